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

"""Schedules: gains, load and modes of an arm by payload and pose, in a file and in use."""

from __future__ import annotations

from dataclasses import dataclass
import math
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import Finite, Name, NonNegative, Positive, Spec, validation_message
from tudor_dynamics.control import settings
from tudor_dynamics.control.cascade import LoopGains
from tudor_dynamics.control.damper import Damper
from tudor_dynamics.errors import ScheduleError
from tudor_dynamics.files import load_yaml, read_bounded, write_whole
from tudor_dynamics.typing import FloatArray, Shown
import yaml


# -- What a schedule says at one payload and pose, and how that stands in a row of numbers

@dataclass(frozen=True, eq=False)
class Mode:
    """A mode of the links, joints held."""

    frequency: float  # frequency of the undamped mode [Hz]
    damping: float  # damping ratio of the links alone
    # (joints,): what an acceleration of each joint drives it with; see `signals.shaped_profile`.
    drive: FloatArray
    # Its strain at the gauge of each damped joint, (damped,) [units of the gauges].
    strain: FloatArray


@dataclass(frozen=True, eq=False)
class Point:
    """A schedule at one payload and pose."""

    gain: FloatArray  # yielding speed per mean-free strain, (damped,) [rad/s per m/m]
    position_gain: float  # speed per position error [1/s]
    full_delay: float  # delay of the loop up to which these gains hold [s]
    reached: float  # damping ratio that they give; that asked for, or what the loop allows
    load: FloatArray  # strain of the arm at rest, (damped,) [units of the gauges]
    # Strain by the acceleration of each joint, links following, (damped, joints)
    # [unit per rad/s^2].
    inertia: FloatArray
    modes: tuple[Mode, ...]  # the first modes, ascending

    def row(self) -> FloatArray:
        """Give its values in the order of ``columns_of``."""
        return np.concatenate([
            self.gain, [self.position_gain, self.full_delay, self.reached], self.load,
            self.inertia.ravel(),
            *(np.concatenate([[m.frequency, m.damping], m.drive, m.strain]) for m in self.modes)])


def columns_of(joints: tuple[str, ...], damped: tuple[str, ...], modes: int) -> tuple[str, ...]:
    """Name the columns of a node."""
    return (*(f'gain({d})' for d in damped), 'position_gain', 'full_delay', 'reached',
            *(f'load({d})' for d in damped),
            *(f'inertia({d},{j})' for d in damped for j in joints),
            *(name for m in range(1, modes + 1) for name in (
                f'frequency({m})', f'damping({m})', *(f'drive({m},{j})' for j in joints),
                *(f'strain({m},{d})' for d in damped))))


# -- A schedule: what is known of an arm by payload and pose, as data in a file, interpolated.
#
# Each node of the grid has the gains of damper and position loop that give the damping ratio asked
# for, the strain that the load and the accelerations of a motion make there, and the first modes.
# ``tudor tune`` computes it from the elastic model; damper and planner read it without that.

MAX_BYTES = 20_000_000  # of a file
MAX_NODES = 10_000  # of a grid
LARGEST_GAIN = 1e6  # of a damper [rad/s per m/m]
Axis = Annotated[tuple[Finite, ...], Field(min_length=1, max_length=200)]


class ScheduleFile(Spec):
    """What stands in a file of a schedule; arrays by node, the payload's axis first."""

    kind: Literal['tudor_dynamics/schedule'] = Field(alias='format')
    version: Literal[1]
    arm: Name  # name of the arm
    joints: Annotated[tuple[Name, ...], Field(min_length=1, max_length=100)]  # active ones
    damped: Annotated[tuple[Name, ...], Field(min_length=1, max_length=100)]  # joints that damp
    gauges: Annotated[tuple[Name, ...], Field(min_length=1, max_length=100)]  # one of each of them
    damping_ratio: Annotated[float, Field(gt=0, lt=1)]  # that was asked for
    delay: NonNegative  # of the loop that the gains are for [s]
    mean_frequency: Positive  # of the high-pass that takes the mean off strains [Hz]
    payload: Annotated[tuple[NonNegative, ...], Field(min_length=1, max_length=200)]  # grid [kg]
    pose: tuple[Axis, ...]  # grid of joint positions [rad or m]
    columns: Annotated[tuple[Name, ...], Field(min_length=1, max_length=2000)]  # of `nodes`
    # A row for each payload and pose.
    nodes: Annotated[tuple[tuple[Finite, ...], ...], Field(min_length=1, max_length=MAX_NODES)]


