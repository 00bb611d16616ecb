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
False alarms and pushes found as the nodes over topics have them, in lock-step simulated time.

Simulator, reference of random targets and damper, the objects that their nodes hold, run sample
after sample; commands are held for a sample. What the sensors say goes to the monitor in the order
in which `arm_simulator` publishes it, and the monitor is that of the node. Model and thresholds
come from three bags of `tudor record` (made in --work) or from --model. Signals are kept in --work
and used again, so that a change of the monitor alone is judged quickly.

    python bench/detection_over_topics.py --work DIR --rates 100 --seeds 1 --minutes 30
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, fields
import json
from pathlib import Path
import subprocess
import sys
from typing import Any

import numpy as np
import pinocchio as pin
from tables import show

from tudor_dynamics.arm.description import Arm, load_arm
from tudor_dynamics.arm.kinematics import joint_axis
from tudor_dynamics.mechanics.closed_loop import Sample
from tudor_dynamics.mechanics.rig import Rig, RigLog
from tudor_dynamics.mechanics.run import FIRST_STAMP
from tudor_dynamics.models.bundle import load_bundle, ModelBundle
from tudor_dynamics.online.detector import Level
from tudor_dynamics.online.monitor import Monitor, MonitorSettings
from tudor_dynamics.typing import FloatArray

PAYLOAD = 0.2  # kg
FIRST = 6.0  # s before the first push: the damper has found its mean
SLOT = 8.0  # s, one push in each
FORCE = (3.0, 5.0)  # N
DURATION = (0.3, 0.8)  # s
LATE = 0.3  # s after the end of a push an event still finds it


@dataclass(frozen=True, eq=False)
class Signals:
    """What the sensors said, a row a sample; times of pushes [s] (begin, end, force [N])."""

    t: FloatArray
    q: FloatArray
    dq: FloatArray
    current: FloatArray
    strain: FloatArray
    pushes: FloatArray


def drive(
    arm: Arm, rate: float, seed: int, seconds: float, pushes: int = 0, rise: float = 0.0,
) -> Signals:
    """Let the arm wander, and push it across its last link now and then, at once or rising."""
    rig = Rig(arm, rate=rate, payload=PAYLOAD, seed=seed)
    rig.start_source('none')
    assert rig.source is not None
    rig.source.wander(seed)
    seen: list[Sample] = []

    def take(sample: Sample) -> Sample:
        seen.append(sample)
        return sample

    rig.alter = take
    random = np.random.default_rng([seed, round(rate)])
    told = []
    for k in range(pushes):
        begin = FIRST + k * SLOT + random.uniform(0.0, SLOT - DURATION[1] - 4.0)
        told.append((begin, begin + random.uniform(*DURATION), random.uniform(*FORCE)))
    left, along = list(told), np.zeros(3)
    for _ in range(round(seconds * rate)):
        if left and rig.t >= left[0][0]:
            begin, end, force = left[0]
            if not rig.process.force.any():
                along = across(arm, seen[-1].q) * random.choice((-1.0, 1.0))
            near = min(rig.t - begin, end - rig.t) + 0.5 / rate
            share = min(near / rise, 1.0) if rise > 0.0 else 1.0
            rig.process.force = force * along * np.sin(0.5 * np.pi * share) ** 2
            if rig.t >= end:
                rig.process.force = np.zeros(3)
                left.pop(0)
        rig.step()
        if len(rig.trace.t) > 1000:
            rig.trace = RigLog()  # of no use here, and it grows
    if rig.process.failure:
        raise SystemExit(rig.process.failure)
    return Signals(np.array([s.t for s in seen]), np.array([s.q for s in seen]),
                   np.array([s.dq for s in seen]), np.array([s.current for s in seen]),
                   np.array([s.strain for s in seen]), np.array(told).reshape(-1, 3))


def across(arm: Arm, q: FloatArray) -> FloatArray:
    """Give the direction in which the tip moves when the last joint turns."""
    model = arm.model
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    place = data.oMi[model.getJointId(arm.active_joints[-1])]
    axis = place.rotation @ joint_axis(model, arm.active_joints[-1])
    way = np.cross(axis, place.rotation @ np.array([1.0, 0.0, 0.0]))
    return np.asarray(way / np.linalg.norm(way))


def kept(args: argparse.Namespace, arm: Arm, rate: float, seed: int, pushed: bool) -> Signals:
    """Give signals that are there already, or drive."""
    seconds = FIRST + SLOT * args.pushes if pushed else 60.0 * args.minutes
    path = args.work / (f'signals_{arm.digest[:8]}_{rate:g}_{seed}_{seconds:g}'
                        f'{f"_pushed{1e3 * args.rise:g}" if pushed else ""}.npz')
    if not path.exists():
        found = drive(arm, rate, seed, seconds, args.pushes if pushed else 0, args.rise)
        np.savez(path, **{f.name: getattr(found, f.name) for f in fields(Signals)})
    with np.load(path) as stored:
        return Signals(**{f.name: stored[f.name] for f in fields(Signals)})


