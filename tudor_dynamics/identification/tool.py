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

"""From rings in recordings to the flexible tool that an arm carries."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
import math
from typing import Any
import warnings

import numpy as np

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.errors import FitError, TudorError, TudorWarning
from tudor_dynamics.identification import settings
from tudor_dynamics.identification.dataset import BagData
from tudor_dynamics.identification.ringdowns import block_means, Ring, ring_of, standing
from tudor_dynamics.models.flexible_tool import (
    Flange, flange_motion, FlexibleTool, free_ring)
from tudor_dynamics.models.settings import RING_AFTER, TOOL_CUTOFF, TOOL_MEMORY
from tudor_dynamics.signals.filters import MotionState, zero_phase
from tudor_dynamics.typing import FloatArray

REFERENCE = 'joint_reference'  # what a planned motion is recorded on
KINDS = {'translation': slice(0, 3), 'rotation': slice(3, 6)}
SIZES = np.array([1.0] * 3 + [settings.TOOL_LEVER] * 3)
"""What makes participation of rotations (6,) comparable with that of translations [1, m]."""


@dataclass(frozen=True, eq=False)
class Rest:
    """What rings in a rest, after a motion; None where nothing clear does."""

    flange: Flange
    ring: Ring | None


Pairs = Sequence[tuple[Flange, Ring]]


def find_rests(arm: Arm, recording: Recording, planned: Recording | None = None) -> list[Rest]:
    """Find the rests of a recording, each with its motion: as planned, where that is there."""
    found = []
    for part in recording.segments:
        t = recording.t[part]
        if recording.effort is None or t[-1] - t[0] < RING_AFTER + settings.RING_LEAST:
            continue
        cutoff = min(TOOL_CUTOFF, 0.2 / recording.dt)
        motion = zero_phase(t, recording.q[part], cutoff)
        rests = standing(t, motion.dq)
        if planned is not None and rests:
            when = (planned.stamp - recording.stamp[0]) * 1e-9
            motion = zero_phase(t, np.stack([np.interp(t, when, q) for q in planned.q.T], axis=1),
                                cutoff)
        for rest in rests:
            means = block_means(t[rest], recording.effort[part][rest])
            at = means[0][0]
            own = slice(*np.searchsorted(t, [at - TOOL_MEMORY, at], side='right'))
            found.append(Rest(flange_motion(arm, t[own], MotionState(
                motion.q[own], motion.dq[own], motion.ddq[own])), ring_of(*means)))
    return found


def check_efforts(arm: Arm) -> None:
    """Refuse an arm whose rings have no size, before hours of work and not after."""
    unknown = [joint.name for joint in arm.joints if joint.effort.unit == 'A']
    if unknown:
        raise FitError(f'{arm.source}: a flexible tool needs efforts in N m or N; those of '
                       f'{", ".join(unknown)} are in A', remedy='remove vibration from --models, '
                       'or give torques')


def tool_of_bags(arm: Arm, bags: Sequence[BagData]) -> FlexibleTool:
    """Fit a tool to bags, by the planned motion where all of them have recorded it."""
    plans: list[Recording | None] = [None] * len(bags)
    with suppress(TudorError), warnings.catch_warnings():
        warnings.simplefilter('ignore', TudorWarning)
        reference = arm.changed(joint_topic=REFERENCE)
        plans = [read_recording(bag.choice.path, reference) for bag in bags]
    rests = [rest for bag, plan in zip(bags, plans, strict=True)
             for rest in find_rests(arm, bag.recording, plan)]
    return fit_tool(arm, rests, 'planned' if all(plans) else 'measured')


def fit_tool(arm: Arm, rests: Sequence[Rest], motion: str) -> FlexibleTool:
    """Fit a tool to rests of recordings, their motion `planned` or `measured`."""
    pairs = [(rest.flange, rest.ring) for rest in rests if rest.ring is not None]
    if len(pairs) < settings.TOOL_LEAST:
        msg = (f'{len(pairs)} rests have a clear ring; a flexible tool needs '
               f'{settings.TOOL_LEAST} or more')
        raise FitError(msg, remedy='let the arm rest for three seconds or more after each motion')
    ratios = np.array([ring.damping for _, ring in pairs])
    weights = np.array([ring.damping_error ** -2 for _, ring in pairs])
    damping = float(weights @ ratios / weights.sum())
    spread = math.sqrt(float(weights @ (ratios - damping) ** 2 / weights.sum()))
    expected = np.eye(3)
    for _ in range(2):  # gravity along the bending changes the frequency little
        squares, covariance = _squares(pairs, settings.TOOL_GRAVITY ** 2 * expected)
        found = _participation(pairs, squares, damping)
        along = np.array(found['participation'][:3])
        along /= np.linalg.norm(along)
        expected = np.eye(3) - (1.0 - settings.TOOL_ALONG ** 2) * np.outer(along, along)
    return FlexibleTool.model_validate({
        'motion': motion, 'rings': len(pairs), 'squares': squares.tolist(),
        'squares_covariance': covariance.tolist(), 'damping': damping,
        'damping_error': max(spread, float(weights.sum() ** -0.5)), **found})


def _squares(pairs: Pairs, expected: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find what gravity does to frequencies, by what is expected of it (3, 3)."""
    rows = np.array([[1.0, *flange.gravity[-1]] for flange, _ in pairs])
    measured = np.array([ring.frequency ** 2 for _, ring in pairs])
    off = np.array([2.0 * ring.frequency * ring.frequency_error for _, ring in pairs])
    weighted, prior, scale = rows / off[:, None] ** 2, np.zeros((4, 4)), 1.0
    prior[1:, 1:] = np.linalg.inv(expected)
    for _ in range(2):  # the second time with the scatter of the first
        covariance = np.linalg.inv(weighted.T @ rows / scale + prior)
        squares = covariance @ weighted.T @ measured / scale
        left = float(np.sum(((measured - rows @ squares) / off) ** 2))
        scale = max(1.0, left / max(len(pairs) - 4, 1))
    return squares, covariance


