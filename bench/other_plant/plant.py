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
A two-blade arm that shares nothing with this package's simulator: MuJoCo and drives of its own.

Each blade is eleven rigid pieces with ten bending springs between them, one at the place of each
gauge; a gear is rigid, a spring, or a spring with play. A step is semi-implicit: springs are
explicit and their damping implicit, which is stable for the proportional damping that blades have.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
import math
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from tudor_dynamics.bags.messages import joint_signals, Signals, WRENCH_STAMPED
from tudor_dynamics.bags.writer import write_bag

FloatArray = NDArray[np.float64]

DT = 5e-4
"""Step of the simulation and of the drives [s]."""
EVERY = 10
"""Steps between two messages: 200 Hz."""
JOINTS = ('joint2', 'joint3')
GAUGES = (('link2_hub', 0, 0.05), ('link3_hub', 1, 0.05), ('link2_mid', 0, 0.24),
          ('link3_mid', 1, 0.24))
"""Name, link and distance from the joint [m]."""
LENGTH, STIFFNESS, PER_LENGTH, RAYLEIGH = 0.3928, 2.06e11 * 0.015 * 0.004**3 / 12, 0.471, 5e-4
"""Of a blade of spring steel, 4 mm by 15 mm: length [m], bending stiffness [N m^2], mass per
length [kg/m], damping per stiffness [s]."""
ELEMENTS = np.repeat([0.1 / 3, 0.04, (LENGTH - 0.26) / 3], [3, 4, 3])
"""Lengths with a spring in their middle: at 50 and 240 mm, where gauges are [m]."""
ELBOW = 0.82
"""Mass of the second motor and its clamps [kg]."""
GAIN = 121.4
"""Strain per moment of a gauge, half the height over the stiffness [um/m per N m]."""
TORQUE = np.array([230 * 0.07 * 0.7, 246 * 0.03 * 0.5])
ROTOR = np.array([230**2 * 1.1e-5, 246**2 * 0.5e-5])
VISCOUS, COULOMB = np.array([0.55, 0.13]), np.array([1.0, 0.21])
"""At the joint: torque per current [N m/A], inertia [kg m^2], friction [N m s/rad, N m]."""
GEAR, GEAR_DAMPING, PLAY = np.array([232.0, 162.0]), np.array([0.3, 0.2]), 0.005
"""Stiffness and damping of elastic gears [N m/rad, N m s/rad], half of their backlash [rad]."""
BANDWIDTH, POSITION_GAIN, CURRENT = 2 * math.pi * 20.0, 3.0, 2.5
"""Of the drives: velocity loop [rad/s], position loop [1/s], largest current [A]."""
LOW, HIGH = np.array([0.25, -1.3]), np.array([2.6, 1.3])
SPEED, ACCELERATION = 1.22, 3.49
"""Of the motion [rad, rad/s, rad/s^2]."""
YIELD, YIELD_MEAN = np.array([0.17, 0.12]), 2 * math.pi * 0.3
"""Damping: speed per moment at the hub [rad/s per N m], less its slow mean [rad/s]."""


@dataclass(frozen=True)
class Push:
    """A force across a link, as it lies when the push begins."""

    time: float  # [s]
    duration: float  # [s]
    link: int
    place: float  # from the joint [m]
    force: float  # [N]
    rise: float = 0.05  # time in which it comes and goes [s]

    def share(self, t: FloatArray) -> FloatArray:
        """Give the part of the force that acts at times [s]."""
        near = np.minimum(t - self.time, self.time + self.duration - t)
        return np.asarray(np.sin(0.5 * np.pi * np.clip(near / self.rise, 0.0, 1.0))**2)


@dataclass(frozen=True)
class Options:
    """What the plant has, switched one by one."""

    gears: str = 'rigid'  # or elastic, or play
    stribeck: float = 0.0  # friction at rest over Coulomb friction, less 1
    payload: float = 0.2  # [kg]
    loads: tuple[tuple[float, float], ...] = ()  # what is carried from a time on [s, kg]
    damped: bool = True
    noise: float = 2.0  # of the gauges [um/m]
    gains: tuple[float, ...] = (1.02, 0.99, 0.98, 1.01)  # of the gauges, over what they should be
    drift: float = 0.0  # of their offsets [um/m per minute]


