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

"""What must hold in a soak: nothing lost, no growth, the envelope; checked on what was seen."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from envelope import Envelope
from live_nodes import Track
import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.bags.storage import read_track
from tudor_dynamics.errors import TudorError
from tudor_dynamics.nodes.common.messages import JointStateDecoder
from tudor_dynamics.typing import FloatArray

EDGE = 0.3
"""What was on its way when a node began, ended or was stopped [s]."""
CATCH_UP = 2.0
"""Time to work off what came during a stop [s]."""
GROWTH = 2.0
"""Memory that a node may grow by [MB]."""
MEETING = 5.0
"""A new publisher and who listens must have found each other by then [s]."""
TELLING = 1.5
"""A node has told what it does, and brought to disk what it records, so soon [s]."""
STARTED = 15.0
"""Behind so much life a node has surely started and minds SIGTERM [s]."""
PUBLISHERS = {'joint_states': 'arm_simulator', 'link_strains': 'arm_simulator',
              'joint_reference': 'reference_generator'}
"""Who publishes what is recorded with stamps."""
SPAN = 5
"""Samples over which the speed of the arm is taken."""
ROUNDING = 1e-3
"""Of encoders [rad], and of what is compared with a limit."""


@dataclass
class Life:
    """A process: when it lived, when it was stopped, what it weighed."""

    node: str
    # Start, and the signal that ended it or the death without one, on the steady clock [s].
    began: float
    ended: float | None = None
    pauses: list[tuple[float, float]] = field(default_factory=list)  # from SIGSTOP to SIGCONT [s]
    memory: list[tuple[float, float]] = field(default_factory=list)  # when [s] and how much [MB]
    code: int | None = None  # exit code
    by: str = ''  # signal that ended it
    asked: bool = False  # whether it was a signal that ended it
    bag: str = ''  # what it recorded

    def paused(self, now: float) -> bool:
        """Say whether it is stopped, or was a moment ago."""
        return any(begin <= now <= end + CATCH_UP for begin, end in self.pauses)

    def windows(self, first: float, edge: float = EDGE) -> Iterator[tuple[float, float]]:
        """Give the times in which it surely took what came, from its first output on."""
        begin = first + EDGE
        assert self.ended is not None
        for stop, go in self.pauses:
            yield begin, stop - edge
            begin = go + CATCH_UP
        yield begin, self.ended - edge


@dataclass(frozen=True, eq=False)
class Observed:
    """All that was seen."""

    arm: Arm  # limits
    period: float  # of the samples [s]
    settle: float  # time for which the monitor's filters settle [s]
    tracks: dict[str, Track]  # topics
    lives: list[Life]  # of all processes
    told: list[tuple[float, Any]]  # time [s] and status of the monitor's diagnostics
    warm: float  # after this time of life memory must not grow [s]


@dataclass(frozen=True)
class Line:
    """A line of the table."""

    check: str
    found: str
    allowed: str
    held: bool

    def text(self) -> str:
        """Give the line in 80 columns."""
        return (f'{self.check:34s} {self.found:>22s} {self.allowed:>16s} '
                f'{"PASS" if self.held else "FAIL"}')


def inside(arrival: NDArray[np.float64], windows: list[tuple[float, float]]) -> NDArray[np.bool_]:
    """Say which arrivals lie in any of the windows."""
    found = np.zeros(len(arrival), dtype=bool)
    for begin, end in windows:
        found |= (arrival > begin) & (arrival < end)
    return found


def lived(
    observed: Observed, node: str, topic: str, edge: float = EDGE,
) -> list[tuple[float, float]]:
    """Give the windows in which a node surely took what came: from its first output on."""
    arrival, windows = observed.tracks[topic].arrival, []
    for life in observed.lives:
        assert life.ended is not None
        own = arrival[(arrival > life.began) & (arrival < life.ended)]
        if life.node == node and own.size:
            windows += list(life.windows(own[0], edge))
    return [(begin, end) for begin, end in windows if end > begin]


def met_late(
    observed: Observed, publisher: str, track: Track, taken: NDArray[np.bool_],
) -> NDArray[np.bool_]:
    """Say what was sent before a new publisher and who listens had met: it never came in."""
    late = np.zeros(len(track), dtype=bool)
    for life in observed.lives:
        if life.node == publisher:
            assert life.ended is not None
            of_it = inside(track.arrival, [(life.began, life.ended + EDGE)])
            first = track.arrival[of_it & taken]
            began = track.arrival[of_it]
            if began.size:
                met = min(first[0] if first.size else np.inf, began[0] + MEETING)
                late |= of_it & (track.arrival < met)
    return late


def monitored(observed: Observed) -> list[Line]:
    """Compare what was published with what the monitor received, judged, and told it did not."""
    joints, motion = observed.tracks['joint_states'], observed.tracks['joint_motion']
    windows = lived(observed, 'monitor', 'joint_motion')
    lives, taken = inside(joints.arrival, windows), np.isin(joints.stamp, motion.stamp)
    late = met_late(observed, 'arm_simulator', joints, taken | ~lives) & lives
    sent = lives & ~late
    missing = int((sent & ~taken).sum())
    within = inside(motion.arrival, lived(observed, 'monitor', 'joint_motion', TELLING))
    unjudged = within & ~np.isin(motion.stamp, observed.tracks['strain_residuals'].stamp)
    told = told_of(observed, motion.stamp)
    secret = unjudged & ~told
    # the strain of a motion may be lost with the simulator that was killed between the two
    settling = motion.elapsed * 1e-9 < observed.settle + 2 * observed.period
    return [Line('monitor: samples not received', f'{missing} of {int(sent.sum())}', '0',
                 not missing and bool(sent.any())),
            Line('monitor: not judged, not told', f'{int(secret.sum())} of {int(within.sum())}',
                 '0', not secret.any()),
            Line('  settling, not judged for else',
                 f'{int((unjudged & settling).sum())}, {int((unjudged & ~settling).sum())}', '-',
                 True),
            Line('  sent before the two had met', str(int(late.sum())), '-', True)]


def told_of(observed: Observed, stamps: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Say of which samples [ns] a diagnosis within 2.5 s said that samples were not judged."""
    found = np.zeros(len(stamps), dtype=bool)
    dropped = 0
    for at, status in observed.told:
        values = {item.key: item.value for item in status.values}
        now = int(values.get('dropped', 0))
        share = values.get('not judged [%]', '0').split()[0]
        if status.level[0] or now != dropped or float(share) > 0.0:
            late = at - stamps * 1e-9
            found |= (late > 0.0) & (late < 2.5)
        dropped = now
    return found


