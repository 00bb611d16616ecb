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
Gauges that were glued again, or whose zero has moved: what `tudor evaluate` says of them.

A model is fitted to some bags; in other ones the gain of one gauge is changed, or its zero. Each
is also looked at as it is, and with a load that the model is not told of: every gauge that is
named then is a false one. The bags are the recordings of the two-blade arm (TUDOR_SHARED_DATA, by
default ../shared/data), and with --work some of the arm in MuJoCo, with two gauges a link, which
are made there.

    python bench/changed_gauges.py [--work DIR]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
import os
from pathlib import Path
import warnings

import numpy as np
from other_plant.plant import GAUGES, JOINTS, motion, Options, record
from tables import show
import tudor_dynamics as td
from tudor_dynamics.identification.dataset import BagData, load, parse_choice
from tudor_dynamics.identification.doctor.between import examine_evaluation
import yaml

ROOT = Path(__file__).parent.parent
DATA = Path(os.environ.get('TUDOR_SHARED_DATA', ROOT / '../shared/data')) / 'bags'
PARTS = ('', '@0-40%', '@60-100%')
GAINS, ZEROS = (0.95, 0.97, 1.03, 1.05, 1.1), (-30.0, -15.0, 15.0, 30.0)
"""Factors, and what is added [um/m]."""


@dataclass
class Count:
    """How often a change was named."""

    right: int = 0
    other: int = 0
    silent: int = 0
    errors: tuple[float, ...] = ()


def named(models: td.ModelBundle, data: BagData) -> dict[str, tuple[str, float]]:
    """Give kind and size of what is said of each gauge."""
    return {item.channels[0]: (item.kind, item.size or 0.0)
            for item in examine_evaluation(models, [data]).findings
            if item.kind in ('gauge_gain', 'gauge_zero')}


def changed(data: BagData, gauge: int, gain: float, zero: float) -> BagData:
    """Change what one gauge reads."""
    strain = np.array(data.recording.strain)
    strain[:, gauge] = gain * strain[:, gauge] + zero
    return replace(data, recording=replace(data.recording, strain=strain))


def two_blades() -> Iterator[tuple[td.ModelBundle, list[Path], list[Path]]]:
    """Give models of real recordings, others with their load, and some with another one."""
    arm = td.load_arm(ROOT / 'config/two_blade_arm.yaml')
    settings = td.FitSettings(kinds=('analytical',))
    bags = [DATA / f'arm_200g_free_{k}' for k in (1, 2, 3, 4)]
    for first in (0, 2):
        models = td.fit(bags[first:first + 2], arm, test=[bags[2 - first]], settings=settings)
        yield models, bags[2 - first:4 - first], [
            DATA / 'arm_000g_free_1', DATA / 'arm_000g_undamped_1']


def other_plant(work: Path) -> Iterator[tuple[td.ModelBundle, list[Path], list[Path]]]:
    """Give a model of the arm in MuJoCo, recordings that it has not seen, and other loads."""
    def recorded(payload: float, number: int, *, damped: bool = True) -> Path:
        path = work / f'gauges_{1000 * payload:03.0f}g_{number}_{damped}'
        if not path.exists():
            random = np.random.default_rng([11, number, round(1000 * payload)])
            record(path, Options(payload=payload, damped=damped), motion(80.0, random), 11)
        return path
    content = yaml.safe_load((ROOT / 'config/two_blade_arm.yaml').read_text())
    content['gauges'] = [{'name': name, 'joint': JOINTS[link], 'distance': place}
                         for name, link, place in GAUGES]
    arm = td.arm_from_dict(content, base=ROOT / 'config', source='two blades, four gauges')
    same = [recorded(0.2, 1), recorded(0.2, 2), recorded(0.2, 2, damped=False)]
    models = td.fit([recorded(0.2, 0)], arm, test=[same[0]], settings=td.FitSettings(
        kinds=('analytical',)))
    yield models, same, [recorded(load, 2) for load in (0.19, 0.23, 0.3)]


def main() -> None:
    """Look at all of them."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--work', type=Path, help='directory for bags of the arm in MuJoCo')
    args = parser.parse_args()
    warnings.simplefilter('ignore')
    rows = []
    for name, sets in (('two blades', two_blades()), *(
            [('MuJoCo', other_plant(args.work))] if args.work else [])):
        counts = {'gain': Count(), 'zero': Count()}
        false = looked = 0
        for models, same, others in sets:
            for path in (*same, *others):
                for part in PARTS:
                    data = load(parse_choice(f'{path}{part}'), models.arm, models.preprocessing,
                                whole=True)
                    looked += 1
                    false += bool(named(models, data))
                    if path in others:
                        continue
                    for gauge, label in enumerate(models.arm.gauge_names):
                        for gain, zero in ([(gain, 0.0) for gain in GAINS]
                                           + [(1.0, zero) for zero in ZEROS]):
                            kind = 'zero' if zero else 'gain'
                            said = named(models, changed(data, gauge, gain, zero))
                            count = counts[kind]
                            if set(said) == {label} and said[label][0] == f'gauge_{kind}':
                                count.right += 1
                                count.errors += (abs(said[label][1] - (zero or gain)),)
                            elif said:
                                count.other += 1
                            else:
                                count.silent += 1
        for kind, count in counts.items():
            error = np.median(count.errors or [np.nan]), max(count.errors, default=np.nan)
            rows.append((name, kind, f'{count.right}', f'{count.other}', f'{count.silent}',
                         '{:.1%}, {:.1%}'.format(*error) if kind == 'gain'
                         else '{:.1f}, {:.1f} um/m'.format(*error), f'{false} of {looked}'))
    show(('arm', 'changed', 'named', 'named wrong', 'silent', 'error of the size: median, largest',
          'false ones, nothing or the load changed'), rows)


if __name__ == '__main__':
    main()
