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

"""The doctor examines one bag: description, samples, stamps, load, then alternatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from tudor_dynamics.arm.description import Arm, arm_from_dict
from tudor_dynamics.arm.kinematics import link_reach, unit_vector
from tudor_dynamics.arm.schema import GaugeSpec, PreprocessingSpec
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.errors import ArmError, TudorError
from tudor_dynamics.identification import settings
from tudor_dynamics.identification.choice import Choices, hysteretic, LeftOut
from tudor_dynamics.identification.dataset import BagChoice, BagData, filtered
from tudor_dynamics.identification.doctor.alternatives import (
    Alternative, choose, driven_by_friction, opposite)
from tudor_dynamics.identification.doctor.case import Case, decimate, Explained, gain, relative
from tudor_dynamics.identification.doctor.findings import Finding, found, RESIDUAL
from tudor_dynamics.identification.doctor.residuals import lags, ringing, trends, velocity_lag
from tudor_dynamics.identification.doctor.samples import look_at_samples, sizes
from tudor_dynamics.identification.ringdowns import loudest_ring
from tudor_dynamics.load.rows import described_masses, LoadRows
from tudor_dynamics.load.settings import BELIEVED
from tudor_dynamics.models.regressor import output_units
from tudor_dynamics.signals.preprocessing import Timing
from tudor_dynamics.typing import FloatArray

BROKEN = ('constant', 'held', 'dying', 'saturated', 'alternating', 'copied_channel')
"""Findings of channels whose values no description is judged by."""


def suspects(arm: Arm) -> tuple[list[Finding], Arm]:
    """Look at a description alone: findings, and the arm with remedies that can be guessed."""
    findings, arm = _table(arm)
    mended = arm
    gauges = [gauge.model_dump(mode='json') for gauge in arm.gauges]
    for gauge, content in zip(arm.gauges, gauges, strict=True):
        length = link_length(arm, gauge)
        if not gauge.distance > (1.001 * length if length else settings.LONGEST_ARM):
            continue
        limit = length or settings.LONGEST_ARM
        kind, what = 'gauge_beyond_link', (
            f'distance of gauge {gauge.name!r} is {gauge.distance:.4g} m, but the link of joint '
            f'{gauge.joint!r} is no longer than {limit:.4g} m')
        if gauge.distance > 1.0 and gauge.distance / 1000.0 <= limit:
            kind, what = 'gauge_in_millimetres', f'{what}, so it seems to be in mm'
            content['distance'] = gauge.distance / 1000.0
            mended = _rebuilt(arm, {'gauges': gauges})
        findings.append(found(kind, what, channels=(gauge.name,), size=gauge.distance))
    return findings, mended


def _table(arm: Arm) -> tuple[list[Finding], Arm]:
    rows, findings = arm.spec.kinematics.dh, []
    if rows is None:
        reach = sum(float(np.linalg.norm(place.translation))
                    for place in list(arm.full_model.jointPlacements)[1:])
        return [] if not reach > settings.LONGEST_ARM else [found(
            'dh_in_millimetres', f'the URDF reaches {reach:.4g} m (limit '
            f'{settings.LONGEST_ARM:g} m), so its lengths look like millimetres', size=reach,
            remedy='scale the origins in the URDF by 0.001')], arm
    a, alpha, d, theta = np.array(rows).T
    reach = float(sum(np.abs(a) + np.abs(d)))
    if reach > settings.LONGEST_ARM:
        a, d = a / 1000.0, d / 1000.0
        findings.append(found(
            'dh_in_millimetres', f'the D-H rows reach {reach:.4g} m (limit '
            f'{settings.LONGEST_ARM:g} m), so they look like millimetres', size=reach))
    largest = float(np.abs([alpha, theta]).max())
    if largest > settings.TURN:
        alpha, theta = np.radians(alpha), np.radians(theta)
        findings.append(found('dh_in_degrees', f'the D-H rows have an angle of {largest:.4g} rad, '
                              'more than a turn, so they look like degrees', size=largest))
    if not findings:
        return [], arm
    return findings, _rebuilt(arm, {'kinematics': {
        **arm.spec.kinematics.model_dump(mode='json'),
        'dh': np.stack([a, alpha, d, theta], axis=1).tolist()}})


def link_length(arm: Arm, gauge: GaugeSpec) -> float | None:
    """Say how far a gauge's link reaches along its direction [m]; None where that is not known."""
    reach = link_reach(arm.full_model, gauge.joint, unit_vector(gauge.direction))
    return reach if reach > 1e-6 else None


