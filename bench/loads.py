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
Loads of the reference recordings, estimated by models of other ones.

The two-blade arm of an independent simulation by models of 0 and 200 g, recordings as a whole and
sample by sample; the UR10e with 2.8 kg by its currents. DATA is that of ``reference_fits.py``.

    python bench/loads.py --data DATA
"""

from __future__ import annotations

from pathlib import Path
import sys
import tempfile

from reference_fits import CONFIG, data_directory, tudor
from tables import show
import tudor_dynamics as td

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from papers.following import follow_load  # noqa: E402, I100

BLADES = ('arm_200g_free_2', 'arm_200g_free_3', 'arm_200g_free_4', 'arm_000g_undamped_1')
LOADED = 2.805
"""What the UR10e carries in its second recording [kg]."""


def masses(found):
    """Write masses and standard deviations [kg], grams where they are small."""
    return '; '.join(f'{1e3 * mass:.1f} ± {1e3 * std:.1f} g' if mass < 1.0 and std < 0.01 else
                     f'{mass:.2f} ± {std:.2f} kg' for mass, std in found)


def estimated(out, bags):
    """Give the masses of bags as text."""
    found = tudor('payload', *bags, '--model', out, '--json')['bags'].values()
    return masses((item['mass'], item['mass_std']) for item in found)


def fit(out, arm, training, *options):
    """Fit to bags with their loads [kg]."""
    tudor('fit', *training, '--payload-of', *(f'{str(bag).partition("@")[0]}={mass}'
                                              for bag, mass in training.items()),
          '--arm', arm, '--out', out, '--overwrite', '--exit-zero', *options)


def main():
    """Go through the recordings."""
    data = data_directory(__doc__.splitlines()[1])
    bags, rows = data / 'bags', []
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / 'model'
        fit(out, CONFIG / 'two_blade_arm.yaml',
            {bags / 'arm_000g_free_1': 0.0, bags / 'arm_200g_free_1': 0.2})
        tests = [bags / name for name in BLADES]
        rows.append(('two blades, recordings', '200 g three times, 0 g', estimated(out, tests)))
        model = td.load_bundle(out)
        ends = [follow_load(model, td.read_recording(bag, model.arm), 0.0) for bag in tests]
        rows.append(('two blades, the same, sample by sample, at the end', rows[-1][1], masses(
            (float(item.mass[-1]), float(item.std[-1])) for item in ends)))
        empty, full = bags / 'ur10e_unloaded', bags / 'ur10e_loaded'
        halves = {f'{empty}@0-50%': 0.0, f'{full}@0-50%': LOADED}
        for what, options in (
                ('as `tudor fit` chooses', ()), ('`--currents shared --friction viscous coulomb`',
                                                 ('--currents', 'shared', '--friction', 'viscous',
                                                  'coulomb'))):
            fit(out, data / 'arms/ur10e.yaml', halves, *options)
            rows.append((f'UR10e, halves to halves, {what}', f'0 and {LOADED} kg', estimated(
                out, [f'{empty}@50-100%', f'{full}@50-100%'])))
        fit(out, data / 'arms/ur10e_gains.yaml', {empty: 0.0})
        rows.append(('UR10e with published gains, model without a load', f'{LOADED} kg',
                     estimated(out, [full])))
    show(('recordings', 'carried', 'estimated'), rows)


if __name__ == '__main__':
    main()
