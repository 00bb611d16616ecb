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
from tudor_dynamics.identification.doctor import settings
from tudor_dynamics.identification.doctor.case import (
    Case, Decimated, Explained, gain, relative, share_of)
from tudor_dynamics.identification.doctor.findings import Finding, found
from tudor_dynamics.identification.doctor.settings import LAGS
from tudor_dynamics.load.rows import described_masses
from tudor_dynamics.typing import FloatArray

AT: tuple[Literal['joints', 'motors'], ...] = ('joints', 'motors')
"""What positions and efforts of coupled drives may be those of."""


@dataclass(frozen=True, eq=False)
class Alternative:
    """A description of the same recording with one thing changed."""

    kind: str  # key of the finding that it would be; empty for the description as it is
    channels: tuple[str, ...]  # joints or gauges concerned
    explained: dict[str, Explained]  # its rows, by output
    outputs: dict[str, FloatArray]  # outputs that it would explain
    shares: FloatArray  # share of each channel's variance that remains
    gain: float = 0.0  # by how much less remains, see `case.gain`
    size: float | None = None  # scale of an effort, or ratio of a coupling
    gravity: FloatArray | None = None  # of another direction, (3,) [m/s^2]
    positions: bool = False  # whether positions alone are exchanged
    couplings: CouplingsSpec | None = None  # of other drives


def unchanged(case: Case) -> Alternative:
    """Give the description as it is, in the form of an alternative."""
    return Alternative('', (), case.usual, case.outputs, case.now)


def judged(
    case: Case, kind: str, channels: tuple[str, ...],
    explained: dict[str, Explained] | None = None,
    changed: dict[str, FloatArray] | None = None, **more: object,
) -> Alternative:
    """Judge other rows, or outputs that are changed, by what remains of the outputs."""
    explained = case.usual if explained is None else explained
    outputs = {**case.outputs, **(changed or {})}
    shares = case.shares(explained, outputs)
    return Alternative(kind, channels, explained, outputs, shares, gain(case.now, shares),
                       **more)  # type: ignore[arg-type]


def with_couplings(arm: Arm, couplings: CouplingsSpec | None) -> Arm:
    """Give an arm with other couplings."""
    return replace(arm, spec=arm.spec.model_copy(update={'couplings': couplings}))


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
    return judged(case, kind, (), case.explained(gravity=gravity), gravity=gravity)


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
    """Turn gravity away from an axis as far as this reduces the residuals."""
    assert start.gravity is not None
    best, step = start, settings.FIRST_TURN
    while step > settings.LAST_TURN:
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
    return best if best.gain > start.gain + settings.REFINED_GAIN else start


def directions(case: Case) -> Iterator[Alternative]:
    """Try each joint, and each effort, counted in the other direction."""
    n = len(case.arm.active_joints)
    shared = shared_efforts(case)
    for i, name in enumerate(case.arm.active_joints):
        turned = {'effort': _column(case.outputs['effort'], i, -1.0)} if i in shared else None
        if len(case.names) > 1:
            motion = case.motion.copy()
            motion[:, i::n] *= -1.0
            explained = case.explained(motion)
            yield judged(case, 'joint_sign', (name,), explained)
            if turned:
                yield judged(case, 'joint_sign', (name,), explained, turned)
        if turned:
            yield judged(case, 'effort_sign', (name,), changed=turned)


def exchanges(case: Case) -> Iterator[Alternative]:
    """Try each two joints, efforts and gauges exchanged."""
    names, n = case.arm.active_joints, len(case.arm.active_joints)
    effort = case.outputs.get('effort')
    for i, j in combinations(range(n), 2):
        order = np.arange(n)
        order[[i, j]] = j, i
        explained = case.explained(
            case.motion[:, np.concatenate([order, n + order, 2 * n + order])])
        both = names[i], names[j]
        yield judged(case, 'joints_exchanged', both, explained, positions=effort is not None)
        if effort is not None:
            yield judged(case, 'joints_exchanged', both, explained,
                         {'effort': _swapped(effort, i, j)})
    for output, kind, names in (('effort', 'efforts_exchanged', names),
                                ('strain', 'gauges_exchanged', case.arm.gauge_names)):
        values = case.outputs.get(output)
        for i, j in combinations(range(0 if values is None else values.shape[1]), 2):
            assert values is not None
            yield judged(case, kind, (names[i], names[j]),
                         changed={output: _swapped(values, i, j)})


