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
What users leave open: filters, friction terms, shared parameters, estimator.

Chosen by parts of the training data that are left out; test data have no hand in it. The simpler
choice stays where the left-out parts do not clearly pay for the other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tudor_dynamics.arm import Arm, JointSpec, PreprocessingSpec
from tudor_dynamics.errors import SignalError
from tudor_dynamics.identification.choice.friction import (
    all_candidates, choices_of, choose_friction, is_open)
from tudor_dynamics.identification.choice.left_out import LeftOut, paid
from tudor_dynamics.identification.choice.outcome import Choice
from tudor_dynamics.identification.choice.rows import WideRows
from tudor_dynamics.identification.dataset import BagData, common_outputs, filtered
from tudor_dynamics.identification.fit import FitSettings
from tudor_dynamics.models.kinds import KINDS
from tudor_dynamics.typing import FloatArray, Progress

CAUSAL_KEYS = {'filter', 'output_cutoff', 'velocity_cutoff', 'acceleration_cutoff'}
"""Keys of the preprocessing any of which says which filter is wanted."""
USUAL_SWITCH = JointSpec.model_fields['friction_velocity'].default
OUTPUT_CUTOFF = 20.0
"""Low-pass over all causal signals that is tried: that of the acceleration [Hz]."""


@dataclass(frozen=True, eq=False)
class Choices:
    """All that was chosen for a fit."""

    arm: Arm  # arm with the friction of its joints
    preprocessing: PreprocessingSpec  # filters and rate
    settings: FitSettings  # settings with nothing left open
    made: tuple[Choice, ...] = ()  # what was chosen, and what it brought; without what was fixed


def choose(
    arm: Arm, bags: Sequence[BagData], preprocessing: PreprocessingSpec, settings: FitSettings,
    progress: Progress = lambda _: None, *, summable: bool = False,
) -> Choices:
    """Choose what description and settings leave open."""
    progress('choose what is left open')
    return _Chooser(arm, bags, preprocessing, settings, summable=summable).choose()


