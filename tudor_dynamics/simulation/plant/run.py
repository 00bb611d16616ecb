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

"""Whole runs: drive a plant through given torques and keep what it shows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
import io
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from tudor_dynamics.errors import check_type, SimulationError, UsageError
from tudor_dynamics.files import write_whole
from tudor_dynamics.simulation.plant.inertial import InertialSensors
from tudor_dynamics.simulation.plant.outputs import Probe
from tudor_dynamics.simulation.plant.plant import Plant
from tudor_dynamics.typing import FloatArray

Motion = tuple[FloatArray, FloatArray, FloatArray]
LARGEST_ROTATION = 0.3
"""Elastic rotation up to which a beam bends as it should: a cantilever by 4 % too much [rad]."""
Integrator = Literal['generalised-alpha', 'radau', 'bdf']


class Steps(NamedTuple):
    """How far a run goes, in steps."""

    total: int  # steps of the run
    every: int  # steps between two records

    @classmethod
    def of(cls, seconds: float, dt: float, rate: float) -> Steps:
        """Count them: seconds, dt [s], rate [Hz]."""
        for name, value in (('seconds', seconds), ('dt', dt), ('rate', rate)):
            check_type(value, (int, float), name, 'a time [s] or a rate [Hz]')
            if not 0.0 < value < 1e9:
                msg = f'{name} (--{name}) must be positive, found {value}'
                raise UsageError(msg)
        return cls(max(int(round(seconds / dt)), 1), max(int(round(1.0 / (rate * dt))), 1))


@dataclass(frozen=True, eq=False)
class Run:
    """Recorded signals of a run."""

    t: FloatArray  # times of the records, (samples,) [s]
    # Joint motion and effort of each drive, (samples, joints) [rad or m, N m or N].
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    effort: FloatArray
    # Of all nodes in the base frame, (samples, points, 3).
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    # Internal loads, see `Observation`, (samples, sections, 3).
    force: FloatArray
    moment: FloatArray
    reaction: FloatArray  # of each joint, see `Observation`, (samples, joints, 6)
    # In the unit of each gauge, and, (samples, gauges) [N m].
    strain: FloatArray
    gauge_moment: FloatArray
    energy: FloatArray  # kinetic, elastic, gravitational, (samples, 3) [J]
    # (samples,): largest elastic rotation of a node in its link's frame [rad], see
    # `LARGEST_ROTATION`.
    rotation: FloatArray
    # (samples, sensors, 3, 3): axes of each inertial sensor in the base frame, see
    # `InertialSensors`.
    sensor_axes: FloatArray
    # (samples, sensors, 3): what each feels, in its axes: angular velocity [rad/s], acceleration
    # less gravity [m/s^2].
    sensor_turning: FloatArray
    sensor_acceleration: FloatArray

    def orientation(self, sensor: int) -> FloatArray:
        """Give the quaternions x, y, z, w of a sensor in the base frame, shape (n_samples, 4)."""
        return np.asarray(Rotation.from_matrix(self.sensor_axes[:, sensor]).as_quat())

    def __repr__(self) -> str:
        """Write the length, and the shape of each array."""
        shapes = ', '.join(f'{f.name} {getattr(self, f.name).shape}' for f in fields(self))
        return f'Run of {self.t[-1]:g} s: {shapes}'

    def save(self, path: Path, **more: NDArray) -> None:
        """Write all arrays to one ``.npz``, whole or not at all."""
        arrays = {f.name: getattr(self, f.name) for f in fields(self)} | more
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **arrays)
        write_whole(path, buffer.getvalue())


def largest_rotation(plant: Plant) -> float:
    """Give the largest elastic rotation of a node in its link's frame, now [rad]."""
    turned = plant.coordinates[plant.mechanism.rotations]
    return float(np.linalg.norm(turned, axis=1).max(initial=0.0))


def _empty(
    plant: Plant, probe: Probe, sensors: InertialSensors, samples: int,
) -> Run:
    shapes: dict[str, tuple[int, ...]] = {'t': (), 'energy': (3,), 'rotation': ()}
    shapes |= dict.fromkeys(('q', 'dq', 'ddq', 'effort'), (len(plant.mechanism.joints),))
    shapes |= dict.fromkeys(('position', 'velocity', 'acceleration'),
                            (plant.mechanism.points, 3))
    shapes['reaction'] = (len(plant.mechanism.joints), 6)
    shapes |= dict.fromkeys(('force', 'moment'), (len(probe.sections), 3))
    shapes |= dict.fromkeys(('strain', 'gauge_moment'), (len(probe.gauge_names),))
    shapes['sensor_axes'] = (len(sensors.names), 3, 3)
    shapes |= dict.fromkeys(('sensor_turning', 'sensor_acceleration'), (len(sensors.names), 3))
    return Run(**{name: np.zeros((samples, *shape)) for name, shape in shapes.items()})


