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

"""Clean bags with their arms, and what is known about them that is no fault of the doctor's."""

from __future__ import annotations

from dataclasses import dataclass, replace
import os
from pathlib import Path

import numpy as np

from tudor_dynamics.arm.description import arm_from_dict, load_arm
from tudor_dynamics.arm.schema import CouplingPair, CouplingsSpec
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.identification.dataset import BagChoice, BagData, cut

ROOT = Path(__file__).resolve().parents[2]
SHARED = Path(os.environ.get('TUDOR_SHARED_DATA', ROOT.parent / 'shared' / 'data'))
OWN = {'two_blade_train_1': 'two_blade_arm', 'two_blade_train_2': 'two_blade_arm',
       'two_blade_test': 'two_blade_arm', 'tudor_damped/stimulus_01': 'tudor',
       'tudor_undamped/stimulus_01': 'tudor'}
OTHERS = {'arm_200g_free_1': 'two_blade_arm', 'arm_200g_free_2': 'two_blade_arm',
          'arm_200g_free_3': 'two_blade_arm', 'arm_200g_free_4': 'two_blade_arm',
          'arm_000g_free_1': 'two_blade_arm', 'arm_000g_undamped_1': 'two_blade_arm',
          'emps_estimation': 'emps', 'emps_validation': 'emps', 'ur10_exciting': 'ur10',
          'airbot_chirp': 'airbot', 'airbot_chirp_loaded': 'airbot',
          'airbot_trapezoidal': 'airbot', 'tx40_exciting': 'tx40', 'quanser_hinf': 'quanser',
          'quanser_lqg': 'quanser', 'ur10e_unloaded': 'ur10e', 'ur10e_loaded': 'ur10e'}
RINGING = ('down', 'level', 'up')
"""How the flexible beam was held that the Panda of `beam_est_*` carries."""
PARTS = ((0.0, 1.0), (0.0, 0.6), (0.6, 1.0), (0.0, 0.4), (0.4, 1.0), (0.0, 1 / 3), (1 / 3, 2 / 3),
         (2 / 3, 1.0))
"""Parts in which all recordings are to have no false finding."""
DEVELOPED_ON = ('two_blade_arm', 'ur10', 'airbot', 'emps')
"""Robots on which thresholds were chosen; the others are the proof."""
STANDS_STILL = {'ur10e_unloaded', 'ur10e_loaded', 'quanser_hinf', 'quanser_lqg'}
"""Recordings that begin or end with standstill as they were published."""


@dataclass(frozen=True, eq=False)
class Clean:
    """A bag without faults, with the arm that was recorded."""

    name: str
    robot: str
    arm: object
    data: BagData

    @property
    def proof(self):
        """Say whether no threshold was chosen on this robot."""
        return self.robot not in DEVELOPED_ON


def described(robot):
    """Read the description of a robot."""
    own = ROOT / 'config' / f'{robot}.yaml'
    arm = load_arm(own if own.exists() else SHARED / 'arms' / f'{robot}.yaml')
    if robot == 'quanser':  # its stage 2 stood still, and its strain was not recorded
        gauges = tuple(gauge for gauge in arm.spec.gauges if gauge.name == 'link1')
        arm = arm.changed(gauges=gauges)
    if robot == 'tx40':  # its maker says that motor 6 turns with joint 5
        arm = arm.changed(couplings=CouplingsSpec(pairs=(CouplingPair(
            motor='joint_6', joint='joint_5', ratio=1.0),)))
    return arm


def named(recording, name, payload=None, timing=None):
    """Make a bag of a recording."""
    return BagData(BagChoice(name), replace(recording, path=name), (), payload, timing)


def clean_bags(own_only=False):
    """Read all clean bags that are there."""
    arms, found = {}, []
    folders = [(ROOT / 'bags', OWN)]
    if not own_only and SHARED.is_dir():
        folders.append((SHARED / 'bags', OTHERS))
    for folder, bags in folders:
        for name, robot in bags.items():
            if not (folder / name).exists():
                continue
            arm = arms.setdefault(robot, described(robot))
            payload = 0.2 if '200g' in name else 0.0 if '000g' in name else None
            found.append(Clean(name, robot, arm,
                               named(read_recording(folder / name, arm), name, payload)))
    return found


def more_bags():
    """Give recordings that no faults are put into: an arm with a beam that rings, and the FER."""
    folder = SHARED / 'bags'
    names = [f'beam_est_{held}_{size}cm_{k}' for held in RINGING for size in (15, 25, 35)
             for k in (1, 2, 3)]
    names += sorted(path.name for path in folder.glob('beam_T*'))
    arms = {'panda': lambda: described('panda'), 'fer': fer}
    for name, robot in [*((name, 'panda') for name in names), ('panda_fer_exciting', 'fer'),
                        ('ur10_native', 'ur10')]:
        if (folder / name).exists():
            arm = arms.get(robot, lambda: described('ur10'))()
            yield Clean(name, robot, arm, named(read_recording(folder / name, arm), name))


def fer():
    """Describe the Franka Research Emika of `panda_fer_exciting`, friction left open."""
    return arm_from_dict({
        'name': 'fer', 'kinematics': {'urdf': 'fer.urdf'},
        'joints': [{'name': f'fer_joint{i}', 'effort': {'topic': 'joint_states', 'unit': 'N m'}}
                   for i in range(1, 8)]}, base=SHARED / 'arms', source='fer.yaml')


def parts_of(bag):
    """Give a bag as it is, and cut in parts as users cut."""
    for begin, end in PARTS:
        part = cut(bag.data.recording, BagChoice(bag.name, begin, end))
        name = f'{bag.name}@{100 * begin:.0f}-{100 * end:.0f}%'
        yield replace(bag, data=named(part, name, bag.data.payload))


def pieces(bag):
    """Give a clean bag, and its halves where these are long enough."""
    yield bag
    recording = bag.data.recording
    if recording.t[-1] < 15.0:
        return
    for begin, end in ((0.0, 0.5), (0.5, 1.0)):
        part = cut(recording, BagChoice(bag.name, begin, end))
        if np.any(np.std(part.q, axis=0) > 0.01):
            yield replace(bag, data=named(part, f'{bag.name}@{100 * begin:g}-{100 * end:g}%',
                                          bag.data.payload))
