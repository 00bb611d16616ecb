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

"""Which clock is wrong, what is lost, by stamps and arrivals alone; which load is carried."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from tudor_dynamics.identification import causes
from tudor_dynamics.identification.causes import (
    _clock, _gap, _losses, _low, _together, _touch, _training, CAUSES, Scene)
from tudor_dynamics.load.live import LoadFound
from tudor_dynamics.online.black_box import Heard

PERIOD, COUNT, AT = 10_000_000, 1500, 900
"""Of the messages [ns], how many, and of which something is wrong."""


def scene(leap: int, back: int, lost: int, speed: float, epoch: int, burst: int) -> Scene:
    """Let strains leap by periods from a message to another, or be lost, before an event."""
    found = []
    for place, topic in enumerate(('/joint_states', '/link_strains')):
        for k in range(COUNT):
            strains = topic == '/link_strains'
            if strains and AT <= k < AT + lost:
                continue
            arrival = burst * (k // burst) + 0.01 * (k % burst) + 0.001 * place
            stamp = k + leap * (strains and AT <= k < back)
            found.append(Heard(epoch + round(arrival * PERIOD / speed), 10**18 + stamp * PERIOD,
                               topic, {}))
    found.sort(key=lambda message: message.time)
    certain = next(item for item in found if item.topic == '/joint_states'
                   and item.stamp == 10**18 + (AT + 10) * PERIOD)
    event = SimpleNamespace(onset=certain.stamp - 2 * PERIOD, stamp=certain.stamp)
    return Scene(SimpleNamespace(event=event, seconds=0.02), found, None, None, certain.time,
                 '', None, False, None)


@pytest.mark.parametrize('epoch', [10**18, 5 * 10**17, 0])
@pytest.mark.parametrize('speed', [1.0, 0.5, 20.0])
@pytest.mark.parametrize(('leap', 'back', 'lost', 'burst', 'clock', 'gap'), [
    (0, 0, 0, 1, '', ''), (0, 0, 0, 4, '', ''),
    (25, COUNT, 0, 1, 'stamps of /link_strains leap by +25.0 periods', '/link_strains'),
    (-25, COUNT, 0, 1, 'stamps of /link_strains leap by -25.0 periods', ''),
    (25, AT + 2, 0, 1, '', '/link_strains'),  # back before the event
    (0, 0, 3, 1, '', '3 samples of /link_strains are missing'),
    (0, 0, 4, 4, '', '4 samples of /link_strains are missing')])
def test_stamps_and_arrivals(
    leap: int, back: int, lost: int, speed: float, epoch: int, burst: int, clock: str, gap: str,
) -> None:
    """Played at another speed or with stamps of another epoch, the same is said."""
    shown = scene(leap, back, lost, speed, epoch, burst)
    assert clock in _clock(shown) and bool(clock) == bool(_clock(shown))
    assert gap in _gap(shown) and bool(gap) == bool(_gap(shown))


@pytest.mark.parametrize('speed', [1.0, 20.0])
def test_one_topic(speed: float) -> None:
    """Where nothing else says how time goes, a gap in a bag that is played is no clock."""
    shown = scene(0, 0, 4, speed, 10**18, 1)
    alone = [item for item in shown.messages if item.topic == '/link_strains']
    shown = replace(shown, messages=alone)
    assert not _clock(shown) and '4 samples' in _gap(shown)


def test_a_clock_that_is_hours_wrong() -> None:
    """A leap longer than all that is kept changes nothing of the usual steps."""
    shown = scene(10**6, COUNT, 0, 1.0, 10**18, 1)
    assert 'leap by +1000000.0 periods' in _clock(shown)
    assert np.isfinite([steps for _, *steps, _ in shown.steps(10.0)][0]).all()


def test_a_clock_that_leaps_after_the_event() -> None:
    """It is no cause of what came before."""
    shown = scene(0, 0, 0, 1.0, 10**18, 1)
    begin = 10**18 + (AT + 30) * PERIOD
    later = [replace(item, stamp=item.stamp + 25 * PERIOD)
             if item.topic == '/link_strains' and item.stamp >= begin else item
             for item in shown.messages]
    assert later != shown.messages
    assert not _clock(replace(shown, messages=later))


@pytest.mark.parametrize('speed', [0.95, 0.97, 0.99, 1.01, 1.05])
@pytest.mark.parametrize('lost', [3, 5, 8])
def test_a_gap_where_the_clock_is_a_little_slow(speed: float, lost: int) -> None:
    """Or fast, as where a driver stamps by the rate that it should have: no leap."""
    shown = scene(0, 0, lost, speed, 10**18, 1)
    assert not _clock(shown) and f'{lost} samples' in _gap(shown)


def test_losses_before_a_long_event() -> None:
    """They are its cause where it is no touch, and before motion is called strange."""
    shown = scene(0, 0, 3, 1.0, 10**18, 1)
    shown = replace(shown, seen=SimpleNamespace(event=shown.seen.event, seconds=1.0))
    assert not _gap(shown) and '3 samples' in _losses(shown)
    looks = [look for look, *_ in CAUSES]
    assert looks.index(_touch) < looks.index(_losses) < looks.index(_training)


def test_most_samples_lost_before_a_long_event() -> None:
    """Of fewer than half of the samples nothing can be said, not even that it is a touch."""
    whole = scene(0, 0, 0, 1.0, 10**18, 1)
    for part, gap in ((3, True), (4, False)):  # of so many samples two are lost
        kept = [item for k, item in enumerate(whole.messages) if item.topic == '/joint_states'
                or not 2 * (AT - 60) < k < 2 * (AT + 8) or k // 2 % part > 1]
        shown = replace(whole, messages=kept,
                        seen=SimpleNamespace(event=whole.seen.event, seconds=1.0))
        assert bool(_gap(shown)) == gap and 'samples of /link_strains' in _losses(shown)


def excursion(strain: dict[float, float], effort: dict[float, float]) -> Scene:
    """Give an event by strains at 0 s, with ratios from some times on, before it 0.1."""
    def series(ratios: dict[float, float]) -> list[SimpleNamespace]:
        levels, begun = [0.1, *ratios.values()], np.array([*ratios])
        return [SimpleNamespace(
            residual=SimpleNamespace(motion=SimpleNamespace(stamp=10**18 + 10**7 * k)),
            collision=np.array([levels[int(np.sum(begun < 0.01 * k + 1e-6))]]))
            for k in range(-1000, 50)]
    event = SimpleNamespace(onset=10**18, stamp=10**18 + 10**7, method='strain')
    seen = SimpleNamespace(event=event, seconds=0.01, ratio=1.05, contact=None)
    return Scene(seen, [], SimpleNamespace(
        log=SimpleNamespace(events=[seen]), contacts=[],
        excesses={'strain': series(strain), 'effort': series(effort)}),
        None, 0, '', None, False, None)


@pytest.mark.parametrize(('strain', 'effort', 'unlike', 'touched'), [
    # a push that grows for 0.25 s; the drives show it, most of it before it is certain
    ({-0.25: 0.99, 0.0: 1.05, 0.05: 0.1}, {-0.2: 0.9, -0.12: 0.3}, False, True),
    ({-0.25: 0.99, 0.0: 1.05, 0.05: 0.1}, {}, False, False),  # the drives show nothing
    ({-0.25: 0.99, 0.0: 1.05, 0.05: 0.1}, {-3.0: 0.9, -2.5: 0.1}, False, False),  # nor then
    ({-4.0: 0.9, -3.0: 0.1, 0.0: 1.05}, {}, True, False)])  # motion that is so always
def test_how_an_event_begins_is_no_free_motion(
    strain: dict[float, float], effort: dict[float, float], unlike: bool, touched: bool,
) -> None:
    """A weak push is called by what gauges and drives show of it, not by its own begin."""
    shown = excursion(strain, effort)
    assert (bool(_training(shown)), bool(_together(shown))) == (unlike, touched)
    assert not _touch(shown)
    looks = [look for look, *_ in CAUSES]
    assert looks.index(_training) < looks.index(_together) < looks.index(_low)


def stand_ins(
    monkeypatch: pytest.MonkeyPatch, loads: list[tuple[float, float, float]],
    knowing: list[float], known: float, *, ranged: bool,
) -> SimpleNamespace:
    """Let an event at 0 s come, and who knows what is carried see others and find loads."""
    def stamp(seconds: float) -> int:
        return 10**18 + round(1e9 * seconds)

    def event(onset: float) -> SimpleNamespace:
        own = SimpleNamespace(onset=stamp(onset), stamp=stamp(onset + 0.02), method='strain')
        return SimpleNamespace(event=own, seconds=1.0)

    estimated = [mass for at, mass, _ in loads if at < 0.0]

    def replay(how: str) -> SimpleNamespace:
        events = knowing if how == 'estimate' else [0.0]
        knew = {'parameter': None, 'topic': known, 'estimate': [known, *estimated][-1]}[how]
        return SimpleNamespace(log=SimpleNamespace(events=[event(at) for at in events]),
                               certain=[(0, '', knew)] * len(events),
                               loads=[LoadFound(stamp(at), *rest) for at, *rest in loads])
    for name, stand_in in {
            'messages_of': lambda *_: [], 'carried_load': lambda how, *_: how,
            'Monitor': lambda *_, payload: SimpleNamespace(
                payload=payload, memories={}, watch=SimpleNamespace(
                    stages={'strain': None}, bundle=None)),
            'replay': lambda _, own: replay(own.payload),
            'CAUSES': [row for row in CAUSES if row[1] == 'load']}.items():
        monkeypatch.setattr(causes, name, stand_in)
    whole = SimpleNamespace(arm=None, at=lambda _: None,
                            mass_at=lambda payload: payload if ranged else known)
    whole.beside_robot = lambda: whole
    return whole


@pytest.mark.parametrize(('ranged', 'source'), [  # a model of several loads, or of one
    (True, 'parameter'), (False, 'parameter'), (True, 'topic')])
@pytest.mark.parametrize(('loads', 'knowing', 'known', 'text'), [
    ([(-5.0, 0.3, 0.3), (2.6, 0.0, -0.3)], [], 0.0, 'found -5.00 s'),  # and is put down after it
    ([(0.6, 0.2, 0.2)], [], 0.0, '0.200 kg at the tip (+0.200 kg), found +0.60 s'),
    ([(3.0, 0.0, 0.014)], [0.0], 0.0, ''),  # again what the monitor knew: it was a blow
    ([(0.6, 0.3, 0.3), (1.2, 0.0, -0.3)], [0.0], 0.0, ''),  # a push that looked like a load
    ([(0.6, 0.0, -0.2)], [], 0.2, '0.000 kg at the tip (-0.200 kg)'),  # dropped
    ([(-5.0, 0.2, 0.2)], [], 0.0, 'found -5.00 s'),  # hangs there since, which nobody said
    ([(-5.0, 0.2, 0.2)], [0.3], 0.0, ''),  # who knows of it sees an event, too
    ([(-5.0, 0.2, 0.2)], [9.0], 0.0, 'found -5.00 s'),  # another one
    ([(-5.0, 0.2, 0.2)], [], 0.2, '')])  # it was said
def test_loads(
    loads: list[tuple[float, float, float]], knowing: list[float], known: float, text: str,
    ranged: bool, source: str, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A load that the monitor does not know of explains an event that who knows it has not."""
    whole = stand_ins(monkeypatch, loads, knowing, known, ranged=ranged)
    found, = causes.explain(None, whole, SimpleNamespace(kind=''), source,
                            known if ranged and source == 'parameter' else 0.0, [])
    assert text in found.evidence and bool(text) == bool(found.evidence)


@pytest.mark.parametrize(('loads', 'text'), [
    ([(0.6, 0.3, 0.3)], 'found +0.60 s'), ([(0.6, 0.3, 0.3), (1.2, 0.0, -0.3)], ''),
    ([(-5.0, 0.3, 0.3), (0.6, 0.0, -0.3)], 'found +0.60 s'), ([(-5.0, 0.3, 0.3)], '')])
def test_loads_of_a_monitor_that_estimates_them(
    loads: list[tuple[float, float, float]], text: str, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Only what changes after the onset, and stays, explains an event."""
    whole = stand_ins(monkeypatch, loads, [0.0], 0.0, ranged=True)
    found, = causes.explain(None, whole, SimpleNamespace(kind=''), 'estimate', 0.0, [])
    assert text in found.evidence and bool(text) == bool(found.evidence)