def stamps_in(path: Path, topic: str) -> NDArray[np.int64]:
    """Read the stamps of a recorded topic [ns]."""
    decoder = JointStateDecoder(Counter())
    samples = [decoder.decode(data) for data in read_track(path, [topic]).data]
    return np.array([sample.stamp for sample in samples if sample is not None], dtype=np.int64)


def recorded(observed: Observed) -> list[Line]:
    """Compare what was published with the bags, those of killed recorders up to the last save."""
    lost = sent = early = unreadable = 0
    begins: list[str] = []
    lives = [life for life in observed.lives if life.node == 'bag_recorder']
    for life in lives:
        bag, killed = found_bag(Path(life.bag)), life.by == 'SIGKILL'
        assert life.ended is not None
        for topic, publisher in PUBLISHERS.items():
            track = observed.tracks[topic]
            during = inside(track.arrival, [(life.began + STARTED, life.ended)])
            try:
                kept = stamps_in(bag, topic)
            except TudorError:
                unreadable += topic == 'joint_states' and bool(during.any())
                continue
            taken = np.isin(track.stamp, kept)
            first = track.arrival[taken]
            windows = life.windows(first[0], TELLING if killed else EDGE) if first.size else ()
            within = inside(track.arrival, list(windows))
            late = met_late(observed, publisher, track, taken | ~within) & within
            early += int(late.sum())
            sent += int((within & ~late).sum())
            missing = within & ~late & ~taken
            lost += int(missing.sum())
            if missing.any():
                at = track.arrival[missing]
                begins.append(f'{topic} {len(at)} in the life from {life.began:.0f} to '
                              f'{life.ended:.0f} ({life.by}), {at[0]:.1f} to {at[-1]:.1f} s')
    return [Line('recorder: messages not in the bag', f'{lost} of {sent}', '0',
                 not lost and sent > 0),
            *(Line(f'  {text}', '', '-', True) for text in begins),
            Line('recorder: bags that cannot be read', f'{unreadable} of {len(lives)}', '0',
                 not unreadable),
            Line('  sent before the two had met', str(early), '-', True)]


