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

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math

import numpy as np

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.errors import TudorError
from tudor_dynamics.identification.dataset import BagData, model_for
from tudor_dynamics.identification.doctor import settings
from tudor_dynamics.identification.doctor.case import Case
from tudor_dynamics.identification.doctor.examine import examine, Examined, load_of
from tudor_dynamics.identification.doctor.findings import CHECKS, Finding, found
from tudor_dynamics.identification.loads import payload_of
from tudor_dynamics.load.offline import PayloadEstimate
from tudor_dynamics.load.rows import LoadRows
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.typing import FloatArray


SLOPE = 'slope of the measured over the expected output'


@dataclass(frozen=True, eq=False)
class KnownBag:
    """A bag for the comparison."""

    name: str  # name of the bag
    case: Case  # bag with its arm
    payload: float | None = None  # mass at the tip as it is stated [kg]


@dataclass(frozen=True, eq=False)
class Pair:
    """What the model of one bag makes of another."""

    # (channels,): measured over expected output, and how much that explains: friction and zero
    # left out where the rest tells enough, otherwise with friction.
    slope: FloatArray
    share: FloatArray
    # Kilograms at the end of the arm that explain the rest, in units of the output, (channels,)
    # [unit].
    load: FloatArray
    carried: float  # part of the residual that a body at the end of the arm leaves
    error: float  # relative error of the prediction


def compare(bags: Sequence[KnownBag]) -> list[Finding]:
    """Find the bag that differs from the others."""
    findings: list[Finding] = []
    if len(bags) < 2:
        return findings
    for output in ('effort', 'strain'):
        some = [bag for bag in bags if output in bag.case.outputs]
        if len(some) < 2:
            continue
        pairs = {(i, j): pair(some[i].case, some[j].case, output)
                 for i in range(len(some)) for j in range(len(some)) if i != j}
        odd = _scales(some, pairs, output)
        findings += odd
        if not odd and not any(item.kind in ('payload_wrong', 'load_unknown')
                               for item in findings):
            findings += _loads(some, pairs)
    return findings


def pair(one: Case, other: Case, output: str) -> Pair:
    """Let the least squares of one bag predict another bag."""
    parameters = one.usual[output].parameters(one.outputs[output])
    explained = other.usual[output]
    measured = other.outputs[output]
    expected = np.column_stack([explained.freed(i, other.rows(output)[:, i] @ parameters[i])
                                for i in range(measured.shape[1])])
    free = np.column_stack([explained.freed(i, measured[:, i])
                            for i in range(measured.shape[1])])
    slope, share = _slope(free, expected)
    known = one.usual[output]
    with_friction = np.column_stack([
        explained.whole(i, parameters[i], known.of_own(i, one.outputs[output][:, i],
                                                       parameters[i]))
        for i in range(measured.shape[1])])
    whole = _slope(measured - measured.mean(axis=0), with_friction - with_friction.mean(axis=0))
    slope, share = (np.where(share > settings.COMPARABLE, few, all_of_it)
                    for few, all_of_it in zip((slope, share), whole, strict=True))
    total = np.sum(free ** 2, axis=0)
    left = free - expected
    carried = LoadRows(other.arm, output)
    rows, point = carried.rows(other.motion), carried.point(other.motion)
    after = np.zeros(len(total))
    loads = np.zeros(len(total))
    for i in range(len(total)):
        columns = np.column_stack([explained.freed(i, column) for column in rows[:, i].T])
        scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        values = np.linalg.lstsq(columns / scale, left[:, i], rcond=1e-6)[0]
        after[i] = np.sum((left[:, i] - columns / scale @ values) ** 2)
        kilogram = explained.freed(i, point[:, i])
        loads[i] = float(kilogram @ left[:, i]) / max(float(kilogram @ kilogram), 1e-300)
    before = np.sum(left ** 2, axis=0)
    return Pair(slope, share, loads,
                float(np.sqrt(after.sum() / max(before.sum(), 1e-300))),
                float(np.sqrt(before.sum() / max(total.sum(), 1e-300))))


def _slope(measured: FloatArray, expected: FloatArray) -> tuple[FloatArray, FloatArray]:
    both = np.sum(measured * expected, axis=0)
    size = np.maximum(np.sum(expected ** 2, axis=0), 1e-300)
    return both / size, both ** 2 / size / np.maximum(np.sum(measured ** 2, axis=0), 1e-300)


