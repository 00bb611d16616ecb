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

"""The simulated arm in lock-step with a controller, with delay, loss and faults: any, or ours."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
import math

import numpy as np
from numpy.typing import ArrayLike

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.control.motion_controller import MotionController, State
from tudor_dynamics.control.references import ReferenceSource
from tudor_dynamics.control.schedule import Adaptation, Schedule
from tudor_dynamics.errors import check_budget, check_type, SimulationError, UsageError
from tudor_dynamics.mechanics.closed_loop import ArmProcess, LoopRecord, Sample
from tudor_dynamics.mechanics.hardware import Imperfections, Push
from tudor_dynamics.typing import finite_array, FloatArray, Shown


@dataclass(eq=False)
class RigLog:
    """What happened, sample by sample."""

    t: list[float] = field(default_factory=list)  # time of each record [s]
    # Positions and speeds of the joints as honest encoders have them, before ``Loop.alter``.
    q: list[FloatArray] = field(default_factory=list)
    dq: list[FloatArray] = field(default_factory=list)
    # Positions of the links, after the gears with their play, as the plant has them.
    true_q: list[FloatArray] = field(default_factory=list)
    # Speeds that the drives were commanded last, or brake to by themselves [rad/s].
    command: list[FloatArray] = field(default_factory=list)
    # Commands that left a controller: time [s], a number that changes where it took over an arm
    # whose speed was not its own doing, and speeds [rad/s].
    sent: list[tuple[float, int, FloatArray]] = field(default_factory=list)
    current: list[FloatArray] = field(default_factory=list)  # of the motors [A]
    # Readings of the gauges [units of the gauges].
    strain: list[FloatArray] = field(default_factory=list)
    force: list[FloatArray] = field(default_factory=list)  # on the tip, in the base frame [N]
    # Reference, not a number where there is none [rad].
    q_ref: list[FloatArray] = field(default_factory=list)
    # State of the controller; None while there is none.
    state: list[State | None] = field(default_factory=list)

    def array(self, name: str, begin: int = 0) -> FloatArray:
        """Stack a signal as (samples, channels), from a sample on."""
        return np.array(getattr(self, name)[begin:])


class Loop(Shown):
    """
    Simulated arm with drives, gears with play, sensors and delay, under a controller of one's own.

    Parameters
    ----------
    arm : Arm
        Description with links and motors.
    controller : callable
        Gets each ``Sample`` (``t``, ``q``, ``dq``, ``current``, ``strain``, ``force``), and
        returns the velocities (n_joints,) that the drives shall follow [rad/s], or None to leave
        them as they are: there is neither a position loop nor a limit. The drives brake where they
        hear nothing for their timeout.
    rate : float, default=500
        Samples per second [Hz].
    payload : float, default=0
        Mass at the tip [kg].
    delay : float, default=0
        Of the whole loop, half on the way in and half on the way out [s].
    loss : float, default=0
        Part of all messages that get lost.
    imperfections : Imperfections
        What is not ideal about drives and sensors; all of it by default.
    pushes : sequence of Push
        Forces on links, by the time since the start.
    start : array_like of shape (n_joints,), optional
        Where the joints start; as described by default [rad].
    seed : int, default=0
        Of noise and losses.

    Attributes
    ----------
    process : ArmProcess
        The arm; what acts on it is set there.
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

    Raises
    ------
    ArmError, SimulationError
        If the arm lacks what is needed, or the rate is no whole part of that of its drives.

    """

    def __init__(
        self, arm: Arm, controller: Callable[[Sample], ArrayLike | None], *, rate: float = 500.0,
        payload: float = 0.0, delay: float = 0.0, loss: float = 0.0,
        imperfections: Imperfections = Imperfections(),  # noqa: B008 (frozen)
        pushes: Sequence[Push] = (), start: ArrayLike | None = None, seed: int = 0,
    ) -> None:
        check_type(arm, Arm, 'arm', "read a description with load_arm('arm.yaml')")
        if not callable(controller):
            raise UsageError(f'controller is {controller!r}; expected a function that takes a '
                             'sample and returns velocities')
        if not 0.0 <= delay < math.inf:
            raise UsageError(f'delay is {delay} s; expected 0 s or more')
        self.arm, self.rate, self.delay, self.loss = arm, rate, delay, loss
        self.process = ArmProcess(arm, rate=rate, payload=payload, imperfections=imperfections,
                                  seed=seed)
        if start is not None:
            self.process.loop.reset(start)
        self.process.loop.set_pushes(pushes)
        mechanism = self.process.loop.plant.mechanism
        self._joints = mechanism.q_index[[mechanism.joints.index(j) for j in arm.active_joints]]
        self._answer = controller
        self._random = np.random.default_rng(seed)
        self.t = self.late = 0.0
        self.trace = RigLog()
        self.alter: Callable[[Sample], Sample | None] | None = None
        self.obey: Callable[[FloatArray], FloatArray | None] | None = None
        self._inward: deque[tuple[float, Sample]] = deque()
        self._outward: deque[tuple[float, FloatArray]] = deque()

    def run(self, seconds: float) -> LoopRecord:
        """Let simulated time pass [s]; a further call goes on, unless the arm has diverged."""
        check_budget(f'a run of {seconds:g} s', seconds * self.rate, 400.0)
        begin = len(self.trace.t)
        for _ in range(round(seconds * self.rate)):
            self.step()
            if self.process.failure:
                raise SimulationError(self.process.failure)
        return LoopRecord(*(self.trace.array(name, begin) for name in (
            't', 'q', 'dq', 'current', 'strain', 'q_ref', 'command', 'true_q')))

    def step(self) -> None:
        """Advance by one sample."""
        self.trace.true_q.append(self.process.loop.plant.coordinates[self._joints])
        measured = self.process.step()
        self.note(measured)
        sample = measured if self.alter is None else self.alter(measured)
        if sample is not None and not self._lost():
            self._inward.append((self.t, sample))
        while self._inward and (
                self._inward[0][0] + 0.5 * self.delay + self.late <= self.t + 1e-9):
            self._send(self._answer(self._inward.popleft()[1]))
        self.act()
        while self._outward and self._outward[0][0] <= self.t + 1e-9:
            _, command = self._outward.popleft()
            obeyed = command if self.obey is None else self.obey(command)
            if obeyed is not None:
                self.process.command(obeyed)
        self.t += 1.0 / self.rate

    def act(self) -> None:
        """Do what is due besides answering samples."""

    @property
    def takeovers(self) -> int:
        """Give a number that changes where a controller took over a moving arm."""
        return 0

    def _lost(self) -> bool:
        return self.loss > 0.0 and bool(self._random.random() < self.loss)

    def _send(self, answer: ArrayLike | None) -> None:
        if answer is None:
            return
        command = finite_array(answer, 'the answer of the controller', len(self._joints))
        self.trace.sent.append((self.t, self.takeovers, command))
        if not self._lost():
            self._outward.append((self.t + 0.5 * self.delay, command))

    def note(self, sample: Sample) -> None:
        """Record a sample, and the commands of the drives."""
        trace = self.trace
        trace.t.append(self.t)
        for name in ('q', 'dq', 'current', 'strain', 'force'):
            getattr(trace, name).append(getattr(sample, name))
        trace.command.append(self.process.speed)
        trace.q_ref.append(self.wanted(sample))

    def wanted(self, sample: Sample) -> FloatArray:
        """Give the reference, not a number where there is none [rad]."""
        return np.full(len(sample.q), math.nan)


class Rig(Loop):
    """
    The loop under the package's own controller and reference source.

    ``rig.run(1.0)`` brings the first positions, ``rig.source.go(target)`` gives why a move cannot
    begin, or nothing, and ``rig.run(5.0)`` records it.

    Parameters
    ----------
    arm : Arm
        Description with everything.
    payload : float, default=0.2
        Mass at the tip [kg].
    share : float
        Part of the damper's gains, 0 for an undamped arm.
    rate, delay, loss, seed : float, float, float, int
        As of `Loop`.

    Attributes
    ----------
    controller, source : MotionController or None, ReferenceSource or None
        None while its node is dead.
    frozen : set of str
        Which of 'controller' and 'source' are stopped, as a process by SIGSTOP.
    active : bool
        Whether the controller is to command; if not, it brakes to standstill first.

    """

    def __init__(
        self, arm: Arm, *, rate: float = 500.0, payload: float = 0.2, delay: float = 0.0,
        loss: float = 0.0, seed: int = 0, share: float = 1.0,
    ) -> None:
        super().__init__(arm, self._command, rate=rate, payload=payload, delay=delay, loss=loss,
                         seed=seed)
        self._share = share
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

    def act(self) -> None:
        """Give the controller a reference, and let it watch over its inputs."""
        controller, source = self._awake()
        reference = None if source is None else source.step(self.t, 1.0 / self.rate)
        if reference is not None and not self._lost() and controller is not None:
            controller.reference.add(self.t, *reference)
        if self.t >= self._due - 1e-9 and controller is not None:
            self._due = self.t + controller.watch_period
            self._send(controller.watch(self.t) if self.active else controller.stand_still(self.t))

    @property
    def takeovers(self) -> int:
        """Count starts of controllers, and what each took over."""
        return self._starts * 1000 + (0 if self.controller is None else self.controller.takeovers)

    def _awake(self) -> tuple[MotionController | None, ReferenceSource | None]:
        """Give controller and source, None where it is dead or frozen."""
        return (None if 'controller' in self.frozen else self.controller,
                None if 'source' in self.frozen else self.source)

    def _command(self, sample: Sample) -> FloatArray | None:
        """Inform both of a sample; the controller answers it."""
        controller, source = self._awake()
        finite = bool(np.isfinite(sample.q).all())
        if source is not None and finite:
            source.measured(self.t, sample.q)
        if controller is None or not (finite and self.active):
            return None
        stamp, self._stamp = self._stamp, sample.t
        dt = sample.t - stamp if stamp is not None else 0.0
        command = controller.step(
            self.t, dt, sample.q, sample.strain, np.ones(len(sample.strain), dtype=bool),
            age=self.t - sample.t, dq=sample.dq, effort=sample.current)
        self._due = self.t + controller.watch_period
        return command

    def note(self, sample: Sample) -> None:
        """Record also what the controller does."""
        super().note(sample)
        self.trace.state.append(None if self.controller is None else self.controller.state)

    def wanted(self, sample: Sample) -> FloatArray:
        reference = None if self.source is None else self.source.q
        return super().wanted(sample) if reference is None else reference.copy()
