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
What is claimed, on an arm that nothing was developed with: MuJoCo's, of `other_plant/plant.py`.

Its arm has two blades with two gauges each, drives and sensors of its own, and gears that are
rigid, elastic, or have play (--gears). The description is that of the sample recordings, which
guesses elastic gears with play. One elastic model is identified from 80 s with 0 g and 80 s with
400 g, damped by strain; everything else is other motion with other loads:

fit        strain explained on unseen loads, 150 g damped and 250 g not damped, and the gears found
simple     error that gears with play, without, and rigid ones leave on the last third
           (for SIMPLE of identification/elastic_search.py; not run unless asked for)
payload    mass of 150 and 350 g, estimated from a recording each
changes    loads picked up and dropped, unannounced: when they are told from touches, and mass
rest       pushes beyond the second gauge while the arm stands: place and force
motion     pushes anywhere while it moves, 200 g, not damped: link, place, force, delay of events

A place counts as within its deviation where the error is at most twice it. Bags and the model are
kept in --work.

    python bench/other_plant.py --work DIR [--gears rigid] [--only fit payload changes ...]
    python bench/other_plant.py --work DIR --only simple --gears play
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
import sys
import time
from typing import Any
import warnings

import numpy as np
from other_plant.plant import (
    first_frequency, FloatArray, GAUGES, GEAR, JOINTS, LENGTH, motion, Options, PLAY, Push, record,
    STIFFNESS)
from tables import show
import tudor_dynamics as td
from tudor_dynamics.identification import dataset
from tudor_dynamics.identification.elastic_problem import Problem, records_of
from tudor_dynamics.identification.elastic_search import (
    descend, GEAR_KINDS, JUDGED, knowledge_of, LEARNED)
from tudor_dynamics.models.settings import RIGID_GEAR
import yaml

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from papers.following import follow_load  # noqa: E402, I100

ROOT = Path(__file__).parent.parent
ENDS = (0.0, 0.4)
"""Loads of the recordings that the model is identified from [kg]."""
SECONDS, SLOT, FIRST = 80.0, 2.0, 3.0
"""Of a recording, for each push in it, before the first one [s]."""
FELT = 1.0
"""Pushes with less across the link do not count [N]."""
RESTING = 10
CHANGES, APART, BEGIN = 12, (4.0, 6.0), 6.0
"""Changes of the load in a recording, between two of them, before the first one [s]."""
HEAVY = (0.1, 0.4)
"""Loads that are picked up [kg]."""


def description() -> td.Arm:
    """Describe the arm as that of the sample recordings, with its four gauges."""
    content = yaml.safe_load((ROOT / 'config/two_blade_arm.yaml').read_text())
    content['gauges'] = [{'name': name, 'joint': JOINTS[link], 'distance': place}
                         for name, link, place in GAUGES]
    return td.arm_from_dict(content, base=ROOT / 'config', source='two blades, four gauges')


