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


"""The library: what ``import tudor_dynamics as td`` gives, how quickly, and what it refuses."""

from __future__ import annotations

import ast
from collections.abc import Callable
import math
from pathlib import Path
import re
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

import tudor_dynamics as td
from tudor_dynamics.cli.main import main
from tudor_dynamics.library import Prediction
from tudor_dynamics.mechanics.study import SimulatedRun

README = Path(__file__).resolve().parents[1] / 'README.md'
LINES = re.findall(r'^```python\n(.*?)^```$', README.read_text(encoding='utf-8'),
                   re.MULTILINE | re.DOTALL)
"""What the README shows: load, fit, predict, plot; and load, simulate, plot, modes."""


@pytest.fixture(scope='module')
def session(root: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Run the lines of the README, beside copies of arms and bags."""
    names: dict[str, Any] = {}
    place = tmp_path_factory.mktemp('library')
    for name in ('config', 'bags'):
        (place / name).symlink_to(root / name)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        exec(LINES[0], names)
        names['picture'] = (place / 'strain.png').read_bytes()
        exec(LINES[1], names)
    return names


def test_import_takes_no_time() -> None:
    """The import is below 0.1 s and loads none of what takes long; the best of three counts."""
    script = ('import sys, time; begin = time.perf_counter(); import tudor_dynamics as td;'
              'print(time.perf_counter() - begin);'
              'print([name for name in ("numpy", "pinocchio", "numba") if name in sys.modules])')
    runs = [subprocess.run([sys.executable, '-c', script], check=True, capture_output=True,
                           text=True).stdout.split('\n') for _ in range(3)]
    assert min(float(run[0]) for run in runs) < 0.1
    assert runs[0][1] == '[]'


def test_names_are_the_same_for_people_interpreter_and_type_checker() -> None:
    """What the stub imports and exports is the same, and all of it is there."""
    tree = ast.parse(Path(td.__file__).with_suffix('.pyi').read_text(encoding='utf-8'))
    exported = next(ast.literal_eval(node.value) for node in tree.body
                    if isinstance(node, ast.Assign))
    assert sorted(exported) == sorted(td.__all__) == sorted(
        name.name for node in tree.body if isinstance(node, ast.ImportFrom) for name in node.names)
    assert set(td.__all__) <= set(dir(td)) and 12 <= len(td.__all__) <= 60
    for name in td.__all__:
        assert getattr(td, name).__doc__
    with pytest.raises(AttributeError, match='no_such_name'):
        td.no_such_name


def test_few_lines_are_enough(session: dict[str, Any]) -> None:
    """Load, fit, predict, plot; load, simulate, modes: the lines work, and are few."""
    assert len(LINES) == 2
    assert len(LINES[0].splitlines()) <= 8 and len(LINES[1].splitlines()) <= 6
    prediction, run = session['prediction'], session['run']
    assert isinstance(prediction, Prediction) and isinstance(run, SimulatedRun)
    assert prediction.outputs['strain']['analytical'].score.fit > 90.0
    assert session['picture'].startswith(b'\x89PNG')
    assert td.modes(session['arm']).frequency[0] == pytest.approx(3.05, abs=0.01)


def test_what_a_notebook_shows(session: dict[str, Any], root: Path) -> None:
    """Arms, recordings, models, predictions and runs say what they are, in a few lines."""
    recording = td.read_recording(root / 'bags/two_blade_test', session['models'].arm)
    shown = {name: repr(item) for name, item in {
        **session, 'recording': recording, 'modes': td.modes(session['arm'])}.items()
        if name != '__builtins__'}
    assert 'joint2: effort [A] on motor_currents' in shown['arm']
    assert '2400 samples at 100 Hz' in shown['recording']
    assert 'strain: 2 channels from' in shown['recording']
    assert 'strain analytical: link2_hub, link3_hub; fit 9' in shown['models']
    assert 'strain analytical: fit' in shown['prediction']
    assert 'largest elastic rotation' in shown['run'] and 'strain:link2_hub' in shown['run']
    assert '1: 3.05' in shown['modes']
    found = repr(session['prediction'].outputs['strain']['analytical'])
    assert found.startswith('Validation by') and 'link2_hub 9' in found and len(found) < 200
    assert 'strain (2001, 4)' in repr(session['run'].run)
    model = session['models'].models['strain']['analytical']
    assert '11 base parameters by wls, condition' in repr(model)
    assert all(len(shown[name].split('\n')) < 12 for name in
               ('arm', 'recording', 'models', 'prediction', 'run', 'modes'))


@pytest.mark.parametrize('torque', [
    4.6, '4.6 + 0*t', lambda t: 4.6, lambda t: np.float64(4.6), np.full(201, 4.6),
    {'joint2': lambda t: 4.6}], ids=['number', 'text', 'function', 'numpy', 'array', 'by name'])
def test_a_torque_may_be_many_things(session: dict[str, Any], torque: Any) -> None:
    """A constant gives the same run, however it is said."""
    arm = session['arm']
    run = td.simulate(arm, torque, seconds=0.1, dt=5e-4, hold=['joint3']).run
    assert run.effort[:, 1] == pytest.approx(4.6)
    assert run.q[-1, 1] == pytest.approx(
        td.simulate(arm, 4.6, seconds=0.1, dt=5e-4, hold=['joint3']).run.q[-1, 1], rel=1e-12)


def test_a_start_may_be_given(session: dict[str, Any]) -> None:
    """Joints start where they are told to, the others as described."""
    run = td.simulate(session['arm'], seconds=0.01, start={'joint2': 0.3}).run
    assert run.q[0].tolist() == pytest.approx([0.0, 0.3, 0.0])


def test_it_simulates_what_the_command_does(root: Path, tmp_path: Path) -> None:
    """Motors count as they do for ``tudor simulate``, and so does a force at the tip."""
    words = ['--seconds', '0.2', '--dt', '0.0005', '--torque', 'joint2=20*sin(9*t)', '--force',
             'z=3*step(t-0.1)', '--json', '--out', str(tmp_path)]
    assert main(['simulate', str(root / 'config/tudor.yaml'), *words]) == 0
    arm = td.load_arm(root / 'config/tudor.yaml')
    run = td.simulate(arm, {'joint2': lambda t: 20.0 * math.sin(9.0 * t)}, seconds=0.2, dt=5e-4,
                      force={'z': lambda t: 3.0 if t >= 0.1 else 0.0})
    with np.load(tmp_path / 'run.npz') as arrays:
        assert run.run.q == pytest.approx(arrays['q'], abs=1e-12)
        assert run.run.strain == pytest.approx(arrays['strain'], abs=1e-6)
    assert td.modes(arm).frequency[0] == pytest.approx(3.05, abs=0.2)


WRONG: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    'no path': (lambda s: td.load_arm(3), 'path is 3 of type int; expected str or Path'),
    'no bag': (lambda s: td.read_recording(None, s['arm']), 'path is None'),
    'path of an arm': (lambda s: td.fit('bags/x', 'arm.yaml'), r"load_arm\('arm.yaml'\)"),
    'number of bags': (lambda s: td.fit(3, s['arm']), 'give the path of a bag'),
    'no bags': (lambda s: td.fit([], s['arm']), 'no bag to learn from'),
    'absent bag': (lambda s: td.fit('absent', s['arm']), 'no such file'),
    'kind': (lambda s: td.FitSettings(kinds=('elm', 'x')), r"kinds: found \['x'\]"),
    'estimator': (lambda s: td.FitSettings(estimator='x'), 'estimator: found'),
    'settings': (lambda s: td.fit('a', s['arm'], settings='elm'), 'expected FitSettings'),
    'payload of no bag': (lambda s: td.fit('a', s['arm'], payloads={'b': 0.1}), 'one of the bags'),
    'no bundle': (lambda s: td.predict(s['arm'], 'a'), 'expected ModelBundle'),
    'nothing to save': (lambda s: td.save_bundle(3, 'a'), 'expected ModelBundle'),
    'no folder': (lambda s: td.load_bundle(3), 'the directory of a bundle'),
    'monitor': (lambda s: td.Monitor('model'), 'the result of fit or load_bundle'),
    'monitor kind': (lambda s: td.Monitor(s['models'], td.MonitorSettings(kind='elastic')),
                     "not 'elastic'; set kind="),
    'channel': (lambda s: s['prediction'].plot(channel='x'), 'it has link2_hub, link3_hub'),
    'output': (lambda s: s['prediction'].plot(output='x'), 'it has effort, strain'),
    'picture': (lambda s: s['prediction'].plot('a.txt'), 'ends in .png or .svg or .pdf'),
    'arm to simulate': (lambda s: td.simulate('arm.yaml'), 'expected Arm'),
    'joint': (lambda s: td.simulate(s['arm'], {'x': 1.0}), 'use some of'),
    'text': (lambda s: td.simulate(s['arm'], 'x + 1'), 'not allowed in an expression'),
    'function': (lambda s: td.simulate(s['arm'], lambda t: 'a'), 'the torque of joint2'),
    'infinite': (lambda s: td.simulate(s['arm'], lambda t: math.inf), 'not finite at t = 0 s'),
    'array': (lambda s: td.simulate(s['arm'], np.zeros(3)), 'an array of 20001 values'),
    'time': (lambda s: td.simulate(s['arm'], seconds=-1.0), 'give a number above 0 and below 1e9'),
    'direction': (lambda s: td.simulate(s['arm'], force={'up': 1.0}),
                  'force: there is no .up.; use some of'),
    'text as time': (lambda s: td.simulate(s['arm'], seconds='a'), "seconds is 'a'"),
    'held': (lambda s: td.simulate(s['arm'], hold=['x']), "'x' cannot be driven"),
    'place': (lambda s: td.simulate(s['arm'], start={'x': 0.0}), "start names 'x'"),
    'signal': (lambda s: s['run'].plot('x'), "there is no signal 'x'"),
    'plant': (lambda s: td.Plant(s['arm']), r'build_mechanism\(arm\)'),
    'torques': (lambda s: td.Plant(td.build_mechanism(s['arm'])).step([1.0, 2.0]),
                '3 numbers, for the joints'),
    'places': (lambda s: td.Plant(td.build_mechanism(s['arm'])).reset('abc'), 'q is'),
    'mechanism': (lambda s: td.build_mechanism('arm.yaml'), 'expected Arm'),
    'modes': (lambda s: td.modes(s['arm'], 0), 'a count of 1 or more'),
    'free joint': (lambda s: td.modes(s['arm'], free_joints=['x']), 'some of'),
}


@pytest.mark.parametrize('case', WRONG)
def test_a_wrong_argument_gives_our_error(session: dict[str, Any], case: str) -> None:
    """One line that says what was found and what was expected, and no error of another library."""
    call, message = WRONG[case]
    with pytest.raises(td.TudorError, match=message):
        call(session)


def knowing(recording: td.Recording, truth: Path) -> np.ndarray:
    """Say 5 where the arm is touched, and NaN in the first second."""
    said = np.zeros(len(recording.stamp))
    for line in truth.read_text(encoding='utf-8').splitlines():
        begin, end = map(float, line.split(','))
        said[(recording.t >= begin) & (recording.t <= end)] = 5.0
    said[recording.t < 1.0] = np.nan
    return said


def test_detectors_are_compared_by_their_roc(root: Path, tmp_path: Path) -> None:
    """One that knows the pushes finds them all; one that does not, as many as it errs."""
    arm, bag = td.load_arm(root / 'config/two_blade_arm.yaml'), root / 'bags/two_blade_pushes'
    table = tmp_path / 'pushes.csv'
    table.write_text('5.0,5.5\n9.0,9.5\n15.0,15.5\n', encoding='utf-8')
    rng = np.random.default_rng(4)
    found = td.roc({'knows': lambda recording: knowing(recording, table),
                    'guesses': lambda recording: rng.random(len(recording.stamp))},
                   bag, arm, truth=[table])
    knows, guesses = found['knows'], found['guesses']
    assert knows.pushes == 3 and knows.found[knows.false == 0].max() == 3
    at = int(np.flatnonzero(knows.found == 3)[0])
    assert 4.9 < knows.factor[at] < 5.0
    assert guesses.found[guesses.false == 0].max(initial=0) < 3
    assert guesses.share()[-1] == 100.0 and guesses.per_hour()[-1] > 1000.0
    with pytest.raises(td.TudorError, match='one number per sample'):
        td.roc({'short': lambda recording: np.zeros(3)}, bag, arm)
    with pytest.raises(td.TudorError, match='no value above zero'):
        td.roc({'never': lambda recording: 0.0 * recording.t}, bag, arm)
    with pytest.raises(td.TudorError, match='does not say when it was pushed'):
        td.roc({'any': lambda recording: recording.t}, root / 'bags/two_blade_test', arm)
    with pytest.raises(td.TudorError, match='give one for each'):
        td.roc({'any': lambda recording: recording.t}, bag, arm, truth=[table, table])