def units(case: Case) -> Iterator[Alternative]:
    """Try each effort in another unit."""
    for i in shared_efforts(case):
        for scale in settings.SCALES:
            yield judged(case, 'effort_unit', (case.arm.active_joints[i],), changed={
                'effort': _column(case.outputs['effort'], i, 1.0 / scale)}, size=scale)


def drives(case: Case) -> Iterator[Alternative]:
    """Try drives that are coupled otherwise than the description says."""
    arm, names = case.arm, case.arm.active_joints
    if 'effort' not in case.outputs or len(names) < 2:
        return
    if arm.coupling is not None:
        coupled = tuple(name for i, name in enumerate(names)
                        if arm.coupling[i].nonzero()[0].size > 1
                        or arm.coupling[:, i].nonzero()[0].size > 1)
        yield judged(case, 'coupling_wrong', coupled,
                     case.explained(arm=with_couplings(arm, None)), size=0.0)
        return
    for i, joint in enumerate(names):
        for j in (i - 1, i + 1):
            # a slide and a hinge have a ratio of their own, which is no guess
            if (not 0 <= j < len(names) or not case.moves[i]
                    or arm.is_prismatic(joint) != arm.is_prismatic(names[j])):
                continue
            for ratio in (1.0, -1.0):
                for at in AT:
                    spec = CouplingsSpec(pairs=(CouplingPair(
                        motor=names[j], joint=joint, ratio=ratio),), positions=at, efforts=at)
                    yield judged(case, 'coupling_missing', (names[j], joint),
                                 case.explained(arm=with_couplings(arm, spec)), size=ratio,
                                 couplings=spec)


ALTERNATIVES: tuple[Callable[[Case], Iterator[Alternative]], ...] = (
    gravities, directions, exchanges, units, drives)
"""All single changes of a description; what each means is in `WORDS`."""


def least_gain(case: Case, chosen: Alternative, hinted: Sequence[int]) -> float:
    """Say how much better an alternative has to be than the description."""
    if chosen.gravity is not None:
        return case.surely(settings.GRAVITY_GAIN)
    if chosen.kind == 'coupling_missing':
        return case.surely(settings.COUPLED_GAIN)
    # the plainer description needs no more
    if chosen.kind == 'coupling_wrong' or {case.arm.active_joints[i] for i in hinted} & {
            *chosen.channels}:
        return settings.HINTED_GAIN
    return case.surely(settings.LEAST_GAIN)


def choose(case: Case, hinted: Sequence[int]) -> Alternative | None:
    """
    Choose the alternative that explains a recording better, if one does.

    Returns None where the description explains it as well as any other.
    """
    best = max((item for candidates in ALTERNATIVES for item in candidates(case)),
               key=lambda item: item.gain, default=None)
    if best is None or best.gain < least_gain(case, best, hinted):
        return None
    return refined(case, best) if best.gravity is not None else best


def driven_by_friction(case: Case) -> list[int]:
    """Find joints whose friction would drive them: effort and motion count in other directions."""
    if 'effort' not in case.outputs:
        return []
    effort = case.outputs['effort']
    n = effort.shape[1]
    result = []
    for i in np.flatnonzero(np.any(case.motion[:, n:2 * n], axis=0)).tolist():
        power, share = case.usual['effort'].friction(i, effort[:, i])
        if power < settings.DRIVING and share > 1.0 + 0.1 * case.brevity ** 2:
            result.append(i)
    return result


Words = tuple[str, str, float | None]
"""What is wrong, what to do (empty: as the check says), and its size."""


def _gravity(case: Case, chosen: Alternative) -> Words:
    assert chosen.gravity is not None
    own = np.array(case.arm.spec.gravity)
    g = np.round(chosen.gravity, 2) + 0.0
    angle = float(np.degrees(np.arccos(np.clip(
        g @ own / (np.linalg.norm(g) * np.linalg.norm(own)), -1.0, 1.0))))
    parallel = ('all axes of the description are parallel to gravity, but the outputs follow '
                'the pose; ' if chosen.kind == 'axes_parallel_to_gravity' else '')
    return (f'{parallel}gravity along {axis_name(g)} explains the outputs, not that of the '
            f'description, {axis_name(own)}',
            f'gravity: {[float(x) for x in g]}, or correct alpha of the first D-H row', angle)


