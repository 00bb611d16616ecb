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

"""No command runs for ever or asks for all memory: one budget of steps and bytes."""

from __future__ import annotations

from pathlib import Path

from bag_making import make_arm, make_bag
import pytest
from tudor_dynamics.cli.main import main
from tudor_dynamics.errors import check_budget, MAX_BYTES, MAX_STEPS, UsageError
from tudor_dynamics.library import fit
from tudor_dynamics.mechanics.run import count_steps

LINK = 'simulate config/single_flexible_link.yaml --torque 0 --out {out}'
RECORD = 'record --arm config/tudor.yaml --out {out} --seconds 3 --stimuli 1'


@pytest.mark.parametrize(('words', 'cause'), [
    (f'{LINK} --dt 1e-300', 'steps of 1e-300 s needs 5e+294 million steps, more than the limit'),
    (f'{LINK} --dt 1e-9', '5e+03 million steps'),
    (f'{LINK} --dt 1e-6 --seconds 1e5', '1e+05 million steps'),
    (f'{LINK} --dt 1e-4 --seconds 1e3 --rate 1e4', 'needs 8.2 GB of memory'),
    ('record --arm config/tudor.yaml --out {out} --stimuli 1000000000', 'give 1 to 100000'),
    (f'{RECORD} --rate 1e-300', 'divided by a whole number'),
    (f'{RECORD} --trajectory {{table}}', 'a trajectory of 1e+09 s'),
    ('excite config/tudor.yaml --out {out} --floor 0 --seconds 3600 --budget 1',
     'a motion of 3600 s'),
])
def test_every_command(
    words: str, cause: str, root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What takes a duration, a step, a rate or a count is refused on one line."""
    (tmp_path / 'table.csv').write_text('t,joint2,joint3\n0,0.5,0\n1e9,0.6,0.1\n')
    places = {'out': tmp_path / 'out', 'table': tmp_path / 'table.csv'}
    monkeypatch.chdir(root)
    assert main(words.format_map(places).split()) == 2
    err = [line for line in capsys.readouterr().err.splitlines() if line.startswith('tudor ')]
    assert len(err) == 1 and cause in err[0], err
    assert not [*tmp_path.rglob('*.npz'), *tmp_path.rglob('*.mcap')]


@pytest.mark.parametrize(('settings', 'cause'), [
    ({'elm_hidden': 10**9}, '1000000000 neurons'),
    ({'elm_seed': -1}, 'elm_seed= -1: give 0')])
def test_learning_machines(tmp_path: Path, settings: dict, cause: str) -> None:
    """Neurons are counted before they are made."""
    from tudor_dynamics.library import FitSettings

    with pytest.raises(ValueError, match=cause):
        fit(make_bag(tmp_path / 'bag'), make_arm(gauges=[], joints=[
            {'name': name} for name in ('shoulder', 'elbow')]), bare=True,
            settings=FitSettings(kinds=('elm',), **settings))


def test_the_budget_itself() -> None:
    """What is just enough passes; what is no number does not."""
    check_budget('x', MAX_STEPS, MAX_BYTES / MAX_STEPS)
    for steps, each in ((MAX_STEPS + 1, 1.0), (MAX_STEPS, 8 * MAX_BYTES), (float('nan'), 1.0)):
        with pytest.raises(UsageError, match='more than the limit of (20 million|4 GB)'):
            check_budget('x', steps, each)
    assert count_steps(5.0, 2.5e-4, 1000.0) == (20_000, 4)
    assert count_steps(1e-300, 1e-300, 1e-300) == (1, 2)