class Bags:
    """Recordings of the plant, made where they are not there yet."""

    def __init__(self, work: Path, gears: str, seed: int) -> None:
        self.work, self.gears, self.seed = work / f'{gears}_{seed}', gears, seed
        self.work.mkdir(parents=True, exist_ok=True)

    def free(self, payload: float, number: int, *, damped: bool = True) -> Path:
        """Record free motion."""
        name = f'free_{1000 * payload:03.0f}g_{"damped" if damped else "undamped"}_{number}'
        seed = [self.seed, number, round(1000 * payload)]
        self._make(name, payload, damped, motion(SECONDS, np.random.default_rng(seed)), ())
        return self.work / name

    def changing(self, how: str, number: int) -> tuple[Path, tuple[tuple[float, float], ...]]:
        """Record loads that are picked up and dropped: damped, undamped, or at rest."""
        random = np.random.default_rng([self.seed, 70, number])
        times = BEGIN + np.cumsum(random.uniform(*APART, CHANGES)) - APART[0]
        loads = tuple((float(time), float(random.uniform(*HEAVY)) if k % 2 == 0 else 0.0)
                      for k, time in enumerate(times))
        moved = motion(float(times[-1]) + APART[1], random)
        if how == 'rest':
            moved = np.tile(random.uniform((0.3, -1.0), (2.5, 1.0)), (len(moved[0]), 1)), (
                0.0 * moved[1])
        name = f'changes_{how}_{number}'
        self._make(name, 0.0, how != 'undamped', moved, (), loads)
        return self.work / name, loads

    def pushed(self, number: int, pushes: int) -> tuple[Path, list[Push], FloatArray]:
        """Record pushes anywhere on the links of a moving arm, damped by nothing but itself."""
        random = np.random.default_rng([self.seed, 50, number])
        chosen = []
        for k in range(pushes):
            duration = float(random.uniform(0.3, 0.8))
            chosen.append(Push(
                FIRST + SLOT * k + float(random.uniform(0.0, SLOT - 1.5 * duration)), duration,
                int(random.integers(2)), float(random.uniform(0.2, 1.0)) * LENGTH,
                float(random.choice((-1.0, 1.0)) * random.uniform(2.0, 6.0))))
        moved = motion(FIRST + SLOT * pushes + 1.0, random)
        name = f'pushes_{number}'
        return self.work / name, chosen, self._make(name, 0.2, False, moved, tuple(chosen))

    def resting(self, number: int) -> tuple[Path, Push, FloatArray]:
        """Record a push beyond the second gauge of an arm that stands."""
        random = np.random.default_rng([self.seed, 90, number])
        pose = random.uniform((0.3, -1.0), (2.5, 1.0))
        push = Push(3.0, 9.0, number % 2, float(random.uniform(0.26, 0.39)),
                    float(random.choice((-1.0, 1.0)) * random.uniform(2.0, 5.0)), 0.2)
        name = f'rest_{number}'
        still = np.tile(pose, (12000, 1)), np.zeros((12000, 2))
        return self.work / name, push, self._make(name, 0.2, False, still, (push,))

    def _make(
        self, name: str, payload: float, damped: bool,
        moved: tuple[FloatArray, FloatArray], pushes: tuple[Push, ...],
        loads: tuple[tuple[float, float], ...] = (),
    ) -> FloatArray:
        truth = self.work / f'{name}.npy'
        if not truth.exists():
            options = Options(gears=self.gears, payload=payload, damped=damped, loads=loads)
            np.save(truth, record(self.work / name, options, moved, self.seed, pushes))
        return np.asarray(np.load(truth))


def identified(bags: Bags) -> td.ModelBundle:
    """Identify the arm, or take it from where it was kept."""
    folder = bags.work / 'model'
    if not folder.exists():
        begun = time.perf_counter()
        models = td.fit([bags.free(load, 0) for load in ENDS], description(),
                        test=[bags.free(load, 1) for load in ENDS], settings=td.FitSettings(
                            kinds=('analytical', 'elastic'), payloads=ENDS))
        td.save_bundle(models, folder)
        print(f'identified in {time.perf_counter() - begun:.0f} s')
    return td.load_bundle(folder)


def fit(bags: Bags, models: td.ModelBundle) -> None:
    """Print how much of the strain is explained on unseen loads, and which gears were found."""
    rows = []
    for load, damped in ((0.15, True), (0.25, False)):
        found = td.predict(models, [bags.free(load, 2, damped=damped)]).outputs['strain']
        rows.append((f'{1000 * load:.0f} g, {"" if damped else "not "}damped', *(
            f'{found[kind].score.fit:.1f}' for kind in ('analytical', 'elastic'))))
    show(('MuJoCo', 'strain: analytical', 'strain: elastic'), rows)
    model = models.models['strain']['elastic']
    assert isinstance(model, td.ElasticModel)
    print('found: ' + ', '.join(f'{item.name} {item.value:.4g}' for item in model.physical))


