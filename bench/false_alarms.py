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
How many false alarms come, beside how many were asked for; some minutes.

The simulated arm moves freely for 40 minutes, none of which anything was learned from. Models come
from five recordings (the elastic one from two), thresholds from three or five others; pushes are
looked for with the same thresholds. Recordings are kept in --work.

With --leave-motions-out DATA recordings of real arms take its place: each motion of an arm is left
out in turn, models and thresholds come from the others, and every event is a false alarm. For each
arm and method the exact 90 % interval of what came has to hold the rate that was promised.

    python bench/false_alarms.py --work DIR
    python bench/false_alarms.py --leave-motions-out DATA [--only ur10 two_blade]
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
import sys
import warnings

from elastic_study import bags, record
from tables import PUSHES, pushes, show

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.errors import TudorWarning
from tudor_dynamics.identification.dataset import load, parse_choice
from tudor_dynamics.identification.detection import (
    evaluate_collisions, find_truth, FREE as UNTOUCHED, score)
from tudor_dynamics.identification.fit import fit_models, FitSettings
from tudor_dynamics.identification.uses import as_plain, learn_all
from tudor_dynamics.library import fit_choices
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.online.detector import Rates
from tudor_dynamics.online.monitor import MonitorSettings

TRAINING, LEARNING, FREE, PUSHED = 5, 5, 30, 8
PAYLOAD = 0.2


CONFIG = Path(__file__).resolve().parents[1] / 'config'
# Arm, its description (in DATA, or one of the repository), and its motions; those that carry
# something name the mass [kg]: half of such a motion is learned from, as nothing else knows it.
ARMS = {
    'two_blade': (CONFIG / 'two_blade_arm.yaml', [f'arm_200g_free_{i}' for i in (1, 2, 3, 4)], {}),
    'ur10': (CONFIG / 'ur10.yaml', [f'ur10_exciting@{part}' for part in (
        '0-33%', '33-67%', '67-100%')], {}),
    'ur10e': ('arms/ur10e.yaml', ['ur10e_unloaded', 'ur10e_loaded'],
              {'ur10e_unloaded': 0.0, 'ur10e_loaded': 2.805}),
    'airbot': ('arms/airbot.yaml', ['airbot_chirp', 'airbot_trapezoidal'], {})}


def leave_motions_out(data, only):
    """Print the events of each arm and method; give how many promises were broken."""
    broken, rows = 0, []
    for name, (description, motions, masses) in ARMS.items():
        if only and name not in only:
            continue
        arm, found = load_arm(data / description), {}
        for left in motions:
            known, test = [motion for motion in motions if motion != left], left
            if masses:
                known, test = [*known, f'{left}@0-50%'], f'{left}@50-100%'
            choices = [parse_choice(str(data / 'bags' / motion)) for motion in (*known, test)]
            payloads = {str((data / 'bags' / motion).resolve()): mass
                        for motion, mass in masses.items()}
            bundle = fit_choices(arm, choices[:-1], [], arm.spec.preprocessing, FitSettings(),
                                 payloads).bundle.at(masses.get(left, 0.0))
            bag = load(choices[-1], arm, bundle.beside_robot().preprocessing, whole=True)
            for item in evaluate_collisions(bundle, [(left, bag.recording)], MonitorSettings(),
                                            [UNTOUCHED]):
                found.setdefault(item.method, []).extend(item.watched)
                print(f'  {name} {left} {item.method}: {item.score.false_alarms} events, largest '
                      f'ratio {item.watched[0].ratio.max():.2f}', flush=True)
        for method, watched in found.items():
            of_all = score(watched)
            kept = of_all.kept(1.0)
            broken += not kept['low'] <= 1.0 <= kept['high']
            rows.append((name, method, of_all.false_alarms, f'{60 * of_all.hours:.1f} min',
                         f'{kept["promised"]:.4f}',
                         f'{kept["low"]:.1f} to {kept["high"]:.0f} times the promise'))
    show(('arm', 'method', 'events', 'in', 'promised', '90 % interval'), rows)
    if not only:
        by_hand(data)
    return broken


def by_hand(data):
    """Print which pushes by hand on a standing arm are detected; models are of another bag."""
    arm = load_arm(data / 'arms/ur10e.yaml')
    bundle = fit_choices(arm, [parse_choice(str(data / 'bags/ur10e_unloaded'))], [],
                         arm.spec.preprocessing, FitSettings(), {}).bundle
    path = str(data / 'bags/ur10e_pushes')
    bag = load(parse_choice(path), arm, bundle.beside_robot().preprocessing, whole=True)
    show(('at rest', 'method', *PUSHES), (
        ('UR10e, four pushes by hand', item.method, *pushes(item.score.as_dict()))
        for item in evaluate_collisions(bundle, [(path, bag.recording)], MonitorSettings(),
                                        [find_truth(path)])))


def main():
    """Record, fit, count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--arm', type=Path, default=Path('config/tudor.yaml'))
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument('--work', type=Path, help='directory for recordings')
    where.add_argument('--leave-motions-out', type=Path, metavar='DATA',
                       help='recordings of real arms in place of a simulated one')
    parser.add_argument('--only', nargs='+', choices=tuple(ARMS), help='arms of DATA')
    parser.add_argument('--kinds', nargs='+', default=['analytical', 'elastic'])
    parser.set_defaults(seconds=80.0)
    args = parser.parse_args()
    warnings.simplefilter('ignore', TudorWarning)
    if args.leave_motions_out:
        sys.exit(bool(leave_motions_out(args.leave_motions_out, args.only)))
    args.work.mkdir(parents=True, exist_ok=True)
    arm = load_arm(args.arm)
    free = bags(arm, record(args, PAYLOAD, damped=True, seed=7,
                            stimuli=TRAINING + LEARNING + FREE))
    pushed = bags(arm, record(args, PAYLOAD, damped=True, seed=8, stimuli=PUSHED, pushes=6))
    spec, models = arm.spec.preprocessing, {}
    learning, unseen = free[TRAINING:TRAINING + LEARNING], free[TRAINING + LEARNING:]
    for kind in args.kinds:
        known = free[:2] if kind == 'elastic' else free[:TRAINING]
        for item in fit_models(arm, known, learning[:1], None, spec,
                               FitSettings(kinds=(kind,))).fitted:
            models.setdefault(item.output, {})[kind] = item.model
    for count in (3, LEARNING):
        bundle = ModelBundle(arm, spec, models, {'thresholds': as_plain(learn_all(
            [(output, kind, [(model, bag) for bag in learning[:count]])
             for output, known in models.items() for kind, model in known.items()], spec)[0])})
        for kind in args.kinds:
            for asked in (1.0, 10.0) if count == LEARNING else (1.0,):
                settings = replace(MonitorSettings(kind=kind), rates=Rates(asked, 60.0 * asked))
                seen = [evaluate_collisions(
                    bundle, [(str(bag.choice), bag.recording) for bag in some], settings,
                    [UNTOUCHED if some is unseen else find_truth(str(bag.choice)) for bag in some])
                        for some in (unseen, pushed)]
                for quiet, push in zip(*seen, strict=True):
                    a, b = quiet.score, push.score
                    print(f'thresholds from {80 * count} s, {kind:10} {quiet.method:8} asked '
                          f'{asked:2g}/h: {a.false_alarms:2d} in {60 * a.hours:.0f} min; found '
                          f'{b.found} of {b.pushes} pushes, after '
                          f'{1000 * (b.latency_median or 0.0):.0f} ms (median)', flush=True)


if __name__ == '__main__':
    main()
