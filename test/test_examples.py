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


"""The examples run, draw what they promise, and find what they speak of."""

from __future__ import annotations

from pathlib import Path
import re
import runpy
import sys

import pytest

from tudor_dynamics.errors import TudorWarning

EXAMPLES = sorted((Path(__file__).resolve().parents[1] / 'examples').glob('*.py'))
FOUND = {
    'fit_a_bag': (r'strain analytical: fit ([0-9.]+) %', 91.0, 94.0),
    'damper_in_motion': (r'with the damper: the strain oscillates by ([0-9.]+)', 5.0, 30.0),
    'own_controller': (r'fed back: strain still swings by ([0-9.]+)', 0.0, 2.0),
    'sweep_of_modes': (r'([0-9.]+) Hz with 400 g', 1.7, 1.9),
    'watch_a_bag': (r'([0-9]+) samples judged, 0 collisions', 2300, 2400),
    'still_tool': (r'another timing: ([0-9.]+) mm', 0.0, 0.5),
    'export_a_run': (r'difference of the strains: ([0-9.e-]+)', 0.0, 1e-9),
}
"""What each prints, with bounds: about what it gave when it was written."""


@pytest.mark.parametrize('script', EXAMPLES, ids=lambda path: path.stem)
@pytest.mark.filterwarnings('default')
def test_example(
    script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Each script ends well, and leaves a picture of its name."""
    monkeypatch.setattr(sys, 'argv', [str(script), str(tmp_path)])
    if script.stem == 'export_a_run':
        with pytest.warns(TudorWarning, match='motor_currents'):
            runpy.run_path(str(script), run_name='__main__')
    else:
        runpy.run_path(str(script), run_name='__main__')
    assert (tmp_path / f'{script.stem}.png').read_bytes().startswith(b'\x89PNG')
    pattern, low, high = FOUND[script.stem]
    match = re.search(pattern, capsys.readouterr().out)
    assert match is not None
    assert low <= float(match[1]) <= high


def test_each_has_its_picture_in_the_repository() -> None:
    """Scripts, pictures and the page that shows them are the same seven."""
    page = (EXAMPLES[0].parent / 'README.md').read_text(encoding='utf-8')
    assert len(EXAMPLES) == len(FOUND) == 7
    for script in EXAMPLES:
        shown = script.with_suffix('.gif' if script.stem == 'damper_in_motion' else '.png')
        assert shown.is_file() and f'`{script.name}`' in page and f'({shown.name})' in page