def simple(bags: Bags) -> None:
    """Print what gears of a kind leave on the last third, identified from the others."""
    arm = description()
    records = records_of([replace(
        dataset.load(dataset.parse_choice(str(bags.free(mass, 0))), arm, arm.spec.preprocessing),
        payload=mass) for mass in ENDS])
    parts = [record.head(LEARNED * float(record.dt[1:].sum())) for record in records]
    rest = [replace(record, skip=len(part.q)) for record, part in zip(records, parts, strict=True)]
    known = knowledge_of(arm, payload=False).without('lag')
    start = dict(known.start) | {f'play({joint})': PLAY if bags.gears == 'play' else 1e-4
                                 for joint in JOINTS}
    link = 3.0 * STIFFNESS / LENGTH
    bent = {f'bending({joint})': STIFFNESS / (1.0 + link / gear)
            for joint, gear in zip(JOINTS, GEAR, strict=True)}
    rows, least = [], 0.0
    for name, kinds, begun in (('with play', (), start), (
            'without', ('play', 'edge', 'loose'), start), ('rigid', GEAR_KINDS, start | bent)):
        held = {f'{kind}({joint})': {'play': 0.0, 'gear': RIGID_GEAR * link}.get(
            kind, start[f'{kind}({joint})']) for kind in kinds for joint in JOINTS}
        one = known.holding(held)

        def problem(some: Any) -> Problem:
            return Problem(arm, some, one.names, one.held, one.center, one.width_of)  # noqa: B023
        x = descend(problem(parts), np.log([begun[name] for name in one.names]), JUDGED,
                    lambda _: None)
        error = 100.0 - problem(rest).fits([x])[0]
        least = least or error
        rows.append((bags.gears, name, f'{error:.2f} %', f'{error / least:.2f}'))
    show(('gears', 'called', 'error on the last third', 'over that with play'), rows)


def payload(bags: Bags, models: td.ModelBundle) -> None:
    """Print masses estimated from one recording each."""
    found = {load: td.carried(models, [bags.free(load, 2)]) for load in (0.15, 0.35)}
    show(('load', 'estimated'), ((f'{1000 * load:.0f} g', f'{1e3 * item.mass:.1f} ± '
                                  f'{1e3 * item.mass_std:.1f} g') for load, item in found.items()))


def changes(bags: Bags, models: td.ModelBundle, count: int) -> None:
    """Print what a monitor says of loads that nobody announces."""
    rows = []
    for how in ('damped', 'undamped', 'rest'):
        delays: list[float] = []
        errors: list[float] = []
        known = alarms = 0
        for number in range(count):
            path, loads = bags.changing(how, number)
            seen = follow_load(models, td.read_recording(path, models.arm), 0.0)
            times, found = np.array(seen.times), np.array([load.mass for load in seen.loads])
            for (begin, mass), (end, _) in pairwise((*loads, (loads[-1][0] + APART[0], 0.0))):
                known += 1
                inside = (times > begin) & (times < end)
                right = inside & (np.abs(found - mass) < 0.3 * max(mass, HEAVY[0]))
                alarms += sum(begin < time < end for time in seen.events)
                if right.any():
                    delays.append(float(times[right][0]) - begin)
                two = int(np.searchsorted(seen.t, begin + 2.0))
                errors.append(1e3 * abs(float(seen.mass[two]) - mass))
        rows.append((how, f'{known}', *(
            f'{np.sum(np.array(delays) < limit)}' for limit in (0.7, 1.0, 4.0)), f'{alarms}',
            f'{np.median(errors):.1f} g', f'{np.mean(np.array(errors) < 5.0):.0%}'))
    show(('loads changed', 'n', 'recognised in 0.7 s', '1 s', '4 s', 'collisions before that',
          'mass after 2 s', 'within 5 g'), rows)


def rest(bags: Bags, models: td.ModelBundle) -> tuple[str, ...]:
    """Give place and force of pushes on an arm that stands."""
    rows = []
    for number in range(RESTING):
        path, push, _ = bags.resting(number)
        recording = td.read_recording(path, models.arm)
        estimator = td.ContactEstimator(models, 'elastic')
        record_of, still = estimator.record(), np.zeros(len(models.arm.active_joints))
        for t, stamp, q, strain in zip(recording.t, recording.stamp, recording.q,
                                       recording.strain, strict=True):
            found = estimator.step(int(stamp), t == 0.0, np.concatenate([q, still, still]),
                                   strain, None)
            if found is not None and 5.0 < t < 6.0:
                record_of.add(found)
        rows.append(compared(push, push.force, record_of.summary()))
    return summary('at rest, beyond the second gauge', rows)


