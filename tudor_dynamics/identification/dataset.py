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
    """
    One bag, ready for models.

    Attributes
    ----------
    choice : BagChoice
        Bag and part.
    recording : Recording
        Signals as read (the part chosen).
    stretches : tuple of Stretch
        Gapless stretches, filtered.
    payload : float or None
        Mass at the tip, where it is known [kg].
    timing : Timing or None
        Why even stamps took the place of those recorded, where they did.

    """

    choice: BagChoice
    recording: Recording
    stretches: tuple[Stretch, ...]
    payload: float | None = None
    timing: Timing | None = None

    def has(self, output: str) -> bool:
        """Say whether the bag has an output, ``effort`` or ``strain``."""
        return getattr(self.recording, output) is not None

    @property
    def samples(self) -> int:
        """Give the number of samples used, after decimation."""
        return sum(stretch.n_kept for stretch in self.stretches)


def cut(recording: Recording, choice: BagChoice) -> Recording:
    """
    Take a part of a recording by time.

    Parameters
    ----------
    recording : Recording
        Recording of the whole bag.
    choice : BagChoice
        Part of it.

    Returns
    -------
    Recording
        The part, its segments counted anew.

    Raises
    ------
    UsageError
        If the part lies in a gap, or ends behind the recording.

    """
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

    Parameters
    ----------
    choice : BagChoice
        Bag and part.
    arm : Arm
        Arm that was recorded.
    preprocessing : PreprocessingSpec
        Filters and rate.
    learn : bool, default=False
        Refuse a bag in which no joint moves: nothing can be learned from it.
    payload : float, optional
        Mass at the tip, in place of what the bag's metadata say [kg].
    whole : bool, default=False
        Keep standstill at the ends, as the running robot does.

    Returns
    -------
    BagData
        Bag ready for models.

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
    """
    Filter the recording of a bag, and leave out standstill at its ends.

    Parameters
    ----------
    bag : BagData
        Bag that was read.
    preprocessing : PreprocessingSpec
        Filters and rate.

    Returns
    -------
    BagData
        The same bag with other stretches.

    """
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
    """
    Split a bag by time into a part to fit to and a last part to judge by.

    Parameters
    ----------
    bag : BagData
        Bag that was loaded.
    held_out : float
        Fraction of it at the end to judge by.
    preprocessing : PreprocessingSpec
        Filters and rate; each part is filtered on its own.

    Returns
    -------
    first, last : BagData
        Parts.

    """
    middle = 1.0 - held_out
    return part(bag, 0.0, middle, preprocessing), part(bag, middle, 1.0, preprocessing)


def part(bag: BagData, begin: float, end: float, preprocessing: PreprocessingSpec) -> BagData:
    """
    Take a part of a bag by time, filtered on its own.

    Parameters
    ----------
    bag : BagData
        Bag that was loaded, or a part of one.
    begin, end : float
        Part of it, as fractions of its duration.
    preprocessing : PreprocessingSpec
        Filters and rate.

    Returns
    -------
    BagData
        The part.

    """
    recording = cut(bag.recording, BagChoice(bag.choice.path, begin, end))
    width = bag.choice.end - bag.choice.begin
    named = replace(bag.choice, begin=bag.choice.begin + begin * width,
                    end=bag.choice.begin + end * width)
    return filtered(BagData(named, recording, (), bag.payload), preprocessing)


def training_blocks(
    data: Sequence[BagData], output: str, *, with_payload: bool = False,
    inputs: Inputs | None = None,
) -> Blocks:
    """
    Give the training data of one output from several bags.

    Parameters
    ----------
    data : sequence of BagData
        Bags that have the output.
    output : {'effort', 'strain'}
        Output to be learned.
    with_payload : bool, default=False
        Let the payload of each bag follow its motion.
    inputs : callable, optional
        What a model takes of a stretch, as ``MemorylessModel.inputs``; its motion by default.

    Returns
    -------
    callable
        Gives blocks anew at each call.

    """
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
    """
    Refuse bags with the same samples, under whatever names: such a bag is no test of another.

    Parameters
    ----------
    training, test : sequence of BagData
        Bags of a fit; their storage files are compared by checksum.

    Raises
    ------
    FitError
        If a bag is a copy of a training bag, byte by byte, and the parts chosen overlap.

    """
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
