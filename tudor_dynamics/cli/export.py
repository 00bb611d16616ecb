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
import math
from pathlib import Path

import numpy as np

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.cli.console import add_out, new_table, print_table, say, write
from tudor_dynamics.errors import UsageError
from tudor_dynamics.files import check_target
from tudor_dynamics.models.bundle import elastic_of, load_bundle, ModelBundle
from tudor_dynamics.models.comparison import (
    file_effects, file_errors, file_parameters, full_parameters, FullParameters)
from tudor_dynamics.models.friction import TERMS
from tudor_dynamics.show.description import (
    csv_of, description_of, elastic_drives, layout_of, LAYOUTS, urdf_of, yaml_of)
from tudor_dynamics.show.mjcf import ElasticFile, mjcf_of, not_in_mjcf
from tudor_dynamics.typing import FloatArray

EXAMPLES = """\
examples:
  tudor export MODEL --to urdf --out my_arm_identified.urdf
  tudor export MODEL --to mjcf --out my_arm.xml
  tudor export MODEL --to yaml --out drives.yaml
  tudor export MODEL --to csv --out parameters.csv
  tudor export MODEL --to arm --out identified.yaml    of an elastic model
  tudor export MODEL --to plotjuggler --out layout.xml    topics of its monitor

Masses, centres, inertias, rotor inertias and friction are those that explain the recordings the
model was fitted to, among all that can exist; what the recordings do not show comes from the
description. URDF and MJCF have two numbers for friction (URDF: and no rotors), those that suit the
recordings best; the error is that of the file, read again. In the URDF nothing but <inertial> and
<dynamics> changes. An elastic model becomes
MJCF with springs in gears and links (--rigid: without), and the description that tudor simulate
and tudor record read. See docs/explanation/export.md.
"""

TABLES = {'yaml': yaml_of, 'csv': csv_of}


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``tudor export``."""
    parser.add_argument('model', metavar='MODEL', help='directory of tudor fit, with efforts')
    parser.add_argument('--to', choices=('urdf', 'mjcf', *TABLES, 'arm', *LAYOUTS), required=True,
                        help='format')
    add_out(parser, 'FILE', 'file to be written')
    parser.add_argument('--rigid', action='store_true',
                        help='MJCF of the rigid model where there is an elastic one too')


def run(args: argparse.Namespace) -> int:
    """Find what was identified and write it."""
    out = Path(args.out)
    if args.to == 'arm' and out.suffix == '.urdf':
        raise UsageError('--to arm writes an arm description, which is no URDF', place=out,
                         remedy='give --out a name that ends in .yaml, or give --to urdf')
    bundle = load_bundle(args.model, with_data=True)
    files, left_out, full = _content(bundle, args, out)
    for path in files:
        check_target(path, overwrite=args.overwrite)
    for path, text in files.items():
        write(path, '--out', text.encode())
    if full is not None:
        show(full, full.solution.relative_errors if args.to in TABLES else
             file_errors(bundle, full, out))
    for what in left_out:
        say(f'{args.to} has no place for: {what}')
    say(f'{args.to}: {", ".join(map(str, reversed(files)))}')
    return 0


def _content(
    bundle: ModelBundle, args: argparse.Namespace, out: Path,
) -> tuple[dict[Path, str], tuple[str, ...], FullParameters | None]:
    """Give the texts to be written, what they leave out, and parameters that are printed."""
    elastic = elastic_of(bundle, 'strain') or elastic_of(bundle, 'effort')
    if args.to == 'arm':
        beside = out.with_suffix('.urdf')
        text, left_out = description_of(bundle, beside.name)
        urdf = {} if bundle.arm.urdf is None else {beside: bundle.arm.urdf}
        return {**urdf, out: text}, left_out, None
    if args.to == 'mjcf' and elastic is not None and not args.rigid:
        drives = elastic_drives(bundle)
        return {out: ElasticFile(elastic, drives).text()}, not_in_mjcf(elastic, drives), None
    if args.to in LAYOUTS:
        return {out: layout_of(bundle.arm, args.to)}, (), None
    if args.to in TABLES:
        full = full_parameters(bundle)
        return {out: TABLES[args.to](full)}, (), full
    rotors = args.to == 'mjcf'
    full = file_parameters(bundle, rotors=rotors)
    text = mjcf_of(full) if rotors else urdf_of(full)
    effects = file_effects(bundle, full, rotors=rotors)
    return {out: text}, lost(bundle.arm, effects, rotors=rotors), full


def lost(arm: Arm, effects: dict[str, FullParameters], *, rotors: bool) -> tuple[str, ...]:
    """Name the parts of an arm's model that URDF or MJCF cannot hold, and what each would win."""
    found: dict[str, bool] = {
        **{str(term): not TERMS[term].pair for joint in arm.joints for term in joint.friction},
        'friction that differs by direction': any(joint.asymmetric for joint in arm.joints),
        'rotor inertias': not rotors and any(joint.rotor_inertia for joint in arm.joints),
        'couplings': arm.coupling is not None}
    errors = {what: 100.0 * math.sqrt(np.mean(full.solution.relative_errors ** 2))
              for what, full in effects.items()}
    return tuple(f'{what} (with it the error is {errors[what]:.3g}, not {errors[""]:.3g} %)' if
                 what in errors else what for what, there in found.items() if there)


def show(full: FullParameters, errors: FloatArray) -> None:
    """Print what was found, what it rests on, and the error of the file: errors (joints,)."""
    solution, model = full.solution, full.arm.model
    table = new_table(f'{full.arm.name}: bodies and drives', names=('joint',), figures=(
        'mass [kg]', '+-', 'described', 'from data', 'error of\nmodel', 'of file'))
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
            f'{100 * errors[place]:.2f} %')
    print_table(table)
    say('from data: parameters of the body that the data fix; the others lean on the '
        'description. error: on the training bags, of the model, and of this file')
    if loose := full.loose_constants():
        say(f'torque constants that the data do not fix: {loose}')
    if full.assumed:
        say('torque constants are not known: torques and masses are scaled so that '
            'the bodies weigh about what the description says; give effort.'
            'torque_constant of one joint for absolute ones')
