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

"""Recordings made ready for models: which bags, which part of them, filtered how."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tudor_dynamics.arm import Arm, PreprocessingSpec
from tudor_dynamics.bags import read_recording, Recording
from tudor_dynamics.errors import FitError, UsageError
from tudor_dynamics.identification.bag_choice import BagChoice
from tudor_dynamics.identification.standstill import motion_span, standstill_note
from tudor_dynamics.models.training import Blocks, Inputs, TrainingBlock
from tudor_dynamics.signals import prepare, Stretch
from tudor_dynamics.signals.timing import retimed, Timing
from tudor_dynamics.typing import FloatArray

OUTPUTS = ('effort', 'strain')


@dataclass(frozen=True, eq=False)
class BagData:
    """One bag, ready for models."""

    choice: BagChoice  # bag and part
    recording: Recording  # signals as read (the part chosen)
    stretches: tuple[Stretch, ...]  # gapless stretches, filtered
    payload: float | None = None  # mass at the tip, where it is known [kg]
    # Why even stamps took the place of those recorded, where they did.
    timing: Timing | None = None

    def has(self, output: str) -> bool:
        """Say whether the bag has an output, ``effort`` or ``strain``."""
        return getattr(self.recording, output) is not None

    @property
    def samples(self) -> int:
        """Give the number of samples used, after decimation."""
        return sum(stretch.n_kept for stretch in self.stretches)


def cut(recording: Recording, choice: BagChoice) -> Recording:
    """Take a part of a recording by time."""
    if (choice.begin, choice.end, choice.seconds) == (0.0, 1.0, False):
        return recording
    t = recording.t
    begin, end = choice.span(float(t[-1]))
    if end > t[-1] + recording.dt:
        msg = (f'{choice}: the recording lasts {t[-1]:.4g} s; name a part that ends before')
        raise UsageError(msg)
    first, last = np.searchsorted(t, [begin, end])
    if end >= t[-1]:
        last = len(t)
    segments = []
    for part in recording.segments:
        start, stop = max(part.start, int(first)), min(part.stop, int(last))
        if stop > start:
            segments.append(slice(start - int(first), stop - int(first)))
    if not segments:
        msg = (f'{choice}: nothing was recorded in this part of {t[-1]:.3g} s; name a part that '
               'has samples')
        raise UsageError(msg)

    start = next((part.start for part in recording.segments
                  if part.start < int(first) < part.stop), int(first))
    earlier = ((recording.stamp[start:first], recording.q[start:first])
               if start < int(first) else None)
    if start == 0 and recording.earlier is not None:
        stamps, places = recording.earlier
        earlier = (np.concatenate([stamps, recording.stamp[:first]]),
                   np.vstack([places, recording.q[:first]]))

    def take(x: FloatArray | None) -> FloatArray | None:
        return None if x is None else x[first:last]

    return replace(
        recording, stamp=recording.stamp[first:last], q=recording.q[first:last],
        dq=take(recording.dq), effort=take(recording.effort), strain=take(recording.strain),
        segments=tuple(segments), earlier=earlier)


def load(
    choice: BagChoice, arm: Arm, preprocessing: PreprocessingSpec, *, learn: bool = False,
    payload: float | None = None, whole: bool = False,
) -> BagData:
    """
    Read and filter a bag; stamps that jitter on a clearly even sampling become even.

    payload [kg].
    """
    read = read_recording(choice.path, arm, need_output=True, need_motion=learn)
    full, timing = retimed(read)
    recording = cut(full, choice)
    choice = replace(choice, duration=float(full.t[-1]))
    if payload is None:
        payload = full.payload
    if whole:
        return BagData(choice, recording, tuple(prepare(recording, preprocessing)), payload,
                       timing)
    note = standstill_note(recording, motion_span(recording))
    if note:
        recording = replace(recording, warnings=(*recording.warnings, note))
    return filtered(BagData(choice, recording, (), payload, timing), preprocessing)


def filtered(bag: BagData, preprocessing: PreprocessingSpec) -> BagData:
    """Filter the recording of a bag, and leave out standstill at its ends."""
    begin, end = motion_span(bag.recording)
    stretches = []
    for stretch in prepare(bag.recording, preprocessing):
        t = stretch.t[stretch.decimation.keep]
        inside = stretch.decimation.keep[(t >= begin) & (t <= end)]
        if len(inside) >= 2:
            stretches.append(replace(stretch, decimation=replace(
                stretch.decimation, keep=inside)))
    return replace(bag, stretches=tuple(stretches or prepare(bag.recording, preprocessing)))


def split_bag(
    bag: BagData, held_out: float, preprocessing: PreprocessingSpec,
) -> tuple[BagData, BagData]:
    """Split a bag by time into a part to fit to and a last part to judge by."""
    middle = 1.0 - held_out
    return part(bag, 0.0, middle, preprocessing), part(bag, middle, 1.0, preprocessing)


def part(bag: BagData, begin: float, end: float, preprocessing: PreprocessingSpec) -> BagData:
    """Take a part of a bag by time, filtered on its own."""
    recording = cut(bag.recording, BagChoice(bag.choice.path, begin, end))
    width = bag.choice.end - bag.choice.begin
    named = replace(bag.choice, begin=bag.choice.begin + begin * width,
                    end=bag.choice.begin + end * width)
    return filtered(BagData(named, recording, (), bag.payload), preprocessing)


def training_blocks(
    data: Sequence[BagData], output: str, *, with_payload: bool = False,
    inputs: Inputs | None = None,
) -> Blocks:
    """Give the training data of one output from several bags; inputs: its motion by default."""
    def blocks() -> Iterator[TrainingBlock]:
        for bag in data:
            for stretch in bag.stretches:
                for block in stretch.blocks(None if inputs is None else inputs(stretch)):
                    motion = block.motion
                    if with_payload:
                        motion = np.column_stack([motion, np.full(len(motion), bag.payload)])
                    yield TrainingBlock(motion, getattr(block, output), block.decimation)
    return blocks


def all_stretches(data: Iterable[BagData]) -> Iterator[Stretch]:
    """Go through the stretches of several bags."""
    for bag in data:
        yield from bag.stretches


def refuse_copies(training: Sequence[BagData], test: Sequence[BagData]) -> None:
    """Refuse bags with the same samples: such a bag is no test of another."""
    for i, one in enumerate(training):
        for other in (*training[i + 1:], *test):
            same = one.recording.checksum == other.recording.checksum != ''
            if same and one.choice.overlaps(other.choice):
                msg = (f'{other.choice} has the very bytes of the training bag {one.choice} '
                       f'(sha256 {one.recording.checksum[:12]}): a copy is no test of what was '
                       'learned from it; give another recording')
                raise FitError(msg)


def common_outputs(data: Sequence[BagData]) -> tuple[str, ...]:
    """Say which outputs all the bags have."""
    return tuple(output for output in OUTPUTS if data and all(bag.has(output) for bag in data))
