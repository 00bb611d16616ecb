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

"""The doctor examines one bag: description, samples, stamps, load, alternatives, residuals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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
from tudor_dynamics.identification.doctor.case import (
    Case, decimate, Decimated, Delay, Explained, gain, relative, share_of)
from tudor_dynamics.identification.doctor.findings import Finding, found, RESIDUAL
from tudor_dynamics.identification.doctor.samples import look_at_samples, SINGULAR, sizes, until
from tudor_dynamics.identification.ringdowns import loudest_ring, oscillation, SMALLEST_AMPLITUDE
from tudor_dynamics.load.rows import described_masses, LoadRows
from tudor_dynamics.load.settings import BELIEVED
from tudor_dynamics.models.regressor import output_units
from tudor_dynamics.signals.preprocessing import Timing
from tudor_dynamics.typing import FloatArray

BROKEN = ('constant', 'held', 'dying', 'saturated', 'alternating', 'copied_channel')
"""Findings of channels whose values no description is judged by."""


def suspects(arm: Arm) -> tuple[list[Finding], Arm]:
    """Look at a description alone: findings, and the arm with remedies that can be guessed."""
    findings, mended = _table(arm)
    of_gauges, mended = _gauges(mended)
    return findings + of_gauges, mended


def _table(arm: Arm) -> tuple[list[Finding], Arm]:
    rows, findings = arm.spec.kinematics.dh, []
    if rows is None:
        reach = sum(float(np.linalg.norm(place.translation))
                    for place in list(arm.full_model.jointPlacements)[1:])
        return [] if not reach > settings.LONGEST_ARM else [found(
            'dh_in_millimetres', f'the URDF reaches {reach:.4g} m (limit '
            f'{settings.LONGEST_ARM:g}): its lengths look like millimetres', size=reach,
            remedy='scale the origins in the URDF by 0.001')], arm
    a, alpha, d, theta = np.array(rows).T
    reach = float(sum(np.abs(a) + np.abs(d)))
    if reach > settings.LONGEST_ARM:
        a, d = a / 1000.0, d / 1000.0
        findings.append(found(
            'dh_in_millimetres', f'the D-H rows reach {reach:.4g} m (limit '
            f'{settings.LONGEST_ARM:g}): their lengths look like millimetres', size=reach))
    largest = float(np.abs([alpha, theta]).max())
    if largest > settings.TURN:
        alpha, theta = np.radians(alpha), np.radians(theta)
        findings.append(found('dh_in_degrees', f'the D-H rows have an angle of {largest:.4g} rad, '
                              'more than a turn: their angles look like degrees', size=largest))
    if not findings:
        return [], arm
    return findings, _rebuilt(arm, {'kinematics': {
        **arm.spec.kinematics.model_dump(mode='json'),
        'dh': np.stack([a, alpha, d, theta], axis=1).tolist()}})


def _gauges(arm: Arm) -> tuple[list[Finding], Arm]:
    findings, mended = [], arm
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
            kind, what = 'gauge_in_millimetres', f'{what}: the distance seems to be in mm'
            content['distance'] = gauge.distance / 1000.0
            mended = _rebuilt(arm, {'gauges': gauges})
        findings.append(found(kind, what, channels=(gauge.name,), size=gauge.distance))
    return findings, mended


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
    return found('load_unknown', 'a load at the tip explains most of the residual',
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


# -- What residuals show: drift, death, steps, lost signs, waves

def trends(chosen: Alternative) -> list[Finding]:
    """Look for what changes with time, and for what no model explains, in each channel."""
    case, t = chosen.case, chosen.case.decimated.t
    findings = []
    for name, explained in chosen.explained.items():
        output, shares, line = chosen.output(name), chosen.shares_of(name).tolist(), t - t.mean()
        units = [one.effort.unit for one in case.arm.joints] if name == 'effort' else [
            one.unit for one in case.arm.gauges]
        for i in np.flatnonzero(case.sound[name]).tolist():
            channel, y = case.bodies[name].channels[i], output[:, i]
            dead = _dies(explained, i, t, y)
            if dead is not None:
                what = f'{SINGULAR[name]} {channel!r} stops following the motion at {dead:.2f} s'
                findings.append(found(
                    'dying', what, case.recording.path, (channel,), time=dead,
                    size=float(t[-1]) - dead, remedy=until(case.recording, dead)))
                continue
            if name == 'effort' and not case.moves[i]:
                continue
            # the slope by Frisch and Waugh: both sides freed of all other columns
            x, left = explained.rest(i, line), explained.rest(i, y)
            slope = float(x @ left) / max(float(x @ x), 1e-300)
            rise = slope * float(t[-1] - t[0])
            now, both = float(share_of(left, y)), float(share_of(left - slope * x, y))
            step = _step(chosen, name, i, left)
            if (np.log(now / both) > settings.DRIFT_GAIN * case.brevity
                    and abs(rise) > settings.DRIFT_SIZE * float(np.std(y))
                    and (step is None or both < (step.otherwise or 0.0) ** 2)):
                findings.append(_found(
                    chosen, 'drift', name, i, f'drifts by {rise:.4g} {units[i]} within '
                    f'{t[-1] - t[0]:.4g} s', rise, now, both))
                continue
            odd = (_without_sign(chosen, name, i) or step or _wave(chosen, name, i, shares[i])
                   or _unexplained(chosen, name, i, shares[i]))
            findings += [] if odd is None else [odd]
    return _at_once(findings)


def _at_once(findings: list[Finding]) -> list[Finding]:
    """Take gains and zeros of several channels that change at one time for a change of load."""
    steps = [item for item in findings if item.kind in ('gain_step', 'offset_step')]
    times = [item.time or 0.0 for item in steps]
    if len(steps) < 2 or max(times) - min(times) > settings.SAME_TIME * max(times):
        return findings
    names, at = tuple(item.channels[0] for item in steps), float(np.median(times))
    most = max(steps, key=lambda item: item.now or 0.0)
    return [item for item in findings if item not in steps] + [found(
        'payload_changed', f'readings of {", ".join(map(repr, names))} change together at '
        f'{at:.1f} s: a load was probably picked up or put down', most.bag, names, time=at,
        now=most.now, otherwise=most.otherwise)]


def _dies(explained: Explained, channel: int, t: FloatArray, y: FloatArray) -> float | None:
    """Say from when on a channel is quiet to the end, though the arm moves on."""
    # expected by what it measured before: samples of a dead channel would teach to expect little
    if t[-1] - t[0] < settings.SHORTEST:
        return None  # windows of less than half a second are too short to judge
    edges = np.linspace(t[0], t[-1], settings.WINDOWS + 1)
    for k in range(settings.WINDOWS // 4, settings.WINDOWS - 1):
        before = t < edges[k]
        lived, after = float(np.std(y[before])), y[~before]
        if float(np.std(after)) > settings.QUIET * lived:
            continue
        expected = explained.predicted(channel, y, before)
        error, spread = float(np.std((y - expected)[before])), float(np.std(expected[~before]))
        if error > settings.ALIVE * lived or spread < settings.EXPECTED * lived:
            continue  # nobody knows what it did, or it may well be quiet
        if float(np.std(after)) > settings.QUIET * spread:
            continue
        # what was predicted may be wrong: both parts together must not be explained as well
        apart = float(np.sum((y - expected)[before] ** 2)) + len(after) * float(np.var(after))
        together = y - explained.predicted(channel, y, np.ones(len(y), dtype=bool))
        if np.log(float(together @ together) / max(apart, 1e-300)) > settings.DEAD_GAIN:
            return _last_alive(edges[:k + 1], t, y, expected)
    return None


def _last_alive(edges: FloatArray, t: FloatArray, y: FloatArray, expected: FloatArray) -> float:
    for begin, end in zip(edges[-2::-1], edges[:0:-1], strict=True):
        inside = (t >= begin) & (t <= end)
        if not inside.any():
            continue  # a gap
        x, z = expected[inside], y[inside]
        x, z = x - x.mean(), z - z.mean()
        if float(x @ z) > settings.FOLLOWS * float(x @ x):
            return float(end)
    return float(edges[0])


def _found(
    chosen: Alternative, kind: str, name: str, channel: int, what: str, size: float,
    now: float, otherwise: float | None = None, time: float = 0.0,
) -> Finding:
    """Say what is odd about a channel: shares of its variance that remain now, and otherwise."""
    label = chosen.case.bodies[name].channels[channel]
    return found(kind, f'{SINGULAR[name]} {label!r} {what}', chosen.case.recording.path, (label,),
                 time=time, size=size, now=float(np.sqrt(now)),
                 otherwise=None if otherwise is None else float(np.sqrt(otherwise)))


def _without_sign(chosen: Alternative, name: str, i: int) -> Finding | None:
    """Find a channel that is never negative, and is explained where its sign is guessed."""
    raw = getattr(chosen.case.recording, name)[:, i]
    if raw.min() < 0.0:
        return None
    explained, y = chosen.explained[name], chosen.output(name)[:, i]
    everything = np.ones(len(y), dtype=bool)
    n = chosen.case.motion.shape[1] // 3
    now = float(share_of(y - explained.predicted(i, y, everything), y))
    columns = explained.bodies[i]
    # first guesses: friction has the sign of a speed, weight that of what bodies can do
    guesses = [*chosen.case.motion[:, n:2 * n].T, *np.linalg.svd(
        columns - columns.mean(axis=0), full_matrices=False)[0][:, :settings.SIGNS].T]
    best = 1.0
    for guess in guesses:
        for _ in range(settings.SIGN_PASSES):
            signed = np.where(guess < 0.0, -y, y)
            guess = explained.predicted(i, signed, everything)
        # of the same spread: a guess that turns a large constant load makes one of its own
        best = min(best, float(share_of(signed - guess, y)))
    return None if best > settings.SIGNED * now else _found(
        chosen, 'rectified', name, i, 'is never negative: its sign is lost', 0.0, now, best)


def _step(chosen: Alternative, name: str, i: int, left: FloatArray) -> Finding | None:
    """Find a time after which a channel has another gain, or another zero."""
    explained, y, t = chosen.explained[name], chosen.output(name)[:, i], chosen.case.decimated.t
    if t[-1] - t[0] < settings.STEP_SECONDS:
        return None
    predicted, best = y - left, (1.0, 0.0, 0.0, 0.0)
    for at in t[0] + (t[-1] - t[0]) * np.linspace(*settings.STEP_WITHIN, settings.STEPS):
        after = (t > at).astype(float)
        columns = np.stack([explained.rest(i, x) for x in (after, after * predicted)], axis=1)
        values = np.linalg.lstsq(columns, left, rcond=1e-9)[0]
        share = float(np.sum((left - columns @ values) ** 2) / max(float(left @ left), 1e-300))
        if share < best[0]:
            best = share, float(at), float(values[0]), float(values[1])
    share, at, zero, gain = best
    now, least = float(share_of(left, y)), settings.STEPPED[int(t[-1] - t[0] > settings.STEP_LONG)]
    if share > least or now * (1.0 - share) < settings.STEP_SHARE:
        return None
    kind, word, size = (('gain_step', 'gain', gain) if
                        abs(gain) * float(np.std(predicted)) > abs(zero) else
                        ('offset_step', 'zero offset', zero))
    return _found(chosen, kind, name, i, f'changes its {word} at about {at:.1f} s', size,
                  now, now * share, at)


def ringing(chosen: Alternative, output: str) -> float | None:
    """Give the frequency of an oscillation that is most of a residual, faster than the motion."""
    from scipy.signal import welch  # slow to import

    case, measured = chosen.case, chosen.output(output)
    rate = 1.0 / float(np.median(np.diff(case.decimated.t)))
    frequency, densities = welch(
        np.hstack([chosen.explained[output].residuals(measured),
                   np.split(case.motion, 3, axis=1)[1]]),
        rate, nperseg=min(len(measured), round(settings.RINGING_SECONDS * rate)), axis=0)
    motion = densities[:, measured.shape[1]:].sum(axis=1)
    found = []
    for i in np.flatnonzero(case.sound[output]).tolist():
        peak, rms, share = oscillation(frequency, densities[:, i])
        moved = motion[frequency >= settings.BELOW_RINGING * peak].sum() / motion.sum()
        if (share > settings.RINGING_SHARE and moved < settings.RINGING_MOVED
                and rms > SMALLEST_AMPLITUDE * float(np.std(measured[:, i]))):
            found.append(peak)
    return min(found, default=None)


def _spectrum(t: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Give frequencies, and what part of the variance of values (n, columns) each one is."""
    step = float(np.median(np.diff(t))) / settings.WAVE_FINE
    place = np.round((t - t[0]) / step).astype(int)
    spread = np.zeros((place[-1] + 1, values.shape[1]))  # fine: stretches keep their phase
    spread[place] = values - values.mean(axis=0)
    count = 1 << (settings.WAVE_LONGER * len(spread)).bit_length()
    shares = 2.0 * np.abs(np.fft.rfft(spread, count, axis=0) / len(t)) ** 2 / np.maximum(
        np.mean(spread[place] ** 2, axis=0), 1e-300)
    return np.asarray(np.fft.rfftfreq(count, step)), shares


