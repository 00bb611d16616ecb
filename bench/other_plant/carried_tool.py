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
An arm of seven joints that carries a slender tool, in MuJoCo; it shares nothing with the package.

The joints are drives that pull to a commanded position like springs with dampers: they lag behind
it, yield to the tool, and rub. The tool is a chain of rigid pieces with two bending springs
between each two, and a mass at its end; it is mounted askew. Angles, forces and the place of the
tip come from MuJoCo's sensors.
"""

from __future__ import annotations

from dataclasses import dataclass, field
import math
from typing import Any

import mujoco
from mujoco import rollout
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.optimize import least_squares

FloatArray = NDArray[np.float64]

DT = 5e-4
"""Step of the simulation and of the commands [s]."""
DH = np.array([  # modified, as Craig has them: a, alpha, d, offset; the last row is the flange
    [0.0, 0.0, 0.35, 0.0], [0.0, -math.pi / 2, 0.0, 0.0], [0.0, math.pi / 2, 0.33, 0.0],
    [0.08, math.pi / 2, 0.0, 0.0], [-0.08, -math.pi / 2, 0.37, 0.0],
    [0.0, math.pi / 2, 0.0, 0.0], [0.09, math.pi / 2, 0.0, 0.0], [0.0, 0.0, 0.11, 0.0]])
HOME = np.array([0.0, -0.4, 0.0, -1.9, 0.0, 1.7, 0.4])
LINKS = (  # mass [kg], its centre in the frame of the joint [m], size of a box of it [m]
    (4.2, (0.0, -0.03, -0.08), (0.12, 0.12, 0.30)), (3.9, (0.0, -0.08, 0.03), (0.12, 0.28, 0.12)),
    (3.1, (0.04, 0.03, -0.07), (0.12, 0.12, 0.24)), (3.0, (-0.04, 0.06, 0.03), (0.12, 0.22, 0.12)),
    (2.6, (0.0, 0.04, -0.13), (0.10, 0.10, 0.30)), (1.6, (0.05, -0.01, -0.01), (0.14, 0.09, 0.1)),
    (0.9, (0.01, 0.01, 0.07), (0.09, 0.09, 0.08)))
ROTOR = np.array([0.60, 0.60, 0.45, 0.45, 0.20, 0.18, 0.15])
"""Inertia of the rotors at the joints [kg m^2]."""
STIFF = np.array([18.0, 16.0, 20.0, 19.0, 25.0, 27.0, 29.0])
"""Natural frequencies of the drives with the bare arm at home [Hz]."""
RATIO = 0.5
"""Damping ratio of the drives."""
COULOMB = np.array([0.3, 0.3, 0.25, 0.25, 0.15, 0.12, 0.1])
VISCOUS = np.array([1.0, 1.0, 0.8, 0.8, 0.4, 0.3, 0.3])
"""Friction [N m, N m s/rad]."""
PIECES = 5
"""Places along the tool where it bends."""
ROD = 0.15
"""Mass of the tool without its end [kg]."""
CALM = 0.7
"""Damping ratio with which a tool is brought to rest."""


@dataclass(frozen=True)
class Tool:
    """A slender tool."""

    frequency: float  # the lower of both bending planes, clamped, without gravity [Hz]
    damping: float  # its ratio
    apart: float  # frequency of the other plane over it
    length: float  # [m]
    mass: float  # of its end [kg]
    tilt: float  # of its axis to that of the flange [rad]
    azimuth: float  # direction of the tilt [rad]
    roll: float  # of the bending planes about the axis [rad]


@dataclass(frozen=True)
class Options:
    """What the plant has, switched one by one."""

    one_plane: bool = False  # the tool bends in one plane only
    yielding: float = 1.0  # frequency of the drives over STIFF, upside down: 0.2 is five times
    rubbing: float = 1.0  # dry friction over COULOMB
    gravity: float = 9.81  # [m/s^2]


def draw_tools(count: int, seed: int) -> list[Tool]:
    """Draw tools of 1 to 5 Hz; every other one has two planes that differ."""
    random = np.random.default_rng(seed)
    edges = np.geomspace(1.0, 5.0, count + 1)
    differ = random.permutation(np.arange(count) % 2 == 0)
    tools = []
    for k in range(count):
        frequency = float(random.uniform(edges[k], edges[k + 1]))
        damping, apart = float(random.uniform(0.01, 0.03)), float(random.uniform(1.15, 1.8))
        # so long that gravity bends it by no more than about a quarter of its length
        length = max(float(random.uniform(0.3, 0.6)), 4.0 * 9.81 / (2 * np.pi * frequency) ** 2)
        tools.append(Tool(
            frequency, damping, apart if differ[k] else 1.0, length,
            float(random.uniform(0.3, 1.2)), float(random.uniform(0.35, 1.2)),
            float(random.uniform(0.0, 2.0 * np.pi)), float(random.uniform(0.0, np.pi))))
    return tools


@dataclass(frozen=True)
class Sensed:
    """What sensors say at every step."""

    q: FloatArray  # (steps, 7) [rad]
    effort: FloatArray  # of the drives, (steps, 7) [N m]
    tip: FloatArray  # relative to the flange, in its frame, (steps, 3) [m]
    end: FloatArray  # state after the last step


@dataclass(frozen=True)
class RingDown:
    """How the tip rings after it was let go."""

    frequency: float  # [Hz]
    damping: float  # its ratio


@dataclass
class CarriedTool:
    """The arm with a tool."""

    tool: Tool
    options: Options = Options()
    model: Any = field(init=False)
    calm: Any = field(init=False)  # the same, whose tool is brought to rest

    def __post_init__(self) -> None:
        """Build the models: stiffness and gains belong to frequencies."""
        planes = (self.tool.frequency, self.tool.frequency * self.tool.apart)
        unit = mujoco.MjModel.from_xml_string(self._document(np.ones(2), 0.0, np.ones(7)))
        mass = self._mass(unit, HOME)
        springs = [[unit.joint(f'bend{axis}_{k}').dofadr[0] for k in range(PIECES)]
                   for axis in self._axes()]
        stiff = np.zeros(2)
        self.shapes = np.zeros((len(springs), PIECES))
        for axis, at in zip(self._axes(), springs, strict=True):
            of = mass[np.ix_(at, at)]
            value, shape = eigh(np.eye(PIECES), of)
            stiff[axis] = (2.0 * math.pi * planes[axis]) ** 2 / value[0]
            self.shapes[axis] = shape[:, 0]
        bare = np.diag(self._mass(mujoco.MjModel.from_xml_string(self._document(
            np.ones(2), 0.0, np.ones(7), bare=True)), HOME))
        gain = bare[:7] * (2.0 * math.pi * STIFF / self.options.yielding) ** 2
        self.model, self.calm = (
            mujoco.MjModel.from_xml_string(self._document(stiff, ratio, gain, inertia=bare[:7]))
            for ratio in (self.tool.damping, CALM))
        self.data = mujoco.MjData(self.model)
        self.springs = [[self.model.joint(f'bend{axis}_{k}').qposadr[0] for k in range(PIECES)]
                        for axis in self._axes()]

    def _axes(self) -> range:
        return range(1 if self.options.one_plane else 2)

    @staticmethod
    def _mass(model: Any, q: FloatArray) -> FloatArray:
        data = mujoco.MjData(model)
        data.qpos[:7] = q
        mujoco.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        return full

    def _document(
        self, stiff: FloatArray, ratio: float, gain: FloatArray, *,
        inertia: FloatArray | None = None, bare: bool = False,
    ) -> str:
        """Write the model: stiffness of both planes [N m/rad], gains of the drives."""
        inertia = np.ones(7) if inertia is None else inertia
        text = '' if bare else self._chain(stiff, ratio)
        a, alpha, d, _ = DH[7]
        text = (f'<site name="flange" pos="{a} {-d * math.sin(alpha)} {d * math.cos(alpha)}"/>'
                f'{text}')
        for k in reversed(range(7)):
            a, alpha, d, _ = DH[k]
            mass, centre, size = LINKS[k]
            box = [mass / 12.0 * (sum(x * x for x in size) - size[i] ** 2) for i in range(3)]
            text = (
                f'<body name="link{k}" pos="{a} {-d * math.sin(alpha)} {d * math.cos(alpha)}" '
                f'quat="{math.cos(alpha / 2)} {math.sin(alpha / 2)} 0 0">'
                f'<joint name="j{k + 1}" type="hinge" axis="0 0 1" armature="{ROTOR[k]}" '
                f'damping="{VISCOUS[k]}" frictionloss="{self.options.rubbing * COULOMB[k]}"/>'
                f'<inertial pos="{_row(centre)}" mass="{mass}" diaginertia="{_row(box)}"/>'
                f'{text}</body>')
        drives = ''.join(
            f'<position name="d{k + 1}" joint="j{k + 1}" kp="{gain[k]}" '
            f'kv="{2.0 * RATIO * math.sqrt(gain[k] * inertia[k])}"/>' for k in range(7))
        sensors = ''.join(f'<jointpos joint="j{k + 1}"/>' for k in range(7)) + ''.join(
            f'<actuatorfrc actuator="d{k + 1}"/>' for k in range(7)) + (
            '' if bare else '<framepos objtype="site" objname="tip" reftype="site" '
            'refname="flange"/>')
        return (f'<mujoco><compiler angle="radian"/><option timestep="{DT}" '
                f'integrator="implicitfast" gravity="0 0 {-self.options.gravity}"/>'
                f'<worldbody>{text}</worldbody><actuator>{drives}</actuator>'
                f'<sensor>{sensors}</sensor></mujoco>')

    def _chain(self, stiff: FloatArray, ratio: float) -> str:
        """Write the tool: rigid pieces along z, bent about x and y between them."""
        tool = self.tool
        sizes = tool.length / PIECES * np.array([0.5, *[1.0] * (PIECES - 1), 0.5])
        text = (f'<body pos="0 0 {sizes[-1]}"><inertial pos="0 0 0" mass="{tool.mass}" '
                f'diaginertia="{_row([4e-4 * tool.mass] * 3)}"/><site name="tip"/></body>')
        planes = (tool.frequency, tool.frequency * tool.apart)
        for k in reversed(range(PIECES + 1)):
            size, mass = sizes[k], ROD * sizes[k] / tool.length
            turn = mass * size**2 / 12.0 + 1e-6
            joints = '' if k == 0 else ''.join(
                f'<joint name="bend{axis}_{k - 1}" type="hinge" '
                f'axis="{"1 0 0" if axis == 0 else "0 1 0"}" stiffness="{stiff[axis]}" '
                f'damping="{stiff[axis] * ratio / (math.pi * planes[axis])}"/>'
                for axis in self._axes())
            own = (f'{joints}<inertial pos="0 0 {0.5 * size}" mass="{mass}" '
                   f'diaginertia="{turn} {turn} 1e-6"/>')
            if k:
                text = f'<body name="piece{k}" pos="0 0 {sizes[k - 1]}">{own}{text}</body>'
            else:
                a, alpha, d, _ = DH[7]
                place = _row((a, -d * math.sin(alpha), d * math.cos(alpha)))
                text = (f'<body name="piece0" pos="{place}" quat="{_row(_mount(tool))}">'
                        f'{own}{text}</body>')
        return text

    def settled(self, q: FloatArray) -> FloatArray:
        """Give the state at rest with commands q [rad]."""
        self.data.qpos[:], self.data.qvel[:] = 0.0, 0.0
        self.data.qpos[:7] = q
        self.data.time = 0.0
        return self._run(self.calm, self._state(), np.tile(q, (round(self._long() / DT), 1))).end

    def follow(self, begin: FloatArray, commands: FloatArray) -> Sensed:
        """Follow commands, one each step, from a state on."""
        return self._run(self.model, begin, commands)

    def resting(self, begin: FloatArray, q: FloatArray) -> FloatArray:
        """Bring the tool to rest, and give where its tip then is, from the flange [m]."""
        return self._run(self.calm, begin, np.tile(q, (round(self._long() / DT), 1))).tip[-1]

    def _long(self) -> float:
        """Give a time in which a calmed tool comes to rest [s]."""
        return 1.5 + 2.5 / self.tool.frequency

    def _state(self) -> FloatArray:
        kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
        state = np.zeros(mujoco.mj_stateSize(self.model, kind))
        mujoco.mj_getState(self.model, self.data, state, kind)
        return state

    def _run(self, model: Any, begin: FloatArray, commands: FloatArray) -> Sensed:
        states, sensed = rollout.rollout(model, self.data, begin[None], commands[None])
        if not np.isfinite(states[0, -1]).all() or np.abs(states[0, -1, 1:]).max() > 1e3:
            raise FloatingPointError('the simulation diverged')
        return Sensed(sensed[0, :, :7], sensed[0, :, 7:14], sensed[0, :, 14:17],
                      np.array(states[0, -1]))

    def ring_downs(self, q: FloatArray, seconds: float = 6.0) -> list[RingDown]:
        """Let the tool go in each plane at a pose, and see how it rings."""
        begin, found = self.settled(q), []
        for at, shape in zip(self.springs, self.shapes, strict=True):
            state = begin.copy()
            state[1 + np.array(at)] += 0.03 * shape / np.abs(shape.sum())
            tip = self._run(self.model, state, np.tile(q, (round(seconds / DT), 1))).tip
            found.append(_decay(tip[round(0.3 / DT)::10], 10 * DT))
        return found


def pose_of(q: FloatArray) -> FloatArray:
    """Give the pose of the flange in the base (4, 4)."""
    pose = np.eye(4)
    for (a, alpha, d, offset), angle in zip(DH, [*q, 0.0], strict=True):
        sin, cos = math.sin(angle + offset), math.cos(angle + offset)
        sa, ca = math.sin(alpha), math.cos(alpha)
        pose = pose @ np.array([[cos, -sin, 0.0, a], [sin * ca, cos * ca, -sa, -d * sa],
                                [sin * sa, cos * sa, ca, d * ca], [0.0, 0.0, 0.0, 1.0]])
    return pose


def planes_of(tool: Tool) -> FloatArray:
    """Give the directions (2, 3) in which the tip moves in either plane, in the flange's frame."""
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, _mount(tool))
    return turn.reshape(3, 3).T[[1, 0]]


