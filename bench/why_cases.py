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
Events of known causes, and what `tudor why` says of them; a minute, some more to record.

Causes are put into the messages of free motion (gauges, currents and encoders that leap, drift,
freeze; clocks that jump; samples that are lost, repeated, or stamped late; friction), or are
simulated (pushes, loads, links without their damper). Sizes, channels and times are drawn. The
list was written before the code that names causes; the half `aside` was run when that was done.

    python bench/why_cases.py --work DIR [--half open|aside]

The two-blade arm's bags come along; the reference arm is recorded into --work.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
import subprocess
import sys
import warnings
import zlib

import numpy as np

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.bags.messages import load_topics
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.bags.storage import open_bag
from tudor_dynamics.errors import TudorWarning
from tudor_dynamics.identification.detection import find_truth
from tudor_dynamics.models.bundle_io import load_bundle
from tudor_dynamics.online.black_box import Heard, Replay
from tudor_dynamics.online.detector import Rates
from tudor_dynamics.online.explanation import explain
from tudor_dynamics.online.monitor import MonitorSettings

ROOT = Path(__file__).resolve().parent.parent
BEFORE, AFTER = 20.0, 3.5  # s of a bag around a cause
SECOND = 10**9
TRIES = 10  # times and sizes that are drawn until something alarms


@dataclass
class Stream:
    """Messages of a topic."""

    stamp: np.ndarray
    arrival: np.ndarray
    values: np.ndarray
    kept: np.ndarray = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        self.kept = np.ones(len(self.stamp), dtype=bool)


Streams = dict[str, Stream]
Fault = Callable[[Streams, float, np.random.Generator], None]


def after(stream: Stream, at: float, length: float = 1e9) -> np.ndarray:
    """Say which samples lie after a time [s], for a length of it."""
    t = (stream.stamp - stream.stamp[0]) * 1e-9
    return (t >= at) & (t < at + length)


def swing(stream: Stream) -> np.ndarray:
    """Give how far the channels go."""
    return stream.values.std(axis=0)


# -- Sensors

def leap(of: str) -> Fault:
    """A channel leaps and stays, as a cable or an amplifier does."""
    def put(streams: Streams, at: float, rng: np.random.Generator) -> None:
        s = streams[of]
        c = rng.integers(s.values.shape[1])
        s.values[after(s, at), c] += rng.choice([-1, 1]) * rng.uniform(0.5, 1.5) * swing(s)[c]
    return put


def drift(of: str) -> Fault:
    """A channel drifts away within seconds."""
    def put(streams: Streams, at: float, rng: np.random.Generator) -> None:
        s = streams[of]
        c = rng.integers(s.values.shape[1])
        t = (s.stamp - s.stamp[0]) * 1e-9
        s.values[:, c] += (rng.choice([-1, 1]) * rng.uniform(0.8, 2.0) * swing(s)[c]
                           * np.clip((t - at) / rng.uniform(0.8, 3.0), 0.0, 1.0))
    return put


def gain(of: str) -> Fault:
    """The gain of a channel changes."""
    def put(streams: Streams, at: float, rng: np.random.Generator) -> None:
        s = streams[of]
        c = rng.integers(s.values.shape[1])
        s.values[after(s, at), c] *= rng.choice([0.3, 0.5, 1.8, 2.5])
    return put


def spikes(of: str) -> Fault:
    """Some samples of a channel are far off."""
    def put(streams: Streams, at: float, rng: np.random.Generator) -> None:
        s = streams[of]
        c = rng.integers(s.values.shape[1])
        hit = after(s, at, rng.uniform(0.03, 0.1))
        s.values[hit, c] += rng.choice([-1, 1]) * rng.uniform(2.0, 4.0) * swing(s)[c]
    return put


def noisy(of: str) -> Fault:
    """A loose contact: a channel is noisy for a while."""
    def put(streams: Streams, at: float, rng: np.random.Generator) -> None:
        s = streams[of]
        c = rng.integers(s.values.shape[1])
        hit = after(s, at, rng.uniform(0.4, 1.2))
        s.values[hit, c] += rng.uniform(0.8, 2.0) * swing(s)[c] * rng.standard_normal(hit.sum())
    return put


def frozen(of: str) -> Fault:
    """A channel stays at its last value."""
    def put(streams: Streams, at: float, rng: np.random.Generator) -> None:
        s = streams[of]
        c = rng.integers(s.values.shape[1])
        hit = after(s, at)
        s.values[hit, c] = s.values[hit, c][0]
    return put


def encoder(streams: Streams, at: float, rng: np.random.Generator) -> None:
    """An encoder loses counts: a joint's position leaps and stays off."""
    s = streams['joints']
    c = rng.integers(s.values.shape[1])
    s.values[after(s, at), c] += rng.choice([-1, 1]) * rng.uniform(0.03, 0.12)