def moving(
    bags: Bags, models: td.ModelBundle, count: int, pushes: int,
) -> list[tuple[str, ...]]:
    """Give link, place and force of events by pushes on a moving arm."""
    rows: list[dict[str, Any]] = []
    delays: list[float] = []
    false = known = 0
    for number in range(count):
        path, chosen, truth = bags.pushed(number, pushes)
        settings = td.MonitorSettings(kind='elastic', methods=('strain',), contact=True)
        watched, = next(item for item in td.detect(models, path, settings)
                        if item.method == 'strain').watched
        begin = watched.truth.pushes
        for push, force, mark in zip(chosen, truth, begin, strict=True):
            if abs(force) < FELT:
                continue
            known += 1
            events = [seen for seen in watched.sightings
                      if mark.begin <= seen.event.stamp <= mark.end + 300_000_000]
            if events:
                delays.append((events[0].event.stamp - mark.begin) * 1e-6)
                rows.append(compared(push, float(force), events[0].contact))
        false += sum(seen.push is None for seen in watched.sightings)
    print(f'{len(rows)} of {known} pushes in motion detected, delay {np.median(delays):.0f} ms '
          f'(95 %: {np.percentile(delays, 95):.0f}), {false} false')
    parts = {'in motion, anywhere on the links': rows}
    for link, name in enumerate(('inner', 'outer')):
        for what, low, high in (('inboard of', 0.0, 0.24), ('beyond', 0.24, 1.0)):
            parts[f'{name} link, {what} its second gauge'] = [
                row for row in rows
                if row['push'].link == link and low <= row['push'].place < high]
    return [summary(what, part) for what, part in parts.items() if part]


def compared(push: Push, force: float, found: dict[str, Any] | None) -> dict[str, Any]:
    """Compare what was found with a push; a wrong link, or none, is off by the whole link."""
    right = bool(found) and found is not None and found['link'] == JOINTS[push.link]
    placed = right and found is not None and found['place'] is not None
    off = abs(found['place'] - push.place) if placed and found is not None else LENGTH
    return {'push': push, 'right': right, 'placed': placed, 'off': off,
            'deviations': off / found['place_deviation'] if placed and found else np.nan,
            'force': abs(found['across'] / force - 1.0) if right and found else 1.0,
            'newton': abs(found['across'] - force) if right and found else abs(force),
            'peak': abs(found['peak'] / abs(push.force) - 1.0) if right and found else 1.0,
            'found': found}


def summary(what: str, rows: Sequence[dict[str, Any]]) -> tuple[str, ...]:
    """Give what a set of pushes came to, as cells of a table."""
    off, force, newton, peak = (float(np.median([row[name] for row in rows]))
                                for name in ('off', 'force', 'newton', 'peak'))
    right, placed = (float(np.mean([row[name] for row in rows])) for name in ('right', 'placed'))
    sure = np.array([row['deviations'] for row in rows if row['placed']] or [np.inf])
    return (what, f'{len(rows)}', f'{right:.0%}', f'{placed:.0%}', f'{1e3 * off:.1f} mm',
            f'{force:.1%}, {newton:.2f} N', f'{peak:.0%}', f'{np.mean(sure <= 2.0):.0%}')


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--work', type=Path, required=True, help='directory for bags and models')
    parser.add_argument('--gears', choices=('rigid', 'elastic', 'play'), default='rigid')
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--runs', type=int, default=2, help='recordings of pushes in motion')
    parser.add_argument('--pushes', type=int, default=30, help='in each of them')
    parser.add_argument('--only', nargs='+', default=(parts := (
                        'fit', 'payload', 'changes', 'rest', 'motion')),
                        choices=(*parts, 'simple'))
    args = parser.parse_args()
    warnings.simplefilter('ignore', UserWarning)  # recordings are known to be the plant's
    bags = Bags(args.work, args.gears, args.seed)
    print(f'gears {args.gears}: first vibration with 200 g at '
          f'{first_frequency(Options(gears=args.gears)):.2f} Hz')
    if 'simple' in args.only:
        simple(bags)
    if not {*args.only} - {'simple'}:
        return
    models = identified(bags)
    if 'fit' in args.only:
        fit(bags, models)
    if 'payload' in args.only:
        payload(bags, models)
    if 'changes' in args.only:
        changes(bags, models, args.runs)
    carrying = models.at(0.2)
    rows = [rest(bags, carrying)] if 'rest' in args.only else []
    if 'motion' in args.only:
        rows += moving(bags, carrying, args.runs, args.pushes)
    show(('pushes', 'n', 'right link', 'a place', 'median error of the place', 'of the force',
          'of its peak', 'within two deviations'), rows)


if __name__ == '__main__':
    main()
