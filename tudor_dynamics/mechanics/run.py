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

"""Whole runs of a plant: outputs, inertial sensors, vibration modes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.compiled import compiled
from tudor_dynamics.errors import check_budget, check_type, SimulationError, UsageError
from tudor_dynamics.files import dump_npz, write_whole
from tudor_dynamics.mechanics import chain as at
from tudor_dynamics.mechanics.chain import (
    add, Chain, exponential, forward, left_jacobian, product, put_rotation, put_vector,
    rotation_at, sub, turn, turn_back, vector_at)
from tudor_dynamics.mechanics.equations import joint_reactions, LOADS, nodal_motion, section_loads
from tudor_dynamics.mechanics.mechanism import build_mechanism, Mechanism, place_gauge, with_motors
from tudor_dynamics.mechanics.plant import Plant
from tudor_dynamics.typing import FloatArray, Shown


# -- What a run shows: motion of nodes, internal loads anywhere along a beam, surface strain

@dataclass(frozen=True, eq=False)
class ProbeReading:
    """What ``Probe.observe`` saw; arrays are overwritten by the next call."""

    # In the base frame, (points, 3) [m, m/s, m/s^2].
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    # (sections, 3): normal and shear forces [N]; torsion and bending moments about the section's y
    # and z [N m], of the outboard part on the inboard one.
    force: FloatArray
    moment: FloatArray
    # Force and moment that each joint transmits to the links it carries, about the joint and in
    # the base frame; the moment about its axis includes the drive's, (joints, 6) [N, N m].
    reaction: FloatArray
    strain: FloatArray  # (gauges,): in the unit of each gauge; um/m where that is a voltage
    # Bending moment at each gauge, positive for the load that the joint holds, (gauges,) [N m].
    gauge_moment: FloatArray


class Probe:
    """Nodal motion, internal loads [N, N m] and strains of a plant, by default amid each beam."""

    def __init__(self, plant: Plant, sections: Sequence[tuple[str, float]] | None = None,
                 arm: Arm | None = None) -> None:
        self.plant = plant
        mechanism = plant.mechanism
        places = [(joint, 0.5 * mechanism.length(joint))
                  for joint in mechanism.beams] if sections is None else list(sections)
        count, gauges = len(places), arm.gauges if arm is not None else ()
        self.gains = np.zeros((len(gauges), 3))
        if arm is not None:
            places += [self._gauge(arm, number) for number in range(len(gauges))]
        for joint, distance in places:
            if joint not in mechanism.beams:
                raise SimulationError(
                    f'arm {mechanism.name!r}: joint {joint!r} has no beam; choose a joint that '
                    f'has one, of {list(mechanism.beams)}')
            length = mechanism.length(joint)
            if not -1e-9 <= distance <= length + 1e-9:
                raise SimulationError(
                    f'arm {mechanism.name!r}: a place at {distance:g} m is outside the beam of '
                    f'{joint!r}; give one from 0 to {length:g} m')
        self.bodies = np.array([mechanism.body_of[joint] for joint, _ in places], dtype=np.int64)
        self.places = np.array([distance for _, distance in places], dtype=float)
        self.loads = np.zeros((len(places), LOADS))
        self._points = np.zeros((3, mechanism.points, 3))
        self._force = np.zeros(mechanism.size)
        self._gauge_loads = self.loads[count:]
        # plain numbers: those of numpy take longer than the mechanics
        self._gauge_gains = [
            (per_moment, per_rate, int(axis), math.copysign(1.0, per_moment))
            for per_moment, per_rate, axis in self.gains.tolist()]
        position, velocity, acceleration = self._points
        self.observation = ProbeReading(
            position, velocity, acceleration, self.loads[:count, :3], self.loads[:count, 3:6],
            np.zeros((len(mechanism.joints), 6)), np.zeros(len(gauges)), np.zeros(len(gauges)))

    def observe(self) -> ProbeReading:
        """Look at the present state of the plant."""
        plant = self.plant
        z, dz, ddz = plant.tables.vectors[:3]
        chain, seen = plant.tables.chain, self.observation
        joint_reactions(z, dz, ddz, chain, plant.loaded, self._force, plant.bodies, seen.reaction)
        section_loads(z, dz, ddz, chain, self.bodies, self.places, self.loads)
        forward(z, dz, ddz, chain, 0.0)
        nodal_motion(z, dz, ddz, plant.mechanism.gravity, chain, *self._points)
        for number, (per_moment, per_rate, axis, sign) in enumerate(self._gauge_gains):
            row = self._gauge_loads[number]
            moment = row[3 + axis]
            seen.strain[number] = per_moment * moment + per_rate * row[6 + axis]
            seen.gauge_moment[number] = sign * moment
        return self.observation

    def _gauge(self, arm: Arm, number: int) -> tuple[str, float]:
        gauge, mechanism = arm.gauges[number], self.plant.mechanism
        place = place_gauge(mechanism, arm, gauge)
        beam, sign = mechanism.beams[gauge.joint], place.sign
        if gauge.unit == 'N m':
            self.gains[number] = sign, 0.0, place.axis
        else:
            surface = beam.surface_y if place.axis == 2 else beam.surface_z
            scale = 1.0 if gauge.unit == 'm/m' else 1e6
            beta = mechanism.body_float[place.body, at.BETA]
            self.gains[number] = (sign * scale * surface / place.bending,
                                  -sign * scale * surface * beta, place.axis)
        return gauge.joint, place.distance


# -- Inertial sensors on a mechanism: at the far end of each beam and at the tip

TIP = 'tip'


@compiled
def read_inertial(
    z: NDArray, dz: NDArray, gravity: NDArray, chain: Chain, bodies: NDArray, nodes: NDArray,
    acceleration: NDArray, axes: NDArray, turning: NDArray, force: NDArray,
) -> None:
    """Give axes, angular velocity and specific force of nodes, after ``nodal_motion``."""
    body_int, moving = chain.body_int, chain.moving
    for s in range(bodies.shape[0]):
        here = moving[bodies[s]]
        frame, omega = rotation_at(here, at.WORLD), vector_at(here, at.OMEGA)
        if nodes[s] > 0:
            k = body_int[bodies[s], at.FIRST] + 6 * (nodes[s] - 1) + 3
            theta = vector_at(z, k)
            turned = exponential(theta)
            omega = turn_back(turned, add(omega, turn(left_jacobian(theta), vector_at(dz, k))))
            frame = product(frame, turned)
        point = body_int[bodies[s], at.POINT] + nodes[s]
        put_rotation(axes[s], 0, frame)
        put_vector(turning[s], 0, omega)
        put_vector(force[s], 0, turn_back(
            frame, sub(vector_at(acceleration[point], 0), vector_at(gravity, 0))))


def _tip(mechanism: Mechanism) -> int:
    """Give the point at the tip: the node that carries a payload where it sits right on it."""
    body = mechanism.body_at(mechanism.tip)
    row, place = mechanism.body_int[body], mechanism.body_float[body, at.JOINT_PLACE:][:3]
    if row[at.JOINT] == at.WELD and row[at.NODE] > 0 and np.linalg.norm(place) < 1e-9:
        return int(mechanism.body_int[row[at.PARENT], at.POINT] + row[at.NODE])
    return mechanism.tip


class InertialSensors:
    """Sensors at the far end of each beam, in its axes, x along it, and at the tip, in its own."""

    def __init__(self, mechanism: Mechanism) -> None:
        points = {mechanism.point(joint): joint for joint in mechanism.beams}
        points[_tip(mechanism)] = TIP  # in place of the last beam where that ends there
        self.names = tuple(points.values())  # joints before the beams
        self._bodies = np.array([mechanism.body_at(point) for point in points])
        self._nodes = np.array(list(points)) - mechanism.body_int[self._bodies, at.POINT]
        count = len(self.names)
        self._axes, self._turning, self._force = (
            np.zeros((count, *shape)) for shape in ((3, 3), (3,), (3,)))

    def read(self, plant: Plant, acceleration: FloatArray) -> dict[str, FloatArray]:
        """Measure after ``Probe.observe`` (points, 3) [m/s^2]; by the fields of `PlantRecord`."""
        read_inertial(
            plant.coordinates, plant.rates, plant.mechanism.gravity, plant.tables.chain,
            self._bodies, self._nodes, acceleration, self._axes.reshape(-1, 9), self._turning,
            self._force)
        return {'sensor_axes': self._axes, 'sensor_turning': self._turning,
                'sensor_acceleration': self._force}


# -- Eigenfrequencies and mode shapes of a mechanism, joints held or free

@dataclass(frozen=True, eq=False)
class Modes(Shown):
    """Small vibrations about a configuration."""

    # Undamped frequencies, ascending; negative where gravity makes the state unstable, (modes,)
    # [Hz].
    frequency: FloatArray
    # (modes,): damping ratios by Rayleigh damping and joint damping (its diagonal part).
    damping: FloatArray
    shape: FloatArray  # (modes, n): coordinates, mass-normalised; zero at joints that are held

    def __repr__(self) -> str:
        """Write frequency and damping ratio, one line a mode."""
        return '\n'.join(['Modes', *(
            f'  {number}: {hertz:.3f} Hz, {100.0 * ratio:.2f} % of critical damping'
            for number, (hertz, ratio) in enumerate(
                zip(self.frequency, self.damping, strict=True), start=1))])


def modes(plant: Plant | Arm, count: int = 8, free_joints: Sequence[str] = ()) -> Modes:
    """
    Solve the eigenvalue problem at the plant's present configuration.

    Parameters
    ----------
    plant : Plant or Arm
        Plant at the configuration wanted, or an arm with ``links`` where its description starts.
    count : int
        Largest number of modes.
    free_joints : sequence of str
        Joints that move freely; the others are held.

    Raises
    ------
    SimulationError
        If nothing can vibrate, or there is no such joint.

    """
    if isinstance(plant, Arm):
        plant = Plant(build_mechanism(with_motors(plant)))
    check_type(plant, Plant, 'plant', 'Plant(build_mechanism(arm)), or the arm itself')
    mechanism = plant.mechanism
    unknown = [name for name in free_joints if name not in mechanism.joints]
    if unknown or count < 1:
        raise SimulationError(f'no joints {unknown}; free some of {list(mechanism.joints)}'
                              if unknown else f'{count} modes; give a count of 1 or more')
    free = mechanism.elastic.copy()
    for joint in free_joints:
        free[mechanism.q_index[mechanism.joints.index(joint)]] = True
    index = np.flatnonzero(free)
    if index.size == 0:
        msg = f'arm {mechanism.name!r}: nothing can vibrate: all links are rigid, all joints held'
        raise SimulationError(msg)
    pick = np.ix_(index, index)
    z, zero = plant.coordinates.copy(), np.zeros(mechanism.size)

    def slopes(step: float, force: Callable[[FloatArray], FloatArray]) -> FloatArray:
        return np.array([(force(step * unit) - force(-step * unit)) / (2.0 * step)
                         for unit in np.eye(len(z))])
    # Differences for gravity alone: those of the stiffness would drown in its large numbers.
    weight = slopes(1e-6, lambda change: plant.imbalance(z + change, zero, zero, elastic=False))
    stiffness = plant.bent_stiffness() + 0.5 * (weight + weight.T)
    # What is quadratic in the rates cancels.
    damping = slopes(1.0, lambda rate: plant.imbalance(z, rate, zero)).T
    try:
        values, vectors = eigh(stiffness[pick], plant.mass_matrix()[pick])
    except np.linalg.LinAlgError:
        msg = (f'arm {mechanism.name!r}: the mass matrix is singular with the joints '
               f'{list(free_joints)} free; give their links a mass, or a hub_inertia')
        raise SimulationError(msg) from None
    count = min(count, index.size)
    values, vectors = values[:count], vectors[:, :count]
    omega = np.sign(values) * np.sqrt(np.abs(values))
    modal = np.einsum('im,ij,jm->m', vectors, damping[pick], vectors)
    # Below a millionth of a hertz a mode is a rigid motion.
    omega[np.abs(omega) < 1e-3] = 0.0
    ratio = np.divide(modal, 2.0 * omega, out=np.zeros(count), where=omega > 0.0)
    shape = np.zeros((count, mechanism.size))
    shape[:, index] = vectors.T
    return Modes(omega / (2.0 * np.pi), ratio, shape)


# -- Whole runs: drive a plant through given torques and keep what it shows

FIRST_STAMP = 1_000_000_000
"""Stamp of t = 0 in bags [ns]: a stamp of zero would mean "not set" in ROS."""
Motion = tuple[FloatArray, FloatArray, FloatArray]


def count_steps(seconds: float, dt: float, rate: float) -> tuple[int, int]:
    """Count the steps of a run, and those between two records: seconds, dt [s], rate [Hz]."""
    for name, value in (('seconds', seconds), ('dt', dt), ('rate', rate)):
        check_type(value, (int, float), name, 'a time [s] or a rate [Hz]')
        if not 0.0 < value < 1e9:
            raise UsageError(f'{name}= {value}: give a number above 0 and below 1e9')
    check_budget(f'a run of {seconds:g} s at steps of {dt:g} s', seconds / dt)
    total = max(int(round(seconds / dt)), 1)
    return total, max(int(round(1.0 / (rate * dt))), 1) if rate * dt > 1e-9 else 2 * total


@dataclass(frozen=True, eq=False, repr=False)
class PlantRecord(Shown):
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
    # Internal loads, see `ProbeReading`, (samples, sections, 3).
    force: FloatArray
    moment: FloatArray
    reaction: FloatArray  # of each joint, see `ProbeReading`, (samples, joints, 6)
    # In the unit of each gauge, and, (samples, gauges) [N m].
    strain: FloatArray
    gauge_moment: FloatArray
    energy: FloatArray  # kinetic, elastic, gravitational, (samples, 3) [J]
    # (samples,): largest elastic rotation of a node in its link's frame [rad], see
    # `settings.LARGEST_ROTATION`.
    rotation: FloatArray
    # (samples, sensors, 3, 3): axes of each inertial sensor in the base frame, as columns, see
    # `InertialSensors`.
    sensor_axes: FloatArray
    # (samples, sensors, 3): what each measures, in its axes: angular velocity [rad/s],
    # acceleration less gravity [m/s^2].
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
        write_whole(path, dump_npz(arrays, small=True))


def largest_rotation(plant: Plant) -> float:
    """Give the largest elastic rotation of a node in its link's frame, now [rad]."""
    turned = plant.coordinates[plant.mechanism.rotations]
    return float(np.linalg.norm(turned, axis=1).max(initial=0.0))


