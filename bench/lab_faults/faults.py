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


"""
The faults, each a small function that changes a recording, with the answers that count as right.

An answer is the key of a finding as ``tudor info --json`` prints it (``kind``), or a word for what
the reader says (``KEYS_OF_NOTES`` in the command). Keys that no check has yet are proposals.
``unexplained`` is right for every fault. A function raises `CannotShowError` where its fault would
change nothing that is measured; a fault marked as one of the model has to raise what rigid bodies
with friction leave unexplained (`lab.growth`), otherwise it is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
import math
from typing import Any

from lab_faults.lab import CannotShowError, Floats, Lab, MOVES, vertical
import numpy as np
import pinocchio as pin
from scipy.signal import lfilter

Random = np.random.Generator
Make = Callable[[Lab, int, float, Random], Lab]


@dataclass(frozen=True)
class Fault:
    """A fault with its sizes, and what may be said of it."""

    name: str
    make: Make  # of a recording, the column, the size
    sizes: tuple[float, ...]
    on: str  # what the column is of: `joint`, `effort`, `gauge`, or `bag` for none
    right: frozenset[str]
    model: Callable[[Lab, int], bool]  # whether the residual of rigid bodies has to grow
    # Corrections of another kind that would do as well where they explain the recording.
    twins: Mapping[str, Make]
    # Answers that are right as well, by recording and column.
    also: Callable[[Lab, int], set[str]]


FAULTS: list[Fault] = []


def fault(name: str, on: str, sizes: tuple[float, ...], right: str, *,
          model: bool | Callable[[Lab, int], bool] = False,
          twins: Mapping[str, Make] | None = None,
          also: Callable[[Lab, int], set[str]] = lambda lab, column: set(),
          ) -> Callable[[Make], Make]:
    """Put a function on the list; right: keys with blanks between them."""
    def listed(make: Make) -> Make:
        by_model = model if callable(model) else lambda lab, column: bool(model)
        FAULTS.append(Fault(name, make, sizes, on, frozenset(right.split()), by_model,
                            twins or {}, also))
        return make
    return listed


# -- Tools

def need(condition: Any, why: str) -> None:
    """Leave a fault out that cannot show."""
    if not condition:
        raise CannotShowError(why)


def changed(values: Floats, rows: Any, column: int, to: Any) -> Floats:
    """Give a table with some of its values replaced."""
    result = np.array(values)
    result[rows, column] = to
    return result


def slides(lab: Lab, joint: int) -> bool:
    """Say whether a joint is prismatic."""
    return lab.arm.is_prismatic(lab.joints[joint])


def in_motion(lab: Lab, joint: int, random: Random, low: float = 0.3, high: float = 0.65) -> int:
    """Draw a row at which the joint moves, away from the ends."""
    speed = np.abs(np.gradient(lab.q[:, joint], lab.t))
    width = max(1, round(0.1 / lab.dt))
    speed = np.convolve(speed, np.ones(width) / width, 'same')
    first, last = round(low * len(speed)), round(high * len(speed))
    rows = first + np.flatnonzero(speed[first:last] > 0.3 * np.percentile(speed, 95))
    need(len(rows), 'the joint stands in the middle of the recording')
    return int(random.choice(rows))


def neighbour(lab: Lab, column: int, random: Random) -> int:
    """Draw another joint that moves."""
    others = [k for k in lab.moving if k != column]
    need(others, 'no other joint moves')
    return int(min(others, key=lambda k: (abs(k - column), random.random())))


def span(values: Floats) -> float:
    """Give the range of a signal without its outermost percents."""
    low, high = np.percentile(values, [1, 99])
    return float(high - low)


def noise_of(values: Floats) -> float:
    """Give the size of what changes from sample to sample."""
    return float(np.median(np.abs(np.diff(values, 2)))) / 2 + 1e-12


def lagged(values: Floats, dt: float, seconds: float) -> Floats:
    """Filter by a first-order lag."""
    keep = math.exp(-dt / seconds)
    return lfilter([1 - keep], [1, -keep], values, axis=0, zi=keep * values[:1])[0]


def with_positions(lab: Lab, joint: int, to: Any, rows: Any = slice(None)) -> Lab:
    """Replace positions of a joint; what the driver says of its velocity stays."""
    return replace(lab, q=changed(lab.q, rows, joint, to))


def scaled(lab: Lab, joint: int, factor: float) -> Lab:
    """Scale positions of a joint, and velocities, which come from the same encoder."""
    dq = None if lab.dq is None else changed(
        lab.dq, slice(None), joint, factor * lab.dq[:, joint])
    return replace(with_positions(lab, joint, factor * lab.q[:, joint]), dq=dq)


def effort_turned(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Turn the sign of an effort."""
    assert lab.effort is not None
    return replace(lab, effort=changed(lab.effort, slice(None), joint, -lab.effort[:, joint]))


