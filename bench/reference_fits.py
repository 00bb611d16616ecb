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
Fit and judge models on the reference recordings; the tables in docs/explanation/validation.md.

The recordings are not part of the package. DATA holds ``bags/arm_200g_free_1`` to ``_4`` (a
simulated two-blade arm), ``bags/emps_estimation`` and ``bags/emps_validation`` (EMPS benchmark,
nonlinearbenchmark.org), ``bags/ur10_exciting`` (UR10 of the inverse_dynamics_solver demos), and
``merit_exp1.csv`` (the TUDOR arm, MERIt, TU Dortmund). What is not there is left out.

    python bench/reference_fits.py --data DATA
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
import statistics
import subprocess
import sys
import tempfile

from tables import show

CONFIG = Path(__file__).resolve().parents[1] / 'config'
HEAD = ('recording', 'figure', 'reached', 'must reach')
ROWS: list[tuple[str, ...]] = []
"""What `row` was given, for `show` at the end."""


def tudor(*words, allowed=(0, 1)):
    """Run the command as a user does, and read its JSON."""
    done = subprocess.run([sys.executable, '-m', 'tudor_dynamics', *map(str, words)],
                          capture_output=True, text=True, check=False)
    if done.returncode not in allowed:
        raise SystemExit(done.stderr)
    return json.loads(done.stdout) if '--json' in words else None


def import_merit(csv, bag):
    """Make a bag of a public recording of the real arm."""
    subprocess.run([sys.executable, '-m', 'papers', 'import-merit', str(csv), '--out', str(bag)],
                   cwd=CONFIG.parent, check=True)


def fit(out, arm, training, test, *options):
    """Fit to training bags, then evaluate on test bags by the saved model."""
    said = tudor('fit', *training, '--test', *test, '--arm', CONFIG / arm, '--out', out,
                 '--overwrite', '--json', *options)
    figures = tudor('evaluate', '--model', out, *test, '--json')
    figures['seconds'] = said['seconds']
    return figures


def row(name, quantity, value, floor, unit='%', *, at_most=False):
    """Keep a figure with its floor."""
    kept = value <= floor if at_most else value >= floor
    ROWS.append((name, quantity, f'{value:.3g} {unit}{"" if kept else ", **falls short**"}',
                 f'{"≤" if at_most else "≥"} {floor:.3g} {unit}'))


def two_blade(bags, out):
    """Fit the simulated two-blade arm: analytical model and ELM of five seeds."""
    said = tudor('fit', *(bags / f'arm_200g_free_{i}' for i in (1, 2, 3, 4)), '--arm',
                 CONFIG / 'two_blade_arm.yaml', '--out', out, '--overwrite', '--json')
    print('two blades, four bags of 80 s, time of `tudor fit`: ' + ', '.join(
        f'{what} {seconds:.1f} s' for what, seconds in said['seconds'].items()))
    training = [bags / f'arm_200g_free_{i}' for i in (1, 2, 3)]
    test = [bags / 'arm_200g_free_4']
    causal = ('--filter', 'causal')
    for options, name in (((), 'chosen'), (causal, 'causal'),
                          ((*causal, '--output-cutoff', '20'), 'causal, outputs at 20 Hz'),
                          (('--filter', 'zero_phase'), 'zero-phase'),
                          ((*causal, '--strain-form', 'paper'), 'causal, strain as in the paper')):
        found = fit(out, 'two_blade_arm.yaml', training, test, *options)
        label = f'two blades 200 g, {name}'
        row(label, 'strain analytical fit', found['strain']['analytical']['fit'], 92.5)
        row(label, 'effort analytical fit', found['effort']['analytical']['fit'], 88.5)
    runs = [fit(out, 'two_blade_arm.yaml', training, test, '--models', 'elm', '--elm-seed', seed,
                *causal) for seed in range(5)]
    for output, floor in (('strain', 90.0), ('effort', 84.0)):
        fits = [run[output]['elm']['fit'] for run in runs]
        row('two blades 200 g, causal', f'{output} ELM fit, median of 5 seeds',
            statistics.median(fits), floor)


def emps(bags, out):
    """Fit the EMPS axis and compare mass and friction with the published values."""
    found = fit(out, 'emps.yaml', [bags / 'emps_estimation'], [bags / 'emps_validation'])
    row('EMPS', 'relative error (published 4.31 %)',
        100 * found['effort']['analytical']['relative_error'], 3.1, at_most=True)
    fit(out, 'emps.yaml', [bags / 'emps_estimation'], [bags / 'emps_validation'],
        '--friction', 'viscous', 'coulomb', 'offset')
    import yaml
    content = yaml.safe_load((Path(out) / 'model.yaml').read_text())
    values = {item['column'].split('(')[0]: item['value'] for item in
              content['outputs']['effort']['analytical']['groups'][0]['coefficients']}
    for name, value, published in (
            ('mass', values['m'], 95.1089),
            ('viscous friction', values['viscous'], 203.5034),
            ('Coulomb friction', values['coulomb'], 20.3935)):
        row('EMPS', f'published terms: {name}, off the published {published}',
            100 * abs(value / published - 1), 2.0, at_most=True)


def ur10(bags, out):
    """Fit the first 60 % of the UR10 bag, test on the rest."""
    bag = bags / 'ur10_exciting'
    found = fit(out, 'ur10.yaml', [f'{bag}@0-60%'], [f'{bag}@60-100%'])
    row('UR10, first 60 % to last 40 %', 'relative error (authors 8.5 %)',
        100 * found['effort']['analytical']['relative_error'], 6.3, at_most=True)


def merit(csv, out):
    """Fit the first half of a record of the real arm, test on the second."""
    bag = Path(out).parent / 'merit_bag'
    import_merit(csv, bag)
    found = fit(out, 'tudor.yaml', [f'{bag}@0-50%'], [f'{bag}@50-100%'])
    row('TUDOR arm (MERIt exp1), not actively damped, halves', 'strain fit, four gauges',
        found['strain']['analytical']['fit'], 78.0)
    channels = [found['strain']['analytical']['channels'][name]
                for name in ('link2_hub', 'link3_hub')]
    spread = [c['rmse'] / (1 - c['fit'] / 100) for c in channels]
    error = sum(c['rmse'] ** 2 for c in channels) / sum(value ** 2 for value in spread)
    row('TUDOR arm (MERIt exp1), not actively damped, halves', 'strain fit, hub gauges',
        100 * (1 - error ** 0.5), 78.0)


def data_directory(purpose):
    """Read from the command line where the recordings are."""
    parser = argparse.ArgumentParser(description=purpose)
    parser.add_argument('--data', type=Path,
                        default=Path(os.environ.get('TUDOR_SHARED_DATA', '../shared/data')))
    return parser.parse_args().data


def main():
    """Go through the recordings that are there."""
    data = data_directory(__doc__.splitlines()[1])
    bags = data / 'bags'
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / 'model'
        for needed, run in ((bags / 'arm_200g_free_4', two_blade),
                            (bags / 'emps_validation', emps), (bags / 'ur10_exciting', ur10)):
            if needed.exists():
                run(bags, out)
            else:
                print(f'{needed}: not there, left out')
        if (data / 'merit_exp1.csv').exists():
            merit(data / 'merit_exp1.csv', out)
    show(HEAD, ROWS)


if __name__ == '__main__':
    main()