def _wave(chosen: Alternative, name: str, i: int, now: float) -> Finding | None:
    """Find a wave that goes on through most of a residual, and is none of the motion."""
    case, t = chosen.case, chosen.case.decimated.t
    seconds = float(t[-1] - t[0])
    if seconds < settings.WAVE_SECONDS:
        return None
    left = chosen.explained[name].residuals(chosen.output(name))[:, i]
    frequency, shares = _spectrum(
        t, np.column_stack([left, np.split(case.motion, 3, axis=1)[1][:, case.moves]]))
    near = (frequency >= max(settings.WAVE_ABOVE, settings.WAVE_CYCLES / seconds)) & (
        frequency <= min(settings.CUTOFF, 0.5 / float(np.median(np.diff(t)))))
    frequency, shares = frequency[near], shares[near]
    peak = int(np.argmax(shares[:, 0]))
    # what rings dies out, or begins again with each motion
    parts = np.array([part.mean() for part in np.array_split(
        np.exp(-2j * np.pi * frequency[peak] * t) * left, settings.WAVE_PARTS)])
    line, uneven = min(float(shares[peak, 0]), 1.0), np.abs(parts / parts.mean() - 1.0).max()
    if (line < settings.WAVE or uneven > settings.WAVE_EVEN
            or shares[peak, 1:].max(initial=0.0) > settings.RINGING_MOVED):
        return None
    return _found(chosen, 'hum', name, i, f'oscillates steadily at {frequency[peak]:.3g} Hz',
                  float(frequency[peak]), now, now * (1.0 - line))


