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

    python bench/false_alarms.py --work DIR
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
import warnings

from elastic_study import bags, record

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.errors import TudorWarning
from tudor_dynamics.identification.detection import (
    evaluate_collisions, find_truth, FREE as UNTOUCHED)
from tudor_dynamics.identification.fit import fit_models, FitSettings
from tudor_dynamics.identification.uses import as_plain, learn_all
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.online.detector import Rates
from tudor_dynamics.online.monitor import MonitorSettings

TRAINING, LEARNING, FREE, PUSHED = 5, 5, 30, 8
PAYLOAD = 0.2


def main():
    """Record, fit, count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--arm', type=Path, default=Path('config/tudor.yaml'))
    parser.add_argument('--work', type=Path, required=True, help='directory for recordings')
    parser.add_argument('--kinds', nargs='+', default=['analytical', 'elastic'])
    parser.set_defaults(seconds=80.0)
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter('ignore', TudorWarning)
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
