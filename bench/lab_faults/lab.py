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
A recording that faults are put into: its signals with the stamps of each stream, and its bag.

Whether a fault can show at all is decided here, by physics and never by what is said of it: rigid
bodies with viscous and Coulomb friction are fitted by least squares to the recording as it is and
to the faulty one, each by its own parameters. A fault that parameters absorb (the zero of the last
joint, gears of one axis) leaves no larger residual, and nothing could tell it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
import pinocchio as pin
from scipy.signal import butter, sosfiltfilt
from tudor_dynamics.arm.description import Arm, by_topic, load_arm
from tudor_dynamics.bags.messages import joint_signals
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.bags.writer import encode, write_bag
import yaml

GROWTH = 1.25  # of a channel's residual, above which a fault can show
LEAST_GROWTH = 0.01  # of the channel's own range of values, in standard deviations
EXPLAINED = 0.7  # residual over standard deviation, above which a channel shows nothing
FASTEST = 250.0  # rate that is kept of faster recordings, by leaving samples out [Hz]
ROWS = 700  # of the regression
MOVES = {False: 0.05, True: 0.01}  # [rad], [m]
STREAMS = ('joints', 'effort', 'strain')

Stamps = NDArray[np.int64]
Floats = NDArray[np.float64]


class CannotShowError(Exception):
    """A fault that cannot show in this recording, and why."""


