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

"""What must hold in every sample of a commanded arm, and random sequences that try to break it."""

from __future__ import annotations

from contextlib import suppress
import dataclasses
from functools import lru_cache
from itertools import pairwise

from hypothesis import strategies as st
from hypothesis.stateful import initialize, invariant, rule, RuleBasedStateMachine
from lying import acceleration, BEYOND, FASTER, Liar, Lie, LIES, NOISY, PATH, SAMPLES, VELOCITIES
import numpy as np
from tudor_dynamics.arm.description import Arm, load_arm
from tudor_dynamics.arm.limits import hard_limits, planned_limits
from tudor_dynamics.control.references import REACTIONS
from tudor_dynamics.control.settings import WATCH_PERIOD
from tudor_dynamics.errors import TudorError
from tudor_dynamics.mechanics.closed_loop import Sample
from tudor_dynamics.mechanics.rig import Rig

FIRST, SECOND = np.radians([20.0, -60.0]), np.radians([170.0, 60.0])
"""Ends of a long move of both joints, within what is planned."""


@lru_cache
def tudor() -> Arm:
    """Read the reference arm."""
    return load_arm(PATH)


def broken_limits(rig: Rig, begin: int = 0) -> list[str]:
    """
    Say which samples were beyond the limits: positions, told speeds, and their change.

    The change is that of commands as they leave: one that gets lost is made up for by the next,
    and an arm is taken over at the speed that it has. Where positions are missing, commands come
    every ``WATCH_PERIOD`` seconds and may step accordingly. The period is as the controller
    learned it: lost samples lengthen it by their share.
    """
    limits, trace = hard_limits(rig.arm), rig.trace
    q = np.array(trace.q[begin:])
    told = np.array(trace.command[begin:])
    found = []
    for what, values, bound in (
            ('below', limits.lower - q, 0.0), ('above', q - limits.upper, 0.0),
            ('speed', np.abs(told), limits.velocity * (1.0 + 1e-9))):
        wrong = values > bound
        if wrong.any():
            k, j = np.argwhere(wrong)[0]
            found.append(f'{what}: joint {j} at {trace.t[begin + k]:.3f} s: {values[k, j]:.4g}')
    allowed = limits.acceleration * max(1.1 / rig.rate, WATCH_PERIOD) * (1.0 + 1e-9)
    for (_, before, last), (t, now, command) in pairwise(trace.sent):
        if before == now and np.any(np.abs(command - last) > allowed):
            found.append(f'acceleration: {command - last} rad/s at {t:.3f} s in one command')
            break
    return found


def left_envelope(
    rig: Rig, deepest: np.ndarray, runaway: bool, begin: int, swapped: float = 0.0,
) -> list[str]:
    """
    Say which samples were truly beyond the envelope of an arm about which something has lied.

    That is ``BEYOND`` farther than it was when the lie began (deepest, (joints,) [rad]), and
    ``FASTER``. What the loop's delay keeps from a controller is added, at the speed from which the
    plan brakes within ``BEYOND``; and where a drive takes its commands for 57 times as much, what
    its motor does with all of its current in the meantime (``lying.bounds``).
    """
    limits, trace, joints = hard_limits(rig.arm), rig.trace, range(len(deepest))
    blind = rig.delay + (2.0 / rig.rate if rig.loss > 0.0 else 0.0)
    near = np.sqrt(2.0 * planned_limits(rig.arm).acceleration * BEYOND)
    beyond = np.maximum(deepest, 0.0) + BEYOND + np.maximum(
        near * blind, swapped * (blind + 1.0 / rig.rate))
    speed = FASTER * limits.velocity
    if runaway:
        late = SAMPLES / rig.rate + 0.01 + blind
        most = np.array([acceleration(rig.arm, j) for j in joints])
        beyond, speed = beyond + most * late**2 + 2.0 * near * late, speed + most * late
    q = np.array(trace.q[max(begin - 1, 0):])
    found = []
    for what, values, bound in (
            ('below', limits.lower - q, beyond), ('above', q - limits.upper, beyond),
            ('speed', np.abs(np.diff(q, axis=0)) * rig.rate, speed)):
        wrong = values > bound
        if wrong.any():
            k, j = np.argwhere(wrong)[0]
            found.append(f'{what}: joint {j} at {trace.t[max(begin - 1, 0) + k]:.3f} s: '
                         f'{np.degrees(values[k, j]):.1f} of {np.degrees(bound[j]):.1f} deg')
    return found


def go(rig: Rig, goal: np.ndarray) -> None:
    """Send a goal, which must be taken."""
    assert rig.source is not None
    assert rig.source.go(goal) == ''


