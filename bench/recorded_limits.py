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
Whether recordings of the simulated arm stay within its limits: extremes over many seeds.

The same motions as ``tudor record`` makes, judged at every step of the closed loop and not only at
the messages.
"""

from __future__ import annotations

import argparse

import numpy as np

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.arm.limits import hard_limits
from tudor_dynamics.mechanics.campaign import stimulus_motion, stimulus_seeds
from tudor_dynamics.mechanics.closed_loop import ClosedLoop
from tudor_dynamics.mechanics.hardware import with_payload


def main() -> int:
    """Print the extremes of each payload, and whether all are within the limits."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--arm', default='config/tudor.yaml', metavar='YAML')
    parser.add_argument('--payloads', type=float, nargs='+', default=[0.0, 0.4], metavar='KG')
    parser.add_argument('--seeds', type=int, default=20, metavar='N')
    parser.add_argument('--seconds', type=float, default=80.0, metavar='S')
    args = parser.parse_args()
    arm = load_arm(args.arm)
    limits = hard_limits(arm)
    names = ' '.join(arm.active_joints)
    print(f'joints {names}: limits {np.degrees(limits.lower).round(1)} .. '
          f'{np.degrees(limits.upper).round(1)} deg,\n'
          f'{np.degrees(limits.velocity).round(1)} deg/s, commands '
          f'{np.degrees(limits.acceleration).round(0)} deg/s^2')
    kept = True
    for payload in args.payloads:
        loop = ClosedLoop(with_payload(arm, payload))
        rows = []
        for seed in range(args.seeds):
            motion, noise, _ = stimulus_seeds(seed, 0)
            reference = stimulus_motion(arm, args.seconds, motion, loop.dt)
            loop._seed = noise
            loop.reset(reference.q[0])
            seen = loop.run(reference.q, reference.dq)
            rows.append((seen.q.min(axis=0), seen.q.max(axis=0),
                         np.abs(seen.dq).max(axis=0)))
        low, high, fast = (np.array(column) for column in zip(*rows, strict=True))
        inside = bool((low >= limits.lower).all() and (high <= limits.upper).all()
                      and (fast <= limits.velocity).all())
        kept = kept and inside
        print(f'{1000 * payload:3.0f} g, {args.seeds} seeds of {args.seconds:g} s: '
              f'{np.degrees(low.min(axis=0)).round(1)} .. {np.degrees(high.max(axis=0)).round(1)} '
              f'deg, at most {np.degrees(fast.max(axis=0)).round(1)} deg/s: '
              f'{"within" if inside else "BEYOND"}')
    return 0 if kept else 1


if __name__ == '__main__':
    raise SystemExit(main())