def bridge(streams: Streams, at: float, rng: np.random.Generator) -> None:
    """The supply of all gauges breaks down: each leaps as it likes."""
    s = streams['strain']
    s.values[after(s, at)] += swing(s) * rng.uniform(0.5, 1.5, s.values.shape[1]) * rng.choice(
        [-1, 1], s.values.shape[1])


# -- Data flow and clocks

def lost(streams: Streams, at: float, rng: np.random.Generator) -> None:
    """A busy machine loses most of the joint states for a while, never five in a row."""
    s = streams['joints']
    hit = np.flatnonzero(after(s, at, rng.uniform(0.5, 1.5)))
    s.kept[hit[np.arange(len(hit)) % rng.integers(4, 6) > 0]] = False


def stale(streams: Streams, at: float, rng: np.random.Generator) -> None:
    """The driver repeats old positions with new stamps."""
    s = streams['joints']
    for begin in (at, at + 0.3):
        hit = np.flatnonzero(after(s, begin, rng.uniform(0.05, 0.12)))
        s.values[hit] = s.values[hit[0]]


def stamped_late(streams: Streams, at: float, rng: np.random.Generator) -> None:
    """A busy driver stamps when it publishes: it stalls, and then sends what has piled up."""
    s = streams['joints']
    for begin in (at, at + 0.25, at + 0.5):
        hit = np.flatnonzero(after(s, begin, rng.uniform(0.035, 0.08)))
        s.stamp[hit] = s.stamp[hit[-1]] - (len(hit) - 1 - np.arange(len(hit))) * 300_000
        s.arrival[hit] = s.stamp[hit]


def jitter(streams: Streams, at: float, rng: np.random.Generator) -> None:
    """Stamps of the joint states jitter for a while."""
    s = streams['joints']
    hit = after(s, at, rng.uniform(0.5, 1.0))
    s.stamp[hit] += (rng.uniform(2.5e6, 4e6) * rng.uniform(-1, 1, hit.sum())).astype(np.int64)
    s.arrival[hit] = s.stamp[hit]


def clock(of: str) -> Fault:
    """The clock of a sensor's host is set: its stamps jump, its messages arrive as before."""
    def put(streams: Streams, at: float, rng: np.random.Generator) -> None:
        s = streams[of]
        s.stamp[after(s, at)] += int(rng.choice([-1, 1]) * rng.uniform(0.06, 0.15) * SECOND)
    return put


def late(of: str) -> Fault:
    """What a sensor says is old from now on, with new stamps."""
    def put(streams: Streams, at: float, rng: np.random.Generator) -> None:
        s = streams[of]
        n = int(rng.uniform(0.06, 0.15) * SECOND / np.median(np.diff(s.stamp)))
        hit = np.flatnonzero(after(s, at))
        s.values[hit] = s.values[hit - n].copy()
    return put


# -- The arm itself

def friction(streams: Streams, at: float, rng: np.random.Generator) -> None:
    """A joint that has stood breaks loose late: its current is higher for a moment."""
    s, q = streams['effort'], streams['joints']
    c = int(rng.integers(s.values.shape[1]))
    t = (q.stamp - q.stamp[0]) * 1e-9
    speed = np.gradient(q.values[:, c], t)
    moves = np.abs(speed) > 0.05
    starts = [k for k in np.flatnonzero(np.diff(moves.astype(int)) > 0)
              if k > 60 and not moves[k - 40:k].any() and moves[k + 1:k + 30].all()
              and t[k] < t[-1] - AFTER]
    if not starts:
        raise LookupError('the joint never starts')
    k = min(starts, key=lambda k: abs(t[k] - at))
    since = (s.stamp - q.stamp[k]) * 1e-9
    size = rng.uniform(0.8, 1.5) * swing(s)[c] * np.sign(speed[k + 10])
    s.values[:, c] += np.where(since >= -0.03, size * np.exp(-np.maximum(since, 0.0) / rng.uniform(
        0.1, 0.3)), 0.0)
    s.moved = t[k]  # type: ignore[attr-defined]


def nonsense(streams: Streams, at: float, rng: np.random.Generator) -> None:
    """All channels of all outputs go their own ways: nothing on the list does this."""
    for of in ('strain', 'effort'):
        s = streams[of]
        hit = after(s, at, 0.8)
        n = hit.sum()
        walk = np.cumsum(rng.standard_normal((n, s.values.shape[1])), axis=0) / np.sqrt(n)
        s.values[hit] += 1.5 * swing(s) * walk


