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
The search for the motion that shows the parameters best, within all limits.

A Fourier series has hundreds of coefficients, and the cost exact slopes by them: a quasi-Newton
descent (L-BFGS) with penalties for what is beyond the limits, which grow from stage to stage. At
its end each joint is scaled into its limits exactly, and the whole motion is drawn towards its
middle where efforts or links ask for it. An APRBS is a draw: the best of many, and of changes to
the best.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize

from tudor_dynamics.errors import SignalError
from tudor_dynamics.excitation.bounds import Bounds, CLEARANCE
from tudor_dynamics.excitation.information import (
    covariance_of, Criterion, Information, mean_error)
from tudor_dynamics.excitation.series import Series, series
from tudor_dynamics.signals.excitation import aprbs, JointRange, Targets
from tudor_dynamics.signals.motion_profile import follow_targets, Reference
from tudor_dynamics.typing import FloatArray

STAGES = (10.0, 1e3, 1e4)
"""Weights of the penalties, one after the other."""
SAMPLES, CLOSE_SAMPLES = 4.0, 20.0
"""Samples for each period of the largest frequency, while it is searched: of what the motion
shows, which is cheaper where they are few, and of its limits, which are passed between them
otherwise."""
LEAST_RATE = 5.0
"""Samples a second at least [Hz]."""
POSES = 100
"""Random poses from which the one with the most room between links is where a search begins."""
HALVINGS = 12
CHECKED = 50.0
"""Rate at which efforts and distances between links are looked at in the end [Hz]."""
LOOKED_AT = 20.0
"""Rate at which an APRBS is judged [Hz]."""

Report = Callable[[float], bool]
"""Told the cost of each step of a search; answers whether to stop."""


@dataclass(frozen=True)
class Order:
    """What motion is wanted."""

    seconds: float  # length with the rests at its ends [s]
    highest: float  # largest frequency of a Fourier series [Hz]
    dt: float  # sample time of the motion that comes out [s]
    steps: int  # steps of the descent in each stage, or draws of an APRBS
    seed: int  # of where the search begins


def best_series(
    information: Information, bounds: Bounds, order: Order, report: Report = lambda _: False,
    criterion: Criterion = mean_error,
) -> Reference:
    """Find a Fourier series that shows parameters well."""
    basis, close = (series(bounds.range, bounds.limits, order.seconds, order.highest,
                           1.0 / max(samples * order.highest, LEAST_RATE))
                    for samples in (SAMPLES, CLOSE_SAMPLES))
    shape = basis.sizes.shape
    generator = np.random.default_rng(order.seed)
    x = generator.normal(size=shape) / np.sqrt(shape[0])
    x[0] = _middle(bounds, basis, generator)
    stopped = False

    def step(intermediate_result: optimize.OptimizeResult) -> None:
        nonlocal stopped
        stopped = report(float(intermediate_result.fun))
        if stopped:
            raise StopIteration

    for weight in STAGES:
        def cost(flat: FloatArray, weight: float = weight) -> tuple[float, FloatArray]:
            own = flat.reshape(shape)
            motion = basis.motion(own)
            value, slope = information.cost(motion, criterion)
            coupled, coupled_slope = bounds.coupled_penalty(motion)
            beyond, beyond_slope = bounds.penalty(close.motion(own))
            return (value + weight * (coupled + beyond),
                    (basis.slope(slope + weight * coupled_slope)
                     + close.slope(weight * beyond_slope)).ravel())

        x = optimize.minimize(
            cost, x.ravel(), jac=True, method='L-BFGS-B', callback=step,
            options={'maxiter': order.steps, 'maxcor': 20}).x.reshape(shape)
        if stopped:
            break
    fine = series(bounds.range, bounds.limits, order.seconds, order.highest, order.dt)
    return _within(fine, x, bounds)


def _middle(bounds: Bounds, basis: Series, generator: np.random.Generator) -> FloatArray:
    """Choose the pose about which a search begins: that with the most room between links."""
    n = len(bounds.range.lower)
    if bounds.links is None:
        return generator.uniform(-0.1, 0.1, n)
    best, room = np.zeros(n), -np.inf
    for _ in range(POSES):
        x = generator.uniform(-0.5, 0.5, n)
        near = bounds.links.near(basis.centre + basis.sizes[0] * x, 10.0 * CLEARANCE)
        least = float(near.distance.min(initial=10.0 * CLEARANCE))
        if least > room:
            best, room = x, least
    return best


