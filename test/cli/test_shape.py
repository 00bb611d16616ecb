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

"""``tudor shape``: trajectories of others, after which nothing rings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tool_making import ARM, curved, KNOWN, moves, recording, ring_after, tool_efforts

from tudor_dynamics.bags.trajectory import (
    read_trajectories, Sent, Trajectory, write_trajectories)
from tudor_dynamics.bags.writer import joint_signals, recording_series, write_bag
from tudor_dynamics.cli.main import main
from tudor_dynamics.errors import SignalError
from tudor_dynamics.identification import tool
from tudor_dynamics.identification.dataset import load, parse_choice
from tudor_dynamics.identification.tool import tool_of_bags
from tudor_dynamics.models.bundle import load_bundle, ModelBundle, save_bundle
from tudor_dynamics.signals.motion_profile import spline
from tudor_dynamics.signals.shaping import convolved, impulses, remains
from tudor_dynamics.typing import FloatArray

FREQUENCY, DAMPING = 2.9, 0.02


def _move(*, accelerations: bool = True) -> Trajectory:
    s = np.linspace(0.0, 1.0, 21)[:, None]
    way, seconds = np.array([0.8, -0.3]), 0.9
    return Trajectory(
        ('a', 'b'), seconds * s[:, 0], way * s**3 * (10.0 - s * (15.0 - 6.0 * s)),
        way * 30.0 * s**2 * (1.0 - s)**2 / seconds,
        way * (60.0 * s - 180.0 * s**2 + 120.0 * s**3) / seconds**2 if accelerations else None)


def _ringing(trajectory: Trajectory, frequency: float) -> FloatArray:
    """Integrate a mode that each joint drives: amplitudes after the end (joints,)."""
    dt, omega = 2e-4, 2.0 * np.pi * frequency
    curve, end = spline(trajectory), float(trajectory.t[-1])
    t = np.arange(0.0, end + 1.0, dt)
    q = np.asarray(curve(np.clip(t, 0.0, end)))
    drive = np.gradient(np.gradient(q, dt, axis=0), dt, axis=0)
    y = speed = np.zeros(q.shape[1])
    found = []
    for a in drive:
        speed = speed + dt * (-a - 2.0 * DAMPING * omega * speed - omega**2 * y)
        y = y + dt * speed
        found.append(y)
    return np.asarray(np.abs(np.array(found)[t > end + 0.01]).max(axis=0))


@pytest.mark.parametrize(('kind', 'most', 'most_off'), [('zv', 0.02, 0.1), ('zvd', 0.02, 0.03)])
@pytest.mark.parametrize('accelerations', [True, False])
def test_nothing_rings_on(
    kind: str, most: float, most_off: float, *, accelerations: bool,
) -> None:
    """The tool is left still, and nearly so where its frequency was taken 5 % too low."""
    given = _move(accelerations=accelerations)
    shaper = impulses(kind, FREQUENCY, DAMPING)
    shaped = convolved(given, shaper)
    for frequency, bound in ((FREQUENCY, most), (1.05 * FREQUENCY, most_off)):
        share = _ringing(shaped, frequency) / _ringing(given, frequency)
        assert share.max() < bound
        assert share.max() == pytest.approx(remains(shaper, frequency, DAMPING), abs=0.015)


def test_limits_of_the_given_motion_hold_between_points_too() -> None:
    """Ends stay, and neither speed nor acceleration is larger than it was, at any time."""
    given = _move()
    shaped = convolved(given, impulses('zv', FREQUENCY, DAMPING))
    assert np.array_equal(shaped.q[[0, -1]], given.q[[0, -1]])
    assert shaped.t[-1] - given.t[-1] == pytest.approx(0.5 / FREQUENCY, rel=0.01)
    for order in (1, 2):
        largest = [np.abs(spline(one).derivative(order)(np.linspace(
            0.0, one.t[-1] - 1e-9, 5000))).max(axis=0) for one in (given, shaped)]
        assert (largest[1] <= largest[0] * (1.0 + 1e-6)).all()


def test_motion_that_does_not_end_at_rest_is_refused() -> None:
    """There is nothing to be left still."""
    given = _move(accelerations=False)
    assert given.dq is not None
    given.dq[-1] = 0.2
    with pytest.raises(SignalError, match='does not begin and end at rest'):
        convolved(given, impulses('zv', FREQUENCY, DAMPING))


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It says what it costs and what remains, and writes what it was given."""
    path, out = tmp_path / 'path.csv', tmp_path / 'still.csv'
    write_trajectories(path, [Sent(_move())])
    command = ['shape', str(path), '--frequency', '2.9', '--out', str(out)]
    assert main(command) == 0
    said = capsys.readouterr().out
    assert 'zv, 0.172 s longer' in said and '2.9 Hz' in said and str(out) in said
    (sent,) = read_trajectories(out)
    assert sent.trajectory.t[-1] == pytest.approx(1.072, abs=1e-3)
    assert main(command) == 2 and 'exists already' in capsys.readouterr().err
    assert main([*command[:3], '-1', *command[4:], '--overwrite']) == 2
    bags = [tmp_path / 'path', tmp_path / 'still']
    for bag in bags:
        write_trajectories(bag, [Sent(_move())])
    command = ['shape', str(bags[0]), '--frequency', '2.9', '--out', str(bags[1])]
    assert main(command) == 2 and 'or add --overwrite' in capsys.readouterr().err
    assert main([*command, '--overwrite']) == 0
    (sent,) = read_trajectories(bags[1])
    assert sent.trajectory.t[-1] == pytest.approx(1.072, abs=1e-3)


