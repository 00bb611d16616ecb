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
Say why a monitor alarmed: the messages of the bag that it wrote pass the same object again.

    python tools/why.py ~/.ros/tudor_dynamics/events/event_20260314_140315_401236
    python tools/why.py run4 --model model --at 14:03:12

The bag of an event holds the settings of the monitor, and names its model. In a bag without events
that were recorded, all that come are explained. Causes: clock, gauge, gap, load, friction after
standstill, touch, motion unlike training, threshold too low; otherwise the event is unexplained.
Exit codes: 0 each event has a cause; 1 one has none, or none came; 2 wrong input. How often it is
right: bench/causes.py.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
import sys
from typing import Any

import numpy as np
from tudor_dynamics.arm.description import Arm, array_places
from tudor_dynamics.bags.messages import DATA, JOINT_STATE, load_topics
from tudor_dynamics.bags.storage import Bag, open_bag
from tudor_dynamics.cli.console import print_json, say
from tudor_dynamics.errors import BagError, ModelError, TudorError, UsageError
from tudor_dynamics.identification.detection import DetectedEvent, EventLog, FREE
from tudor_dynamics.load.live import carried_load, LoadFound
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.bundle_io import load_bundle
from tudor_dynamics.nodes.common.interfaces import FIELD
from tudor_dynamics.online.black_box import records_of
from tudor_dynamics.online.contact import ContactEstimate
from tudor_dynamics.online.detector import Excess, time_of_day
from tudor_dynamics.online.monitor import Found, Monitor, MonitorSettings, SOURCE
from tudor_dynamics.online.settings import LOST_STEP, STANDING
from tudor_dynamics.online.streams import Gathering
from tudor_dynamics.online.thresholds import MethodThresholds
from tudor_dynamics.typing import FloatArray

# Chosen on the simulated arm of config/tudor.yaml; SHARED, and the order of causes, also on
# recordings of the two-blade arm. Judged on another arm (bench/causes.py --stiff).
BEFORE, LONG_BEFORE = 0.1, 10.0
"""Times before an onset that are looked at [s]."""
BRIEF = 0.15
"""Shorter events come by chance, or after a loss [s]."""
CLOCK_STEP = 1.5
"""Stamps that leap by more while messages come as always [periods]."""
LOST_BEFORE = 0.5
"""Time before an event within which losses may be its cause [s]."""
LEAP, QUIET_CHANNEL = 0.7, 0.5
"""Part of a change that comes in one sample; other channels then, in their thresholds."""
STARTED, STOOD = 0.4, 0.3
"""A joint has begun to move so lately, and stood before for so long [s]."""
FELT = 0.5
"""Share of the samples of an event at which a contact is felt."""
LEAST_TOUCH, SHARED = 0.06, 0.8
"""A force lasts so long [s]; or the other sensor shows so much, in its threshold."""
UNLIKE = 0.8
"""Of a threshold, reached before an event."""
FASTER = 1.1
"""Times the largest speed of the training."""
USUAL = 6.0
"""Where free motion reaches a ratio more often, its threshold is too low [1/h]."""
JUST_ABOVE = 1.3
"""Ratio to a threshold."""
LATE_LOAD = 4.0
"""Time after an onset until which a load is found [s]."""
SAME = 0.05
"""Onsets of one event differ by less [s]."""


# -- The messages of a bag in the order in which they arrived, past a monitor

@dataclass(frozen=True, eq=False)
class Heard:
    """One message as a monitor takes it."""

    time: int  # when it arrived [ns]
    stamp: int  # header stamp [ns]
    topic: str  # as the arm description names it
    # `q`, `dq`, `effort` and `strain` of the channels that the topic carries, as far as it does
    fields: dict[str, FloatArray]