def _mount(tool: Tool) -> FloatArray:
    return _product(_turn('z', tool.azimuth), _turn('x', tool.tilt), _turn('z', tool.roll))


def _decay(tip: FloatArray, dt: float) -> RingDown:
    """Fit one decaying oscillation to the direction that moves most: tip (samples, 3)."""
    left = tip - tip.mean(axis=0)
    _, _, axes = np.linalg.svd(left, full_matrices=False)
    signal, t = left @ axes[0], np.arange(len(left)) * dt
    power = np.abs(np.fft.rfft(signal * np.hanning(len(t)), 8 * len(t)))
    begun = float(np.argmax(power[4:]) + 4) / (8 * len(t) * dt)

    def error(p: FloatArray) -> FloatArray:
        wave = np.exp(2.0 * np.pi * p[0] * t * (1j * math.sqrt(1.0 - p[1] ** 2) - p[1]))
        rows = np.column_stack([wave.real, wave.imag, np.ones_like(t)])
        return np.asarray(signal - rows @ np.linalg.lstsq(rows, signal, rcond=None)[0])
    found = least_squares(error, [begun, 0.02], x_scale=[0.1, 0.01],
                          bounds=([0.8 * begun, 0.0], [1.2 * begun, 0.3])).x
    return RingDown(float(found[0]), float(found[1]))


def _row(values: Any) -> str:
    return ' '.join(f'{value:.12g}' for value in values)


def _turn(axis: str, angle: float) -> FloatArray:
    """Give the quaternion of a turn about an axis."""
    return np.array([math.cos(angle / 2), *(
        math.sin(angle / 2) if name == axis else 0.0 for name in 'xyz')])


def _product(*turns: FloatArray) -> FloatArray:
    """Multiply quaternions."""
    whole = np.array([1.0, 0.0, 0.0, 0.0])
    for turn in turns:
        result = np.zeros(4)
        mujoco.mju_mulQuat(result, whole, turn)
        whole = result
    return whole
