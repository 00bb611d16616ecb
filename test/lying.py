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
Drives and encoders that lie, the situations in which they begin to, and what must hold then.

What a joint truly does is what an honest encoder on its motor would say (``RigLog.q``): that is
what limits are about, and what no gear twists. The link hangs on it by play and torsion, which
yield by ``YIELD`` in honest moves already (400 g, measured); its angle may be that much further
beyond a limit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import dataclasses
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import cycle, product
from pathlib import Path
import re

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from tudor_dynamics.arm.description import Arm, load_arm
from tudor_dynamics.arm.limits import hard_limits
from tudor_dynamics.control.motion_controller import State
from tudor_dynamics.mechanics.closed_loop import Sample
from tudor_dynamics.mechanics.rig import Rig

PATH = Path(__file__).parent.parent / 'config' / 'tudor.yaml'
BEYOND, FASTER, STANDSTILL, FALSE = np.radians(1.0), 1.05, 0.5, np.radians(5.0)
"""Bounds: beyond a limit [rad], of the speed limit, until standstill [s], false motion [rad]."""
YIELD = np.radians(3.5)
"""How far play and torsion of the gears let links be from their motors in honest moves [rad]."""
STILL = np.radians(1.0)
"""Standstill: the motors stay within it, in which links swing out and drives give way [rad]."""
AFTER = 1.2
"""How long a run goes on after the detection [s]."""
SAMPLES = 3
"""Of a new speed, before a controller knows it without efforts: one in which the speed changes,
one that shows it, one that confirms."""
ANSWER = 0.06
"""Within it an honest drive does what it is told: lag of its loop, held sample [s]."""

KINDS = {
    'reversed': r'revers|negat|backward|opposite|wrong (way|direction)|\bsign\b',
    'scaled': r'scal|factor|times|\bunits?\b|\bdegrees\b|tenth|half|twice|ratio',
    'runaway': r'scal|factor|times|\bunits?\b|\bdegrees\b|faster|run(s|ning)? away|runaway',
    'slips': r'slip|loses|lost counts|scal|factor|times',
    'drifts': r'drift|creep|by itself|without (a |being )?command|not commanded|uncommanded',
    'stuck': r'stuck|frozen|freez|stands|does not (move|turn|answer|follow)|no motion|dead|deaf',
    'swapped': r'swap|\border\b|exchang|other joint|mixed up|jump',
    'jumped': r'jump'}
"""What a text may call each kind of lie."""
CULPRITS = {
    'drive': r'\bdrives?\b|\bdriver\b|commands? (or|and|are)\b',
    'encoder': r'encoder|reading|position'}


@dataclass(frozen=True, eq=False)
class Lie:
    """What lies: commands or positions are turned, shifted, drift, or are lost in part."""

    name: str
    who: str  # 'drive' or 'encoder'
    kind: str  # key of KINDS
    joints: tuple[int, ...] = (0,)
    turn: np.ndarray = field(default_factory=lambda: np.eye(2))  # what becomes of changes
    rate: float = 0.0  # of the first joint, by itself [rad/s]
    step: float = 0.0  # of the first joint, at once [rad]
    dither: float = 0.0  # greatest noise of positions, encoder counts
    slip: float = 0.0  # part of the samples whose motion is not counted
    whole: bool = False  # whether positions are turned themselves, not their changes

    @property
    def slow(self) -> bool:
        """Whether it shows without any goal, in seconds."""
        return self.rate != 0.0

    @property
    def seconds(self) -> float:
        """How long it is looked at [s]."""
        return 3.0 if not self.slow else max(3.0, 1.2 * FALSE / abs(self.rate))


def diagonal(value: float, joint: int = 0) -> np.ndarray:
    """Scale one joint, or both for joint -1."""
    turn = np.eye(2)
    for j in range(2) if joint < 0 else [joint]:
        turn[j, j] = value
    return turn