def messages_of(bag: Bag, arm: Arm) -> list[Heard]:
    """Read what a monitor of an arm listens to."""
    own = arm.spec.joint_topic
    wanted: dict[str, list[tuple[str, Sequence[str], str]]] = {
        own: [('q', arm.active_joints, 'position'), ('dq', arm.active_joints, 'velocity')]}
    for output, carried in arm.topics.items():
        for topic, names in carried.items():
            wanted.setdefault(topic, []).append(
                (output, tuple(names), FIELD[output]))
    places = {topic: name for topic, name in bag.find(dict.fromkeys(wanted, JOINT_STATE)).items()
              if name is not None}
    if own not in places:
        raise BagError(f'no topic {own}', place=str(bag.path),
                       remedy='give a bag of the node monitor, or of what it listens to')
    topics, arrays, found = load_topics(bag, list(places.values())), array_places(arm), []
    for topic, name in places.items():
        decoded = topics[name]
        rows: list[dict[str, FloatArray]] = [{} for _ in decoded.stamp]
        for key, of, part in wanted[topic]:
            columns: Sequence[str] = of
            if topic in arrays:
                columns, part = [str(arrays[topic][item]) for item in of], DATA
            for row, values in zip(*decoded.select(columns, part, str(bag.path)), strict=True):
                rows[row][key] = values
        stamps = decoded.stamp if decoded.stamped else decoded.log_time
        found += [Heard(time, stamp, topic, row) for time, stamp, row in zip(
            decoded.log_time.tolist(), stamps.tolist(), rows, strict=True)]
    return sorted(found, key=lambda message: message.time)


@dataclass(eq=False)
class Replay:
    """What a monitor made of messages."""

    log: EventLog = field(default_factory=EventLog)
    excesses: dict[str, list[Excess]] = field(default_factory=dict)  # by method
    loads: list[LoadFound] = field(default_factory=list)
    contacts: list[ContactEstimate] = field(default_factory=list)
    unlike: list[str] = field(default_factory=list)  # at each event, why motion is unlike training


def replay(messages: Iterable[Heard], arm: Arm, monitor: Monitor) -> Replay:
    """Let a monitor take messages as the node does: joint states first, then what they carry."""
    seen, watch = Replay(), monitor.watch
    gathering = {output: Gathering(arm.channels[output], arm.topics[output])
                 for output in watch.outputs}

    def take(found: Found) -> None:
        for method, excess in found.excesses:
            seen.excesses.setdefault(method, []).append(excess)
        seen.loads += found.loads
        seen.contacts += found.contacts
        seen.unlike += [watch.outside_training] * len(found.events)
        seen.log.add(found, watch)

    for message in messages:
        if message.topic == arm.spec.joint_topic:
            if 'q' not in message.fields:
                continue
            take(monitor.add_joints(message.stamp, message.fields['q'], message.fields.get('dq')))
        for output, stage in gathering.items():
            if output in message.fields:
                for stamp, whole in stage.add(
                        message.topic, message.stamp, message.fields[output]):
                    take(monitor.add_measured(output, stamp, whole))
    return seen


# -- Causes, each with the evidence that the messages around an event show, or an empty text

@dataclass(frozen=True, eq=False)
class Scene:
    """An event with all that is known of the time around it."""

    seen: DetectedEvent
    messages: list[Heard]
    replay: Replay
    load: LoadFound | None  # what turned out to be carried
    unlike: str  # why the motion is unlike that of the training; empty where it is not
    thresholds: MethodThresholds  # of the method
    rate: float  # false alarms that they allow [1/h]
    topics: dict[str, dict[str, list[str]]]  # of each output, with their channels

    def excesses(self, begin: float, end: float, method: str = '') -> list[Excess]:
        """Give the samples of a method between two times since the onset [s]."""
        onset = self.seen.event.onset
        return [excess for excess in self.replay.excesses.get(method or self.seen.event.method, ())
                if begin <= (excess.residual.motion.stamp - onset) * 1e-9 <= end]

    def readings(self, output: str, channel: str, begin: float, end: float) -> FloatArray:
        """Give the readings of a channel between two times since the onset [s]."""
        topic, names = next((topic, names) for topic, names in self.topics[output].items()
                            if channel in names)
        place, onset = names.index(channel), self.seen.event.onset
        return np.array([message.fields[output][place] for message in self.messages
                         if message.topic == topic and output in message.fields
                         and begin <= (message.stamp - onset) * 1e-9 <= end])

    def steps(self, before: float) -> Iterator[tuple[str, FloatArray, FloatArray]]:
        """Give steps of stamps and of arrivals in a time before the event [s], in usual ones."""
        event = self.seen.event
        for topic in dict.fromkeys(message.topic for message in self.messages):
            own = np.array([(item.stamp, item.time) for item in self.messages
                            if item.topic == topic])
            if len(own) > 2:
                steps = np.diff(own, axis=0) / np.median(np.diff(own[:, 0]))
                near = (own[1:, 1] >= event.onset - before * 1e9) & (own[1:, 1] <= event.stamp)
                yield topic, *steps[near].T


