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

"""Why the monitor of a simulated elastic arm alarmed, over topics."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from elastic_making import (
    blade_arm, GAINS, identified, OFFSETS, pushed, recorded, STIFFNESS, travel)
import numpy as np
import pytest
from ros_world import feed, World
from sample_arms import recording_of
from std_msgs.msg import String

from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.cli.main import build_parser
from tudor_dynamics.cli.why import causes
from tudor_dynamics.identification.dataset import BagChoice, BagData
from tudor_dynamics.identification.uses import as_plain, learn_all
from tudor_dynamics.models.bundle import ModelBundle, save_bundle
from tudor_dynamics.nodes.common.base import latched
from tudor_dynamics.nodes.monitor import MonitorNode
from tudor_dynamics.signals.preprocessing import prepare

RATE, K = 100.0, 700
"""Of samples [Hz], and which of them is the first that is touched or wrong."""
ARM, SPEC = blade_arm(), PreprocessingSpec(filter='causal', rate=None)
TRUTH = {'gear(j1)': 200.0}
"""What the arm is and its model is not."""


@pytest.fixture(scope='module')
def elastic(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write an elastic model of strain with thresholds, learned from most of a minute."""
    known = identified(ARM, {'gear(j1)': STIFFNESS['j1']})
    model = known.models['strain']['elastic']
    free = arm_in_motion(50.0, 5)
    bag = BagData(BagChoice('free', 0.0, 1.0), free, prepare(free, SPEC))
    path = tmp_path_factory.mktemp('elastic') / 'model'
    save_bundle(ModelBundle(ARM, SPEC, known.models, {
        'thresholds': as_plain(learn_all([('strain', 'elastic', [(model, bag)])], SPEC)[0])}),
        path)
    return path


def arm_in_motion(seconds: float, seed: int) -> Recording:
    """Simulate the true arm, touched by nothing."""
    q = travel(seconds, RATE, seed)
    return recording_of(q, RATE, strain=recorded(ARM, TRUTH, q, RATE, seed=seed)[0])


def touched(seconds: float = 1.0) -> Recording:
    """Simulate the true arm, its tip pushed by 6 N."""
    q = travel(11.0, RATE, 7)
    force = np.zeros((len(q), 3))
    force[K:K + round(seconds * RATE)] = [4.2, 4.2, 0.0]
    noise = np.random.default_rng(7).normal(0.0, 2.0, (len(q), 2))
    return recording_of(
        q, RATE, strain=pushed(ARM, q, RATE, force, TRUTH) * GAINS + OFFSETS + noise)


def quick() -> Recording:
    """Let the arm move four times as fast as ever before."""
    t = np.arange(1101) / RATE
    q = travel(11.0, RATE, 7)
    q[K:, 0] += 0.5 * (1.0 - np.cos(2.0 * np.pi * 1.5 * (t[K:] - t[K])))
    return recording_of(q, RATE, strain=recorded(ARM, TRUTH, q, RATE, seed=7)[0])


def free() -> Recording:
    """Change nothing."""
    return arm_in_motion(11.0, 7)


def late(k: int, messages: dict[str, Any]) -> None:
    """Let the stamps of strains leap by 0.25 s."""
    if k >= K:
        stamp = messages['link_strains'].header.stamp
        stamp.sec, stamp.nanosec = divmod(stamp.sec * 10**9 + stamp.nanosec + 250_000_000, 10**9)


def leaps(k: int, messages: dict[str, Any]) -> None:
    """Let the first gauge leap, and stay there."""
    if k >= K:
        messages['link_strains'].position[0] += 300.0


@pytest.mark.parametrize(('cause', 'make', 'change'), [
    ('touch', touched, None), ('touch', partial(touched, 0.3), None), ('clock', free, late),
    ('gauge', free, leaps),
    ('motion outside training', quick, None)])
def test_each_cause(
    world: World, elastic: Path, tmp_path: Path, cause: str, make: Callable[[], Recording],
    change: Callable[[int, dict[str, Any]], None] | None,
) -> None:
    """The same event comes again to the last bit, and its cause by name."""
    node = world.add(MonitorNode, model=str(elastic), kind='elastic', event_bags=str(tmp_path),
                     methods=['strain'])
    assert not node.fault
    records = world.listen('collision_record', String, latched())
    world.meet('joint_states', 'link_strains')

    def each(k: int, messages: dict[str, Any]) -> None:
        messages['joint_states'].name = ['j1', 'j2']
        if change is not None:
            change(k, messages)
    feed(world, make(), lambda: node.meter.count // 2, change=each, batch=1, gauges=['g1', 'g2'])
    assert world.spin(lambda: bool(records))
    world.end(node)
    (bag,) = tmp_path.iterdir()
    found = causes(build_parser('why').parse_args(['why', str(bag)]))
    assert found and all(item.same for item in found)
    assert cause == found[0].name, [(item.name, item.evidence) for item in found]
