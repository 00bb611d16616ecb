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
Judge an elastic model by bags that begin in motion, with more and less strain to begin with.

How the links oscillate at the beginning of such a bag is unknown. Each row gives the fit over all
samples, and over those after 12 s alone, which no correction reaches, when strain corrects the
state for so many seconds.

    python bench/elastic_beginnings.py [--training BAG BAG ... --test BAG ... --arm ARM]
"""

from __future__ import annotations

import argparse
from pathlib import Path
import warnings

import numpy as np
from tables import show

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.errors import TudorWarning
from tudor_dynamics.identification.dataset import load, parse_choice
from tudor_dynamics.identification.fit import fit_models, FitSettings
from tudor_dynamics.identification.validation import cases_of, score, validated
from tudor_dynamics.models.elastic import model as elastic

HERE = Path(__file__).parent.parent
SECONDS = (0.0, 1.0, 2.0, 4.0, 6.0, 8.0)
FREE = 12.0  # from when on the last column counts [s]


def main() -> None:
    """Fit once, judge several times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--training', nargs='+', default=[
        str(HERE / 'bags' / f'two_blade_train_{k}') for k in (1, 2)])
    parser.add_argument('--test', nargs='+', default=[str(HERE / 'bags' / 'two_blade_test')])
    parser.add_argument('--arm', default=str(HERE / 'config' / 'two_blade_arm.yaml'))
    args = parser.parse_args()
    warnings.simplefilter('ignore', TudorWarning)
    arm = load_arm(args.arm)
    training, test = ([load(parse_choice(path), arm, arm.spec.preprocessing) for path in paths]
                      for paths in (args.training, args.test))
    models = {item.output: item.model for item in fit_models(
        arm, training, test, None, arm.spec.preprocessing, FitSettings(kinds=('elastic',))).fitted}
    rows = []
    for seconds in SECONDS:
        elastic.OBSERVED = seconds
        row = [f'{seconds:g} s']
        for output, model in models.items():
            found = validated(cases_of(model, test), output, 'test')
            measured, predicted = (np.vstack([
                getattr(trace, part)[trace.t >= trace.t[0] + FREE] for trace in found.traces])
                for part in ('measured', 'predicted'))
            after = score(measured, predicted, found.channels)
            row += [f'{found.score.fit:.1f} %', f'{after.fit:.1f} %']
        rows.append(row)
    head = ['strain corrects for', *(text for output in models for text in (
        f'fit of {output}', f'after {FREE:g} s'))]
    show(head, rows)


if __name__ == '__main__':
    main()
