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


"""Simulate, export as arrays and as a bag, read the bag back: export_a_run.png and a folder."""

import math
from pathlib import Path
import sys

import numpy as np

import tudor_dynamics as td

CONFIG = Path(__file__).resolve().parents[1] / 'config'


def main(out: Path) -> None:
    """Drive a joint by a function of the time, and save what comes of it."""
    arm = td.load_arm(CONFIG / 'elastic_arm.yaml')
    run = td.simulate(arm, {'joint2': lambda t: 4.6 + 1.5 * math.sin(9.0 * t)}, seconds=1.0,
                      dt=5e-4, rate=200.0, hold=['joint3'])
    run.plot('strain:link2_hub', out / 'export_a_run.png')
    run.save(out / 'export_a_run')
    recording = td.read_recording(out / 'export_a_run' / 'bag', arm)
    # a simulated run has torques, no motor currents, and joint3 is held: reading it warns of both
    with np.load(out / 'export_a_run' / 'run.npz') as arrays:
        difference = np.abs(recording.strain - arrays['strain']).max()
    print(run, recording, f'largest difference of the strains: {difference:g} um/m', sep='\n')


if __name__ == '__main__':
    main(Path(sys.argv[1] if len(sys.argv) > 1 else '.'))