def _rebuilt(arm: Arm, changes: dict[str, Any]) -> Arm:
    content = arm.spec.model_dump(mode='json') | changes
    try:
        return arm_from_dict(content, base=Path(arm.source).parent, source=arm.source)
    except ArmError:
        return arm


def load_of(case: Case, predicted: Mapping[str, FloatArray]) -> Finding | None:
    """Explain residuals by a body at the end of the arm; None where a load explains little."""
    findings = [_of_output(case, output, values) for output, values in predicted.items()]
    return max((item for item in findings if item is not None),
               key=lambda item: item.now or 0.0, default=None)


def _of_output(case: Case, output: str, predicted: FloatArray) -> Finding | None:
    measured, sound, bodies = case.outputs[output], case.sound[output], case.bodies[output]
    residual = np.where(sound, measured - predicted, 0.0)
    # another day's friction or zero is no load, nor are filters with another lag than in the fit
    rates = np.gradient(predicted, case.decimated.t, axis=0)
    own = [np.column_stack([columns[:, 1:] if output == 'effort' else columns, rates[:, i]])
           for i, columns in enumerate(bodies.own(case.motion))]
    rows = LoadRows(case.arm, output).rows(case.motion)
    sizes = np.sum((measured - measured.mean(axis=0)) ** 2, axis=0)
    before, after = (
        np.sum(Explained(columns, own, bodies.groups).residuals(residual) ** 2, axis=0)
        / np.maximum(sizes, 1e-300) for columns in (np.zeros_like(rows[:, :, :1]), rows))
    felt = sound & (before > settings.LOAD_ERROR ** 2)
    if not felt.any():
        return None
    now, then = float(np.sqrt(before[felt].mean())), float(np.sqrt(after[felt].mean()))
    better = gain(np.maximum(before[felt], 1e-9), np.maximum(after[felt], 1e-9))
    if better < settings.LOAD_GAIN or then > settings.LOAD_SHARE * now:
        return None
    return found('load_unknown', 'a load explains most of the residual',
                 case.recording.path, now=now, otherwise=then)


def changed_gauges(case: Case, predicted: FloatArray) -> list[Finding]:
    """Find gauges whose gain or zero is not that of the training: predicted (n, gauges)."""
    measured, sound = case.outputs['strain'], case.sound['strain']
    parts = np.array_split(np.arange(len(measured)), settings.GAUGE_PARTS)
    effect, said = np.zeros(measured.shape[1]), []
    sure = sound.copy()
    for i, (expected, gauge) in enumerate(zip(predicted.T, case.arm.gauges, strict=True)):
        left, size = measured[:, i] - expected, max(float(np.std(measured[:, i])), 1e-300)
        # filters may be later, or earlier, than those of the fit
        rate = np.gradient(expected, case.decimated.t)
        ways = [np.column_stack([column, rate]) for column in (expected, np.ones_like(expected))]
        values = [np.linalg.lstsq(way, left, rcond=None)[0] for way in ways]
        zero = int(np.argmin([np.sum((left - way @ value) ** 2)
                              for way, value in zip(ways, values, strict=True)]))
        value, std = float(values[zero][0]), float(np.sqrt((len(parts) - 1) * np.var([
            np.linalg.lstsq(np.delete(ways[zero], part, axis=0), np.delete(left, part),
                            rcond=None)[0][0] for part in parts])))
        least = settings.GAUGE_ZERO * size if zero else settings.GAUGE_GAIN
        sure[i] &= abs(value) > max(least, settings.GAUGE_SURE * std)
        effect[i] = float(np.sqrt(np.mean((value * ways[zero][:, 0]) ** 2))) / size
        said.append(found(
            'gauge_zero' if zero else 'gauge_gain', f'gauge {gauge.name!r} ' + (
                f'is off by {value:+.3g} +- {std:.1g} {gauge.unit} from' if zero else
                f'reads {1.0 + value:.3f} +- {std:.3f} times') + ' what the model predicts',
            case.recording.path, (gauge.name,), size=value if zero else 1.0 + value))
    # what changes the readings of all gauges is a load
    alone = 0 < sure.sum() <= sound.sum() // 2 and (
        effect[sound & ~sure].max() < settings.GAUGE_ALONE * effect[sure].min())
    return [item for item, changed in zip(said, sure, strict=True) if changed and alone]


