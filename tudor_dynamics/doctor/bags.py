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

"""The doctor looks at all bags of a fit, each alone and then beside the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.doctor.between import compare, Seen
from tudor_dynamics.doctor.examine import examine, Examined
from tudor_dynamics.identification.dataset import BagData
from tudor_dynamics.identification.finding import Finding

OF_ONE_BAG = ('standstill', 'outlier', 'held', 'dying', 'saturated', 'drift', 'clock_set_back')
"""What happened while one bag was recorded, and is not told of several at once."""
SAME_SHARE = 0.9
"""Part of the samples that two recordings have in common where they are one."""


def examine_bags(arm: Arm, bags: Sequence[BagData]) -> tuple[Finding, ...]:
    """Look at the bags of a fit or of an evaluation."""
    found = [examine_bag(arm, bag) for bag in bags]
    known = merged([item.findings for item in found])
    # bags that are known to be wrong are no measure for the others
    sound = [Seen(str(bag.choice), item.case, bag.payload)
             for bag, item in zip(bags, found, strict=True)
             if item.case is not None and (item.chosen is None or not item.chosen.kind)]
    told = {(item.kind, item.bag) for item in known}
    more = [item for item in compare(sound) if (item.kind, item.bag) not in told]
    return tuple(more + known + copies(bags))


def examine_bag(arm: Arm, bag: BagData) -> Examined:
    """Look at one bag, under the name by which it was chosen."""
    found = examine(arm, bag.recording, bag.timing)
    named = tuple(replace(item, bag=str(bag.choice)) if item.bag else item
                  for item in found.findings)
    return replace(found, findings=named)


def merged(findings: Sequence[Sequence[Finding]]) -> list[Finding]:
    """Tell once what several bags show alike."""
    groups: dict[tuple[str, tuple[str, ...], str], list[Finding]] = {}
    for i, of_bag in enumerate(findings):
        for item in of_bag:
            alone = f'{i}' if item.kind in OF_ONE_BAG else ''
            groups.setdefault((item.kind, item.channels, alone), []).append(item)
    told = [replace(group[0], bag=', '.join(dict.fromkeys(item.bag for item in group)))
            for group in groups.values()]
    return sorted(told, key=lambda item: -len(item.bag.split(', ')))


def copies(bags: Sequence[BagData]) -> list[Finding]:
    """Find bags that hold the same motion, in whatever storage and under whatever name."""
    findings = []
    for i, one in enumerate(bags):
        for other in bags[i + 1:]:
            share = _in_common(one, other)
            if share > SAME_SHARE:
                findings.append(Finding(
                    'same_recording', f'{one.choice} and {other.choice} hold the same samples',
                    'give another recording: a copy is no test of what was learned from it',
                    str(other.choice), (), None, share, '', 'share of samples in common', share))
    return findings


def _in_common(one: BagData, other: BagData) -> float:
    a, b = one.recording.q, other.recording.q
    moves = np.flatnonzero(np.any(np.diff(a, axis=0) != 0.0, axis=1))
    # samples of a still arm are alike in all recordings
    rows = a[moves[::max(1, len(moves) // 400)]]
    if not len(rows):
        return 0.0
    known = {row.tobytes() for row in np.ascontiguousarray(b)}
    return float(np.mean([row.tobytes() in known for row in np.ascontiguousarray(rows)]))
