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
Faults that are found where there are none: hours of free motion, and recordings.

The simulated arm wanders with no payload, 0.2 and 0.4 kg, damped and undamped, at several rates,
with all its noise and play, a delay of up to 20 ms and 5 % of all messages lost. Then the bags of
the two-blade arm, and those of a UR10 and a UR10e where --data names them, go sample by sample
through the judgement of motion; commanded is then what the driver says of its speeds, or what
positions became, where it says nothing. Every fault is printed; exit 1 where there is any.
"""

from __future__ import annotations

import argparse
from itertools import cycle, islice, product
import os
from pathlib import Path
import time

import numpy as np
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.arm.limits import effort_limits, hard_limits
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.control.cascade import Commanded
from tudor_dynamics.control.motion_controller import State
from tudor_dynamics.control.plausibility import MotionWatch
from tudor_dynamics.mechanics.rig import Rig, RigLog

ROOT = Path(__file__).parent.parent
PART = 300.0  # simulated in one piece [s]
DWELLS = 3.0  # standstill before it wanders [s]
LAGS = (0.0, 0.03)  # from a command to its motion, in recordings [s]


def wander(rate: float, payload: float, share: float, seed: int, seconds: float) -> list[str]:
    """Let the arm wander; give its faults, each with its time."""
    random = np.random.default_rng(seed)
    delay = random.uniform(0.0, 0.02)
    rig = Rig(load_arm(ROOT / 'config/tudor.yaml'), rate=rate, payload=payload, share=share,
              delay=delay, loss=0.05, seed=seed)
    found, what = [], (f'{rate:g} Hz, {payload:g} kg, damping {share:g}, delay {1e3 * delay:.0f} '
                       f'ms, seed {seed}')
    assert rig.source is not None and rig.controller is not None
    begun = False
    while rig.t < seconds:
        if not begun and rig.t >= DWELLS:
            rig.source.wander(seed)
            begun = True
        rig.step()
        if rig.controller.state is State.FAULT:
            found.append(f'{what}: at {rig.t:.2f} s: {rig.controller.cause}')
            rig.run(2.0)
            rig.start_controller()
            rig.start_source()
            begun = False
            rig.run(0.5)
        if len(rig.trace.t) > 1000:
            rig.trace = RigLog()  # of no use here, and it grows
    if rig.process.failure:
        found.append(f'{what}: {rig.process.failure}')
    return found


def replay(bag: Path, description: Path) -> list[str]:
    """Let a recording be judged as the controller judges its arm; give what is not believed."""
    arm = load_arm(description)
    recording, found = read_recording(bag, arm), []
    for part in recording.segments:
        t, q = recording.t[part], recording.q[part]
        dq = None if recording.dq is None else recording.dq[part]
        effort = None if recording.effort is None else recording.effort[part]
        commands = np.gradient(q, t, axis=0) if dq is None else dq
        units = {name: arm.position_units[name] for name in arm.active_joints}
        watch = MotionWatch(units, hard_limits(arm), effort_limits(arm))
        commanded = Commanded(len(arm.active_joints))
        watch.trust(np.full(len(arm.active_joints), np.inf))  # it is no start that moves
        for k in range(len(t)):
            doubts = watch.step(
                float(t[k]), float(t[k] - t[k - 1]) if k else 0.0, q[k], commanded, LAGS,
                dq=None if dq is None else dq[k], effort=None if effort is None else effort[k])
            found += [f'{bag.name}: at {t[k]:.2f} s: {doubt.text}' for doubt in doubts]
            commanded.add(float(t[k]), commands[k])
            if doubts:
                watch.reset()
    return found


def recordings(data: Path | None) -> list[tuple[Path, Path]]:
    """Give bags with the descriptions of their arms."""
    own = [(path, ROOT / 'config/two_blade_arm.yaml')
           for path in sorted((ROOT / 'bags').glob('two_blade_*'))]
    if data is None:
        return own
    return [*own, (data / 'bags/ur10_exciting', ROOT / 'config/ur10.yaml'),
            *((data / f'bags/ur10e_{name}', data / 'arms/ur10e.yaml')
              for name in ('unloaded', 'loaded', 'pushes'))]


def main() -> int:
    """Let the arm wander for hours, and print the faults."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--hours', type=float, default=2.0, metavar='H')
    parser.add_argument('--rates', type=float, nargs='+', default=[100.0, 250.0, 500.0],
                        metavar='HZ')
    parser.add_argument('--seed', type=int, default=0, metavar='N')
    parser.add_argument('--data', type=Path, default=os.environ.get('TUDOR_SHARED_DATA'),
                        metavar='DIR', help='folder of recordings of real arms')
    args = parser.parse_args()
    begun, found = time.perf_counter(), []
    parts = int(np.ceil(3600.0 * args.hours / PART))
    seconds = 3600.0 * args.hours / max(parts, 1)
    every = cycle(product((0.0, 0.2, 0.4), (1.0, 0.0)))
    for k, (payload, share) in enumerate(islice(every, parts)):
        # the rate changes with each round through payloads and damping, too
        rate = args.rates[(k + k // 6) % len(args.rates)]
        faults = wander(rate, payload, share, 1000 * args.seed + k, seconds)
        print(*faults, sep='\n', end='\n' if faults else '', flush=True)
        found += faults
    print(f'{args.hours:g} h of simulated free motion in {time.perf_counter() - begun:.0f} s: '
          f'{len(found)} faults')
    for bag, description in recordings(None if args.data is None else Path(args.data)):
        faults = replay(bag, description)
        print(f'{bag.name}: {len(faults)} faults', *faults[:5], sep='\n  ', flush=True)
        found += faults
    return bool(found)


if __name__ == '__main__':
    raise SystemExit(main())