def _clock(scene: Scene) -> str:
    for topic, stamp, arrival in scene.steps(LONG_BEFORE):
        leap = stamp - arrival
        leaps = np.flatnonzero((np.abs(leap) > CLOCK_STEP) & (np.abs(arrival - 1.0) < 1.0))
        if len(leaps) and abs(leap[leaps[0]:].sum()) > CLOCK_STEP:  # and stays
            return (f'stamps of {topic} leap by {leap[leaps[0]]:+.1f} periods while its messages '
                    'come as always')
    return ''


def _gap(scene: Scene) -> str:
    if scene.seen.seconds > BRIEF:
        return ''
    for topic, stamp, _ in scene.steps(LOST_BEFORE):
        lost = int(np.sum(np.round(stamp[stamp > LOST_STEP]) - 1))
        if lost:
            return f'{lost} samples of {topic} are missing within {LOST_BEFORE:g} s before it'
    return ''


def _gauge(scene: Scene) -> str:
    """One channel leaps from a sample to the next, or stands, and no other shows anything."""
    event, channel = scene.seen.event, scene.seen.channel
    output = SOURCE[event.method]
    for name in event.ratios:
        lately, ever = (scene.readings(output, name, -before, 0.0) for before in (BEFORE, np.inf))
        if len(lately) > 2 and not np.ptp(lately) and np.ptp(ever):
            return f'{name} stands at {lately[0]:.4g} to the last digit'
    if event.method == 'momentum':
        return ''
    place = list(event.ratios).index(channel)
    rest = max((float(np.max(np.delete(np.abs(item.residual.value / item.threshold), place),
                             initial=0.0)) for item in scene.excesses(-BEFORE, BRIEF)),
               default=0.0)
    value = scene.readings(output, channel, -BEFORE, BRIEF)
    whole, leap = float(np.ptp(value)), float(np.abs(np.diff(value)).max(initial=0.0))
    if rest > QUIET_CHANNEL or not leap > LEAP * whole:
        return ''
    return (
        f'{channel} leaps by {leap:.3g} from one sample to the next, {leap / whole:.0%} of all it '
        f'does; no other channel is above {rest:.2f} of its threshold')


def _load(scene: Scene) -> str:
    load = scene.load
    return '' if load is None else (
        f'{(load.stamp - scene.seen.event.onset) * 1e-9:.2f} s after the onset all that came is '
        f'what {load.change:+.3f} kg at the tip do')


def _friction(scene: Scene) -> str:
    """A joint has just begun to move, and what bends the links shows nothing."""
    event, joint = scene.seen.event, scene.seen.channel
    if event.method == 'strain':
        return ''
    strain = max((float(excess.collision.max()) for excess in scene.excesses(
        -BEFORE, scene.seen.seconds, 'strain')), default=0.0)
    place = list(event.ratios).index(joint)
    before = scene.excesses(-STARTED - STOOD, 0.0)
    n = len(event.ratios)
    speed = np.abs([excess.residual.motion.row[n + place] for excess in before])
    stood = float(np.mean(speed < STANDING)) * (STARTED + STOOD) if len(speed) else 0.0
    if strain > QUIET_CHANNEL or stood < STOOD:
        return ''
    return (f'{joint} stood for {stood:.2f} of the last {STARTED + STOOD:g} s before it, and '
            'the efforts of a joint that begins to move are its friction')


def _faster(scene: Scene) -> str:
    rows = [excess.residual.motion.row for excess in scene.excesses(-LOST_BEFORE, 0.0)]
    n = len(scene.thresholds.reach)
    times = max((float(np.max(np.abs(row[n:2 * n]) / scene.thresholds.reach)) for row in rows),
                default=0.0)
    return '' if times < FASTER else f'it moved {times:.2f} times as fast as in the training'


def _training(scene: Scene) -> str:
    # other events and what follows them say nothing of free motion
    onset = scene.seen.event.onset
    others = [item.event.onset for item in scene.replay.log.events
              if item.event.onset < onset - 1e8]
    often = max((float(excess.collision.max()) for excess in scene.excesses(-LONG_BEFORE, -BEFORE)
                 if not any(-1.0 < (excess.residual.motion.stamp - other) * 1e-9 < 3.0
                            for other in others)), default=0.0)
    if not scene.unlike and often < UNLIKE:
        return ''
    return '; '.join(filter(None, (scene.unlike, f'up to {often:.2f} of a threshold was reached '
                                   f'in the {LONG_BEFORE:g} s before it')))