def _scales(
    bags: Sequence[KnownBag], pairs: dict[tuple[int, int], Pair], output: str,
) -> list[Finding]:
    """Find channels of one bag that are scaled or turned against all others."""
    n = len(bags)
    names = bags[0].case.bodies[output].channels
    scaled: dict[tuple[int, str], list[tuple[str, float]]] = {}
    for channel, name in enumerate(names):
        slopes = np.full((n, n), np.nan)
        for (i, j), item in pairs.items():
            if item.share[channel] > settings.COMPARABLE:
                slopes[i, j] = item.slope[channel]
        for j in range(n):
            others = slopes[[i for i in range(n) if i != j], j]
            rest = [slopes[a, b] for a in range(n) for b in range(n)
                    if a != b and j not in (a, b)]
            if not np.all(np.isfinite(others)) or not np.all(np.isfinite(rest)):
                continue
            if any(_odd(slope) for slope in rest):
                continue  # another bag is the odd one
            ratio = float(np.median(others))
            if not _odd(ratio) or not all(_odd(slope) for slope in others):
                continue
            if n == 2 and not _is_the_odd_one(ratio, j):
                continue
            size = abs(ratio)
            kind = 'unit' if not 1.0 / settings.OTHER_UNIT < size < settings.OTHER_UNIT else 'sign'
            rounded = next((exact for exact in (1e3, 1e-3) if 0.5 < size / exact < 2.0), 0.0)
            scaled.setdefault((j, kind), []).append((name, rounded or ratio))
    return [_other_scale(bags, j, kind, float(np.median([size for _, size in channels])),
                         tuple(name for name, _ in channels), output)
            for (j, kind), channels in scaled.items()]


def _odd(slope: float) -> bool:
    return slope < 0.0 or not 1.0 / settings.OTHER_UNIT < slope < settings.OTHER_UNIT


def _is_the_odd_one(ratio: float, j: int) -> bool:
    """Say which of two bags is taken for the odd one; nobody knows for a sign."""
    size = abs(ratio)
    if size > settings.THOUSANDTH_OF_BAGS:
        return True  # thousandths of a unit are large numbers
    if size < 1.0 / settings.THOUSANDTH_OF_BAGS:
        return False
    if size > settings.OTHER_UNIT:
        return False
    if size < 1.0 / settings.OTHER_UNIT:
        return True  # currents are smaller than torques
    return j == 1


def _other_scale(
    bags: Sequence[KnownBag], j: int, kind: str, size: float, channels: tuple[str, ...],
    output: str,
) -> Finding:
    other = bags[0 if j else 1].name
    what = f'{"effort of" if output == "effort" else "gauge"} {", ".join(channels)}'
    if kind == 'sign':
        return found(
            f'{"effort" if output == "effort" else "gauge"}_sign',
            f'{what} has the opposite sign of that in {other}', bags[j].name, channels, size=-1.0,
            now=-1.0, otherwise=1.0, measure=SLOPE, remedy=CHECKS['gauge_sign'].remedy)
    return found(
        'effort_unit', f'{what} is {size:.3g} times that in {other}: another unit', bags[j].name,
        channels, size=size, now=size, otherwise=1.0, measure=SLOPE,
        remedy='bring the bags to one unit, that of the description')


def _loads(bags: Sequence[KnownBag], pairs: dict[tuple[int, int], Pair]) -> list[Finding]:
    """Find the bag whose load is not that which it states."""
    n = len(bags)
    differ = {key: item.carried < settings.LOAD_SHARE and item.error > settings.DIFFERENT
              for key, item in pairs.items()}
    best = max(pairs, key=lambda key: pairs[key].error)
    channel = int(np.argmax(np.abs(pairs[best].load) * np.sqrt(pairs[best].share)))
    change = {key: float(item.load[channel]) if differ[key] else 0.0
              for key, item in pairs.items()}
    stated = [bag.payload for bag in bags]
    if any(payload is None for payload in stated):
        return _heavier(bags, differ, change)
    masses = np.array(stated, dtype=float)
    suspects = []
    for j in range(n):
        rest = [(a, b) for a, b in pairs if j not in (a, b)]
        steps = np.array([masses[b] - masses[a] for a, b in rest])
        seen = np.array([change[key] for key in rest])
        own = [(a, j) for a in range(n) if a != j]
        if len(rest) and np.ptp(steps) > settings.LEAST_PAYLOAD:
            unit = float(steps @ seen) / float(steps @ steps)
            if unit == 0.0:
                continue
            error = float(np.max(np.abs(seen / unit - steps)))
            mass = float(np.median([masses[a] + change[a, j] / unit for a, _ in own]))
            if error < settings.PAYLOAD_OFF * float(np.ptp(steps)) / 2.0:
                suspects.append((abs(mass - masses[j]), j, mass))
        elif (n > 2 and not any(differ[key] for key in rest)
                and all(differ[key] for key in own)
                and all(abs(masses[a] - masses[j]) < settings.LEAST_PAYLOAD for a, _ in own)):
            suspects.append((np.inf, j, np.nan))
    if not suspects:
        return _heavier(bags, differ, change) if n == 2 and (
            abs(masses[0] - masses[1]) < settings.LEAST_PAYLOAD) else []
    most = max(off for off, *_ in suspects)
    chosen = [item for item in suspects if item[0] > 0.8 * most or item[0] == most]
    j = chosen[0][1]
    scale = max(float(np.ptp(np.delete(masses, j))), settings.LEAST_PAYLOAD)
    if most < settings.PAYLOAD_OFF * scale:
        return []
    return [_wrong_payload(bags, masses, chosen)]


