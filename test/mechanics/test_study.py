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

"""What a study takes of the library beside fit and predict, on small cases."""

from __future__ import annotations

import json
from pathlib import Path

from motion_machine import tudor
import numpy as np
import pytest
from schedule_making import schedule

import tudor_dynamics as td
from tudor_dynamics.cli.main import main

DRIVEN = {'joint2': 4.6}


@pytest.fixture(scope='module')
def model(two_blades: Path) -> Path:
    """Give the fit of the shipped bags, with thresholds."""
    return two_blades


@pytest.fixture(scope='module')
def run(root: Path) -> td.SimulatedRun:
    """Let the elastic arm sag for a moment."""
    return td.simulate(td.load_arm(root / 'config/elastic_arm.yaml'), DRIVEN, seconds=0.1, dt=5e-4)


def test_detect_finds_what_the_command_finds(
    model: Path, root: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """The same figures for every method, from the names of bags."""
    bag = root / 'bags/two_blade_pushes'
    assert main(['evaluate', '--model', str(model), str(bag), '--collisions', '--json']) == 0
    said = json.loads(capsys.readouterr().out)['collisions']
    found = {item.method: item for item in td.detect(td.load_bundle(model), bag)}
    assert {*found} == {*said}
    for method, item in found.items():
        assert item.score.pushes == said[method]['pushes'] > 0
        assert item.score.found == said[method]['found']
        assert item.score.latency_median == pytest.approx(said[method]['latency_median'])
        assert len(item.watched) == 1 and len(item.watched[0].truth.pushes) == item.score.pushes


def test_detect_refuses_what_it_cannot_use(model: Path, root: Path) -> None:
    """Our error, that says what was found."""
    with pytest.raises(td.TudorError, match='expected ModelBundle'):
        td.detect('model', root / 'bags/two_blade_pushes')
    with pytest.raises(td.TudorError, match='MonitorSettings'):
        td.detect(td.load_bundle(model), root / 'bags/two_blade_pushes', 'strain')
    bare = td.load_bundle(model)
    bare.facts['thresholds'] = {}
    with pytest.raises(td.TudorError, match='no collision thresholds'):
        td.detect(bare, root / 'bags/two_blade_pushes')


def test_bare_models_are_the_same(model: Path, root: Path, tmp_path: Path) -> None:
    """Models and figures of a full fit, and nothing on what they are good for."""
    bags = [root / f'bags/two_blade_train_{k}' for k in (1, 2)]
    arm, test = td.load_arm(root / 'config/two_blade_arm.yaml'), root / 'bags/two_blade_test'
    bare, full = td.fit(bags, arm, bare=True), td.load_bundle(model)
    for output, kinds in full.models.items():
        for kind, known in kinds.items():
            assert bare.models[output][kind].to_dict(arm, output) == known.to_dict(arm, output)
    assert bare.facts['validation'] == full.facts['validation'] and not bare.facts['findings']
    assert not {'thresholds', 'uses', 'payload_errors'} & {*bare.facts}
    td.save_bundle(bare, tmp_path / 'bare')
    assert td.predict(td.load_bundle(tmp_path / 'bare'), test).outputs.keys() == full.models.keys()
    with pytest.raises(td.TudorError, match='no data for the report'):
        td.fit(bags, arm, out=tmp_path / 'x', bare=True)


def test_signals_of_a_run(run: td.SimulatedRun, tmp_path: Path) -> None:
    """Curves with labels and unit, their amplitudes, a titled picture, a moving one."""
    curves = run.curves('acceleration:tip')
    assert curves.labels == ('x', 'y', 'z') and curves.unit == 'm/s$^2$'
    assert curves.values.tolist() == run.values('acceleration:tip').tolist()
    frequency, amplitude = run.spectrum('acceleration:tip')
    assert amplitude.shape == (len(frequency), 3)
    assert frequency[1] == pytest.approx(1.0 / (len(run.run.t) * 1e-3))
    assert run.plot('acceleration:tip', title='tip').axes[0].get_title() == 'tip'
    run.animate(tmp_path / 'run.gif')
    assert (tmp_path / 'run.gif').read_bytes().startswith(b'GIF')
    with pytest.raises(td.TudorError, match='.gif or .mp4'):
        run.animate(tmp_path / 'run.txt')
    with pytest.raises(td.TudorError, match='there is no signal'):
        run.curves('x')


def test_the_plant_of_a_run_is_where_it_ended(run: td.SimulatedRun) -> None:
    """So its modes are those about the end."""
    assert run.plant.state.q == pytest.approx(run.run.q[-1])
    start = td.modes(run.arm).frequency[0]
    assert td.modes(run.plant).frequency[0] == pytest.approx(start, rel=0.1)


def test_a_rig_follows_a_schedule() -> None:
    """The payload that its controller is given comes into use, whatever the arm carries."""
    rig = td.Rig(tudor(), payload=0.2)
    rig.follow(schedule(), 0.3)
    rig.run(2.0)
    assert rig.controller is not None and rig.controller.adaptation is not None
    assert rig.controller.adaptation.payload == pytest.approx(0.3, abs=0.01)


def test_signals_as_models_are_given_them(root: Path) -> None:
    """What ``prepare`` gives of a recording is what predictions are made of."""
    arm = td.load_arm(root / 'config/two_blade_arm.yaml')
    recording = td.read_recording(root / 'bags/two_blade_test', arm)
    (stretch,) = td.prepare(recording, arm.spec.preprocessing)
    assert stretch.states.q.shape == (len(stretch.t), len(arm.active_joints))
    assert np.isfinite(stretch.states.ddq).all()


def test_figures_of_a_prediction() -> None:
    """Nothing is left over of a perfect one, and all of it of a constant."""
    measured = np.random.default_rng(0).normal(size=(100, 2))
    assert td.score(measured, measured, ['a', 'b']).fit == pytest.approx(100.0)
    mean = np.tile(measured.mean(axis=0), (100, 1))
    assert td.score(measured, mean, ['a', 'b']).fit == pytest.approx(0.0, abs=1e-9)
