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
The elastic model on recordings of the simulated arm: all payloads, known truth, collisions.

One model is fitted to recordings at 0 and 400 g, damped and undamped, and tested on other stimuli
at all payloads; its parameters are compared with those of the simulation; collisions are looked
for in recordings with pushes. Recordings are kept in --work.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import subprocess
import sys
import time
import warnings

import numpy as np
from tables import PUSHES, pushes, show

from tudor_dynamics.arm.description import Arm, load_arm
from tudor_dynamics.errors import TudorWarning
from tudor_dynamics.identification.dataset import BagData, load, model_for, parse_choice
from tudor_dynamics.identification.detection import evaluate_collisions, find_truth
from tudor_dynamics.identification.fit import fit_models, FitSettings
from tudor_dynamics.identification.loads import bundle_of
from tudor_dynamics.identification.validation import score, trace
from tudor_dynamics.models.elastic.model import ElasticModel
from tudor_dynamics.models.elastic.parameters import in_words
from tudor_dynamics.online.monitor import MonitorSettings

KINDS = ('analytical', 'elm', 'elastic')
UNITS = {'1': '', 'N m^2': 'N m²'}


def record(args: argparse.Namespace, payload: float, *, damped: bool, seed: int, stimuli: int,
           pushes: int = 0) -> list[str]:
    """Record bags, or find them recorded."""
    name = (f'{1000 * payload:03.0f}g_{"damped" if damped else "undamped"}_{seed}'
            + (f'_{stimuli}' if stimuli > 1 else '') + (f'_pushes{pushes}' if pushes else ''))
    out = args.work / name
    if not (out / 'campaign.yaml').exists():
        command = [sys.executable, '-m', 'tudor_dynamics', 'record', '--arm', str(args.arm),
                   '--payload', str(payload), '--out', str(out), '--stimuli', str(stimuli),
                   '--seconds', str(args.seconds), '--seed', str(seed)]
        command += [] if damped else ['--no-damping']
        command += ['--pushes', str(pushes)] if pushes else []
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return [str(path) for path in sorted(out.glob('stimulus_*'))]


def bags(arm: Arm, paths: list[str]) -> list[BagData]:
    """Read bags."""
    return [load(parse_choice(path), arm, arm.spec.preprocessing) for path in paths]


def truth(arm: Arm) -> dict[str, float]:
    """Give the parameters of the simulation, as far as the elastic model has the same."""
    from tudor_dynamics.models.elastic.arm import DrivenArm
    # between the teeth, whose edges are sharp, gears of the simulation have no torque
    others = ('payload', 'edge', 'loose')
    return {name: value for name, value in DrivenArm(arm).parameters.items()
            if name.partition('(')[0] not in others}


def spoilt(arm: Arm) -> Arm:
    """Give the arm as one knows it who has not measured it: everything 20 to 50 % off."""
    links = []
    for link in arm.spec.links:
        beam = link.flexible
        if beam is not None:
            material = beam.material.model_copy(update={'E': 0.7 * beam.material.E})
            lumped = tuple(p.model_copy(update={'mass': 1.3 * p.mass}) for p in beam.lumped)
            beam = beam.model_copy(update={'material': material, 'lumped': lumped})
        links.append(link.model_copy(update={'flexible': beam}))
    motors = tuple(m.model_copy(update={
        'stiffness': None if m.stiffness is None else 1.4 * m.stiffness,
        'damping': 1.5 * m.damping, 'backlash': 0.7 * m.backlash}) for m in arm.spec.motors)
    simulation = arm.spec.simulation.model_copy(update={
        'rayleigh': arm.spec.simulation.rayleigh.model_copy(update={'beta': 3e-4})})
    return Arm(arm.spec.model_copy(update={
        'links': tuple(links), 'motors': motors, 'simulation': simulation}), arm.full_model,
        arm.source, arm.urdf)