def _participation(pairs: Pairs, squares: FloatArray, damping: float) -> dict[str, Any]:
    """Find participation, its covariance, the scatter, and what is hidden."""
    from scipy.optimize import least_squares  # slow to import

    w = np.array([2.0 * math.pi * ring.frequency for _, ring in pairs])
    # each by the frequency it was heard at: 1 % is 15 degrees after a second and a half
    off = [ring.frequency ** 2 - float(squares @ [1.0, *flange.gravity[-1]])
           for flange, ring in pairs]
    free = np.array([free_ring(flange, squares + [more, 0.0, 0.0, 0.0], damping)
                     for (flange, _), more in zip(pairs, off, strict=True)]) * SIZES
    levers = np.array([flange.jacobian.T for flange, _ in pairs]) * SIZES
    seen = np.array([ring.amplitude for _, ring in pairs])
    loud = np.abs(seen).max(axis=1)
    noise = np.array([np.sqrt(np.mean(ring.noise ** 2)) for _, ring in pairs])
    unit = (settings.TOOL_RELATIVE * loud + noise)[:, None]
    # what shows rings as large as those seen
    usual = math.sqrt(float(np.median(loud / np.linalg.norm(free, axis=1))))

    def error(x: FloatArray) -> Any:  # participation, then the delay of the motion
        return (levers @ x[:6]) * (free @ x[:6] * np.exp(1j * w * x[6]))[:, None] - seen

    def whole(x: FloatArray, scale: float) -> FloatArray:
        misfit = (error(x) / unit / math.sqrt(scale)).ravel()
        return np.concatenate([misfit.real, misfit.imag, x[:6] / (settings.TOOL_LARGE * usual),
                               x[6:] / settings.TOOL_DELAY])

    random, scale = np.random.default_rng(0), float(seen.shape[1])
    starts = [np.append(usual * random.normal(size=6), 0.0) for _ in range(settings.TOOL_STARTS)]
    for _ in range(3):  # what the model does not explain weighs against what is expected
        best = min((least_squares(whole, start, args=(scale,)) for start in starts),
                   key=lambda one: float(one.cost))
        # all joints of a ring are one sample: what a ring has besides is the same in all of them
        scale = max(settings.TOOL_SURE, seen.shape[1] * float(np.sum(np.abs(
            error(best.x) / unit) ** 2)) / max(2 * seen.size - len(best.x), len(pairs)))
        starts = [best.x]
    sizes = {name: np.linalg.svd(np.vstack([free.real, free.imag])[:, part], compute_uv=False)
             for name, part in KINDS.items()}
    most = max(float(size[0]) for size in sizes.values())
    errors = np.linalg.norm(error(best.x), axis=1) / np.linalg.norm(seen, axis=1)
    covariance = np.linalg.inv(best.jac.T @ best.jac)[:6, :6] * np.outer(SIZES, SIZES)
    return {'participation': (best.x[:6] * SIZES).tolist(),
            'participation_covariance': covariance.tolist(),
            'quiet': max(float(np.median(noise)), 1e-9),
            'scatter': max(float(np.sqrt(np.mean(errors ** 2))), 1e-3),
            'hidden': [name for name, size in sizes.items()
                       if len(size) < 3 or size[2] < settings.TOOL_HIDDEN * most]}
