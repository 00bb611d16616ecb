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
Follow what to do next, item by item and literally, and judge it by motion that nobody has seen.

Each recording of DATA is fitted by its first 60 % (or by another bag), with the description of the
arm without friction, as `tudor init` writes it. Each command that the fit prints is run in a shell
as it stands; each remedy that changes the description, or names a part of the bag that is to be
used, is applied, and the fit run again. Of what comes out, by the best of its models, the error on
the last 40 % is printed, before and after. It must not grow by more than 0.1 points, and each
command must end with 0 or 1.

    python bench/next_steps.py --data DATA [--only UR10 TX40]
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
import re
import shlex
import subprocess
import sys
import tempfile

from first_hour import WRIST
from reference_fits import CONFIG
import yaml

WORSE = 0.1
"""By which an error may grow [points]."""
ROBOTS = {
    # name: description, training, test, couplings
    'UR10': ('ur10.yaml', 'ur10_exciting@0-60%', 'ur10_exciting@60-100%', None),
    'UR10e': ('ur10e.yaml', 'ur10e_unloaded@0-60%', 'ur10e_unloaded@60-100%', None),
    'UR10e_loaded': ('ur10e.yaml', 'ur10e_loaded@0-60%', 'ur10e_loaded@60-100%', None),
    'Airbot': ('airbot.yaml', 'airbot_chirp@0-60%', 'airbot_chirp@60-100%', None),
    'Airbot_moves': (
        'airbot.yaml', 'airbot_trapezoidal@0-60%', 'airbot_trapezoidal@60-100%', None),
    'TX40': ('tx40.yaml', 'tx40_exciting@0-60%', 'tx40_exciting@60-100%', WRIST),
    'TX40_uncoupled': ('tx40.yaml', 'tx40_exciting@0-60%', 'tx40_exciting@60-100%', None),
    'FER': ('panda.yaml', 'panda_fer_exciting@0-60%', 'panda_fer_exciting@60-100%', None),
    'EMPS': ('emps.yaml', 'emps_estimation', 'emps_validation', None),
    'Quanser': ('quanser.yaml', 'quanser_hinf@0-60%', 'quanser_hinf@60-100%', None),
    'two_blades': ('two_blade_arm.yaml', 'arm_200g_free_1@0-60%', 'arm_200g_free_1@60-100%', None),
    'undamped': ('two_blade_arm.yaml', 'arm_000g_undamped_1@0-60%', 'arm_000g_undamped_1@60-100%',
                 None)}


def run(words):
    """Run words in a shell as they would be typed; give the exit code and what was said."""
    line = shlex.join(words) if isinstance(words, list) else words
    line = re.sub(r'^tudor ', f'{shlex.quote(sys.executable)} -m tudor_dynamics ', line)
    done = subprocess.run(line, shell=True, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout, done.stderr


def errors(model, arm, test):
    """Judge a model by unseen motion: relative error by output [%], None where it cannot be."""
    code, said, _ = run(['tudor', 'evaluate', '--model', str(model), test, '--json'])
    if code not in (0, 1):
        return None
    found = json.loads(said)
    return {output: 100.0 * min(one['relative_error'] for one in kinds.values()
                                if isinstance(one, dict) and 'relative_error' in one)
            for output, kinds in found.items()
            if isinstance(kinds, dict) and 'analytical' in kinds}


def fitted(words, out):
    """Fit; give what it says as JSON, or None."""
    code, said, err = run([*words, '--out', str(out), '--json'])
    if code not in (0, 1):
        print(f'  exit code {code}: {err.strip()[-200:]}')
        return None
    return json.loads(said)


def remedied(content, finding):
    """Apply a remedy to a description, where it is one of the description; else None."""
    found = re.search(r'(gravity|couplings|preprocessing): *([\[{].*[\]}])', finding['remedy'])
    if found:
        return {**content, found[1]: yaml.safe_load(found[2])}
    if 'measured_velocity: false' in finding['remedy']:
        return {**content, 'preprocessing': {**content.get('preprocessing', {}),
                                             'measured_velocity': False}}
    return None


def compare(what, before, after):
    """Print errors before and after; say whether none has grown."""
    if after is None:
        print(f'  {what}: no model that could be judged')
        return False
    grown = max((after[key] - before[key] for key in before if key in after), default=0.0)
    shown = ', '.join(f'{key} {before[key]:.2f} -> {after[key]:.2f} %' for key in before
                      if key in after)
    print(f'  {what}: {shown}{"" if grown <= WORSE else "  GROWS"}', flush=True)
    return grown <= WORSE


def follow(name, folder, data, robot):
    """Fit, and follow each item; give how many there were, and how many fell short."""
    source, training, test, couplings = robot
    path = CONFIG / source if (CONFIG / source).exists() else data / 'arms' / source
    training, test = f'{data}/bags/{training}', f'{data}/bags/{test}'
    if not path.exists() or not Path(training.partition('@')[0]).exists():
        print(f'{name}: not there, left out')
        return 0, 0
    text = path.read_text()
    if 'fer_' in training:  # the same arm, whose joints have other names in this recording
        text = text.replace('panda', 'fer')
    content = yaml.safe_load(text)
    for joint in content['joints']:
        joint.pop('friction', None)
    if 'urdf' in content['kinematics']:
        content['kinematics']['urdf'] = str(
            (path.parent / content['kinematics']['urdf']).resolve())
    if couplings:
        content['couplings'] = couplings
    (folder / 'arm.yaml').write_text(yaml.safe_dump(content))
    words = ['tudor', 'fit', training, '--arm', str(folder / 'arm.yaml')]
    said = fitted(words, folder / 'model')
    if said is None:
        return 1, 1
    before = errors(folder / 'model', folder / 'arm.yaml', test)
    print(f'{name}: {before}')
    count = short = 0
    for step in said['next_steps']:
        print(f'  item: {step["what"][:150]}')
        if not step['command']:
            continue
        count += 1
        code, _, err = run(step['command'])
        if code not in (0, 1):
            short += 1
            print(f'    exit code {code}: {step["command"]}\n    {err.strip()[-300:]}', flush=True)
        elif step['command'].startswith('tudor fit '):
            out = shlex.split(step['command'])[-1]
            short += not compare(step['command'], before, errors(out, folder / 'arm.yaml', test))
        else:
            print(f'    runs: {step["command"]}', flush=True)
    for number, finding in enumerate(said['findings']):
        changed = remedied(content, finding)
        part = re.search(r'use (?:only this part of the bag: )?(\S+@\S+%)', finding['remedy'])
        if changed is not None or part and part[1] != training:
            count += 1
            other = folder / f'arm_{number}.yaml'
            other.write_text(yaml.safe_dump(changed or content))
            words = ['tudor', 'fit', part[1] if part else training, '--arm', str(other)]
            out = folder / f'remedied_{number}'
            found = fitted(words, out)
            short += not compare(f'remedy: {finding["remedy"][:100]}', before,
                                 None if found is None else errors(out, other, test))
    return count, short


def main():
    """Go through the robots."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--data', type=Path,
                        default=Path(os.environ.get('TUDOR_SHARED_DATA', '../shared/data')))
    parser.add_argument('--only', nargs='+', default=list(ROBOTS), choices=list(ROBOTS))
    args = parser.parse_args()
    total = wrong = 0
    for name in args.only:
        with tempfile.TemporaryDirectory() as folder:
            count, short = follow(name, Path(folder), args.data.resolve(), ROBOTS[name])
        total, wrong = total + count, wrong + short
    print(f'{total} items could be followed, {wrong} of them fell short')


if __name__ == '__main__':
    main()
