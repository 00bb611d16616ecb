# Copyright 2026 tudor_dynamics contributors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Commands print with ``--json`` the keys that the reference has, and each has a meaning."""

from __future__ import annotations

import json
from pathlib import Path
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / 'tools'))

import json_keys  # noqa: E402, I100

KEYS = json.loads(json_keys.FILE.read_text(encoding='utf-8'))


def test_each_key_has_a_meaning() -> None:
    """Sections are those of the tool, and no key stands without a word."""
    assert list(KEYS) == list(json_keys.COMMANDS)
    last = {path.rpartition('.')[2].removesuffix('[]') for keys in KEYS.values() for path in keys}
    assert last == set(json_keys.MEANING)


def test_names_stand_in_capitals() -> None:
    """Lists merge their items, names of bags and channels are no keys, a null takes a type."""
    found = json_keys.keys_of(iter([
        ('a', {'effort': {'joint2': None}, 'bags': {'bags/x@0-20%': {'odd': []}}}),
        ('a', {'effort': {'joint3': 1.23456}, 'items': [{'b': 1}, {'c': True}]})]))
    assert found == {'a': {
        'OUTPUT.CHANNEL': ('number', '1.235'), 'bags.BAG.odd': ('list', ''),
        'items[].b': ('number', '1'), 'items[].c': ('true or false', 'true')}}


def test_commands_print_these_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither more nor fewer, and of the same types; two minutes on an idle machine."""
    monkeypatch.delenv('NO_COLOR', raising=False)
    found = json_keys.keys_of(json_keys.printed(json_keys.COMMANDS))
    assert {title: {path: row[0] for path, row in keys.items()} for title, keys in found.items()
            } == {title: {path: row[0] for path, row in keys.items()}
                  for title, keys in KEYS.items()}, 'python tools/json_keys.py writes them'