def joint_turned(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Count a joint the other way round."""
    return scaled(lab, joint, -1.0)


def alone(key: str) -> Callable[[Lab, int], set[str]]:
    """Give a key that is right as well where no joint before moves."""
    return lambda lab, joint: set() if any(k < joint for k in lab.moving) else {key}


# -- Positions

@fault('positions wrapped', 'joint', (0.0, math.pi), 'positions_wrapped')
def wrapped(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Wrap positions into [0, 2 pi) or [-pi, pi)."""
    need(not slides(lab, joint), 'a sliding joint does not wrap')
    values = np.mod(lab.q[:, joint] + size, 2 * math.pi) - size
    jumps = np.abs(np.diff(values - lab.q[:, joint])) > 1.0
    need(jumps.sum() >= 1, 'the joint does not cross the place where it would wrap')
    return with_positions(lab, joint, values)


@fault('encoder slips once', 'joint', (0.05, 0.2), 'position_jump')
def slips(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Let the positions jump while the joint moves [rad; a tenth in m]."""
    row = in_motion(lab, joint, random)
    step = size * (0.1 if slides(lab, joint) else 1.0) * random.choice([-1, 1])
    return with_positions(lab, joint, lab.q[row:, joint] + step, slice(row, None))


@fault('encoder slips and comes back', 'joint', (0.1,), 'position_jump outlier')
def slips_back(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Let positions be off for 4 s, as until the next index mark."""
    row = in_motion(lab, joint, random, 0.2, 0.5)
    rows = slice(row, row + round(4.0 / lab.dt))
    step = size * (0.1 if slides(lab, joint) else 1.0)
    return with_positions(lab, joint, lab.q[rows, joint] + step, rows)


@fault('belt or coupling creeps', 'joint', (0.1, 0.3), 'position_drift joint_zero', model=True)
def creeps(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Let the encoder lose counts evenly [rad; a tenth in m over the recording]."""
    step = size * (0.1 if slides(lab, joint) else 1.0)
    return with_positions(
        lab, joint, lab.q[:, joint] + step * lab.t / lab.t[-1])


@fault('encoder counts half or double', 'joint', (0.5, 2.0), 'joint_scale', model=True)
def counts(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Count single edges for fourfold ones."""
    return scaled(lab, joint, size)


@fault('wrong gear ratio', 'joint', (0.8, 1.25), 'joint_scale', model=True)
def ratio(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Take the ratio of another gear of the series."""
    return scaled(lab, joint, size)


@fault('joint zero off', 'joint', (5.0, 10.0), 'joint_zero', model=True,
       also=alone('gravity_axis'))
def zero(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Set the zero at another angle [deg]."""
    need(vertical(lab, joint) > 0.3, 'gravity does not see this joint turn')
    need(any(k > joint for k in lab.moving),
         'the last joint that moves: its body takes the zero up')
    return with_positions(
        lab, joint, lab.q[:, joint] + math.radians(size) * random.choice([-1, 1]))


def rubs_little(lab: Lab, joint: int) -> bool:
    """Say whether friction is too small for a turned sign to show as friction that drives."""
    return lab.explained.friction.get(lab.joints[joint], 0.0) < 0.1


fault('joint counts the other way', 'joint', (1.0,), 'joint_sign', model=rubs_little,
      twins={'effort_sign': effort_turned})(joint_turned)


@fault('one joint in degrees', 'joint', (1.0,), 'degrees joint_scale')
def degrees(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Publish positions and velocities of a joint in degrees."""
    need(not slides(lab, joint), 'a sliding joint has no degrees')
    return scaled(lab, joint, 180 / math.pi)


@fault('only positions of one joint in degrees', 'joint', (1.0,), 'degrees joint_scale')
def degrees_beside(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Publish positions of a joint in degrees beside velocities in rad/s."""
    need(not slides(lab, joint), 'a sliding joint has no degrees')
    need(lab.dq is not None, 'no velocities')
    return with_positions(lab, joint, lab.q[:, joint] * 180 / math.pi)


@fault('encoder held', 'joint', (1.0, 3.0), 'position_held held')
def held(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Repeat a position for some seconds while the joint moves."""
    row = in_motion(lab, joint, random, 0.2, 0.7)
    rows = slice(row, row + round(size / lab.dt))
    need(span(lab.q[rows, joint]) > max(MOVES[slides(lab, joint)], 0.05 * span(lab.q[:, joint])),
         'the joint hardly moves meanwhile')
    return with_positions(lab, joint, lab.q[row, joint], rows)


@fault('encoder dead', 'joint', (1.0,), 'position_held held constant standing')
def dead(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Give one position throughout, while the drive works."""
    need(len(lab.moving) > 1, 'no other joint moves: this is a recording of standing')
    result = with_positions(lab, joint, lab.q[0, joint])
    return result if lab.dq is None else replace(
        result, dq=changed(lab.dq, slice(None), joint, 0.0))


@fault('positions updated at a tenth of the rate', 'joint', (10,), 'position_held held stale')
def stale(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Repeat each position ten times: a slow bus under a fast publisher."""
    rows = np.arange(len(lab.q)) // int(size * max(1, round(0.01 / lab.dt)))
    first = np.searchsorted(rows, rows)
    return with_positions(lab, joint, lab.q[first, joint])


@fault('whole driver at half the rate', 'bag', (2, 5), 'held position_held stale alternating')
def republished(lab: Lab, column: int, size: float, random: Random) -> Lab:
    """Publish every message several times, with new stamps."""
    first = np.arange(len(lab.q)) // int(size) * int(size)

    def again(values: Floats | None) -> Floats | None:
        return None if values is None else values[first]
    return replace(lab, q=lab.q[first], dq=again(lab.dq), effort=again(lab.effort),
                   strain=again(lab.strain))


@fault('positions quantised', 'joint', (0.5, 2.0), 'coarse_positions position_held held stale')
def quantised(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Round positions [deg; 5 mm a degree]."""
    quantum = 0.005 * size if slides(lab, joint) else math.radians(size)
    need(span(lab.q[:, joint]) > 10 * quantum, 'the joint moves by a few steps only')
    return with_positions(lab, joint, np.round(lab.q[:, joint] / quantum) * quantum)


@fault('positions with spikes', 'joint', (0.1, 1.0), 'outlier position_jump')
def spikes(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Throw single samples out [rad; a tenth in m]."""
    rows = random.choice(np.arange(20, len(lab.q) - 20), max(3, len(lab.q) // 600), replace=False)
    step = size * (0.1 if slides(lab, joint) else 1.0)
    return with_positions(
        lab, joint, lab.q[rows, joint] + step * random.choice([-1, 1], len(rows)), rows)


@fault('positions noisy', 'joint', (0.01,), 'noisy_positions outlier')
def noisy(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Add noise as of a broken shield [rad; a tenth in m]."""
    step = size * (0.1 if slides(lab, joint) else 1.0)
    need(step > 5 * noise_of(lab.q[:, joint]), 'positions are as noisy already')
    return with_positions(lab, joint, lab.q[:, joint] + step * random.normal(size=len(lab.q)))


@fault('encoder off its centre', 'joint', (0.05,), 'position_ripple', model=True)
def eccentric(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Add a wave of the joint's angle, seven to a turn [rad]."""
    need(not slides(lab, joint), 'a sliding joint has no centre')
    return with_positions(lab, joint, lab.q[:, joint] + size * np.sin(7 * lab.q[:, joint]))


@fault('wanted positions in place of measured ones', 'bag', (0.05, 0.15),
       'effort_late strain_late velocity_late clocks_apart', model=True)
def wanted(lab: Lab, column: int, size: float, random: Random) -> Lab:
    """Let all positions lead by what the position loop lags [s]."""
    led = replace(lab, q=np.column_stack([
        np.interp(lab.t + size, lab.t, values) for values in lab.q.T]))
    return led.at(lab.t <= lab.t[-1] - size)


@fault('positions of two joints exchanged', 'joint', (1.0,), 'joints_exchanged', model=True,
       twins={'efforts_exchanged': lambda lab, k, size, random: swapped_efforts(lab, k)})
def exchanged(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Exchange what two neighbours' encoders say."""
    other = _next(lab, joint)
    order = list(range(len(lab.joints)))
    order[joint], order[other] = other, joint
    return replace(lab, q=lab.q[:, order], dq=None if lab.dq is None else lab.dq[:, order])


def _next(lab: Lab, joint: int) -> int:
    later = [k for k in lab.moving if k > joint]
    need(later, 'no later joint moves')
    return later[0]


def swapped_efforts(lab: Lab, joint: int) -> Lab:
    """Exchange the efforts of a joint and of the next that moves."""
    assert lab.effort is not None
    order = list(range(len(lab.joints)))
    other = _next(lab, joint)
    order[joint], order[other] = other, joint
    return replace(lab, effort=lab.effort[:, order])


@fault('names of two joints exchanged', 'joint', (1.0,), 'joints_exchanged', model=True)
def names(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Exchange all that is measured of two joints: names sorted by their letters."""
    result = exchanged(lab, joint, size, random)
    return result if lab.effort is None else swapped_efforts(result, joint)


# -- Velocities

def velocities(lab: Lab, joint: int, to: Any) -> Lab:
    """Replace velocities of a joint."""
    need(lab.dq is not None, 'no velocities')
    return replace(lab, dq=changed(lab.dq, slice(None), joint, to))


@fault('velocity filtered', 'joint', (0.05, 0.15), 'velocity_late velocity_unlike')
def velocity_filtered(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Filter a velocity by a lag [s]."""
    need(lab.dq is not None, 'no velocities')
    return velocities(lab, joint, lagged(lab.dq[:, joint], lab.dt, size))


@fault('all velocities filtered', 'bag', (0.05,), 'velocity_late velocity_unlike')
def velocities_filtered(lab: Lab, column: int, size: float, random: Random) -> Lab:
    """Filter all velocities by a lag [s]."""
    need(lab.dq is not None, 'no velocities')
    return replace(lab, dq=lagged(lab.dq, lab.dt, size))


@fault('velocity zero', 'joint', (0.0,), 'velocity_zeros')
def velocity_zero(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Publish no velocity of a joint."""
    return velocities(lab, joint, 0.0)


@fault('velocity in deg/s', 'joint', (1.0,), 'degrees velocity_scale')
def velocity_degrees(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Publish a velocity in deg/s."""
    need(not slides(lab, joint) and lab.dq is not None, 'no velocities of turning')
    return velocities(lab, joint, lab.dq[:, joint] * 180 / math.pi)


@fault('velocity of the motor', 'joint', (100.0,), 'velocity_scale')
def velocity_motor(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Publish the speed before the gear."""
    need(lab.dq is not None, 'no velocities')
    return velocities(lab, joint, lab.dq[:, joint] * size)


@fault('velocity with the other sign', 'joint', (1.0,), 'velocity_sign velocity_scale')
def velocity_turned(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Publish a velocity with the other sign."""
    need(lab.dq is not None, 'no velocities')
    return velocities(lab, joint, -lab.dq[:, joint])


@fault('velocity of the neighbour', 'joint', (1.0,), 'copied_channel velocity_unlike')
def velocity_copied(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Publish the neighbour's velocity twice."""
    need(lab.dq is not None, 'no velocities')
    return velocities(lab, joint, lab.dq[:, neighbour(lab, joint, random)])


# -- Efforts and strains: the same faults of both

def put(lab: Lab, on: str, column: int, to: Any, rows: Any = slice(None)) -> Lab:
    """Replace values of an effort or of a gauge."""
    table = lab.effort if on == 'effort' else lab.strain
    assert table is not None
    values = changed(table, rows, column, to)
    return replace(lab, effort=values) if on == 'effort' else replace(lab, strain=values)


def column_of(lab: Lab, on: str, column: int) -> Floats:
    """Give an effort or a strain that says something."""
    table = lab.effort if on == 'effort' else lab.strain
    assert table is not None
    values = table[:, column]
    need(span(values) > 10 * noise_of(values), 'the channel is little more than noise')
    return values


Channel = Callable[[Lab, Floats, float, Random], 'tuple[Any, Any]']


def both(what: str, sizes: tuple[float, ...], right: str, *, only: str = 'effort gauge',
         model: bool = False) -> Callable[[Channel], Channel]:
    """Make a fault of efforts and one of gauges from what happens to a channel."""
    def listed(change: Channel) -> Channel:
        def of(on: str) -> Make:
            def make(lab: Lab, column: int, size: float, random: Random) -> Lab:
                rows, to = change(lab, column_of(lab, on, column), size, random)
                return put(lab, on, column, to, rows)
            return make
        for on in only.split():
            fault(f'{on} {what}', on, sizes, right, model=model)(of(on))
        return change
    return listed


@both('every second zero', (2,), 'alternating')
def alternating(lab: Lab, values: Floats, size: float, random: Random) -> tuple[Any, Any]:
    """Publish zero in turn with the value."""
    need(np.mean(np.abs(values) > 5 * noise_of(values)) > 0.3, 'values are about zero')
    return slice(None, None, int(size)), 0.0


def two_signs(values: Floats) -> None:
    """Ask for a channel that changes its sign."""
    size = span(values)
    need(min(np.mean(values > 0.1 * size), np.mean(values < -0.1 * size)) > 0.1,
         'the channel has one sign')


@both('rectified', (1.0,), 'rectified')
def rectified(lab: Lab, values: Floats, size: float, random: Random) -> tuple[Any, Any]:
    """Publish magnitudes."""
    two_signs(values)
    return slice(None), np.abs(values)


@both('cut at zero', (0.0,), 'rectified saturated')
def one_sided(lab: Lab, values: Floats, size: float, random: Random) -> tuple[Any, Any]:
    """Publish zero for what is negative: an input that knows one sign."""
    two_signs(values)
    return slice(None), np.maximum(values, 0.0)


@both('filtered', (0.05, 0.2), 'effort_late strain_late', model=True)
def filtered(lab: Lab, values: Floats, size: float, random: Random) -> tuple[Any, Any]:
    """Filter by a lag [s]."""
    return slice(None), lagged(values, lab.dt, size)


@both('clipped', (0.5, 0.75), 'saturated')
def clipped(lab: Lab, values: Floats, size: float, random: Random) -> tuple[Any, Any]:
    """Clip at a share of the largest value."""
    limit = size * float(np.percentile(np.abs(values), 99.5))
    need(np.mean(np.abs(values) > limit + 3 * noise_of(values)) > 0.01,
         'less than 1 % of the samples are above')
    return slice(None), np.clip(values, -limit, limit)


@both('held', (3.0,), 'held effort_held')
def channel_held(lab: Lab, values: Floats, size: float, random: Random) -> tuple[Any, Any]:
    """Repeat a value for some seconds."""
    row = round(random.uniform(0.3, 0.6) * len(values))
    rows = slice(row, row + round(size / lab.dt))
    need(span(values[rows]) > 0.1 * span(values), 'the channel hardly changes meanwhile')
    return rows, values[row]


@both('falls to zero', (0.5,), 'dying held constant')
def dying(lab: Lab, values: Floats, size: float, random: Random) -> tuple[Any, Any]:
    """Publish zero from some time on."""
    return slice(round(size * len(values)), None), 0.0


@both('dead', (0.0,), 'constant dying')
def channel_dead(lab: Lab, values: Floats, size: float, random: Random) -> tuple[Any, Any]:
    """Publish one value and the noise of the input."""
    return slice(None), values.mean() + noise_of(values) * random.normal(size=len(values))


@both('with spikes', (0.5, 3.0), 'outlier')
def channel_spikes(lab: Lab, values: Floats, size: float, random: Random) -> tuple[Any, Any]:
    """Throw single samples out by shares of the range."""
    rows = random.choice(np.arange(20, len(values) - 20), max(3, len(values) // 600),
                         replace=False)
    need(size * span(values) > 10 * noise_of(values), 'noise is as large')
    return rows, values[rows] + size * span(values) * random.choice([-1, 1], len(rows))


@both('steps by an offset', (0.3,), 'offset_step drift', model=True)
def offset_step(lab: Lab, values: Floats, size: float, random: Random) -> tuple[Any, Any]:
    """Add an offset from the middle on, a share of the range: a plug that was moved."""
    row = round(random.uniform(0.35, 0.65) * len(values))
    return slice(row, None), values[row:] + size * span(values)


@both('drifts', (0.4,), 'drift', model=True)
def drifts(lab: Lab, values: Floats, size: float, random: Random) -> tuple[Any, Any]:
    """Add a ramp, a share of the range over the recording: warmth."""
    return slice(None), values + size * span(values) * lab.t / lab.t[-1]


@both('changes its gain', (0.4, 2.0), 'gain_step dying', model=True)
def gain_step(lab: Lab, values: Floats, size: float, random: Random) -> tuple[Any, Any]:
    """Change the range of the amplifier in the middle; a gauge whose glue gives way."""
    row = round(random.uniform(0.35, 0.65) * len(values))
    return slice(row, None), values[row:] * size


@both('with hum', (0.15,), 'hum', model=True)
def hum(lab: Lab, values: Floats, size: float, random: Random) -> tuple[Any, Any]:
    """Add what an aliased mains frequency leaves: a wave of 1.3 Hz."""
    return slice(None), values + size * span(values) * np.sin(2 * math.pi * 1.3 * lab.t)


@both('quantised', (12,), 'coarse_channel held')
def coarse(lab: Lab, values: Floats, size: float, random: Random) -> tuple[Any, Any]:
    """Round to a few steps over the range."""
    quantum = span(values) / size
    need(quantum > 10 * noise_of(values), 'noise is as large as a step')
    return slice(None), np.round(values / quantum) * quantum


@both('in thousandths', (1000.0,), 'effort_unit strain_unit')
def thousandths(lab: Lab, values: Floats, size: float, random: Random) -> tuple[Any, Any]:
    """Publish mA for A, or whatever is a thousand times smaller."""
    return slice(None), values * size


fault('effort with the other sign', 'effort', (1.0,), 'effort_sign', model=rubs_little,
      twins={'joint_sign': joint_turned})(
    lambda lab, joint, size, random: (
        column_of(lab, 'effort', joint), effort_turned(lab, joint, size, random))[1])


@fault('gauge with the other sign', 'gauge', (1.0,), 'gauge_sign')
def gauge_turned(lab: Lab, gauge: int, size: float, random: Random) -> Lab:
    """Turn the sign of a bridge."""
    values = column_of(lab, 'gauge', gauge)
    need(lab.effort is not None, 'no effort says which sign a load has')
    joint = lab.joints.index(lab.arm.gauges[gauge].joint)
    need(np.corrcoef(values, lab.effort[:, joint])[0, 1] > 0.5,
         'strain and effort have little in common')
    return put(lab, 'gauge', gauge, -values)


@fault('efforts of two joints exchanged', 'effort', (1.0,), 'efforts_exchanged', model=True,
       twins={'joints_exchanged': exchanged})
def efforts_exchanged(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Exchange two plugs."""
    return swapped_efforts(lab, joint)


@fault('efforts one place on', 'bag', (1.0,), 'efforts_exchanged', model=True)
def efforts_shifted(lab: Lab, column: int, size: float, random: Random) -> Lab:
    """Begin the array of efforts one place late."""
    need(lab.effort is not None and len(lab.moving) > 2, 'too few joints')
    return replace(lab, effort=np.roll(lab.effort, 1, axis=1))


@fault('effort of the neighbour', 'effort', (1.0,), 'copied_channel')
def effort_copied(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Publish the neighbour's effort twice."""
    other = neighbour(lab, joint, random)
    assert lab.effort is not None
    return put(lab, 'effort', joint, lab.effort[:, other])


@fault('effort of the neighbour, with noise', 'effort', (1.0,), 'copied_channel', model=True)
def effort_crosstalk(lab: Lab, joint: int, size: float, random: Random) -> Lab:
    """Measure the neighbour's current twice, by two inputs with other gains."""
    other = neighbour(lab, joint, random)
    assert lab.effort is not None
    values = column_of(lab, 'effort', other)
    return put(lab, 'effort', joint,
               0.97 * values + 0.005 * span(values) * random.normal(size=len(values)))


@fault('gauge copies another', 'gauge', (1.0,), 'copied_channel')
def gauge_copied(lab: Lab, gauge: int, size: float, random: Random) -> Lab:
    """Publish another gauge twice."""
    need(len(lab.gauges) > 1, 'one gauge')
    assert lab.strain is not None
    return put(lab, 'gauge', gauge, lab.strain[:, gauge - 1])


@fault('gauges exchanged', 'gauge', (1.0,), 'gauges_exchanged')
def gauges_exchanged(lab: Lab, gauge: int, size: float, random: Random) -> Lab:
    """Exchange the gauges of two links."""
    others = [g for g, spec in enumerate(lab.arm.gauges)
              if spec.joint != lab.arm.gauges[gauge].joint]
    need(others, 'no gauge on another link')
    assert lab.strain is not None
    order = list(range(len(lab.gauges)))
    order[gauge], order[others[0]] = others[0], gauge
    return replace(lab, strain=lab.strain[:, order])


# -- Clocks

def later(lab: Lab, stream: str, seconds: float) -> Lab:
    """Stamp a stream late."""
    values = lab.effort if stream == 'effort' else lab.strain
    need(values is not None, f'no {stream}')
    return with_clock(lab, stream, lab.stamps[stream] + round(seconds * 1e9))


def with_clock(lab: Lab, stream: str, stamp: Any) -> Lab:
    """Stamp a stream otherwise; what stands beside the positions is merged by these stamps."""
    moved = replace(lab, stamps=lab.stamps | {stream: stamp})
    if stream == 'strain' or not lab.of_joint_topic():
        return moved
    joints = lab.stamps['joints']
    merged = replace(lab, effort=moved.stream(lab.effort, 'effort'))
    return merged.at((joints >= stamp[0]) & (joints <= stamp[-1]))


@fault('clock of efforts apart', 'bag', (0.1, 1.0, -0.5), 'clocks_apart effort_late', model=True)
def efforts_apart(lab: Lab, column: int, size: float, random: Random) -> Lab:
    """Stamp efforts on another computer [s]."""
    return later(lab, 'effort', size)


@fault('clock of strains apart', 'bag', (0.1, 1.0, -0.5), 'clocks_apart strain_late', model=True)
def strains_apart(lab: Lab, column: int, size: float, random: Random) -> Lab:
    """Stamp strains on another computer [s]."""
    return later(lab, 'strain', size)


@fault('clock of efforts runs fast', 'bag', (0.005,), 'clocks_apart effort_late', model=True)
def efforts_fast(lab: Lab, column: int, size: float, random: Random) -> Lab:
    """Let the other computer's clock run fast, by a share."""
    need(lab.effort is not None, 'no effort')
    stamp = lab.stamps['effort']
    return with_clock(lab, 'effort', stamp + ((stamp - stamp[0]) * size).astype(np.int64))


@fault('time base off', 'bag', (0.5, 2.0), 'time_scale velocity_scale',
       model=lambda lab, column: lab.dq is None)
def time_scaled(lab: Lab, column: int, size: float, random: Random) -> Lab:
    """Stamp by counting samples of another rate; the driver's velocities stay."""
    stamp = lab.stamps['joints']
    slow = stamp[0] + ((stamp - stamp[0]) * size).astype(np.int64)
    return replace(lab, stamps=dict.fromkeys(lab.stamps, slow))


@fault('stamps of arrival', 'bag', (5, 12), 'jitter gaps')
def arrival(lab: Lab, column: int, size: float, random: Random) -> Lab:
    """Stamp when a packet of several samples arrives, half a millisecond from each other."""
    stamp = lab.stamps['joints']
    end = np.minimum(np.arange(len(stamp)) // int(size) * int(size) + int(size) - 1,
                     len(stamp) - 1)
    places = np.arange(len(stamp)) % int(size)
    step = min(500_000, round(lab.dt * 1e9 / 20))
    stamp = np.maximum.accumulate(stamp[end] + places * step)
    return replace(lab, stamps=dict.fromkeys(lab.stamps, stamp))


@fault('stamps jitter', 'bag', (0.4, 1.5), 'jitter gaps')
def jitter(lab: Lab, column: int, size: float, random: Random) -> Lab:
    """Stamp by a busy computer, late by an exponential of so many sample times."""
    stamp = lab.stamps['joints']
    late = random.exponential(size * lab.dt, len(stamp))
    stamp = np.maximum.accumulate(stamp + (late * 1e9).astype(np.int64))
    return replace(lab, stamps=dict.fromkeys(lab.stamps, stamp + np.arange(len(stamp)) * 1000))


@fault('clock set back', 'bag', (2.0,), 'clock_set_back')
def set_back(lab: Lab, column: int, size: float, random: Random) -> Lab:
    """Set the clock back in the middle [s]."""
    stamp = lab.stamps['joints']
    stamps = np.array(stamp)
    stamps[len(stamp) // 2:] -= round(size * 1e9)
    return replace(lab, stamps=dict.fromkeys(lab.stamps, stamps),
                   logs=dict.fromkeys(lab.stamps, stamp))


@fault('clock set forward', 'bag', (1.0,), 'clock_set_forward gaps time_jump')
def set_forward(lab: Lab, column: int, size: float, random: Random) -> Lab:
    """Set the clock forward in the middle of the motion [s]."""
    row = in_motion(lab, lab.moving[0], random)
    stamp = np.array(lab.stamps['joints'])
    stamp[row:] += round(size * 1e9)
    return replace(lab, stamps=dict.fromkeys(lab.stamps, stamp))


@fault('bursts are lost', 'bag', (0.1, 0.3), 'gaps lost')
def bursts(lab: Lab, column: int, size: float, random: Random) -> Lab:
    """Lose a share of all messages in bursts of 0.3 s."""
    count, width = len(lab.q), round(0.3 / lab.dt)
    keep = np.ones(count, dtype=bool)
    while keep.mean() > 1 - size:
        row = random.integers(count - width)
        keep[row:row + width] = False
    return replace(lab, kept=dict.fromkeys(lab.stamps, keep))


@fault('lost samples are filled by lines', 'bag', (0.15,), 'filled held gaps', model=True)
def filled(lab: Lab, column: int, size: float, random: Random) -> Lab:
    """Lose a share in bursts of 0.4 s, which a script has filled in by straight lines."""
    keep = np.ones(len(lab.q), dtype=bool)
    width = round(0.4 / lab.dt)
    while keep.mean() > 1 - size:
        row = random.integers(width, len(keep) - 2 * width)
        keep[row:row + width] = False

    def fill(values: Floats | None) -> Floats | None:
        return None if values is None else np.column_stack([
            np.interp(lab.t, lab.t[keep], one[keep]) for one in values.T])
    return replace(lab, q=fill(lab.q), dq=fill(lab.dq), effort=fill(lab.effort),
                   strain=fill(lab.strain))


# -- The arm and what is around it

def turned(lab: Lab, axis: Floats, angle: float) -> Lab:
    """Describe gravity turned by an angle [rad]: the base stands otherwise than described."""
    gravity = np.array(lab.arm.spec.gravity, dtype=float)
    need(gravity.any(), 'gravity does nothing in this arm')
    rotated = pin.exp3(axis * angle) @ gravity
    content = lab.content | {'gravity': [float(value) for value in rotated]}
    spec = lab.arm.spec.model_copy(update={'gravity': tuple(content['gravity'])})
    return replace(lab, content=content, arm=replace(lab.arm, spec=spec))


def level_axis(lab: Lab, random: Random) -> Floats:
    """Draw an axis across gravity; that of the joints where they are all parallel."""
    gravity = np.array(lab.arm.spec.gravity, dtype=float)
    need(gravity.any(), 'gravity does nothing in this arm')
    axis = np.cross(gravity, random.normal(size=3))
    return axis / np.linalg.norm(axis)


@fault('base tilted', 'bag', (5.0, 10.0), 'gravity_axis axes_parallel_to_gravity', model=True,
       also=lambda lab, column: {'joint_zero'} if vertical(lab, lab.moving[0]) > 0.9 else set())
def tilted(lab: Lab, column: int, size: float, random: Random) -> Lab:
    """Mount the robot on a bench that leans [deg]."""
    return turned(lab, level_axis(lab, random), math.radians(size))


@fault('mounted otherwise', 'bag', (90.0, 180.0), 'gravity_axis axes_parallel_to_gravity',
       model=True)
def mounted(lab: Lab, column: int, size: float, random: Random) -> Lab:
    """Mount the robot on the wall or the ceiling, described as on the floor [deg]."""
    return turned(lab, level_axis(lab, random), math.radians(size))


def with_tip_force(lab: Lab, rows: slice, mass: float, force: Floats) -> Lab:
    """Add what a mass at the last frame and a force there ask of the drives."""
    need(lab.effort is not None and all(
        str(joint.effort.unit) in ('N m', 'N') for joint in lab.arm.joints),
        'efforts are no torques')
    need(len(lab.moving) > 1, 'one axis')
    model, order = lab.arm.model, lab.arm.velocity_index
    bare = model.copy()
    for k in range(bare.njoints):
        bare.inertias[k] = pin.Inertia(0.0, np.zeros(3), np.zeros((3, 3)))
    bare.inertias[bare.njoints - 1] = pin.Inertia(mass, np.array([0.0, 0.0, 0.1]),
                                                  1e-3 * mass * np.eye(3))
    bare.gravity.linear = np.array(lab.arm.spec.gravity, dtype=float)
    data = bare.createData()
    dt = lab.dt
    width = max(1, round(0.08 / dt))
    kernel = np.hanning(width + 2)[1:-1]
    smooth = np.column_stack([np.convolve(np.pad(one, width, 'edge'), kernel / kernel.sum(),
                                          'same')[width:-width] for one in lab.q.T])
    dq = np.gradient(smooth, lab.t, axis=0)
    ddq = np.gradient(dq, lab.t, axis=0)
    efforts = np.array(lab.effort)
    for row in range(*rows.indices(len(lab.q))):
        q, v, a = (np.zeros(bare.nv) for _ in range(3))
        q[order], v[order], a[order] = smooth[row], dq[row], ddq[row]
        place = pin.integrate(bare, pin.neutral(bare), q)
        torque = pin.rnea(bare, data, place, v, a)
        if force.any():
            jacobian = pin.computeJointJacobian(bare, data, place, bare.njoints - 1)
            rotation = data.oMi[bare.njoints - 1].rotation
            torque = torque + jacobian[:3].T @ (rotation.T @ force)
        efforts[row] += torque[order]
    return replace(lab, effort=efforts)


@fault('load picked up in the middle', 'bag', (0.5, 2.0),
       'load_unknown payload_wrong payload_changed', model=True)
def picked(lab: Lab, column: int, size: float, random: Random) -> Lab:
    """Pick a load up [kg]."""
    row = round(random.uniform(0.35, 0.65) * len(lab.q))
    return with_tip_force(lab, slice(row, None), size, np.zeros(3))


@fault('somebody leans on the arm', 'bag', (30.0,), 'contact load_unknown', model=True)
def leans(lab: Lab, column: int, size: float, random: Random) -> Lab:
    """Push at the tip for 3 s [N]."""
    row = round(random.uniform(0.2, 0.6) * len(lab.q))
    axis = random.normal(size=3)
    return with_tip_force(lab, slice(row, row + round(3.0 / lab.dt)), 0.0,
                          size * axis / np.linalg.norm(axis))
