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


"""How the frequencies of an arm fall with what it carries: sweep_of_modes.png."""

from pathlib import Path
import sys

from matplotlib.figure import Figure
import numpy as np
import tudor_dynamics as td
import yaml

CONFIG = Path(__file__).resolve().parents[1] / 'config'


def main(out: Path) -> None:
    """Change one value of the description, and ask for the modes each time."""
    source = CONFIG / 'elastic_arm.yaml'
    content = yaml.safe_load(source.read_text())
    masses = np.linspace(0.0, 0.4, 9)
    found = []
    for mass in masses.tolist():
        content['payload'] = {'mass': mass}
        arm = td.arm_from_dict(content, base=CONFIG, source=source.name)
        found.append(td.modes(arm, 3).frequency)
    print(f'first mode: {found[0][0]:.2f} Hz empty, {found[-1][0]:.2f} Hz with 400 g')
    figure = Figure(figsize=(6.4, 3.6), layout='constrained')
    axes = figure.subplots()
    for mode, marker in enumerate('os^'):
        axes.semilogy(1e3 * masses, [item[mode] for item in found], marker=marker,
                      label=f'mode {mode + 1}')
    figure.legend(loc='outside upper right', frameon=False, ncols=3)
    axes.set_yticks([2, 3, 5, 10], ['2', '3', '5', '10'])
    axes.set_yticks([], minor=True)
    axes.set(xlabel='payload [g]', ylabel='frequency [Hz]', title='Lowest modes, joints held')
    axes.grid(alpha=0.3, which='both')
    figure.savefig(out / 'sweep_of_modes.png', dpi=110)


if __name__ == '__main__':
    main(Path(sys.argv[1] if len(sys.argv) > 1 else '.'))
