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

"""Alternatives of a description: gravity, directions, names, units, judged by what they leave."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from tudor_dynamics.arm.couplings import CouplingsSpec
from tudor_dynamics.doctor.case import Case, gain
from tudor_dynamics.doctor.drives import other_drives
from tudor_dynamics.doctor.explained import Explained
from tudor_dynamics.typing import FloatArray

LEAST_GAIN = 1.0
"""An alternative has to leave less by this sum of log ratios: e.g. 1/e in one channel."""
HINTED_GAIN = 0.3
"""The same where friction that drives instead of braking points at the channel."""
GRAVITY_GAIN, COUPLED_GAIN = 0.5, 1.5
"""The same for gravity, which all channels feel, and for drives coupled in one of many ways."""
SCALES = tuple(10.0 ** (sign * exponent) for sign in (1.0, -1.0)
               for exponent in (0.5, 0.75, 1.0, 1.25, 1.5, 2.75, 3.0, 3.25))
"""Factors between the units of efforts: those of gears with motors, and thousandths."""


@dataclass(frozen=True, eq=False)
class Alternative:
    """A description of the same recording with one thing changed."""

    kind: str  # key of the finding that it would be; empty for the description as it is
    channels: tuple[str, ...]  # joints or gauges concerned
    gain: float  # by how much less it leaves, see `case.gain`
    shares: FloatArray  # what it leaves of each channel
    explained: dict[str, Explained]  # its rows, by output
    outputs: dict[str, FloatArray]  # outputs that it would explain
    size: float | None = None  # scale of an effort, or ratio of a coupling
    gravity: FloatArray | None = None  # of another direction, (3,) [m/s^2]
    positions: bool = False  # whether positions alone are exchanged
    couplings: CouplingsSpec | None = None  # of other drives


def alternatives(case: Case) -> Iterator[Alternative]:
    """Go through all single changes of a description."""
    yield from gravities(case)
    yield from _directions(case)
    yield from _joint_pairs(case)
    yield from _channel_pairs(case, 'effort', 'efforts_exchanged', case.arm.active_joints)
    yield from _channel_pairs(case, 'strain', 'gauges_exchanged', case.arm.gauge_names)
    yield from _scales(case)
    for drives in other_drives(case):
        yield replace(_judged(case, drives.kind, drives.channels, drives.explained,
                              size=drives.ratio), couplings=drives.couplings)


def _judged(
    case: Case, kind: str, channels: tuple[str, ...], explained: dict[str, Explained],
    changed: dict[str, FloatArray] | None = None, *, size: float | None = None,
    gravity: FloatArray | None = None, positions: bool = False,
) -> Alternative:
    outputs = {**case.outputs, **(changed or {})}
    shares = case.shares(explained, outputs)
    return Alternative(kind, channels, gain(case.now, shares), shares, explained, outputs, size,
                       gravity, positions)


def gravities(case: Case) -> Iterator[Alternative]:
    """Try gravity along the other axes of the base."""
    own = np.array(case.arm.spec.gravity)
    size = float(np.linalg.norm(own))
    if size == 0.0:
        return
    felt = any(np.abs(bodies.of_gravity(case.motion[:1]) @ np.ones(
        10 * (bodies.model.njoints - 1))).any() for bodies in case.bodies.values())
    if not felt:
        return
    for axis in np.vstack([np.eye(3), -np.eye(3)]):
        if axis @ own < 0.99 * size:
            yield tilted(case, size * axis)


def tilted(case: Case, gravity: FloatArray) -> Alternative:
    """Try another gravity: gravity (3,) [m/s^2]."""
    kind = 'gravity_axis' if feels_gravity(case) else 'axes_parallel_to_gravity'
    return _judged(case, kind, (), case.explained(gravity=gravity), gravity=gravity)


def feels_gravity(case: Case) -> bool:
    """Say whether gravity of the description can change any output of this motion."""
    own = np.array(case.arm.spec.gravity)
    for bodies in case.bodies.values():
        parts = bodies.of_gravity(case.motion[::8])
        felt = np.tensordot(own, parts, axes=1)
        if np.abs(felt).max() > 1e-3 * np.abs(parts).max() * np.linalg.norm(own):
            return True
    return False


def refined(case: Case, start: Alternative) -> Alternative:
    """Turn gravity away from an axis as far as the outputs want it."""
    assert start.gravity is not None
    best, step = start, 0.35
    while step > 0.04:
        g = np.asarray(best.gravity)
        size = float(np.linalg.norm(g))
        across = np.linalg.svd(g[None, :])[2][1:] * size
        tries = [tilted(case, size * v / np.linalg.norm(v)) for v in
                 (g + sign * step * side for side in across for sign in (1.0, -1.0))]
        top = max(tries, key=lambda item: item.gain)
        if top.gain > best.gain:
            best = top
        else:
            step /= 2.0
    return best if best.gain > start.gain + 0.5 else start


def _turned(motion: FloatArray, joint: int) -> FloatArray:
    changed = motion.copy()
    changed[:, joint::motion.shape[1] // 3] *= -1.0
    return changed


def _column(values: FloatArray, column: int, factor: float) -> FloatArray:
    changed = values.copy()
    changed[:, column] *= factor
    return changed


def _swapped(values: FloatArray, i: int, j: int) -> FloatArray:
    changed = values.copy()
    changed[:, [i, j]] = values[:, [j, i]]
    return changed


def shared_efforts(case: Case) -> tuple[int, ...]:
    """Give the joints whose efforts share their parameters; none where each has its own."""
    if 'effort' not in case.outputs:
        return ()
    largest = max(case.bodies['effort'].groups, key=len)
    return largest if len(largest) > 1 else ()


def _directions(case: Case) -> Iterator[Alternative]:
    shared = shared_efforts(case)
    effort = case.outputs.get('effort')
    for i, name in enumerate(case.arm.active_joints):
        if len(case.names) > 1:
            explained = case.explained(_turned(case.motion, i))
            yield _judged(case, 'joint_sign', (name,), explained)
            if i in shared and effort is not None:
                turned = {'effort': _column(effort, i, -1.0)}
                yield _judged(case, 'joint_sign', (name,), explained, turned)
        if i in shared and effort is not None:
            yield _judged(case, 'effort_sign', (name,), case.usual,
                          {'effort': _column(effort, i, -1.0)})


def _joint_pairs(case: Case) -> Iterator[Alternative]:
    n = len(case.arm.active_joints)
    effort = case.outputs.get('effort')
    for i, j in combinations(range(n), 2):
        order = np.arange(n)
        order[[i, j]] = j, i
        explained = case.explained(
            case.motion[:, np.concatenate([order, n + order, 2 * n + order])])
        names = case.arm.active_joints[i], case.arm.active_joints[j]
        yield _judged(case, 'joints_exchanged', names, explained, positions=effort is not None)
        if effort is not None:
            yield _judged(case, 'joints_exchanged', names, explained,
                          {'effort': _swapped(effort, i, j)})


def _channel_pairs(
    case: Case, output: str, kind: str, names: Sequence[str],
) -> Iterator[Alternative]:
    values = case.outputs.get(output)
    if values is None:
        return
    for i, j in combinations(range(values.shape[1]), 2):
        yield _judged(case, kind, (names[i], names[j]), case.usual,
                      {output: _swapped(values, i, j)})


def _scales(case: Case) -> Iterator[Alternative]:
    effort = case.outputs.get('effort')
    for i in shared_efforts(case):
        assert effort is not None
        for scale in SCALES:
            yield _judged(case, 'effort_unit', (case.arm.active_joints[i],), case.usual,
                          {'effort': _column(effort, i, 1.0 / scale)}, size=scale)


def driven_by_friction(case: Case, explained: Explained, effort: FloatArray) -> list[int]:
    """
    Find joints whose friction would drive them: effort and motion count in other directions.

    effort (n, joints) [its unit].
    """
    n = effort.shape[1]
    found = []
    for i in np.flatnonzero(np.any(case.motion[:, n:2 * n], axis=0)).tolist():
        power, share = explained.friction(i, effort[:, i])
        if power < -0.5 and share > 1.0 + 0.1 * case.brevity ** 2:
            found.append(i)
    return found


def choose(case: Case, hinted: list[int]) -> Alternative | None:
    """
    Choose the alternative that explains a recording better, if one does.

    Returns None where the description explains it as well as any other.
    """
    best = max(alternatives(case), key=lambda item: item.gain, default=None)
    if best is None:
        return None
    names = {case.arm.active_joints[i] for i in hinted}
    least = case.surely(LEAST_GAIN)
    if best.gravity is not None:
        least = case.surely(GRAVITY_GAIN)
    elif best.kind == 'coupling_missing':
        least = case.surely(COUPLED_GAIN)
    elif best.kind == 'coupling_wrong' or names & set(best.channels):
        least = HINTED_GAIN  # the plainer description needs no more
    if best.gain < least:
        return None
    return refined(case, best) if best.gravity is not None else best


def unchanged(case: Case) -> Alternative:
    """Give the description as it is, in the form of an alternative."""
    return Alternative('', (), 0.0, case.now, case.usual, case.outputs)