def watch(bundle: ModelBundle, settings: MonitorSettings, signals: Signals) -> dict[str, Any]:
    """Give times of events with their methods, and times in which the flag stood [s]."""
    monitor = Monitor(bundle, settings)
    outputs = [(output, getattr(signals, 'current' if output == 'effort' else output))
               for output in monitor.watch.outputs]
    events, flags = [], []
    since = None
    for k, t in enumerate(signals.t.tolist()):
        stamp = FIRST_STAMP + round(t * 1e9)
        # in the order of arm_simulator's messages
        found = [monitor.add_measured(output, stamp, values[k]) for output, values in outputs]
        found.append(monitor.add_joints(stamp, signals.q[k], signals.dq[k]))
        events += [((event.stamp - FIRST_STAMP) * 1e-9, event.method)
                   for item in found for event in item.events]
        up = monitor.watch.level is Level.COLLISION
        if up and since is None:
            since = t
        elif not up and since is not None:
            flags.append((since, t))
            since = None
    if since is not None:
        flags.append((since, float(signals.t[-1])))
    return {'events': events, 'flags': flags}


def judge_pushes(seen: dict[str, Any], pushes: FloatArray) -> dict[str, Any]:
    """Say which pushes were found, how soon, and how soon their flags went [s]."""
    times = np.array([t for t, _ in seen['events']])
    latencies, released, near = [], [], np.zeros(len(times), dtype=bool)
    for begin, end, _ in pushes.tolist():
        hits = times[(times >= begin) & (times <= end + LATE)]
        latencies += [float(hits[0] - begin)] if len(hits) else []
        near |= (times >= begin) & (times <= end + 2.0)
        released += [max(off - end, 0.0) for on, off in seen['flags']
                     if begin <= on <= end + LATE]
    return {'pushes': len(pushes), 'latencies': latencies, 'others': int(np.sum(~near)),
            'released': released}


def cells(found: list[dict[str, Any]], minutes: float) -> tuple[str, ...]:
    """Give the cells of a table for what the seeds came to."""
    late, released = (np.array([value for row in found for value in row[key]] or [np.nan])
                      for key in ('latencies', 'released'))
    return (f'{sum(len(row["events"]) for row in found)} in {minutes * len(found):g} min',
            f'{sum(len(row["latencies"]) for row in found)} of '
            f'{sum(row["pushes"] for row in found)}',
            *(f'{1e3 * np.quantile(late, part):.0f} ms' for part in (0.5, 0.95)),
            f'{np.median(released):.2f} s, {released.max():.2f} s')


def make_model(args: argparse.Namespace) -> Path:
    """Record and fit as the documents say, unless that was done."""
    model = args.work / 'model'
    tudor = [sys.executable, '-m', 'tudor_dynamics']
    if not model.exists():
        out = args.work / 'bags'
        if not out.exists():
            subprocess.run([*tudor, 'record', '--arm', str(args.arm), '--payload', str(PAYLOAD),
                            '--stimuli', '3', '--jobs', '1', '--out', str(out)], check=True,
                           stdout=subprocess.DEVNULL)
        subprocess.run([*tudor, 'fit', *(str(out / f'stimulus_0{k}') for k in (1, 2, 3)), '--arm',
                        str(args.arm), '--models', 'analytical', 'elastic', '--out', str(model)],
                       check=True, stdout=subprocess.DEVNULL)
    return Path(model)


def main() -> None:
    """Print a line for each kind of model, rate and seed, then the table over seeds."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--arm', type=Path, default=Path('config/tudor.yaml'))
    parser.add_argument('--work', type=Path, required=True, help='directory for what is kept')
    parser.add_argument('--model', type=Path, help='bundle; by default of three bags made here')
    parser.add_argument('--kinds', nargs='+', default=['elastic', 'analytical'])
    parser.add_argument('--methods', nargs='+', default=[], help='by default all of the model')
    parser.add_argument('--rates', nargs='+', type=float, default=[100.0, 200.0, 500.0])
    parser.add_argument('--seeds', nargs='+', type=int, default=[1, 2, 3])
    parser.add_argument('--minutes', type=float, default=30.0, help='of free motion')
    parser.add_argument('--pushes', type=int, default=48)
    parser.add_argument('--rise', type=float, default=0.0,
                        help='time in which a push comes and goes [s]; none on external_wrench')
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    arm = load_arm(args.arm)
    bundle = load_bundle(args.model or make_model(args))
    rows = []
    for rate in args.rates:
        for kind in args.kinds:
            settings, found = MonitorSettings(kind=kind, methods=tuple(args.methods)), []
            for seed in args.seeds:
                row: dict[str, Any] = {'seed': seed, 'events': [], 'pushes': 0, 'latencies': [],
                                       'released': []}
                if args.minutes > 0.0:
                    seen = watch(bundle, settings, kept(args, arm, rate, seed, False))
                    row['events'] = [(round(t, 2), method) for t, method in seen['events']]
                if args.pushes:
                    signals = kept(args, arm, rate, seed, True)
                    row |= judge_pushes(watch(bundle, settings, signals), signals.pushes)
                print(json.dumps(row), flush=True)
                found.append(row)
            rows.append((f'{rate:g} Hz', kind, *cells(found, args.minutes)))
    show(('rate', 'model', 'events in free motion', 'pushes found', 'median', '95 %',
          'flag after the push, median and last'), rows)


if __name__ == '__main__':
    main()
