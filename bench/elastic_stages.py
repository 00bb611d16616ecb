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
Show what a last phase of the elastic search would bring in which nothing draws the arm.

Run with ``OMP_NUM_THREADS=1 python bench/elastic_stages.py ARM.yaml BAG...``. Each bag is cut in
halves; the search learns from the first. The fit of both halves follows [%], as the search ends
and after more such phases, each begun where the one before ended. Behind it, how far the fit of
the second half is spread among parameters that differ by 1e-4.
"""

from __future__ import annotations

import argparse

import numpy as np

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.identification.dataset import load, parse_choice
from tudor_dynamics.identification.elastic_problem import fit_percent, Problem, records_of
from tudor_dynamics.identification.elastic_search import (
    descend, identify, knowledge_of, SearchPhase)
from tudor_dynamics.models.settings import INNER_STEP
from tudor_dynamics.typing import FloatArray

BANDWIDTHS = (0.3, 0.0)
SPREAD, COUNT = 1e-4, 8


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('arm', help='arm description')
    parser.add_argument('bag', nargs='+', help='recordings with strain')
    options = parser.parse_args()
    arm = load_arm(options.arm)
    print(f'{"":34} {"train":>7} {"unseen":>7} {"spread":>7}')
    for bag in options.bag:
        known, unseen = (records_of([load(parse_choice(f'{bag}@{half}'), arm,
                                          arm.spec.preprocessing, learn=True)])
                         for half in ('0-50%', '50-100%'))
        found = {p.name: p.value for p in identify(arm, known).physical}
        about = knowledge_of(arm, payload=known[0].payload is None)
        names = tuple(name for name in about.names if name in found)
        kept = [about.names.index(name) for name in names]
        x = np.log([found[name] for name in names])
        problems = [Problem(arm, records, names, {}, about.center[kept], about.width_of[kept])
                    for records in (known, unseen)]
        tell(f'{bag[-24:]} as found', problems, x)
        for bandwidth in BANDWIDTHS:
            phase = SearchPhase(bandwidth, INNER_STEP, 8, 1e-4)
            x = descend(problems[0], x, [phase], lambda _: None)
            tell(f'   drawn with {bandwidth:g} 1/s', problems, x)


def tell(name: str, problems: list[Problem], x: FloatArray) -> None:
    """Print a row: the gauges' gains and offsets are those of the first half."""
    moments = problems[0].moments(x)
    assert moments is not None
    gauges = problems[0].gauges(moments, x)
    train = fit_percent(problems[0].errors(moments, x), problems[0].strain)
    near = np.random.default_rng(0).normal(0.0, SPREAD, (COUNT, len(x)))
    near[0] = 0.0
    fits = [fit_percent(strain_errors(problems[1], x + off, gauges), problems[1].strain)
            for off in near]
    print(f'{name:34} {train:7.2f} {fits[0]:7.2f} {np.std(fits):7.2f}', flush=True)


def strain_errors(problem: Problem, x: FloatArray, gauges: FloatArray) -> FloatArray:
    """Give what gauges with these gains and offsets show beyond the simulation."""
    moments = problem.moments(x)
    assert moments is not None
    return np.asarray(problem.strain - moments * gauges[:, 0] - gauges[:, 1])


if __name__ == '__main__':
    main()