SWAP = np.eye(2)[::-1]
DEGREE = np.degrees(1.0)
DRIVES = (
    Lie('drive negates', 'drive', 'reversed', turn=diagonal(-1.0)),
    Lie('drive negates joint3', 'drive', 'reversed', (1,), diagonal(-1.0, 1)),
    Lie('drive swaps', 'drive', 'swapped', (0, 1), SWAP),
    Lie('drive takes rad for deg', 'drive', 'runaway', (0, 1), diagonal(DEGREE, -1)),
    Lie('drive takes deg for rad', 'drive', 'scaled', (0, 1), diagonal(1.0 / DEGREE, -1)),
    Lie('drive does half', 'drive', 'scaled', turn=diagonal(0.5)),
    Lie('drive does half, joint3', 'drive', 'scaled', (1,), diagonal(0.5, 1)),
    Lie('drive is deaf', 'drive', 'stuck', turn=diagonal(0.0)),
    *(Lie(f'drive creeps {speed}', 'drive', 'drifts', rate=np.radians(speed))
      for speed in (10, 3, 1)))
ENCODERS = (
    *(Lie(f'encoder drifts {speed}', 'encoder', 'drifts', rate=np.radians(speed))
      for speed in (10, 3, 1)),
    Lie('encoder counts a tenth', 'encoder', 'scaled', turn=diagonal(0.1)),
    Lie('encoder counts half', 'encoder', 'scaled', turn=diagonal(0.5)),
    Lie('encoder counts half, joint3', 'encoder', 'scaled', (1,), diagonal(0.5, 1)),
    Lie('encoder counts twice', 'encoder', 'scaled', turn=diagonal(2.0)),
    Lie('encoder counts backwards', 'encoder', 'reversed', turn=diagonal(-1.0)),
    Lie('encoder counts backwards, joint3', 'encoder', 'reversed', (1,), diagonal(-1.0, 1)),
    Lie('encoder slips', 'encoder', 'slips', slip=0.7, dither=1.0),
    Lie('encoder is stuck', 'encoder', 'stuck', turn=diagonal(0.0)),
    Lie('encoder is stuck with dither', 'encoder', 'stuck', turn=diagonal(0.0), dither=1.0),
    Lie('encoders are swapped', 'encoder', 'swapped', (0, 1), SWAP, whole=True),
    *(Lie(f'encoder jumps {step}', 'encoder', 'jumped', step=np.radians(step))
      for step in (20, 3)))
LIES = DRIVES + ENCODERS
NOISY = Lie('honest, with a count of noise', 'encoder', '', dither=1.0)
HONEST = Lie('honest', '', '')
STARTS = ('begin', 'rest', 'moving', 'towards', 'away')
VELOCITIES = ('along', 'truth', 'absent')
"""The driver's own velocities lie as the positions do, say the truth, or are no numbers."""


class Liar:
    """Lets a lie act on a rig from now on; ``readings`` has all positions that left for it."""

    def __init__(self, rig: Rig) -> None:
        self.rig, self.lie = rig, HONEST
        self.readings: list[np.ndarray] = []
        self.velocity = 'truth'
        self._random = np.random.default_rng(5)
        motors = {motor.joint: motor for motor in rig.arm.spec.motors}
        self._counts = np.array([motors[j].encoder_resolution for j in rig.arm.active_joints])
        rig.alter, rig.obey = self._alter, self._obey

    def begin(self, lie: Lie, velocity: str = 'truth', sign: float = 1.0) -> None:
        """Begin to lie; sign: direction of what moves by itself."""
        self.lie, self.velocity, self._sign = lie, velocity, sign
        self._start: Sample | None = None
        self._slipped = np.zeros(2)

    def end(self) -> None:
        """Tell the truth from now on."""
        self.lie, self.velocity = HONEST, 'truth'

    def _first(self, value: float) -> np.ndarray:
        return np.array([value * (j == self.lie.joints[0]) for j in range(2)])

    def _obey(self, command: np.ndarray) -> np.ndarray:
        if self.lie.who != 'drive':
            return command
        return self.lie.turn @ command + self._first(self._sign * self.lie.rate)

    def _alter(self, sample: Sample) -> Sample:
        lie, q, dq = self.lie, sample.q, sample.dq
        if lie.who == 'encoder':
            if self._start is None:
                self._start = self._last = sample
            start = np.zeros(2) if lie.whole else self._start.q
            self._slipped += (sample.q - self._last.q) * self._first(
                float(self._random.random() < lie.slip))
            self._last = sample
            q = start + lie.turn @ (q - self._slipped - start) + self._first(
                self._sign * (lie.step + lie.rate * (sample.t - self._start.t))
                + lie.dither * self._counts[lie.joints[0]] * self._random.integers(-1, 2))
            if self.velocity == 'along' and self.readings:
                dq = lie.turn @ dq * (1.0 - lie.slip) + self._first(self._sign * lie.rate)
        if self.velocity == 'absent':
            dq = np.full(2, np.nan)
        self.readings.append(q)
        return dataclasses.replace(sample, q=q, dq=dq)