@dataclass(frozen=True, eq=False)
class Lab:
    """Signals of a bag, the stamps of its streams, and the description that goes with it."""

    name: str
    arm: Arm
    content: dict[str, Any]  # the description as it is written
    q: Floats
    dq: Floats | None
    effort: Floats | None
    strain: Floats | None
    stamps: dict[str, Stamps]  # of each stream, as its messages say [ns]
    payload: float | None = None
    # Times at which messages were recorded, where other than their stamps [ns].
    logs: dict[str, Stamps] = field(default_factory=dict)
    kept: dict[str, NDArray[np.bool_]] = field(default_factory=dict)  # messages that are not lost

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints that are measured."""
        return self.arm.active_joints

    @property
    def gauges(self) -> tuple[str, ...]:
        """Names of the gauges."""
        return self.arm.gauge_names

    @cached_property
    def t(self) -> Floats:
        """Time of the joint states [s]."""
        stamp = self.stamps['joints']
        return np.asarray((stamp - stamp[0]) * 1e-9)

    @property
    def dt(self) -> float:
        """Median sample time [s]."""
        return float(np.median(np.diff(self.t)))

    @cached_property
    def moving(self) -> list[int]:
        """Joints that move."""
        spans = np.ptp(np.percentile(self.q, [1, 99], axis=0), axis=0)
        return [k for k, (name, span) in enumerate(zip(self.joints, spans, strict=True))
                if span > MOVES[self.arm.is_prismatic(name)]]

    def stream(self, values: Floats, stream: str) -> Floats:
        """Bring a stream onto the stamps of the joint states."""
        if self.stamps[stream] is self.stamps['joints']:
            return values
        order = np.argsort(self.stamps[stream], kind='stable')
        at, own = self.stamps['joints'].astype(float), self.stamps[stream].astype(float)
        return np.column_stack([np.interp(at, own[order], column[order]) for column in values.T])

    @cached_property
    def explained(self) -> Explained:
        """Fit rigid bodies with friction to it, once."""
        return explain(self)

    def at(self, rows: Any) -> Lab:
        """Give some of the samples, whose streams have the same stamps."""
        def cut(values: Any) -> Any:
            return None if values is None else values[rows]
        stamp = self.stamps['joints'][rows]
        return replace(self, q=self.q[rows], dq=cut(self.dq), effort=cut(self.effort),
                       strain=cut(self.strain), stamps=dict.fromkeys(STREAMS, stamp))

    def of_joint_topic(self) -> bool:
        """Say whether efforts stand in the messages of the positions."""
        return all(joint.effort.topic == self.arm.spec.joint_topic for joint in self.arm.joints)

    def write(self, folder: Path) -> tuple[Path, Path]:
        """Write bag and description."""
        description, bag = folder / 'arm.yaml', folder / 'bag'
        description.write_text(yaml.safe_dump(self.content))
        custom = {} if self.payload is None else {'payload': f'{self.payload:g}'}
        series = []
        own, apart = None, []
        if self.effort is not None:
            for topic, chosen in by_topic(joint.effort for joint in self.arm.joints).items():
                if topic == self.arm.spec.joint_topic:
                    values = self.stream(self.effort, 'effort')
                    own = np.full(values.shape, np.nan)
                    own[:, chosen] = values[:, chosen]
                else:
                    names = [self.joints[i] for i in chosen]
                    apart.append(('effort', joint_signals(
                        f'/{topic}', self.stamps['effort'], names,
                        effort=self.effort[:, chosen])))
        series.append(('joints', joint_signals(
            f'/{self.arm.spec.joint_topic}', self.stamps['joints'], self.joints, self.q, self.dq,
            own)))
        series += apart
        if self.strain is not None:
            for topic, chosen in by_topic(self.arm.gauges).items():
                series.append(('strain', joint_signals(
                    f'/{topic}', self.stamps['strain'], [self.gauges[i] for i in chosen],
                    self.strain[:, chosen])))
        raw = []
        for stream, signals in series:
            messages = encode(signals)
            log = self.logs.get(stream, messages.log_time)
            keep = np.flatnonzero(self.kept.get(stream, np.ones(len(log), dtype=bool)))
            raw.append(replace(messages, log_time=log[keep],
                               data=[messages.data[row] for row in keep]))
        write_bag(bag, raw, custom=custom)
        return bag, description

    def part(self, begin: float, end: float) -> Lab:
        """Give a part, by shares of its length."""
        count = len(self.q)
        return self.at(slice(round(begin * count), round(end * count)))


def read_lab(name: str, bag: Path, description: Path | dict[str, Any], folder: Path,
             seconds: float) -> Lab:
    """Read the first seconds of a bag, at 250 Hz or less, with a description or its path."""
    content, base = description, folder
    if isinstance(description, Path):
        content, base = yaml.safe_load(description.read_text()), description.parent
    assert isinstance(content, dict)
    kinematics = content['kinematics']
    if 'urdf' in kinematics:
        content = content | {'kinematics': kinematics | {
            'urdf': str((base / kinematics['urdf']).absolute())}}
    path = folder / 'clean.yaml'
    path.write_text(yaml.safe_dump(content))
    arm = load_arm(path)
    recording = read_recording(bag, arm)
    rows = recording.t <= seconds
    columns = [values for values in (recording.effort, recording.strain) if values is not None]
    for values in columns:
        rows &= np.isfinite(values).all(axis=1)
    step = max(1, round(1.0 / (FASTEST * recording.dt)))
    rows = np.flatnonzero(rows)[::step]
    stamp = recording.stamp[rows]

    def cut(values: Floats | None) -> Floats | None:
        return None if values is None else np.array(values[rows])
    return Lab(name, arm, content, np.array(recording.q[rows]), cut(recording.dq),
               cut(recording.effort), cut(recording.strain), dict.fromkeys(STREAMS, stamp),
               recording.payload)


def vertical(lab: Lab, joint: int) -> float:
    """Give the median sine of the angle between a joint's axis and gravity; 0 if it slides."""
    if lab.arm.is_prismatic(lab.joints[joint]):
        return 0.0
    model, data = lab.arm.model, lab.arm.model.createData()
    gravity = np.array(lab.arm.spec.gravity, dtype=float)
    if not gravity.any():
        return 0.0
    order = lab.arm.velocity_index
    sines = []
    for row in np.linspace(0, len(lab.q) - 1, 20).astype(int):
        pin.computeJointJacobians(model, data, _configuration(model, order, lab.q[row]))
        number = next(i for i in range(1, model.njoints)
                      if model.joints[i].idx_v == order[joint])
        axis = pin.getJointJacobian(model, data, number, pin.WORLD)[3:, order[joint]]
        sines.append(np.linalg.norm(np.cross(axis, gravity)) / np.linalg.norm(gravity))
    return float(np.median(sines))


def _configuration(model: pin.Model, order: Any, values: Floats) -> Floats:
    tangent = np.zeros(model.nv)
    tangent[order] = values
    return pin.integrate(model, pin.neutral(model), tangent)


@dataclass(frozen=True)
class Explained:
    """What rigid bodies with friction leave of each channel, and what friction takes."""

    residual: dict[str, float]  # over the channel's standard deviation
    friction: dict[str, float]  # its part, over the same; negative where it would drive


