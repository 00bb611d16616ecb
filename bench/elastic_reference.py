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
The elastic model on the reference recordings, beside the other models; some minutes.

Strain and effort on recordings it was not identified from, collisions with thresholds learned
from free motion. DATA is that of ``reference_fits.py``.

    python bench/elastic_reference.py --data DATA
"""

from __future__ import annotations

from pathlib import Path
import tempfile

from reference_fits import CONFIG, data_directory, fit, import_merit, tudor
from tables import PUSHES, pushes as scored, show

KINDS = ('analytical', 'elm', 'elastic')
FLOORS = {'free': 97.0, 'undamped': 94.0, 'merit': 84.0}


def judge(name, floor, out, arm, training, test, *, unseen=False):
    """
    Give the fits of all models on a test recording, as cells of a table.

    With ``unseen`` the fit knows nothing of the test, so thresholds come from the training bags,
    each judged by models of the others.
    """
    if unseen:
        said = tudor('fit', *training, '--arm', CONFIG / arm, '--out', out, '--overwrite',
                     '--json', '--models', *KINDS)
        found = {**tudor('evaluate', '--model', out, *test, '--json'),
                 'seconds': said['seconds']}
    else:
        found = fit(out, arm, training, test, '--models', *KINDS)
    cells = [f'{found[output][kind]["fit"]:.1f}' for output in ('strain', 'effort')
             for kind in KINDS]
    short = '' if found['strain']['elastic']['fit'] >= floor else ', **falls short**'
    return (name, *cells, f'≥ {floor:g}{short}')


def pushes(bags, out):
    """Print the pushes that the model which is there detects, by each method."""
    rows = []
    for kind in ('analytical', 'elastic'):
        for bag in ('arm_200g_pushes', 'arm_200g_free_4'):
            said = tudor('evaluate', '--model', out, bags / bag, '--collisions', '--kind', kind,
                         '--json', *(['--free'] if 'free' in bag else []))
            rows += [(bag, kind, method, *scored(score))
                     for method, score in said['collisions'].items()]
    show(('recording', 'model', 'method', *PUSHES), rows)


def main():
    """Go through the recordings that are there."""
    data = data_directory(__doc__.splitlines()[1])
    bags = data / 'bags'
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / 'model'
        rows = []
        if (bags / 'arm_200g_free_4').exists():
            rows.append(judge(
                'independent simulation, 200 g, damped; three bags of 80 s to a fourth',
                FLOORS['free'], out, 'two_blade_arm.yaml',
                [bags / f'arm_200g_free_{i}' for i in (1, 2, 3)], [bags / 'arm_200g_free_4'],
                unseen=True))
            pushes(bags, out)
        if (bags / 'arm_000g_undamped_1').exists():
            bag = bags / 'arm_000g_undamped_1'
            rows.append(judge('same, 0 g, not damped; halves of one bag', FLOORS['undamped'], out,
                              'two_blade_arm.yaml', [f'{bag}@0-50%'], [f'{bag}@50-100%']))
        if (data / 'merit_exp1.csv').exists():
            bag = Path(folder) / 'merit_bag'
            import_merit(data / 'merit_exp1.csv', bag)
            rows.append(judge('the real arm (MERIt exp1), not actively damped; halves',
                              FLOORS['merit'], out, 'tudor.yaml', [f'{bag}@0-50%'],
                              [f'{bag}@50-100%']))
    show(('recording', *(f'{output}: {kind}' for output in ('strain', 'effort') for kind in KINDS),
          'strain, elastic: must reach'), rows)


if __name__ == '__main__':
    main()
