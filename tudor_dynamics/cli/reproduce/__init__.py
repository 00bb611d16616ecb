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

"""``tudor reproduce``: published experiments, repeated in simulation."""

from __future__ import annotations

import argparse
from importlib import import_module
import os
from typing import Any

from tudor_dynamics.cli.console import add_running
from tudor_dynamics.cluster import on_cluster
from tudor_dynamics.errors import UsageError
from tudor_dynamics.models.kinds import KINDS
from tudor_dynamics.reproduction.outlook.parts import PARTS

EXAMPLES = """\
examples:
  tudor reproduce table1 --out out
  tudor reproduce figures --out out
  tudor reproduce table1 --out out --split random
  tudor reproduce lshape --out out
  tudor reproduce lshape --out out --elements 4 --dt 0.0001 --animate out/l.gif
  tudor reproduce lshape --out out --reference lshape_reference.npz
  tudor reproduce outlook --out out --only payload

table1: Table I of Malzahn et al.: strain and current of the damped arm, five payloads with ten
stimuli of 80 s each, every kind of model, and one model for all payloads beside them; terminal,
table1.csv, table1.md and table1.html.
figures: the figures of both papers and four more, as SVG and PNG, with index.html and the numbers
in figures.json. It uses what table1 has left in the same DIR, and the other way round: finished
stages are kept in DIR/stages, so that an interrupted run goes on where it was.
lshape: the L-shaped mechanism of two flexible links of Gasparetto et al. (2013). Two opposite
steps of torque take it from 135 deg (from hanging) to about 30 deg. Figures as in the paper:
torque (4), elbow and tip acceleration over time and frequency (5 to 8), bending moment in the
middle of the second link (9). With --reference, a run of an independent computation is repeated
and compared too.
outlook: what the first paper names as its outlook, computed on the simulated reference arm, part
by part; outlook.html with figures and with what must be reached, the numbers in outlook.json.
With --data also on other recordings: DIR/bags/NAME, DIR/arms/NAME.yaml.
force: short for outlook --only force, steps of a held force on floors of 100 to 20 000 N/m.
"""

EXPERIMENTS = ('table1', 'figures', 'lshape', 'outlook', 'force')
OWN = {'lshape': ('elements', 'dt', 'animate', 'reference'),
       'table1': ('arm', 'models', 'quick', 'stimuli', 'seconds', 'seed', 'jobs', 'cluster',
                  'split'),
       'figures': ('arm', 'models', 'quick', 'stimuli', 'seconds', 'seed', 'jobs', 'cluster'),
       'outlook': ('arm', 'quick', 'seed', 'jobs', 'cluster', 'only', 'data'),
       'force': ('arm', 'quick', 'seed', 'jobs', 'cluster')}
"""Options that an experiment knows, beside --out and --json."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``tudor reproduce``."""
    parser.add_argument('experiment', choices=EXPERIMENTS, help='experiment')
    parser.add_argument('--out', metavar='DIR', required=True, help='results go there')
    parser.add_argument('--json', action='store_true', help='print figures as JSON')
    arm = parser.add_argument_group('table1, figures and outlook')
    arm.add_argument('--arm', metavar='YAML',
                     help='arm description with links, motors and damper (config/tudor.yaml)')
    arm.add_argument('--models', nargs='+', choices=tuple(KINDS), help='kinds of models (all)')
    arm.add_argument('--split', choices=('stimulus', 'random'),
                     help='train on half of the stimuli, as the paper, or on half of the samples '
                          'at random, which flatters (table1; stimulus)')
    arm.add_argument('--quick', action='store_true', default=None,
                     help='three payloads, two short stimuli each, fast models: to see that it '
                          'works')
    arm.add_argument('--stimuli', type=int, metavar='N',
                     help='recordings a payload, half of them for training (10)')
    arm.add_argument('--seconds', type=float, metavar='S', help='length of each (80)')
    arm.add_argument('--seed', type=int, metavar='N', help='of motions, noise and pushes (0)')
    add_running(arm, jobs=None)
    outlook = parser.add_argument_group('outlook')
    outlook.add_argument('--only', nargs='+', choices=tuple(PARTS), help='parts (all)')
    outlook.add_argument('--data', metavar='DIR',
                         help='recordings that are no part of the package')
    shape = parser.add_argument_group('lshape')
    shape.add_argument('--elements', type=int, help='elements a beam (2)')
    shape.add_argument('--dt', type=float, help='step [s] (0.00025)')
    shape.add_argument('--animate', metavar='FILE', help='.gif or .mp4')
    shape.add_argument('--reference', metavar='FILE.npz', help='computation to compare with')


DEFAULTS: dict[str, Any] = {
    'elements': 2, 'dt': 2.5e-4, 'split': 'stimulus', 'quick': False, 'seed': 0,
    'jobs': os.cpu_count() or 1, 'models': tuple(KINDS)}


def run(args: argparse.Namespace) -> int:
    """Repeat the experiment."""
    own = OWN[args.experiment]
    for name in sorted({name for names in OWN.values() for name in names}):
        if getattr(args, name) is None:
            setattr(args, name, DEFAULTS.get(name))
        elif name not in own:
            msg = f'--{name} is no option of {args.experiment}; it knows ' + ', '.join(
                f'--{item}' for item in (*own, 'out', 'json'))
            raise UsageError(msg)
    if args.experiment == 'force':
        args.experiment, args.only = 'outlook', ['force']
    module = import_module(f'tudor_dynamics.cli.reproduce.{args.experiment}')
    with on_cluster(args.cluster):
        return int(module.run(args))
