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

"""The causes in docs/reference/causes.md are those of the code, and their tests exist."""

from __future__ import annotations

from pathlib import Path
import re

ROOT = Path(__file__).parents[2]


def rows() -> list[tuple[str, str]]:
    """Give the words of each cause, and the test that shows it."""
    text = (ROOT / 'docs' / 'reference' / 'causes.md').read_text()
    table = text.partition('| cause | level |')[2].partition('\n\n')[0]
    found = re.findall(r'^\| `([^`]+)` \|.*\| `(test_\w+)` \|$', table, re.MULTILINE)
    assert len(found) > 12
    return found


def test_causes_are_said_as_documented() -> None:
    """Each in the words of the controller or of its node, strings across lines joined."""
    said = ''
    for file in ('control/plausibility.py', 'control/motion_controller.py',
                 'nodes/oscillation_damper.py', 'nodes/common/base.py'):
        said += (ROOT / 'tudor_dynamics' / file).read_text()
    said = re.sub(r"'\s*f?'", '', said).replace('{verb}', 'command the joints')
    missing = [cause for cause, _ in rows() if cause not in said]
    assert not missing


def test_each_cause_has_a_test() -> None:
    """A function, or a file of tests."""
    names = ' '.join(file.stem + ' ' + ' '.join(re.findall(r'def (test_\w+)', file.read_text()))
                     for file in (ROOT / 'test').rglob('test_*.py'))
    assert not [test for _, test in rows() if test not in names.split()]