def _touch(scene: Scene) -> str:
    """A contact is felt most of the time: a force that lasts, or what gauges and drives share."""
    found, event = scene.seen.contact, scene.seen.event
    until = max(scene.seen.seconds, BRIEF)
    during = [item.felt for item in scene.replay.contacts
              if 0.0 <= (item.stamp - event.onset) * 1e-9 <= until]
    if not during or np.mean(during) < FELT:
        return ''
    if found and found['seconds'] >= LEAST_TOUCH:
        place = '' if found['place'] is None else (
            f', {1e3 * found["place"]:.0f} mm from its joint')
        return (f'{abs(found["largest_force"]):.2f} N on {found["link"]}{place}, for '
                f'{found["seconds"]:.2f} s')
    most = {method: max((float(excess.collision.max()) for excess in scene.excesses(
        -BEFORE, until, method)), default=0.0) for method in scene.replay.excesses}
    other = max((ratio for method, ratio in most.items()
                 if SOURCE[method] != SOURCE[event.method]), default=0.0)
    return '' if other < SHARED else 'gauges and drives show it together: ' + ', '.join(
        f'{method} {ratio:.2f} of its threshold' for method, ratio in most.items())


def _often(scene: Scene) -> float:
    """Say how often free motion of the training reaches such a ratio [1/h]."""
    allowed = scene.rate
    parts = np.geomspace(1.0, 1e-4, 81)
    ratios = [float(np.median(scene.thresholds.ratios(allowed * part)
                              / scene.thresholds.ratios(allowed))) for part in parts]
    return float(np.interp(scene.seen.ratio, ratios, allowed * parts))


def _usual(scene: Scene) -> str:
    often = _often(scene)
    return '' if often < USUAL else (
        f'{scene.seen.ratio:.2f} of a threshold that allows {scene.rate:.0f} false alarms an '
        f'hour; free motion reaches as much {often:.0f} times an hour')


def _low(scene: Scene) -> str:
    """The threshold was hardly exceeded, and not for long."""
    return '' if scene.seen.ratio > JUST_ABOVE or scene.seen.seconds > BRIEF else (
        f'{scene.seen.ratio:.2f} of the threshold, for {1e3 * scene.seen.seconds:.0f} ms: free '
        f'motion does that once in {1.0 / _often(scene):.2g} h')


TRAINING = 'motion unlike training', ('fit with such motion, or learn the thresholds from it '
                                      '(~/calibrate)')
LOW = 'threshold too low', 'allow fewer false_alarms_per_hour, or fit with more free motion'
CAUSES: tuple[tuple[Callable[[Scene], str], str, str], ...] = (
    (_clock, 'clock', 'let drivers stamp samples when they are measured, by one clock'),
    (_gap, 'gap', 'look at drivers and network: the diagnostics count what is lost'),
    (_friction, 'friction after standstill', 'fit with bags in which joints start and stop'),
    (_gauge, 'gauge', 'look at cable and amplifier; tudor evaluate names one that has changed'),
    (_load, 'load', 'set payload_source to estimate, or announce loads by ~/expect_payload'),
    (_usual, *LOW), (_faster, *TRAINING),
    (_touch, 'touch', 'look at the arm; ~/reset goes on'),
    (_training, *TRAINING), (_low, *LOW))
"""What is looked for, in this order, its name, and what to do."""
UNEXPLAINED = 'unexplained'


@dataclass(frozen=True)
class Cause:
    """Why a monitor alarmed."""

    event: DetectedEvent
    name: str  # one of those of `CAUSES`, or `UNEXPLAINED`
    evidence: str
    remedy: str
    same: bool | None  # whether the event of the node came again to the last bit; None without it