def _within(fine: Series, x: FloatArray, bounds: Bounds) -> Reference:
    """Scale a motion into its limits, each joint by itself, then all where it has to be."""
    motion = fine.motion(x)
    n = x.shape[1]
    mid, half = fine.centre, fine.sizes[0]
    constant = np.clip(mid + x[0] * half, bounds.range.lower + 0.01 * half,
                       bounds.range.upper - 0.01 * half)
    swing = motion[:, :n] - (mid + x[0] * half)
    room = np.minimum(
        (bounds.range.upper - constant) / np.maximum(swing.max(axis=0), 1e-12),
        (constant - bounds.range.lower) / np.maximum(-swing.min(axis=0), 1e-12))
    fast = bounds.limits.velocity / np.maximum(np.abs(motion[:, n:2 * n]).max(axis=0), 1e-12)
    sharp = bounds.limits.acceleration / np.maximum(np.abs(motion[:, 2 * n:]).max(axis=0), 1e-12)
    scale = np.minimum(1.0, np.minimum(room, np.minimum(fast, sharp)))
    y = x * scale
    y[0] = (constant - mid) / half

    def scaled(factor: float) -> FloatArray:
        smaller = y * factor
        smaller[0] = y[0]
        return smaller

    every = max(int(round(1.0 / (CHECKED * fine.dt))), 1)

    def allowed(factor: float) -> bool:
        return bounds.beyond(fine.motion(scaled(factor))[::every]).excess == 0.0

    factor = 1.0
    if not allowed(1.0):
        low, high = 0.0, 1.0
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if allowed(middle) else (low, middle)
        factor = low
    if factor < 0.1:
        found = bounds.beyond(fine.motion(scaled(0.1))[::every])
        msg = (f'no motion was found within all limits: {", ".join(found.nearest) or "efforts"} '
               'already in small motions')
        raise SignalError(msg, remedy='give another --seed, planned ranges without '
                                      'collisions, or an SRDF that takes pairs out')
    return fine.reference(scaled(factor))


def best_aprbs(
    information: Information, bounds: Bounds, order: Order, report: Report = lambda _: False,
) -> Reference:
    """Find an APRBS that shows parameters well, by draws and by changes to the best of them."""
    generator = np.random.default_rng(order.seed)
    samples = int(round(order.seconds / order.dt)) + 1
    every = max(int(round(1.0 / (LOOKED_AT * order.dt))), 1)
    best: tuple[tuple[float, float], Targets, Reference] | None = None
    for draw in range(order.steps):
        if best is None or draw < order.steps // 3:
            targets = aprbs(_part(bounds, generator), order.seconds,
                            int(generator.integers(2**31)),
                            clock=float(generator.uniform(0.5, 1.5)))
        else:
            targets = _changed(best[1], bounds, generator)
        reference = follow_targets(targets.start, targets.times, targets.values, bounds.limits,
                                   order.dt, samples)
        motion = reference.motion[::every]
        # first what is allowed, then what shows most
        cost = (bounds.beyond(motion).excess, mean_error(
            [covariance_of(item) for item in information.matrices(motion)])[0])
        if best is None or cost < best[0]:
            best = (cost, targets, reference)
        if report(best[0][1]):
            break
    if best is None or best[0][0] > 0.0:
        raise SignalError(f'none of {order.steps} APRBS is within the limits of efforts and free '
                          'of collisions', remedy='take --kind fourier, or smaller planned ranges')
    return best[2]


def _part(bounds: Bounds, generator: np.random.Generator) -> JointRange:
    """Draw a part of the range, where all of it is more than links and efforts allow."""
    if bounds.links is None and bounds.efforts is None:
        return bounds.range
    size = bounds.range.upper - bounds.range.lower
    length = size * generator.uniform(0.2, 1.0)
    lower = bounds.range.lower + generator.uniform(0.0, 1.0, len(size)) * (size - length)
    return JointRange(lower, lower + length)


def _changed(targets: Targets, bounds: Bounds, generator: np.random.Generator) -> Targets:
    """Give one joint another target at one time."""
    j = int(generator.integers(len(targets.values)))
    values = targets.values[j].copy()
    values[int(generator.integers(len(values)))] = generator.uniform(
        bounds.range.lower[j], bounds.range.upper[j])
    return replace(targets, values=tuple(
        values if i == j else item for i, item in enumerate(targets.values)))