def _unit(case: Case, chosen: Alternative) -> Words:
    assert chosen.size is not None
    name, = chosen.channels
    size = next((exact for exact in (1e3, 1e-3) if 1.0 / settings.NEARLY < chosen.size / exact
                 < settings.NEARLY), chosen.size)
    unit = {joint.name: joint.effort.unit for joint in case.arm.joints}[name]
    other = {1e3: f'm{unit}', 1e-3: f'k{unit}'}.get(size, 'A' if unit != 'A' else 'N m')
    return (f'effort of {name} is {size:.3g} times what those of the other joints want: '
            f'{other}, not {unit}?',
            'correct joints[].effort.unit, or scale the effort in the driver', float(size))


def _sign(case: Case, chosen: Alternative) -> Words:
    what = 'effort' if chosen.kind == 'effort_sign' else 'position'
    return (f'{what} of {chosen.channels[0]} counts in the other direction than the kinematics '
            'say', '', -1.0)


def _uncoupled(case: Case, chosen: Alternative) -> Words:
    return f'the outputs show no coupling of {" and ".join(chosen.channels)}', '', 0.0


def _coupled(case: Case, chosen: Alternative) -> Words:
    assert chosen.couplings is not None
    (pair,), at = chosen.couplings.pairs, chosen.couplings.efforts
    way = 'forwards' if pair.ratio > 0.0 else 'backwards'
    return (f'the motor of {pair.motor} turns with {pair.joint} as well, {way}; what is measured '
            f'is that of the {at}',
            f'couplings: {{pairs: [{{motor: {pair.motor}, joint: {pair.joint}, ratio: '
            f'{pair.ratio:g}}}], positions: {at}, efforts: {at}}}', pair.ratio)


def _exchanged(case: Case, chosen: Alternative) -> Words:
    what = {'efforts_exchanged': 'efforts', 'gauges_exchanged': 'gauges',
            'joints_exchanged': 'positions' if chosen.positions else 'names'}[chosen.kind]
    return f'{what} of {" and ".join(chosen.channels)} are exchanged', '', None


WORDS: dict[str, Callable[[Case, Alternative], Words]] = {
    'gravity_axis': _gravity, 'axes_parallel_to_gravity': _gravity, 'effort_unit': _unit,
    'effort_sign': _sign, 'joint_sign': _sign, 'coupling_wrong': _uncoupled,
    'coupling_missing': _coupled, 'efforts_exchanged': _exchanged,
    'gauges_exchanged': _exchanged, 'joints_exchanged': _exchanged}


def finding_of(case: Case, chosen: Alternative) -> Finding:
    """Say what an alternative means."""
    what, remedy, size = WORDS[chosen.kind](case, chosen)
    return found(chosen.kind, what, case.recording.path, chosen.channels, size=size,
                 now=relative(case.now), otherwise=relative(chosen.shares), remedy=remedy)


def axis_name(gravity: np.ndarray) -> str:
    """Name the direction of a gravity, in the base frame."""
    unit = np.asarray(gravity) / np.linalg.norm(gravity)
    i = int(np.argmax(np.abs(unit)))
    if abs(unit[i]) > 0.99:
        return f'{"+-"[int(unit[i] < 0)]}{"xyz"[i]}'
    return '(' + ', '.join(f'{x:.2f}' for x in unit) + ')'


def opposite(case: Case, hinted: Sequence[int]) -> list[Finding]:
    """Report directions that no residual shows: of efforts alone, and of gravity reversed."""
    if 'effort' not in case.outputs:
        return []
    findings = []
    effort = case.outputs['effort']
    for i in hinted:
        name = case.arm.active_joints[i]
        power, _ = case.usual['effort'].friction(i, effort[:, i])
        findings.append(found(
            'effort_sign', f'effort and position of {name} count in opposite directions: its '
            'friction would drive it', case.recording.path, (name,), size=-1.0, now=power,
            otherwise=-power, measure='correlation of friction and speed',
            remedy='turn the sign of the effort in the driver (or that of the position)'))
    if findings:
        return findings
    known = described_masses(case.arm, case.motion, effort)
    if known is None or not len(known.believed) or not np.all(known.believed < 0.0):
        return []
    own = np.array(case.arm.spec.gravity)
    ratio = float(np.median(known.believed))
    return [found(
        'gravity_axis', f'the efforts are those of gravity along {axis_name(-own)}, not '
        f'{axis_name(own)}', case.recording.path, size=180.0, now=ratio, otherwise=-ratio,
        measure='measured effort over that of the masses',
        remedy=f'gravity: {[float(-x + 0.0) for x in own]}')]


