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
Fit the first 60 % of one recording with no option and no test bag; its error on the last 40 %.

Beside it stand the error that the fit itself says, of motion that it has left out, and the error
of a fit that was given the last 40 % as `--test`. The recordings are no part of the package;
docs/validation.md says where they come from. Descriptions name no friction, as `tudor init`
writes none, but for those of config/. What is not there is left out, and said.

    python bench/one_bag.py --data DATA
"""

from __future__ import annotations

from pathlib import Path
import tempfile

from first_hour import undescribed, WRIST
from reference_fits import CONFIG, data_directory, fit, tudor
from tables import show
import yaml

RECORDINGS = (
    # name, description, bag, couplings
    ('UR10', 'config', 'ur10.yaml', 'ur10_exciting'),
    ('UR10e, currents', 'arms', 'ur10e.yaml', 'ur10e_unloaded'),
    ('Airbot Play, chirp', 'arms', 'airbot.yaml', 'airbot_chirp'),
    ('Airbot Play, trapezoidal', 'arms', 'airbot.yaml', 'airbot_trapezoidal'),
    ('TX40', 'arms', 'tx40.yaml', 'tx40_exciting'),
    ('EMPS', 'config', 'emps.yaml', 'emps_estimation'),
    ('FER', 'arms', 'fer.urdf', 'panda_fer_exciting'),
    ('Quanser', 'arms', 'quanser.yaml', 'quanser_hinf'),
    ('two blades, 200 g', 'config', 'two_blade_arm.yaml', 'arm_200g_free_1'),
    ('two blades, 200 g', 'config', 'two_blade_arm.yaml', 'arm_200g_free_2'),
    ('two blades, 0 g', 'config', 'two_blade_arm.yaml', 'arm_000g_free_1'))


def described(source: Path, folder: str) -> Path:
    """Give the description of an arm, completed by what is known of it."""
    if source.parent == CONFIG:
        return source
    if source.suffix == '.urdf':
        content = {'name': source.stem, 'kinematics': {'urdf': str(source.resolve())},
                   'joints': [{'name': f'{source.stem}_joint{k}', 'effort': {
                       'topic': 'joint_states', 'unit': 'N m'}} for k in range(1, 8)]}
    elif source.stem == 'quanser':  # one gauge was recorded, and the second stage stands
        content = yaml.safe_load(source.read_text())
        content['gauges'] = content['gauges'][:1]
    else:
        return undescribed(source, folder, WRIST if source.stem == 'tx40' else None)
    target = Path(folder) / f'{source.stem}.yaml'
    target.write_text(yaml.safe_dump(content))
    return target


def errors(figures: dict, key: str | None = None) -> str:
    """Write the relative error of each output; of a key of its model's figures, where there."""
    found = {output: figures[output]['analytical'] for output in ('effort', 'strain')
             if output in figures}
    return ', '.join(
        f'{output} {100 * (item if key is None else item[key])["relative_error"]:.2f} %'
        for output, item in found.items())


def cell(found: dict, named: dict, output: str) -> str:
    """Write the error of an output, and in brackets that of the model with ``--test``."""
    if output not in found:
        return ''
    return ' '.join(form.format(100 * figures[output]['analytical']['relative_error'])
                    for form, figures in (('{:.1f} %', found), ('({:.1f} %)', named)))


def main() -> None:
    """Go through the recordings that are there."""
    data = data_directory(__doc__.splitlines()[1])
    rows = []
    folders = {'config': CONFIG, 'arms': data / 'arms'}
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / 'model'
        for name, place, description, bag in RECORDINGS:
            path = data / 'bags' / bag
            if not path.exists():
                print(f'{path}: not there, left out')
                continue
            arm = described(folders[place] / description, folder)
            first, last = f'{path}@0-60%', f'{path}@60-100%'
            said = tudor('fit', first, '--arm', arm, '--out', out, '--overwrite', '--json')
            found = tudor('evaluate', '--model', out, last, '--json')
            named = fit(out, arm, [first], [last])
            print(f'{name} ({bag}): {errors(found)}; said '
                  f'{errors(said, "validation")}; with --test '
                  f'{errors(named)}', flush=True)
            rows.append((name, cell(found, named, 'effort'), cell(found, named, 'strain')))
    show(('recording', 'effort', 'strain'), rows)


if __name__ == '__main__':
    main()
