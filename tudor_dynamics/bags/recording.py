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

"""A recording as aligned arrays, what of a bag goes into it, and whether values are plausible."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import LimitSpec, SourceSpec
from tudor_dynamics.bags.messages import (
    DATA, DYNAMIC_JOINT_STATE, FLOAT64_MULTI_ARRAY, JOINT_STATE)
from tudor_dynamics.bags.settings import (
    FAST, FASTEST, GAP_FLOOR, GAP_PERIODS, MANY_TURNS, MAX_SPREAD, MIN_DISPLACEMENT, MIN_WINDOWS,
    STILL, UNIT_TOLERANCE, UNLIMITED, WINDOW)
from tudor_dynamics.bags.storage import Notes
from tudor_dynamics.errors import BagError
from tudor_dynamics.typing import finite_array, FloatArray, Shown


def gap_limit(stamp: NDArray[np.int64]) -> float:
    """Give the longest time between samples that is not a gap [s] for stamps [ns]."""
    if len(stamp) < 2:
        return GAP_FLOOR
    return max(GAP_PERIODS * float(np.median(np.diff(stamp))) * 1e-9, GAP_FLOOR)


def split_at_gaps(stamp: NDArray[np.int64]) -> tuple[slice, ...]:
    """Split a record at its gaps: stamp (n,) [ns]."""
    cuts = np.flatnonzero(np.diff(stamp) * 1e-9 > gap_limit(stamp)) + 1
    ends = [0, *cuts.tolist(), len(stamp)]
    return tuple(slice(a, b) for a, b in zip(ends, ends[1:]) if b > a)


SIGNALS = ('q', 'dq', 'effort', 'strain')


@dataclass(frozen=True)
class SetBack:
    """A clock that was set back while it stamped messages."""

    time: float  # where, since the first stamp [s]
    seconds: float  # by how much [s]
    lost: int  # messages with stamps that had been there before


@dataclass(frozen=True)
class Oddities:
    """What the arrays of a recording do not show of its bag."""

    set_backs: tuple[SetBack, ...] = ()  # of the clock of the joint states, which split it
    # How far each other name of the joint states moves, its outermost percents left out
    # [rad or m].
    others: dict[str, float] = field(default_factory=dict)
    zero_velocities: tuple[str, ...] = ()  # joints that move without any: none are used


@dataclass(frozen=True, eq=False)
class Recording(Shown):
    """
    Signals of one bag on the stamps of the joint states.

    Attributes
    ----------
    path : str
        Bag that was read.
    stamp : ndarray of int64, shape (n_samples,)
        Header stamps, strictly increasing [ns].
    q : ndarray of shape (n_samples, n_joints)
        Positions of the arm's active joints, in their order [rad or m].
    dq : ndarray of shape (n_samples, n_joints) or None
        Velocities, where the driver has them [rad/s or m/s].
    effort : ndarray of shape (n_samples, n_joints) or None
        Actuator efforts in the units of the arm description.
    strain : ndarray of shape (n_samples, n_gauges) or None
        Gauge readings in the units of the arm description.
    segments : tuple of slice
        Stretches without a gap; nothing may be filtered or differentiated across their ends.
    dt : float
        Median sample time [s].
    dropped : dict of str to int
        Messages left out, by cause.
    warnings : tuple of str
        What is wrong with the bag, one sentence each.
    checksum : str
        SHA-256 over the storage files.
    payload : float or None
        Mass at the tip, where the metadata of the bag say [kg].
    earlier : (ndarray of int64, ndarray) or None
        Stamps [ns] and positions of the gapless motion just before, where this is a part of a
        bag.
    oddities : Oddities
        What the arrays do not show of the bag.
    push : ndarray of shape (n_samples,) or None
        Size of the force that was applied on purpose, by the topic ``applied_wrench`` [N].

    """

    path: str
    stamp: NDArray[np.int64]
    q: FloatArray
    dq: FloatArray | None
    effort: FloatArray | None
    strain: FloatArray | None
    segments: tuple[slice, ...]
    dt: float
    dropped: dict[str, int] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    checksum: str = ''
    payload: float | None = None
    earlier: tuple[NDArray[np.int64], FloatArray] | None = None
    oddities: Oddities = Oddities()
    push: FloatArray | None = None

    def __repr__(self) -> str:
        """Write length, rate, signals with their ranges, and what is wrong with the bag."""
        stretches = f', {len(self.segments)} gapless stretches' if len(self.segments) > 1 else ''
        lines = [f'Recording {self.path}: {self.t[-1]:.4g} s, {len(self.stamp)} samples at '
                 f'{1.0 / self.dt:.4g} Hz{stretches}']
        lines += [f'  {name}: {values.shape[1]} channels from {np.nanmin(values):.4g} to '
                  f'{np.nanmax(values):.4g}' for name, values in self.signals.items()]
        if self.payload is not None:
            lines.append(f'  payload: {self.payload:g} kg')
        return '\n'.join(lines + [f'  warning: {warning}' for warning in self.warnings])

    @classmethod
    def from_arrays(cls, t: ArrayLike, **signals: ArrayLike) -> Recording:
        """Make one of times [s] and of ``q``, ``dq``, ``effort``, ``strain``, split at gaps."""
        if 'q' not in signals or not {*signals} <= {*SIGNALS}:
            raise BagError(f'found {", ".join(signals) or "no signal"}; expected q, and perhaps '
                           'others of dq, effort, strain')
        stamp = np.round(finite_array(t, 't', None) * 1e9).astype(np.int64)
        if len(stamp) < 2 or np.diff(stamp).min() <= 0:
            raise BagError('t is not two or more times that increase; give seconds, sorted')
        found: dict[str, Any] = dict.fromkeys(SIGNALS) | {
            name: finite_array(values, name, len(stamp), None) for name, values in signals.items()}
        return cls('arrays', stamp, **found, segments=split_at_gaps(stamp),
                   dt=float(np.median(np.diff(stamp))) * 1e-9)

    @property
    def t(self) -> FloatArray:
        """Time since the first stamp [s]."""
        return np.asarray((self.stamp - self.stamp[0]) * 1e-9)

    @property
    def signals(self) -> dict[str, FloatArray]:
        """All signals that were recorded, by name."""
        return {name: values for name in SIGNALS if (values := getattr(self, name)) is not None}

    def to_xarray(self, arm: Arm) -> Any:
        """Give an ``xarray.Dataset``: signals over ``time`` [s] and ``joint`` or ``gauge``."""
        from xarray import Dataset  # optional

        return Dataset(
            {name: (('time', 'gauge' if name == 'strain' else 'joint'), values)
             for name, values in self.signals.items()}
            | ({} if self.push is None else {'push': ('time', self.push)}),
            {'time': self.t, 'joint': list(arm.active_joints), 'gauge': list(arm.gauge_names)},
            {'path': self.path})

    def to_dataframe(self, arm: Arm) -> Any:
        """Give a ``pandas.DataFrame`` over ``time`` [s], columns such as ``('q', 'joint2')``."""
        from pandas import concat  # optional

        return concat({name: values.to_pandas() for name, values in self.to_xarray(arm).items()},
                      axis=1)


@dataclass(frozen=True)
class ChannelSource:
    """Where the values of one joint or gauge stand."""

    topic: str  # as described (relative or absolute)
    name: str  # name in the messages; in an array the place, from 0
    field: str  # field of the messages: `effort`, `position`, `data`, or an interface
    msgtype: str = JOINT_STATE  # type that the messages must have


def channel_of(source: SourceSpec, name: str, field: str) -> ChannelSource:
    """Give the channel that a description names: as a JointState by default."""
    if source.index is not None:
        return ChannelSource(source.topic, str(source.index), DATA, FLOAT64_MULTI_ARRAY)
    if source.interface is not None:
        return ChannelSource(source.topic, name, source.interface, DYNAMIC_JOINT_STATE)
    return ChannelSource(source.topic, name, field)


@dataclass(frozen=True)
class Sources:
    """What a recording is made of."""

    joint_topic: str  # topic of the joint states, as described (relative or absolute)
    joints: tuple[str, ...]  # names of the joints, in the order of the columns
    prismatic: tuple[bool, ...]  # kind of each joint
    reach: tuple[float | None, ...]  # largest plausible `|q|` [rad or m]; None where any is
    efforts: tuple[ChannelSource, ...]  # where each joint's effort stands
    gauges: tuple[str, ...] = ()  # names of the gauges
    strains: tuple[ChannelSource, ...] = ()  # where each gauge's reading stands

    @property
    def topics(self) -> dict[str, str]:
        """All topics as described, with the types of their messages."""
        return {self.joint_topic: JOINT_STATE, **{
            channel.topic: channel.msgtype for channel in (*self.efforts, *self.strains)}}


def plan_from_arm(arm: Arm) -> Sources:
    """Make the plan of an arm."""
    model = arm.full_model
    prismatic, reach = [], []
    for joint in arm.joints:
        inner = model.joints[model.getJointId(joint.name)]
        slides, given = arm.is_prismatic(joint.name), joint.limits or LimitSpec()
        lower = model.lowerPositionLimit[inner.idx_q] if given.lower is None else given.lower
        upper = model.upperPositionLimit[inner.idx_q] if given.upper is None else given.upper
        bound: float | None = None
        if max(-lower, upper) < UNLIMITED:
            # Twice the limits: a soft limit overrun or a zero set elsewhere is no matter of units.
            bound = 2 * float(max(abs(lower), abs(upper), upper - lower))
        elif not slides and joint.type != 'continuous' and arm.spec.kinematics.urdf is None:
            bound = MANY_TURNS
        prismatic.append(slides)
        reach.append(bound)
    return Sources(
        arm.spec.joint_topic, arm.active_joints, tuple(prismatic), tuple(reach),
        tuple(channel_of(joint.effort, joint.name, 'effort') for joint in arm.joints),
        arm.gauge_names,
        tuple(channel_of(gauge, gauge.name, 'position') for gauge in arm.gauges))


DEGREES = 180 / math.pi


def velocity_ratio(recording: Recording, joint: int) -> tuple[float, float] | None:
    """Give displacement over integrated velocity and its relative deviation; None at rest."""
    assert recording.dq is not None
    width = max(1, round(WINDOW / recording.dt))
    moved, integrated = [], []
    for segment in recording.segments:
        q, dq, t = recording.q[segment, joint], recording.dq[segment, joint], recording.t[segment]
        if len(q) <= width:
            continue
        area = np.concatenate([[0.0], np.cumsum(np.diff(t) * (dq[1:] + dq[:-1]) / 2)])
        moved.append(q[width:] - q[:-width])
        integrated.append(area[width:] - area[:-width])
    if not moved:
        return None
    x, y = np.concatenate(moved), np.concatenate(integrated)
    significant = np.abs(y) > max(MIN_DISPLACEMENT, 0.2 * float(np.abs(y).max()))
    if significant.sum() < MIN_WINDOWS or np.abs(x).max() < MIN_DISPLACEMENT / DEGREES:
        return None
    ratios = x[significant] / y[significant]
    ratio = float(np.median(ratios))
    deviation = float(np.median(np.abs(ratios - ratio)))
    return ratio, deviation / abs(ratio) if ratio else math.inf


def _is_about(value: float, expected: float) -> bool:
    return abs(value / expected - 1) < UNIT_TOLERANCE


@np.errstate(over='ignore', invalid='ignore')  # a damaged value may be as large as any double
def check_units(recording: Recording, plan: Sources, notes: Notes) -> None:
    """Refuse degrees, warn of velocities that do not go with the positions."""
    # degrees beside rad/s show in the ratio of displacement and velocity. Degrees in both only
    # show in their size: positions far outside the limits or beyond two turns, speeds that no arm
    # has
    suspects, width = [], max(1, round(WINDOW / recording.dt))
    for column, (name, slides, reach) in enumerate(
            zip(plan.joints, plan.prismatic, plan.reach, strict=True)):
        size = float(np.percentile(np.abs(recording.q[:, column]), 95))
        # within a turn, by steps of more than half of one: wrapped
        steps = np.abs(np.diff(recording.q[:, column])).max(initial=0.0)
        if not slides and reach is not None and size > reach and not (
                steps > math.pi > 0.5 * size):
            suspects.append(f'{name} goes to {size:.4g}, beyond {reach:.4g} rad')
        elif slides and reach is not None and size > reach:
            notes.add(f'{name} goes to {size:.4g} m, twice its limits or more; check the units')
        # Speed that is exceeded in a tenth of the moving time [rad/s or m/s]. Over windows, not
        # samples: the steps of a coarse encoder at 1 kHz are no speed. A tenth, not the maximum:
        # angles that wrap at pi jump now and then.
        speeds = [np.abs(recording.q[part][width:, column] - recording.q[part][:-width, column])
                  / (recording.t[part][width:] - recording.t[part][:-width])
                  for part in recording.segments if part.stop - part.start > width]
        speed = float(np.percentile(np.concatenate(speeds), 90)) if speeds else 0.0
        if not slides and speed > FASTEST:
            suspects.append(f'{name} turns at {speed:.4g} rad/s')
        elif not slides and speed > FAST:
            notes.add(f'{name} turns at {speed:.4g} rad/s, which is fast for an arm; make sure '
                      'that positions are in rad, not in degrees')
        if recording.dq is not None:
            suspects += _check_velocity(recording, column, name, slides, notes)
    if suspects:
        raise BagError(f'joint states look like degrees ({"; ".join(suspects[:4])}); publish '
                       'rad and rad/s and record again, or, if the values are right, correct type '
                       'and limits of the joint in the arm description', place=recording.path)


def without_zero_velocities(recording: Recording, plan: Sources, notes: Notes) -> Recording:
    """Leave velocities out that are all zero for a joint that moves: nobody measures them."""
    if recording.dq is None:
        return recording
    zero = tuple(name for name, moves, column in zip(
        plan.joints, moving_joints(recording, plan.prismatic), recording.dq.T, strict=True)
        if moves and not column.any())
    if not zero:
        return recording
    notes.add(f'the velocity of {", ".join(zero)} is always zero, though the joints move, so '
              'velocities are not used')
    return replace(recording, dq=None, oddities=replace(recording.oddities, zero_velocities=zero))


def _check_velocity(
    recording: Recording, column: int, name: str, slides: bool, notes: Notes,
) -> list[str]:
    found = velocity_ratio(recording, column)
    if found is None:
        return []
    (ratio, spread), unit = found, 'm' if slides else 'rad'
    if spread > MAX_SPREAD:
        notes.add(f'the velocity of {name} does not follow its position, but is used as it is; '
                  'check the driver')
    elif not slides and _is_about(abs(ratio), DEGREES):
        return [f'position of {name} changes {ratio:.3g} times as fast as its velocity says']
    elif not slides and _is_about(abs(ratio), 1 / DEGREES):
        return [f'velocity of {name} is {1 / ratio:.3g} times the derivative of its position']
    elif _is_about(ratio, -1.0):
        notes.add(f'velocity of {name} has the opposite sign of its motion; correct the driver')
    elif not _is_about(ratio, 1.0):
        notes.add(f'the velocity of {name} is {1 / ratio:.3g} times the derivative of its '
                  f'position; publish velocities in {unit}/s')
    return []


def moving_joints(recording: Recording, prismatic: Sequence[bool]) -> list[bool]:
    """Say which joints move."""
    low, high = np.percentile(recording.q, [1, 99], axis=0)
    spans: FloatArray = high - low
    return [bool(span > STILL[slides]) for span, slides in zip(spans, prismatic, strict=True)]


def check_plausible(
    recording: Recording, plan: Sources, notes: Notes, *, need_output: bool, need_motion: bool,
) -> Recording:
    """Check units and use of a recording; velocities that nobody measures are left out."""
    recording = without_zero_velocities(recording, plan, notes)
    check_units(recording, plan, notes)
    moving = moving_joints(recording, plan.prismatic)
    if not any(moving):
        text = f'no joint moves ({", ".join(plan.joints)} keep their positions)'
        if need_motion:
            raise BagError(f'{text}; no model can be learned: record motion', place=recording.path)
        notes.add(text)
    elif not all(moving):
        still = [name for name, moves in zip(plan.joints, moving, strict=True) if not moves]
        notes.add(f'{", ".join(map(repr, still))} does not move')
    if need_output and recording.effort is None and recording.strain is None:
        reasons = '; '.join(notes.lacking)
        raise BagError(f'the bag has neither efforts nor strains ({reasons or "none described"}); '
                       'correct effort.topic or gauges[].topic in the arm description, or record '
                       'these topics', place=recording.path)
    return replace(recording, warnings=tuple(notes.texts))