@dataclass(frozen=True)
class Lateness:
    """What makes the lag of a signal a finding."""

    words: str  # plural of the signal
    seconds: float  # smaller lags are the filters of drivers, which every arm has [s]
    gain: float  # sum of log ratios by which the residuals have to be smaller


LATE = {'effort': Lateness('efforts', 0.015, 0.1), 'strain': Lateness('strains', 0.015, 0.1),
        'velocity': Lateness('velocities', 0.03, 0.5)}
"""Source: bench/doctor.py, as all settings of the doctor."""


@dataclass(frozen=True)
class Lag:
    """The lag that explains an output best."""

    seconds: float  # positive where the output comes late [s]
    gain: float  # by how much less remains, see `case.gain`
    # Relative residual without and with the lag.
    now: float
    otherwise: float


def best_lag(shares: Callable[[float], FloatArray]) -> Lag:
    """Search for the lag with the least residuals."""
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
    return Lag(seconds, gain(zero, values[i]), relative(zero), relative(values[i]))


def lags(case: Case, chosen: Alternative) -> list[tuple[Finding, float]]:
    """Look for outputs that come late, with what their lags gain."""
    result = []
    for name in chosen.outputs:
        matrix = _change(case, name, chosen)

        def shares(lag: float, name: str = name, matrix: FloatArray = matrix) -> FloatArray:
            values = np.where(case.sound[name], case.decimated.output(name, lag), 0.0)
            return chosen.explained[name].shares(values @ matrix)

        lag = best_lag(shares)
        finding = _late(case.recording, name, lag, case.brevity)
        if finding is not None:
            result.append((finding, lag.gain))
    return result


def _change(case: Case, name: str, chosen: Alternative) -> FloatArray:
    """Find the scales and exchanges of an alternative from the samples, as a matrix."""
    before, after = case.decimated.output(name), chosen.outputs[name]
    sizes = np.maximum(np.sum(before ** 2, axis=0), 1e-300)
    products = before.T @ after
    fits = np.abs(products) / np.sqrt(sizes)[:, None]
    matrix = np.zeros_like(products)
    for j, i in enumerate(np.argmax(fits, axis=0)):
        matrix[i, j] = products[i, j] / sizes[i]
    return matrix


def velocity_lag(recording: Recording, decimated: Decimated) -> list[Finding]:
    """Look for velocities of the driver that come later than the derivative of the positions."""
    if not decimated.has('velocity'):
        return []
    n = decimated.motion.shape[1] // 3
    derivative = decimated.motion[:, n:2 * n]
    moves = np.std(derivative, axis=0) > 0.05 * float(np.std(derivative, axis=0).max())

    def shares(lag: float) -> FloatArray:
        values = decimated.output('velocity', lag)[:, moves]
        return share_of(values - derivative[:, moves], derivative[:, moves])

    finding = _late(recording, 'velocity', best_lag(shares), 1.0)
    return [] if finding is None else [finding]


def _late(recording: Recording, name: str, lag: Lag, brevity: float) -> Finding | None:
    """Report a lag where it is more than drivers usually have."""
    limits = LATE[name]
    if abs(lag.seconds) < limits.seconds * np.sqrt(brevity) or lag.gain < limits.gain:
        return None
    if lag.otherwise > settings.LAG_SHARE or not LAGS[0] < lag.seconds < LAGS[-1] - 1e-9:
        return None  # it is not the lag that the residual comes from
    size = round(lag.seconds, 4)
    way = 'late' if lag.seconds > 0.0 else 'early'
    return found(
        f'{name}_late', f'{limits.words} come {abs(size) * 1e3:.0f} ms {way} against the '
        'positions', recording.path, time=0.0, size=size, now=lag.now, otherwise=lag.otherwise)