def _unexplained(chosen: Alternative, name: str, i: int, now: float) -> Finding | None:
    """Say that most of a channel is left, and no check has found a cause: now, its share."""
    return None if now < settings.UNEXPLAINED ** 2 or ringing(chosen, name) else _found(
        chosen, 'unexplained', name, i, 'does not fit the model: the relative residual '
        f'is above the limit of {100 * settings.UNEXPLAINED:.0f} %', 0.0, now)


# -- Outputs that come late

PLURAL = {'effort': 'efforts', 'strain': 'strains', 'velocity': 'velocities'}


def lags(chosen: Alternative) -> list[Alternative]:
    """Look for outputs that come late, the likeliest way of each: as a whole, more, by one."""
    late = [_late_output(chosen, name) for name, sound in chosen.case.sound.items() if sound.any()]
    return [one for one in late if one is not None]


def _late_output(chosen: Alternative, name: str) -> Alternative | None:
    case, shares, best = chosen.case, chosen.shares_of(name), None
    least_gain = settings.LAG_GAIN[name]
    sound, span = np.flatnonzero(case.sound[name]).tolist(), float(case.decimated.t[-1])

    def least(sizes: FloatArray, delay: Callable[[float], Delay]) -> float:
        return _least(sizes, chosen.explained[name].shares(np.array([
            chosen.output(name, delay(float(size))) for size in sizes])))

    grid = settings.LAGS
    # clocks may be apart by seconds; an oscillation looks the same a period later
    if relative(shares[sound]) > settings.LAG_FAR and ringing(chosen, name) is None:
        grid = grid + least(settings.CLOCKS, Delay)
    seconds = least(grid, Delay)
    more = least(settings.CLOCKS, lambda size: Delay(seconds - size, 2.0 * size / span))
    # filters of drivers; and stamps of samples show no less than the time between them
    usual = np.sqrt(case.brevity) * max(settings.USUAL_LAG[name], case.recording.dt)
    ways: list[tuple[tuple[int, ...], float, Delay]] = [
        ((), abs(seconds) / usual, Delay(seconds)),
        ((), abs(more) / usual, Delay(seconds - more, 2.0 * more / span))]
    step = 0.5 * float(settings.LAGS[1] - settings.LAGS[0])
    rates = (chosen.output(name, Delay(step)) - chosen.output(name, Delay(-step))) / (2.0 * step)
    for i in sound if len(sound) > 1 else ():
        rate, left = (chosen.explained[name].rest(i, x[:, i]) for x in (
            rates, chosen.output(name)))
        # beside others with the same stamps a channel comes late by a filter: never early
        own = float(np.clip(-(rate @ left) / max(float(rate @ rate), 1e-300), 0.0, 2.0))
        # drivers filter one channel more than another
        ways.append(((i,), 0.5 * own / usual,
                     Delay(np.where(np.arange(len(shares)) == i, own, 0.0))))
    for channels, size, delay in ways:
        after, judged = chosen.shares_of(name, delay), list(channels) or sound
        better = gain(shares, after)
        if size > 1.0 and relative(after[judged]) < settings.LAG_SHARE and better > least_gain:
            names = tuple(case.bodies[name].channels[i] for i in channels)
            best = replace(chosen, kind=f'{name}_late', channels=names, remedy='', size=delay.size,
                           what=_said(name, names, delay), late={name: delay})
            least_gain = better + settings.LAG_GAIN[name]
    return best


