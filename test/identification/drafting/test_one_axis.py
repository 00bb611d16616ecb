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

"""Gravity of joints that turn about the vertical, and what else a draft says."""

from __future__ import annotations

from pathlib import Path

from carrier_making import DYNAMIC, dynamic, Topic, topic_of, write as write_topics
from draft_making import JOINTS, motion, torques, urdf, write
import numpy as np
import pytest

from tudor_dynamics.bags.messages import joint_signals
from tudor_dynamics.bags.writer import write_bag
from tudor_dynamics.identification.drafting.draft import draft_of, text_of
import yaml

LYING = urdf().replace('rpy="1.5708', 'rpy="0')
ALONE = LYING.replace('type="revolute"><origin xyz="0.4', 'type="fixed"><origin xyz="0.4')
"""Only the shoulder moves, about the vertical."""
NOISE = np.random.default_rng(5).normal(0.0, 0.1, 1200)


def drafted(folder: Path, effort: np.ndarray, q: np.ndarray):
    """Draft an arm of one joint from a bag."""
    (folder / 'arm.urdf').write_text(ALONE)
    write_bag(folder / 'bag', [joint_signals('/joint_states', motion()[0], JOINTS[:1], q[:, None],
                                             effort=effort[:, None])])
    return draft_of([str(folder / 'bag')], urdf=folder / 'arm.urdf', out=folder / 'arm.yaml')


def of_pair(folder: Path):
    """Draft the arm of two joints from its bag."""
    return draft_of([str(folder / 'bag')], urdf=folder / 'pair.urdf', out=folder / 'a.yaml')


@pytest.mark.parametrize('zero', [0.0, 3.0])
def test_friction_and_a_zero_are_no_gravity(tmp_path: Path, zero: float) -> None:
    """The effort does not follow the position: the base stands upright, as it is assumed."""
    q = motion()[1][:, 0]
    dq = np.gradient(q, 0.01)
    found = drafted(tmp_path, zero + 2.0 * np.tanh(dq / 0.3) + 0.5 * dq + NOISE, q)
    assert found.content['gravity'] == [0.0, 0.0, -9.81] and 'gravity' not in found.remarks


def test_a_cable_looks_like_gravity(tmp_path: Path) -> None:
    """Nobody can say which of them it is: the direction is left open, and asked for."""
    q = 0.3 * motion()[1][:, 0]
    found = drafted(tmp_path, 4.0 * q + np.sign(np.gradient(q, 0.01)) + NOISE, q)
    assert found.content['gravity'] == '?'
    assert any('a spring or a cable explain alike' in note for note in found.notes)
    assert "\ngravity: '?'\n" in text_of(found)
    assert found.unknown == [('gravity',)]


def test_an_arm_on_a_wall(tmp_path: Path) -> None:
    """Over a wide motion the effort follows the sine of the position, which no spring does."""
    q = 1.8 * motion()[1][:, 0]
    tau = torques(q[:, None], text=ALONE, gravity=(-9.81, 0.0, 0.0))[:, 0]
    assert drafted(tmp_path, tau, q).content['gravity'] == [-9.81, 0.0, 0.0]


def test_limits_are_those_of_the_motion(tmp_path: Path) -> None:
    """Where the URDF has none: accelerations always."""
    (tmp_path / 'pair.urdf').write_text(urdf().replace('lower="-3" upper="3"', ''))
    _, q = motion()
    write(tmp_path / 'bag', effort=torques(q))
    found = of_pair(tmp_path)
    for joint, places in zip(found.content['joints'], q.T, strict=True):
        limits = joint['limits']
        assert limits['lower'] == pytest.approx(places.min(), abs=0.01)
        assert limits['upper'] == pytest.approx(places.max(), abs=0.01)
        assert 'velocity' not in limits, 'the URDF has it'
        assert 1.0 < limits['acceleration'] < 6.0
    assert 'those of the motion seen' in text_of(found)


def test_numbers_that_nothing_reads(tmp_path: Path) -> None:
    """Each field is named with its topic."""
    stamp, q = motion()
    states = topic_of(joint_signals('/joint_states', stamp, JOINTS, q, effort=torques(q)))
    warm = [dynamic(int(s), {name: {'temperature': 40.0} for name in JOINTS}) for s in stamp]
    write_topics(tmp_path / 'bag', states,
                 Topic('/dynamic_joint_states', DYNAMIC, states.log_time, warm))
    (tmp_path / 'pair.urdf').write_text(urdf())
    found = of_pair(tmp_path)
    assert 'numbers that are not used: temperature of /dynamic_joint_states' in found.notes


def test_a_link_that_rings_and_a_gauge_with_a_name(tmp_path: Path) -> None:
    """The strain rings after the joints have stopped; the gauge says by its name where it is."""
    stamp, q = motion()
    t = np.arange(len(q)) / 100.0
    stop = np.searchsorted(t, 6.0)
    q[stop:] = q[stop]
    strain = 20.0 * np.exp(-0.5 * (t - 6.0)) * np.sin(2 * np.pi * 3.0 * (t - 6.0)) * (t >= 6.0)
    write_bag(tmp_path / 'bag', [
        joint_signals('/joint_states', stamp, JOINTS, q),
        joint_signals('/link_strains', stamp, ['elbow_hub'], strain[:, None])])
    (tmp_path / 'pair.urdf').write_text(urdf())
    found = of_pair(tmp_path)
    assert found.content['gauges'][0]['joint'] == 'elbow'
    note, = (note for note in found.notes if 'rings' in note)
    assert note.startswith(
        'the link with gauge elbow_hub (joint elbow) rings at 3.00 Hz while the joints stand')
    yaml.safe_load(text_of(found))
