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
Soft hits: how late each is told, with the accumulated statistic and without; some minutes.

Half-sines of several lengths are added to measured strain or effort of recorded free motion, on
all channels of the output, as large as the usual threshold of the residual times --sizes.
Thresholds come from other recordings, for one false alarm per hour. The recordings themselves
count for false alarms. DATA is that of ``reference_fits.py``; without it the bags are taken that
come along.

    python bench/soft_hits.py --data DATA
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
import sys
import tempfile
import warnings

import numpy as np

import tudor_dynamics as td
from tudor_dynamics.errors import TudorWarning
from tudor_dynamics.identification.dataset import load, parse_choice
from tudor_dynamics.identification.detection import evaluate_collisions, FREE, KnownPush, Truth
from tudor_dynamics.identification.fit import FitSettings
from tudor_dynamics.online.monitor import MonitorSettings

ROOT = Path(__file__).resolve().parent.parent
LENGTHS = (0.3, 0.6, 1.2, 2.4)  # s
PERIOD = 8.0  # s, one hit in each


def cases(data: Path | None, folder: Path):
    """Give name, arm, training bags and test bag of what is there."""
    own, two = ROOT / 'bags', ROOT / 'config/two_blade_arm.yaml'
    if data is None:
        return [('two-blade arm', two, [own / 'two_blade_train_1', own / 'two_blade_train_2'],
                 own / 'two_blade_test')]
    bags = data / 'bags'
    found = [('two-blade arm, 200 g', two, [bags / f'arm_200g_free_{i}' for i in (1, 2, 3)],
              bags / 'arm_200g_free_4'),
             ('two-blade arm, not damped', two, [f'{bags}/arm_000g_undamped_1@0-50%'],
              f'{bags}/arm_000g_undamped_1@50-100%')]
    if (data / 'merit_exp1.csv').exists():
        sys.path.insert(0, str(ROOT))
        from papers.merit import main as import_merit
        import_merit([str(data / 'merit_exp1.csv'), '--out', str(folder / 'merit')])
        found.append(('MERIt', ROOT / 'config/tudor.yaml', [f'{folder}/merit@0-50%'],
                      f'{folder}/merit@50-100%'))
    if (bags / 'ur10e_unloaded').exists():
        found.append(('UR10e', data / 'arms/ur10e.yaml', [f'{bags}/ur10e_unloaded@0-60%'],
                      f'{bags}/ur10e_unloaded@60-100%'))
    return found


def usual_threshold(bundle, bag, output, kind='analytical'):
    """Give the median threshold of the residual of each channel along a bag."""
    from tudor_dynamics.online.monitor import Monitor
    monitor = Monitor(bundle, MonitorSettings(kind=kind, methods=(output,)))
    seen = []
    for k, stamp in enumerate(bag.recording.stamp.tolist()):
        dq = bag.recording.dq
        monitor.add_joints(stamp, bag.recording.q[k], None if dq is None else dq[k])
        found = monitor.add_measured(output, stamp, getattr(bag.recording, output)[k])
        seen += [excess.threshold for _, excess in found.excesses]
    return np.median(seen, axis=0)


def hit(recording, output, length, size, seed):
    """Add a hit in each period; gives recording and truth."""
    rng = np.random.default_rng(seed)
    values, t, pushes = getattr(recording, output).copy(), recording.t, []
    for begin in np.arange(2.0, t[-1] - length - 3.0, PERIOD):
        at = begin + rng.uniform(0.0, max(PERIOD - length - 3.0, 0.1))
        inside = (t >= at) & (t < at + length)
        if not inside.any():
            continue
        values[inside] += rng.choice([-1.0, 1.0]) * size * np.sin(
            np.pi * (t[inside] - at) / length)[:, None]
        stamps = recording.stamp[inside]
        pushes.append(KnownPush(int(stamps[0]), int(stamps[-1])))
    return replace(recording, **{output: values}), Truth('added', tuple(pushes))


def without(bundle):
    """Give the bundle without the accumulated statistic, as older ones are."""
    old = {method: {kind: {**content, 'tails': content['tails'][:2 * len(content['channels'])]}
                    for kind, content in kinds.items()}
           for method, kinds in bundle.facts['thresholds'].items()}
    return replace(bundle, facts={**bundle.facts, 'thresholds': old})


def main():
    """Go through recordings, outputs, lengths and sizes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--data', type=Path)
    parser.add_argument('--sizes', type=float, nargs='+', default=[0.6, 1.0, 1.5])
    args = parser.parse_args()
    warnings.simplefilter('ignore', TudorWarning)
    with tempfile.TemporaryDirectory() as folder:
        for name, arm, training, test in cases(args.data, Path(folder)):
            bundle = td.fit([str(bag) for bag in training], td.load_arm(str(arm)),
                            settings=FitSettings(kinds=('analytical',)))
            bag = load(parse_choice(str(test)), bundle.arm, bundle.preprocessing)
            for output in bundle.models:
                settings = MonitorSettings(methods=(output,))
                usual = usual_threshold(bundle, bag, output)
                for which, model in (('without', without(bundle)), ('with', bundle)):
                    free, = [item for item in evaluate_collisions(
                        model, [(name, bag.recording)], settings, [FREE])
                        if item.method == output]
                    print(f'{name}, {output}, {which}: {free.score.false_alarms} false in '
                          f'{60 * free.score.hours:.1f} min, largest ratio '
                          f'{free.watched[0].ratio.max():.2f}', flush=True)
                for length in LENGTHS:
                    for size in args.sizes:
                        line = [f'  {length:.1f} s, {size:.1f} times:']
                        for model in (without(bundle), bundle):
                            made = [hit(bag.recording, output, length, size * usual, seed)
                                    for seed in (1, 2)]
                            found, = [item for item in evaluate_collisions(
                                model, [(name, part) for part, _ in made], settings,
                                [truth for _, truth in made]) if item.method == output]
                            late = found.score.latency_median
                            line.append(f'{found.score.found:2d} of {found.score.pushes}'
                                        + (' -' if late is None else f', {1e3 * late:4.0f} ms'))
                        print(' | '.join(line), flush=True)


if __name__ == '__main__':
    main()