@dataclass
class Arm:
    """The arm in MuJoCo."""

    options: Options
    model: Any = field(init=False)
    data: Any = field(init=False)

    def __post_init__(self) -> None:
        """Build the model."""
        self.model = mujoco.MjModel.from_xml_string(_document(self.options))
        self.data = mujoco.MjData(self.model)
        names = ['motor0', 'motor1']
        self.motors = np.array([self.model.joint(name).dofadr[0] for name in names])
        self.springs = np.array([[self.model.joint(f'bend{link}_{k}').dofadr[0]
                                  for k in range(len(ELEMENTS))] for link in range(2)])
        self.gears = np.array([self.model.joint(f'gear{link}').dofadr[0] for link in range(2)]
                              if self.options.gears != 'rigid' else [], dtype=int)
        middles = np.cumsum(ELEMENTS) - 0.5 * ELEMENTS
        at = [int(np.argmin(abs(middles - place))) for _, _, place in GAUGES]
        self.gauges = [self.springs[link][k] for k, (_, link, _) in zip(at, GAUGES, strict=True)]
        self.stiffness = STIFFNESS / ELEMENTS[at]
        self.edges = np.concatenate([[0.0], middles])

    def moments(self) -> FloatArray:
        """Give the bending moments at the gauges, positive for the weight of the arm [N m]."""
        return -self.stiffness * self.data.qpos[self.gauges]

    def carry(self, payload: float) -> None:
        """Carry another load from now on, which moves as the arm does already [kg]."""
        self.model.body_mass[self.model.body('load').id] = max(payload, 1e-6)
        mujoco.mj_setConst(self.model, mujoco.MjData(self.model))

    def push(self, link: int, place: float, force: FloatArray) -> FloatArray:
        """Give the generalised forces of a force in the base frame at a place of a link."""
        piece = int(np.searchsorted(self.edges, place, side='right')) - 1
        body = self.model.body(f'piece{link}_{piece}').id
        rotation = self.data.xmat[body].reshape(3, 3)
        point = self.data.xpos[body] + (place - self.edges[piece]) * rotation[:, 0]
        result = np.zeros(self.model.nv)
        mujoco.mj_applyFT(self.model, self.data, force, np.zeros(3), point, body, result)
        return result

    def gear_torque(self) -> None:
        """Let gears with play push where teeth meet."""
        twist = self.data.qpos[self.gears]
        beyond = twist - np.clip(twist, -PLAY, PLAY)
        self.data.qfrc_applied[self.gears] += -GEAR * beyond
        self.model.dof_damping[self.gears] = np.where(beyond == 0.0, 0.02, 1.0) * GEAR_DAMPING

    def settle(self, q: FloatArray) -> None:
        """Stand still at angles (2,) [rad], links hanging."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[self.motors] = q
        held = np.array([dof for dof in range(self.model.nv) if dof not in self.motors])
        for _ in range(60):  # Newton, with the stiffness alone as slope where it is largest
            self.data.qvel[:] = 0.0
            self.data.qacc[:] = 0.0
            self.data.qfrc_applied[:] = 0.0
            if self.options.gears == 'play':
                self.gear_torque()
            residual = self._residual(held)
            slopes = np.zeros((len(held), len(held)))
            here = self.data.qpos.copy()
            for column, dof in enumerate(held):
                self.data.qpos[dof] = here[dof] + 1e-7
                self.data.qfrc_applied[:] = 0.0
                if self.options.gears == 'play':
                    self.gear_torque()
                slopes[:, column] = (self._residual(held) - residual) / 1e-7
                self.data.qpos[:] = here
            step = np.linalg.lstsq(slopes, residual, rcond=1e-12)[0]
            self.data.qpos[held] -= np.clip(step, -0.05, 0.05)
            if np.abs(step).max() < 1e-9:
                break
        self.data.qfrc_applied[:] = 0.0
        mujoco.mj_forward(self.model, self.data)

    def _residual(self, held: NDArray[np.intp]) -> FloatArray:
        mujoco.mj_fwdPosition(self.model, self.data)
        mujoco.mj_fwdVelocity(self.model, self.data)
        forces = self.data.qfrc_passive - self.data.qfrc_bias + self.data.qfrc_applied
        return np.asarray(forces[held].copy())


def _document(options: Options) -> str:
    """Write the model of the arm."""
    def inertial(mass: float, at: float, length: float, lump: float) -> str:
        turn = max(mass * length**2 / 12, 1e-9) + lump
        return (f'<inertial pos="{at} 0 0" mass="{max(mass, 1e-6)}" '
                f'diaginertia="{turn} {turn} {turn}"/>')

    def hinge(name: str, more: str) -> str:
        return f'<joint name="{name}" type="hinge" axis="0 -1 0" {more}/>'

    def blade(link: int, after: str) -> str:
        middles = np.cumsum(ELEMENTS) - 0.5 * ELEMENTS
        ends = np.concatenate([[0.0], middles, [LENGTH]])
        text = after
        for k in reversed(range(len(ends) - 1)):
            size = ends[k + 1] - ends[k]
            own = inertial(PER_LENGTH * size, 0.5 * size, size, 0.0)
            if k:
                stiffness = STIFFNESS / ELEMENTS[k - 1]
                own = hinge(f'bend{link}_{k - 1}', f'stiffness="{stiffness}" '
                            f'damping="{RAYLEIGH * stiffness}"') + own
            else:
                motor = hinge(f'motor{link}', f'armature="{ROTOR[link]}" '
                              f'damping="{VISCOUS[link]}" frictionloss="{COULOMB[link]}"')
                spring = 0.0 if options.gears == 'play' else GEAR[link]
                own = (motor if options.gears == 'rigid' else '') + own
                text = f'<body name="piece{link}_0">' + (
                    '' if options.gears == 'rigid' else
                    hinge(f'gear{link}', f'stiffness="{spring}" damping="{GEAR_DAMPING[link]}"')
                ) + own + text + '</body>'
                return text if options.gears == 'rigid' else (
                    f'<body name="rotor{link}">{motor}' + inertial(1e-6, 0.0, 0.0, 1e-6)
                    + text + '</body>')
            text = (f'<body name="piece{link}_{k}" pos="{ends[k] - ends[k - 1]} 0 0">'
                    f'{own}{text}</body>')
        return text

    last = ELEMENTS[-1] / 2
    tip = (f'<body name="load" pos="{last} 0 0">' + inertial(options.payload, 0.0, 0.0, 1e-6)
           + '</body>')
    elbow = (f'<body name="elbow" pos="{last} 0 0">' + inertial(ELBOW, 0.0, 0.0, 5.4e-4)
             + blade(1, tip) + '</body>')
    return (f'<mujoco><option timestep="{DT}" integrator="implicitfast" gravity="0 0 -9.81"/>'
            f'<worldbody><body pos="0 0 0.3">{blade(0, elbow)}</body></worldbody></mujoco>')


def motion(seconds: float, random: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Move each joint from target to target with a trapezoidal speed, and pauses of its own."""
    steps = round(seconds / DT)
    q, dq = np.zeros((steps, 2)), np.zeros((steps, 2))
    for joint in range(2):
        here = random.uniform(LOW[joint], HIGH[joint])
        now = round(random.uniform(1.0, 1.5) / DT)
        q[:now, joint] = here
        while now < steps:
            there = random.uniform(LOW[joint], HIGH[joint])
            speed = SPEED * random.uniform(0.4, 1.0)
            peak = min(speed, math.sqrt(abs(there - here) * ACCELERATION))
            rise, total = peak / ACCELERATION, abs(there - here) / peak + peak / ACCELERATION
            pause = random.uniform(0.1, 2.0)
            t = np.arange(round((total + pause) / DT)) * DT
            side = np.minimum(np.minimum(t, total - t), rise).clip(0.0)
            rate = np.sign(there - here) * ACCELERATION * side
            count = min(len(t), steps - now)
            dq[now:now + count, joint] = rate[:count]
            q[now:now + count, joint] = (here + np.cumsum(rate) * DT)[:count]
            here, now = q[now + count - 1, joint], now + count
    return q, dq


