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
Find the frequency at which a tool rings in efforts, and no ring in arms that are still.

Of the recordings of a beam (TUDOR_SHARED_DATA, by default ../shared/data) triples are drawn from
the 27 translations; the loudest ring of each orientation in a triple is compared with 2.770 Hz
(beam up), 2.943 (level) and 3.039 (down), damping ratio 0.015 to 0.021. Thresholds were chosen on
the beam held up and down. Of other arms, which are still, every ring would be a false one.
"""

from __future__ import annotations

from itertools import combinations
import json
import os
from pathlib import Path
import sys
import warnings

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from tudor_dynamics.arm.description import load_arm  # noqa: E402
from tudor_dynamics.identification.dataset import load, parse_choice  # noqa: E402
from tudor_dynamics.identification.ringdowns import loudest_ring, Ring  # noqa: E402

DATA = Path(os.environ.get('TUDOR_SHARED_DATA', ROOT / '../shared/data'))
FREQUENCY = {'up': 2.770, 'level': 2.943, 'down': 3.039}
DAMPING = (0.015, 0.021)
STILL = {'ur10_': ROOT / 'config/ur10.yaml', 'ur10e_': DATA / 'arms/ur10e.yaml',
         'emps_': ROOT / 'config/emps.yaml', 'airbot_': DATA / 'arms/airbot.yaml',
         'tx40_': DATA / 'arms/tx40.yaml', 'arm_200g_': ROOT / 'config/two_blade_arm.yaml'}


def ring_of(bag: Path, arm_file: Path) -> Ring | None:
    """Find what rings in a bag."""
    arm = load_arm(arm_file)
    data = load(parse_choice(str(bag)), arm, arm.spec.preprocessing, learn=False)
    return loudest_ring(data.recording)


def main() -> int:
    """Measure and print as JSON."""
    warnings.simplefilter('ignore')
    rings = {bag.name: ring_of(bag, DATA / 'arms/panda.yaml')
             for bag in sorted((DATA / 'bags').glob('beam_*'))}
    runs = [(name, ring, name.split('_')[2]) for name, ring in rings.items() if '_est_' in name]
    off: list[tuple[float, float]] = []
    for triple in combinations(runs, 3):
        worst = [0.0, 0.0]
        for pose, truth in FREQUENCY.items():
            own = [ring for _, ring, where in triple if ring is not None and where == pose]
            if not own:
                continue
            loud = max(own, key=lambda ring: float(np.abs(ring.amplitude).max()))
            beyond = max(DAMPING[0] - loud.damping, loud.damping - DAMPING[1], 0.0)
            worst = [max(worst[0], abs(loud.frequency / truth - 1.0)), max(worst[1], beyond)]
        off.append((worst[0], worst[1]))
    false = {bag.name: ring.frequency for start, arm in STILL.items()
             for bag in sorted((DATA / 'bags').glob(f'{start}*'))
             if (ring := ring_of(bag, arm)) is not None}
    still = sum(1 for start in STILL for _ in (DATA / 'bags').glob(f'{start}*'))
    errors = np.array(off)
    print(json.dumps({
        'rings_named': f'{sum(ring is not None for ring in rings.values())} of {len(rings)}',
        'not_named': [name for name, ring in rings.items() if ring is None],
        'triples': len(off),
        'frequency_within_1_percent': float(np.mean(errors[:, 0] < 0.01)),
        'damping_within_0.005': float(np.mean(errors[:, 1] < 0.005)),
        'largest_frequency_error': float(errors[:, 0].max()),
        'still_bags': still, 'false_rings': false}, indent=2))
    return 0


if __name__ == '__main__':
    sys.exit(main())
