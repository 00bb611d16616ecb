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
Which cause `tudor why` names, where it is known.

    python bench/causes.py --work DIR [--first 0 --seeds 3] [--stiff] [--elastic] [--only touch]
    python bench/causes.py --work DIR --recorded

Arms in simulation are touched, loaded, moved faster than in the training; their messages are
spoiled. With --stiff the blades are half as thick again, drives have twice the friction. With
--elastic the monitor watches the residuals of an elastic model. With --recorded the messages of
the real two-blade arm are spoiled, and its pushes are explained. Bounds were chosen on seeds 0 to
2 of the arm as it is, those of encoders on its seeds 0 to 11. The order of causes, and what gauges
and drives share, were chosen on the recordings, too. Seed 52 of --stiff showed that a load may go
again. Nothing was chosen on seeds from 60 on.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
import struct
import sys
from tempfile import TemporaryDirectory

import numpy as np
from tables import show
import tudor_dynamics as td
from tudor_dynamics.bags.storage import open_bag
from tudor_dynamics.identification.causes import Cause, explain
from tudor_dynamics.online.detector import Rates
from tudor_dynamics.online.monitor import MonitorSettings
import yaml

ROOT = Path(__file__).parents[1]

RATE, SECONDS, AT = 100.0, 24.0, 14.0
"""Samples a second, length of a recording, and when something happens [s]."""
LATE, DRIFT = 0.25, 0.02
"""By which stamps leap [s]; slowest drift of an encoder [rad/s]."""
SPOILED = {'clock': 'clock', 'gauge leaps': 'gauge', 'gauge stuck': 'gauge', 'gap': 'gap',
           'breakaway': 'friction after standstill', 'encoder drifts': 'encoder'}
MOVED = {'touch': 'touch', 'touch at rest': 'touch', 'blow': 'touch', 'load': 'load',
         'fast': 'motion outside training', 'low': 'threshold too low'}
"""What is done, and the cause that is to be named."""


@dataclass(eq=False)
class Messages:
    """What an arm sends, sample by sample; which of its positions come."""

    stamp: np.ndarray  # [ns]
    q: np.ndarray
    dq: np.ndarray | None
    current: np.ndarray
    strain: np.ndarray
    kept: np.ndarray


def messages(
    stamp: np.ndarray, q: np.ndarray, dq: np.ndarray | None, current: np.ndarray,
    strain: np.ndarray,
) -> Messages:
    """Give all of it, as it is."""
    return Messages(stamp, q, dq, current.copy(), strain.copy(), np.ones(len(stamp), bool))


