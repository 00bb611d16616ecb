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

"""The arm in closed loop as a robot: velocity commands in, sensor samples out, in small steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.arm.limits import drive_stop
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.simulation.loop.closed_loop import ClosedLoop
from tudor_dynamics.simulation.loop.drive import Imperfections
from tudor_dynamics.simulation.loop.floor import Floor
from tudor_dynamics.simulation.loop.signals import with_payload
from tudor_dynamics.simulation.plant.outputs import Probe
from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True, eq=False)
class Sample:
    """What the sensors say."""

    t: float  # simulated time [s]
    # As measured, (joints,) [rad, rad/s, A].
    q: FloatArray
    dq: FloatArray
    current: FloatArray
    strain: FloatArray  # as measured, in units of the gauges, (gauges,)
    force: FloatArray  # force at the tip, in the base frame, (3,) [N]


class ArmProcess:
    """
    An arm whose joints take velocities.

    rate [Hz], payload [kg], force (3,) [N], command_timeout [s], held [rad or m]; failure: empty
    where nothing has failed.
    """

    def __init__(
        self, arm: Arm, *, rate: float = 500.0, payload: float = 0.0, damping: float = 0.0,
        imperfect: bool = True, seed: int = 0,
    ) -> None:
        if payload > 0.0:
            arm = with_payload(arm, payload)
        chosen = Imperfections() if imperfect else Imperfections.none()
        self.loop = ClosedLoop(arm, damping=damping, imperfections=chosen, seed=seed,
                               position_loop=False)
        steps = 1.0 / (rate * self.loop.dt)
        self.steps = round(steps)
        if self.steps < 1 or abs(steps - self.steps) > 1e-6:
            msg = (f'rate {rate:g} Hz: expected a whole part of the rate at which the arm is '
                   f'controlled, {1.0 / self.loop.dt:g} Hz (damper.rate)')
            raise SimulationError(msg)
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
        self._rest()

    def _rest(self) -> None:
        self.loop.reset(self.loop.described)
        count = len(self.loop.arm.active_joints)
        self._speed = np.zeros(count)
        self._age = np.inf
        self.force = np.zeros(3)

    def command(self, speed: FloatArray) -> None:
        """Take speeds of the joints; a failed arm does not [rad/s]."""
        if self.failure:
            return
        self._speed = np.array(speed, dtype=float)
        self._age = 0.0

    @property
    def speed(self) -> FloatArray:
        """Speeds that the joints were told last, or brake to by themselves [rad/s]."""
        return self._speed.copy()

    def tip(self) -> FloatArray:
        """Give the place of the tip in the base frame [m]."""
        position = self._probe.observe().position
        return np.asarray(position[self.loop.plant.mechanism.tip].copy())

    def step(self) -> Sample:
        """
        Advance by one sample and give what the sensors say at its start.

        A run that diverges is no end: the arm is put to rest, see ``failure``.
        """
        t = self.t
        self._samples += 1
        try:
            return self._advance(t, self.force, self.floor)
        except SimulationError as err:
            self.failure = str(err)
            self._rest()
            return self._advance(t, np.zeros(3), None)

    def _advance(self, t: float, force: FloatArray, floor: Floor | None) -> Sample:
        if self.failure:
            force, floor = np.zeros(3), None
        self.loop.set_force(force)
        self.loop.set_floor(floor)
        felt = np.array(force, dtype=float)
        if floor is not None:
            felt[2] += floor.stiffness * max(floor.height - float(self.tip()[2]), 0.0)
        period = self.steps * self.loop.dt
        if self._age >= self.command_timeout:  # as good drives do: braked, not cut off
            self._speed -= np.clip(self._speed, -period * self._braking, period * self._braking)
        speed = self._speed
        self._age += period
        q_ref = np.zeros((self.steps, len(speed)))  # no position loop: not used
        signals = self.loop.run(q_ref, np.tile(speed, (self.steps, 1)), every=self.steps)
        return Sample(t, signals.q[0], signals.dq[0], signals.current[0], signals.strain[0],
                      felt)
