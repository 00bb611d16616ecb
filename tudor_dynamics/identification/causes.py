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

"""Why a monitor alarmed: the causes of an event, each with its evidence."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
import json
from typing import Any

import numpy as np

from tudor_dynamics.bags.storage import Bag
from tudor_dynamics.errors import ModelError
from tudor_dynamics.identification.detection import DetectedEvent, EventLog, FREE
from tudor_dynamics.identification.settings import (
    BEGINS, BRIEF, CLOCK_STEP, FASTER, FELT, JUST_ABOVE, JUST_AFTER, JUST_BEFORE, LATE_LOAD, LEAP,
    LEAP_SAMPLES, LEAST_TOUCH, LONG_BEFORE, LOST_BEFORE, OFFSET_LARGEST, OFFSET_SHARE, OFFSET_SPAN,
    OFFSET_STEP, OFFSET_SUM, PLAYED, QUIET_CHANNEL, SAME_ONSET, SHARED_TOUCH, STARTED,
    STOOD_BEFORE, SURE, UNLIKE, USUAL)
from tudor_dynamics.load.live import carried_load, LoadFound
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.online.black_box import (
    ASKED, Heard, messages_of, replayed, STATES, undamaged)
from tudor_dynamics.online.contact import contact_text, ContactEstimate
from tudor_dynamics.online.detector import Excess, ExcessStage
from tudor_dynamics.online.monitor import Monitor, MonitorSettings, SOURCE
from tudor_dynamics.online.settings import LOST_STEP, STANDING
from tudor_dynamics.online.threshold_learning import stored_thresholds
from tudor_dynamics.typing import FloatArray


@dataclass(eq=False)
class Replay:
    """What a monitor made of messages."""

    log: EventLog
    excesses: dict[str, list[Excess]] = field(default_factory=dict)  # by method
    loads: list[LoadFound] = field(default_factory=list)
    contacts: list[ContactEstimate] = field(default_factory=list)
    # when each event was certain: arrival [ns], what of the motion is strange, load known [kg]
    certain: list[tuple[int, str, float | None]] = field(default_factory=list)


def replay(messages: list[Heard], monitor: Monitor) -> Replay:
    """Let a monitor take messages, and keep what it found."""
    begin = next((message.stamp for message in messages if message.topic != ASKED), 0)
    seen, watch = Replay(EventLog(begin, FREE)), monitor.watch
    for message, found in replayed(messages, watch.bundle.arm, monitor):
        for method, excess in found.excesses:
            seen.excesses.setdefault(method, []).append(excess)
        seen.loads += found.loads
        seen.contacts += found.contacts
        known = watch.payload.mass if watch.payload else None
        seen.certain += [(message.time, watch.outside_training, known)] * len(found.events)
        seen.log.add(found, watch)
    return seen


# -- Causes, each with the evidence that the messages around an event show, or an empty text

@dataclass(frozen=True, eq=False)
class Scene:
    """An event with all that is known of the time around it."""

    seen: DetectedEvent
    messages: list[Heard]
    replay: Replay
    load: LoadFound | None  # what turned out to be carried
    arrived: int  # when the message came that made the event certain [ns]
    unlike: str  # why the motion is unlike that of the training; empty where it is not
    stage: ExcessStage  # thresholds of the method, and how many false alarms they allow
    follows: bool  # whether the model follows the readings of gauges, also wrong ones
    bundle: ModelBundle  # that was watched

    def excesses(self, begin: float, end: float, method: str = '') -> list[Excess]:
        """Give the samples of a method between two times since the onset [s]."""
        onset = self.seen.event.onset
        return [excess for excess in self.replay.excesses.get(method or self.seen.event.method, ())
                if begin <= (excess.residual.motion.stamp - onset) * 1e-9 <= end]

    def largest(self, end: float, method: str, before: float = JUST_BEFORE) -> float:
        """Give the largest ratio to the thresholds of a method since before the onset [s]."""
        return max((float(excess.collision.max())
                    for excess in self.excesses(-before, end, method)), default=0.0)

    def readings(self, output: str, channel: str, begin: float, end: float) -> FloatArray:
        """Give the readings of a channel between two times since the onset [s]."""
        topics, onset = self.bundle.arm.topics[output], self.seen.event.onset
        topic = next(topic for topic, names in topics.items() if channel in names)
        place = topics[topic].index(channel)
        return np.array([message.fields[output][place] for message in self.messages
                         if message.topic == topic and output in message.fields
                         and begin <= (message.stamp - onset) * 1e-9 <= end])

    def steps(
        self, before: float, after: float = 0.0,
    ) -> Iterator[tuple[str, FloatArray, FloatArray, int]]:
        """Give steps of stamps and arrivals near it [s], in usual ones; how many precede it."""
        event = self.seen.event
        since = before * 1e9 + event.stamp - event.onset
        for topic in dict.fromkeys(message.topic for message in self.messages):
            own = np.array([(item.stamp, item.time) for item in self.messages
                            if item.topic == topic])
            if len(own) > 2:
                # the epoch of stamps may be another, and the pace where a bag is played
                part = (len(own) + 3) // 4
                spans, ago = own[part:] - own[:-part], self.arrived - own[1:, 1]
                pace = np.median(spans[:, 1] / np.maximum(spans[:, 0], 1))
                near = (ago >= -1e9 * after * pace) & (ago <= since * pace)
                others = np.array([(item.stamp, item.time) for item in self.messages
                                   if item.topic != topic])
                if abs(pace - 1.0) > PLAYED:  # the newest stamp of the others is the clock
                    own[:, 1] = own[:, 0] if not len(others) else others[
                        np.maximum(np.searchsorted(others[:, 1], own[:, 1]) - 1, 0), 0]
                    pace = 1.0
                steps = np.diff(own, axis=0) / np.median(np.diff(own[:, 0])) / [1.0, pace]
                yield topic, *steps[near].T, int(np.sum(ago[near] >= 0))


def _clock(scene: Scene) -> str:
    for topic, stamp, arrival, before in scene.steps(LONG_BEFORE, after=JUST_AFTER):
        ahead = np.cumsum(stamp - arrival)
        for at in range(LEAP_SAMPLES, min(before, len(stamp) - LEAP_SAMPLES)):
            leap = stamp[at] - 1.0  # and stays: by medians, as messages may come in bunches
            if abs(leap) > CLOCK_STEP and abs(
                    np.median(ahead[at:]) - np.median(ahead[:at]) - leap) < 0.5 * abs(leap):
                return (f'stamps of {topic} leap by {leap:+.1f} periods while its messages come '
                        'as always')
    return ''


def _gap(scene: Scene) -> str:
    return _losses(scene, 0.5 if scene.seen.seconds > BRIEF else 0.0)  # half: nothing is sure


def _losses(scene: Scene, share: float = 0.0) -> str:
    for topic, stamp, *_ in scene.steps(LOST_BEFORE):
        lost = int(np.sum(np.round(stamp[stamp > LOST_STEP]) - 1))
        if lost > share * (lost + len(stamp)):
            return f'{lost} samples of {topic} are missing within {LOST_BEFORE:g} s before it'
    return ''


def _gauge(scene: Scene) -> str:
    """One channel leaps from a sample to the next, or stands, and no other shows anything."""
    event, output = scene.seen.event, SOURCE[scene.seen.event.method]
    for name in event.ratios:
        now, ever = (scene.readings(output, name, *at) for at in ((0.0, BRIEF), (-np.inf, 0.0)))
        if len(now) > 2 and not np.ptp(now) and np.ptp(ever):
            return f'{name} stands at {now[0]:.4g} to the last digit'
    if event.method == 'momentum':
        return ''
    place = list(event.ratios).index(event.channel)  # of its begin: others may be larger later
    rest = max((float(np.max(np.delete(np.abs(item.residual.value / item.threshold), place),
                             initial=0.0)) for item in scene.excesses(
                                 -JUST_BEFORE, 0.0 if scene.follows else BRIEF)), default=0.0)
    value = scene.readings(output, event.channel, -JUST_BEFORE, BRIEF)
    whole, leap = float(np.ptp(value)), float(np.abs(np.diff(value)).max(initial=0.0))
    if rest > QUIET_CHANNEL or not leap > LEAP * whole:
        return ''
    return (f'{event.channel} leaps by {leap:.3g} from one sample to the next, {leap / whole:.0%} '
            f'of all it does; no other channel is above {rest:.2f} of its threshold')


def _encoder(scene: Scene) -> str:
    """Find a joint whose encoder has an offset, which the weight of the links reveals."""
    joints = scene.bundle.arm.active_joints
    grams = [np.zeros((1 + len(joints), 1 + len(joints)))]
    for output, models in scene.bundle.models.items():
        items = scene.excesses(-OFFSET_SPAN, -OFFSET_SUM, output)  # before what has just begun
        if items and 'analytical' in models:
            predict = models['analytical'].predict
            stamp, motion, value, threshold = (np.array(part) for part in zip(*(
                (item.residual.motion.stamp, item.residual.motion.row, item.residual.value,
                 item.threshold) for item in items), strict=True))
            slopes = [(predict(motion + off) - predict(motion - off)) / (2.0 * OFFSET_STEP)
                      for off in OFFSET_STEP * np.eye(len(joints), motion.shape[1])]
            # in sums over so long ringing cancels, weight does not
            begins = np.flatnonzero(np.diff(stamp // round(OFFSET_SUM * 1e9), prepend=0))
            parts = np.dstack([value, *slopes]) / threshold[..., np.newaxis]
            rows = np.add.reduceat(parts, begins).reshape(-1, 1 + len(joints))
            grams.append(rows.T @ rows)
    products, squares = np.array(grams)[:, 0], np.diagonal(grams, axis1=1, axis2=2)[:, 1:]
    offset = products[:, 1:].sum(axis=0) / np.maximum(squares.sum(axis=0), 1e-30)
    explained = offset * (2.0 * products[:, 1:] - offset * squares)  # of each output, and joint
    share = np.where((np.abs(offset) < OFFSET_LARGEST) & (explained >= 0.0).all(axis=0),
                     explained.sum(axis=0) / max(products[:, 0].sum(), 1e-30), 0.0)
    best = int(share.argmax())
    name, wrong = joints[best], offset[best]
    return '' if share[best] < OFFSET_SHARE else (
        f'{name} reads {abs(wrong):.2g} {scene.bundle.arm.position_units[name]} too '
        f'{"little" if wrong > 0.0 else "much"}: that explains {share[best]:.0%} of what gauges '
        'and drives show')


def _load(scene: Scene) -> str:
    return '' if scene.load is None else (
        f'a load of {scene.load.mass:.3f} kg at the tip ({scene.load.change:+.3f} kg), found '
        f'{(scene.load.stamp - scene.seen.event.onset) * 1e-9:+.2f} s from the onset, explains it')


def _friction(scene: Scene) -> str:
    """Find a joint that has just begun to move, where what bends the links shows nothing."""
    event, joint = scene.seen.event, scene.seen.channel
    if event.method == 'strain':
        return ''
    strain = scene.largest(scene.seen.seconds, 'strain')
    place = len(event.ratios) + list(event.ratios).index(joint)
    before = scene.excesses(-STARTED - STOOD_BEFORE, 0.0)
    speed = np.abs([excess.residual.motion.row[place] for excess in before])
    stood = float(np.mean(speed < STANDING)) * (STARTED + STOOD_BEFORE) if len(speed) else 0.0
    if strain > QUIET_CHANNEL or stood < STOOD_BEFORE:
        return ''
    return (f'{joint} stood for {stood:.2f} of the last {STARTED + STOOD_BEFORE:g} s before it, '
            'and the efforts of a joint that begins to move are its friction')


def _faster(scene: Scene) -> str:
    reach = scene.stage.thresholds.reach
    rows = [item.residual.motion.row for item in scene.excesses(-LOST_BEFORE, 0.0)]
    times = np.max(np.abs(np.reshape(rows, (-1, 3, len(reach)))[:, 1]) / reach, initial=0.0)
    return '' if times < FASTER else f'it moved {times:.2f} times as fast as in the training'


def _training(scene: Scene) -> str:
    # how events begin, this one too, and what follows them say nothing of free motion
    onsets = [item.event.onset for item in scene.replay.log.events]
    often = max((float(excess.collision.max()) for excess in scene.excesses(-LONG_BEFORE, 0.0)
                 if not any(-BEGINS < (excess.residual.motion.stamp - onset) * 1e-9 < 3.0
                            for onset in onsets)), default=0.0)
    if not scene.unlike and often < UNLIKE:
        return ''
    return '; '.join(filter(None, (scene.unlike, f'up to {often:.2f} of a threshold was reached '
                                   f'in the {LONG_BEFORE:g} s before it')))


def _touch(scene: Scene) -> str:
    """Find a contact most of the time, or a sure force, that lasts or that drives show, too."""
    found, event = scene.seen.contact, scene.seen.event
    until = max(scene.seen.seconds, BRIEF)
    during = [item.felt for item in scene.replay.contacts
              if 0.0 <= (item.stamp - event.onset) * 1e-9 <= until]
    sure = bool(found and found['force'] and found['force'] > SURE * found['force_deviation'])
    if not during or np.mean(during) < FELT and not sure:
        return ''
    if found and found['seconds'] >= LEAST_TOUCH:
        return f'{contact_text(found)}, for {found["seconds"]:.2f} s'
    return _together(scene, JUST_BEFORE)


def _together(scene: Scene, before: float = BEGINS) -> str:
    """Find what both gauges and drives show in a moment: by chance that is far rarer than each."""
    until = max(scene.seen.seconds, BRIEF)
    most = {method: scene.largest(until, method, before) for method in scene.replay.excesses}
    other = max((ratio for method, ratio in most.items()
                 if SOURCE[method] != SOURCE[scene.seen.event.method]), default=0.0)
    return '' if other < SHARED_TOUCH else 'gauges and drives show it together: ' + ', '.join(
        f'{method} {ratio:.2f} of its threshold' for method, ratio in most.items())


def _often(scene: Scene) -> float:
    """Say how often free motion of the training reaches such a ratio [1/h]."""
    allowed, thresholds = scene.stage.rates.collision, scene.stage.thresholds
    parts = np.geomspace(1.0, 1e-4, 81)
    ratios = [float(np.median(thresholds.ratios(allowed * part) / thresholds.ratios(allowed)))
              for part in parts]
    return float(np.interp(scene.seen.ratio, ratios, allowed * parts))


def _usual(scene: Scene) -> str:
    often = _often(scene)
    return '' if often < USUAL else (
        f'{scene.seen.ratio:.2f} of a threshold that allows {scene.stage.rates.collision:.0f} '
        f'false alarms an hour; motion without contact reaches as much {often:.0f} times an hour')


def _low(scene: Scene) -> str:
    """Find a threshold that was hardly exceeded, and not for long."""
    return '' if scene.seen.ratio > JUST_ABOVE or scene.seen.seconds > BRIEF else (
        f'{scene.seen.ratio:.2f} of the threshold, for {1e3 * scene.seen.seconds:.0f} ms: free '
        f'motion does that once in {1.0 / _often(scene):.2g} h')


GAP = 'gap', 'look at drivers and network: the diagnostics count what is lost'
TOUCH = 'touch', 'look at the arm, then call the service reset of the monitor'
TRAINING = 'motion outside training', 'fit with such motion, or calibrate the monitor in it'
LOW = 'threshold too low', 'allow fewer false_alarms_per_hour, or fit more motion without contact'
CAUSES: tuple[tuple[Callable[[Scene], str], str, str], ...] = (
    (_clock, 'clock', 'let drivers stamp samples when they are measured, by one clock'),
    (_gap, *GAP),
    (_friction, 'friction after standstill', 'fit with bags in which joints start and stop'),
    (_gauge, 'gauge', 'look at cable and amplifier; tudor evaluate names one that has changed'),
    (_load, 'load', 'set payload_source to estimate, or announce loads (expect_payload)'),
    (_usual, *LOW),
    (_encoder, 'encoder', 'compare the pose of the arm with its positions, then mend the encoder'),
    (_faster, *TRAINING),
    (_touch, *TOUCH), (_losses, *GAP), (_training, *TRAINING), (_together, *TOUCH), (_low, *LOW))
"""What is looked for, in this order, its name, and what to do."""


@dataclass(frozen=True)
class Cause:
    """Why a monitor alarmed."""

    event: DetectedEvent
    name: str  # one of those of `CAUSES`, or `unexplained`
    evidence: str
    remedy: str
    same: bool | None  # whether the event of the node came again to the last bit; None without it


def _load_found(
    item: DetectedEvent, known: float, estimating: Replay, *, follows: bool,
) -> LoadFound | None:
    """Give the load of an event that the monitor did not know: it comes then, or hangs already."""
    event = item.event
    found = [one for one in estimating.loads
             if 0 <= one.stamp - event.onset <= LATE_LOAD * 1e9][-1:]
    if not follows and not any(  # a monitor that estimates the load has no such event
            -JUST_BEFORE < (other.event.onset - event.onset) * 1e-9 < item.seconds
            for other in estimating.log.events):
        found += [one for one in estimating.loads if one.stamp < event.onset][-1:]
    return next((one for one in found if abs(one.mass - known) > 0.5 * abs(one.change)), None)


def explain(
    bag: Bag, whole: ModelBundle, settings: MonitorSettings,
    source: str, payload: float,  # where the node knew the load from, and which [kg]
    records: list[dict[str, Any]],  # its events, to be explained; empty for all that come
) -> list[Cause]:
    """Replay what a monitor heard, and name the cause of each event."""
    learned, states, bundle = None, {}, whole.beside_robot()
    messages = messages_of(bag, bundle.arm)

    def monitor(how: str) -> Monitor:
        return Monitor(bundle.at(payload), settings, learned,
                       payload=carried_load(how, bundle, payload))
    if records and records[0]['settings'].get('payload', payload) == payload:
        with undamaged(bag, STATES):
            states = json.loads(bag.metadata.custom.get(STATES, '{}'))
            if states.get('thresholds'):  # of the service `calibrate`
                learned = stored_thresholds(states['thresholds'], bundle.arm, settings.kind)
    own, sensed = monitor(source), [item for item in messages if item.topic != ASKED]
    with undamaged(bag, STATES):
        for name, memory in own.memories.items():
            memory.recall(states.get(name, ()))
    with undamaged(bag, STATES, (IndexError,) if states else ()):
        estimating = seen = replay(messages, own)
    if source != 'estimate':
        with suppress(ModelError):  # not every model has kilograms
            estimating = replay(messages, monitor('estimate'))
    found = []
    for place, item in enumerate(seen.log.events):
        event = item.event
        record = next((one for one in records if one['method'] == event.method
                       and abs(one['onset'] - event.onset) < SAME_ONSET * 1e9), None)
        if records and record is None:
            continue
        arrived, unlike, known = seen.certain[place]
        load = _load_found(item, bundle.mass_at(payload) if known is None else known, estimating,
                           follows=source == 'estimate')
        scene = Scene(item, sensed, seen, load, arrived, unlike, own.watch.stages[event.method],
                      settings.kind == 'elastic', own.watch.bundle)
        name, text, remedy = next(((name, text, remedy) for look, name, remedy in CAUSES
                                   if (text := look(scene))), ('unexplained', '', ''))
        found.append(Cause(item, name, text, remedy, None if record is None else
                           (record['onset'], record['ratio']) == (event.onset, event.ratios)))
    return found
