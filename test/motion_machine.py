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

import dataclasses
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

from hypothesis import strategies as st
from hypothesis.stateful import initialize, invariant, rule, RuleBasedStateMachine
import numpy as np

from tudor_dynamics.arm.description import Arm, load_arm
from tudor_dynamics.arm.limits import hard_limits
from tudor_dynamics.control.references import REACTIONS
from tudor_dynamics.control.settings import WATCH_PERIOD
from tudor_dynamics.mechanics.closed_loop import Sample
from tudor_dynamics.mechanics.rig import Rig

PATH = Path(__file__).parent.parent / 'config' / 'tudor.yaml'
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


def go(rig: Rig, goal: np.ndarray) -> None:
    """Send a goal, which must be taken."""
    assert rig.source is not None
    assert rig.source.go(goal) == ''


def moving(**options: float) -> Rig:
    """Give an arm in the middle of a long move, at 70 deg/s."""
    rig = Rig(tudor(), **{'rate': 250.0, **options})
    rig.run(1.0)
    go(rig, FIRST)
    rig.run(3.2)
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

    @initialize(payload=st.sampled_from([0.0, 0.2, 0.4]), delay=st.sampled_from([0.0, 0.02, 0.06]),
                loss=st.sampled_from([0.0, 0.0, 0.05]), seed=st.integers(0, 99))
    def start(self, payload: float, delay: float, loss: float, seed: int) -> None:
        """Begin with an arm, its controller and a source of references."""
        self.rig = Rig(tudor(), rate=100.0, payload=payload, delay=delay, loss=loss, seed=seed)
        self.rig.run(0.3)

    def _run(self, seconds: float) -> None:
        assert self.rig is not None
        self.rig.run(seconds)

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
        kept = self.rig.trace.q[-1].copy()

        def alter(sample: Sample) -> Sample | None:
            if kind == 'driver':
                return None
            if kind == 'gauges':
                return dataclasses.replace(sample, strain=sample.strain * np.nan)
            q = {'nan': sample.q * np.nan, 'frozen': kept, 'jump': sample.q + [size, 0.0]}[kind]
            return dataclasses.replace(sample, q=q)
        self.rig.alter = alter
        self._run(seconds)
        self.rig.alter = None
        self._run(0.3)

    @rule(gain=st.floats(0.0, 100.0), share=st.floats(0.0, 2.0), timeout=st.floats(0.02, 0.5))
    def configure(self, gain: float, share: float, timeout: float) -> None:
        """Change gains and times while it moves."""
        assert self.rig is not None
        if self.rig.controller is not None:
            self.rig.controller.gains.set_position_gain(gain)
            self.rig.controller.gains.share = share
            self.rig.controller.timeout = timeout
        self._run(0.5)

    @rule()
    def reset(self) -> None:
        """Call ~/reset of both."""
        assert self.rig is not None
        if self.rig.controller is not None:
            self.rig.controller.reset()
        if self.rig.source is not None:
            self.rig.source.clear()
        self._run(0.3)

    @rule(seconds=st.floats(0.0, 1.5))
    def deactivate(self, seconds: float) -> None:
        """Deactivate the controller, and activate it again."""
        assert self.rig is not None
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
        if self.rig is not None:
            found = broken_limits(self.rig, self.seen)
            assert not found, found
            self.seen = len(self.rig.trace.t)
