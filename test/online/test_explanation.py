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

"""Causes of events: one of each kind is put into a recording of free motion, and is named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.cli.main import main
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.bundle_io import load_bundle
from tudor_dynamics.online.black_box import Heard, Replay
from tudor_dynamics.online.explanation import explain, Explanation
from tudor_dynamics.online.monitor import MonitorSettings

SETTINGS = MonitorSettings(methods=('strain', 'effort'))
AT = 1000
"""Sample at which a cause begins: 10 s, in the middle of a move."""
Change = Callable[[dict[str, np.ndarray], dict[str, np.ndarray]], object]


@pytest.fixture(scope='module')
def bundle(tmp_path_factory: pytest.TempPathFactory, root: Path) -> ModelBundle:
    """Fit a model to the sample bags."""
    out = tmp_path_factory.mktemp('why') / 'model'
    assert main(['fit', *(str(root / f'bags/two_blade_train_{k}') for k in (1, 2)), '--arm',
                 str(root / 'config/two_blade_arm.yaml'), '--filter', 'causal', '--estimator',
                 'wls', '--friction', 'viscous', 'coulomb', '--currents', 'separate', '--out',
                 str(out), '--force']) == 0
    return load_bundle(out)


def messages(recording: Recording, change: Change | None = None) -> list[Heard]:
    """Make messages of a recording, whose values and stamps may be changed first."""
    values = {'joints': recording.q.copy(), 'effort': recording.effort.copy(),
              'strain': recording.strain.copy()}
    stamps = {name: recording.stamp.copy() for name in values}
    if change is not None:
        change(values, stamps)
    return sorted((Heard(int(recording.stamp[k]) + place, name, name, int(stamps[name][k]),
                         values[name][k])
                   for place, name in enumerate(values) for k in range(len(recording.stamp))),
                  key=lambda item: item.time)


def cause(bundle: ModelBundle, heard: list[Heard], least: int = 0) -> Explanation:
    """Explain the first event after a stamp."""
    events = [event for event in Replay(bundle, SETTINGS, heard).events if event.stamp > least]
    return explain(bundle, SETTINGS, heard, events[0])


@pytest.fixture(scope='module')
def free(root: Path) -> Recording:
    """Read a bag in which nothing touches the arm."""
    return read_recording(root / 'bags/two_blade_test',
                          load_arm(root / 'config/two_blade_arm.yaml'))


def gauge(values: dict[str, np.ndarray], stamps: dict[str, np.ndarray]) -> None:
    """Let one gauge leap."""
    values['strain'][AT:, 1] += 250.0


def encoder(values: dict[str, np.ndarray], stamps: dict[str, np.ndarray]) -> None:
    """Let a joint lose counts."""
    values['joints'][AT:, 1] += 0.1


def clock(values: dict[str, np.ndarray], stamps: dict[str, np.ndarray]) -> None:
    """Set the clock of the gauges."""
    stamps['strain'][AT:] += 150_000_000


def stall(values: dict[str, np.ndarray], stamps: dict[str, np.ndarray]) -> None:
    """Repeat old positions, with new stamps."""
    for begin in (AT, AT + 30):
        values['joints'][begin:begin + 12] = values['joints'][begin]


def nonsense(values: dict[str, np.ndarray], stamps: dict[str, np.ndarray]) -> None:
    """Let all channels go their own ways."""
    rng = np.random.default_rng(3)
    for name, size in (('strain', 300.0), ('effort', 1.0)):
        walk = np.cumsum(rng.standard_normal((80, 2)), axis=0) / 9.0
        values[name][AT:AT + 80] += size * walk


@pytest.mark.parametrize(('change', 'expected'), [
    (gauge, 'sensor'), (encoder, 'sensor'), (clock, 'clock'), (stall, 'samples'),
    (nonsense, 'unexplained')])
def test_what_is_put_in_is_named(
    bundle: ModelBundle, free: Recording, change: Change, expected: str,
) -> None:
    """Nothing alarms before; then the cause has its name."""
    assert not Replay(bundle, SETTINGS, messages(free)).events
    found = cause(bundle, messages(free, change))
    assert found.cause == expected, found


def test_pushes_are_touches(bundle: ModelBundle, root: Path) -> None:
    """Link and order of the force are right; truth is 3.2 N at the end of the third link."""
    recording = read_recording(root / 'bags/two_blade_pushes',
                               load_arm(root / 'config/two_blade_arm.yaml'))
    found = cause(bundle, messages(recording), int(recording.stamp[0]) + 14_000_000_000)
    assert found.cause == 'touch' and 'joint3 is touched' in found.text
    force = float(found.text.rsplit('about ', 1)[1].removesuffix(' N'))
    assert 1.5 < force < 7.0
    assert found.remains['touch'] < found.remains['sensor']


def test_a_load_is_one(bundle: ModelBundle, free: Recording) -> None:
    """What a mass at the tip does to all channels from a time on is called a load."""
    from tudor_dynamics.load.rows import LoadRows
    from tudor_dynamics.online.explanation import _per_moment

    arm = bundle.arm
    gains = _per_moment(bundle.beside_robot(), 'analytical')
    t, n = free.t, len(arm.active_joints)
    motion = np.zeros((len(t), 3 * n))
    motion[:, :n] = free.q

    def carry(values: dict[str, np.ndarray], stamps: dict[str, np.ndarray]) -> None:
        for output in ('effort', 'strain'):
            more = LoadRows(arm, output).point(motion) * [
                gains[output, name] for name in arm.channels[output]]
            values[output][AT:] += 0.3 * more[AT:]
    found = cause(bundle, messages(free, carry))
    assert found.cause == 'load', found
    assert abs(float(found.text.split(' kg')[0]) - 0.3) < 0.1


def test_too_little_is_said(bundle: ModelBundle, free: Recording) -> None:
    """An event around which the bag holds nothing that can be judged is unexplained."""
    event = Replay(bundle, SETTINGS, messages(free, gauge)).events[0]
    heard = messages(replace(free, stamp=free.stamp[:40], q=free.q[:40], strain=free.strain[:40],
                             effort=free.effort[:40]))
    assert explain(bundle, SETTINGS, heard, event).cause == 'unexplained'