def _wrong_payload(
    bags: Sequence[KnownBag], masses: FloatArray, chosen: Sequence[tuple[float, int, float]],
) -> Finding:
    _, j, mass = chosen[0]
    if len(chosen) > 1:
        names = ', '.join(bags[k].name for _, k, _ in chosen)
        shown = ' and '.join(f'{masses[k]:g}' for _, k, _ in chosen)
        return found('payload_wrong', f'the payloads of {shown} kg do not go together: one of '
                     'them is wrong', names)
    what = f'the payload of {masses[j]:g} kg is not what the others show: it carries'
    if not np.isfinite(mass):
        return found('payload_wrong', f'{what} another load', bags[j].name)
    mass = max(mass, 0.0)
    return found('payload_wrong', f'{what} about {mass:.2g} kg', bags[j].name, size=mass,
                 now=float(masses[j]), otherwise=mass)


def _heavier(
    bags: Sequence[KnownBag], differ: dict[tuple[int, int], bool],
    change: dict[tuple[int, int], float],
) -> list[Finding]:
    for (i, j), differs in differ.items():
        if differs and differ[j, i]:
            heavy, light = (j, i) if change[i, j] > 0.0 else (i, j)
            return [found(
                'load_unknown', f'{bags[heavy].name} carries more than {bags[light].name}',
                bags[heavy].name,
                remedy='say how much with --payload-of BAG=KG, or fit them apart')]
    return []


def examine_bags(arm: Arm, bags: Sequence[BagData]) -> tuple[Finding, ...]:
    """Look at the bags of a fit or of an evaluation."""
    examined = [examine_bag(arm, bag) for bag in bags]
    known = merged([item.findings for item in examined])
    # bags that are known to be wrong are no measure for the others
    sound = [KnownBag(str(bag.choice), item.case, bag.payload)
             for bag, item in zip(bags, examined, strict=True)
             if item.case is not None and (item.chosen is None or not item.chosen.kind)]
    reported = {(item.kind, item.bag) for item in known}
    more = [item for item in compare(sound) if (item.kind, item.bag) not in reported]
    return tuple(more + known + copies(bags))


def examine_bag(arm: Arm, bag: BagData) -> Examined:
    """Look at one bag, under the name by which it was chosen."""
    examined = examine(arm, bag.recording, bag.timing)
    named = tuple(replace(item, bag=str(bag.choice)) if item.bag else item
                  for item in examined.findings)
    return replace(examined, findings=named)


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
    for i, one in enumerate(bags):
        for other in bags[i + 1:]:
            share = _in_common(one, other)
            if share > settings.SAME_SHARE:
                findings.append(found(
                    'same_recording', f'{one.choice} and {other.choice} hold the same samples',
                    str(other.choice), size=share, now=share))
    return findings


def _in_common(one: BagData, other: BagData) -> float:
    a, b = one.recording.q, other.recording.q
    moves = np.flatnonzero(np.any(np.diff(a, axis=0) != 0.0, axis=1))
    # samples of a still arm are alike in all recordings
    rows = a[moves[::max(1, len(moves) // 400)]]
    if not len(rows):
        return 0.0
    known = {row.tobytes() for row in np.ascontiguousarray(b)}
    return float(np.mean([row.tobytes() in known for row in np.ascontiguousarray(rows)]))


@dataclass(frozen=True, eq=False)
class Evaluated:
    """What bags show beside a model."""

    findings: tuple[Finding, ...]  # of the bags alone, and of the bags beside the model
    # Bag whose residuals look like a load, to what is known of it.
    loads: dict[str, PayloadEstimate]


def examine_evaluation(bundle: ModelBundle, data: Sequence[BagData]) -> Evaluated:
    """Look at bags that a model is compared with."""
    findings, loads = [], {}
    for bag in data:
        examined = examine_bag(bundle.arm, bag)
        findings.append(list(examined.findings))
        if examined.case is None:
            continue
        known = {}
        for output, kinds in bundle.models.items():
            model = kinds.get('analytical')
            if model is not None and output in examined.case.outputs:
                try:
                    known[output] = model_for(model, bag)
                except TudorError:
                    continue  # its payload is not known, which is said elsewhere
        finding = load_of(examined.case, {output: model.predict(examined.case.motion)
                                          for output, model in known.items()}, str(bag.choice))
        if finding is not None:
            load = loads[str(bag.choice)] = payload_of(bundle, [bag], 'analytical')
            findings[-1].insert(0, _measured(finding, load))
    return Evaluated(tuple(merged(findings)), loads)


def _measured(finding: Finding, load: PayloadEstimate) -> Finding:
    """Say of a load what is known of it: how much, and as surely as that is known."""
    size = None if math.isnan(load.mass) else load.mass - load.known
    return replace(finding, what=f'{finding.what}; {load.sentence}', size=size,
                   unit='' if size is None else 'kg')