def spoil(sent: Messages, kind: str, seed: int, k: int) -> None:
    """Let something be wrong from a sample on."""
    gauge, joint = seed % sent.strain.shape[1], seed % sent.current.shape[1]
    if kind == 'encoder drifts':  # so slowly that commands do not tell
        rate = DRIFT * (1.0 + seed % 3) * (-1.0) ** (seed // 2)
        sent.q, sent.dq = sent.q.copy(), None
        sent.q[k:, joint] += rate * 1e-9 * (sent.stamp[k:] - sent.stamp[k])
    if kind == 'gauge leaps':
        sent.strain[k:, gauge] += 6.0 * sent.strain[:, gauge].std()
    elif kind == 'gauge stuck':
        sent.strain[k:, gauge] = sent.strain[k, gauge]
    elif kind == 'gap':
        random = np.random.default_rng([seed, 7])
        sent.kept[k:] = random.uniform(size=len(sent.q) - k) > 0.8
    elif kind == 'breakaway':  # what a joint that has stood needs to begin to move
        speed = np.gradient(sent.q[:, joint], 1e-9 * sent.stamp)
        still = np.abs(speed) < 0.02
        for start in np.flatnonzero(still[:-1] & ~still[1:]):
            if start > k and still[start - 30:start].all():
                way = np.sign(speed[min(start + 5, len(speed) - 1)])
                span = sent.current[start:start + 30, joint]
                span += 2.5 * sent.current[:, joint].std() * way * np.exp(
                    -np.arange(len(span)) / 12.0)


def write(arm: td.Arm, sent: Messages, out: Path, leaps_at: int | None = None) -> None:
    """Write a bag; where stamps of the strain leap, its messages come as always."""
    signals = [
        td.joint_signals('/joint_states', sent.stamp, arm.active_joints, sent.q,
                         sent.dq).at(sent.kept),
        td.joint_signals('/motor_currents', sent.stamp, arm.active_joints, effort=sent.current),
        td.joint_signals('/link_strains', sent.stamp, arm.gauge_names, sent.strain)]
    if leaps_at is None:
        td.write_bag(out, signals)
        return
    with TemporaryDirectory() as folder:
        td.write_bag(Path(folder, 'bag'), signals)
        raw = list(open_bag(Path(folder, 'bag')).read([item.topic for item in signals]).values())
    data = [item if i < leaps_at else item[:4] + struct.pack(
        '<iI', *divmod(time + round(LATE * 1e9), 10**9)) + item[12:]
        for i, (time, item) in enumerate(zip(raw[-1].log_time.tolist(), raw[-1].data,
                                             strict=True))]
    td.write_bag(out, [*raw[:-1], replace(raw[-1], data=data)])


def motion(arm: td.Arm, kind: str, seed: int, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Plan what the arm does: at rest, with stops, fast without damping, or as in the training."""
    limits, random = td.motion_limits(arm), np.random.default_rng(seed)
    planned = td.stimulus_motion(arm, SECONDS, seed, dt)
    if kind == 'touch at rest':
        q = np.tile(planned.q[len(planned.q) // 2], (len(planned.q), 1))
        return q, np.zeros_like(q)
    if kind in ('breakaway', 'fast'):
        low, high = planned.q.min(axis=0), planned.q.max(axis=0)
        times = [np.arange(2.0, SECONDS, 4.0 if kind == 'breakaway' else 1.0)] * len(low)
        if kind == 'fast':
            limits = replace(limits, velocity=1.5 * limits.velocity,
                             acceleration=3.0 * limits.acceleration)
        goals = [random.uniform(a, b, len(times[0])) for a, b in zip(low, high, strict=True)]
        found = td.follow_targets([g[0] for g in goals], times, goals, limits, dt,
                                  round(SECONDS / dt))
        return found.q, found.dq
    return planned.q, planned.dq


def simulated(arm: td.Arm, kind: str, seed: int, out: Path) -> None:
    """Simulate and write a bag in which something happens."""
    loop = td.ClosedLoop(td.with_payload(arm, 0.2) if kind == 'load' else arm,
                         damping=0.0 if kind == 'fast' else 1.0, seed=seed)
    q, dq = motion(arm, kind, seed, loop.dt)
    if kind == 'load':
        loop.set_payload(0.0)
    loop.reset(q[0])
    if MOVED.get(kind) == 'touch':
        way = np.random.default_rng([seed, 7]).choice((-1.0, 1.0))
        force, seconds, rise = (25.0 * way, 0.1, 0.002) if kind == 'blow' else (
            6.0 * way, 0.5, 0.05)
        loop.set_pushes([td.Push(AT, seconds, arm.active_joints[-1], 0.3, (force, 0.0, force),
                                 rise)])
    every, middle = round(1.0 / (RATE * loop.dt)), round(AT / loop.dt)
    first = loop.run(q[:middle], dq[:middle], every=every)
    if kind == 'load':
        loop.set_payload(0.2)
    second = loop.run(q[middle:], dq[middle:], every=every)
    t, *signals = (np.concatenate([getattr(part, name) for part in (first, second)])
                   for name in ('t', 'q', 'dq', 'current', 'strain'))
    sent = messages(np.round(t * 1e9).astype(np.int64) + 10**18, *signals)
    spoil(sent, kind, seed, round(AT * RATE))
    write(arm, sent, out, round(AT * RATE) if kind == 'clock' else None)


def explained(
    bag: Path, bundle: td.ModelBundle, rate: float = 1.0, kind: str = 'analytical',
) -> list[Cause]:
    """Explain what comes at so many false alarms an hour, by the residuals of a kind of model."""
    settings = MonitorSettings(kind, methods=(), rates=Rates(rate, 60.0 * rate), contact=True)
    return explain(open_bag(bag, quiet=True), bundle, settings, 'parameter', 0.0, [])


def row(kind: str, right: str, found: list[Cause]) -> tuple[str, ...]:
    """Count what was named."""
    named = Counter(cause.name for cause in found)
    for cause in found:
        seen = cause.event
        print(f'{kind}: {seen.time:.2f} s, {seen.channel} by {seen.event.method}, {seen.ratio:.2f}'
              f': {cause.name}: {cause.evidence}', file=sys.stderr, flush=True)
    return kind, f'{len(found)}', f'{named[right]}', ', '.join(
        f'{n} {name}' for name, n in named.most_common() if name != right) or '-'


def recorded(work: Path) -> Iterator[tuple[str, ...]]:
    """Spoil recordings of the real arm, and explain its pushes."""
    arm = td.load_arm(ROOT / 'config/two_blade_arm.yaml')
    names = [ROOT / f'bags/two_blade_{name}' for name in ('train_1', 'train_2', 'test')]
    bundle = td.fit(names[:2], arm, test=names[2],
                    settings=td.FitSettings(kinds=('analytical',)))
    whole = td.read_recording(names[2], arm)
    assert whole.effort is not None and whole.strain is not None
    for kind, right in SPOILED.items():
        found = []
        for seed in range(6):
            k = round((0.3 + 0.08 * seed) * len(whole.stamp))
            sent = messages(whole.stamp, whole.q, whole.dq, whole.effort, whole.strain)
            spoil(sent, kind, seed, k)
            bag = work / f'recorded_{kind.replace(" ", "_")}_{seed}'
            if not bag.exists():
                write(arm, sent, bag, k if kind == 'clock' else None)
            begun = (whole.stamp[k] - whole.stamp[0]) * 1e-9 - 0.05
            found += [cause for cause in explained(bag, bundle) if cause.event.time > begun][:1]
        yield row(kind, right, found)
    yield row('touch', 'touch', explained(ROOT / 'bags/two_blade_pushes', bundle))


def stiff(work: Path) -> Path:
    """Describe an arm with thicker blades, and drives with more friction."""
    spec = yaml.safe_load((ROOT / 'config/tudor.yaml').read_text())
    for link in spec['links']:
        if 'flexible' in link:
            link['flexible']['section']['height'] *= 1.5
    for motor in spec['motors']:
        motor['coulomb'] = (2.0 * np.array(motor['coulomb'])).tolist()
    spec['kinematics'] = {'urdf': str(ROOT / 'config' / spec['kinematics']['urdf'])} if (
        'urdf' in spec['kinematics']) else spec['kinematics']
    work.mkdir(parents=True, exist_ok=True)
    path = work / 'stiff.yaml'
    path.write_text(yaml.safe_dump({**spec, 'name': 'stiff'}))
    return path


def rows(args: argparse.Namespace) -> Iterator[tuple[str, ...]]:
    """Fit an arm in simulation, let it alarm, and explain the first event of each recording."""
    source = stiff(args.work) if args.stiff else ROOT / 'config/tudor.yaml'
    arm = td.load_arm(source)
    training = [args.work / f'{arm.name}_{k}' for k in range(3)]
    missing = [k for k, path in enumerate(training) if not path.exists()]
    if missing:
        td.record_stimuli(source, [td.StimulusSpec(
            0.0, 60.0, RATE, 1.0, 100 + k, 200 + k, 0) for k in missing],
            [training[k] for k in missing], 2)
    kinds = ('analytical', 'elastic')[:1 + args.elastic]
    model = args.work / f'{arm.name}_{kinds[-1]}'
    if not model.exists():
        td.fit(training[:2], arm, test=training[2], out=model,
               settings=td.FitSettings(kinds=kinds))
    bundle = td.load_bundle(model)
    for kind in args.only:
        found = []
        for seed in range(args.first, args.first + args.seeds):
            bag = args.work / f'{arm.name}_{kind.replace(" ", "_")}_{seed}'
            if not bag.exists():
                simulated(arm, kind, seed, bag)
            begun = 0.0 if kind in ('low', 'fast') else AT - 0.05
            found += [cause for cause in explained(
                bag, bundle, 3600.0 if kind == 'low' else 1.0, kinds[-1])
                      if cause.event.time > begun][:1]
        yield row(kind, (SPOILED | MOVED)[kind], found)


def main() -> None:
    """Print how often each cause was named."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--work', type=Path, required=True)
    parser.add_argument('--first', type=int, default=0)
    parser.add_argument('--seeds', type=int, default=3)
    parser.add_argument('--only', nargs='+', default=[*SPOILED, *MOVED])
    parser.add_argument('--stiff', action='store_true')
    parser.add_argument('--elastic', action='store_true')
    parser.add_argument('--recorded', action='store_true')
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    show(('what is done', 'events', 'named', 'otherwise named'),
         recorded(args.work) if args.recorded else rows(args))


if __name__ == '__main__':
    main()