def moving(**options: float) -> Rig:
    """Give an arm in the middle of a long move, at 70 deg/s."""
    rig = Rig(tudor(), **{'rate': 100.0, **options})
    rig.process.loop.reset(FIRST)
    rig.run(1.0)
    go(rig, SECOND)
    rig.run(0.9)
    assert np.degrees(rig.trace.dq[-1][0]) > 55.0
    return rig


class MotionMachine(RuleBasedStateMachine):
    """Faults, references, reconfigurations and reactions in any order."""

    def __init__(self) -> None:
        super().__init__()
        self.rig: Rig | None = None
        self.seen = 0
        self.lied = self.runaway = False
        self.deepest, self.swapped = np.zeros(2), 0.0

    @initialize(payload=st.sampled_from([0.0, 0.2, 0.4]), delay=st.sampled_from([0.0, 0.02, 0.06]),
                loss=st.sampled_from([0.0, 0.0, 0.05]), seed=st.integers(0, 99),
                rate=st.sampled_from([100.0, 100.0, 50.0]))
    def start(
        self, payload: float, delay: float, loss: float, seed: int, rate: float = 100.0,
    ) -> None:
        """Begin with an arm, its controller and a source of references."""
        self.rig = Rig(tudor(), rate=rate, payload=payload, delay=delay, loss=loss, seed=seed)
        self.liar = Liar(self.rig)
        self.rig.run(0.3)

    def _run(self, seconds: float) -> None:
        assert self.rig is not None
        self.rig.run(seconds)

    def _truth(self) -> None:
        """
        End a lie.

        What begins again (a reset, a new controller) takes the positions that it is given, so
        nothing could know the true ones.
        """
        self.within_limits()
        self.liar.end()

    @rule(lie=st.sampled_from([*LIES, NOISY]), velocity=st.sampled_from(VELOCITIES),
          sign=st.sampled_from([-1.0, 1.0]), seconds=st.floats(0.1, 4.0))
    def lie(self, lie: Lie, velocity: str, sign: float, seconds: float) -> None:
        """Let a drive or an encoder begin to lie, and go on with it."""
        assert self.rig is not None
        self._truth()
        limits, q = hard_limits(self.rig.arm), self.rig.trace.q[-1]
        self.deepest = np.maximum(limits.lower - q, q - limits.upper)
        self.lied, self.runaway = True, self.runaway or lie.kind == 'runaway'
        self.swapped = float(np.abs(self.rig.trace.command[-1]).max()) * (lie.kind == 'swapped')
        self.liar.begin(lie, velocity, sign)
        self._run(seconds)

    @rule(lie=st.sampled_from(LIES), velocity=st.sampled_from(VELOCITIES),
          shares=st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0)),
          sign=st.sampled_from([-1.0, 1.0]), before=st.floats(0.0, 2.0))
    def lie_in_a_move(self, lie: Lie, velocity: str, shares: tuple[float, float], sign: float,
                      before: float) -> None:
        """Let a drive or an encoder begin to lie at any moment of a move."""
        self.goal(shares, before)
        self.lie(lie, velocity, sign, 2.0)

    @rule()
    def truth(self) -> None:
        """Let nothing lie any more."""
        self._truth()
        self._run(0.3)

    @rule(late=st.floats(0.05, 0.8), seconds=st.floats(0.05, 2.0), times=st.integers(1, 4))
    def busy(self, late: float, seconds: float, times: int) -> None:
        """Let positions wait on a busy machine, and all arrive at once."""
        assert self.rig is not None
        self._truth()
        self.lied = True  # in the sense that positions are not the true ones
        for _ in range(times):
            self.rig.late = late
            self._run(seconds)
            self.rig.late = 0.0
            self._run(0.1)

    @rule(shares=st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0)), seconds=st.floats(0.1, 3.0))
    def goal(self, shares: tuple[float, float], seconds: float) -> None:
        """Send a goal anywhere within the limits."""
        assert self.rig is not None
        limits = hard_limits(self.rig.arm)
        if self.rig.source is not None:
            self.rig.source.go(limits.lower + np.array(shares) * (limits.upper - limits.lower))
        self._run(seconds)

    @rule(q=st.tuples(st.floats(-60.0, 60.0), st.floats(-60.0, 60.0)),
          dq=st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0)), number=st.integers(1, 60))
    def foreign_reference(self, q: tuple[float, float], dq: tuple[float, float], number: int,
                          ) -> None:
        """Let somebody else publish references, too: degrees, steps, nonsense."""
        assert self.rig is not None
        for _ in range(number):
            if self.rig.controller is not None:
                self.rig.controller.reference.add(self.rig.t, np.array(q), np.array(dq))
            self._run(0.01)

    @rule(who=st.sampled_from(['controller', 'source']), seconds=st.floats(0.02, 3.0))
    def freeze(self, who: str, seconds: float) -> None:
        """Stop a process for a while."""
        assert self.rig is not None
        self.rig.frozen = {who}
        self._run(seconds)
        self.rig.frozen = set()
        self._run(0.5)

    @rule(who=st.sampled_from(['controller', 'source']), seconds=st.floats(0.0, 2.0),
          reaction=st.sampled_from(REACTIONS))
    def kill(self, who: str, seconds: float, reaction: str) -> None:
        """Let a process die, and come back."""
        assert self.rig is not None
        if who == 'controller':
            self._truth()
        setattr(self.rig, who, None)
        self._run(seconds)
        if who == 'controller':
            self.rig.start_controller()
            self.rig.active = True
        else:
            self.rig.start_source(reaction)
        self._run(0.3)

    @rule(seconds=st.floats(0.02, 2.0))
    def cut(self, seconds: float) -> None:
        """Cut the network."""
        assert self.rig is not None
        loss, self.rig.loss = self.rig.loss, 1.0
        self._run(seconds)
        self.rig.loss = loss
        self._run(0.5)

    @rule(kind=st.sampled_from(['nan', 'frozen', 'jump', 'driver', 'gauges']),
          seconds=st.floats(0.02, 2.0), size=st.floats(-1.5, 1.5))
    def fault(self, kind: str, seconds: float, size: float) -> None:
        """Let sensors or their driver fail for a while."""
        assert self.rig is not None
        self._truth()
        kept, honest = self.rig.trace.q[-1].copy(), self.rig.alter

        def alter(sample: Sample) -> Sample | None:
            if kind == 'driver':
                return None
            if kind == 'gauges':
                return dataclasses.replace(sample, strain=sample.strain * np.nan)
            q = {'nan': sample.q * np.nan, 'frozen': kept, 'jump': sample.q + [size, 0.0]}[kind]
            return dataclasses.replace(sample, q=q)
        self.rig.alter = alter
        self._run(seconds)
        self.rig.alter = honest
        self._run(0.3)

    @rule(gain=st.floats(0.0, 100.0), share=st.floats(0.0, 10.0), timeout=st.floats(0.02, 60.0))
    def configure(self, gain: float, share: float, timeout: float) -> None:
        """Change gains and times while it moves."""
        assert self.rig is not None
        if self.rig.controller is not None:
            with suppress(TudorError, ValueError):
                self.rig.controller.gains.asked = gain
            with suppress(TudorError, ValueError):
                self.rig.controller.gains.share = share
            with suppress(TudorError, ValueError):
                self.rig.controller.timeout = timeout
        self._run(0.5)

    @rule()
    def reset(self) -> None:
        """Call ~/reset of both."""
        assert self.rig is not None
        self._truth()
        if self.rig.controller is not None:
            self.rig.controller.reset()
        if self.rig.source is not None:
            self.rig.source.clear()
        self._run(0.3)

    @rule(seconds=st.floats(0.0, 1.5))
    def deactivate(self, seconds: float) -> None:
        """Deactivate the controller, and activate it again."""
        assert self.rig is not None
        self._truth()
        self.rig.active = False
        self._run(seconds)
        if self.rig.controller is not None:
            self.rig.activate()
        self._run(0.3)

    @rule(strain=st.floats(-300.0, 300.0), seconds=st.floats(0.1, 1.0))
    def collide(self, strain: float, seconds: float) -> None:
        """Report a collision."""
        assert self.rig is not None
        source = self.rig.source
        if source is not None:
            source.collide(True)
            if source.motion is not None:
                source.motion.yielding[:] = 1e-3 * strain
        self._run(seconds)
        if source is not None:
            source.collide(False)
            source.clear()

    @rule(seed=st.integers(0, 9), seconds=st.floats(0.5, 4.0))
    def wander(self, seed: int, seconds: float) -> None:
        """Wander to random targets."""
        assert self.rig is not None
        if self.rig.source is not None:
            self.rig.source.wander(seed)
        self._run(seconds)

    @invariant()
    def within_limits(self) -> None:
        """Find no sample since the last look beyond a limit."""
        if self.rig is not None and self.seen < len(self.rig.trace.t):
            found = (left_envelope(
                self.rig, self.deepest, self.runaway, self.seen, self.swapped) if self.lied
                     else broken_limits(self.rig, self.seen))
            assert not found, found
            self.seen = len(self.rig.trace.t)