@dataclass(frozen=True, eq=False)
class Examined:
    """What was found about a bag."""

    findings: tuple[Finding, ...]  # what is wrong; empty for a clean bag of a right description
    case: Case | None = None  # for comparisons with other bags; None: the bag is too short
    described: bool = True  # whether no other description explains it better


def examine(arm: Arm, recording: Recording, retimed: Timing | None = None) -> Examined:
    """Look at a bag."""
    return examine_all(arm, [BagData(
        BagChoice(recording.path), recording, (), recording.payload, retimed)])[0]


def examine_all(
    arm: Arm, bags: Sequence[BagData], choices: Choices | None = None,
) -> list[Examined]:
    """Look at bags of one arm, under the names by which they were chosen."""
    of_description, mended = suspects(arm)
    units = {(field, name): f' {unit}' for field, known in (
                 ('q', arm.position_units), ('effort', output_units(arm, 'effort')),
                 ('strain', output_units(arm, 'strain'))) for name, unit in known.items()}
    seen = []
    for bag in bags:
        clean, findings = look_at_samples(replace(bag.recording, path=str(bag.choice)),
                                          arm.active_joints, arm.gauge_names, bag.timing, units)
        findings, decimated = not_listed(arm, clean) + findings, decimate(clean)
        if decimated is not None:
            rings = rings_on(arm, clean)
            # where it stands is where that shows
            findings = [item for item in findings if not rings or item.kind != 'standstill']
            findings += velocity_lag(clean, decimated, arm.active_joints) + rings
        seen.append((findings, None if decimated is None else Case(
            mended, clean, decimated, frozenset(
                name for item in findings if item.kind in BROKEN for name in item.channels))))
    judged = iter(_by_model([(case, bag.payload) for (_, case), bag in zip(
        seen, bags, strict=True) if case is not None and case.outputs], choices))
    found = []
    for findings, case in seen:
        if case is None or not case.outputs:
            found.append(Examined((*of_description, *findings), case))
            continue
        case, described, by_model = next(judged)
        wrong = replace(case, arm=arm, units={})
        found.append(Examined((*(replace(
            item, bag=case.recording.path, measure=RESIDUAL, now=relative(wrong.now),
            otherwise=relative(case.now)) for item in reversed(of_description)),
            *by_model, *findings), case, described))
    return found


def not_listed(arm: Arm, recording: Recording) -> list[Finding]:
    """Find joints of the kinematics that move, but are held by the description."""
    moved = {name: span for name, span in recording.oddities.others.items()
             if name in arm.held_joints and span > settings.MOVING_SPAN}
    if not moved:
        return []
    most, span = max(moved.items(), key=lambda item: item[1])
    unit = arm.position_units[most]
    return [replace(found(
        'joint_not_listed', f'moving, but not active: {", ".join(map(repr, moved))} ({most!r} by '
        f'{span:.3g} {unit})', recording.path, tuple(moved), size=span), unit=unit)]


def rings_on(arm: Arm, recording: Recording) -> list[Finding]:
    """Say what efforts show of a flexible tool while the arm stands."""
    ring = loudest_ring(recording)
    if ring is None:
        return []
    size = np.abs(ring.amplitude)
    loudest = int(np.argmax(size / ring.noise))
    joint = arm.joints[loudest]
    return [found('rings', f'the arm rings at {ring.frequency:.2f} Hz after motion, damping ratio '
                  f'{ring.damping:.3f}, amplitude {size[loudest]:.2g} {joint.effort.unit} in the '
                  f'effort of {joint.name!r}', recording.path, size=ring.frequency, remedy=(
                      f'shape the motion with tudor shape --frequency {ring.frequency:.2f} '
                      f'--damping {ring.damping:.3f}'))]