@pytest.fixture(scope='module')
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Save a bundle that has nothing but a tool."""
    path = tmp_path_factory.mktemp('tool') / 'model'
    save_bundle(ModelBundle(ARM, ARM.spec.preprocessing, {}, tool=KNOWN), path)
    return path


def test_a_tool_of_bags(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The planned motion is used where all bags have recorded it."""
    q = moves(1, count=3)
    own = recording(q, tool_efforts(ARM, q))
    reference = joint_signals('/joint_reference', own.stamp, ARM.active_joints, q, None, None)
    bags = []
    for name, more in (('with', [reference]), ('without', [])):
        write_bag(tmp_path / name, [*recording_series(own, ARM), *more])
        bags.append(load(parse_choice(str(tmp_path / name)), ARM, ARM.spec.preprocessing))
    given: list[Any] = []
    monkeypatch.setattr(tool, 'fit_tool', lambda *args: given.append(args) or KNOWN)
    assert tool_of_bags(ARM, bags[:1], None) == KNOWN == tool_of_bags(ARM, bags, None)
    (_, one, kind), (_, both, other) = given
    assert (kind, other) == ('planned', 'measured')
    assert len(one[0].rests) == 3 and len(both) == 2


def test_by_a_model_that_knows_the_tool(
    model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """The trajectories of a bag are shaped for it; what each costs and brings is said."""
    assert load_bundle(model).tool == KNOWN
    assert 'tool: rings at 3 and 3.7 Hz' in repr(load_bundle(model))
    wanted, plan = [curved(seed) for seed in (1, 2)], tmp_path / 'plan'
    write_trajectories(plan, [Sent(one) for one in wanted])
    for kind in ('timing', 'zv'):
        out = tmp_path / kind
        assert main(['shape', str(plan), '--model', str(model), '--by', kind,
                     '--out', str(out)]) == 0
        said = capsys.readouterr().out
        assert f'{kind}: the ring after each trajectory' in said and said.count(') N m') == 4
        for sent, given in zip(read_trajectories(out), wanted, strict=True):
            longer = (sent.trajectory.t[-1] - given.t[-1]) * 3.0
            assert 0.4 < longer < (0.7 if kind == 'timing' else 1.0)
            assert kind == 'zv' or ring_after(sent.trajectory) < 0.1 * ring_after(given)


def test_a_model_without_a_tool(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It is said how to learn one."""
    save_bundle(ModelBundle(ARM, ARM.spec.preprocessing, {}), tmp_path / 'm')
    write_trajectories(tmp_path / 'path.csv', [Sent(curved(1))])
    assert main(['shape', str(tmp_path / 'path.csv'), '--model', str(tmp_path / 'm'),
                 '--out', str(tmp_path / 'still.csv')]) == 2
    assert 'the model has no tool that vibrates; record motions' in capsys.readouterr().err


@pytest.mark.parametrize(('options', 'says'), [
    (['--frequency', '2', '--by', 'timing'],
     '--by timing needs a model of a tool that vibrates; give'),
    (['--model', 'm', '--damping', '0.1'], '--damping cannot be given with --model')])
def test_options_that_do_not_fit(
    options: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """They are refused in one line before anything is read."""
    write_trajectories(tmp_path / 'path.csv', [Sent(_move())])
    assert main(['shape', str(tmp_path / 'path.csv'), *options,
                 '--out', str(tmp_path / 'still.csv')]) == 2
    assert says in ' '.join(capsys.readouterr().err.split())
