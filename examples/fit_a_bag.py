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


"""Learn models from two bags, and draw what they predict for a third: fit_a_bag.png."""

from pathlib import Path
import sys

import tudor_dynamics as td

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path) -> None:
    """Fit, predict, plot."""
    arm = td.load_arm(ROOT / 'config' / 'two_blade_arm.yaml')
    bags = [ROOT / 'bags' / 'two_blade_train_1', ROOT / 'bags' / 'two_blade_train_2']
    models = td.fit(bags, arm)
    prediction = td.predict(models, ROOT / 'bags' / 'two_blade_test')
    prediction.plot(out / 'fit_a_bag.png', output='strain')
    print(models, prediction, sep='\n')


if __name__ == '__main__':
    main(Path(sys.argv[1] if len(sys.argv) > 1 else '.'))
