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

"""The arm and its controller in lock-step on a simulated clock, with delay, loss and faults."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
import math

import numpy as np

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.control.motion_controller import MotionController, State
from tudor_dynamics.control.references import ReferenceSource
from tudor_dynamics.control.schedule import Adaptation, Schedule
from tudor_dynamics.mechanics.closed_loop import ArmProcess, Sample
from tudor_dynamics.typing import FloatArray


@dataclass(eq=False)
class RigLog:
    """What happened, sample by sample."""

    t: list[float] = field(default_factory=list)  # time of each record [s]
    # Positions and speeds of the joints as honest encoders have them, before ``Rig.alter``.
    q: list[FloatArray] = field(default_factory=list)
    dq: list[FloatArray] = field(default_factory=list)
    # The same of the links, after the gears with their play, as the plant has them.
    true_q: list[FloatArray] = field(default_factory=list)
    true_dq: list[FloatArray] = field(default_factory=list)
    # Speeds that the drives were commanded last, or brake to by themselves [rad/s].
    command: list[FloatArray] = field(default_factory=list)
    # Commands that left a controller: time [s], a number that changes where it took over an arm
    # whose speed was not its own doing, and speeds [rad/s].
    sent: list[tuple[float, int, FloatArray]] = field(default_factory=list)
    # Readings of the gauges [units of the gauges].
    strain: list[FloatArray] = field(default_factory=list)
    # Reference, not a number where there is none [rad].
    q_ref: list[FloatArray] = field(default_factory=list)
    # State of the controller; None while there is none.
    state: list[State | None] = field(default_factory=list)

    def array(self, name: str) -> FloatArray:
        """Stack a signal as (samples, channels)."""
        return np.array(getattr(self, name))


class Rig:
    """
    Simulated arm, controller and reference source on one simulated clock.

    Parameters
    ----------
    arm : Arm
        Description with everything.
    rate : float
        Samples per second [Hz].
    payload : float
        Mass at the tip [kg].
    delay : float
        Of the whole loop, half on the way in and half on the way out [s].
    loss : float
        Part of all messages that get lost.
    seed : int
        Of noise and losses.
    share : float
        Part of the damper's gains.

    Attributes
    ----------
    process : ArmProcess
        The arm; what acts on it is set there.
    controller, source : MotionController or None, ReferenceSource or None
        None while its node is dead.
    t : float
        Simulated time [s].
    trace : RigLog
        Record of what happened.
    alter : callable or None
        Changes a sample on its way, or loses it by None.
    obey : callable or None
        Changes what the driver makes of a command [rad/s], or loses it by None.
    late : float
        Further delay on the way in, as on a busy machine; what it held back arrives in order, and
        at once where it falls [s].
    frozen : set of str
        Which of 'controller' and 'source' are stopped, as a process by SIGSTOP.
    active : bool
        Whether the controller is to command; if not, it brakes to standstill first.

    """

    def __init__(
        self, arm: Arm, *, rate: float = 500.0, payload: float = 0.2, delay: float = 0.0,
        loss: float = 0.0, seed: int = 0, share: float = 1.0,
    ) -> None:
        self.arm, self.rate, self.delay, self.loss = arm, rate, delay, loss
        self.process = ArmProcess(arm, rate=rate, payload=payload, seed=seed)
        mechanism = self.process.loop.plant.mechanism
        self._joints = mechanism.q_index[[mechanism.joints.index(j) for j in arm.active_joints]]
        self._random = np.random.default_rng(seed)
        self._share = share
        self.t = self.late = 0.0
        self.trace = RigLog()
        self.alter: Callable[[Sample], Sample | None] | None = None
        self.obey: Callable[[FloatArray], FloatArray | None] | None = None
        self._inward: deque[tuple[float, Sample]] = deque()
        self._outward: deque[tuple[float, FloatArray]] = deque()
        self._stamp: float | None = None
        self._due = 0.0
        self._starts = 0
        self.frozen: set[str] = set()
        self.active = True
        self.controller: MotionController | None = None
        self.source: ReferenceSource | None = None
        self.start_controller()
        self.start_source()

    def start_controller(self) -> None:
        """Start the controller, as a process that was not there before."""
        self.controller = MotionController(self.arm, self._share)
        self._starts += 1
        self._stamp = None

    def start_source(self, reaction: str = 'retreat') -> None:
        """Start the source of references, as a new process, with a reaction to collisions."""
        self.source = ReferenceSource(self.arm, reaction=reaction)

    def follow(self, schedule: Schedule, payload: float) -> None:
        """
        Let the gains of the controller follow a schedule, as ``design`` computes it, from now on.

        The payload that the controller is given need not be the true one [kg].
        """
        assert self.controller is not None
        adaptation = Adaptation(schedule, self.controller.planned.acceleration)
        adaptation.tell(self.t, payload)
        self.controller.adaptation = adaptation

    def activate(self) -> None:
        """Let the controller command again, as it does at its start."""
        assert self.controller is not None
        self.controller.reset()
        self.active, self._stamp = True, None

    def run(self, seconds: float) -> None:
        """Let simulated time pass [s]."""
        for _ in range(round(seconds * self.rate)):
            self.step()

    def step(self) -> None:
        """Advance by one sample."""
        plant = self.process.loop.plant
        self.trace.true_q.append(plant.coordinates[self._joints])
        self.trace.true_dq.append(plant.rates[self._joints])
        measured = self.process.step()
        self._note(measured)
        sample = measured if self.alter is None else self.alter(measured)
        if sample is not None and not self._lost():
            self._inward.append((self.t, sample))
        while self._inward and (
                self._inward[0][0] + 0.5 * self.delay + self.late <= self.t + 1e-9):
            self._hear(self._inward.popleft()[1])
        controller, source = self._awake()
        reference = None if source is None else source.step(self.t, 1.0 / self.rate)
        if reference is not None and not self._lost() and controller is not None:
            controller.reference.add(self.t, *reference)
        self._watch()
        while self._outward and self._outward[0][0] <= self.t + 1e-9:
            _, command = self._outward.popleft()
            obeyed = command if self.obey is None else self.obey(command)
            if obeyed is not None:
                self.process.command(obeyed)
        self.t += 1.0 / self.rate

    def _awake(self) -> tuple[MotionController | None, ReferenceSource | None]:
        """Give controller and source, None where it is dead or frozen."""
        return (None if 'controller' in self.frozen else self.controller,
                None if 'source' in self.frozen else self.source)

    def _lost(self) -> bool:
        return self.loss > 0.0 and bool(self._random.random() < self.loss)

    def _hear(self, sample: Sample) -> None:
        controller, source = self._awake()
        finite = bool(np.isfinite(sample.q).all())
        if source is not None and finite:
            source.measured(self.t, sample.q)
        if controller is None or not (finite and self.active):
            return
        stamp, self._stamp = self._stamp, sample.t
        dt = sample.t - stamp if stamp is not None else 0.0
        self._command(controller.step(
            self.t, dt, sample.q, sample.strain, np.ones(len(sample.strain), dtype=bool),
            age=self.t - sample.t, dq=sample.dq, effort=sample.current))
        self._due = self.t + controller.watch_period

    def _watch(self) -> None:
        if self.t < self._due - 1e-9:
            return
        controller, _ = self._awake()
        if controller is not None:
            self._due = self.t + controller.watch_period
            self._command(controller.watch(self.t) if self.active
                          else controller.stand_still(self.t))

    def _command(self, command: FloatArray | None) -> None:
        if command is None:
            return
        assert self.controller is not None
        takeover = self._starts * 1000 + self.controller.takeovers
        self.trace.sent.append((self.t, takeover, command))
        if not self._lost():
            self._outward.append((self.t + 0.5 * self.delay, command))

    def _note(self, sample: Sample) -> None:
        trace = self.trace
        trace.t.append(self.t)
        trace.q.append(sample.q)
        trace.dq.append(sample.dq)
        trace.strain.append(sample.strain)
        trace.command.append(self.process.speed)
        reference = None if self.source is None else self.source.q
        trace.q_ref.append(np.full(len(sample.q), math.nan) if reference is None
                           else reference.copy())
        trace.state.append(None if self.controller is None else self.controller.state)
