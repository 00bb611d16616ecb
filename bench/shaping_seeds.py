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
What refining shaped moves by the simulated model brings, on moves it was not developed with.

Run with ``OMP_NUM_THREADS=1 python bench/shaping_seeds.py --work DIR``, DIR that of
``python -m papers outlook --only shaping --out DIR``. Moves anywhere, twelve of each seed, on the
arm with all its imperfections; the residual strain that is left of the unshaped moves' [%] by the
modes alone and refined, with the payload as it is and told wrong by ``--error`` in turn upwards
and downwards, what the simulation itself leaves of a refined move, and the processor's time that
one is planned in [s].
"""

from __future__ import annotations

import argparse
from pathlib import Path
import sys
import time

import numpy as np

import tudor_dynamics as td
from tudor_dynamics.control.shaped_motion import Shaping
from tudor_dynamics.models.tuning import MoveRefiner, TunedArm
from tudor_dynamics.typing import FloatArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from papers.__main__ import default_arm  # noqa: E402, I100
from papers.campaign import Campaign, Plan, ResultCache  # noqa: E402
from papers.outlook import Setting  # noqa: E402
from papers.shaping import (  # noqa: E402
    AFTER, BEFORE, draw_ends, LOUD, MOVES, reference, run)
from papers.tuned import schedule_of, tuned_arm  # noqa: E402

EVERY = 5
"""Of the reference's samples, for the simulation."""


def simulated(
    tuned: TunedArm, payload: float, q: FloatArray, length: float, period: float,
) -> float:
    """Give what a move leaves in the simulation that it was refined with [um/m]."""
    assert tuned.arm.spec.damper is not None
    dt = EVERY / tuned.arm.spec.damper.rate
    strain = 1e6 * tuned.strains(payload, q[None, ::EVERY], dt)[0, :, 0]
    t = dt * np.arange(len(strain)) - BEFORE - length - AFTER
    return float(0.5 * np.ptp(strain[(t > 0.0) & (t < period)]))


def trial(
    tuned: TunedArm, schedule: td.Schedule, refiner: MoveRefiner, seed: int, error: float,
) -> tuple[FloatArray, list[float]]:
    """Give what is left by the modes, refined, and of that simulated [%], and times [s]."""
    arm, random = tuned.arm, np.random.default_rng(seed)
    payloads, total, seconds = schedule.payload.tolist(), np.zeros(4), []
    for number in range(MOVES):
        ends = draw_ends(arm, random, sided=False)
        payload = payloads[-1 - number % len(payloads)]
        told = payload + (error if number % 2 else -error)
        if not payloads[0] <= told <= payloads[-1]:
            told = payload - (told - payload)
        period = 1.0 / schedule.at(payload, ends[1]).modes[0].frequency
        left = []
        for kind, refine in (('none', None), ('elastic', None), ('elastic', refiner)):
            begun = time.process_time()
            q, dq, length = reference(
                arm, Shaping(kind, schedule, payload=told, refine=refine), ends, period)
            seconds.append(time.process_time() - begun)
            left.append(run(arm, payload, q, dq, length, period, number)[2])
        left.append(simulated(tuned, told, q, length, period))
        if left[0] > LOUD:
            total += left
    return 100.0 * total[1:] / total[0], seconds[2::3]


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--work', type=Path, required=True, help='directory of the outlook')
    parser.add_argument('--seeds', type=int, nargs='+', default=[11, 23, 47])
    parser.add_argument('--error', type=float, default=0.05, help='of the payload [kg]')
    options = parser.parse_args()
    setting = Setting('shaping', Campaign(Plan(str(default_arm())), ResultCache(options.work)))
    tuned = tuned_arm(setting)
    schedule, refiner = schedule_of(setting, tuned)[0], MoveRefiner(tuned)
    print(f'{"seed":>5} {"payload":>9} {"modes":>7} {"refined":>8} {"simulated":>10} '
          f'{"median":>7} {"longest":>8}')
    for seed in options.seeds:
        for error in (0.0, options.error):
            left, seconds = trial(tuned, schedule, refiner, seed, error)
            what = f'+-{1000.0 * error:.0f} g' if error else 'known'
            print(f'{seed:5d} {what:>9} {left[0]:7.1f} {left[1]:8.1f} {left[2]:10.1f} '
                  f'{np.median(seconds):7.2f} {max(seconds):8.2f}', flush=True)


if __name__ == '__main__':
    main()