def record(
    path: Path, options: Options, reference: tuple[FloatArray, FloatArray], seed: int,
    pushes: tuple[Push, ...] = (),
) -> FloatArray:
    """Move the arm, and write a bag; returns the mean across the link of each push [N]."""
    random, arm = np.random.default_rng([seed, 7]), Arm(options)
    want, rate = reference
    arm.settle(want[0])
    model, data, motors = arm.model, arm.data, arm.motors
    speed_gain = ROTOR * BANDWIDTH / TORQUE
    integral = data.qfrc_bias[motors] / TORQUE  # what holds the arm
    mean, rows, forces = arm.moments()[:2], [], np.zeros((len(want), 3))
    begun: dict[int, FloatArray] = {}
    acted = [np.zeros(0)] * len(pushes)
    changes = {round(time / DT): payload for time, payload in options.loads}
    for k in range(len(want)):
        if k in changes:
            arm.carry(changes[k])
        q, dq, moment = data.qpos[motors], data.qvel[motors], arm.moments()
        wanted = rate[k] + POSITION_GAIN * (want[k] - q)
        mean = mean + DT * YIELD_MEAN * (moment[:2] - mean)
        if options.damped:
            wanted = wanted - YIELD * (moment[:2] - mean)
        error = wanted - dq
        current = np.clip(speed_gain * error + integral, -CURRENT, CURRENT)
        integral = np.clip(integral + 0.2 * BANDWIDTH * speed_gain * DT * error, -CURRENT, CURRENT)
        data.qfrc_applied[:] = 0.0
        data.qfrc_applied[motors] = TORQUE * current
        if options.stribeck:
            model.dof_frictionloss[motors] = COULOMB * (
                1.0 + options.stribeck * np.exp(-(dq / 0.05)**2))
        if options.gears == 'play':
            arm.gear_torque()
        for number, push in enumerate(pushes):
            if push.time < k * DT < push.time + push.duration:
                angle = q[:push.link + 1].sum()
                across = np.array([-math.sin(angle), 0.0, math.cos(angle)])
                force = begun.setdefault(number, push.force * across) * float(
                    push.share(np.array(k * DT)))
                data.qfrc_applied += arm.push(push.link, push.place, force)
                acted[number] = np.append(acted[number], force @ across)
                forces[k] += force
        if k % EVERY == 0:
            rows.append(np.concatenate([q, dq, current, moment]))
        mujoco.mj_step(model, data)
    _write(path, options, np.array(rows), forces[::EVERY], random)
    return np.array([value.mean() for value in acted])


