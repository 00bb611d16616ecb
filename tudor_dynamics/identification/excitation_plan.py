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

"""The search for the motion to record, and the plan as a folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
import json
import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from tudor_dynamics.arm.description import Arm, OUTPUTS
from tudor_dynamics.arm.limits import Limits, SelfCollision
from tudor_dynamics.arm.schema import PreprocessingSpec, validation_message
from tudor_dynamics.bags.trajectory import read_trajectory, Sent, Trajectory, write_trajectories
from tudor_dynamics.errors import SignalError, UsageError
from tudor_dynamics.files import read_text, write_whole
from tudor_dynamics.identification.excitation import (
    Beyond, Bounds, CLEARANCE, Criterion, expected_errors, ExpectedError, Information,
    known_efforts, mean_error, Noise, Series, series)
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.flexible_tool import flange_motion, hidden_in, pushes, sizes_of, square
from tudor_dynamics.models.friction import sliding
from tudor_dynamics.models.regressor import regressor_of
from tudor_dynamics.signals.motion_profile import (
    follow_targets, joint_range, motion_limits, Reference, states)
from tudor_dynamics.typing import FloatArray, Shown


# -- The search for the motion that shows the parameters best, within all limits.
#
# A Fourier series has hundreds of coefficients, and the cost exact slopes by them: a quasi-Newton
# descent (L-BFGS) with penalties for what is beyond the limits, which grow from stage to stage. At
# its end each joint is scaled into its limits exactly, and the whole motion is drawn towards its
# middle where efforts or links ask for it. What shows a flexible tool are moves with rests, each
# the best of many draws for what those before it leave hidden.

STAGES = (10.0, 1e3, 1e4)  # weights of the penalties, one after the other
SAMPLES, CLOSE_SAMPLES = 4.0, 20.0
"""Samples for each period of the largest frequency, while it is searched: of what the motion
shows, which is cheaper where they are few, and of its limits, which are passed between them
otherwise."""
LEAST_RATE = 5.0  # samples a second at least [Hz]
POSES = 100
"""Random poses from which the one with the most room between links is where a search begins."""
HALVINGS = 12
CHECKED = 50.0  # rate at which efforts and distances between links are looked at in the end [Hz]
MOVE, REST = 1.5, 3.5  # longest move, rest after it [s] (bench/still_moves.py --excited 3)
UNKNOWN = (1.5, 3.0, 5.0)  # frequencies at which a tool is pushed that nobody knows yet [Hz]
LEAST_PUSH = 1e-6  # what a direction counts that no move of an arm can push

Report = Callable[[float], bool]  # told the cost of each step of a search; answers whether to stop


@dataclass(frozen=True)
class Order:
    """What motion is wanted."""

    seconds: float  # length with the rests at its ends [s]
    highest: float  # largest frequency of a Fourier series [Hz]
    dt: float  # sample time of the motion that comes out [s]
    steps: int  # steps of the descent in each stage, or draws of each move
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
    x[0] = _middle(bounds, basis.centre, basis.sizes[0], generator)
    from scipy import optimize  # slow to import

    stopped = False

    def step(intermediate_result: Any) -> None:
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


def random_series(bounds: Limits, limits: Limits, order: Order) -> Reference:
    """Draw a Fourier series that keeps to positions, speeds and accelerations."""
    fine = series(bounds, limits, order.seconds, order.highest, order.dt)
    x = np.random.default_rng(order.seed).normal(size=fine.sizes.shape)
    return _within(fine, x / math.sqrt(len(x)), Bounds(bounds, limits))


def _middle(
    bounds: Bounds, centre: FloatArray, half: FloatArray, generator: np.random.Generator,
) -> FloatArray:
    """Choose the pose about which a search begins: that with the most room between links."""
    n = len(bounds.range.lower)
    if bounds.links is None:
        return generator.uniform(-0.1, 0.1, n)
    best, room = np.zeros(n), -np.inf
    for _ in range(POSES):
        x = generator.uniform(-0.5, 0.5, n)
        near = bounds.links.near(centre + half * x, 10.0 * CLEARANCE)
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
    y = x * np.minimum(1.0, np.minimum(room, np.minimum(fast, sharp)))
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
        near = f'{" and ".join(found.nearest)} too close' if found.nearest else 'too large efforts'
        msg = f'no motion was found within all limits, as even small ones have {near}'
        raise SignalError(msg, remedy='give another seed, smaller ranges in joints[].planned, '
                                      'or an SRDF that disables false collisions')
    q, dq, ddq = np.split(fine.motion(scaled(factor)), 3, axis=1)
    return Reference(q, dq, ddq, fine.dt)


# -- From an arm to the plan of a recording: the motion, what it keeps to, what it will show

HIGHEST = 2.0  # largest frequency of a series where links do not bend [Hz]


@dataclass(frozen=True, eq=False)
class Target:
    """What is to be identified, after which filters, in which noise."""

    arm: Arm  # arm with the friction that is identified
    models: dict[str, AnalyticalModel]  # for each output the model that a fit would fit
    preprocessing: PreprocessingSpec  # filters and rate of that fit
    noise: Noise  # noise of the outputs
    parameters: FloatArray | None = None  # what is known of the efforts, (joints, columns)

    @cached_property
    def information(self) -> Information:
        """Say what motions show of it."""
        return Information(self.models, self.noise.size)


@dataclass(frozen=True, eq=False, repr=False)
class Plan(Shown):
    """A motion to record."""

    trajectory: Trajectory  # motion of the active joints, at the rate of the messages
    expected: list[ExpectedError]  # what it will show
    beyond: Beyond  # how far it goes to the limits
    noise: Noise  # noise that the standard errors are for
    cost: float  # of the motion, by the criterion of the search
    hidden: Sequence[str] = ()  # directions in which moves do not push a tool


def target_of_arm(arm: Arm, noise: dict[str, FloatArray] | None = None) -> Target:
    """Say what a fit of an arm would identify, in noise of 1 where none is given."""
    spec = arm.spec.preprocessing
    if 'filter' not in spec.model_fields_set:
        spec = spec.model_copy(update={'filter': 'zero_phase'})
    outputs = OUTPUTS if arm.gauges else OUTPUTS[:1]
    return Target(arm, {output: _planned(arm, output) for output in outputs}, spec, Noise(
        noise or {output: np.ones(len(arm.channels[output])) for output in outputs}))


def _planned(arm: Arm, output: str) -> AnalyticalModel:
    """Give the model that a motion is planned for: any reversal shows friction with a state."""
    return AnalyticalModel(regressor_of(sliding(arm), output, 'exact'), len(arm.active_joints))


def target_of_model(bundle: ModelBundle, arm: Arm) -> Target:
    """Say what a fit like an earlier one would identify, in the noise that it left."""
    found, noise = {}, {}
    known: FloatArray | None = None
    for output, kinds in bundle.models.items():
        model = kinds.get('analytical')
        if isinstance(model, AnalyticalModel) and model.payload_range is None:
            if output == 'effort':
                known = model.coefficients()
            found[output] = model if model.states is None else _planned(bundle.arm, output)
            noise[output] = model.deviations()
    if not found:
        raise UsageError('the model of model= has no analytical part for one load',
                         remedy='give noise= in its place')
    return Target(arm.with_friction_of(bundle.arm), found, bundle.preprocessing,
                  Noise(noise, residual=True), known)


def default_highest(arm: Arm) -> float:
    """Choose the largest frequency of a series: below what makes links oscillate [Hz]."""
    if any(link.flexible is not None for link in arm.spec.links):
        from tudor_dynamics.mechanics.run import modes  # slow to import

        return min(HIGHEST, float(modes(arm, 1).frequency[0]) / 3.0)
    return HIGHEST


def bounds_of(target: Target, links: SelfCollision | None = None) -> Bounds:
    """Collect what motions of an arm keep to."""
    return Bounds(joint_range(target.arm), motion_limits(target.arm),
                  known_efforts(target.arm, target.parameters), links)


def make_plan(
    target: Target, order: Order, *, links: SelfCollision | None = None,
    report: Report = lambda _: False, criterion: Criterion = mean_error,
) -> Plan:
    """Search for the motion that shows best what is to be identified."""
    bounds = bounds_of(target, links)
    reference = best_series(target.information, bounds, order, report, criterion)
    return judged(target, _trajectory(target.arm, reference.motion, order.dt), bounds, criterion)


def make_moves(
    target: Target, order: Order, frequencies: Sequence[float], *,
    links: SelfCollision | None = None, report: Report = lambda _: False,
) -> Plan:
    """Search for moves with rests that push a tool, which rings at frequencies [Hz], each way."""
    bounds = bounds_of(target, links)
    generator, limits = np.random.default_rng(order.seed), bounds.limits
    low, high = bounds.range.lower, bounds.range.upper
    half = 0.5 * (high - low)
    q = low + half * (1.0 + _middle(bounds, low + half, half, generator))
    reach = 0.5 * MOVE * np.minimum(limits.velocity, 0.25 * MOVE * limits.acceleration)
    every, t = max(round(1.0 / (CHECKED * order.dt)), 1), np.arange(0.0, MOVE + REST, order.dt)
    moves: list[Reference] = []
    pushed = {frequency: np.zeros((6, 6)) for frequency in frequencies}
    for _ in range(int(order.seconds / (MOVE + REST))):
        best: tuple[float, Reference, dict[float, FloatArray]] | None = None
        for _ in range(order.steps):
            to = np.clip(q + generator.uniform(-reach, reach), low, high)
            move = follow_targets(q, [np.zeros(1)] * len(q), list(to[:, None]), limits, order.dt,
                                  len(t))
            if bounds.beyond(move.motion[:round(MOVE / order.dt):every]).excess > 0.0:
                continue
            flange = flange_motion(target.arm, t, move)
            more = {frequency: own + square(pushes(flange, frequency, np.array([0.0, MOVE])))
                    for frequency, own in pushed.items()}
            shown = sum(float(np.log(np.maximum(size, LEAST_PUSH)).sum())
                        for each in more.values() for size in sizes_of(each).values())
            if best is None or shown > best[0]:
                best = shown, move, more
        if best is None:
            raise SignalError(f'each of {order.steps} moves collides or exceeds effort limits',
                              remedy='give another seed, or reduce joints[].planned')
        moves.append(best[1])
        q, pushed = best[1].q[-1], best[2]
        if report(-best[0]):
            break
    motion = np.vstack([move.motion for move in moves])
    return Plan(_trajectory(target.arm, motion, order.dt), [], bounds.beyond(motion), target.noise,
                0.0, sorted({name for each in pushed.values() for name in hidden_in(each)}))


def _trajectory(arm: Arm, motion: FloatArray, dt: float) -> Trajectory:
    t = np.asarray(np.arange(len(motion)) * dt)
    return Trajectory(arm.active_joints, t, *np.split(motion, 3, axis=1))


def judged(target: Target, trajectory: Trajectory, bounds: Bounds, criterion: Criterion) -> Plan:
    """Say what a motion will show, and how far it goes."""
    motion = states(trajectory)
    return Plan(trajectory, expected_errors(
        target.models, target.arm, trajectory, target.preprocessing, target.noise),
        bounds.beyond(motion), target.noise, target.information.value(motion, criterion))


# -- A plan as a folder: the motion as a bag and as a table, and what it is to show as JSON.
#
# ``bag`` has one trajectory_msgs/JointTrajectory, ``trajectory.csv`` the same numbers;
# ``plan.json`` says what was asked for, what the motion keeps to, and the standard errors that it
# will bring.

FORMAT, VERSION = 'tudor_dynamics/excitation', 1
HEAD, TABLE, BAG, PICTURE = 'plan.json', 'trajectory.csv', 'bag', 'motion.png'
MAX_HEAD_BYTES = 20_000_000
STAMP = 1_000_000_000  # stamp of the only message [ns]; one of zero would mean "not set" in ROS


class _Head(BaseModel):
    """What is read of ``plan.json``."""

    model_config = ConfigDict(extra='ignore', frozen=True)
    format: str  # noqa: A003
    version: int
    # standard deviation by output and channel, in its unit
    noise: dict[str, dict[str, Annotated[float, Field(ge=1e-12, le=1e12)]]] = Field(min_length=1)
    noise_of: str  # `samples`, or `residuals` of a model
    noise_stated: bool  # whether anybody stated it


@dataclass(frozen=True, eq=False)
class PlanFolder:
    """A plan that was read."""

    path: Path  # folder that it was read from
    trajectory: Trajectory  # motion that was planned
    noise: Noise  # noise that was stated
    stated: bool  # whether anybody stated it


def plan_head(plan: Plan, arm: Arm, facts: dict[str, Any], *, stated: bool) -> dict[str, Any]:
    """Say what is planned, and was asked for, as plain values: the content of ``plan.json``."""
    names, errors = arm.channels, []
    for item in plan.expected:
        row = asdict(item)
        value = row.pop('value')
        errors.append({**row, 'channels': list(item.channels),
                       'standard_error': value if math.isfinite(value) else None})
    return {
        'format': FORMAT, 'version': VERSION, 'arm': arm.name, 'digest': arm.digest, **facts,
        'noise': {output: dict(zip(names[output], size.tolist(), strict=True))
                  for output, size in plan.noise.size.items()},
        'noise_of': 'residuals' if plan.noise.residual else 'samples', 'noise_stated': stated,
        'part_of_limits': {limit: dict(zip(arm.active_joints, (
            round(value, 6) for value in getattr(plan.beyond, limit).tolist()), strict=True))
            for limit in ('position', 'velocity', 'acceleration', 'effort')},
        'expected': errors}


def write_plan(folder: Path, plan: Plan, head: dict[str, Any]) -> None:
    """Write a plan, but for its picture, into an empty folder; head: of `plan_head`."""
    write_whole(folder / TABLE, plan.trajectory.table())
    write_trajectories(folder / BAG, [Sent(plan.trajectory, time=STAMP, stamp=STAMP)])
    write_whole(folder / HEAD, json.dumps(head, indent=2, allow_nan=False).encode() + b'\n')


def read_motion(path: Path) -> Trajectory:
    """Read the motion of a plan: of its folder, or of a table as there is one in it."""
    return read_trajectory(path / TABLE if path.is_dir() else path)


def read_plan(path: str | Path) -> PlanFolder:
    """Read the folder that ``tudor excite`` wrote."""
    path = Path(path)
    text = read_text(path / HEAD, MAX_HEAD_BYTES, 'the plan', UsageError,
                     'give the folder that tudor excite wrote')
    try:
        head = _Head.model_validate_json(text)
    except ValidationError as err:
        raise UsageError(f'the plan is not valid, as {validation_message(err, add="")}',
                         place=path / HEAD, remedy='make one with tudor excite') from None
    if (head.format, head.version) != (FORMAT, VERSION):
        raise UsageError(f'the plan has the format {head.format[:60]} {head.version}, not {FORMAT}'
                         f' {VERSION}', place=path / HEAD, remedy='make one with tudor excite')
    noise = {output: np.array(list(values.values())) for output, values in head.noise.items()}
    return PlanFolder(path, read_trajectory(path / TABLE),
                      Noise(noise, head.noise_of == 'residuals'), head.noise_stated)
