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

"""Alternatives of a description that explain a recording better: gravity, signs, drives."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import CouplingPair, CouplingsSpec
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.identification import settings
from tudor_dynamics.identification.doctor.case import Case, Delay, Explained, gain, unit_scale
from tudor_dynamics.identification.doctor.findings import Finding, found, UNSEEN
from tudor_dynamics.load.rows import described_masses
from tudor_dynamics.typing import FloatArray

AT: tuple[Literal['joints', 'motors'], ...] = ('joints', 'motors')
"""What positions and efforts of coupled drives may be those of."""


@dataclass(frozen=True, eq=False)
class Alternative:
    """A description of the same recording with one thing changed, or with nothing changed."""

    case: Case
    kind: str  # key of the finding that it would be; empty for the description as it is
    channels: tuple[str, ...]  # joints or gauges concerned
    explained: dict[str, Explained]  # its rows, by output
    what: str = ''  # the change in a sentence
    remedy: str = ''  # empty for that of the check
    size: float | None = None  # scale of an effort, ratio of a coupling, or angle of gravity
    # Output to a matrix after its channels, (channels, channels); none for the output as it is.
    mixed: Mapping[str, FloatArray] = field(default_factory=dict)
    mended: Callable[[Recording], Recording] = lambda it: it  # its positions and stamps
    late: Mapping[str, Delay] = field(default_factory=dict)  # outputs that come late
    arm: Arm | None = None  # other description
    unseen: tuple[float, float] = (0.0, 0.0)  # errors on parts left out, without and with it

    def output(self, name: str, late: Delay | None = None) -> FloatArray:
        """Give an output that it would explain, as if it had not come late."""
        late = self.late.get(name) if late is None else late
        values = self.case.outputs[name] if late is None else self.case.output(name, late)
        return values @ self.mixed[name] if name in self.mixed else values

    def shares_of(self, name: str, late: Delay | None = None) -> FloatArray:
        """Give the share that remains of the variance of each channel of an output."""
        return self.explained[name].shares(self.output(name, late))

    @cached_property
    def shares(self) -> FloatArray:
        """Give the share that remains of the variance of each channel of all outputs."""
        return np.concatenate([self.shares_of(name) for name in self.explained])

    @cached_property
    def gain(self) -> float:
        """Say by how much less remains, see `case.gain`."""
        return gain(self.case.now, self.shares)

    def finding(self) -> Finding:
        """Say what it means."""
        return found(self.kind, self.what, self.case.recording.path, self.channels,
                     size=self.size, now=self.unseen[0], otherwise=self.unseen[1],
                     remedy=self.remedy, measure=UNSEEN)


def _scaled(n: int, i: int, factor: float) -> FloatArray:
    return np.diag(np.where(np.arange(n) == i, factor, 1.0))


def _swapped(n: int, i: int, j: int) -> FloatArray:
    order = np.arange(n)
    order[[i, j]] = j, i
    return np.eye(n)[order]


def _turned(recording: Recording, mixed: FloatArray) -> Recording:
    dq = recording.dq
    return replace(recording, q=recording.q @ mixed, dq=None if dq is None else dq @ mixed)


def _moved(
    case: Case, kind: str, channels: tuple[str, ...], mixed: FloatArray, what: str = '',
    size: float | None = None,
) -> Alternative:
    """Try other positions: mixed (joints, joints)."""
    return Alternative(case, kind, channels, case.explained(case.motion @ np.kron(
        np.eye(3), mixed)), what, size=size, mended=partial(_turned, mixed=mixed))


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
    for axis in np.vstack([np.eye(3), -np.eye(3)]):
        if axis @ own < 0.99 * size:
            yield tilted(case, size * axis)


def tilted(case: Case, gravity: FloatArray) -> Alternative:
    """Try another gravity: gravity (3,) [m/s^2]."""
    own = np.array(case.arm.spec.gravity)
    g = np.round(gravity, 2) + 0.0
    angle = float(np.degrees(np.arccos(np.clip(
        g @ own / (np.linalg.norm(g) * np.linalg.norm(own)), -1.0, 1.0))))
    arm = case.arm.under(gravity)
    return Alternative(
        case, 'gravity_axis', (), case.explained(arm=arm),
        f'the data fit gravity along {axis_name(g)} of the base frame, but the arm description '
        f'says {axis_name(own)}', f'set gravity: {[float(x) for x in g]} in the arm description, '
        'or correct the first rotation of the URDF or D-H rows', angle, arm=arm)


def refined(start: Alternative) -> Alternative:
    """Turn gravity away from an axis as far as this reduces the residuals."""
    best, step = start, settings.FIRST_TURN
    while step > settings.LAST_TURN:
        g = np.array((best.arm or start.case.arm).spec.gravity)
        size = float(np.linalg.norm(g))
        across = np.linalg.svd(g[None, :])[2][1:] * size
        top = max((tilted(start.case, size * v / np.linalg.norm(v)) for v in
                   (g + sign * step * side for side in across for sign in (1.0, -1.0))),
                  key=lambda item: item.gain)
        if top.gain > best.gain:
            best = top
        else:
            step /= 2.0
    return best if best.gain > start.gain + settings.REFINED_GAIN else start


def directions(case: Case) -> Iterator[Alternative]:
    """Try each joint, and each effort, counted in the other direction."""
    names, shared = case.arm.active_joints, shared_efforts(case)
    for i, name in enumerate(names):
        if not case.moves[i]:
            continue
        flip = _scaled(len(names), i, -1.0)
        turned = [{'effort': flip}] if i in shared else []
        if len(case.now) > 1:
            moved = _moved(case, 'joint_sign', (name,), flip, f'position of {name!r} '
                           'increases against its axis in the URDF or D-H rows', -1.0)
            for mixed in ({}, *turned):
                yield replace(moved, mixed=mixed)
        for mixed in turned:
            yield Alternative(
                case, 'effort_sign', (name,), case.usual, f'effort of {name!r} has the opposite '
                'sign of what motion and gravity need', '', -1.0, mixed)


def scales(case: Case) -> Iterator[Alternative]:
    """Try each joint in another scale: counts, gears."""
    names = case.arm.active_joints
    if len(case.now) < 2:
        return
    for i, name in enumerate(names):
        for scale in settings.JOINT_SCALES if case.moves[i] else ():
            yield _moved(case, 'joint_scale', (name,), _scaled(len(names), i, scale),
                         f'joint {name!r} moves {scale:.3g} times as far as its positions say',
                         scale)


def clocks(case: Case) -> Iterator[Alternative]:
    """Try stamps that count samples of another rate: bodies know the time by their weight."""
    for pace in settings.PACES:
        one, more = (Alternative(
            case, 'time_scale', (), case.explained(case.motion * np.repeat(
                [1.0, fast, fast ** 2], len(case.arm.joints))),
            f'the motion is about {pace:g} times as fast as its time stamps say', '', 1.0 / pace,
            mended=partial(_paced, pace=pace)) for fast in (pace, pace ** 2))
        if one.gain > more.gain:  # else something other than time is wrong
            yield one


def _paced(recording: Recording, pace: float) -> Recording:
    first = recording.stamp[0]
    return replace(recording, dt=recording.dt / pace, stamp=first + (
        (recording.stamp - first) / pace).astype(np.int64))


def bends(case: Case) -> Iterator[Alternative]:
    """Try positions that creep, or err with their angle: by what this changes of the outputs."""
    t, n = case.decimated.t, len(case.arm.joints)
    best: dict[str, tuple[float, int, float, complex]] = {}
    for i in np.flatnonzero(case.moves).tolist():
        name, turns = case.arm.active_joints[i], settings.TURNS
        for turn, (left, size) in zip(turns, [] if case.arm.is_prismatic(name) else _sizes(
                case, case.usual, case.motion, i, turns), strict=False):
            kind = 'position_ripple' if turn else 'position_drift'
            low, high = settings.BENDS[kind]
            if low < abs(size) < min(high, settings.BACKWARDS / (turn + 1e-9)) and (
                    kind not in best or left < best[kind][0]):
                best[kind] = left, i, turn, size
    for kind, (_, i, turn, size) in best.items():
        for last in (False, False, True):
            moved = case.motion.copy()
            moved[:, i::n] = _straight(turn, size, t, moved[:, i::n].T).T
            explained = case.explained(moved)
            size += 0.0 if last else _sizes(case, explained, moved, i, (turn,))[0][1]
        name = case.arm.active_joints[i]
        how = f'drifts by {-size.real:.2g} rad during the bag' if not turn else (
            f'has an error of up to {abs(size):.2g} rad that repeats {turn:g} times a turn')
        yield Alternative(case, kind, (name,), explained, f'position of {name!r} {how}', '',
                          abs(size), mended=partial(_straightened, joint=i, turn=turn, size=size))


def _sizes(case: Case, explained: Mapping[str, Explained], motion: FloatArray, joint: int,
           turns: Sequence[float]) -> list[tuple[float, complex]]:
    """Give of each error of a position what it leaves of the outputs, and its size with phase."""
    step, places = settings.BEND_STEP, np.eye(motion.shape[1])[joint::len(case.arm.joints)]
    errors = np.array([_error(turn, case.decimated.t, places @ motion.T) for turn in turns])
    felt = []
    for output, usual in explained.items():
        y, sound = case.outputs[output], case.sound[output]
        known = usual.parameters(y)
        rows = np.array([case.bodies[output].rows(motion + step * place) for place in places])
        for c in np.flatnonzero(sound).tolist():
            change = np.sum(errors * ((rows[:, :, c] - usual.bodies[c]) @ known[c] / step), axis=1)
            free = usual.rest(c, np.vstack([y[:, c], change.real, -change.imag]).T)
            felt.append(free / max(float(np.std(free[:, 0])), 1e-300, settings.LEAST_RESIDUAL
                                   * float(np.std(y[:, c]))))
    if not felt:  # no channel is sound
        return []
    left, *columns = np.vstack(felt).T
    found = []
    for both in (np.array(columns[k::len(turns)]).T for k in range(len(turns))):
        size = np.linalg.lstsq(both, left, rcond=1e-9)[0]
        found.append((float(np.linalg.norm(left - both @ size)), complex(*size)))
    return found


def _error(turn: float, t: FloatArray, motion: FloatArray) -> NDArray[np.complex128]:
    """Give a unit error of a position and its derivatives (3, n), by these (3, n)."""
    q, dq, ddq = motion
    if not turn:
        return np.array([t, np.ones_like(t), np.zeros_like(t)], dtype=complex) / t[-1]
    return np.exp(1j * turn * q) * np.array([
        np.ones_like(q), 1j * turn * dq, 1j * turn * ddq - (turn * dq) ** 2])


def _straight(turn: float, size: complex, t: FloatArray, motion: FloatArray) -> FloatArray:
    """Free a position and its derivatives (3, n) of an error, which the right angle makes."""
    right = motion
    for _ in range(settings.STRAIGHTENED if turn else 1):
        right = motion + (size * _error(turn, t, right)).real
    return right


def _straightened(recording: Recording, joint: int, turn: float, size: complex) -> Recording:
    q = recording.q.copy()
    own = np.outer([1.0, 0.0, 0.0], q[:, joint])
    q[:, joint] = _straight(turn, size, recording.t, own)[0]
    return replace(recording, q=q)


def exchanges(case: Case) -> Iterator[Alternative]:
    """Try each two joints, efforts and gauges exchanged."""
    names, n = case.arm.active_joints, len(case.arm.active_joints)
    for i, j in combinations(range(n), 2):
        if not case.moves[[i, j]].any():
            continue
        swap = _swapped(n, i, j)
        moved = _moved(case, 'joints_exchanged', (names[i], names[j]), swap)
        for what, mixed in ([('positions', {}), ('names', {'effort': swap})]
                            if 'effort' in case.outputs else [('names', {})]):
            yield replace(moved, mixed=mixed,
                          what=f'{what} of joints {names[i]!r} and {names[j]!r} are exchanged')
    for output, what in (('effort', 'efforts'), ('strain', 'gauges')):
        if output in case.outputs:
            names = case.bodies[output].channels
            for i, j in combinations(range(len(names)), 2):
                yield Alternative(case, f'{what}_exchanged', (names[i], names[j]), case.usual,
                                  f'{output}s of {names[i]!r} and {names[j]!r} are exchanged',
                                  mixed={output: _swapped(len(names), i, j)})


def units(case: Case) -> Iterator[Alternative]:
    """Try each effort in another unit."""
    for i in shared_efforts(case):
        if not case.moves[i]:
            continue
        joint = case.arm.joints[i]
        for scale in settings.SCALES:
            size, unit = unit_scale(scale), joint.effort.unit
            other = {1e3: f'm{unit}', 1e-3: f'k{unit}'}.get(size, 'A' if unit != 'A' else 'N m')
            yield Alternative(
                case, 'effort_unit', (joint.name,), case.usual,
                f'effort of {joint.name!r} is {size:.3g} times as large as the other efforts '
                f'suggest, so its unit seems to be {other}, not {unit}', '', size,
                {'effort': _scaled(len(case.arm.joints), i, 1.0 / scale)})


def drives(case: Case) -> Iterator[Alternative]:
    """Try drives that are coupled otherwise than the description says."""
    arm, names = case.arm, case.arm.active_joints
    if 'effort' not in case.outputs or len(names) < 2:
        return
    if arm.coupling is not None:
        coupled = tuple(name for i, name in enumerate(names)
                        if np.count_nonzero(arm.coupling[i]) > 1
                        or np.count_nonzero(arm.coupling[:, i]) > 1)
        alone = arm.changed(couplings=None)
        yield Alternative(case, 'coupling_wrong', coupled, case.explained(arm=alone),
                          f'the data show no coupling of {" and ".join(map(repr, coupled))}', '',
                          0.0, arm=alone)
        return
    for i, joint in enumerate(names):
        for j in (i - 1, i + 1):
            # a slide and a hinge have a ratio of their own, which is no guess
            if (0 <= j < len(names) and case.moves[[i, j]].all()
                    and arm.is_prismatic(joint) == arm.is_prismatic(names[j])):
                for ratio in (1.0, -1.0):
                    for at in AT:
                        yield _coupled(case, names[j], joint, ratio, at)


def _coupled(
    case: Case, motor: str, joint: str, ratio: float, at: Literal['joints', 'motors'],
) -> Alternative:
    couplings = CouplingsSpec(pairs=(CouplingPair(motor=motor, joint=joint, ratio=ratio),),
                              positions=at, efforts=at)
    arm = case.arm.changed(couplings=couplings)
    return Alternative(
        case, 'coupling_missing', (motor, joint), case.explained(arm=arm),
        f'{joint!r} also turns the motor of {motor!r} {"forwards" if ratio > 0 else "backwards"}; '
        f'the bag has positions and efforts of the {at}', 'add to the arm description: couplings: '
        f'{{pairs: [{{motor: {motor}, joint: {joint}, ratio: {ratio:g}}}], '
        f'positions: {at}, efforts: {at}}}', ratio, arm=arm)


def choose(case: Case) -> list[Alternative]:
    """Choose what explains a recording better than the description, the best of each kind."""
    best: dict[str, Alternative] = {}
    for candidates in (gravities, directions, scales, clocks, bends, exchanges, units, drives):
        for item in candidates(case):
            if item.kind not in best or item.gain > best[item.kind].gain:
                best[item.kind] = item
    return [refined(item) if item.kind == 'gravity_axis' else item
            for item in sorted(best.values(), key=lambda item: -item.gain)[:settings.LIKELIEST]
            if item.gain >= case.brevity * (
                settings.BEND_GAIN if item.kind in settings.BENDS else settings.LEAST_GAIN)]


def driven_by_friction(case: Case) -> dict[int, float]:
    """Find joints, with the correlation, whose friction would drive them: a direction is wrong."""
    if 'effort' not in case.outputs:
        return {}
    hinted, shared = {}, shared_efforts(case)
    for i in np.flatnonzero(case.moves).tolist():
        if i in shared:
            continue  # the bodies show its sign
        power, share = case.usual['effort'].friction(i, case.outputs['effort'][:, i])
        if power < settings.DRIVING and (share > 1.0 + settings.DRIVING_SHARE * case.brevity ** 2):
            hinted[i] = power
    return hinted


def axis_name(gravity: np.ndarray) -> str:
    """Name the direction of a gravity, in the base frame."""
    unit = np.asarray(gravity) / np.linalg.norm(gravity)
    i = int(np.argmax(np.abs(unit)))
    if abs(unit[i]) > 0.99:
        return f'{"+-"[int(unit[i] < 0)]}{"xyz"[i]}'
    return '(' + ', '.join(f'{x:.2f}' for x in unit) + ')'


def opposite(case: Case, hinted: Mapping[int, float]) -> list[Finding]:
    """Report directions that no residual shows: of efforts alone, and of gravity reversed."""
    if hinted:
        names = case.arm.active_joints
        return [found(
            'effort_sign', f'effort and position of {names[i]!r} have opposite signs, as '
            'friction would drive the joint, not brake it', case.recording.path, (names[i],),
            size=-1.0, now=power, otherwise=-power, measure='correlation of friction and speed',
            remedy='change the sign of the effort in the driver, or that of the position')
            for i, power in hinted.items()]
    if 'effort' not in case.outputs:
        return []
    if turned := _gauges_turned(case):
        return turned
    known = described_masses(case.arm, case.motion, case.outputs['effort'])
    if known is None or not len(known.believed) or not np.all(known.believed < 0.0):
        return []
    own = np.array(case.arm.spec.gravity)
    ratio = float(np.median(known.believed))
    return [found(
        'gravity_axis', f'the data fit gravity along {axis_name(-own)} of the base frame, but the '
        f'arm description says {axis_name(own)}', case.recording.path, size=180.0, now=ratio,
        otherwise=-ratio, measure='ratio of measured efforts to those of the masses in the URDF',
        remedy=f'set gravity: {[float(-x + 0.0) for x in own]} in the arm description')]


def _gauges_turned(case: Case) -> list[Finding]:
    """Report gauges that count against the effort of their joint: a load makes both positive."""
    findings, of = [], case.usual['effort'].freed
    for g, gauge in enumerate(case.arm.gauges if 'strain' in case.outputs else ()):
        if gauge.axis is None and gauge.joint in case.arm.active_joints:
            i = case.arm.active_joints.index(gauge.joint)
            x, y = of(i, case.outputs['strain'][:, g]), of(i, case.outputs['effort'][:, i])
            together = float(x @ y) / max(float(np.linalg.norm(x) * np.linalg.norm(y)), 1e-300)
            if together < -1.0 + settings.AGAINST / case.brevity:
                findings.append(found(
                    'gauge_sign', f'gauge {gauge.name!r} and effort of {gauge.joint!r} have '
                    'opposite signs', case.recording.path, (gauge.name,), size=-1.0,
                    now=together, otherwise=-together, measure='correlation of gauge and effort',
                    remedy='change the sign of the gauge in its driver, or that of the effort'))
    return findings