def velocity_lag(
    recording: Recording, decimated: Decimated, joints: Sequence[str],
) -> list[Finding]:
    """Look for velocities of the driver that come later than the derivative of the positions."""
    if not decimated.has('velocity'):
        return []
    derivative = np.split(decimated.motion, 3, axis=1)[1]
    sizes = np.std(derivative, axis=0)
    moves = np.flatnonzero(sizes > settings.STILL * float(sizes.max()))
    shares = np.array([share_of(decimated.output('velocity', Delay(float(lag))) - derivative,
                                derivative) for lag in settings.LAGS])
    zero = shares[np.argmin(np.abs(settings.LAGS))]
    late: dict[int, tuple[float, float]] = {}
    for i in moves.tolist():
        seconds, least = _least(settings.LAGS, shares[:, [i]]), float(shares[:, i].min())
        if (abs(seconds) > max(settings.USUAL_LAG['velocity'], recording.dt)
                and np.log(zero[i] / least) > settings.LAG_GAIN['velocity']
                and np.sqrt(least) < settings.LAG_SHARE):
            late[i] = seconds, least
    if not late:
        return []
    names = () if len(late) == len(moves) else tuple(joints[i] for i in late)
    delay = Delay(float(np.median([seconds for seconds, _ in late.values()])))
    return [found('velocity_late', _said('velocity', names, delay), recording.path, names,
                  size=delay.size, now=relative(zero[list(late)]),
                  otherwise=relative(np.array([least for _, least in late.values()])))]


def _least(lags: FloatArray, shares: FloatArray) -> float:
    """Give the lag of the least residuals: shares of each lag, (lags, channels)."""
    scores = np.log(shares).sum(axis=1)
    i = int(np.argmin(scores))
    seconds = float(lags[i])
    if 0 < i < len(scores) - 1:  # the vertex of the parabola through three
        before, here, after = scores[i - 1:i + 2]
        bend = before - 2.0 * here + after
        if bend > 0.0:
            seconds += float(0.5 * (before - after) / bend * (lags[1] - lags[0]))
    return seconds


def _said(name: str, channels: tuple[str, ...], delay: Delay) -> str:
    """Say what comes late, and by how much."""
    late, what = delay.size > 0.0, PLURAL[name]
    if channels:
        what = f'{SINGULAR.get(name, "velocity of")} {", ".join(map(repr, channels))}'
    more = '' if not delay.rate else (f' at first, and get {1e3 * abs(delay.rate):.2g} ms '
                                      f'{"later" if delay.rate > 0.0 else "earlier"} each second')
    return (f'{what} {"lag" if late else "lead"}{"s" * bool(channels)} the positions by '
            f'{abs(delay.size) * 1e3:.0f} ms{more}')
