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

"""The arm in closed loop, compiled: sensors, controller, drives and plant at the damper's rate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import accumulate, pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.limits import drive_stop, hard_limits
from tudor_dynamics.compiled import compiled, unowned
from tudor_dynamics.control.cascade import (
    arm_gains, Cascade, CUT, envelope_law, POSITION_GAIN, position_law, SATURATED, SATURATING,
    velocity_lag, velocity_law)
from tudor_dynamics.control.damper import (
    arm_damping, Damper, damper_law, moving_share, STATUS, Status)
from tudor_dynamics.errors import MAX_STEPS, SimulationError
from tudor_dynamics.mechanics import chain as at, hardware as dr, integrator as gen, settings
from tudor_dynamics.mechanics.equations import inverse_dynamics, section_loads
from tudor_dynamics.mechanics.hardware import (
    add_pushes_to_sections, drive_row, drive_sensor_row, Floor, floor_row, gauge_rows,
    Imperfections, press, Push, push_table, put_pushes, with_payload)
from tudor_dynamics.mechanics.integrator import PlantTables
from tudor_dynamics.mechanics.mechanism import build_mechanism
from tudor_dynamics.mechanics.plant import Plant
from tudor_dynamics.mechanics.run import Probe
from tudor_dynamics.signals.filters import low_pass_gain
from tudor_dynamics.signals.motion_profile import motion_limits
from tudor_dynamics.typing import finite_array, FloatArray, Shown


# -- One step after another, compiled.
#
# The laws are those of ``control`` and of the other modules of this room; here they only follow
# each other: readings at the start of a step, current from them, rotor and link to its end.

class DrivenPlant(NamedTuple):
    """Tables of a plant, coordinates of the driven joints, forces that stay, pushes, floor."""

    tables: PlantTables
    driven: NDArray
    external: NDArray
    force: NDArray
    pushes: NDArray
    floor: NDArray


class SensorTables(NamedTuple):
    """Drives with their sensors, gauges with their sections; readings of the present step."""

    drive: NDArray
    drive_state: NDArray
    sensor: NDArray
    gauge: NDArray
    bodies: NDArray
    places: NDArray
    loads: NDArray
    velocity_share: float
    angle: NDArray
    speed: NDArray
    current: NDArray
    strain: NDArray


class ControlTables(NamedTuple):
    """Cascade, envelope and damper."""

    gains: NDArray
    state: NDArray
    envelope: NDArray
    envelope_state: NDArray
    damper: NDArray
    damper_state: NDArray
    past: NDArray
    joint: NDArray
    gauge: NDArray
    yielding: NDArray
    status_time: NDArray
    planned_speed: NDArray


@compiled
def sense(
    plant: DrivenPlant, sensors: SensorTables, noise: NDArray, t: float, dt: float, loaded: bool,
) -> None:
    """Read all sensors at the present state, at the time t."""
    v, chain = plant.tables.vectors, plant.tables.chain
    inverse_dynamics(v[gen.Z], v[gen.DZ], v[gen.DDZ], chain, loaded, 1.0, plant.force)
    section_loads(v[gen.Z], v[gen.DZ], v[gen.DDZ], chain, sensors.bodies, sensors.places,
                  sensors.loads)
    add_pushes_to_sections(plant.pushes, t, chain, sensors.bodies, sensors.places, sensors.loads)
    joints = plant.driven.shape[0]
    for j in range(joints):
        row = sensors.sensor[j]
        angle = dr.encoder_reading(
            row, sensors.drive_state[j, dr.ANGLE], v[gen.Z, plant.driven[j]])
        quotient = (angle - sensors.angle[j]) / dt
        sensors.speed[j] += sensors.velocity_share * (quotient - sensors.speed[j])
        sensors.angle[j] = angle
        sensors.current[j] = dr.current_reading(
            row, sensors.drive_state[j, dr.CURRENT], sensors.drive_state[j, dr.ANGLE], noise[j])
    for g in range(sensors.gauge.shape[0]):
        sensors.strain[g] = dr.gauge_reading(sensors.gauge[g], sensors.loads[g], noise[joints + g])


@compiled
def control(
    sensors: SensorTables, tables: ControlTables, dt: float, q_ref: NDArray, dq_ref: NDArray,
    ahead: NDArray,
) -> None:
    """Run damper, envelope and cascade on the readings, then the rotors with the currents."""
    tables.yielding[:] = 0.0
    moving = moving_share(dq_ref, tables.planned_speed)
    for i in range(tables.joint.shape[0]):
        j = tables.joint[i]
        limited = (tables.state[j, SATURATED] > 0.0
                   or int(tables.envelope_state[j, CUT]) & SATURATING > 0
                   or sensors.drive_state[j, dr.LIMITED] > 0.0)
        tables.yielding[j] += damper_law(
            tables.damper[i], tables.damper_state[i], tables.past[i], dt,
            sensors.strain[tables.gauge[i]], True, limited, moving)
        tables.status_time[i, int(tables.damper_state[i, STATUS])] += dt
    for j in range(tables.yielding.shape[0]):
        wanted = position_law(
            tables.gains[j], q_ref[j], dq_ref[j], sensors.angle[j], tables.yielding[j])
        speed = envelope_law(
            tables.envelope[j], tables.envelope_state[j], dt, wanted, sensors.angle[j])
        current = velocity_law(
            tables.gains[j], tables.state[j], dt, speed, sensors.speed[j], ahead[j])
        dr.rotor_law(sensors.drive[j], sensors.drive_state[j], dt, current)


@compiled
def advance(
    plant: DrivenPlant, sensors: SensorTables, t: float, dt: float, loaded: bool,
) -> tuple[int, bool]:
    """Advance the links to the time t; give the status and whether forces act there."""
    body = plant.tables
    for row in range(body.chain.wrench.shape[0]):
        for i in range(6):
            body.chain.wrench[row, i] = plant.external[row, i]
    acting = put_pushes(plant.pushes, t, body.chain) or loaded
    v = body.vectors
    acting = press(plant.floor, v[gen.Z], v[gen.DZ], body.chain, dt) or acting
    for j in range(plant.driven.shape[0]):
        i = plant.driven[j]
        body.torque[i] = dr.gear_push(
            sensors.drive[j], sensors.drive_state[j], dt, v[gen.Z, i], v[gen.DZ, i])
    status = gen.step(body, acting)
    for j in range(plant.driven.shape[0]):
        i = plant.driven[j]
        row = sensors.drive[j]
        sensors.drive_state[j, dr.GEAR] = (
            body.torque[i] - row[dr.GEAR_STIFFNESS] * v[gen.Z, i] - row[dr.DAMPING] * v[gen.DZ, i])
    return status, acting


@compiled
def run_loop(
    plant: DrivenPlant, sensors: SensorTables, tables: ControlTables, wanted: NDArray,
    noise: NDArray, done: int, dt: float, every: int, acting: bool, loaded: bool, out: NDArray,
) -> tuple[int, int, bool]:
    """Run as many steps as there are references, (3, steps, joints): place, speed, current."""
    plant, sensors, tables = unowned((plant, sensors, tables))
    joints, gauges = plant.driven.shape[0], sensors.gauge.shape[0]
    record = 0
    q_ref, dq_ref, ahead = wanted[0], wanted[1], wanted[2]
    for k in range(q_ref.shape[0]):
        sense(plant, sensors, noise[k], (done + k) * dt, dt, acting)
        if (done + k) % every == 0:
            row = out[record]
            for j in range(joints):
                row[j], row[joints + j] = sensors.angle[j], sensors.speed[j]
                row[2 * joints + j] = sensors.current[j]
                row[3 * joints + gauges + j] = q_ref[k, j]
                row[4 * joints + gauges + j] = dq_ref[k, j]
                row[5 * joints + gauges + j] = plant.tables.vectors[gen.Z, plant.driven[j]]
            for g in range(gauges):
                row[3 * joints + g] = sensors.strain[g]
            record += 1
        control(sensors, tables, dt, q_ref[k], dq_ref[k], ahead[k])
        status, acting = advance(plant, sensors, (done + k + 1) * dt, dt, loaded)
        if status != gen.OK:
            return k, status, acting
    return q_ref.shape[0], gen.OK, acting


# -- The arm with the state of all its parts.
#
# ``run`` takes a whole reference and is compiled from end to end; ``step`` is the same for one
# step, for a process that gets its references one by one.

CHUNK = 2000  # steps between two looks from outside


@dataclass(frozen=True, eq=False, repr=False)
class LoopRecord(Shown):
    """Readings and truth of one ``run``, at the times of its samples."""

    t: FloatArray  # times of the samples, (samples,) [s]
    # As measured at the motors, (samples, joints) [rad, rad/s, A].
    q: FloatArray
    dq: FloatArray
    current: FloatArray
    strain: FloatArray  # as measured, in units of the gauges, (samples, gauges)
    # Position and speed of the reference, NaN without one, (samples, joints) [rad, rad/s].
    q_ref: FloatArray
    dq_ref: FloatArray
    q_true: FloatArray  # angle of the link after the gear, (samples, joints) [rad]

    @classmethod
    def joined(cls, parts: Sequence[LoopRecord]) -> LoopRecord:
        """Put records that follow each other into one."""
        return cls(*(np.concatenate([getattr(part, item.name) for part in parts])
                     for item in fields(cls)))


class ClosedLoop(Shown):
    """
    An arm under control, with the state of all its parts.

    Parameters
    ----------
    arm : Arm
        Description with links, motors and damper; see ``with_payload``.
    damping : float
        Part of the damper's gains in use, 0 for none.
    imperfections : Imperfections
        What is not ideal about drives and sensors.
    seed : int
        Of all noise.
    position_loop : bool
        Whether the cascade closes the position loop, or takes the reference speed alone.

    Raises
    ------
    ArmError, SimulationError
        If the description lacks what is needed.

    """

    def __init__(
        self, arm: Arm, *, damping: float = 1.0,
        imperfections: Imperfections = Imperfections(),  # noqa: B008 (frozen)
        seed: int = 0, position_loop: bool = True,
    ) -> None:
        self.arm = arm
        gains = arm_gains(arm)  # says what is missing, damper or motors
        self.dt = 1.0 / arm.damper.rate
        self._seed = seed
        motors = {motor.joint: motor for motor in arm.spec.motors}
        chosen = [motors[name] for name in arm.active_joints]
        mechanism = build_mechanism(arm)
        self._joints = [mechanism.joints.index(name) for name in arm.active_joints]
        index = mechanism.q_index[self._joints]
        self._drive = np.array([drive_row(motor, self.dt, imperfections) for motor in chosen])
        mechanism.coordinate[index, at.STIFFNESS] = self._drive[:, dr.GEAR_STIFFNESS]
        mechanism.coordinate[index, at.DAMPING] = self._drive[:, dr.DAMPING]
        self.plant = Plant(mechanism, self.dt, rho=settings.LOOP_DAMPING,
                           tolerance=settings.LOOP_TOLERANCE)
        probe = Probe(self.plant, [], arm)
        # Without the position loop it is a robot that takes speeds: who commands bounds them.
        self.cascade = Cascade(gains, self.dt, hard_limits(arm) if position_loop else None,
                               velocity_lag(arm.damper), drive_stop(arm))
        if not position_loop:
            self.cascade.rows[:, POSITION_GAIN] = 0.0
        damped = arm_damping(arm, share=damping) if damping != 0.0 else []
        self.damper = Damper(damped, self.dt)
        n, count, gauges = len(index), len(damped), len(arm.gauges)
        self._plant = DrivenPlant(self.plant.tables, index, np.zeros((mechanism.points, 6)),
                                  np.zeros(mechanism.size), push_table([], mechanism),
                                  floor_row(None, mechanism))
        self._sensors = SensorTables(
            self._drive, np.zeros((n, dr.STATES)),
            np.array([drive_sensor_row(motor, imperfections) for motor in chosen]),
            gauge_rows(arm, probe, imperfections), probe.bodies, probe.places,
            probe.loads,
            low_pass_gain(arm.spec.preprocessing.velocity_cutoff, self.dt),
            np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(gauges))
        self._control = ControlTables(
            self.cascade.rows, self.cascade.state, self.cascade.envelope.rows,
            self.cascade.envelope.state, self.damper.rows, self.damper.state,
            self.damper.past,
            np.array([arm.active_joints.index(s.joint) for s in damped], dtype=np.int64),
            np.array([arm.gauge_names.index(s.gauge) for s in damped], dtype=np.int64),
            np.zeros(n), np.zeros((count, len(Status))), motion_limits(arm).velocity)
        self._parts = [slice(begin, end) for begin, end in pairwise(
            accumulate((n, n, n, gauges, n, n, n), initial=0))]
        self._acting = self._loaded = False
        self._done = 0
        self.reset(self.described)

    @property
    def described(self) -> FloatArray:
        """Angles of the active joints where the description lets them start [rad]."""
        mechanism = self.plant.mechanism
        return mechanism.initial[mechanism.q_index[self._joints]]

    @property
    def t(self) -> float:
        """Time since the last ``reset`` [s]."""
        return self._done * self.dt

    @property
    def status_seconds(self) -> dict[str, dict[str, float]]:
        """How long the damper of each joint was in each state since the last ``reset`` [s]."""
        return {joint: {status.name.lower(): float(row[status]) for status in Status
                        if row[status] > 0.0}
                for joint, row in zip(self.damper.joints, self._control.status_time, strict=True)}

    def reset(self, q: ArrayLike, ahead: ArrayLike = 0.0) -> None:
        """
        Put the arm at rest, held by its motors; noise begins again.

        ``q``, shape (n_joints,), are the angles of the active joints that the encoders of the
        motors show [rad]; ``ahead``, of the same shape, is the current that is fed forward from
        the first step on, integrators have the rest [A].
        """
        plant, state = self.plant, self._sensors.drive_state
        wanted = finite_array(q, 'q', len(self._joints))
        stiffness, play = self._drive[:, dr.GEAR_STIFFNESS], self._drive[:, dr.PLAY]
        index = self._plant.driven
        place = plant.mechanism.initial[plant.mechanism.q_index].copy()
        place[self._joints] = wanted
        zero = np.zeros(plant.mechanism.size)
        for _ in range(20):  # the load hardly depends on the twist of the gear
            plant.reset(place, equilibrium=True)
            need = plant.imbalance(plant.coordinates, zero, zero)[index]
            load = need - stiffness * plant.coordinates[index]
            twist = load / stiffness + np.where(np.abs(load) > 1e-9, np.sign(load), 0.0) * play
            change = wanted - twist - place[self._joints]
            place[self._joints] += change
            if np.abs(change).max() < 1e-12:
                break
        torque = np.zeros(len(plant.mechanism.joints))
        torque[self._joints] = need
        plant.start_torque(torque)
        plant.tables.settings[gen.PEAK] = settings.REST_ACCELERATION
        state[:] = 0.0
        state[:, dr.ANGLE], state[:, dr.GEAR] = wanted, load
        state[:, dr.CURRENT] = load / self._drive[:, dr.TORQUE]
        self._sensors.angle[:] = [dr.encoder_reading(row, angle, angle) for row, angle in zip(
            self._sensors.sensor, wanted.tolist(), strict=True)]
        self._sensors.speed[:] = 0.0
        self.cascade.reset(state[:, dr.CURRENT] - np.asarray(ahead, dtype=float))
        self.damper.reset()
        self._control.status_time[:] = 0.0
        self._plant.external[:] = 0.0
        self._acting = self._loaded = False
        self._done = 0
        self._random = np.random.default_rng(self._seed)

    def set_pushes(self, pushes: Sequence[Push]) -> None:
        """Give the pushes, by their times since the last ``reset``; none takes them away."""
        self._plant = self._plant._replace(pushes=push_table(pushes, self.plant.mechanism))

    def set_payload(self, mass: float) -> None:
        """
        Change the point mass [kg] at the tip from now on, at the speed that the tip has.

        The arm needs a payload to begin with, be it one of no mass.
        """
        mechanism, none = self.plant.mechanism, self.arm.spec.payload is None
        if none or not 0.0 <= mass < float('inf'):
            raise SimulationError(f'arm {self.arm.name!r}: ' + (
                "no load to change; add the key 'payload' to the arm description" if none else
                f'payload= {mass:g} kg: give 0 or more'))
        mechanism.body_float[mechanism.body_at(mechanism.tip), at.MASS] = mass

    def set_floor(self, floor: Floor | None) -> None:
        """Put a floor (height [m], stiffness [N/m]) below the tip, or take it away."""
        self._plant.floor[:] = floor_row(floor, self.plant.mechanism)

    def set_force(self, force: ArrayLike) -> None:
        """Let a force (3,) [N], or it and a moment (6,) [N m], act at the tip; in base axes."""
        values = np.asarray(force, dtype=float)
        if values.shape not in ((3,), (6,)) or not np.isfinite(values).all():
            msg = f'a force has 3 or, with a moment, 6 finite components, found {values.tolist()}'
            raise SimulationError(msg)
        tip = self._plant.external[self.plant.mechanism.tip]
        tip[:], tip[:values.size] = 0.0, values
        self._loaded = bool(values.any())

    def step(self, q_ref: ArrayLike, dq_ref: ArrayLike) -> LoopRecord:
        """Advance by one step of the reference; give the readings at its start, one row."""
        return self.run(np.atleast_2d(np.asarray(q_ref, dtype=float)),
                        np.atleast_2d(np.asarray(dq_ref, dtype=float)))

    def run(
        self, q_ref: FloatArray, dq_ref: FloatArray, *, every: int = 1,
        ahead: FloatArray | None = None,
    ) -> LoopRecord:
        """
        Run through a reference.

        Parameters
        ----------
        q_ref, dq_ref : ndarray of shape (n_steps, n_joints)
            Reference at the start of each step [rad, rad/s].
        every : int
            Steps between two records, counted from the last ``reset``.
        ahead : ndarray of shape (n_steps, n_joints), optional
            Current that is fed forward in each step, as a drive takes it with its speed; none
            by default [A].

        Raises
        ------
        SimulationError
            If a reference is not finite or the run diverges.

        """
        joints, gauges = len(self._joints), len(self.arm.gauges)
        given = [np.asarray(item, dtype=float) for item in (
            q_ref, dq_ref, np.zeros(np.shape(q_ref)) if ahead is None else ahead)]
        steps = len(q_ref)
        if any(item.shape != (steps, joints) for item in given):
            msg = (f'references have shapes {", ".join(str(item.shape) for item in given)}; '
                   f'expected ({steps}, {joints}) for the joints {list(self.arm.active_joints)}')
            raise SimulationError(msg)
        wanted = np.array(given)
        if not np.isfinite(wanted).all():
            step = int(np.argwhere(~np.isfinite(wanted))[:, 1].min())
            raise SimulationError(f'arm {self.arm.name!r}: reference {step} is not finite')
        begun = self._done
        records = np.arange(-(-begun // every), (begun + steps - 1) // every + 1, dtype=float)
        out = np.empty((len(records), 6 * joints + gauges))
        noise = self._random.standard_normal((steps, joints + gauges))
        count, status, self._acting = run_loop(
            self._plant, self._sensors, self._control, wanted, noise, begun, self.dt, every,
            self._acting, self._loaded, out)
        self._done += count
        self.plant.taken(self._done, status)
        return LoopRecord(records * every * self.dt, *(out[:, part] for part in self._parts))


def steps_per_message(dt: float, rate: float) -> int:
    """Give the number of steps between two messages: dt [s], rate [Hz]."""
    every = 1.0 / (dt * rate) if rate > 0.0 else 0.0
    if not 1.0 - 1e-9 <= every < MAX_STEPS or abs(every - round(every)) > 1e-6:
        near = 1.0 / (dt * round(min(max(every, 1.0), 100.0)))
        raise SimulationError(f'rate= {rate:g} Hz: not {1.0 / dt:g} Hz of the damper (key '
                              f'damper.rate) divided by a whole number; give {near:.6g} Hz')
    return int(round(every))


@dataclass(frozen=True, eq=False)
class Sample:
    """Readings of the sensors: of ``active_joints`` and of ``gauge_names``, in their orders."""

    t: float  # simulated time [s]
    # As measured, (joints,) [rad, rad/s, A].
    q: FloatArray
    dq: FloatArray
    current: FloatArray
    strain: FloatArray  # (gauges,), in units of the gauges: um/m, where gains are per m/m
    force: FloatArray  # force at the tip, in the base frame, (3,) [N]


class ArmProcess:
    """An arm whose joints take velocities [rad/s]; ``failure`` is empty where nothing failed."""

    def __init__(
        self, arm: Arm, *, rate: float = 500.0, payload: float = 0.0, damping: float = 0.0,
        imperfections: Imperfections = Imperfections(),  # noqa: B008 (frozen)
        seed: int = 0,
    ) -> None:
        if payload > 0.0:
            arm = with_payload(arm, payload)
        self.loop = ClosedLoop(arm, damping=damping, imperfections=imperfections, seed=seed,
                               position_loop=False)
        self.steps = steps_per_message(self.loop.dt, rate)
        self._probe = Probe(self.loop.plant, [])
        self._samples = 0
        initial = arm.spec.simulation.initial
        self.held = {name: initial.get(name, hold) for name, hold in arm.held_joints.items()}
        stop = drive_stop(arm)
        self._braking, self.command_timeout = stop.acceleration, stop.timeout
        self.floor: Floor | None = None
        self.reset()

    @property
    def t(self) -> float:
        """Give the simulated time; a sample that could not be computed has its share of it [s]."""
        return self._samples * self.steps * self.loop.dt

    def reset(self) -> None:
        """Put the arm at rest where its description says, a failure forgotten; time goes on."""
        self.failure = ''
        self.loop.reset(self.loop.described)
        self.speed = np.zeros(len(self.loop.arm.active_joints))
        self._age = np.inf
        self.force = np.zeros(3)

    def command(self, speed: FloatArray) -> None:
        """Take speeds of the joints; a failed arm does not [rad/s]."""
        if self.failure:
            return
        self.speed = np.array(speed, dtype=float)
        self._age = 0.0

    def tip(self) -> FloatArray:
        """Give the place of the tip in the base frame [m]."""
        return np.asarray(self._probe.observe().position[self.loop.plant.mechanism.tip].copy())

    def step(self) -> Sample:
        """Advance by a sample, give what sensors say at its start; ends at rest if it diverges."""
        t = self.t
        self._samples += 1
        try:
            return self._advance(t)
        except SimulationError as err:
            self.reset()
            self.failure = str(err)
            return self._advance(t)

    def _advance(self, t: float) -> Sample:
        force, floor = (np.zeros(3), None) if self.failure else (self.force, self.floor)
        self.loop.set_force(force)
        self.loop.set_floor(floor)
        total = np.array(force, dtype=float)
        if floor is not None:
            total[2] += floor.stiffness * max(floor.height - float(self.tip()[2]), 0.0)
        period = self.steps * self.loop.dt
        if self._age >= self.command_timeout:  # as good drives do: braked, not cut off
            self.speed = self.speed - np.clip(
                self.speed, -period * self._braking, period * self._braking)
        self._age += period
        q_ref = np.zeros((self.steps, len(self.speed)))  # no position loop: not used
        signals = self.loop.run(q_ref, np.full(q_ref.shape, self.speed), every=self.steps)
        return Sample(t, signals.q[0], signals.dq[0], signals.current[0], signals.strain[0], total)
