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

"""The doctor compares bags with one another and with a model."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations
import math

import numpy as np

from tudor_dynamics.arm.description import Arm, OUTPUTS
from tudor_dynamics.errors import TudorError
from tudor_dynamics.identification import settings
from tudor_dynamics.identification.choice import Choices
from tudor_dynamics.identification.dataset import BagData, model_for
from tudor_dynamics.identification.doctor.case import Case, unit_scale
from tudor_dynamics.identification.doctor.examine import changed_gauges, examine_all, load_of
from tudor_dynamics.identification.doctor.findings import CHECKS, Finding, found
from tudor_dynamics.identification.loads import payload_of
from tudor_dynamics.load.offline import PayloadEstimate
from tudor_dynamics.load.rows import LoadRows
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.typing import FloatArray

SLOPE = 'ratio of measured to predicted output'


@dataclass(frozen=True, eq=False)
class Pair:
    """What the model of one bag makes of another."""

    # (channels,): measured over expected output, and how much that explains: friction and zero
    # left out where the rest shows enough, otherwise with friction.
    slope: FloatArray
    share: FloatArray
    # Kilograms at the tip that explain the rest, (channels,) [unit of the output].
    load: FloatArray
    carried: float  # part of the residual that remains with a body at the end of the arm
    error: float  # relative error of the prediction


Pairs = dict[tuple[int, int], Pair]
"""Bag that was learned from, and bag that was predicted, to its result."""


def compare(bags: Sequence[tuple[Case, float | None]]) -> list[Finding]:
    """Find the bag that differs from the others: each with the mass at its tip as stated [kg]."""
    findings: list[Finding] = []
    for output in OUTPUTS:
        some = [(case, payload) for case, payload in bags if output in case.outputs]
        if len(some) < 2:
            continue
        cases = [case for case, _ in some]
        pairs = {(i, j): pair(cases[i], cases[j], output)
                 for i, j in permutations(range(len(cases)), 2)}
        scaled = _scales(cases, pairs, output)
        findings += scaled
        if not scaled and not any(item.kind in ('payload_wrong', 'load_unknown')
                                  for item in findings):
            findings += _loads(cases, [payload for _, payload in some], pairs)
    return findings


def pair(one: Case, other: Case, output: str) -> Pair:
    """Let the least squares of one bag predict another bag."""
    known, explained = one.usual[output], other.usual[output]
    learned, measured = one.outputs[output], other.outputs[output]
    parameters = known.parameters(learned)
    channels = range(measured.shape[1])

    def freed(columns: Iterable[FloatArray]) -> FloatArray:
        return np.column_stack([explained.freed(i, x) for i, x in enumerate(columns)])

    bodies = [explained.bodies[i] @ parameters[i] for i in channels]
    expected, free = freed(bodies), freed(measured.T)
    slope, share = _slope(free, expected)
    with_friction = np.column_stack([
        bodies[i] + explained.own[i] @ known.own_parameters(i, learned[:, i], parameters[i])
        for i in channels])
    whole = _slope(measured - measured.mean(axis=0), with_friction - with_friction.mean(axis=0))
    slope, share = (np.where(share > settings.COMPARABLE, few, all_of_it)
                    for few, all_of_it in zip((slope, share), whole, strict=True))
    residual = free - expected
    carried = LoadRows(other.arm, output)
    kilogram = freed(carried.point(other.motion).T)
    loads = np.sum(kilogram * residual, axis=0) / np.maximum(np.sum(kilogram ** 2, axis=0), 1e-300)
    after = 0.0
    for i, rows in enumerate(np.moveaxis(carried.rows(other.motion), 1, 0)):
        columns = explained.freed(i, rows.T).T
        columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        values = np.linalg.lstsq(columns, residual[:, i], rcond=1e-6)[0]
        after += float(np.sum((residual[:, i] - columns @ values) ** 2))
    before = max(float(np.sum(residual ** 2)), 1e-300)
    return Pair(slope, share, loads, math.sqrt(after / before),
                math.sqrt(before / max(float(np.sum(free ** 2)), 1e-300)))


def _slope(measured: FloatArray, expected: FloatArray) -> tuple[FloatArray, FloatArray]:
    both = np.sum(measured * expected, axis=0)
    size = np.maximum(np.sum(expected ** 2, axis=0), 1e-300)
    return both / size, both ** 2 / size / np.maximum(np.sum(measured ** 2, axis=0), 1e-300)


def _scales(cases: Sequence[Case], pairs: Pairs, output: str) -> list[Finding]:
    """Find channels of one bag that are scaled or turned against all others."""
    scaled: dict[tuple[int, bool], list[tuple[str, float]]] = {}
    for channel, name in enumerate(cases[0].bodies[output].channels):
        slopes = {key: float(item.slope[channel]) if item.share[channel] > settings.COMPARABLE
                  else math.nan for key, item in pairs.items()}
        for j in range(len(cases)):
            others = [slope for (_, other), slope in slopes.items() if other == j]
            rest = [slope for key, slope in slopes.items() if j not in key]
            if not all(map(math.isfinite, others + rest)) or any(map(_differs, rest)):
                continue  # nothing is known, or another bag is the one that differs
            ratio = float(np.median(others))
            if not all(map(_differs, [ratio, *others])) or (
                    len(cases) == 2 and not _is_suspect(abs(ratio), j)):
                continue
            scaled.setdefault((j, _differs(abs(ratio))), []).append((name, unit_scale(ratio)))
    findings = []
    for (j, of_unit), found_there in scaled.items():
        names = tuple(name for name, _ in found_there)
        here, there = cases[j].recording.path, cases[0 if j else 1].recording.path
        what = f'{"effort of" if output == "effort" else "gauge"} {", ".join(map(repr, names))}'
        size = float(np.median([size for _, size in found_there])) if of_unit else -1.0
        kind, text, remedy = (
            f'{output}_unit', f'is {size:.3g} times as large as in {there}: the units differ',
            'give only bags that have the units of the arm description') if of_unit else (
            'effort_sign' if output == 'effort' else 'gauge_sign',
            f'has the opposite sign compared with {there}', CHECKS['gauge_sign'].remedy)
        findings.append(found(kind, f'{what} {text}', here, names, size=size, now=size,
                              otherwise=1.0, measure=SLOPE, remedy=remedy))
    return findings


def _differs(slope: float) -> bool:
    """Say whether a slope is that of another unit or sign."""
    return not 1.0 / settings.OTHER_UNIT < slope < settings.OTHER_UNIT


def _is_suspect(size: float, j: int) -> bool:
    """Say which of two bags is taken for the wrong one; nobody knows for a sign."""
    if not 1.0 / settings.THOUSANDTH_OF_BAGS <= size <= settings.THOUSANDTH_OF_BAGS:
        return size > 1.0  # thousandths of a unit are large numbers
    if not 1.0 / settings.OTHER_UNIT <= size <= settings.OTHER_UNIT:
        return size < 1.0  # currents are smaller than torques
    return j == 1


def _loads(cases: Sequence[Case], stated: Sequence[float | None], pairs: Pairs) -> list[Finding]:
    """Find the bag whose load is not that which it states."""
    n, names = len(cases), [case.recording.path for case in cases]
    # a bag that predicts another worse than nothing does is too poor to say what that carries
    differ = {key: item.carried < settings.LOAD_SHARE and settings.DIFFERENT < item.error < 1.0
              for key, item in pairs.items()}
    best = max(pairs.values(), key=lambda item: item.error)
    channel = int(np.argmax(np.abs(best.load) * np.sqrt(best.share)))
    # also of bags that are nearly alike: a small load is no load, but no other one either
    change = {key: float(item.load[channel]) for key, item in pairs.items()}
    masses = np.array(stated, dtype=float)
    if np.isnan(masses).any():
        return _heavier(names, differ, change)
    suspects = []  # by how much the stated mass is off, the bag, and the mass that it carries
    for j in range(n):
        rest = [key for key in pairs if j not in key]
        others = [a for a in range(n) if a != j]
        steps = np.array([masses[b] - masses[a] for a, b in rest])
        measured = np.array([change[key] for key in rest])
        if len(rest) and np.ptp(steps) > settings.LEAST_PAYLOAD:
            unit = float(steps @ measured) / float(steps @ steps)
            if unit == 0.0 or not all(differ[key] for key, step in zip(rest, steps, strict=True)
                                      if step):
                continue
            error = float(np.max(np.abs(measured / unit - steps)))
            mass = float(np.median([masses[a] + change[a, j] / unit for a in others]))
            if error < settings.PAYLOAD_OFF * float(np.ptp(steps)) / 2.0:
                suspects.append((abs(mass - masses[j]), j, mass))
        elif (n > 2 and not any(differ[key] for key in rest)
                and all(differ[a, j] for a in others)
                and all(abs(masses[a] - masses[j]) < settings.LEAST_PAYLOAD for a in others)):
            suspects.append((np.inf, j, np.nan))
    if not suspects:
        return _heavier(names, differ, change) if n == 2 and (
            abs(masses[0] - masses[1]) < settings.LEAST_PAYLOAD) else []
    chosen = [(j, mass) for off, j, mass in suspects if off >= settings.PAYLOAD_OFF * max(
        float(np.ptp(np.delete(masses, j))), settings.LEAST_PAYLOAD)]
    if not chosen:
        return []
    j, mass = chosen[0]
    if len(chosen) > 1:
        shown = ' and '.join(f'{masses[k]:g}' for k, _ in chosen)
        return [found('payload_wrong', f'the stated loads of {shown} kg contradict each '
                      'other, so one is wrong', ', '.join(names[k] for k, _ in chosen))]
    what = f'the stated load is {masses[j]:g} kg, but the other bags suggest'
    if math.isnan(mass):
        return [found('payload_wrong', f'{what} a different one', names[j])]
    mass = max(mass, 0.0)
    return [found('payload_wrong', f'{what} about {mass:.2g} kg', names[j], size=mass,
                  now=float(masses[j]), otherwise=mass)]


def _heavier(
    names: Sequence[str], differ: dict[tuple[int, int], bool],
    change: dict[tuple[int, int], float],
) -> list[Finding]:
    for (i, j), differs in differ.items():
        # where each bag carries more than the other it is no load: tools ring, drives drift
        if differs and differ[j, i] and change[i, j] * change[j, i] < 0.0:
            heavy, light = (j, i) if change[i, j] > 0.0 else (i, j)
            return [found(
                'load_unknown', f'the arm carries more in bag {names[heavy]!r} than in bag '
                f'{names[light]!r}',
                names[heavy], remedy='state the load of each bag with tudor fit --payload-of '
                'BAG=KG, or fit each bag separately')]
    return []


def examine_bags(
    arm: Arm, bags: Sequence[BagData], chosen: Choices | None = None,
) -> tuple[Finding, ...]:
    """Look at the bags of a fit, by what was chosen for it, or of an evaluation."""
    examined = examine_all(arm, bags, chosen)
    known = merged([item.findings for item in examined])
    # bags that are known to be wrong are no measure for the others
    sound = [(item.case, bag.payload) for bag, item in zip(bags, examined, strict=True)
             if item.case is not None and item.described]
    reported = {(item.kind, item.bag) for item in known}
    more = [item for item in compare(sound) if (item.kind, item.bag) not in reported]
    return tuple(more + known + copies(bags))


def merged(findings: Sequence[Sequence[Finding]]) -> list[Finding]:
    """Report once what several bags show alike."""
    groups: dict[tuple[str, tuple[str, ...], str], list[Finding]] = {}
    for i, of_bag in enumerate(findings):
        for item in of_bag:
            alone = f'{i}' if CHECKS[item.kind].one_bag else ''
            groups.setdefault((item.kind, item.channels, alone), []).append(item)
    once = [replace(group[0], bag=', '.join(dict.fromkeys(item.bag for item in group)))
            for group in groups.values()]
    return sorted(once, key=lambda item: -len(item.bag.split(', ')))


def copies(bags: Sequence[BagData]) -> list[Finding]:
    """Find bags that hold the same motion, in whatever storage and under whatever name."""
    findings = []
    for one, other in combinations(bags, 2):
        q = one.recording.q
        moves = np.flatnonzero(np.any(np.diff(q, axis=0) != 0.0, axis=1))
        # samples of a still arm are alike in all recordings
        rows = np.ascontiguousarray(q[moves[::max(1, len(moves) // settings.COMPARED)]])
        known = {row.tobytes() for row in np.ascontiguousarray(other.recording.q)}
        share = float(np.mean([row.tobytes() in known for row in rows])) if len(rows) else 0.0
        if share > settings.SAME_SHARE:
            findings.append(found(
                'same_recording', f'{one.choice} and {other.choice} hold the same samples',
                str(other.choice), size=share, now=share))
    return findings


@dataclass(frozen=True, eq=False)
class Evaluated:
    """What bags show of themselves, and compared with a model."""

    findings: tuple[Finding, ...]  # of both
    loads: dict[str, PayloadEstimate]  # what looks like a load, by bag


def examine_evaluation(bundle: ModelBundle, data: Sequence[BagData]) -> Evaluated:
    """Look at bags that a model is compared with."""
    findings, loads = [], {}
    for bag, examined in zip(data, examine_all(bundle.arm, data), strict=True):
        name = str(bag.choice)
        findings.append(list(examined.findings))
        if examined.case is None:
            continue
        predicted = {}
        for output, kinds in bundle.models.items():
            if 'analytical' in kinds and output in examined.case.outputs:
                try:
                    model = model_for(kinds['analytical'], bag)
                except TudorError:
                    continue  # its payload is not known, which is said elsewhere
                predicted[output] = model.predict(examined.case.motion)
        finding = load_of(examined.case, predicted)
        gauges = changed_gauges(
            examined.case, predicted['strain']) if 'strain' in predicted else []
        if gauges:
            findings[-1][:0] = gauges
        elif finding is not None:
            # how much it is, and as surely as that is known
            load = loads[name] = payload_of(bundle, [bag], 'analytical')
            size = None if math.isnan(load.mass) else load.mass - load.known
            findings[-1].insert(0, replace(
                finding, what=f'{finding.what}; {load.sentence}', size=size,
                unit='' if size is None else 'kg'))
    return Evaluated(tuple(merged(findings)), loads)
