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

"""Licence: header of every Python file, text of LICENSE and CONTRIBUTING.md."""

from __future__ import annotations

import importlib.util
from pathlib import Path
import re

import pytest

# Short form of the appendix of the Apache License, as ament_copyright knows it.
HEADER = """\
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
"""


def header_fault(text: str) -> str | None:
    """Say what is wrong with the header of a Python file, None if nothing is."""
    if text.startswith('#!'):
        text = text.partition('\n')[2].lstrip('\n')
    first, _, rest = text.partition('\n')
    if not re.fullmatch(r'# Copyright 20\d\d(-20\d\d)? \S.*', first):
        return f'starts with {first!r}, expected "# Copyright YEAR NAME"'
    if not rest.startswith(HEADER):
        return 'the copyright line is not followed by the short form of the Apache License 2.0'
    if rest[len(HEADER):] and not rest[len(HEADER):].startswith('\n'):
        return 'no empty line after the licence header'
    return None


@pytest.mark.copyright
@pytest.mark.linter
def test_headers(root: Path) -> None:
    """Every Python file that is not empty begins with the Apache header."""
    files = [root / 'setup.py']
    for place in ('tudor_dynamics', 'papers', 'test', 'bench'):
        files += sorted((root / place).rglob('*.py'))
    assert len(files) > 10
    faults = {str(file.relative_to(root)): fault for file in files
              if (text := file.read_text(encoding='utf-8')) and (fault := header_fault(text))}
    assert not faults


@pytest.mark.parametrize(('text', 'fault'), [
    ('', 'expected "# Copyright YEAR NAME"'),
    ('# Copyright 2026 A\n# SPDX-License-Identifier: Apache-2.0\n', 'short form'),
    ('# Copyright 2026 A\n' + HEADER.replace('AS IS', 'as is'), 'short form'),
    ('# Copyright 2026 A\n' + HEADER + 'import os\n', 'no empty line'),
])
def test_header_check_sees_faults(text: str, fault: str) -> None:
    """The check of the headers finds what ament_copyright would."""
    assert fault in (header_fault(text) or '')


def test_licence_texts(root: Path) -> None:
    """LICENSE is the whole Apache text, and CONTRIBUTING.md quotes its fifth section."""
    licence = (root / 'LICENSE').read_text(encoding='utf-8')
    assert licence.split()[:2] == ['Apache', 'License']
    for number in range(1, 10):
        assert re.search(rf'^   {number}\. [A-Z]', licence, re.MULTILINE)
    assert 'END OF TERMS AND CONDITIONS' in licence
    start = licence.index('   5. Submission of Contributions.')
    section = ' '.join(licence[start:licence.index('   6. Trademarks.')].split())
    contributing = (root / 'CONTRIBUTING.md').read_text(encoding='utf-8')
    assert section in ' '.join(contributing.split())


@pytest.mark.copyright
@pytest.mark.linter
@pytest.mark.skipif(importlib.util.find_spec('ament_copyright') is None,
                    reason='ament_copyright comes with ROS only; test_headers checks the same')
def test_ament_copyright(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Check with ROS's own tool, where it is."""
    from ament_copyright.main import main
    monkeypatch.chdir(root)
    assert main(argv=['tudor_dynamics', 'test', 'setup.py']) == 0
