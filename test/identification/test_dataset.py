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

"""Bag arguments, parts of bags, and blocks of several bags."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from sample_arms import multisine, recording_of

from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.errors import UsageError
from tudor_dynamics.identification.dataset import (
    BagChoice, BagData, common_outputs, cut, filtered, motion_span, parse_choice, standstill_note,
    training_blocks)
from tudor_dynamics.signals.preprocessing import prepare


@pytest.mark.parametrize(('text', 'expected'), [
    ('run', BagChoice('run')), ('a@b/run', BagChoice('a@b/run')),
    ('run@0-60%', BagChoice('run', 0.0, 0.6)), ('r@1@2.5-100%', BagChoice('r@1', 0.025, 1.0)),
    ('run@0-60', BagChoice('run@0-60')), ('run@5s-50s', BagChoice('run', 5.0, 50.0, True)),
    ('run@5-50s', BagChoice('run@5-50s'))])
def test_choices(text: str, expected: BagChoice) -> None:
    """A path, or a path and a part of it."""
    assert parse_choice(text) == expected


@pytest.mark.parametrize(('text', 'remedy'), [
    ('run@60-60%', 'run@0-60%'), ('run@60-40%', 'run@0-60%'), ('run@0-101%', 'run@0-60%'),
    ('run@9s-5s', 'run@5s-50s')])
def test_impossible_parts(text: str, remedy: str) -> None:
    """A part that is empty or outside is refused with the argument, and with what to give."""
    with pytest.raises(UsageError, match=f'{text}: the part .*such as {remedy}'):
        parse_choice(text)


@settings(deadline=None)
@given(st.text(min_size=1, max_size=30), st.integers(0, 99), st.integers(1, 100))
def test_written_and_read(path: str, begin: int, width: int) -> None:
    """What a choice is written as is read as the same choice, whatever the path."""
    choice = BagChoice(path.replace('\n', ' '), begin / 100, min(begin + width, 100) / 100)
    if choice != parse_choice(str(choice)):
        assert (choice.begin, choice.end) == (0.0, 1.0)  # then the path itself names a part
        assert '@' in path


@pytest.mark.parametrize('bounds', [(0.0, 0.35, 1.0), (0.0, 0.2, 0.5, 0.83, 1.0)])
def test_parts_make_the_whole(bounds: tuple[float, ...]) -> None:
    """Parts side by side have each sample once, and no stretch goes across a gap."""
    q = np.arange(1000.0)[:, None]
    whole = recording_of(q, 100.0, effort=2 * q, gaps=(300, 700))
    parts = [cut(whole, BagChoice('bag', a, b)) for a, b in zip(bounds[:-1], bounds[1:])]
    assert np.array_equal(np.vstack([part.q for part in parts]), q)
    assert np.array_equal(np.concatenate([part.stamp for part in parts]), whole.stamp)
    for part in parts:
        assert part.effort is not None and np.array_equal(part.effort, 2 * part.q)
        assert part.strain is None and part.dq is None
        covered = np.concatenate([np.arange(len(part.q))[s] for s in part.segments])
        assert np.array_equal(covered, np.arange(len(part.q)))
        for s in part.segments:
            assert np.max(np.diff(part.t[s]), initial=0.0) < 0.011


def test_cut_by_time() -> None:
    """Fractions are of the duration, gaps included; the whole is given back as it is."""
    whole = recording_of(np.arange(200.0)[:, None], 100.0, gaps=(100,), gap=8.0)
    first = cut(whole, BagChoice('bag', 0.0, 0.5))
    assert len(first.q) == 100 and first.segments == (slice(0, 100),)
    assert cut(whole, BagChoice('bag')) is whole
    with pytest.raises(UsageError, match='bag: nothing was recorded from 0.99 to 9 s; give .* '
                                         'bag@0s-0.99s bag@9s-9.99s'):
        cut(whole, BagChoice('bag', 0.2, 0.8))


def test_cut_by_seconds() -> None:
    """Times count from the first sample; a part that ends after the recording is refused."""
    whole = recording_of(np.arange(1001.0)[:, None], 100.0)
    part = cut(whole, parse_choice('bag@2s-4.5s'))
    assert part.q[0, 0] == 200.0 and part.q[-1, 0] == 449.0
    assert str(parse_choice('bag@2s-4.5s')) == 'bag@2s-4.5s'
    with pytest.raises(UsageError, match='bag@2s-11s: the recording lasts 10 s'):
        cut(whole, parse_choice('bag@2s-11s'))


def test_times_and_fractions_overlap() -> None:
    """They are compared once the duration is known."""
    early, late = parse_choice('bag@0s-5s'), parse_choice('bag@60-100%')
    assert early.overlaps(parse_choice('bag@4s-6s'))
    assert not early.overlaps(parse_choice('bag@5s-6s'))
    assert replace(early, duration=8.0).overlaps(late)
    assert not replace(early, duration=10.0).overlaps(late)
    assert not late.overlaps(replace(early, duration=10.0))


def _bag(effort: bool, strain: bool) -> BagData:
    motion = multisine(np.arange(3000) * 0.01, 2)
    outputs = motion[:, :2] + 10.0
    recording = recording_of(motion[:, :2], 100.0, effort=outputs if effort else None,
                             strain=outputs if strain else None, gaps=(1000,))
    spec = PreprocessingSpec(rate=20.0)
    return BagData(BagChoice('bag'), recording, tuple(prepare(recording, spec)))


def test_outputs_in_common() -> None:
    """Only what all bags have can be fitted to all of them."""
    assert common_outputs([_bag(True, True), _bag(True, True)]) == ('effort', 'strain')
    assert common_outputs([_bag(True, True), _bag(False, True)]) == ('strain',)
    assert common_outputs([_bag(True, False), _bag(False, True)]) == ()
    assert common_outputs([]) == ()


def test_blocks_of_several_bags() -> None:
    """Every kept sample of every stretch of every bag comes once, and comes again when asked."""
    bags = [_bag(True, True), _bag(True, False)]
    model: Any = SimpleNamespace(inputs=lambda stretch: stretch.motion, payload_range=None)
    blocks = training_blocks(bags, 'effort', model)
    for _ in range(2):
        count = 0
        for block in blocks():
            assert block.decimation is not None
            assert np.allclose(block.decimation(block.motion)[:, :2] + 10.0, block.output)
            count += len(block.output)
        assert count == bags[0].samples + bags[1].samples


def test_what_was_before_may_begin_in_motion() -> None:
    """A part that follows a motion knows its past only where that began at standstill."""
    t = np.arange(900) * 0.01
    for moves, begin in ((True, 0.0), (False, 2.0)):
        q = np.repeat(np.sin(3.0 * np.maximum(t - begin, 0.0))[:, None], 2, axis=1)
        whole = recording_of(q, 100.0, strain=np.zeros_like(q))
        later = cut(whole, BagChoice('bag', 4.0, 9.0, seconds=True))
        (stretch,) = prepare(later, PreprocessingSpec())
        assert stretch.before is not None and stretch.past_unknown == moves


@pytest.mark.parametrize(('before', 'behind', 'note'), [
    (3.0, 4.0, 'standstill of 2.6 s at the start and 3.6 s at the end is left out'),
    (0.0, 4.0, 'standstill of 3.6 s at the end is left out'),
    (0.4, 0.4, '')])
def test_standstill_at_the_ends(before: float, behind: float, note: str) -> None:
    """Half a second of it stays, in the middle all; the recording itself is left as it is."""
    moving = 0.4 * (1.0 - np.cos(2.0 * np.pi * np.arange(1000) / 500.0))
    moving[400:600] = moving[400]
    q = np.concatenate([np.zeros(round(100 * before)), moving, np.zeros(round(100 * behind))])
    recording = recording_of(np.column_stack([q, 0.0 * q]), 100.0, effort=np.zeros((len(q), 2)))
    begin, end = motion_span(recording)
    assert standstill_note(recording) == note
    assert begin == pytest.approx(max(0.0, before - 0.5) if before > 1.0 else 0.0, abs=0.1)
    bag = filtered(BagData(BagChoice('bag'), recording, ()), PreprocessingSpec(rate=None))
    stretch, = bag.stretches
    kept = stretch.t[stretch.decimation.keep]
    assert kept[0] >= begin and kept[-1] <= end and len(stretch.t) == len(q)
    # filters settle for 0.5 s, or not at all where the arm stood and moves before that
    settled = 0.1 if before == 0.4 else 0.5
    assert bag.samples == pytest.approx(100 * (end - max(begin, settled)), abs=3)


def test_no_motion_at_all() -> None:
    """A bag in which nothing moves is not emptied."""
    recording = recording_of(np.zeros((500, 2)), 100.0, effort=np.zeros((500, 2)))
    assert motion_span(recording) == (0.0, pytest.approx(4.99))
    bag = filtered(BagData(BagChoice('bag'), recording, ()), PreprocessingSpec())
    assert bag.samples > 80