def _write(
    path: Path, options: Options, rows: FloatArray, forces: FloatArray,
    random: np.random.Generator,
) -> None:
    """Let sensors measure, and write what they say."""
    t = np.arange(len(rows)) * DT * EVERY
    stamp = np.asarray(1_700_000_000_000_000_000 + np.round(t * 1e9), dtype=np.int64)
    count = 2 * np.pi / (2000.0 * np.array([230.0, 246.0]))
    q = count * np.floor(rows[:, :2] / count)
    dq = rows[:, 2:4] + 2e-3 * random.standard_normal((len(t), 2))
    current = rows[:, 4:6] + 0.02 * random.standard_normal((len(t), 2))
    strain = GAIN * np.array(options.gains) * rows[:, 6:] + options.drift / 60.0 * t[:, None]
    strain = strain + options.noise * random.standard_normal(strain.shape)
    strain = 0.23 * np.round(strain / 0.23)
    write_bag(path, [
        joint_signals('/joint_states', stamp, JOINTS, q, dq),
        joint_signals('/motor_currents', stamp, JOINTS, effort=current),
        joint_signals('/link_strains', stamp, [name for name, _, _ in GAUGES], strain),
        Signals('/applied_wrench', stamp, {'force': forces, 'torque': np.zeros_like(forces)},
                frame='base', msgtype=WRENCH_STAMPED)], custom={'payload': f'{options.payload:g}'})


def first_frequency(options: Options) -> float:
    """Give the slowest vibration of the stretched arm with motors held, by its ringing [Hz]."""
    arm = Arm(replace(options, damped=False))
    arm.settle(np.zeros(2))
    arm.model.dof_armature[arm.motors] = 1e6  # nothing moves them
    arm.data.qvel[arm.springs[0]] = 0.05
    seen = []
    for _ in range(round(8.0 / DT)):
        arm.data.qfrc_applied[:] = 0.0
        if options.gears == 'play':
            arm.gear_torque()
        mujoco.mj_step(arm.model, arm.data)
        seen.append(arm.moments()[0])
    spectrum = np.abs(np.fft.rfft((seen - np.mean(seen)) * np.hanning(len(seen)), 16 * len(seen)))
    return float(np.argmax(spectrum)) / (16 * len(seen) * DT)