def _by_model(
    bags: Sequence[tuple[Case, float | None]], choices: Choices | None,
) -> list[tuple[Case, bool, list[Finding]]]:
    """Say of each bag whether no alternative explains it better, and what its residuals show."""
    if not bags:
        return []
    sized = [sizes(case) for case, _ in bags]
    usual = [Alternative(case, '', (), case.usual) for case in (
        replace(case, units={name: item.size or 1.0 for item in by_size
                             for name in item.channels})
        for (case, _), by_size in zip(bags, sized, strict=True))]
    trials = Trials([item.case for item in usual], [payload for _, payload in bags], choices)
    chosen = trials.paying(usual, [_proposed(item) for item in usual])
    late = trials.paying_lags(chosen, [lags(item) for item in chosen])
    hints = [driven_by_friction(item.case) for item in usual]
    found = []
    for own, item, slow, hinted, findings in zip(usual, chosen, late, hints, sized, strict=True):
        case, trending = own.case, trends(item)
        findings = [*findings, *([] if item is own else [item.finding()]), *slow]
        if not any(late) and item is own:
            # what dies has no friction to judge it by
            dead = {one.channels[0] for one in trending if one.kind == 'dying'}
            findings += opposite(case, {
                i: power for i, power in hinted.items()
                if case.arm.active_joints[i] not in dead and trials.driven(i, hints)})
        shown = {name for finding in findings for name in finding.channels}
        found.append((case, item is own, findings + [
            one for one in trending if one.channels[0] not in shown]))
    return found


def _proposed(usual: Alternative) -> list[Alternative]:
    """Give what explains a bag better than the description, and than a lag does."""
    least = max((late.gain for late in lags(usual)), default=0.0)
    return [item for item in choose(usual.case) if item.gain >= least]


# -- A remedy has to pay: models are fitted with it and without, and predict parts left out