FAULTS: dict[str, tuple[set[str], list[Fault]]] = {
    'gauge leaps': ({'sensor'}, [leap('strain')] * 2),
    'gauge drifts': ({'sensor'}, [drift('strain')] * 2),
    'gauge gain': ({'sensor'}, [gain('strain')] * 2),
    'gauge spikes': ({'sensor'}, [spikes('strain')] * 2),
    'gauge noisy': ({'sensor'}, [noisy('strain')] * 2),
    'gauge frozen': ({'sensor'}, [frozen('strain')] * 2),
    'current leaps': ({'sensor'}, [leap('effort')] * 2),
    'current drifts': ({'sensor'}, [drift('effort')] * 2),
    'encoder leaps': ({'sensor'}, [encoder] * 2),
    'all gauges leap': ({'sensor', 'unexplained'}, [bridge] * 2),
    'samples lost': ({'samples'}, [lost] * 2),
    'positions repeated': ({'samples'}, [stale] * 2),
    'stamped late': ({'samples', 'clock'}, [stamped_late] * 2),
    'stamps jitter': ({'samples', 'clock'}, [jitter] * 2),
    'clock of gauges': ({'clock'}, [clock('strain')] * 2),
    'clock of joints': ({'clock'}, [clock('joints')] * 2),
    'gauges late': ({'clock', 'samples'}, [late('strain')] * 2),
    'friction': ({'friction'}, [friction] * 4),
    'nonsense': ({'unexplained'}, [nonsense] * 2),
}


@dataclass(frozen=True)
class Case:
    """An event of a known cause."""

    name: str
    want: set[str]
    model: Path
    recording: Recording
    at: float
    fault: Fault | None = None
    rates: Rates = Rates()
    aside: bool = False


def streams_of(recording: Recording) -> Streams:
    """Make messages of a recording."""
    delay = np.random.default_rng(1).uniform(2e5, 1.5e6, (3, len(recording.stamp))).astype(int)
    return {name: Stream(recording.stamp.copy(), recording.stamp + delay[k], values.copy())
            for k, (name, values) in enumerate((
                ('joints', recording.q), ('effort', recording.effort),
                ('strain', recording.strain)))}


def messages(streams: Streams, begin: float, end: float) -> list[Heard]:
    """Put what is left of the messages into the order of their arrival."""
    first = streams['effort'].stamp[0]
    found = [Heard(int(s.arrival[k]), name, name, int(s.stamp[k]), s.values[k])
             for name, s in streams.items() for k in np.flatnonzero(s.kept)
             if begin * SECOND <= s.arrival[k] - first < end * SECOND]
    return sorted(found, key=lambda item: item.time)


def record(work: Path, name: str, *options: str) -> list[Path]:
    """Record the reference arm, once."""
    if not (work / name / 'campaign.yaml').exists():
        subprocess.run([sys.executable, '-m', 'tudor_dynamics', 'record', '--arm',
                        str(ROOT / 'config/tudor.yaml'), '--seconds', '40', '--out',
                        str(work / name), *options], check=True, stdout=subprocess.DEVNULL)
    return sorted((work / name).glob('stimulus_*'))


def fitted(out: Path, arm: str, *bags: Path) -> Path:
    """Fit a model, once."""
    if not out.exists():
        subprocess.run([sys.executable, '-m', 'tudor_dynamics', 'fit', *map(str, bags), '--arm',
                        str(ROOT / 'config' / arm), '--out', str(out)], check=True,
                       stdout=subprocess.DEVNULL)
    return out


