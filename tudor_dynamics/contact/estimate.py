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

"""A contact as it is estimated at one sample, and what one that lasts comes to."""

from __future__ import annotations

from dataclasses import dataclass, field
import math
from typing import Any

import numpy as np

from tudor_dynamics.contact.layout import ACROSS, ALONG, MOMENT
from tudor_dynamics.contact.span import Span
from tudor_dynamics.typing import FloatArray

TOLD = 0.5
"""Part of what was not known of a place before; one that is less certain is not told."""


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
    force_deviation: float  # standard deviation of the force across the link [N]
    # Standard deviation of the torque about the axis that its gauges see [N m].
    torque_deviation: float
    # Along the link, from its joint; NaN where force and place cannot be told apart [m].
    place: float
    place_deviation: float
    point: FloatArray  # the place in the frame of the link; NaN where it is not known, (3,) [m]
    pressing: FloatArray  # for each span (F, F a, A), (spans, PRESSING) [N, N m, N]
    likely: FloatArray  # logarithm of the likelihood of the newest readings, (spans,)

    @property
    def located(self) -> bool:
        """Whether its place is known."""
        return not math.isnan(self.place)

    @property
    def note(self) -> str:
        """Say what cannot be said; empty for nothing."""
        return '' if self.located or not self.felt else (
            'the gauges cannot tell place from force')


@dataclass
class ContactRecord:
    """Sums over a contact: its place does not change, so all samples tell of it together."""

    spans: tuple[Span, ...]  # where contacts are looked for
    links: tuple[str, ...]
    _likely: FloatArray = field(init=False)
    _moments: FloatArray = field(init=False)
    _largest: FloatArray = field(init=False)
    _count: int = 0

    def __post_init__(self) -> None:
        n = len(self.spans)
        self._likely = np.log([max(span.outer - span.inner, 1e-3) for span in self.spans])
        self._moments, self._largest = np.zeros((n, 4)), np.zeros(n)

    def add(self, estimate: ContactEstimate) -> None:
        """Take a sample of the contact."""
        force, moment = estimate.pressing[:, ACROSS], estimate.pressing[:, MOMENT]
        self._likely = self._likely + estimate.likely
        self._moments = self._moments + np.column_stack(
            [force * force, force * moment, moment * moment, force])
        self._largest = np.where(np.abs(force) > np.abs(self._largest), force, self._largest)
        self._count += 1

    def summary(self) -> dict[str, Any]:
        """
        Give what it comes to.

        Returns ``link``, ``force`` (mean across the link) and ``largest_force`` [N], ``place`` and
        ``place_deviation`` (None where it cannot be told) [m]; empty without a sample.
        """
        if self._count == 0 or not self.spans:
            return {}
        weights = np.exp(self._likely - self._likely.max())
        weights /= weights.sum()
        totals = {link: float(sum(w for w, of in zip(weights, self.links, strict=True)
                                  if of == link)) for link in self.links}
        link = max(totals, key=lambda name: totals[name])
        own = [k for k, of in enumerate(self.links) if of == link]
        share = weights[own] / weights[own].sum()
        force = float(share @ (self._moments[own, 3] / self._count))
        largest = float(share @ self._largest[own])
        places, spreads = np.array([self._place(k) for k in own]).T
        place = float(share @ places)
        spread = math.sqrt(float(share @ (spreads**2 + (places - place)**2)))
        prior = prior_spread([self.spans[k] for k in own])
        told = spread <= TOLD * prior or prior == 0.0
        return {'link': link, 'certain': round(totals[link], 4), 'force': force,
                'largest_force': largest, 'place': place if told else None,
                'place_deviation': spread if told else None}

    def _place(self, k: int) -> tuple[float, float]:
        """Give the place on a span and its standard deviation, by the line through (F, F a)."""
        span, (squares, products, others, _) = self.spans[k], self._moments[k]
        prior = (span.outer - span.inner) / math.sqrt(12.0)
        if squares <= 0.0:
            return span.middle, prior
        raw = products / squares
        scatter = max(others - raw * products, 0.0) / max(self._count - 1, 1)
        spread = math.sqrt(scatter / squares)
        near = min(max(raw, span.inner), span.outer)
        return near, min(max(spread, abs(raw - near)), max(prior, 1e-9))


def prior_spread(spans: list[Span]) -> float:
    """Give the standard deviation of a place of which only the link is known [m]."""
    reach = max(span.outer for span in spans) - min(span.inner for span in spans)
    return reach / math.sqrt(12.0)


@dataclass(frozen=True, eq=False)
class Belief:
    """What is believed of each span at a sample."""

    pressing: FloatArray  # (F, F a, A), (spans, PRESSING) [N, N m, N]
    covariance: FloatArray  # covariance of what presses on each span, (spans, PRESSING, PRESSING)
    weight: FloatArray  # how likely each is, in all 1, (spans,)


def significance(belief: Belief, k: int) -> float:
    """Give the squared size of (F, F a) on a span, in standard deviations."""
    value, spread = belief.pressing[k, :ALONG], belief.covariance[k, :ALONG, :ALONG]
    scale = np.sqrt(np.maximum(np.diag(spread), 1e-300))
    white = spread / np.outer(scale, scale) + 1e-9 * np.eye(ALONG)
    unit = value / scale
    return float(unit @ np.linalg.solve(white, unit))


def place_on(belief: Belief, k: int, span: Span) -> tuple[float, float]:
    """Give the place on a span and its standard deviation, within the span [m]."""
    prior = (span.outer - span.inner) / math.sqrt(12.0)
    force, moment = float(belief.pressing[k, ACROSS]), float(belief.pressing[k, MOMENT])
    if prior == 0.0 or force == 0.0:
        return span.middle, prior
    raw = moment / force
    line = np.array([-raw, 1.0])
    spread = math.sqrt(max(float(line @ belief.covariance[k, :ALONG, :ALONG] @ line), 0.0))
    return min(max(raw, span.inner), span.outer), min(spread / abs(force), prior)
