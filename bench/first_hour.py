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
Fit arms that the package has not seen, with no option, and judge them on motion of another part.

The recordings are no part of the package; docs/explanation/validation.md says whose they are. DATA
holds ``bags/`` and ``arms/`` with a description of each arm, of which the friction is taken out,
as ``tudor init`` writes none: filters, friction and shared parameters are chosen from the
training data. What is not there is left out, and said.

    python bench/first_hour.py --data DATA
"""

from __future__ import annotations

from pathlib import Path
import tempfile

from reference_fits import CONFIG, data_directory, fit, HEAD, import_merit, row, ROWS
from tables import show
import yaml

WRIST = {'pairs': [{'motor': 'joint_6', 'joint': 'joint_5', 'ratio': 1.0}]}
"""Motor 6 of the TX40 turns with joint 5 as well (DATA/README.md)."""
TORQUE_RATIOS = {'shoulder_lift_joint': 10.6956, 'elbow_joint': 8.4566}
"""Of the UR10e, published with the recordings [N m/A]."""
UNSEEN = (
    # name, description, training, test, relative error that is to be reached [%], couplings
    ('UR10e, currents, 60 % to 40 %', 'ur10e.yaml', ['ur10e_unloaded@0-60%'],
     ['ur10e_unloaded@60-100%'], 4.3, None),
    ('Airbot Play, chirp to trapezoidal motion', 'airbot.yaml', ['airbot_chirp'],
     ['airbot_trapezoidal'], 7.7, None),
    ('Stäubli TX40, `couplings` given, 60 % to 40 %', 'tx40.yaml', ['tx40_exciting@0-60%'],
     ['tx40_exciting@60-100%'], 12.6, WRIST))
KNOWN = (
    ('EMPS', 'emps.yaml', ['emps_estimation'], ['emps_validation'], 3.1),
    ('UR10, 60 % to 40 %', 'ur10.yaml', ['ur10_exciting@0-60%'], ['ur10_exciting@60-100%'], 6.3),
    ('two blades, 200 g, effort', 'two_blade_arm.yaml', [f'arm_200g_free_{i}' for i in (1, 2, 3)],
     ['arm_200g_free_4'], 7.07))
MERIT_FLOOR = 79.0
"""Strain fit of the hub gauges of the undamped arm, first half to second [%]."""


def undescribed(source, folder, couplings):
    """Write a description without friction, as tudor init does; give its file."""
    content = yaml.safe_load(source.read_text())
    for joint in content['joints']:
        joint.pop('friction', None)
    content['kinematics']['urdf'] = str((source.parent / content['kinematics']['urdf']).resolve())
    if couplings:
        content['couplings'] = couplings
    target = Path(folder) / source.name
    target.write_text(yaml.safe_dump(content))
    return target


def error_row(name, out, arm, bags, training, test, bound):
    """Fit, evaluate, keep the relative error, print what was chosen."""
    found = fit(out, arm, [bags / bag for bag in training], [bags / bag for bag in test],
                '--models', 'analytical')
    row(name, 'relative error', 100 * found['effort']['analytical']['relative_error'],
        bound, at_most=True)
    content = yaml.safe_load((Path(out) / 'model.yaml').read_text())
    for choice in content['facts']['choices']:
        print(f'{name}: {choice["what"]}: {choice["chosen"]}')
    return content


def ratios(content):
    """Compare the torque constants that were found with the published ones."""
    group, = content['outputs']['effort']['analytical']['groups']
    constants = {item['channel']: item['value'] for item in group['torque_constants']}
    (first, one), (second, other) = TORQUE_RATIOS.items()
    off = 100 * abs(constants[second] / constants[first] / (other / one) - 1)
    row('UR10e, currents, 60 % to 40 %',
        'ratio of the torque constants of joints 2 and 3, off the published', off, 3.0,
        at_most=True)


def merit(csv, out):
    """Fit the first half of a record of the real two-blade arm, test on the second."""
    bag = Path(out).parent / 'merit_bag'
    import_merit(csv, bag)
    found = fit(out, 'tudor.yaml', [f'{bag}@0-50%'], [f'{bag}@50-100%'])
    channels = [found['strain']['analytical']['channels'][name]
                for name in ('link2_hub', 'link3_hub')]
    spread = [c['rmse'] / (1 - c['fit'] / 100) for c in channels]
    error = sum(c['rmse'] ** 2 for c in channels) / sum(value ** 2 for value in spread)
    row('TUDOR arm (MERIt exp1), not actively damped, halves', 'strain fit, hub gauges',
        100 * (1 - error ** 0.5), MERIT_FLOOR)


def main():
    """Go through the recordings that are there."""
    data = data_directory(__doc__.splitlines()[1])
    bags = data / 'bags'

    def there(*needed):
        missing = [path for path in needed if not path.exists()]
        for path in missing:
            print(f'{path}: not there, left out')
        return not missing

    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / 'model'
        for name, arm, training, test, bound, couplings in UNSEEN:
            if there(data / 'arms' / arm, *(bags / bag.partition('@')[0] for bag in training)):
                described = undescribed(data / 'arms' / arm, folder, couplings)
                content = error_row(name, out, described, bags, training, test, bound)
                if arm == 'ur10e.yaml':
                    ratios(content)
        for name, arm, training, test, bound in KNOWN:
            if there(*(bags / bag.partition('@')[0] for bag in training)):
                error_row(name, out, CONFIG / arm, bags, training, test, bound)
        if there(data / 'merit_exp1.csv'):
            merit(data / 'merit_exp1.csv', out)
    show(HEAD, ROWS)


if __name__ == '__main__':
    main()