def held_commands(rig: Rig) -> np.ndarray:
    """Give what was commanded at each sample, the true speed where nobody commands [rad/s]."""
    times = np.array([item[0] for item in rig.trace.sent])
    speeds = np.array([item[2] for item in rig.trace.sent]).reshape(-1, 2)
    t = np.array(rig.trace.t)
    last = np.searchsorted(times, t + 1e-9, side='right') - 1
    held = speeds[last]
    nobody = (last < 0) | (t - times[last] > rig.process.command_timeout)
    held[nobody] = rig.trace.array('dq')[nobody]
    return held


def false_motion(rig: Rig, readings: np.ndarray, begin: int) -> np.ndarray:
    """
    Give the false motion of each joint since a sample, summed up, (samples, joints) [rad].

    False is the largest of three speeds: true motion that was not commanded (beyond all commands
    within ``ANSWER``, and beyond standstill), read motion that was not commanded, and commanded
    motion that is not read (less than the least command within ``ANSWER``).
    """
    width = 2 * round((ANSWER + rig.delay) * rig.rate) + 1
    shift = width // 2  # of the window, which ends at the present sample
    command = held_commands(rig)
    high = maximum_filter1d(command, width, axis=0, origin=shift)
    low = minimum_filter1d(command, width, axis=0, origin=shift)
    true, read = (np.diff(values, axis=0, prepend=values[:1]) * rig.rate
                  for values in (rig.trace.array('q'), readings))

    def excess(speed: np.ndarray) -> np.ndarray:
        return np.maximum(speed - np.maximum(high, 0.0), np.minimum(low, 0.0) - speed)
    missing = np.where(low > 0.0, low - read, np.where(high < 0.0, read - high, 0.0))
    false = np.maximum(np.maximum(excess(true), excess(read)), np.maximum(missing, 0.0))
    false[:begin + 1] = 0.0
    return np.cumsum(np.maximum(false, 0.0), axis=0) / rig.rate


@lru_cache
def resting(place: tuple[float, ...]) -> Arm:
    """Give the reference arm as it begins at rest somewhere [rad]."""
    arm = load_arm(PATH)
    simulation = arm.spec.simulation.model_copy(update={
        'initial': dict(zip(arm.active_joints, place, strict=True))})
    return dataclasses.replace(arm, spec=arm.spec.model_copy(update={'simulation': simulation}))


@dataclass(frozen=True)
class Case:
    """A lie in a situation."""

    lie: Lie
    start: str
    rate: float = 100.0
    payload: float = 0.0
    velocity: str = 'truth'
    inside: float = 1.0  # how far inside a limit it begins to lie [deg]
    upper: bool = False  # at which limit

    def __str__(self) -> str:
        where = f' {self.inside:g} {"upper" if self.upper else "lower"}' if self.near else ''
        return (f'{self.lie.name}, {self.start}{where}, {self.rate:g} Hz, {self.payload:g} kg, '
                f'velocity {self.velocity}')

    @property
    def near(self) -> bool:
        """Whether it begins near a limit."""
        return self.start in ('towards', 'away')

    @property
    def side(self) -> float:
        """Direction of the limit."""
        return 1.0 if self.upper else -1.0


def place_of(case: Case) -> np.ndarray:
    """Give where the arm begins [rad]."""
    if case.start == 'moving':
        return np.radians([25.0, -60.0])
    place = np.radians([45.0, 30.0])
    if case.near:
        limits, joint = hard_limits(load_arm(PATH)), case.lie.joints[0]
        limit = (limits.upper if case.upper else limits.lower)[joint]
        place = np.radians([60.0, 0.0])
        place[joint] = limit - case.side * np.radians(case.inside)
    return place


