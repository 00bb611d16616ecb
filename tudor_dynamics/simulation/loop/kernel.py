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
The arm in closed loop, compiled: sensors, controller, drives and plant of one step after another.

The laws are those of ``control`` and of the other modules of this room; here they only follow each
other: readings at the start of a step, current from them, rotor and link to its end.
"""

from __future__ import annotations

from typing import NamedTuple

from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.control.cascade import position_law, SATURATED, velocity_law
from tudor_dynamics.control.damper_law import damper_law, moving_share, STATUS
from tudor_dynamics.control.envelope_law import CUT, envelope_law, SATURATING
from tudor_dynamics.simulation.loop import drive as dr, sensors as sn
from tudor_dynamics.simulation.loop.floor import press
from tudor_dynamics.simulation.loop.pushes import add_pushes_to_sections, put_pushes
from tudor_dynamics.simulation.mechanics.equations import inverse_dynamics
from tudor_dynamics.simulation.mechanics.loads import section_loads
from tudor_dynamics.simulation.plant import integrator as gen
from tudor_dynamics.simulation.plant.integrator import PlantTables
from tudor_dynamics.small_arrays import unowned


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
    fault: NDArray
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


NO_FAULT, STUCK, MISSING = 0, 1, 2  # of a gauge


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
        angle = sn.encoder_reading(
            row, sensors.drive_state[j, dr.ANGLE], v[gen.Z, plant.driven[j]])
        quotient = (angle - sensors.angle[j]) / dt
        sensors.speed[j] += sensors.velocity_share * (quotient - sensors.speed[j])
        sensors.angle[j] = angle
        sensors.current[j] = sn.current_reading(
            row, sensors.drive_state[j, dr.CURRENT], sensors.drive_state[j, dr.ANGLE], noise[j])
    for g in range(sensors.gauge.shape[0]):
        if sensors.fault[g] == NO_FAULT:
            sensors.strain[g] = sn.gauge_reading(
                sensors.gauge[g], sensors.loads[g], noise[joints + g])
        elif sensors.fault[g] == MISSING:
            sensors.strain[g] = float('nan')


@compiled
def control(
    sensors: SensorTables, tables: ControlTables, dt: float, q_ref: NDArray, dq_ref: NDArray,
    ahead: NDArray,
) -> None:
    """Run damper, envelope and cascade on the readings, then the rotors with the currents."""
    moving = 0.0
    for j in range(tables.yielding.shape[0]):
        tables.yielding[j] = 0.0
        moving = max(moving, moving_share(dq_ref[j], tables.planned_speed[j]))
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
            body.torque[i] - row[dr.STIFFNESS] * v[gen.Z, i] - row[dr.DAMPING] * v[gen.DZ, i])
    return status, acting


@compiled
def run_loop(
    plant: DrivenPlant, sensors: SensorTables, tables: ControlTables,
    wanted: NDArray, noise: NDArray, done: int, dt: float, every: int,
    acting: bool, loaded: bool, out: NDArray,
) -> tuple[int, int, bool]:
    """
    Run as many steps as there are references.

    noise (steps, joints + gauges), dt [s]; wanted (3, steps, joints): position and speed of the
    reference at the start of each step [rad, rad/s], and the current that is fed forward in it
    [A]; writes out (records, 6 joints + gauges).
    """
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
