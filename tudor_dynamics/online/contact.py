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

"""Force and place of a contact from strain; link and torque from efforts."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
import math
from typing import Any

import numpy as np

from tudor_dynamics.arm.kinematics import joint_axis, link_frame
from tudor_dynamics.errors import ModelError, SimulationError
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.elastic.model import ElasticModel
from tudor_dynamics.online.contact_fronts import (
    ACROSS, ALONG, correct, ElasticFront, gauge_gain, link_axes, MOMENT, newtons_of, PRESSING,
    RigidFront, Span, spans_of, strain_deviation, torque_scale, validation_rmse)
from tudor_dynamics.online.settings import (
    CONTACT_STEP, DEVIATION_STEP, ELASTIC_DETECTED, ELASTIC_ENDED, ELASTIC_OFFSET,
    EVIDENCE_MEMORY, FORCE_MEMORY, FREE_EVIDENCE_MEMORY, HELD_FORCE_MEMORY, INNOVATION_BOUND,
    LARGEST_FORCE, MOVING_DEVIATIONS, OFFSET_MEMORY, OTHER_SHARE, PEAK_TIME, PLACE_CERTAIN,
    RECORD_ROWS, RIGID_DETECTED, RIGID_ENDED, RIGID_OFFSET, RINGING_FLOOR, RINGING_MEMORY,
    RINGING_SAMPLES, STANDING_DEVIATION, STANDING_MEMORY, STANDING_SPEED, STANDING_VARIANCE,
    TORQUE_DETECTED, TORQUE_ENDED, TOUCH_SHARE)
from tudor_dynamics.typing import FloatArray, Shown


@dataclass(frozen=True, eq=False)
class ContactEstimate:
    """What touches an arm at one sample."""

    stamp: int  # header stamp of the sample [ns]
    link: str  # link that is touched, the most likely one; its frame is that of the vectors
    joint: str  # joint that moves it
    felt: bool  # whether something touches the arm beyond doubt
    # On the link, about the origin of its frame, (3,) [N, N m].
    force: FloatArray
    torque: FloatArray
    force_deviation: float  # across the link [N]; NaN where the force is not known, as the force
    torque_deviation: float  # about the axis that its gauges bend about [N m]
    # Along the link, from its joint; NaN where place and force are not identifiable [m].
    place: float = math.nan
    place_deviation: float = math.nan
    # The place in the frame of the link; NaN where it is not known, (3,) [m].
    point: FloatArray = field(default_factory=lambda: np.full(3, np.nan))
    # For each span (F, F a, A) by the scale of the model, (spans, PRESSING) [N, N m, N].
    pressing: FloatArray = field(default_factory=lambda: np.zeros((0, PRESSING)))
    # Covariance of these for each span, (spans, PRESSING, PRESSING).
    spread: FloatArray = field(default_factory=lambda: np.zeros((0, PRESSING, PRESSING)))
    # Logarithm of the likelihood of the newest readings, (spans,).
    likely: FloatArray = field(default_factory=lambda: np.zeros(0))
    note: str = ''  # what cannot be said, why, and what would show it; empty for nothing


LINK_ALONE = 'efforts show the link alone; gauges would show force and place'


def not_known(span: Span, newtons: tuple[float, float], *, placed: bool) -> str:
    """Say what is not known of a contact on a span, why, and what would show it."""
    return '; '.join([
        'the gauges cannot separate place and force; two gauges before the place would show it'
        if span.spread else f'the link of {span.joint} has one gauge, so a push at its end is '
        'assumed; a second gauge would show the place'] * (not placed) + [
        f'a force along the link of {span.joint} shows in no gauge'] * (not span.along) + [
        f'strain and described masses give newtons to {100.0 * newtons[1]:.0f} % only; add '
        'sensors[].gain, or fit bags of two known loads'] * math.isnan(newtons[0]))


class ContactRecord:
    """What a contact comes to: its place does not change, so all samples of it count together."""

    def __init__(
        self, spans: Sequence[Span], links: Sequence[str],
        together: float = 1.0,  # samples that count as one: the residual of a moving arm rings
        newtons: tuple[float, float] = (1.0, 0.0),  # see `newtons_of`
    ) -> None:
        self.spans, self.links, self.together, self._newtons = spans, links, together, newtons
        self._prior = np.log([span.weight for span in spans])
        self._seen: list[ContactEstimate] = []

    def add(self, *estimates: ContactEstimate) -> None:
        """Take samples of the contact, or of the moments before and after it."""
        self._seen += estimates

    def summary(self) -> dict[str, Any]:
        """Give link, force (mean, peak, course) [N], time, places [m]; empty without a sample."""
        if not self._seen or not self.spans:
            return {}
        pressing = np.array([item.pressing for item in self._seen])
        likely = np.array([item.likely for item in self._seen])
        spread = np.array([item.spread for item in self._seen])
        during = slice(0, len(pressing))
        for _ in range(2):  # the touch by the likeliest link, and the link by the touch
            link, own, weights = most_likely(
                self._prior + likely[during].sum(axis=0) / self.together, self.links)
            share = weights[own] / weights[own].sum()
            force, variance = (np.tensordot(values[:, own][:, :, [ACROSS, ALONG]], share, (1, 0))
                               for values in (pressing, np.diagonal(spread, 0, 2, 3)))
            during = touch(force / np.sqrt(np.maximum(variance, 1e-12)))
        kept, best = self._seen[during], int(np.argmax(share))
        # what the residual of free motion makes of a place does not become less over a touch
        places = [place_on(self.spans[k], pressing[during, k], spread[during, k], self.together)
                  for k in own]
        place, unsure, known = place_among([self.spans[k] for k in own], share, places)
        if not known:  # two places that are each certain are said
            known = place_among([self.spans[k] for k in own], np.eye(len(own))[best], places)[2]
        others = [places[n][0] for n in np.argsort(-share).tolist()
                  if n != best and share[n] > OTHER_SHARE]
        span = self.spans[own[best]]
        across, along = force[during].mean(axis=0)
        deviation = math.sqrt(variance[during].sum(axis=1).mean() / self.together)
        factor, doubt = self._newtons
        mean = math.hypot(across, along)
        t = 1e-9 * np.array([item.stamp - kept[0].stamp for item in kept])
        width = math.ceil(len(t) * min(1.0, PEAK_TIME / max(t[-1], 1e-9)))
        total = np.pad(force[during].cumsum(axis=0), ((1, 0), (0, 0)))
        held = np.hypot(*(total[width:] - total[:-width]).T) / width
        course = np.column_stack([t, factor * np.hypot(*force[during].T)])[
            ::-(-len(t) // RECORD_ROWS)]
        forces = {'force': mean, 'peak': max(mean, held.max()), 'across': across,
                  'along': along if span.along else math.nan,
                  'force_deviation': math.hypot(deviation, doubt * mean)}
        return {'link': link, 'certain': round(float(sum(weights[k] for k in own)), 4),
                **{name: None if math.isnan(factor * value) else float(factor * value)
                   for name, value in forces.items()},
                'course': [] if math.isnan(factor) else course.tolist(),
                'seconds': float(t[-1]),
                'place': place if known else None, 'place_deviation': unsure if known else None,
                'or_place': others[0] if known and others else None,
                'note': not_known(span, self._newtons, placed=known)}


def contact_text(found: dict[str, Any]) -> str:
    """Write force, link and place of a summary on a line."""
    force = 'a force' if found['force'] is None else (
        f'{found["force"]:.2f} N (at most {found["peak"]:.2f} N)')
    return f'{force} on {found["link"]}' + (
        '' if found['place'] is None else f', {1e3 * found["place"]:.0f} mm from its joint')


def touch(force: FloatArray) -> slice:
    """Find the samples of a touch by its force in deviations (samples, parts): about its peak."""
    peak = int(np.argmax((force**2).sum(axis=1)))
    course = force @ force[peak]
    weak = np.flatnonzero(course <= TOUCH_SHARE * course[peak])
    begin, end = weak[weak < peak], weak[weak > peak]
    return slice(int(begin[-1]) + 1 if len(begin) else 0, int(end[0]) if len(end) else None)


def most_likely(likely: FloatArray, names: Sequence[str]) -> tuple[str, list[int], FloatArray]:
    """Find the likeliest name, its spans, and how likely each is, from logarithms (spans,)."""
    weights = np.exp(likely - likely.max())
    weights = weights / weights.sum()
    totals = {name: float(sum(w for w, of in zip(weights, names, strict=True) if of == name))
              for name in names}
    best = max(totals, key=lambda name: totals[name])
    return best, [k for k, of in enumerate(names) if of == best], weights


def place_among(
    spans: Sequence[Span], share: FloatArray, places: Sequence[tuple[float, float]],
) -> tuple[float, float, bool]:
    """Give the likeliest place on several spans of a link [m], its deviation, and if it is one."""
    means, deviations = np.array(places).T
    place = float(means[np.argmax(share)])
    deviation = math.sqrt(float(share @ (deviations**2 + (means - place)**2)))
    reach = max(span.outer for span in spans) - min(span.inner for span in spans)
    prior = reach / math.sqrt(12.0)  # of a place of which only the link is known
    return place, deviation, deviation < PLACE_CERTAIN * prior


def significance(pressing: FloatArray, covariance: FloatArray) -> float:
    """Give the squared size of (F, F a) on a span, in standard deviations."""
    value, spread = pressing[:ALONG], covariance[:ALONG, :ALONG]
    scale = np.sqrt(np.maximum(np.diag(spread), 1e-300))
    white = spread / np.outer(scale, scale) + 1e-9 * np.eye(ALONG)
    unit = value / scale
    return float(unit @ np.linalg.solve(white, unit))


def place_on(
    span: Span, pressing: FloatArray, covariance: FloatArray, together: float = 1.0,
) -> tuple[float, float]:
    """Give the place on a span and its standard deviation, by the line through (F, F a)."""
    squares, products = pressing[:, ACROSS] @ pressing[:, :ALONG]
    if squares <= 0.0:
        return span.middle, span.spread
    line = np.array([-products / squares, 1.0, 0.0])
    spread = math.sqrt(max(float((covariance @ line @ line).sum()), 0.0) / (together * squares))
    near = min(max(-line[0], span.inner), span.outer)
    return near, min(max(spread, abs(-line[0] - near)), span.spread)


# Force and place of a contact from strain, sample by sample.
#
# On each span of each link a contact is looked for by a Kalman filter of its own, and their
# likelihoods say which link and span it is. A rigid model leaves the moments of the contact over;
# an elastic one also the vibration that the contact causes, which the filters carry along.


class ContactEstimator(Shown):
    """
    Estimates what touches an arm with gauges.

    Parameters
    ----------
    bundle : ModelBundle
        Models of the arm.
    kind : str
        Kind of model in use.

    Attributes
    ----------
    spans : tuple of Span
        Where contacts are looked for.
    links : tuple of str
        Frame of the link of each.

    Raises
    ------
    ModelError
        If there is no model of the strain, no gauge has a scale, or no link a length.

    """

    source = 'strain'

    def __init__(self, bundle: ModelBundle, kind: str) -> None:
        model = bundle.models.get('strain', {}).get(kind)
        if model is None:
            raise ModelError(f'contacts need a {kind} model of strain; fit one with strain')
        gain = gauge_gain(bundle.arm, model)
        deviation = np.abs(strain_deviation(bundle, kind) / gain)
        if not np.isfinite(deviation).any():
            raise ModelError(f'arm {bundle.arm.name!r}: no gauge has a known gain (reading per N '
                             'm); add sensors[].gain to the description, or fit an elastic model')
        arm = bundle.arm
        self.spans = spans_of(arm, [bool(v) for v in np.isfinite(deviation)])
        if not self.spans:
            raise ModelError(f'arm {arm.name!r}: no link with gauges has a joint or frame beyond '
                             'them; add a tip frame to the URDF')
        elastic = isinstance(model, ElasticModel)
        self._widening = MOVING_DEVIATIONS if elastic else 1.0
        self._detected, self._ended, self._free = (
            (ELASTIC_DETECTED, ELASTIC_ENDED, ELASTIC_OFFSET) if elastic else
            (RIGID_DETECTED, RIGID_ENDED, RIGID_OFFSET))
        self._deviation = self._widening * np.where(np.isfinite(deviation), deviation, 1e9)
        self._front: ElasticFront | RigidFront = (
            ElasticFront(model, self.spans, gain, self._deviation)
            if isinstance(model, ElasticModel) else RigidFront(arm, self.spans, gain))
        self.links = tuple(link_frame(arm.full_model, span.joint) for span in self.spans)
        self._axes = [link_axes(arm, span.joint) for span in self.spans]
        n = 2 * self._front.modes + PRESSING
        self._state = np.zeros((len(self.spans), n))
        self._covariance = np.zeros((len(self.spans), n, n))
        self._prior = np.log([span.weight for span in self.spans])
        self._last, self._restarts = 0, True
        self._newtons = newtons_of(arm, model)
        self._restart()

    def record(self) -> ContactRecord:
        """Give a record for a contact that begins."""
        return ContactRecord(self.spans, self.links, RINGING_SAMPLES if self._front.modes else 1.0,
                             self._newtons)

    def _restart(self) -> None:
        """Forget the past."""
        self._state[:] = 0.0
        self._covariance[:] = 0.0
        for covariance, span in zip(self._covariance, self.spans, strict=True):
            covariance[-PRESSING:, -PRESSING:] = span.covariance
        self._weight = self._prior.copy()
        self._offset = np.zeros(len(self._deviation))
        self._spread = self._deviation**2
        self._ringing = np.diag(self._spread)
        self._size = 0.0
        self.felt = False

    def step(
        self, stamp: int, begins: bool, row: FloatArray, measured: FloatArray,
        residual: FloatArray | None,
    ) -> ContactEstimate | None:
        """
        Take a sample into account.

        Parameters
        ----------
        stamp : int
            Header stamp [ns].
        begins : bool
            Whether nothing before it counts.
        row : ndarray of shape (3 n_joints,)
            ``[q, dq, ddq]`` of the active joints [rad, rad/s, rad/s^2 or m, m/s, m/s^2].
        measured : ndarray of shape (n_gauges,)
            Readings in their units.
        residual : ndarray of shape (n_gauges,) or None
            Their residual by a rigid model; None while its filters settle.

        Returns
        -------
        ContactEstimate or None
            None at a beginning, for samples that are passed over, and where the readings have
            driven the followed arm beyond what an arm can do: it restarts.

        """
        if begins or stamp <= self._last:
            self._restarts = True
        dt = 0.0 if self._restarts else (stamp - self._last) * 1e-9
        if not self._restarts and dt < CONTACT_STEP:
            return None
        self._last = stamp
        try:
            moment = self._front.residual(dt, row, measured, residual)
        except SimulationError:
            moment = None
        if moment is None or self._restarts:
            self._restart()
            self._restarts = moment is None
            return None
        n = len(row) // 3
        standing = float(np.abs(row[n:2 * n]).max()) < STANDING_SPEED
        free_of_offset = moment - self._offset  # as it was before this sample
        share = self._standing_noise(dt, moment, standing)
        likely = self._correct(dt, free_of_offset, share)
        self._front.settle(moment - self._offset, dt, self._state)
        # free motion says nothing of where a contact is
        kept = math.exp(-dt / (EVIDENCE_MEMORY if self.felt else FREE_EVIDENCE_MEMORY))
        self._weight = (self._weight - self._prior) * kept + self._prior + likely
        found = self._estimate(stamp, likely)
        if not np.abs(found.pressing).max() < LARGEST_FORCE:  # not a number, too
            self._restarts, self.felt = True, False
            return None
        return found

    def _standing_noise(self, dt: float, moment: FloatArray, standing: bool) -> FloatArray:
        """Learn offset and noise of a standing arm; give the part of its usual variance."""
        usual = self._deviation**2
        if not standing:
            self._spread[:] = usual
            self._offset *= math.exp(-dt / OFFSET_MEMORY)
            if self._front.modes and self._size < self._free:
                # how the residual of a moving, untouched arm rings, in all gauges together
                off = np.clip(np.where(np.isfinite(moment), moment, 0.0), -self._deviation,
                              self._deviation)
                floor = np.diag((RINGING_FLOOR / self._widening * self._deviation)**2)
                self._ringing += min(dt / RINGING_MEMORY, 1.0) * (
                    RINGING_SAMPLES * (np.outer(off, off) + floor) - self._ringing)
        elif self._size < self._free:
            off = moment - self._offset
            self._offset += min(dt / OFFSET_MEMORY, 1.0) * off
            # a push that begins is no noise
            self._spread += min(dt / STANDING_MEMORY, 1.0) * (
                np.minimum(off**2, 4.0 * self._spread) - self._spread)
        return np.minimum(1.0, self._spread / usual + (STANDING_DEVIATION / self._widening)**2)

    def _correct(self, dt: float, moment: FloatArray, share: FloatArray) -> FloatArray:
        front = self._front
        known = np.flatnonzero(np.isfinite(moment))
        # noise of an arm that stands is no larger than it was seen
        part = np.sqrt(np.minimum(1.0, share * self._deviation**2 / np.diag(self._ringing)))
        times = DEVIATION_STEP / dt if front.modes else 1.0
        noise = times * np.outer(part, part) * self._ringing
        white = np.linalg.inv(np.linalg.cholesky(noise[np.ix_(known, known)]))
        moment, variance = white @ moment[known], np.ones(len(known))
        quiet = float(share.min())
        moves = front.modes and quiet > STANDING_VARIANCE
        fade = math.exp(-dt / (FORCE_MEMORY if moves else HELD_FORCE_MEMORY))
        likely = np.zeros(len(self.spans))
        for k, span in enumerate(self.spans):
            state, covariance = self._state[k], self._covariance[k]
            rise = (1.0 - fade * fade) * span.covariance
            rows = front.carry(k, state, covariance, dt, fade, rise, quiet)
            likely[k] = correct(state, covariance, white @ rows[known], variance, moment,
                                INNOVATION_BOUND)
        return likely

    def _estimate(self, stamp: int, likely: FloatArray) -> ContactEstimate:
        joint, own, weights = most_likely(self._weight, [span.joint for span in self.spans])
        pressing = self._state[:, -PRESSING:].copy()
        covariance = self._covariance[:, -PRESSING:, -PRESSING:].copy()
        best = max(own, key=lambda k: float(weights[k]))
        self._size = size = max(map(significance, pressing, covariance))
        self.felt = size > (self._ended if self.felt else self._detected)
        share = weights[own] / weights[own].sum()
        values = share @ pressing[own]
        variance = share @ (np.diagonal(covariance[own], 0, 1, 2) + (pressing[own] - values)**2)
        place, unsure, known = place_among(
            [self.spans[k] for k in own], share,
            [place_on(self.spans[k], pressing[k, None], covariance[k, None]) for k in own])
        axes = self._axes[best]
        if not (self.felt and known):
            place = unsure = math.nan
        factor, doubt = self._newtons
        values *= factor
        deviation = np.hypot(factor * np.sqrt(np.maximum(variance, 0.0)), doubt * values)
        return ContactEstimate(
            stamp, self.links[best], joint, self.felt,
            values[ACROSS] * axes.across + values[ALONG] * axes.along,
            values[MOMENT] * axes.bending, float(deviation[ACROSS]), float(deviation[MOMENT]),
            place, unsure, place * axes.along, pressing, covariance, likely,
            not_known(self.spans[best], self._newtons, placed=known) if self.felt else '')


# Which link is touched, and with what torque about its joint, from efforts alone.
#
# The momentum observer gives the external effort of each joint. A contact loads the joints inboard
# of it: the outermost joint that feels one moves the link that is touched. Where on it, and with
# what force, is not identifiable from efforts.


class TorqueEstimator:
    """Estimates link and external torque of a contact."""

    source = 'momentum'  # whose residuals it takes

    def __init__(self, bundle: ModelBundle) -> None:
        arm = bundle.arm
        self._joints = arm.active_joints
        self._gain = torque_scale(arm)
        usual = validation_rmse(bundle, 'effort', 'analytical')
        if usual is None:
            raise ModelError('contacts from efforts need the error of the model on other bags, '
                             'which is unknown; fit the model to several bags, or give test bags')
        if not np.isfinite(self._gain).any():
            raise ModelError(f'arm {arm.name!r}: no torque constant is known; add motors[] with '
                             'torque_constant and gear_ratio to the arm description')
        self._deviation = usual * self._gain
        self._links = tuple(link_frame(arm.full_model, name) for name in self._joints)
        self._axes = [joint_axis(arm.full_model, name) for name in self._joints]
        self.felt = False

    def record(self) -> ContactRecord:
        """Give a record for a contact that begins; efforts show no force."""
        return ContactRecord((), ())

    def step(
        self, stamp: int, begins: bool, row: FloatArray, measured: FloatArray,
        residual: FloatArray | None,
    ) -> ContactEstimate | None:
        """Take a sample into account, as ``ContactEstimator.step`` does."""
        if residual is None:
            self.felt = False
            return None
        torque = -residual * self._gain
        size = np.nan_to_num(np.abs(torque) / self._deviation)
        bound = TORQUE_ENDED if self.felt else TORQUE_DETECTED
        feeling = np.flatnonzero(size > bound)
        self.felt = bool(len(feeling))
        place = int(feeling[-1]) if self.felt else int(np.argmax(size))
        return ContactEstimate(
            stamp, self._links[place], self._joints[place], self.felt, np.zeros(3),
            float(np.nan_to_num(torque[place])) * self._axes[place], math.nan,
            float(self._deviation[place]), note=LINK_ALONE if self.felt else '')


AnyEstimator = ContactEstimator | TorqueEstimator


def contact_estimator(
    bundle: ModelBundle, kind: str, methods: Collection[str],
) -> tuple[AnyEstimator | None, str]:
    """Choose what estimates contacts, and say why it does not find force and place."""
    why: list[str] = []
    for method, limit in (('strain', ''), ('momentum', LINK_ALONE)):
        if method in methods:
            try:
                return (TorqueEstimator(bundle) if limit else ContactEstimator(bundle, kind),
                        '; '.join(why) or limit)
            except ModelError as err:
                why.append(str(err))
    return None, '; '.join(why) or 'only the methods strain and momentum estimate contacts'