def cases(
    rates: Sequence[float] = (100.0, 500.0), payloads: Sequence[float] = (0.0, 0.4),
    velocities: Sequence[str] = VELOCITIES, starts: Sequence[str] = STARTS,
    lies: Sequence[Lie] = LIES,
) -> Iterator[Case]:
    """Combine all lies and situations; the limit and the way to it change from one to the next."""
    ways = cycle(product((1.0, 2.0, 3.0), (False, True)))
    for lie, start, rate, payload, velocity in product(lies, starts, rates, payloads, velocities):
        if not (lie.who == 'drive' and velocity == 'along' or lie.step and start == 'begin'):
            yield Case(lie, start, rate, payload, velocity, *next(ways))


def goal_of(case: Case, place: np.ndarray) -> np.ndarray | None:
    """Give the goal after the lie has begun; none where it shows without [rad]."""
    if case.start == 'moving' or (case.near and case.lie.slow):
        return None
    if not case.near:
        return place + np.radians([60.0, -40.0])
    limits, joint = hard_limits(load_arm(PATH)), case.lie.joints[0]
    goal = place + case.side * np.radians(20.0)  # of the other joint
    goal[joint] = (place[joint] - case.side * np.radians(30.0) if case.start == 'away' else
                   (limits.upper if case.upper else limits.lower)[joint])
    return goal


def acceleration(arm: Arm, joint: int) -> float:
    """Give what all of its current makes of a motor alone [rad/s^2]."""
    motor = next(m for m in arm.spec.motors if m.joint == arm.active_joints[joint])
    assert motor.current_limit is not None
    return motor.current_limit * motor.joint_torque_constant / motor.reflected_inertia


@dataclass
class Outcome:
    """What came of a lie; angles in degrees, times from its beginning."""

    case: Case
    found: float = np.nan  # time of the detection [s]
    false: float = 0.0  # false motion until then, or until the end
    beyond: float = -np.inf  # farthest beyond a limit, by the motors
    hanging: float = -np.inf  # the same, by the links
    speed: float = 0.0  # greatest
    still: float = np.nan  # from the detection until it stands [s]
    cause: str = ''
    broken: list[str] = field(default_factory=list)


def run(case: Case) -> Outcome:
    """Let it lie, and judge what came of it."""
    place = place_of(case)
    arm = resting(tuple(place.tolist()))
    rig = Rig(arm, rate=case.rate, payload=case.payload, seed=3)
    liar, sign = Liar(rig), 1.0
    if case.near:
        sign = case.side * (1.0 if case.start == 'towards' else -1.0)
        sign *= 1.0 if case.lie.who == 'drive' else -1.0
    if case.start == 'begin':
        liar.begin(case.lie, case.velocity, sign)
        begin = 0
        rig.run(0.5)
    elif case.start == 'moving':
        rig.run(0.5)
        assert rig.source is not None and rig.source.go(np.radians([170.0, 60.0])) == ''
        rig.run(0.8)
        assert np.degrees(rig.trace.dq[-1][0]) > 55.0, 'it does not move as it should'
    else:
        rig.run(0.5)
    if case.start != 'begin':
        begin = len(rig.trace.t)
        liar.begin(case.lie, case.velocity, sign)
        rig.run(0.0 if case.start == 'moving' else 0.2)
    goal = goal_of(case, place)
    refused = ''
    if goal is not None and rig.controller is not None and rig.source is not None:
        refused = rig.source.go(goal)
    end, found = rig.t + case.lie.seconds, np.inf
    while rig.t < min(end, found + AFTER):
        rig.run(0.1)
        if rig.trace.state[-1] is State.FAULT:
            found = min(found, rig.t)
    return judged(case, rig, liar, begin, refused)