def explain(lab: Lab) -> Explained:
    """Fit rigid bodies with friction to a recording."""
    arm, model = lab.arm, lab.arm.model
    data, order = model.createData(), lab.arm.velocity_index
    model.gravity.linear = np.array(arm.spec.gravity, dtype=float)
    t, dt = lab.t, lab.dt
    grid = np.arange(t[0], t[-1], dt)

    def even(values: Floats) -> Floats:
        table = np.column_stack([np.interp(grid, t, column) for column in values.T])
        low = butter(2, min(8.0, 0.2 / dt) * 2 * dt, output='sos')
        return sosfiltfilt(low, np.where(np.isfinite(table), table, 0.0), axis=0)
    q = even(lab.q)
    dq = np.gradient(q, dt, axis=0)
    ddq = np.gradient(dq, dt, axis=0)
    margin = round(0.3 / dt)
    starts = [(lab.stamps[stream][[0, -1]] - lab.stamps['joints'][0]) * 1e-9 for stream in STREAMS]
    first, last = (np.searchsorted(grid, pick(edges)) for pick, edges in zip(
        (max, min), zip(*starts, strict=True), strict=True))
    rows = np.linspace(first + margin, min(last, len(grid)) - margin - 1,
                       min(ROWS, len(grid) // 4)).astype(int)
    coupling = np.eye(len(lab.joints)) if arm.coupling is None else arm.coupling
    speeds, turns = dq[rows] @ coupling.T, ddq[rows] @ coupling.T
    bodies = np.empty((len(rows), len(lab.joints), 10 * (model.njoints - 1)))
    for place, row in enumerate(rows):
        v, a = np.zeros(model.nv), np.zeros(model.nv)
        v[order], a[order] = dq[row], ddq[row]
        bodies[place] = pin.computeJointTorqueRegressor(
            model, data, _configuration(model, order, q[row]), v, a)[order]
    residual, friction = {}, {}
    if lab.effort is not None:
        efforts = even(lab.stream(lab.effort, 'effort'))[rows]
        drives = []
        for k in range(len(lab.joints)):
            motors = np.flatnonzero(coupling[:, k])
            scale = 0.02 * np.abs(speeds[:, motors]).max(axis=0) + 1e-9
            drives.append(np.column_stack([
                speeds[:, motors], np.tanh(speeds[:, motors] / scale), turns[:, motors],
                np.ones(len(rows))]))
        units = {str(joint.effort.unit) for joint in arm.joints}
        shared = 'A' not in units
        results = _shared(bodies, drives, efforts) if shared else [
            _channel(bodies[:, k], drives[k], efforts[:, k]) for k in range(len(lab.joints))]
        for k, (left, rubs) in enumerate(results):
            deviation = float(efforts[:, k].std()) or 1e-12
            residual[lab.joints[k]] = float(left.std()) / deviation
            dissipated = float(np.mean(rubs * speeds[:, k]))
            friction[lab.joints[k]] = float(rubs.std()) / deviation * (-1.0, 1.0)[dissipated > 0]
    if lab.strain is not None:
        strains = even(lab.stream(lab.strain, 'strain'))[rows]
        for g, gauge in enumerate(arm.gauges):
            k = lab.joints.index(gauge.joint)
            left, _ = _channel(bodies[:, k], np.ones((len(rows), 1)), strains[:, g])
            residual[gauge.name] = float(left.std()) / (float(strains[:, g].std()) or 1e-12)
    return Explained(residual, friction)


def _solve(table: Floats, values: Floats) -> Floats:
    size = np.linalg.norm(table, axis=0) + 1e-12
    return np.linalg.lstsq(table / size, values, rcond=1e-7)[0] / size


def _channel(bodies: Floats, drive: Floats, values: Floats) -> tuple[Floats, Floats]:
    table = np.column_stack([bodies, drive])
    solution = _solve(table, values)
    count = bodies.shape[1]
    rubs = (drive.shape[1] - 1) * 2 // 3  # viscous and Coulomb
    return (values - table @ solution,
            drive[:, :rubs] @ solution[count:count + rubs])


def _shared(
    bodies: Floats, drives: Sequence[Floats], values: Floats,
) -> list[tuple[Floats, Floats]]:
    weights = 1.0 / (values.std(axis=0) + 1e-9)
    widths = [drive.shape[1] for drive in drives]
    starts = bodies.shape[2] + np.concatenate([[0], np.cumsum(widths)])
    tables = []
    for k, drive in enumerate(drives):
        table = np.zeros((len(bodies), starts[-1]))
        table[:, :bodies.shape[2]] = bodies[:, k]
        table[:, starts[k]:starts[k + 1]] = drive
        tables.append(table)
    solution = _solve(np.concatenate([table * weight for table, weight in zip(
        tables, weights, strict=True)]), np.concatenate(list((values * weights).T)))
    results = []
    for k, table in enumerate(tables):
        rubs = (widths[k] - 1) * 2 // 3
        part = drives[k][:, :rubs] @ solution[starts[k]:starts[k] + rubs]
        results.append((values[:, k] - table @ solution, part))
    return results


def growth(clean: Explained, faulty: Explained) -> float:
    """Say by how much the residual of some channel grows; 1 where it does in none."""
    ratios = [faulty.residual[name] / max(left, 1e-9) for name, left in clean.residual.items()
              if left < EXPLAINED and faulty.residual[name] - left > LEAST_GROWTH]
    return max(ratios, default=1.0)
