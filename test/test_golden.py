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

"""``tools/golden.py``: a record sees what has changed, and nothing where nothing has."""

from __future__ import annotations

import importlib
import json
from pathlib import Path
import shutil
import sys
from typing import Any

import numpy as np
import pytest

TOOLS = str(Path(__file__).resolve().parents[1] / 'tools')
sys.path.insert(0, TOOLS)
golden = importlib.import_module('golden')
read_table = importlib.import_module('golden_cases').read_table
files = importlib.import_module('golden_files')
dropped, of_folder = files.dropped, files.of_folder
sys.path.remove(TOOLS)

VALUES: dict[str, Any] = {'exit code': 0, 'stdout:error': 0.1, 'out.npz:q': np.array([[1.0, 2.0]]),
                          'page.html:text': 'mass 0.25 kg\nno finding'}


def kept(folder: Path, **changes: Any) -> Path:
    """Write a record of one case, whose values are changed; None leaves one out."""
    values = {**VALUES, **{key.replace('__', ':'): value for key, value in changes.items()}}
    golden.save_case(folder, 'part/case', {
        key: value for key, value in values.items() if value is not None})
    (folder / 'about.json').write_text(json.dumps({'cases': ['part/case']}))
    return folder


@pytest.mark.parametrize(('changes', 'said', 'beyond'), [
    ({'stdout__error': 0.1 + 2e-17}, '0.1 -> 0.10000000000000002', 1e-9),
    ({'stdout__error': 0.1001}, '0.1 -> 0.1001', 1e-2),
    ({'out.npz__q': np.array([[1.0, 2.0 + 1e-12]])},
     '1 of 2 numbers differ, by up to 5e-13', 1e-9),
    ({'out.npz__q': np.array([[1.0, -0.0]])}, '1 of 2 numbers differ, by up to 1 of', None),
    ({'out.npz__q': np.array([[1.0], [2.0]])}, '(1, 2) -> float64 (2, 1)', None),
    ({'out.npz__q': None}, 'out.npz:q: only in A', None),
    ({'page.html__text': 'mass 0.25 kg\none finding'},
     "line 2: 'no finding' -> 'one finding'", None),
    ({'page.html__text': 'mass 0.2500001 kg\nno finding'}, 'line 1: ', 1e-6),
    ({'new.csv__text': ''}, 'new.csv:text: only in B', None),
    ({'exit code': 1}, 'exit code: 0 -> 1', None),
])
def test_a_change_is_seen(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], changes: dict[str, Any], said: str,
    beyond: float | None,
) -> None:
    """A number, a shape, a text, a file more or less; small ones only without a tolerance."""
    a, b = kept(tmp_path / 'a'), kept(tmp_path / 'b', **changes)
    assert golden.main(['compare', str(a), str(b)]) == 1
    shown = capsys.readouterr().out
    assert said in shown and '0 of 1 cases are equal' in shown
    code = golden.main(['compare', str(a), str(b), '--tolerance', str(beyond or 1e-6)])
    assert code == (0 if beyond else 1)


def test_long_numbers_are_no_checksums() -> None:
    """Only words of a checksum may differ beside numbers within the tolerance."""
    digest = '79817f6538267ed9bae2c61d144588af'
    assert golden.alike(f'of {digest}: 0.5', f'of {digest[::-1]}: 0.5', 1e-9)
    assert not golden.alike('0.1234567890123', '0.1234567990123', 1e-9)
    assert not golden.alike('1234567890123', '1234577890123', 1e-9)


def test_equal_records_are_equal(tmp_path: Path) -> None:
    """Numbers that are none are equal to themselves, bit for bit."""
    odd = {'stdout__error': float('nan'), 'out.npz__q': np.array([np.nan, -np.inf, -0.0])}
    a, b = kept(tmp_path / 'a', **odd), kept(tmp_path / 'b', **odd)
    assert golden.main(['compare', str(a), str(b)]) == 0


def test_a_case_recorded_twice_is_equal(root: Path, tmp_path: Path) -> None:
    """A command runs in a folder of its own each time, and gives the same."""
    places = [tmp_path / name for name in ('a', 'b')]
    for place in places:
        assert golden.main(['record', str(place), '--root', str(root), '--only',
                            'init/dh', 'errors/command']) == 0
    assert golden.main(['compare', *map(str, places)]) == 0
    values = golden.load_case(places[0], 'errors/command')
    assert values['exit code'] == 2 and 'nonsense' in values['stderr:text']


def test_a_bag_is_compared_by_its_messages(root: Path, tmp_path: Path) -> None:
    """Topics, stamps and numbers; a page by its words."""
    shutil.copytree(root / 'bags' / 'two_blade_test', tmp_path / 'bag')
    (tmp_path / 'page.html').write_text('<style>a</style><p>one <b>load</b></p><img src="x">')
    found = of_folder(tmp_path)
    assert found['bag:/joint_states.count'] == len(found['bag:/joint_states.numbers']) == 2400
    assert found['page.html:text'] == 'one load [picture]'


def test_when_and_by_which_commit_a_model_was_fitted_is_not_compared(tmp_path: Path) -> None:
    """Two commits that do the same give equal records, in a page and in a bundle."""
    for place, commit, date in (('a', '0123456789ab', '2026-11-25 22:32 UTC'),
                                ('b', 'ba9876543210, changed', '2026-11-26 08:01 UTC')):
        (tmp_path / place).mkdir()
        (tmp_path / place / 'page.html').write_text(
            f'<p>{date}</p><tr><th>Commit</th><td><code>{commit}</code></td></tr>error 0.5')
        (tmp_path / place / 'model.yaml').write_text(
            f'facts:\n  made: {{commit: "{commit}", date: "{date}", python: "3.11"}}\n')
    found, other = ({key: value for key, value in of_folder(tmp_path / place).items()
                     if not dropped(key)} for place in 'ab')
    assert found == other
    assert 'error 0.5' in found['page.html:text']
    assert found['model.yaml:facts.made.python'] == '3.11'


def test_cases_come_after_what_they_need() -> None:
    """Quick ones need quick ones or are few; all names that are used exist."""
    table = read_table()
    order = list(table)
    assert all(order.index(need) < order.index(case.name)
               for case in table.values() for need in case.needs)
    assert table['evaluate/elastic'].needs == ('fit/elastic',)
