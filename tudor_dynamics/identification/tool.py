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

"""From rests in recordings to the flexible tool that an arm carries."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
import math
from typing import Any
import warnings

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.errors import FitError, TudorError, TudorWarning
from tudor_dynamics.identification import settings
from tudor_dynamics.identification.dataset import BagData
from tudor_dynamics.identification.ringdowns import block_means, loudest_of, with_rests
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.flexible_tool import (
    Flange, flange_motion, FlexibleTool, pushes, row_of, square)
from tudor_dynamics.models.settings import TOOL_CUTOFF, TOOL_HIDDEN
from tudor_dynamics.models.tool_motion import from_rest, pulls
from tudor_dynamics.signals.filters import interpolated, MotionState, zero_phase
from tudor_dynamics.typing import FloatArray

STEP = settings.TOOL_LEARN
REFERENCE = 'joint_reference'  # what a planned motion is recorded on


@dataclass(frozen=True, eq=False)
class Rest:
    """What efforts show of a ring while the arm stands."""

    t: FloatArray  # (samples,) [s]
    effort: FloatArray  # (samples, joints) [N m or N]
    jacobian: FloatArray  # of the flange, (6, joints)

    @cached_property
    def noise(self) -> FloatArray:
        """Give the noise of each joint, (joints,)."""
        return np.maximum(np.sqrt(0.5 * np.mean(np.diff(self.effort, axis=0)**2, axis=0)), 1e-6)

    @cached_property
    def rings(self) -> FloatArray:
        """Give the efforts less drift."""
        return self.swing(self.effort)

    @cached_property
    def loud(self) -> float:
        """Give the squared amplitude of the loudest joint."""
        return 2.0 * float(np.mean(self.rings**2, axis=0).max())

    @cached_property
    def _drift(self) -> FloatArray:
        return np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, len(self.t)), 4))[0]

    def swing(self, effort: FloatArray) -> FloatArray:
        """Give what of efforts is no slow drift."""
        return effort - self._drift @ (self._drift.T @ effort)

    def first(self, seconds: float) -> Rest:
        """Give the begin of it."""
        n = max(int(np.searchsorted(self.t, self.t[0] + seconds)), 8)
        return Rest(self.t[:n], self.effort[:n], self.jacobian)


@dataclass(frozen=True, eq=False)
class Moves:
    """A stretch of motion with rests."""

    flange: Flange  # in even steps
    rests: tuple[Rest, ...]


def find_moves(
    arm: Arm, recording: Recording, planned: Recording | None = None, model: Model | None = None,
) -> list[Moves]:
    """Find the rests of a recording with its motion: as planned, where that is there."""
    found = []
    for part, motion, parts in with_rests(recording, TOOL_CUTOFF):
        assert recording.effort is not None
        t, effort, still = recording.t[part], recording.effort[part], np.zeros_like(motion.q)
        if model is not None:  # efforts that accelerate the arm, which yields to the tool, aside
            shaken, held = (model.predict(np.hstack([motion.q, still, ddq]))
                            for ddq in (motion.ddq, still))
            effort = effort - (shaken - held)
        if planned is not None:
            when = (planned.stamp - recording.stamp[0]) * 1e-9
            motion = zero_phase(t, interpolated(t, when, planned.q),
                                min(TOOL_CUTOFF, 0.2 / recording.dt))
        even = np.arange(t[0], t[parts[-1].stop - 1] + STEP, STEP)
        states = MotionState(*(interpolated(even, t, values) for values in (
            motion.q, motion.dq, motion.ddq)))
        rests = tuple(Rest(*block_means(t[rest], effort[rest]), flange_motion(
            arm, np.zeros(1), MotionState(*(values[rest][-1:] for values in (
                motion.q, motion.dq, motion.ddq)))).jacobian) for rest in parts)
        found.append(Moves(flange_motion(arm, even, states), rests))
    return found


def check_efforts(arm: Arm, without: str = 'leave vibration out of models=') -> None:
    """Refuse an arm whose rings have no size, before hours of work and not after."""
    unknown = [repr(joint.name) for joint in arm.joints if joint.effort.unit == 'A']
    if unknown:
        raise FitError(f'{arm.source}: efforts of {", ".join(unknown)} are in A, but the model of '
                       'vibration needs torques [N m] or forces [N]', remedy='record torques and '
                       f'set joints[].effort.unit to N m, or {without}')


def tool_of_bags(arm: Arm, bags: Sequence[BagData], model: Model | None) -> FlexibleTool:
    """Fit a tool to bags, by the planned motion where all of them have recorded it."""
    plans: list[Recording | None] = [None] * len(bags)
    with suppress(TudorError), warnings.catch_warnings():
        warnings.simplefilter('ignore', TudorWarning)
        reference = arm.changed(joint_topic=REFERENCE)
        plans = [read_recording(bag.choice.path, reference) for bag in bags]
    return fit_tool(arm, [one for bag, plan in zip(bags, plans, strict=True)
                          for one in find_moves(arm, bag.recording, plan, model)],
                    'planned' if all(plans) else 'measured')


def fit_tool(arm: Arm, moves: Sequence[Moves], motion: str) -> FlexibleTool:
    """Fit a tool to rests of recordings, their motion `planned` or `measured`."""
    search = _Search(moves)
    one, two = search.fits()
    return search.tool(two if two.excess < settings.TOOL_SECOND * one.excess else one, motion)


@dataclass(frozen=True, eq=False)
class _Found:
    x: FloatArray
    covariance: FloatArray
    excess: float  # by how much it errs more than noise does


class _Search:
    """
    The search of a tool whose efforts are those in all rests.

    What is sought: the parameters of a FlexibleTool, then the delay of the motion [s].
    """

    def __init__(self, moves: Sequence[Moves]) -> None:
        self.moves, self.rests = moves, [rest for one in moves for rest in one.rests]
        self._delay, self._late = math.nan, list[FloatArray]()  # motions that come later by it
        if len(self.rests) < settings.TOOL_LEAST:
            raise FitError(f'the bags have {len(self.rests)} rests after a motion, but the model '
                           f'of vibration needs {settings.TOOL_LEAST} or more', remedy='record '
                           'motions after each of which the arm rests for three seconds')

    def units(self, scale: float) -> Iterator[FloatArray]:
        """Give expected errors: each sample errs by noise, a whole rest by a part of its ring."""
        for rest in self.rests:
            yield np.sqrt(rest.noise**2 + scale * len(rest.t) / settings.TOOL_FEW
                          * settings.TOOL_RELATIVE**2 * rest.loud)

    def short(self, frequency: float) -> _Search:
        """Give the same search by the begin of each rest, where phases are not yet ambiguous."""
        seconds = max(settings.TOOL_BEGIN, 2.0 / frequency)
        return _Search([Moves(one.flange, tuple(rest.first(seconds) for rest in one.rests))
                        for one in self.moves])

    def efforts(self, x: FloatArray) -> Iterator[FloatArray]:
        """Give the efforts of a tool in each rest, drift aside."""
        row, mass = row_of(x[:-1]), math.exp(x[6])
        if x[-1] != self._delay:  # most steps of a search leave it
            self._delay, self._late = float(x[-1]), []
            for one in self.moves:
                t, motion = one.flange.t, one.flange.motion
                late = np.clip(t - x[-1], t[0], t[-1])
                k = np.minimum(((late - t[0]) / STEP).astype(int), len(t) - 2)
                share = ((late - t[k]) / STEP)[:, None]
                self._late.append((1.0 - share) * motion[k] + share * motion[k + 1])
        for one, motion in zip(self.moves, self._late, strict=True):
            t, states = one.flange.t, from_rest(row, STEP, motion)
            for rest in one.rests:
                part = slice(*np.searchsorted(t, [rest.t[0] - STEP, rest.t[-1] + STEP]))
                pulled = mass * pulls(row, motion[part], states[part])
                yield rest.swing(interpolated(rest.t, t[part], pulled @ rest.jacobian))

    def errors(self, x: FloatArray, scale: float = 1.0) -> FloatArray:
        """Give how unlikely a tool is, and what it leaves over, in units of what is expected."""
        planes, length = (len(x) - 9) // 2, math.exp(x[7])
        usual = np.concatenate([
            (x[3:6] - length * pin.exp3(x[:3])[:, 2]) / settings.TOOL_FOOT,
            [(x[7] - math.log(settings.TOOL_LENGTH)) / settings.TOOL_LENGTHS],
            np.diff(x[8:8 + planes]) / settings.TOOL_PLANES[0],
            x[8 + planes:-1] - math.log(settings.TOOL_DAMPING),
            np.diff(x[8 + planes:-1]) / settings.TOOL_PLANES[1], x[-1:] / settings.TOOL_DELAY])
        left = [((found - rest.rings) / unit).ravel() for found, rest, unit in zip(
            self.efforts(x), self.rests, self.units(scale), strict=True)]
        most = 1e6  # of a tool that its weight turns over, whose motion is no number
        return np.nan_to_num(np.concatenate([usual, *left]), nan=most, posinf=most, neginf=most)

    def starts(self, peaks: Sequence[float], planes: int) -> list[FloatArray]:
        """Give tools in all directions, with the mass that explains most, the best first."""
        from scipy.spatial.transform import Rotation  # slow to import

        found = [np.concatenate([
            turn.as_rotvec(), settings.TOOL_LENGTH * turn.as_matrix()[:, 2],
            [0.0, math.log(settings.TOOL_LENGTH)], [math.log(peak) + off] * planes,
            [math.log(settings.TOOL_DAMPING)] * planes, [0.5 * settings.TOOL_DELAY]])
            for turn in Rotation.random(settings.TOOL_WAYS, 0) for peak in peaks
            for off in settings.TOOL_OFF]
        units, costs = list(self.units(1.0)), []
        seen = np.concatenate([(rest.rings / unit).ravel()
                               for rest, unit in zip(self.rests, units, strict=True)])
        for start in found:
            shown = np.concatenate([(each / unit).ravel() for each, unit in zip(
                self.efforts(start), units, strict=True)])
            size = max(float(shown @ seen) / float(shown @ shown), 1e-3)
            start[6] = math.log(size)
            costs.append(float(np.sum((size * shown - seen) ** 2)))
        return [found[k] for k in np.argsort(costs)]

    def fits(self) -> tuple[_Found, _Found]:
        """Fit a tool that bends in one plane, then one with two: from the first, and anywhere."""
        peaks = loudest_of([(rest.t, rest.rings / rest.noise) for rest in self.rests],
                           settings.TOOL_PEAKS)
        short = self.short(peaks[0])
        one = self.best(short.tried(short.starts(peaks, 1)))
        grown = [np.concatenate([one.x[:9], one.x[8:9] + other, one.x[9:10], one.x[9:]])
                 for other in np.arange(*settings.TOOL_OTHER)]
        costs = np.array([np.sum(short.errors(start) ** 2) for start in grown])
        low = 1 + np.flatnonzero((costs[1:-1] < costs[:-2]) & (costs[1:-1] < costs[2:]))
        return one, self.best([*short.tried([grown[k] for k in low[np.argsort(costs[low])]]),
                               *short.tried(short.starts(peaks[:1], 2))])

    def solved(self, start: FloatArray, most: int, scale: float = 1.0, fine: float = 1e-3) -> Any:
        """Solve from a start."""
        from scipy.optimize import least_squares  # slow to import

        planes = (len(start) - 9) // 2
        unit = np.repeat([0.3, 0.1, 0.3, 0.02, 0.3, 0.01], [3, 3, 2, planes, planes, 1])
        return least_squares(self.errors, start, x_scale=unit, max_nfev=most, ftol=fine,
                             args=(scale,))

    def tried(self, starts: Sequence[FloatArray]) -> list[FloatArray]:
        """Give the best that the first of many starts lead to."""
        found = sorted((self.solved(start, 8) for start in starts[:settings.TOOL_TRIED]),
                       key=lambda one: float(one.cost))
        return [one.x for one in found[:settings.TOOL_BEST]]

    def best(self, tried: Sequence[FloatArray]) -> _Found:
        """Search from the best of what was tried."""
        whole = min((self.solved(x, 20) for x in tried), key=lambda one: float(one.cost))
        noise = sum(len(rest.t) * float(np.sum((rest.noise / expected) ** 2))
                    for rest, expected in zip(self.rests, self.units(1.0), strict=True))
        excess = max(2.0 * float(whole.cost) - noise, settings.TOOL_FEW)
        # Errors beyond noise are common to all samples and joints of a rest, which then counts
        # as one complex sample; so scaled, they are also weighed against what is usual.
        last = self.solved(whole.x, 40, max(1.0, 0.5 * excess / len(self.rests)), 1e-6)
        return _Found(last.x, np.linalg.inv(last.jac.T @ last.jac), excess)

    def tool(self, best: _Found, motion: str) -> FlexibleTool:
        """Make the tool of a solution, with its uncertainty and what was pushed."""
        x, planes = best.x, (len(best.x) - 9) // 2
        left, loud = [], []
        for found, rest in zip(self.efforts(x), self.rests, strict=True):
            noise = len(rest.t) * float(np.sum(rest.noise**2))
            ring = max(float(np.sum(rest.rings**2)) - noise, 1e-12)
            left.append(max(float(np.sum((found - rest.rings) ** 2)) - noise, 0.0) / ring)
            loud.append(ring > settings.TOOL_HEARD * noise)
        clear = [k for k, share in enumerate(left)
                 if loud[k] and share < 1.0 - settings.RING_CLEAR]
        if len(clear) < settings.TOOL_LEAST or 2 * len(clear) < sum(loud):
            raise FitError(f'the tool rings in {sum(loud)} rests, but a model of its vibration '
                           f'explains only {len(clear)}; half, and {settings.TOOL_LEAST} or more, '
                           'are needed', remedy='record moves of tudor excite --for vibration, '
                           'or faster ones with rests of 3 s or more')
        covariance = 0.5 * (best.covariance + best.covariance.T)[:-1, :-1]
        mass, length, *others = np.exp(x[6:-1]).tolist()
        return FlexibleTool.model_validate({
            'motion': motion, 'rests': len(clear), 'turn': x[:3].tolist(),
            'place': x[3:6].tolist(), 'mass': mass, 'length': length,
            'frequencies': others[:planes], 'damping': others[planes:],
            'covariance': covariance.tolist(),
            'quiet': float(np.median([np.sqrt(np.mean(rest.noise**2)) for rest in self.rests])),
            'scatter': max(math.sqrt(float(np.median([left[k] for k in clear]))),
                           settings.TOOL_SURE),
            'pushed': self.pushed(float(others[0])).tolist()})

    def pushed(self, frequency: float) -> FloatArray:
        """Give in what directions the rests were moved as one sum (6, 6), loud ones alike."""
        found = np.vstack([pushes(one.flange, frequency, np.array(
            [0.0, *(rest.t[0] for rest in one.rests)])) for one in self.moves])
        sizes = np.linalg.norm(found, axis=1)
        return square(found / np.hypot(sizes, TOOL_HIDDEN * sizes.max())[:, None])