class _Chooser:
    """The steps of a choice, and what they share."""

    def __init__(
        self, arm: Arm, bags: Sequence[BagData], spec: PreprocessingSpec, settings: FitSettings,
        *, summable: bool,
    ) -> None:
        self.arm, self.bags, self.spec, self.settings = arm, bags, spec, settings
        self.outputs = common_outputs(bags)
        self.joints: list[JointSpec] = list(arm.joints)
        self.shared = bool(settings.shared)
        self.made: list[Choice] = []
        follows = any(KINDS[kind].model.has_memory for kind in settings.kinds)
        # a load on the gear is no term of an arm that is followed, nor affine in a payload
        self.without = (*(('load',) if summable or follows or settings.payloads is not None
                          else ()), *(('presliding',) if follows else ()))
        # what follows measured positions has no filter to choose
        self.filter_open = not follows and not spec.model_fields_set & CAUSAL_KEYS

    def choose(self) -> Choices:
        """Go through what is open, what matters most first."""
        if self.filter_open:
            self._choose_filter()
        if 'effort' in self.outputs and 'analytical' in self.settings.kinds:
            self._choose_effort()
        changes = {old.name: choices_of(new) for old, new in zip(
            self.arm.joints, self.joints, strict=True) if new != old}
        settings = replace(self.settings, shared=self.shared).settled()
        return Choices(self.arm.with_joints(changes), self.spec, settings, tuple(self.made))

    def _rows(self, output: str, bags: Sequence[BagData], joints: Sequence[JointSpec]) -> WideRows:
        return WideRows(self.arm, output, joints, bags, self.settings.strain_form,
                        with_payload=self.settings.payloads is not None)

    def _grouped(self, left_out: LeftOut) -> tuple[FloatArray, bool]:
        """Give the errors of parameters shared or not, whichever is open and pays."""
        joints = self.joints if left_out.rows.output == 'effort' else []
        if True not in left_out.rows.groupings:
            return left_out.errors(joints), False
        if self.settings.shared is not None:
            return left_out.errors(joints, shared=self.settings.shared), self.settings.shared
        separate, shared = (left_out.errors(joints, shared=own) for own in (False, True))
        return (shared, True) if paid(separate.sum(axis=1), shared.sum(axis=1)) else (
            separate, False)

    def _choose_filter(self) -> None:
        candidates = [('causal', self.spec),
                      (f'causal, all signals behind {OUTPUT_CUTOFF:g} Hz',
                       self._with({'output_cutoff': OUTPUT_CUTOFF})),
                      ('zero-phase (causal beside the robot)',
                       self._with({'filter': 'zero_phase'}))]
        if self.spec.cutoff is None:
            half = 0.05 / self.bags[0].recording.dt
            candidates.append((f'zero-phase with {half:.3g} Hz (causal beside the robot)',
                               self._with({'filter': 'zero_phase', 'cutoff': half})))
        best = first = self._relative(self.spec)
        name, spec = candidates[0]
        for label, candidate in candidates[1:]:
            try:
                found = self._relative(candidate)
            except SignalError:
                continue  # the recordings are too short or too slow for it
            if paid(best, found):
                best, name, spec = found, label, candidate
        self.spec = spec
        self.made.append(Choice('filters', name, candidates[0][0], _percent(best),
                                _percent(first)))

    def _with(self, changes: dict[str, Any]) -> PreprocessingSpec:
        return self.spec.model_copy(update=changes)

    def _relative(self, spec: PreprocessingSpec) -> FloatArray:
        """Give relative squared errors of each part, the mean of all outputs, as they are used."""
        total: FloatArray = np.zeros(1)
        bags = [filtered(bag, spec) for bag in self.bags]
        for output in self.outputs:
            rows = self._rows(output, bags, self.joints)
            errors, _ = self._grouped(LeftOut(rows))
            total = total + errors.sum(axis=1) / rows.power.sum()
        return total / len(self.outputs)

    def _choose_effort(self) -> None:
        bags = [filtered(bag, self.spec) for bag in self.bags]
        rows = self._rows('effort', bags, all_candidates(self.joints, self.without))
        left_out = LeftOut(rows)
        power = float(rows.power.sum())
        start = list(self.joints)

        def percent(errors: FloatArray) -> float:
            return _percent(errors.sum(axis=1) / power)

        errors, self.shared = self._grouped(left_out)
        constants = left_out.fitted(start, shared=self.shared)[1] if self.shared else None
        before = left_out.errors(start, shared=self.shared, constants=constants)
        self.joints = choose_friction(left_out, start, self.without, shared=self.shared,
                                      constants=constants)
        after = left_out.errors(self.joints, shared=self.shared, constants=constants)
        if self.joints != start or any(is_open(joint) for joint in start):
            self.made.append(Choice('friction', friction_words(self.joints),
                                    friction_words(start), percent(after), percent(before)))
        if True in rows.groupings and self.settings.shared is None:
            separate, shared = (left_out.errors(self.joints, shared=own) for own in (False, True))
            self.shared = paid(separate.sum(axis=1), shared.sum(axis=1))
            words = 'parameters of its own for each current', 'one set for all currents'
            self.made.append(Choice('inertial parameters', words[self.shared], words[0],
                                    percent(shared if self.shared else separate),
                                    percent(separate)))
        if self.settings.estimator == 'auto':
            self._choose_estimator(left_out, percent)

    def _choose_estimator(
        self, left_out: LeftOut, percent: Callable[[FloatArray], float],
    ) -> None:
        weighted, plain = (left_out.errors(self.joints, shared=self.shared, weighted=own)
                           for own in (True, False))
        better = paid(weighted.sum(axis=1), plain.sum(axis=1))
        if better:
            self.settings = replace(self.settings, estimator='ols')
        self.made.append(Choice('estimator', 'ols' if better else 'wls', 'wls',
                                percent(plain if better else weighted), percent(weighted)))


def friction_words(joints: Sequence[JointSpec]) -> str:
    """Write the friction of joints, those alike together."""
    found: dict[str, list[str]] = {}
    for joint in joints:
        text = ' + '.join(joint.friction) or 'none'
        if joint.asymmetric:
            text += ', each way'
        if joint.friction_velocity != USUAL_SWITCH:
            text += f', sign smoothed over {joint.friction_velocity:g}'
        if joint.bristles:
            text += f', gives way over {" and ".join(f"{d:g}" for d in joint.bristles)}'
        found.setdefault(text, []).append(joint.name)
    if len(found) == 1:
        return next(iter(found))
    return '; '.join(f'{", ".join(names)}: {text}' for text, names in found.items())


def _percent(squares: FloatArray) -> float:
    return 100.0 * float(np.sqrt(squares.sum()))