def judged(case: Case, rig: Rig, liar: Liar, begin: int, refused: str) -> Outcome:
    """Judge a run: a lie that began at a sample."""
    assert rig.controller is not None
    trace, limits, out = rig.trace, hard_limits(rig.arm), Outcome(case)
    false = false_motion(rig, np.array(liar.readings), begin).max(axis=1)
    faults = np.array([state is State.FAULT for state in trace.state])
    q, link = trace.array('q'), trace.array('true_q')
    speeds = np.abs(np.diff(q, axis=0)) * rig.rate
    first = int(np.argmax(faults)) if faults.any() else len(faults) - 1
    say = out.broken.append
    out.cause = rig.controller.cause
    allowed, beyond = limits.velocity * FASTER, BEYOND
    for angles, name, slack in ((q, 'beyond', 0.0), (link, 'hanging', YIELD)):
        depth = float(np.maximum(limits.lower - angles, angles - limits.upper).max())
        setattr(out, name, np.degrees(depth))
        if depth > beyond + slack:
            say(f'{np.degrees(depth):.1f} deg beyond a limit'
                + (' by the link' if slack else ''))
    out.speed = float(np.degrees(speeds.max()))
    if np.any(speeds > allowed):
        k, j = np.unravel_index(np.argmax(speeds / allowed), speeds.shape)
        say(f'{np.degrees(speeds[k, j]):.0f} deg/s of {np.degrees(allowed[j]):.0f}')
    out.false = float(np.degrees(false[first]))
    late = false[max(first - SAMPLES, 0)] if faults.any() else false[first]
    if late > FALSE:
        say(f'{out.false:.1f} deg of false motion, '
            + ('found too late' if faults.any() else f'not found ({out.cause})'))
    if not faults.any():
        return out
    out.found = (first - begin) / rig.rate
    if out.found < 0.0:
        say(f'a fault {-out.found:.2f} s before there was a lie: {out.cause}')
    _judge_standstill(out, rig, first)
    _judge_text(out, rig, refused)
    return out


def _judge_standstill(out: Outcome, rig: Rig, first: int) -> None:
    q = rig.trace.array('q')[first:]
    least, most = (np.asarray(extreme.accumulate(q[::-1])[::-1])
                   for extreme in (np.minimum, np.maximum))  # from each sample to the end
    within = ((most - least) < STILL).all(axis=1)
    out.still = float(np.argmax(within) / rig.rate)
    if out.still > STANDSTILL:
        more = np.degrees(np.abs(q[-1] - q[-round(0.1 * rig.rate)])) / 0.1
        out.broken.append(f'stands {out.still:.2f} s after the detection' if more.max() < 1.0 else
                          f'moves on after the detection, at {more.max():.0f} deg/s')


def _judge_text(out: Outcome, rig: Rig, refused: str) -> None:
    lie, text = out.case.lie, out.cause
    names = [rig.arm.active_joints[j] for j in lie.joints]
    if not any(name in text for name in names):
        out.broken.append(f'the text does not name {" or ".join(names)}')
    for what, words in ((lie.who, CULPRITS[lie.who]), (lie.kind, KINDS[lie.kind])):
        if not re.search(words, text, re.IGNORECASE):
            out.broken.append(f'the text does not name the true cause ({what})')


SCALES = (0.99, 0.98, 0.97, 0.96, 0.95, 0.93, 0.9)
"""Of encoders that count a little less than they should."""
UNSEEN = np.radians(6.5)
"""How far beyond a limit such an encoder leads joint2, which goes 158 deg to it [rad]."""


def to_a_limit(
    scale: float, rate: float, payload: float, velocity: str = 'truth',
) -> tuple[float, str]:
    """Let joint2 cross its range by a wrong scale; give how far beyond [rad], what was said."""
    rig = Rig(resting(tuple(np.radians([20.0, 0.0]))), rate=rate, payload=payload, seed=3)
    rig.run(0.5)
    Liar(rig).begin(Lie(f'encoder counts {scale}', 'encoder', 'scaled', turn=diagonal(scale)),
                    velocity)
    limits = hard_limits(rig.arm)
    assert rig.source is not None and rig.controller is not None
    assert rig.source.go(np.array([limits.upper[0], 0.0])) == ''
    rig.run(5.0)
    return float((rig.trace.array('q') - limits.upper).max()), rig.controller.cause
