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

"""Which numbers a sweep finds, and what it makes of them."""

from __future__ import annotations

from pathlib import Path
import sys

BENCH = Path(__file__).resolve().parents[1] / 'bench'
sys.path.insert(0, str(BENCH))

from sweep import CASES, largest_change, numbers  # noqa: E402

SETTINGS = '''
RISE, DWELL = 0.5, 3
"""Seconds, samples."""
EDGES = (1.0, 2.0)
NAME = 'none'
TOTAL = RISE + 1.0


class Settings:
    """Of a room."""

    gain: float = 2.0  # 1/s
    on: bool = True
'''


def test_numbers_are_found(tmp_path: Path) -> None:
    """Numbers at the top, in tuples and as defaults; no text, no flag, nothing computed."""
    (tmp_path / 'online').mkdir()
    (tmp_path / 'online' / 'settings.py').write_text(SETTINGS)
    (tmp_path / 'online' / 'other.py').write_text('LIMIT = 4.0\n')
    found = [(item.name, item.value) for item in numbers(tmp_path, ['online'], False)]
    assert found == [('RISE', 0.5), ('DWELL', 3), ('EDGES', 1.0), ('EDGES', 2.0), ('gain', 2.0)]
    assert 'LIMIT' in {item.name for item in numbers(tmp_path, [], True)}
    assert not list(numbers(tmp_path, ['arm'], True))


def test_a_number_changes_in_its_place(tmp_path: Path) -> None:
    """A float by its part, an integer by one at least."""
    (tmp_path / 'online').mkdir()
    (tmp_path / 'online' / 'settings.py').write_text(SETTINGS)
    changed = {item.name: (item.changed(0.7), item.changed(1.3))
               for item in numbers(tmp_path, [], False)}
    assert changed['RISE'] == ('0.35', '0.65')
    assert changed['DWELL'] == ('2', '4')
    line = SETTINGS.splitlines()[1]
    dwell = next(item for item in numbers(tmp_path, [], False) if item.name == 'DWELL')
    assert line[dwell.start:dwell.end] == '3'


def test_cases_exist() -> None:
    """Every case that a room is tried on is one of the recorder."""
    from golden_cases import read_table

    assert not {case for cases in CASES.values() for case in cases} - set(read_table())
    assert largest_change(Path(), Path(), []) == 'nothing'