class Trials:
    """Bags of one description, on which remedies are tried: all of them on all bags."""

    def __init__(
        self, cases: Sequence[Case], payloads: Sequence[float | None], chosen: Choices | None,
    ) -> None:
        self.cases, self._payloads, arm = cases, payloads, cases[0].arm
        # without hysteresis, friction that has it looks like a lag
        self._joints = hysteretic(arm.joints) if chosen is None else chosen.arm.joints
        self._spec = arm.spec.preprocessing.model_copy(update={
            'filter': 'zero_phase'}) if chosen is None else chosen.preprocessing
        self._settings = None if chosen is None else chosen.settings
        self._sound = {name: np.all([case.sound[name] for case in cases], axis=0)
                       for name in cases[0].outputs if all(name in one.outputs for one in cases)}
        self._before = cache(self._shares)  # what several remedies are compared with

    def paying(
        self, usual: Sequence[Alternative], proposed: Sequence[Sequence[Alternative]],
    ) -> list[Alternative]:
        """Give for each bag what it is to be judged by: what pays on all of them, or as it is."""
        groups: dict[str, list[Alternative]] = {}
        for item in chain.from_iterable(proposed):
            groups.setdefault(item.what, []).append(item)
        likeliest = sorted(groups.values(), key=lambda group: -sum(one.gain for one in group))
        spec = self._slower(usual) if likeliest else self._spec
        tried = [(errors[::-1], group) for group in likeliest[:settings.LIKELIEST]
                 if (errors := self._try(group[0], settings.PAYING, spec, usual[0])) is not None
                 and (group[0].kind != 'joint_scale' or errors[1] < settings.RESCALED * errors[0])]
        (otherwise, now), best = min(tried, key=lambda item: item[0], default=((0.0, 0.0), []))
        return [next((replace(one, unseen=(now, otherwise)) for one in best
                      if one.case is own.case), own) for own in usual]

    def paying_lags(
        self, chosen: Sequence[Alternative], found: Sequence[Sequence[Alternative]],
    ) -> list[list[Finding]]:
        """Give the lags of each bag that pay on all of them: the likeliest of each output."""
        base = next((item for item in chosen if item.kind), chosen[0])
        spec = self._slower(chosen) if any(found) else self._spec
        paid = {}
        for name in self._sound:
            late = [one for one in chain.from_iterable(found) if name in one.late]
            if late:
                likeliest = max(late, key=lambda one: one.gain)
                paid[likeliest.kind, likeliest.channels] = self._try(
                    likeliest, settings.PAYING_LAG, spec, base)
        return [[replace(one, unseen=errors).finding() for one in of_bag
                 if (errors := paid.get((one.kind, one.channels))) is not None]
                for of_bag in found]

    def driven(self, joint: int, hints: Sequence[Mapping[int, float]]) -> bool:
        """Say whether all bags and the masses agree that friction would drive a joint."""
        for case, hinted in zip(self.cases, hints, strict=True):
            known = described_masses(case.arm, case.motion, case.outputs['effort'])
            if case.moves[joint] and joint not in hinted or known is not None and (
                    known.share[joint] > BELIEVED and known.ratio[joint] > 0.0):
                return False
        return True

    def _slower(self, chosen: Sequence[Alternative]) -> PreprocessingSpec:
        """Give filters below an oscillation: it has its own cause, bodies explain the rest."""
        peaks = [peak for one in chosen for name in self._sound
                 if (peak := ringing(one, name)) is not None]
        return self._spec if not peaks else self._spec.model_copy(update={
            'filter': 'zero_phase', 'cutoff': settings.BELOW_RINGING * min(peaks)})

    def _try(
        self, remedy: Alternative, least: float, spec: PreprocessingSpec, base: Alternative,
    ) -> tuple[float, float] | None:
        """Give relative errors without a remedy and with it; None if it loses."""
        names = np.concatenate([np.array(self.cases[0].bodies[output].channels)[sound]
                                for output, sound in self._sound.items()])
        # a channel that comes late, and a position that errs, show in one channel above all
        bent = remedy.kind in settings.BENDS
        own = np.isin(names, remedy.channels if remedy.late or bent else names)
        judged = own if own.any() else ~own
        if bent:  # velocities are not those of a position that errs
            spec = spec.model_copy(update={'measured_velocity': False})
        try:
            before = self._before(base, spec)[:, judged]
            after = self._shares(remedy, spec)[:, judged]
        except TudorError:
            return None  # too short for the filters, or nothing is left to be predicted
        # every channel and part counts alike, whatever its error
        gains = ((before - after) / np.maximum(before + after, 1e-12)).mean(axis=1)
        now, otherwise = float(np.sqrt(before.mean())), float(np.sqrt(after.mean()))
        errors = settings.PAYING_ERRORS * float(np.std(gains, ddof=1)) / np.sqrt(len(gains))
        pays = otherwise < min(now, settings.PREDICTED) and gains.mean() > max(least, errors)
        return (now, otherwise) if pays else None

    def _shares(self, remedy: Alternative, spec: PreprocessingSpec) -> FloatArray:
        """Give squared errors over the power of a part, (parts, channels), 1 at most."""
        bags = [filtered(BagData(
            BagChoice(case.recording.path), remedied(case, remedy), (), payload), spec)
            for case, payload in zip(self.cases, self._payloads, strict=True)]
        arm = remedy.arm or self.cases[0].arm
        found = []
        for output, sound in self._sound.items():
            joints = self._joints if output == 'effort' else []
            rows = LeftOut(arm, output, joints, bags, 'exact', payloads=(
                None if self._settings is None else self._settings.payloads))
            shared = bool(self._settings and self._settings.shared and rows.unknown)
            if joints:
                rows.assume(rows.fitted(joints, shared=shared)[0])
            found.append(np.minimum(
                rows.errors(joints, shared=shared) / rows.spread, 1.0)[:, sound])
        return np.hstack(found)


def remedied(case: Case, remedy: Alternative) -> Recording:
    """Give the recording of a bag as it would be with a remedy."""
    recording = case.recording
    changed: dict[str, Any] = {'earlier': None}
    for name in case.outputs:
        values = getattr(recording, name)
        if name == 'effort':
            values = values / [case.units.get(joint, 1.0) for joint in case.arm.active_joints]
        if name in remedy.mixed:
            values = values @ remedy.mixed[name]
        if name in remedy.late:
            values = np.vstack([
                remedy.late[name].undone(t, values[part], t) for part in recording.segments
                if len(t := recording.t[part])])
        changed[name] = values
    return remedy.mended(replace(recording, **changed))