class Schedule(Shown):
    """
    A schedule over payload and pose.

    Parameters
    ----------
    content : ScheduleFile
        What stands in the file, its shapes not yet compared.
    source : str
        Where it is from, for messages.

    Attributes
    ----------
    content : ScheduleFile
        What the file says, as it was given.
    payload : ndarray of shape (n_payloads,)
        Grid of payloads [kg].
    modes : int
        Number of modes.

    Raises
    ------
    ScheduleError
        If axes, columns and nodes contradict each other, or values cannot be.

    """

    def __init__(self, content: ScheduleFile, source: str = 'schedule') -> None:
        self.content, self.source = content, source
        joints, damped = content.joints, content.damped
        if len(content.pose) != len(joints) or len(content.gauges) != len(damped):
            self._refuse(f'{len(content.pose)} grid axes in pose for the joints {list(joints)}, '
                         f'{len(content.gauges)} gauges for {list(damped)}; expected one each')
        unknown = sorted(set(damped) - set(joints))
        if unknown:
            self._refuse(f'damped joints {unknown} are not among the joints {list(joints)}')
        per_mode = 2 + len(joints) + len(damped)
        rest = len(content.columns) - len(columns_of(joints, damped, 0))
        self.modes = max(rest, 0) // per_mode
        if content.columns != columns_of(joints, damped, self.modes) or self.modes < 1:
            self._refuse(f'columns begins with {list(content.columns)[:4]}; expected, for these '
                         f'joints, {list(columns_of(joints, damped, 1))[:4]}')
        axes = [np.array(axis, dtype=float) for axis in (content.payload, *content.pose)]
        for name, axis in zip(('payload', *joints), axes, strict=True):
            if np.any(np.diff(axis) <= 0.0):
                self._refuse(f'grid values of {name} do not increase: {axis.tolist()[:8]}')
        shape = tuple(len(axis) for axis in axes)
        if math.prod(shape) != len(content.nodes) or any(
                len(row) != len(content.columns) for row in content.nodes):
            sizes = sorted({len(row) for row in content.nodes})
            self._refuse(f'nodes has {len(content.nodes)} rows of {sizes} values, for a grid of '
                         f'{shape}; expected {math.prod(shape)} rows of {len(content.columns)}')
        values = np.array(content.nodes)
        self._check(values)
        self.payload = axes[0]
        self._axes = axes
        self._table = values.reshape(*shape, -1)

    def _refuse(self, cause: str) -> None:
        raise ScheduleError(cause, place=self.source, remedy='write another with `tudor tune`')

    def _check(self, values: FloatArray) -> None:
        """Refuse what no schedule may command."""
        names = self.content.columns
        for index, name in enumerate(names):
            kind = name.partition('(')[0]
            low, high = {'gain': (0.0, LARGEST_GAIN), 'position_gain': (1e-3, 100.0),
                         'full_delay': (1e-4, 10.0), 'reached': (-1.0, 10.0),
                         'frequency': (1e-3, 1e4), 'damping': (-1.0, 10.0)}.get(
                             kind, (-math.inf, math.inf))
            column = values[:, index]
            wrong = np.flatnonzero((column < low) | (column > high))
            if wrong.size:
                self._refuse(f'{name} is {column[wrong[0]]:g} in row {wrong[0] + 1} of nodes; '
                             f'expected {low:g} to {high:g}')

    def check_arm(self, arm: Arm) -> None:
        """Raise a `ScheduleError` where joints or gauges are not those of an arm."""
        damper = arm.spec.damper
        own = [(item.joint, item.gauge) for item in damper.joints
               if item.joint in arm.active_joints] if damper is not None else []
        given = list(zip(self.content.damped, self.content.gauges, strict=True))
        if self.content.joints != arm.active_joints or given != own:
            self._refuse(f'the schedule is for {list(self.content.joints)} with gauges '
                         f'{dict(given)}, not {list(arm.active_joints)} with {dict(own)}')

    def at(self, payload: float, q: FloatArray) -> Point:
        """Interpolate at a payload [kg] and a pose; beyond the grid its edge counts."""
        row = self._table
        for axis, value in zip(self._axes, (payload, *q.tolist()), strict=True):
            # an axis of one value says that nothing depends on it
            k = min(max(int(np.searchsorted(axis, value)) - 1, 0), max(len(axis) - 2, 0))
            if len(axis) == 1:
                row = row[0]
                continue
            share = min(max((value - axis[k]) / (axis[k + 1] - axis[k]), 0.0), 1.0)
            row = (1.0 - share) * row[k] + share * row[k + 1]
        n, d = len(self.content.joints), len(self.content.damped)
        gain, single, load, inertia, rest = np.split(row, np.cumsum([d, 3, d, d * n]))
        position_gain, full_delay, reached = single.tolist()
        return Point(gain, position_gain, full_delay, reached, load, inertia.reshape(d, n),
                     tuple(Mode(float(part[0]), float(part[1]), part[2:2 + n], part[2 + n:])
                           for part in rest.reshape(self.modes, -1)))

    def column(self, name: str) -> FloatArray:
        """Give one column, see ``columns_of``, over the whole grid, the payload's axis first."""
        return np.asarray(self._table[..., self.content.columns.index(name)])

    def save(self, path: str | Path) -> None:
        """Write the file, whole or not at all; one that is there is replaced."""
        content = self.content.model_dump(by_alias=True)
        nodes = content.pop('nodes')
        text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=99)
        lines = '\n'.join('- [' + ', '.join(_number(value) for value in row) + ']'
                          for row in nodes)
        write_whole(Path(path), f'{text}nodes:\n{lines}\n'.encode())