def run_plant(
    plant: Plant, probe: Probe, torque: FloatArray, *, every: int = 1,
    motion: Motion | None = None, force: FloatArray | None = None,
    progress: Callable[[int], None] | None = None,
) -> PlantRecord:
    """Step a plant through torques (steps + 1, joints) [N m or N] from its present state."""
    steps, sensors, reported = torque.shape[0] - 1, InertialSensors(plant.mechanism), 0
    samples = steps // every + 1

    def look() -> dict[str, Any]:
        seen = probe.observe()
        return {**vars(plant.state), **vars(seen), **sensors.read(plant, seen.acceleration),
                'energy': plant.energy(), 'rotation': largest_rotation(plant)}
    shown = {name: np.shape(value) for name, value in look().items()}
    check_budget('recording the run', samples, 8.0 * sum(map(math.prod, shown.values())),
                 'lower seconds= or rate=')
    run = PlantRecord(**{name: np.zeros((samples, *shape)) for name, shape in shown.items()})
    for k in range(steps + 1):
        if k > 0:
            plant.step(torque[k], None if force is None else force[k],
                       None if motion is None else (motion[0][k], motion[1][k], motion[2][k]))
        if k % every == 0:
            for name, value in look().items():
                getattr(run, name)[k // every] = value
        if progress is not None and (k - reported >= 200 or k == steps):
            progress(k - reported)
            reported = k
    return run
