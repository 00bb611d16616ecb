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

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.arm.schema import CouplingPair, CouplingsSpec
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.identification.dataset import BagChoice, BagData, cut
from tudor_dynamics.identification.doctor.alternatives import with_couplings

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
        arm = replace(arm, spec=arm.spec.model_copy(update={'gauges': gauges}))
    if robot == 'tx40':  # its maker says that motor 6 turns with joint 5
        arm = with_couplings(arm, CouplingsSpec(pairs=(CouplingPair(
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
