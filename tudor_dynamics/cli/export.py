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

"""``tudor export``: an identified arm as URDF, MJCF, description, drives, or table."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console

from tudor_dynamics.cli.console import new_table, print_table
from tudor_dynamics.errors import UsageError
from tudor_dynamics.files import write_whole
from tudor_dynamics.models.bundle_io import load_bundle
from tudor_dynamics.models.comparison import full_parameters, FullParameters
from tudor_dynamics.models.elastic.model import elastic_of
from tudor_dynamics.show.description import csv_of, description_of, elastic_drives, yaml_of
from tudor_dynamics.show.mjcf import elastic_mjcf, mjcf_of, not_in_mjcf
from tudor_dynamics.show.urdf import simple_frictions, urdf_of

EXAMPLES = """\
examples:
  tudor export MODEL --to urdf --out my_arm_identified.urdf
  tudor export MODEL --to mjcf --out my_arm.xml
  tudor export MODEL --to yaml --out drives.yaml
  tudor export MODEL --to csv --out parameters.csv
  tudor export MODEL --to arm --out my_arm_identified.yaml    of an elastic model

Masses, centres, inertias, rotor inertias and friction are those that explain the recordings the
model was fitted to, among all that can exist; what the recordings do not show comes from the
description. In the URDF nothing but <inertial> and <dynamics> changes. An elastic model becomes
MJCF with springs in gears and links (--rigid: without), and the description that tudor simulate
and tudor record read. See docs/export.md.
"""

FORMATS = {'urdf': urdf_of, 'mjcf': mjcf_of, 'yaml': yaml_of, 'csv': csv_of}


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``tudor export``."""
    parser.add_argument('model', metavar='MODEL', help='bundle of tudor fit, with efforts')
    parser.add_argument('--to', choices=(*FORMATS, 'arm'), required=True, help='format')
    parser.add_argument('--out', metavar='FILE', required=True, help='file to be written')
    parser.add_argument('--rigid', action='store_true',
                        help='MJCF of the rigid model where there is an elastic one too')
    parser.add_argument('--overwrite', action='store_true', help='replace the file')


def run(args: argparse.Namespace) -> int:
    """Find what was identified and write it."""
    out = Path(args.out)
    if args.to == 'arm' and out.suffix == '.urdf':
        raise UsageError('is the name of the URDF beside it', place=out,
                         remedy='choose a name that ends in .yaml')
    console = Console(highlight=False, markup=False, emoji=False, soft_wrap=True)
    files, left_out = _content(args, out, console)
    for path in files:
        if path.exists() and not args.overwrite:
            raise UsageError('exists already', place=path,
                             remedy='choose another --out, or add --overwrite')
    for path, text in files.items():
        try:
            write_whole(path, text.encode())
        except OSError as err:
            raise UsageError(f'cannot be written ({err.strerror or err})', place=path,
                             remedy='choose another --out') from None
    for what in left_out:
        console.print(f'{args.to} has no place for: {what}')
    print(f'{args.to}: {", ".join(map(str, reversed(files)))}')
    return 0


def _content(
    args: argparse.Namespace, out: Path, console: Console,
) -> tuple[dict[Path, str], tuple[str, ...]]:
    """Give the texts to be written, that which was asked for last, and what they leave out."""
    bundle = load_bundle(args.model, with_data=True)
    elastic = elastic_of(bundle, 'strain') or elastic_of(bundle, 'effort')
    if args.to == 'arm':
        beside = out.with_suffix('.urdf')
        described = description_of(bundle, beside.name)
        urdf = {} if bundle.arm.urdf is None else {beside: bundle.arm.urdf}
        return {**urdf, out: described.text}, described.left_out
    if args.to == 'mjcf' and elastic is not None and not args.rigid:
        drives = elastic_drives(bundle)
        return {out: elastic_mjcf(elastic, drives)}, not_in_mjcf(elastic, drives)
    full = full_parameters(bundle)
    show(full, args.to, console)
    return {out: FORMATS[args.to](full)}, ()


def show(full: FullParameters, target: str, console: Console) -> None:
    """Print what was found, what it rests on, and what the format leaves out."""
    solution, model = full.solution, full.arm.model
    table = new_table(f'{full.arm.name}: bodies and drives', names=('joint',), figures=(
        'mass [kg]', '+-', 'described', 'from data', 'error free', 'error'))
    places = {name: i for i, name in enumerate(full.model.channels)}
    sources = full.sources()
    for i, (name, body) in enumerate(full.bodies.items()):
        place = places[name]
        described = float(model.inertias[i + 1].mass)
        own = sources[10 * i:10 * (i + 1)]
        table.add_row(
            name, f'{body[0]:.4g}', f'{solution.body_errors[i, 0]:.2g}',
            f'{described:.4g}' if described > 0.0 else '-', f'{own.count("data")} of 10',
            f'{100 * solution.free_errors[place]:.2f} %',
            f'{100 * solution.relative_errors[place]:.2f} %')
    print_table(table)
    console.print('from data: parameters of the body that the data fix; the others lean on the '
                  'description. error: on the training bags, of base parameters, and of these')
    if full.assumed:
        console.print('torque constants are not known: torques and masses are scaled so that '
                      'the bodies weigh about what the description says; give effort.'
                      'torque_constant of one joint for absolute ones')
    if target in ('urdf', 'mjcf'):
        left = {name: simple.left_out for name, simple in simple_frictions(full).items()}
        some = [f'{name} ({", ".join(terms)})' for name, terms in left.items() if terms]
        if some:
            console.print(f'{target} has two numbers for friction, without: {"; ".join(some)}; '
                          '--to yaml has all of it')
        if target == 'urdf' and any(terms.get('Ia') for terms in full.drives.values()):
            console.print('urdf has no place for rotor inertias: --to mjcf or yaml has them')
