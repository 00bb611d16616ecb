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

"""Alternatives of a description that explain a recording better: gravity, signs, drives, lags."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import CouplingPair, CouplingsSpec
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.identification.doctor.case import (
    Case, Explained, gain, relative, share_of, Thinned)
from tudor_dynamics.identification.doctor.findings import Finding
from tudor_dynamics.load.rows import described_masses
from tudor_dynamics.typing import FloatArray


# -- Alternatives of coupled drives: motors that turn with another joint, described or not

AT: tuple[Literal['joints', 'motors'], ...] = ('joints', 'motors')
"""What positions and efforts of coupled drives may be those of."""


@dataclass(frozen=True, eq=False)
class Drives:
    """Drives as they might be."""

    kind: str  # key of the finding that it would be
    # Motor, and the joint that turns it; all that are coupled where nothing should be.
    channels: tuple[str, ...]
    couplings: CouplingsSpec | None  # what the description would say
    explained: dict[str, Explained]  # rows of the outputs

    @property
    def ratio(self) -> float:
        """Give the turns of the motor for one of the joint; 0 where nothing is coupled."""
        return 0.0 if self.couplings is None else self.couplings.pairs[0].ratio


def with_couplings(arm: Arm, couplings: CouplingsSpec | None) -> Arm:
    """Give an arm with other couplings."""
    return replace(arm, spec=arm.spec.model_copy(update={'couplings': couplings}))


def other_drives(case: Case) -> Iterator[Drives]:
    """Go through drives that are coupled otherwise than the description says."""
    arm, names = case.arm, case.arm.active_joints
    if 'effort' not in case.outputs or len(names) < 2:
        return
    if arm.coupling is not None:
        coupled = tuple(name for i, name in enumerate(names)
                        if arm.coupling[i].nonzero()[0].size > 1
                        or arm.coupling[:, i].nonzero()[0].size > 1)
        yield Drives('coupling_wrong', coupled, None,
                     case.explained(arm=with_couplings(arm, None)))
        return
    moves = case.moves
    for i, joint in enumerate(names):
        for j in (i - 1, i + 1):
            # a slide and a hinge have a ratio of their own, which is no guess
            if (not 0 <= j < len(names) or not moves[i]
                    or arm.is_prismatic(joint) != arm.is_prismatic(names[j])):
                continue
            for ratio in (1.0, -1.0):
                for at in AT:
                    spec = CouplingsSpec(pairs=(CouplingPair(
                        motor=names[j], joint=joint, ratio=ratio),), positions=at, efforts=at)
                    yield Drives('coupling_missing', (names[j], joint), spec,
                                 case.explained(arm=with_couplings(arm, spec)))


# -- Alternatives of a description: gravity, directions, names, units, judged by what they leave

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


# -- Alternatives that explain a recording better become findings

MEASURE = 'relative residual'
NEARLY = 2.0
"""A scale within this factor of a thousand or a thousandth is taken for it."""


def told(case: Case, chosen: Alternative) -> Finding:
    """Say what an alternative means."""
    what, remedy, size, unit = _words(case, chosen)
    return Finding(chosen.kind, what, remedy, case.recording.path, chosen.channels, None, size,
                   unit, MEASURE, relative(case.now), relative(chosen.shares))


def _words(case: Case, chosen: Alternative) -> tuple[str, str, float | None, str]:
    both = ' and '.join(chosen.channels)
    if chosen.gravity is not None:
        own = np.array(case.arm.spec.gravity)
        g = np.round(chosen.gravity, 2) + 0.0
        angle = float(np.degrees(np.arccos(np.clip(
            g @ own / (np.linalg.norm(g) * np.linalg.norm(own)), -1.0, 1.0))))
        parallel = ('all axes of the description are parallel to gravity, but the outputs follow '
                    'the pose; ' if chosen.kind == 'axes_parallel_to_gravity' else '')
        return (f'{parallel}gravity along {axis_name(g)} explains the outputs, not that of the '
                f'description, {axis_name(own)}',
                f'gravity: {[float(x) for x in g]}, or correct alpha of the first D-H row',
                angle, 'deg')
    if chosen.kind == 'effort_unit':
        assert chosen.size is not None
        size = next((exact for exact in (1e3, 1e-3)
                     if 1.0 / NEARLY < chosen.size / exact < NEARLY), chosen.size)
        unit = {joint.name: joint.effort.unit for joint in case.arm.joints}[both]
        other = {1e3: f'm{unit}', 1e-3: f'k{unit}'}.get(size, 'A' if unit != 'A' else 'N m')
        return (f'effort of {both} is {size:.3g} times what those of the other joints want: '
                f'{other}, not {unit}?', 'correct joints[].effort.unit, or scale the effort in '
                'the driver', float(size), '')
    if chosen.kind in ('effort_sign', 'joint_sign'):
        what = 'effort' if chosen.kind == 'effort_sign' else 'position'
        return (f'{what} of {both} counts in the other direction than the kinematics say',
                f'turn the sign of the {what} in the driver' + (
                    '' if what == 'effort' else ', or the axis of the joint in the kinematics'),
                -1.0, '')
    if chosen.kind == 'coupling_wrong':
        return (f'the outputs show no coupling of {both}', 'leave couplings out of the '
                'description, or correct pairs, positions and efforts there', 0.0, '')
    if chosen.couplings is not None:
        (pair,), at = chosen.couplings.pairs, chosen.couplings.efforts
        return (f'the motor of {pair.motor} turns with {pair.joint} as well, '
                + ('forwards' if pair.ratio > 0.0 else 'backwards') + f'; what is measured is '
                f'that of the {at}',
                f'couplings: {{pairs: [{{motor: {pair.motor}, joint: {pair.joint}, ratio: '
                f'{pair.ratio:g}}}], positions: {at}, efforts: {at}}}', pair.ratio, '')
    what = {'efforts_exchanged': 'efforts', 'gauges_exchanged': 'gauges',
            'joints_exchanged': 'positions' if chosen.positions else 'names'}[chosen.kind]
    return (f'{what} of {both} are exchanged', 'correct the names in the driver or in the '
            'description', None, '')


def axis_name(gravity: np.ndarray) -> str:
    """Name the direction of a gravity, in the base frame."""
    unit = np.asarray(gravity) / np.linalg.norm(gravity)
    i = int(np.argmax(np.abs(unit)))
    if abs(unit[i]) > 0.99:
        return f'{"+-"[int(unit[i] < 0)]}{"xyz"[i]}'
    return '(' + ', '.join(f'{x:.2f}' for x in unit) + ')'


def opposite(case: Case, hinted: list[int]) -> list[Finding]:
    """Report directions that no residual shows: of efforts alone, and of gravity reversed."""
    names = case.arm.active_joints
    findings = []
    for i in hinted:
        power, _ = case.usual['effort'].friction(i, case.outputs['effort'][:, i])
        findings.append(Finding(
            'effort_sign', f'effort and position of {names[i]} count in opposite directions: its '
            'friction would drive it', 'turn the sign of the effort in the driver (or that of '
            'the position)', case.recording.path, (names[i],), None, -1.0, '',
            'correlation of friction and speed', power, -power))
    if findings or 'effort' not in case.outputs:
        return findings
    known = described_masses(case.arm, case.motion, case.outputs['effort'])
    if known is not None and len(known.believed) and np.all(known.believed < 0.0):
        own = np.array(case.arm.spec.gravity)
        ratio = float(np.median(known.believed))
        findings.append(Finding(
            'gravity_axis', f'the efforts are those of gravity along {axis_name(-own)}, not '
            f'{axis_name(own)}', f'gravity: {[float(-x + 0.0) for x in own]}',
            case.recording.path, (), None, 180.0, 'deg',
            'measured effort over that of the masses', ratio, -ratio))
    return findings


# -- Velocities, efforts and strains that come late: by what lag they are explained best

LAGS = np.arange(-0.06, 0.1501, 0.01)
"""Tried [s]."""
LEAST = {'effort': 0.015, 'strain': 0.015, 'velocity': 0.03}
"""Smaller ones are the filters of drivers, which every arm has [s]."""
LEAST_LAG_GAIN = {'effort': 0.1, 'strain': 0.1, 'velocity': 0.5}
"""What is left has to become less by this sum of log ratios."""
EXPLAINED = 0.6
"""Relative residual that a lag leaves at most; where it leaves more, something else is wrong."""
KINDS = {'effort': 'effort_late', 'strain': 'strain_late', 'velocity': 'velocity_late'}
REMEDIES = {
    'effort': 'let the driver stamp efforts when they are measured, or take the efforts of the '
              'joint states',
    'strain': 'let the amplifier stamp strains when they are measured, not when they arrive',
    'velocity': 'leave them out with preprocessing.measured_velocity: false, or mend the '
                "driver's filter"}


@dataclass(frozen=True)
class Lag:
    """The lag that explains an output best."""

    seconds: float  # positive where the output comes late [s]
    gain: float  # by how much less it leaves, see `case.gain`
    # Relative residual without and with the lag.
    now: float
    otherwise: float


def best_lag(shares: Callable[[float], FloatArray]) -> Lag:
    """Search for the lag that leaves least."""
    values = [shares(float(lag)) for lag in LAGS]
    scores = np.array([float(np.sum(np.log(x))) for x in values])
    i = int(np.argmin(scores))
    seconds = float(LAGS[i])
    if 0 < i < len(LAGS) - 1:  # the vertex of the parabola through three
        before, here, after = scores[i - 1:i + 2]
        bend = before - 2.0 * here + after
        if bend > 0.0:
            seconds += float(0.5 * (before - after) / bend * (LAGS[1] - LAGS[0]))
    zero = shares(0.0)
    return Lag(seconds, gain(zero, values[i]), float(np.sqrt(zero.mean())),
               float(np.sqrt(values[i].mean())))


def output_lag(case: Case, name: str, chosen: Alternative) -> Lag:
    """Search for the lag of all efforts, or of all strains."""
    change = _change(case, name, chosen)

    def shares(lag: float) -> FloatArray:
        values = np.where(case.sound[name], case.thinned.output(name, lag), 0.0)
        return chosen.explained[name].shares(change(values))

    return best_lag(shares)


def _change(case: Case, name: str, chosen: Alternative) -> Callable[[FloatArray], FloatArray]:
    before, after = case.thinned.output(name), chosen.outputs[name]
    # scales and exchanges as a matrix, found from the samples
    sizes = np.maximum(np.sum(before ** 2, axis=0), 1e-300)
    products = before.T @ after
    fits = np.abs(products) / np.sqrt(sizes)[:, None]
    matrix = np.zeros_like(products)
    for j, i in enumerate(np.argmax(fits, axis=0)):
        matrix[i, j] = products[i, j] / sizes[i]
    return lambda values: values @ matrix


def velocity_lag(recording: Recording, thinned: Thinned) -> Finding | None:
    """
    Look for a lag of the driver's velocities behind the derivative of the positions.

    Returns None where there are none, or they come in time.
    """
    if not thinned.has('velocity'):
        return None
    n = thinned.motion.shape[1] // 3
    derivative = thinned.motion[:, n:2 * n]
    moves = np.std(derivative, axis=0) > 0.05 * float(np.std(derivative, axis=0).max())

    def shares(lag: float) -> FloatArray:
        values = thinned.output('velocity', lag)[:, moves]
        return share_of(values - derivative[:, moves], derivative[:, moves])

    return lag_told(recording, 'velocity', best_lag(shares), 1.0)


def lag_told(
    recording: Recording, name: str, lag: Lag, brevity: float,
) -> Finding | None:
    """
    Tell of a lag, where it is more than drivers usually have.

    Returns None where it comes in time.
    """
    if abs(lag.seconds) < LEAST[name] * np.sqrt(brevity) or lag.gain < LEAST_LAG_GAIN[name]:
        return None
    if lag.otherwise > EXPLAINED or not LAGS[0] < lag.seconds < LAGS[-1] - 1e-9:
        return None  # it is not the lag that the residual comes from
    kinds = {'effort': 'efforts', 'strain': 'strains', 'velocity': 'velocities'}
    way = 'late' if lag.seconds > 0.0 else 'early'
    size = round(lag.seconds, 4)
    return Finding(
        KINDS[name], f'{kinds[name]} come {abs(size) * 1e3:.0f} ms {way} against the positions',
        REMEDIES[name], recording.path, (), 0.0, size, 's', 'relative residual', lag.now,
        lag.otherwise)
