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

"""What users leave open is chosen by left-out parts: filters, friction terms, estimator."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import JointSpec, PreprocessingSpec, STATE_KEYS
from tudor_dynamics.errors import FitError, SignalError
from tudor_dynamics.identification.dataset import BagData, common_outputs, filtered
from tudor_dynamics.identification.fit import Choice, FitSettings
from tudor_dynamics.models.base import Range
from tudor_dynamics.models.bundle import KINDS
from tudor_dynamics.models.estimation import (
    find_constants, Products, rescaled, solve, squared_residuals)
from tudor_dynamics.models.friction import (
    BY_LOAD, Coupling, fill_columns, friction_codes, friction_names, states_along, term_of, TERMS)
from tudor_dynamics.models.regressor import base_sets, regressor_of
from tudor_dynamics.typing import FloatArray, Progress


# -- Rows for all candidates at once: those of the bodies, and each friction term that any of them
#    has.
#
# Candidates differ in which columns they take, so one pass over the recordings serves all of them:
# of every part that may be left out, the products of all columns are kept, and to leave a part out
# is a subtraction.

PARTS = 5  # parts that a few recordings are divided into; of more recordings each is a part


class Column(NamedTuple):
    """A column of friction; numbers that it does not depend on are 0."""

    kind: str  # name of the term, with its direction
    code: int  # as `fill_columns` takes it
    switch: float  # velocity of the smoothed sign [rad/s or m/s]
    decay: float  # velocity of Stribeck's curve [rad/s or m/s]
    value: float  # of its state


class CandidateRows(NamedTuple):
    """A part of the training data, its rows and outputs decimated."""

    bodies: FloatArray  # rows of the bodies and rotors, (samples, channels, body_columns)
    # (samples, joints, terms): friction terms of each drive, those of the load as yet without it.
    speed: FloatArray
    output: FloatArray  # efforts or strains in their units, as measured, (samples, channels)


def columns_of(joint: JointSpec) -> list[Column]:
    """Give the friction columns of a joint, those with a state first."""
    found = [Column(term, TERMS[term].code, 0.0, 0.0, value) for term in joint.friction
             for value in joint.state_values(term)]
    for name, code in zip(friction_names(joint), friction_codes(joint).tolist(), strict=True):
        kind, term = name.partition('(')[0], term_of(name)
        if term not in STATE_KEYS:
            # what acts in one direction has a switch
            switched = TERMS[term].switched or kind != term
            found.append(Column(kind, code, joint.friction_velocity if switched else 0.0,
                                joint.stribeck_velocity if TERMS[term].decays else 0.0, 0.0))
    return found


class LeftOut:
    """
    Rows of an output for all candidates, and their errors on parts that are left out, each once.

    A candidate with more in it is taken where the left-out parts clearly pay for it, by the rule
    of one standard error (Breiman et al., Classification and Regression Trees, 1984, Section
    3.4.3): the gain over all parts has to exceed its own scatter between them.
    """

    def __init__(
        self, arm: Arm, output: str, candidates: Sequence[JointSpec], bags: Sequence[BagData],
        strain_form: str, *, payloads: Range | None = None,
    ) -> None:
        self.output = output
        bare = arm.with_joints({joint.name: {'friction': ()} for joint in arm.joints})
        self._coupling = Coupling(arm)
        self._reach = self._coupling.reach if output == 'effort' else np.zeros((0, 0))
        names = [joint.name for joint in arm.joints]
        self.terms: list[list[Column]] = [[] for _ in names]
        if output == 'effort':
            for joint in candidates:
                own = self.terms[names.index(joint.name)]
                own += [column for column in columns_of(joint) if column not in own]
        self._widest = max((len(terms) for terms in self.terms), default=0)
        self._codes = np.zeros((self._widest, len(names)), dtype=np.intp)
        self._values = np.zeros((self._widest, len(names)))
        for i, columns in enumerate(self.terms):
            for k, column in enumerate(columns):
                self._codes[k, i], self._values[k, i] = column.code, column.value
        self.groupings = {}
        kept: set[int] = set()
        for shared in (False, True):
            rows = regressor_of(bare, output, strain_form, shared=shared, payloads=payloads)
            if shared and not rows.unknown:
                continue
            self.groupings[shared] = [(base.channels, base.kept) for base in base_sets(
                rows, len(names))]
            self.unknown, self.scaled = rows.unknown, rows.scaled
            kept |= {int(i) for _, columns in self.groupings[shared] for i in columns}
        self._regressor = rows
        self.columns = np.array(sorted(kept), dtype=np.intp)
        self.scaled = self.scaled[self.columns]
        self.n_columns = len(self.columns) + self._widest * len(self.terms)
        self._rows = [part for bag in bags for part in self._parts_of(
            bag, len(bags), payloads is not None)]
        self.power = np.sum([np.sum(part.output ** 2, axis=0) for part in self._rows], axis=0)
        # of a part, on average: the power without the mean
        self.spread = np.maximum(np.var(np.concatenate(
            [part.output for part in self._rows]), axis=0), 1e-300) * np.mean(
                [len(part.output) for part in self._rows])
        self.assume(None)

    def _parts_of(self, bag: BagData, bags: int, with_payload: bool) -> list[CandidateRows]:
        pieces = []
        for stretch in bag.stretches:
            motion = stretch.motion
            if with_payload:
                motion = np.column_stack([motion, np.full(len(motion), bag.payload)])
            keep = stretch.decimation
            dq = self._coupling.drive_places(stretch.states.dq)
            # columns without a state are 0 in what is followed
            speed = np.swapaxes(states_along(
                stretch, self._coupling, self._codes, self._values), 1, 2).copy()
            for i, columns in enumerate(self.terms):
                for k, column in enumerate(columns):
                    if column.kind in STATE_KEYS:
                        continue
                    one = np.empty((len(dq), 1))
                    fill_columns(dq[:, i], np.array([column.code], dtype=np.intp), column.switch,
                                 column.decay, one)
                    speed[:, i, k] = one[:, 0]
            rows = self._regressor.rows(motion if keep.sections is not None else keep(motion))
            bodies = rows[:, :, self.columns]
            pieces.append(CandidateRows(
                keep(bodies) if keep.sections is not None else bodies, keep(speed),
                keep(getattr(stretch, self.output))))
        whole = [np.concatenate(values) for values in zip(*pieces, strict=True)]
        count = 1 if bags >= PARTS else -(-PARTS // bags)
        edges = np.linspace(0, len(whole[0]), count + 1).astype(int)
        return [CandidateRows(*(values[a:b] for values in whole))
                for a, b in zip(edges[:-1], edges[1:], strict=True)]

    def assume(self, parameters: FloatArray | None) -> None:
        """Take parameters (channels, columns) that give the loads which some terms grow with."""
        self._parts = [self._products(part, parameters) for part in self._rows]
        self._total = [reduce(add, channel) for channel in zip(*self._parts, strict=True)]

    def _products(self, part: CandidateRows, parameters: FloatArray | None) -> list[Products]:
        """Give the products of each channel, on all columns."""
        speed = part.speed
        if parameters is not None:
            speed = speed.copy()
            loads = np.abs(np.einsum('kcp,cp->kc', part.bodies, parameters[:, :len(self.columns)]))
            for i, columns in enumerate(self.terms):
                for k, column in enumerate(columns):
                    if TERMS[term_of(column.kind)].loaded:
                        speed[:, i, k] *= loads[:, i]
        found = []
        for channel in range(part.output.shape[1]):
            friction = [speed[:, i] * self._reach[channel, i] for i in range(len(self._reach))]
            wide = np.hstack([part.bodies[:, channel], *friction])
            product = Products.empty(self.n_columns)
            product.add(wide, part.output[:, channel])
            found.append(product)
        return found

    def taken(self, joints: Sequence[JointSpec], columns: NDArray[np.intp]) -> NDArray[np.intp]:
        """Give the places of the columns that a candidate takes."""
        bodies = np.searchsorted(self.columns, columns)
        if self.output != 'effort':
            return bodies
        friction = [len(self.columns) + i * self._widest + self.terms[i].index(column)
                    for i, joint in enumerate(joints) for column in columns_of(joint)]
        return np.concatenate([bodies, np.array(friction, dtype=np.intp)])

    def errors(
        self, joints: Sequence[JointSpec], *, shared: bool = False, weighted: bool = True,
        constants: FloatArray | None = None,
    ) -> FloatArray:
        """Fit to all parts but one and predict it; (parts, channels), inf with few samples."""
        errors = np.zeros((len(self._parts), len(self._total)))
        for channels, kept in self.groupings[shared]:
            places = self.taken(joints, kept)
            for k, part in enumerate(self._parts):
                others = [_narrow(self._total[i], places, part[i]) for i in channels]
                try:
                    parameters, found = self._solve(others, places, shared, weighted, constants)
                except FitError:
                    errors[k, list(channels)] = np.inf
                    continue
                for i, values in zip(channels, parameters, strict=True):
                    errors[k, i] = squared_residuals(_narrow(part[i], places), values)
        return errors

    def fitted(
        self, joints: Sequence[JointSpec], *, shared: bool = False,
    ) -> tuple[FloatArray, FloatArray | None]:
        """Fit all parts: parameters (channels, columns), torque constants (channels,)."""
        full = np.zeros((len(self._total), self.n_columns))
        constants = None
        for channels, kept in self.groupings[shared]:
            places = self.taken(joints, kept)
            parameters, constants = self._solve(
                [_narrow(self._total[i], places) for i in channels], places, shared, True, None)
            for i, values in zip(channels, parameters, strict=True):
                full[i, places] = values
        return full, constants

    def _solve(
        self, products: list[Products], places: NDArray[np.intp], shared: bool, weighted: bool,
        constants: FloatArray | None,
    ) -> tuple[list[FloatArray], FloatArray | None]:
        if not shared:
            return [solve(products, weighted=weighted).parameters] * len(products), None
        bodies = places < len(self.columns)
        scaled = np.zeros(len(places), dtype=bool)
        scaled[bodies] = self.scaled[places[bodies]]
        if constants is None:
            constants = find_constants(products, scaled, self.unknown).values
        common = solve([rescaled(product, scaled, value) for product, value in
                        zip(products, constants, strict=True)], weighted=weighted).parameters
        return [np.where(scaled, common / value, common) for value in constants], constants


def _narrow(
    product: Products, places: NDArray[np.intp], without: Products | None = None,
) -> Products:
    index = np.append(places, len(product.gram) - 1)
    gram, n = product.gram[np.ix_(index, index)], product.n
    if without is None:
        return Products(gram, n)
    return Products(gram - without.gram[np.ix_(index, index)], n - without.n)


LEAST_GAIN = 0.01
"""Part of the error that a choice has to bring: less is no reason for more parameters."""


def paid(before: FloatArray, after: FloatArray) -> bool:
    """Say whether left-out parts clearly pay for a candidate: before, after (parts,)."""
    if not np.all(np.isfinite([before, after])) or not before.sum() > 0.0:
        return False
    gains = before - after
    scatter = float(np.std(gains, ddof=1)) * np.sqrt(len(gains)) if len(gains) > 1 else np.inf
    return bool(np.sqrt(after.sum() / before.sum()) < 1.0 - LEAST_GAIN and gains.sum() > scatter)


# -- Friction terms for each joint: added one after the other, as long as left-out parts pay

ROUNDS = 3  # additions that a joint may get
SWITCHES = (0.05, 0.25, 5.0)
"""Speeds of the smoothed sign that are tried, in that of the description."""
HYSTERESIS = (0.01, 0.05)
"""Distances over which friction gives way where none was chosen [rad or m]; UR10, Airbot."""
TRIED = tuple(name for name, term in TERMS.items() if term.tried)
TRIED_STATES = tuple(name for name, term in TERMS.items() if term.tried_values)
JointChange = Mapping[str, Any]


def choices_of(joint: JointSpec) -> dict[str, Any]:
    """Give all keys of a joint that a choice of its friction sets."""
    return {key: getattr(joint, key) for key in (
        'friction', 'asymmetric', 'friction_velocity', *STATE_KEYS.values())}


def is_open(joint: JointSpec) -> bool:
    """Say whether the description leaves the friction terms of a joint to be chosen."""
    return not joint.model_fields_set & {'friction', 'asymmetric'}


def additions(joint: JointSpec, left_out: Collection[str]) -> dict[str, JointChange]:
    """Give what may be added to the friction of a joint, by its name; empty where all is fixed."""
    found: dict[str, JointChange] = {}
    if is_open(joint):
        for term in TRIED:
            if term in left_out or term in joint.friction or (
                    TERMS[term].constant and joint.asymmetric):
                continue
            found[term] = {'friction': (*joint.friction, term)}
        for term in TRIED_STATES:
            values = joint.state_values(term)
            for value in () if term in left_out else TERMS[term].tried_values:
                if value not in values:
                    found[f'{term} {value:g}'] = {
                        'friction': tuple(dict.fromkeys((*joint.friction, term))),
                        STATE_KEYS[term]: tuple(sorted((*values, value)))}
        if not joint.asymmetric:
            found['asymmetric'] = {'asymmetric': True, 'friction': tuple(
                term for term in joint.friction if not TERMS[term].constant)}
    if 'friction_velocity' not in joint.model_fields_set:
        for factor in SWITCHES:
            found[f'switch {factor:g}'] = {'friction_velocity': USUAL_SWITCH * factor}
    return found


def all_candidates(joints: Sequence[JointSpec], left_out: Collection[str]) -> list[JointSpec]:
    """Give the joints with all friction that can come out, for the rows to have its columns."""
    found = []
    for joint in joints:
        changes = additions(joint, left_out).values()
        for one in (joint, *(_changed(joint, change) for change in changes
                             if 'friction_velocity' in change)):
            found.append(one)
            if is_open(joint):
                every = _changed(one, {'friction': (*joint.friction, *(
                    term for term in TRIED if term not in left_out))})
                found += [every, _changed(every, {'asymmetric': True})]
        if is_open(joint):
            found += [_changed(joint, {'friction': (term,),
                                       STATE_KEYS[term]: TERMS[term].tried_values})
                      for term in TRIED_STATES if term not in left_out]
    return found


def hysteretic(joints: Sequence[JointSpec]) -> list[JointSpec]:
    """Give joints hysteresis, of two sizes, where the description leaves friction open."""
    return [_changed(joint, {'friction': (*joint.friction, 'presliding'),
                             'presliding_distances': HYSTERESIS})
            if is_open(joint) else joint for joint in joints]


def _changed(joint: JointSpec, change: JointChange) -> JointSpec:
    # what was open stays open: what is tried does not count as described
    content = {**{name: getattr(joint, name) for name in JointSpec.model_fields}, **change}
    return JointSpec.model_construct(_fields_set=set(joint.model_fields_set), **content)


def choose_friction(
    left_out: LeftOut, joints: Sequence[JointSpec], without: Collection[str], *,
    shared: bool, constants: FloatArray | None,
) -> list[JointSpec]:
    """Add friction terms to joints whose left-out errors clearly pay for them."""
    # all open joints are given the same addition at once, since friction shows in its own joint:
    # one fit to each part shows for every joint whether it pays there
    current = list(joints)

    def errors(candidate: Sequence[JointSpec]) -> FloatArray:
        return left_out.errors(candidate, shared=shared, constants=constants)

    for _ in range(ROUNDS):
        left_out.assume(left_out.fitted(current, shared=shared)[0])
        base = errors(current)
        options = [additions(joint, without) for joint in current]
        best: dict[int, tuple[float, JointSpec]] = {}
        for name in dict.fromkeys(name for option in options for name in option):
            candidate = [_changed(joint, option[name]) if name in option else joint
                         for joint, option in zip(current, options, strict=True)]
            found = errors(candidate)
            for i, option in enumerate(options):
                if name in option and candidate[i] != current[i] and paid(base[:, i], found[:, i]):
                    gain = float(found[:, i].sum())
                    if i not in best or gain < best[i][0]:
                        best[i] = gain, candidate[i]
        chosen = [best[i][1] if i in best else joint for i, joint in enumerate(current)]
        if not best or not errors(chosen).sum() < base.sum():
            break
        current = chosen
    return current


# -- What users leave open: filters, friction terms, shared parameters, estimator.
#
# Chosen by parts of the training data that are left out; test data have no hand in it. The simpler
# choice stays where the left-out parts do not clearly pay for the other.

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
    blind: Choices | None = None  # choices by the rest of an only bag whose end is held out


def choose(
    arm: Arm, bags: Sequence[BagData], preprocessing: PreprocessingSpec, settings: FitSettings,
    progress: Progress = lambda _: None, *, summable: bool = False,
) -> Choices:
    """Choose what description and settings leave open."""
    progress('choose what is open')
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
        follows = all(KINDS[kind].model.has_memory for kind in settings.kinds)
        # a load on the gear is no term of an arm that is followed, nor affine in a payload
        self.without = (*((BY_LOAD,) if summable or follows or settings.payloads is not None
                          else ()), *(STATE_KEYS if follows else ()))
        # what follows measured positions has no filter to choose
        self.filter_open = not follows and not spec.model_fields_set & CAUSAL_KEYS

    def choose(self) -> Choices:
        """Go through what is open, what matters most first."""
        if self.filter_open:
            self._choose_filter()
        if 'effort' in self.outputs and {'analytical', 'elastic'} & {*self.settings.kinds}:
            self._choose_effort()
        changes = {old.name: choices_of(new) for old, new in zip(
            self.arm.joints, self.joints, strict=True) if new != old}
        settings = replace(self.settings, shared=self.shared).settled()
        return Choices(self.arm.with_joints(changes), self.spec, settings, tuple(self.made))

    def _left_out(
        self, output: str, bags: Sequence[BagData], joints: Sequence[JointSpec],
    ) -> LeftOut:
        return LeftOut(self.arm, output, joints, bags, self.settings.strain_form,
                       payloads=self.settings.payloads)

    def _grouped(self, left_out: LeftOut) -> tuple[FloatArray, bool]:
        """Give the errors of parameters shared or not, whichever is open and pays."""
        joints = self.joints if left_out.output == 'effort' else []
        if True not in left_out.groupings:
            return left_out.errors(joints), False
        if self.settings.shared is not None:
            return left_out.errors(joints, shared=self.settings.shared), self.settings.shared
        separate, shared = (left_out.errors(joints, shared=own) for own in (False, True))
        return (shared, True) if paid(separate.sum(axis=1), shared.sum(axis=1)) else (
            separate, False)

    def _choose_filter(self) -> None:
        candidates = [('causal', self.spec),
                      (f'causal, all signals after {OUTPUT_CUTOFF:g} Hz',
                       self.spec.model_copy(update={'output_cutoff': OUTPUT_CUTOFF})),
                      ('zero-phase (causal beside the robot)',
                       self.spec.model_copy(update={'filter': 'zero_phase'}))]
        if self.spec.cutoff is None:
            half = 0.05 / self.bags[0].recording.dt
            candidates.append((
                f'zero-phase with {half:.3g} Hz (causal beside the robot)',
                self.spec.model_copy(update={'filter': 'zero_phase', 'cutoff': half})))
        best = first = self._relative(self.spec)
        name = usual = candidates[0][0]
        for label, candidate in candidates[1:]:
            try:
                found = self._relative(candidate)
            except SignalError:
                continue  # the recordings are too short or too slow for it
            if paid(best, found):
                best, name, self.spec = found, label, candidate
        self.made.append(Choice('filters', name, usual, _percent(best), _percent(first)))

    def _relative(self, spec: PreprocessingSpec) -> FloatArray:
        """Give relative squared errors of each part, the mean of all outputs, as they are used."""
        total: FloatArray = np.zeros(1)
        bags = [filtered(bag, spec) for bag in self.bags]
        for output in self.outputs:
            left_out = self._left_out(output, bags, self.joints)
            total = total + self._grouped(left_out)[0].sum(axis=1) / left_out.power.sum()
        return total / len(self.outputs)

    def _choose_effort(self) -> None:
        bags = [filtered(bag, self.spec) for bag in self.bags]
        left_out = self._left_out('effort', bags, all_candidates(self.joints, self.without))
        power = float(left_out.power.sum())
        start = list(self.joints)

        def percent(errors: FloatArray) -> float:
            return _percent(errors.sum(axis=1) / power)

        _, self.shared = self._grouped(left_out)
        constants = left_out.fitted(start, shared=self.shared)[1] if self.shared else None
        before = left_out.errors(start, shared=self.shared, constants=constants)
        self.joints = choose_friction(left_out, start, self.without, shared=self.shared,
                                      constants=constants)
        after = left_out.errors(self.joints, shared=self.shared, constants=constants)
        if self.joints != start or any(is_open(joint) for joint in start):
            self.made.append(Choice('friction', friction_words(self.joints),
                                    friction_words(start), percent(after), percent(before)))

        def second(what: str, words: tuple[str, str], *both: FloatArray) -> bool:
            """Take the second of two ways where left-out parts pay for it."""
            better = paid(*(errors.sum(axis=1) for errors in both))
            self.made.append(Choice(what, words[better], words[0], percent(both[better]),
                                    percent(both[0])))
            return better

        if True in left_out.groupings and self.settings.shared is None:
            self.shared = second('inertial parameters', (
                'parameters of its own for each current', 'one set for all currents'),
                *(left_out.errors(self.joints, shared=own) for own in (False, True)))
        if (self.settings.estimator == 'auto' and 'analytical' in self.settings.kinds
                and second('estimator', ('wls', 'ols'), *(
                    left_out.errors(self.joints, shared=self.shared, weighted=own)
                    for own in (True, False)))):
            self.settings = replace(self.settings, estimator='ols')


def friction_words(joints: Sequence[JointSpec]) -> str:
    """Write the friction of joints, those alike together."""
    found: dict[str, list[str]] = {}
    for joint in joints:
        text = ' + '.join(joint.friction) or 'none'
        if joint.asymmetric:
            text += ', each way'
        if joint.friction_velocity != USUAL_SWITCH:
            text += f', sign smoothed over {joint.friction_velocity:g}'
        for term in STATE_KEYS:
            if values := joint.state_values(term):
                text += (f', {TERMS[term].state_words} '
                         f'{" and ".join(f"{value:g}" for value in values)}')
        found.setdefault(text, []).append(joint.name)
    if len(found) == 1:
        return next(iter(found))
    return '; '.join(f'{", ".join(names)}: {text}' for text, names in found.items())


def _percent(squares: FloatArray) -> float:
    return 100.0 * float(np.sqrt(squares.sum()))