def fits(args: argparse.Namespace, arm: Arm) -> None:
    """Fit at the ends, test in between, compare with the truth."""
    paths = [path for payload in (0.0, 0.4) for damped in (True, False)
             for path in record(args, payload, damped=damped, seed=1, stimuli=args.stimuli)]
    known = spoilt(arm)
    training = bags(known, paths)
    seconds = sum(float(bag.recording.t[-1]) for bag in training)
    begun = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', TudorWarning)
        some = bags(known, record(args, 0.2, damped=True, seed=2, stimuli=1))
        result = fit_models(known, training, some, None, known.spec.preprocessing,
                            FitSettings(kinds=KINDS, payloads=(0.0, 0.4)))
    print(f'identified from {seconds:.0f} s of recordings in {time.perf_counter() - begun:.0f} s '
          '(all models)')
    models = {(item.output, item.kind): item.model for item in result.fitted}
    for output in ('strain', 'effort'):
        print(f'fit of {output} on other stimuli [%], one model for all payloads: '
              + ', '.join(KINDS))
        for damped in (True, False):
            for payload in (0.0, 0.1, 0.2, 0.3, 0.4):
                test = bags(known, record(args, payload, damped=damped, seed=2,
                                          stimuli=args.tests))
                row = []
                for kind in KINDS:
                    traces = [trace(model_for(models[output, kind], bag), bag, output)
                              for bag in test]
                    row.append(score(np.vstack([t.measured for t in traces]),
                                     np.vstack([t.predicted for t in traces]),
                                     models[output, kind].channels).fit)
                print(f'  {1000 * payload:3.0f} g {"damped  " if damped else "undamped"} '
                      + '  '.join(f'{value:6.2f}' for value in row))
    elastic = models['strain', 'elastic']
    assert isinstance(elastic, ElasticModel)
    exact = truth(arm)
    started = truth(known)
    rows = []
    for p in elastic.physical:
        size = exact.get(p.name)
        if size:  # a share of nothing says nothing
            start, found = (f'{100.0 * (value / size - 1.0):+.1f} %'
                            for value in (started[p.name], p.value))
            rows.append((in_words(p.name), f'{size:.4g} {UNITS.get(p.unit, p.unit)}'.strip(),
                         start, found, f'{100.0 * p.standard_error / size:.2g} %' if p.shown
                         else 'not in the recordings'))
    show(('parameter', 'truth', 'started from', 'identified', 'standard error'), rows)


def collisions(args: argparse.Namespace, arm: Arm) -> None:
    """Find pushes with the damper off, where a rigid residual rings."""
    rows = []
    for damped in (True, False):
        free = bags(arm, record(args, 0.2, damped=damped, seed=3, stimuli=4))
        pushed = record(args, 0.2, damped=damped, seed=4, stimuli=2, pushes=5)
        with warnings.catch_warnings():
            warnings.simplefilter('ignore', TudorWarning)
            result = fit_models(arm, free[:2], free[2:], None, arm.spec.preprocessing,
                                FitSettings(kinds=('analytical', 'elastic')))
            bundle = bundle_of(result)
        recordings = [(str(bag.choice), bag.recording) for bag in bags(arm, pushed)]
        for kind in ('analytical', 'elastic'):
            rows += [('damped' if damped else 'not damped', kind, found.method,
                      *pushes(found.score.as_dict())) for found in evaluate_collisions(
                          bundle, recordings, MonitorSettings(kind=kind),
                          [find_truth(path) for path, _ in recordings])]
    show(('200 g', 'model', 'method', *PUSHES), rows)


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--arm', type=Path, default=Path('config/tudor.yaml'))
    parser.add_argument('--work', type=Path, required=True, help='directory for recordings')
    parser.add_argument('--seconds', type=float, default=80.0, help='of each recording')
    parser.add_argument('--stimuli', type=int, default=1, help='for training, of each condition')
    parser.add_argument('--tests', type=int, default=3,
                        help='stimuli of each condition for testing')
    parser.add_argument('--only', choices=('fits', 'collisions'))
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    arm = load_arm(args.arm)
    if args.only != 'collisions':
        fits(args, arm)
    if args.only != 'fits':
        collisions(args, arm)


if __name__ == '__main__':
    main()
