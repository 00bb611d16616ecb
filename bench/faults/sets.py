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

"""Faults that show between bags, and loads that a model does not know."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path

from faults.injected import Fault
from faults.signals import column, put
import numpy as np

import tudor_dynamics as td
from tudor_dynamics.identification.dataset import filtered
from tudor_dynamics.identification.doctor.between import examine_evaluation
from tudor_dynamics.identification.fit import FitSettings

LOADS = (('airbot_chirp', 'airbot_chirp_loaded', 'airbot_trapezoidal'),
         ('ur10e_unloaded', 'ur10e_loaded', None),
         ('arm_200g_free_1', 'arm_000g_free_1', 'arm_200g_free_2'),
         ('arm_000g_free_1', 'arm_200g_free_1', None))
"""Trained on, with another load, and with the same."""
PAYLOADS = ('arm_200g_free_1', 'arm_200g_free_2', 'arm_000g_free_1', 'arm_000g_undamped_1')


def renamed(data, name):
    """Give a bag another name."""
    return replace(data, choice=replace(data.choice, path=name),
                   recording=replace(data.recording, path=name))


def of_sets(bags, rng):
    """Go through faults that show between bags of one robot."""
    for bag in bags:
        yield bag, Fault('same_recording', ('same_recording',), bag.arm,
                         (bag.data, renamed(bag.data, f'{bag.name}_again')))
    by_robot = {}
    for bag in bags:
        if 'loaded' not in bag.name.split('_')[-1] or bag.name == 'ur10e_unloaded':
            by_robot.setdefault((bag.robot, bag.data.payload), []).append(bag)
    for group in by_robot.values():
        for one, other in list(combinations(group, 2))[:3]:
            yield from _of_pair(one, other, rng)
    known = {bag.name: bag for bag in bags}
    if all(name in known for name in PAYLOADS):
        yield from _payloads([known[name] for name in PAYLOADS])


def _of_pair(one, other, rng):
    r = other.data.recording
    arm = other.arm
    if r.effort is not None and one.data.recording.effort is not None:
        i = int(rng.integers(r.effort.shape[1]))
        for chosen, scale in ((i, 1e3), (None, 1e3), (None, 1.0 / float(rng.uniform(8.0, 12.0)))):
            # gear ratios and constants are told of in torques, currents have another size anyway
            values = (scale * r.effort if chosen is None else
                      column(r.effort, i, lambda x, s=scale: s * x))
            channels = arm.active_joints if chosen is None else (arm.active_joints[i],)
            yield other, Fault('effort_unit', ('effort_unit',), arm,
                               (one.data, put(other.data, effort=values)), channels=channels,
                               size=scale, part=1.0)
    if r.strain is not None and one.data.recording.strain is not None:
        i = int(rng.integers(r.strain.shape[1]))
        yield other, Fault('gauge_sign', ('gauge_sign',), arm,
                           (one.data, put(other.data, strain=column(r.strain, i, np.negative))),
                           channels=(arm.gauge_names[i],))


def _payloads(bags):
    for j, wrong in ((0, 0.4), (1, 0.0), (2, 0.1), (3, 0.2)):
        data = tuple(replace(bag.data, payload=wrong if k == j else bag.data.payload)
                     for k, bag in enumerate(bags))
        yield bags[j], Fault('payload_wrong', ('payload_wrong',), bags[j].arm, data,
                             bag=bags[j].name)


def of_loads(bags):
    """Judge bags with a load by models of the arm without it, and the other way round."""
    known = {bag.name: bag for bag in bags}
    for trained, loaded, same in LOADS:
        if trained not in known or loaded not in known:
            continue
        bag = known[trained]
        bundle = td.fit([str(_place(bag))], bag.arm, settings=FitSettings(kinds=('analytical',)))

        def judged(name, bundle=bundle):
            data = filtered(known[name].data, bundle.preprocessing)
            return examine_evaluation(bundle, [data]).findings

        yield (known[loaded], Fault('load_unknown', ('load_unknown',), bag.arm, ()),
               judged(loaded))
        if same is not None and same in known:
            yield known[same], None, judged(same)


def _place(bag):
    from faults.clean import ROOT, SHARED
    return next(folder / bag.name for folder in (ROOT / 'bags', SHARED / 'bags')
                if Path(folder / bag.name).exists())