def _number(value: float) -> str:
    text = f'{value:.6g}'
    # YAML 1.1 takes 1e-05 for a text
    return text if '.' in text or 'e' not in text else text.replace('e', '.0e')


def load_schedule(path: str | Path, arm: Arm | None = None) -> Schedule:
    """Read a schedule that ``tudor tune`` wrote; check that it is of an arm, if one is given."""
    try:
        content: Any = load_yaml(read_bounded(Path(path), MAX_BYTES).decode())
        found = ScheduleFile.model_validate(content)
    except OSError as err:
        cause = f'the schedule cannot be read ({err.strerror})'
    except ValidationError as err:
        cause = f'the schedule is not valid, as {validation_message(err, add="")}'
    except ValueError as err:
        cause = f'the schedule is not valid ({err})'
    else:
        schedule = Schedule(found, str(path))
        if arm is not None:
            schedule.check_arm(arm)
        return schedule
    raise ScheduleError(cause, place=path, remedy='write a schedule with `tudor tune`')


# -- Gains and expected load that follow payload and pose; nothing of it while the payload is
#    unknown.
#
# A payload that is reported changes what is in use slowly, as does one that is reported no more:
# gains go back to the fixed ones then.

class Adaptation:
    """Follows payload and pose through a schedule: acceleration (joints,) [rad/s^2]."""

    def __init__(self, schedule: Schedule, acceleration: FloatArray) -> None:
        self.schedule = schedule
        self.timeout = 0.0  # [s]
        self.payload: float | None = None  # in use [kg]; None before any was reported
        self.weight = 0.0
        self.point: Point | None = None
        self._reported, self._at = math.nan, -math.inf
        self._refusal = ''
        self._most = acceleration
        self._load: FloatArray | None = None
        self._slow: FloatArray | None = None

    def tell(self, now: float, payload: float) -> str:
        """Take a payload: now [s], payload [kg]; returns an empty string if it is."""
        low, high = float(self.schedule.payload[0]), float(self.schedule.payload[-1])
        room = settings.PAYLOAD_MARGIN * (high - low) + settings.PAYLOAD_MARGIN_MASS
        if low - room <= payload <= high + room:
            self._reported, self._at, self._refusal = min(max(payload, low), high), now, ''
        else:  # not a number neither
            self._reported = math.nan
            self._refusal = (f'a load of {payload:.3g} kg is outside the {low:g} to {high:g} '
                             'kg of the schedule; widen it with `tudor tune --payloads`')
        return self._refusal

    @property
    def unknown(self) -> str:
        """Why no payload is known, where none is."""
        return self._refusal or (
            'no load was reported; start payload_estimator' if math.isnan(self._reported) else
            f'no load was reported for {self.timeout:g} s; check that payload_estimator runs')

    def report(self) -> dict[str, str]:
        """Give what is in use as texts by name, for diagnostics."""
        values = {'payload in use [kg]': 'none' if self.payload is None else f'{self.payload:.3f}',
                  'scheduled gains in use': f'{self.weight:.2f}'}
        if self.point is not None:
            values['first mode [Hz]'] = f'{self.point.modes[0].frequency:.2f}'
            values['damping ratio by schedule'] = f'{self.point.reached:.2f}'
        return values

    @property
    def mean_frequency(self) -> float:
        """Corner of the DC blockers [Hz]."""
        # The weight of what was just picked up is in the strain, but not in its mean yet.
        own = self.schedule.content.mean_frequency
        if self.payload is None or math.isnan(self._reported):
            return own
        much = settings.PAYLOAD_MUCH * float(np.ptp(self.schedule.payload))
        left = abs(self._reported - self.payload) / much if much > 0.0 else 0.0
        return own + settings.MEAN_HURRY * min(left, 1.0)

    def reset(self) -> None:
        """Begin with the fixed gains; the payload that was reported is still known."""
        self.weight, self.payload, self.point = 0.0, None, None
        self.forget()

    def forget(self) -> None:
        """Take the next sample for a first one."""
        self._load = self._slow = None

    def known(self, now: float) -> bool:
        """Say whether a payload was reported, and not too long before now [s]."""
        return math.isfinite(self._reported) and (
            self.timeout <= 0.0 or now - self._at <= self.timeout)

    def step(self, now: float, dt: float, q: FloatArray, dq_ref: FloatArray) -> FloatArray | None:
        """Follow for one sample; give what means shift by, None while no payload is in use."""
        known = self.known(now)
        change = dt / settings.SCHEDULE_BLEND_TIME
        self.weight = min(max(self.weight + (change if known else -change), 0.0), 1.0)
        if known:
            share = -math.expm1(-dt / settings.PAYLOAD_TIME)
            self.payload = self._reported if self.payload is None else (
                self.payload + share * (self._reported - self.payload))
        if self.payload is None or self.weight == 0.0:
            self.forget()
            return None
        before, self.point = self.point, self.schedule.at(self.payload, q)
        if self._slow is None:
            self._slow = dq_ref.copy()
        ddq = np.clip((dq_ref - self._slow) / (settings.ACCELERATION_TIME + dt),
                      -self._most, self._most)
        self._slow += ddq * dt
        shift = np.zeros(len(self.point.load))
        load = self.point.load + self.point.inertia @ ddq
        if self._load is not None and before is not None:
            # what the payload itself changes is in the strain already, and in its mean
            shift = self.weight * (load - self._load)
        self._load = load
        return shift

    def use(
        self, now: float, dt: float, q: FloatArray, dq_ref: FloatArray, damper: Damper,
        gains: LoopGains,
    ) -> None:
        """Follow for one sample, and let damper and loop have what is in use then."""
        shift = self.step(now, dt, q, dq_ref)
        if shift is None or self.point is None:
            damper.release()
            gains.adapt(0.0, 0.0, 0.0)
            return
        damper.adapt(self.point.gain, self.mean_frequency, self.weight, shift)
        gains.adapt(self.point.position_gain, self.point.full_delay, self.weight)