def found_bag(bag: Path) -> Path:
    """Give a bag, or what a recorder that was killed has left of it."""
    left = sorted(bag.parent.glob(f'.{bag.name}.*/{bag.name}'))
    return bag if bag.exists() or not left else left[0]


def grown(observed: Observed) -> list[Line]:
    """Judge the memory of each node that lived long enough."""
    found: dict[str, list[float]] = {}
    for life in observed.lives:
        late = [memory for at, memory in life.memory if at > life.began + observed.warm]
        assert life.ended is not None
        if late and life.ended - life.began > 2.0 * observed.warm:
            found.setdefault(life.node, []).append(max(late) - late[0])
    lines = []
    for node in dict.fromkeys(life.node for life in observed.lives):
        growth = max(found.get(node, []), default=None)
        text = 'no long life' if growth is None else f'{growth:.2f} MB'
        lines.append(Line(f'memory: {node}', text, f'< {GROWTH:g} MB',
                          growth is not None and growth < GROWTH))
    return lines


def ended(observed: Observed) -> Line:
    """Judge exit codes: 0 for SIGTERM, and no death without a signal."""
    bad = [life for life in observed.lives if not life.asked or (
        life.by == 'SIGTERM' and life.code != 0 and life.ended is not None
        and life.ended - life.began > STARTED)]
    return Line('ends: by themselves, or not with 0', f'{len(bad)} of {len(observed.lives)}', '0',
                not bad)


def speeds_at(joints: Track, arrival: FloatArray, period: float) -> FloatArray:
    """Give how fast the joints were at times of arrival, over samples without a gap [rad/s]."""
    last = len(joints.arrival) - 1
    end = np.clip(np.searchsorted(joints.arrival, arrival), SPAN, last)
    begin = end - SPAN
    broken = (joints.stamp[end] - joints.stamp[begin]) * 1e-9 > 2.0 * SPAN * period
    begin, end = (np.where(broken, end, begin),
                  np.where(broken, np.minimum(end + SPAN, last), end))
    time = (joints.stamp[end] - joints.stamp[begin]) * 1e-9
    way = joints.values[end] - joints.values[begin]
    return np.asarray(way / np.maximum(time, period)[:, np.newaxis])


def enveloped(observed: Observed) -> list[Line]:
    """Hold positions and commands against the limits."""
    envelope = Envelope.of(observed.arm)
    joints, commands = observed.tracks['joint_states'], observed.tracks['velocity_commands']
    q, command = joints.values, commands.values
    finite = np.isfinite(command).all(axis=1)
    outside = float(np.degrees(envelope.excursion(q)))
    speed = envelope.speed(command[finite])
    arrival = commands.arrival[finite]
    size, allowed = envelope.steps(command[finite], arrival, observed.period,
                                   speeds_at(joints, arrival, observed.period))
    silent = np.diff(arrival) > envelope.stop.timeout
    step, again = (float(np.max((size / allowed)[chosen], initial=0.0))
                   for chosen in (~silent, silent))
    at = float(arrival[1:][np.argmax((size / allowed).max(axis=1) * silent)] - arrival[0])
    return [Line('positions outside their limits', f'{outside:.2f} deg of {len(q)}', '0 deg',
                 np.radians(outside) <= ROUNDING and len(q) > 0),
            Line('commands that are no numbers', f'{int((~finite).sum())} of {len(command)}', '0',
                 bool(finite.all()) and len(command) > 0),
            Line('largest command, of its limit', f'{speed:.3f}', '1', speed <= 1.0 + ROUNDING),
            Line('largest step of it, of its limit', f'{step:.3f}', '1', step <= 1.0 + ROUNDING),
            Line('  when the driver had timed out', f'{again:.3f} at {at:.0f} s', '1',
                 again <= 1.0 + ROUNDING)]


def verdict(observed: Observed) -> list[Line]:
    """Give all lines."""
    return [*monitored(observed), *recorded(observed), *grown(observed), ended(observed),
            *enveloped(observed)]