def _record(
    run: Run, row: int, plant: Plant, probe: Probe, sensors: InertialSensors,
) -> None:
    state, seen = plant.state, probe.observe()
    felt, energy = sensors.feel(plant, seen.acceleration), plant.energy()
    run.t[row] = state.t
    run.q[row], run.dq[row], run.ddq[row] = state.q, state.dq, state.ddq
    run.effort[row] = state.effort
    run.position[row], run.velocity[row] = seen.position, seen.velocity
    run.acceleration[row] = seen.acceleration
    run.force[row], run.moment[row] = seen.force, seen.moment
    run.reaction[row] = seen.reaction
    run.strain[row], run.gauge_moment[row] = seen.strain, seen.gauge_moment
    run.energy[row] = energy.kinetic, energy.elastic, energy.gravity
    run.rotation[row] = largest_rotation(plant)
    run.sensor_axes[row], run.sensor_turning[row] = felt.axes, felt.angular_velocity
    run.sensor_acceleration[row] = felt.specific_force


def run_plant(
    plant: Plant, probe: Probe, torque: FloatArray, *, every: int = 1,
    motion: Motion | None = None, force: FloatArray | None = None,
    progress: Callable[[int], None] | None = None,
) -> Run:
    """
    Step a plant through given torques from its present state.

    torque (steps + 1, joints) [N m or N], motion (steps + 1, joints), force (steps + 1, 3) [N].
    """
    steps = torque.shape[0] - 1
    sensors = InertialSensors(plant.mechanism)
    run = _empty(plant, probe, sensors, steps // every + 1)
    _record(run, 0, plant, probe, sensors)
    told = 0
    for k in range(1, steps + 1):
        plant.step(torque[k], None if force is None else force[k],
                   None if motion is None else (motion[0][k], motion[1][k], motion[2][k]))
        if k % every == 0:
            _record(run, k // every, plant, probe, sensors)
        if progress is not None and (k - told >= 200 or k == steps):
            progress(k - told)
            told = k
    return run


def simulate_with_scipy(
    plant: Plant, probe: Probe, torque: FloatArray, *, every: int = 1,
    method: Integrator = 'radau', rtol: float = 1e-6,
    progress: Callable[[int], None] | None = None,
) -> Run:
    """Do the same with a solver of scipy, as a check of the integrator: slow, error controlled."""
    names: dict[str, str] = {'radau': 'Radau', 'bdf': 'BDF'}
    n, dt = plant.mechanism.size, plant.dt
    steps = torque.shape[0] - 1
    times = np.arange(steps + 1) * dt
    free = ~plant.prescribed
    z, dz = plant.coordinates.copy(), plant.rates.copy()
    count = int(free.sum())
    q_index = plant.mechanism.q_index

    def unpack(y: FloatArray) -> tuple[FloatArray, FloatArray]:
        place, rate = z.copy(), np.zeros(n)
        place[free], rate[free] = y[:count], y[count:]
        return place, rate

    def right_side(t: float, y: FloatArray) -> FloatArray:
        place, rate = unpack(y)
        k = min(int(t / dt), steps - 1)
        share = t / dt - k
        now = (1.0 - share) * torque[k] + share * torque[k + 1]
        return np.concatenate([y[count:], plant.solve_accelerations(place, rate, now)[free]])

    scale = np.where(np.isin(np.flatnonzero(free), q_index), 1.0, 0.01)
    atol = rtol * np.concatenate([scale, 10.0 * scale])
    wanted = times[::every]
    result = solve_ivp(right_side, (0.0, times[-1]), np.concatenate([z[free], dz[free]]),
                       method=names[method], t_eval=wanted, rtol=rtol, atol=atol,
                       max_step=max(20.0 * dt, 1e-3))
    if not result.success:
        reached = result.t[-1] if result.t.size else 0.0
        msg = f'{method} gave up at t = {reached:g} s: {result.message}'
        raise SimulationError(msg)
    sensors = InertialSensors(plant.mechanism)
    run = _empty(plant, probe, sensors, wanted.size)
    for row, t in enumerate(wanted):
        place, rate = unpack(result.y[:, row])
        plant.set_state(float(t), place, rate, torque[row * every])
        _record(run, row, plant, probe, sensors)
        if progress is not None:
            progress(every if row else 0)
    return run
