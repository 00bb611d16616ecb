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

"""A remedy has to pay: models are fitted with it and without, and predict parts left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.errors import TudorError
from tudor_dynamics.identification import settings
from tudor_dynamics.identification.choice import Choices, hysteretic, LeftOut
from tudor_dynamics.identification.dataset import BagChoice, BagData, filtered
from tudor_dynamics.identification.doctor.alternatives import Alternative
from tudor_dynamics.identification.doctor.case import Case
from tudor_dynamics.identification.doctor.findings import Finding
from tudor_dynamics.identification.doctor.residuals import ringing
from tudor_dynamics.load.rows import described_masses
from tudor_dynamics.load.settings import BELIEVED
from tudor_dynamics.typing import FloatArray


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
        self._before: dict[tuple[Alternative | None, str], FloatArray] = {}  # of remedy, filters

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
                 if (errors := self._try(group[0], settings.PAYING, spec, None)) is not None
                 and (group[0].kind != 'joint_scale' or errors[1] < settings.RESCALED * errors[0])]
        (otherwise, now), best = min(tried, key=lambda item: item[0], default=((0.0, 0.0), []))
        return [next((replace(one, unseen=(now, otherwise)) for one in best
                      if one.case is own.case), own) for own in usual]

    def paying_lags(
        self, chosen: Sequence[Alternative], found: Sequence[Sequence[Alternative]],
    ) -> list[list[Finding]]:
        """Give the lags of each bag that pay on all of them: the likeliest of each output."""
        base = next((item for item in chosen if item.kind), None)
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
        self, remedy: Alternative, least: float, spec: PreprocessingSpec,
        base: Alternative | None,
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
            without = base, spec.model_dump_json()
            if without not in self._before:
                self._before[without] = self._shares(base, spec)
            before = self._before[without][:, judged]
            after = self._shares(remedy, spec)[:, judged]
        except TudorError:
            return None  # too short for the filters, or nothing is left to be predicted
        # every channel and part counts alike, whatever its error
        gains = ((before - after) / np.maximum(before + after, 1e-12)).mean(axis=1)
        now, otherwise = float(np.sqrt(before.mean())), float(np.sqrt(after.mean()))
        errors = settings.PAYING_ERRORS * float(np.std(gains, ddof=1)) / np.sqrt(len(gains))
        pays = otherwise < min(now, settings.PREDICTED) and gains.mean() > max(least, errors)
        return (now, otherwise) if pays else None

    def _shares(self, remedy: Alternative | None, spec: PreprocessingSpec) -> FloatArray:
        """Give squared errors over the power of a part, (parts, channels), 1 at most."""
        bags = [filtered(BagData(
            BagChoice(case.recording.path), remedied(case, remedy), (), payload), spec)
            for case, payload in zip(self.cases, self._payloads, strict=True)]
        arm = remedy.arm if remedy is not None and remedy.arm is not None else self.cases[0].arm
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


def remedied(case: Case, remedy: Alternative | None) -> Recording:
    """Give the recording of a bag as it would be with a remedy."""
    recording = case.recording
    changed: dict[str, Any] = {'earlier': None}
    for name in case.outputs:
        values = getattr(recording, name)
        if name == 'effort':
            values = values / [case.units.get(joint, 1.0) for joint in case.arm.active_joints]
        if remedy is not None and name in remedy.mixed:
            values = values @ remedy.mixed[name]
        if remedy is not None and name in remedy.late:
            values = np.vstack([
                remedy.late[name].undone(t, values[part], t) for part in recording.segments
                if len(t := recording.t[part])])
        changed[name] = values
    done = replace(recording, **changed)
    return done if remedy is None else remedy.mended(done)