def explain(
    bag: Bag, whole: ModelBundle, settings: MonitorSettings, source: str, payload: float,
    records: list[dict[str, Any]],
) -> list[Cause]:
    """
    Replay what a monitor heard, and name the cause of each event.

    source, payload [kg]: where the node knew the load from, and which; records: its events, which
    are those explained, or none for all that come.
    """
    bundle = whole.beside_robot()
    messages, arm = messages_of(bag, bundle.arm), bundle.arm

    def monitor(how: str) -> Monitor:
        return Monitor(bundle.at(payload), settings, payload=carried_load(how, bundle, payload))
    own = monitor(source)
    seen = replay(messages, arm, own)
    loads = seen.loads
    if source != 'estimate':
        with suppress(ModelError):  # not every model has kilograms
            loads = replay(messages, arm, monitor('estimate')).loads
    events = seen.log.sightings(messages[0].stamp, FREE)
    found = []
    for place, item in enumerate(events):
        event = item.event
        record = next((one for one in records if one['method'] == event.method
                       and abs(one['onset'] - event.onset) < SAME * 1e9), None)
        if records and record is None:
            continue
        load = next((one for one in loads if 0 <= one.stamp - event.onset <= LATE_LOAD * 1e9),
                    None)
        scene = Scene(item, messages, seen, load, seen.unlike[place], own.watch.stages[
            event.method].thresholds, own.watch.stages[event.method].rates.collision,
            arm.topics)
        name, text, remedy = next(((name, text, remedy) for look, name, remedy in CAUSES
                                   if (text := look(scene))), (UNEXPLAINED, '', ''))
        found.append(Cause(item, name, text, remedy, None if record is None else
                           (record['onset'], record['ratio']) == (event.onset, event.ratios)))
    return found


# -- The command

def arguments(argv: Sequence[str] | None = None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('bag', metavar='BAG', help='bag of events, or any other recording')
    parser.add_argument('--model', metavar='MODEL',
                        help='bundle of tudor fit (that which the bag names)')
    parser.add_argument('--at', default='', metavar='HH:MM:SS',
                        help='explain the events whose date or time of day has this in it')
    parser.add_argument('--payload', type=float, metavar='KG',
                        help='mass at the tip (that which the bag names, or 0)')
    parser.add_argument('--json', action='store_true', help='print the causes as JSON')
    return parser.parse_args(argv)


def causes(args: argparse.Namespace) -> list[Cause]:
    """Read, replay, explain."""
    bag = open_bag(args.bag)
    records = records_of(bag)
    params = records[0]['settings'] if records else {}
    model = args.model or params.get('model')
    if not model:
        raise UsageError('names no model', place=args.bag, remedy='give --model MODEL')
    try:
        settings = MonitorSettings.of({**params, 'estimate_contact': True}) if params else (
            MonitorSettings(methods=(), contact=True))
        payload = float(params.get('payload', 0.0) if args.payload is None else args.payload)
    except (KeyError, TypeError, ValueError) as err:
        raise UsageError(f'its settings are not those of a monitor ({err})', place=args.bag,
                         remedy='give a bag of this version') from None
    source = str(params.get('payload_source', 'parameter'))
    bundle = load_bundle(model)
    if records and records[0].get('digest', bundle.digest) != bundle.digest:
        print(f'why: {model} is another model than at the event ({bundle.digest[:12]}, then '
              f'{str(records[0]["digest"])[:12]}): other events and causes may come',
              file=sys.stderr)
    found = explain(bag, bundle, settings, source, payload, records)
    return [cause for cause in found if args.at in time_of_day(cause.event.event.onset)]


def main(argv: Sequence[str] | None = None) -> int:
    """Print the causes."""
    args = arguments(argv)
    try:
        found = causes(args)
    except TudorError as err:
        print(f'why: {err}', file=sys.stderr)
        return 2
    if args.json:
        print_json([{
            **cause.event.as_dict(), 'method': cause.event.event.method, 'cause': cause.name,
            'evidence': cause.evidence, 'remedy': cause.remedy, 'same': cause.same}
            for cause in found])
    else:
        report(found)
    return 0 if found and all(cause.evidence for cause in found) else 1


def report(found: Sequence[Cause]) -> None:
    """Print a paragraph for each event."""
    if not found:
        say('no such event comes when the messages pass the monitor again')
    for cause in found:
        seen = cause.event
        say(f'{time_of_day(seen.event.onset)}: {cause.name}',
            f'  {seen.channel} of {seen.event.link}, by {seen.event.method}: '
            f'{seen.ratio:.2f} times its threshold, for {1e3 * seen.seconds:.0f} ms',
            *(f'  {text}' for text in (cause.evidence, cause.remedy) if text))
        if cause.same is not None:
            say('  the replay gives the event of the node to the last bit' if cause.same else
                '  the replay comes near to the event of the node, not to the last bit: the node '
                'was older than 30 s, or the model is another')


if __name__ == '__main__':
    sys.exit(main())