def cases(work: Path) -> Iterator[Case]:
    """Give all cases; of each kind every second one is kept aside."""
    own, load = ROOT / 'bags', ('--payload', '0.2')
    free = record(work, 'free', *load, '--stimuli', '4', '--seed', '7')
    empty = record(work, 'empty', '--payload', '0', '--stimuli', '3', '--seed', '17')
    model_a = fitted(work / 'model_a', 'two_blade_arm.yaml', own / 'two_blade_train_1',
                     own / 'two_blade_train_2')
    model_b = fitted(work / 'model_b', 'tudor.yaml', *free[:3])
    model_b0 = fitted(work / 'model_b0', 'tudor.yaml', *empty)
    arms = {'a': (model_a, own / 'two_blade_test'), 'b': (model_b, free[3])}
    counts: Counter[str] = Counter()

    def turn(name: str) -> bool:
        counts[name] += 1
        return counts[name] % 2 == 0

    def read(path: Path, arm: str) -> Recording:
        return read_recording(path, load_arm(ROOT / 'config' / arm))
    for arm, (model, bag) in arms.items():
        recording = read(bag, 'two_blade_arm.yaml' if arm == 'a' else 'tudor.yaml')
        for name, (want, faults) in FAULTS.items():
            for number, fault in enumerate(faults):
                rng = np.random.default_rng(zlib.crc32(f'{arm} {name} {number}'.encode()))
                at = float(rng.uniform(5.0, recording.t[-1] - AFTER - 1.0))
                yield Case(f'{arm} {name} {number}', want, model, recording, at, fault,
                           aside=turn(name))
        for number, rate in enumerate((1500.0, 3000.0)):
            yield Case(f'{arm} thresholds low {number}', {'threshold'}, model, recording,
                       float(recording.t[-1]) - AFTER, None, Rates(rate, 3600.0), turn('low'))
    pushed = [('a', model_a, own / 'two_blade_pushes'), *(
        ('b', model_b, path) for path in (
            *record(work, 'pushes', *load, '--stimuli', '2', '--seed', '8', '--pushes', '5'),
            *record(work, 'held', *load, '--stimuli', '1', '--seed', '9', '--pushes', '4',
                    '--held')))]
    for arm, model, path in pushed:
        recording = read(path, 'two_blade_arm.yaml' if arm == 'a' else 'tudor.yaml')
        for number, push in enumerate(find_truth(str(path)).pushes):
            yield Case(f'{arm} {path.parent.name} push {number}', {'touch'}, model, recording,
                       (push.begin - int(recording.stamp[0])) * 1e-9, aside=turn('push'))
    for path in record(work, 'loads', '--payload', '0', '--stimuli', '2', '--seed', '10',
                       '--loads', '4'):
        recording = read(path, 'tudor.yaml')
        for number, at in enumerate(picked_up(path)):
            yield Case(f'b {path.name} load {number}', {'load'}, model_b0, recording, at,
                       aside=turn('load'))
    for path in record(work, 'undamped', *load, '--stimuli', '2', '--seed', '11', '--no-damping'):
        recording = read(path, 'tudor.yaml')
        for at in (3.0, 12.0, 21.0, 30.0):
            yield Case(f'b {path.name} undamped {at:g}', {'motion'}, model_b, recording, at,
                       aside=turn('undamped'))


def picked_up(path: Path) -> list[float]:
    """Give when loads were picked up [s]."""
    carried = load_topics(open_bag(path), ['/applied_payload'])['/applied_payload']
    mass = carried.select(('payload',), 'position', str(path))[1][:, 0]
    return [(carried.stamp[k] - carried.stamp[0]) * 1e-9
            for k in np.flatnonzero(np.diff(mass, prepend=0.0) > 0.0)]


def run(case: Case) -> tuple[str, str]:
    """Give the cause that is named, and why; empty where nothing alarms in some tries."""
    bundle = load_bundle(case.model)
    settings = replace(MonitorSettings(), methods=(), rates=case.rates)
    first = int(case.recording.stamp[0])
    rng = np.random.default_rng(zlib.crc32(case.name.encode()) + 1)
    for number in range(TRIES if case.fault is not None else 1):
        streams, at = streams_of(case.recording), case.at
        if number:
            at = float(rng.uniform(5.0, case.recording.t[-1] - AFTER - 1.0))
        if case.fault is not None:
            case.fault(streams, at, rng)
            at = getattr(streams['effort'], 'moved', at)
        heard = messages(streams, max(0.0, at - BEFORE), at + AFTER)
        events = [event for event in Replay(bundle, settings, heard).events
                  if (at if case.rates == Rates() else 3.0) - 0.2 <= (event.stamp - first) * 1e-9]
        if events:
            found = explain(bundle, settings, heard, events[0])
            return found.cause, found.text
    return '', ''


def judge(case: Case) -> tuple[str, bool]:
    """Run a case, and print it; gives the cause that is named, and if it is right."""
    try:
        cause, text = run(case)
    except LookupError as err:
        cause, text = '', str(err)
    good = cause in case.want
    print(f'{case.name:28s} {"" if good or not cause else "WRONG":6s}{cause or "no event":12s} '
          f'{text}', flush=True)
    return cause, good


def main() -> None:
    """Print each case, and a table."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--work', type=Path, required=True)
    parser.add_argument('--half', choices=('open', 'aside', 'both'), default='open')
    parser.add_argument('--only', default='', help='cases whose name has this in it')
    args = parser.parse_args()
    warnings.simplefilter('ignore', TudorWarning)
    rows = []
    for half in ('open', 'aside') if args.half == 'both' else (args.half,):
        chosen = [case for case in cases(args.work)
                  if case.aside == (half == 'aside') and args.only in case.name]
        found = [judge(case) for case in chosen]
        wrong = Counter(f'{"/".join(sorted(case.want))} as {cause}' for case, (cause, good) in zip(
            chosen, found, strict=True) if cause and not good)
        events = sum(bool(cause) for cause, _ in found)
        rows.append((half, len(found), events, events - wrong.total(),
                     '; '.join(f'{count} {what}' for what, count in wrong.most_common())))
    print('| half | cases | with an event | named rightly | named otherwise |')
    print('|---|---|---|---|---|')
    for row in rows:
        print('| ' + ' | '.join(map(str, row)) + ' |')


if __name__ == '__main__':
    main()
