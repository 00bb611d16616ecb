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

"""Recordings of the simulated arm: stimuli, pushes with their truth, changes of load."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
import math
from pathlib import Path
import shlex
from typing import Any

import numpy as np
from numpy.typing import NDArray
import pinocchio as pin
from scipy.interpolate import CubicHermiteSpline

from tudor_dynamics.arm.description import Arm, load_arm
from tudor_dynamics.arm.kinematics import joint_axis, link_frame
from tudor_dynamics.arm.limits import hard_limits
from tudor_dynamics.arm.schema import InertiaPart
from tudor_dynamics.bags.messages import joint_signals, Signals, WRENCH_STAMPED
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.bags.writer import recording_series, write_bag
from tudor_dynamics.errors import check_budget, MAX_STEPS, SimulationError
from tudor_dynamics.mechanics import chain as at, settings
from tudor_dynamics.mechanics.closed_loop import CHUNK, ClosedLoop, LoopRecord, steps_per_message
from tudor_dynamics.mechanics.hardware import (
    Imperfections, Push, push_share, push_table, with_payload)
from tudor_dynamics.mechanics.mechanism import beam_axes, Mechanism
from tudor_dynamics.mechanics.run import FIRST_STAMP
from tudor_dynamics.parallel import Count, in_processes
from tudor_dynamics.signals.motion_profile import (
    aprbs, follow_targets, joint_range, motion_limits, Reference, states)
from tudor_dynamics.typing import FloatArray, Shown


# -- Loads that are picked up and put down while the arm moves


@dataclass(frozen=True)
class LoadChange:
    """A load at the tip from a time on."""

    time: float  # from when [s]
    mass: float  # what is carried then in all [kg]

    def __post_init__(self) -> None:
        """Refuse what is no time and no mass."""
        if not (math.isfinite(self.time) and self.time >= 0.0
                and math.isfinite(self.mass) and self.mass >= 0.0):
            raise SimulationError(f'load of {self.mass} kg at {self.time} s: give 0 or more')


def random_loads(count: int, seconds: float, carried: float, seed: int) -> tuple[LoadChange, ...]:
    """Choose loads [kg] to pick up, or put down if one is carried, for a recording [s]."""
    if count == 0:
        return ()
    slot = (seconds - settings.FIRST_CHANGE) / count
    if not settings.BETWEEN_CHANGES <= slot < MAX_STEPS:
        raise SimulationError(f'{count} changes of the load do not fit into {seconds:g} s, as '
                              f'each needs {settings.BETWEEN_CHANGES:g} s, after a start of '
                              f'{settings.FIRST_CHANGE:g} s; raise seconds=, or lower loads=')
    rng = np.random.default_rng(seed)
    found = []
    for number in range(count):
        time = (settings.FIRST_CHANGE + slot * number
                + rng.uniform(0.0, slot - settings.BETWEEN_CHANGES))
        mass = round(float(rng.uniform(*settings.LOADS)), 4)
        carried = 0.0 if carried > 0.0 else mass
        found.append(LoadChange(round(float(time), 3), carried))
    return tuple(found)


def carried_at(changes: Sequence[LoadChange], before: float, t: FloatArray) -> FloatArray:
    """Give what is carried over time: before [kg], t (samples,) [s]; returns (samples,) [kg]."""
    masses = np.array([before, *(change.mass for change in changes)])
    return np.asarray(masses[np.searchsorted([change.time for change in changes], t, 'right')])


# -- Pushes of a recording: their random choice, and the truth about them as messages


def random_pushes(
    arm: Arm, mechanism: Mechanism, count: int, seconds: float, seed: int, *, held: bool = False,
) -> tuple[Push, ...]:
    """Choose pushes across the axis of a joint for a recording [s]; held: every other lasts."""
    if count == 0:
        return ()
    slot = (seconds - settings.FIRST_PUSH) / count
    longest = settings.HELD_TIME[1] if held else settings.PUSH_TIME[1]
    room = 1.5 * longest + 0.5 * settings.PUSH_TIME[1]
    if not room <= slot < MAX_STEPS:
        raise SimulationError(f'{count} pushes do not fit into {seconds:g} s: the first '
                              f'{settings.FIRST_PUSH:g} s stay free, and a push needs up to '
                              f'{room:g} s; raise seconds=, or lower pushes=')
    beams = [joint for joint in arm.active_joints if mechanism.length(joint) > 0.0]
    if not beams:
        msg = f'{arm.source}: no active joint moves an elastic link: describe links, or push none'
        raise SimulationError(msg)
    data = arm.full_model.createData()
    pin.forwardKinematics(arm.full_model, data, pin.neutral(arm.full_model))
    rng = np.random.default_rng(seed)
    result = []
    for number in range(count):
        joint = beams[int(rng.integers(len(beams)))]
        times, forces = ((settings.HELD_TIME, settings.HELD_FORCE) if held and number % 2 else
                         (settings.PUSH_TIME, settings.PUSH_FORCE))
        duration = float(rng.uniform(*times))
        begin = settings.FIRST_PUSH + slot * number + rng.uniform(0.0, slot - 1.5 * duration)
        axis = (data.oMi[arm.full_model.getJointId(joint)].rotation
                @ joint_axis(arm.full_model, joint))
        across = np.cross(axis, rng.standard_normal(3))
        force = across / np.linalg.norm(across) * rng.uniform(*forces)
        place = float(rng.uniform(0.2, 1.0)) * mechanism.length(joint)
        fx, fy, fz = (round(float(value), 4) + 0.0 for value in force)
        result.append(Push(round(float(begin), 3), round(duration, 3), joint, round(place, 4),
                           (fx, fy, fz)))
    return tuple(result)


def push_wrenches(
    arm: Arm, mechanism: Mechanism, pushes: tuple[Push, ...], signals: LoopRecord,
    stamp: NDArray[np.int64],
) -> Signals:
    """Give the truth about the pushes at stamps [ns], each in the frame of its (rigid) link."""
    shares = [[push_share(row, now) for now in signals.t.tolist()]
              for row in push_table(pushes, mechanism)]
    force, torque = np.zeros((2, len(stamp), 3))
    frames = np.full(len(stamp), 'base', dtype=object)
    model = arm.full_model
    data = model.createData()
    q, columns = arm.held_pose()
    for push, share in zip(pushes, shares, strict=True):
        values = np.outer(share, push.force)
        floats = mechanism.body_float[mechanism.body_of[push.joint]]
        place = floats[at.BODY_PLACE:at.BODY_PLACE + 3] + push.distance * beam_axes(floats)[:, 0]
        index, frame = model.getJointId(push.joint), link_frame(model, push.joint)
        for row in np.flatnonzero(np.any(values != 0.0, axis=1)):
            q[columns] = signals.q_true[row]
            pin.forwardKinematics(model, data, q)
            force[row] = data.oMi[index].rotation.T @ values[row]
            torque[row] = np.cross(place, force[row])
            frames[row] = frame
    return Signals('/applied_wrench', stamp, {'force': force, 'torque': torque}, frame=frames,
                   msgtype=WRENCH_STAMPED)


# -- Motions of stimuli: random ones by their seeds, and planned ones

def stimulus_seeds(seed: int, stimulus: int) -> tuple[int, int, int]:
    """Give the seeds of motion, noise and pushes of a stimulus."""
    state = np.random.SeedSequence([seed, stimulus]).generate_state(3)
    return int(state[0]), int(state[1]), int(state[2])


def stimulus_motion(arm: Arm, seconds: float, seed: int, dt: float) -> Reference:
    """
    Make the motion of a stimulus, an APRBS.

    Parameters
    ----------
    arm : Arm
        Arm with limits.
    seconds : float
        Length of the motion [s].
    seed : int
        Of the motion.
    dt : float
        Sample time [s].

    """
    check_budget(f'{seconds:g} s at steps of {dt:g} s', seconds / dt if dt > 0.0 else math.nan)
    targets = aprbs(joint_range(arm), seconds, seed)
    return follow_targets(targets.start, targets.times, targets.values, motion_limits(arm), dt,
                          round(seconds / dt))


def played_motion(arm: Arm, trajectory: Trajectory, dt: float) -> Reference:
    """Make a motion of a trajectory, at the rate of the loop: dt [s]."""
    if sorted(trajectory.joints) != sorted(arm.active_joints):
        own = ', '.join(map(repr, arm.active_joints))
        raise SimulationError(f'the trajectory moves {", ".join(map(repr, trajectory.joints))}, '
                              f'but arm {arm.name!r} has {own}; give a trajectory of {own}')
    q, dq, _ = np.split(states(trajectory.of(arm.active_joints)), 3, axis=1)
    hard = hard_limits(arm)
    for k, j in np.argwhere(hard.outside(q) | (np.abs(dq) > hard.velocity))[:1]:
        name = arm.active_joints[j]
        unit = 'm' if arm.is_prismatic(name) else 'rad'
        words = ['tudor', 'excite', arm.source, '--floor', '0', '--out', 'plan']
        raise SimulationError(f'at {trajectory.t[k]:.4g} s the trajectory has ' + (
            f'{name!r} at {q[k, j]:.4g} {unit}, but its limits are {hard.lower[j]:.4g} to '
            f'{hard.upper[j]:.4g} {unit}' if hard.outside(q)[k, j] else f'a speed of {name!r} of '
            f'{dq[k, j]:.4g} {unit}/s, but its limit is {hard.velocity[j]:.4g} {unit}/s')
            + f'; plan a trajectory within the limits, with `{shlex.join(words)}` for example')
    t = trajectory.t - trajectory.t[0]
    check_budget(f'a trajectory of {t[-1]:g} s at steps of {dt:g} s', t[-1] / dt,
                 48.0 * len(arm.joints), 'give a shorter trajectory')
    curve = CubicHermiteSpline(t, q, dq)
    times = np.arange(int(t[-1] / dt + 1e-9) + 1) * dt
    return Reference(curve(times), curve(times, 1), curve(times, 2), dt)


# -- Recordings of the simulated arm: stimuli, pushes, and the bags that they become

@dataclass(frozen=True, repr=False)
class StimulusSpec(Shown):
    """
    One recording.

    Attributes
    ----------
    payload : float
        Mass at the tip [kg].
    seconds : float
        Length of the stimulus [s].
    rate : float
        Of the messages [Hz].
    damping : float
        Part of the damper's gains, 0 for none.
    motion_seed, noise_seed, push_seed : int
        Of motion, noise and pushes.
    pushes : int
        Number of pushes.
    imperfections : Imperfections
        What is not ideal.
    loads : tuple of LoadChange
        What is picked up and put down.
    held : bool
        Whether every second push lasts for seconds.
    trajectory : Trajectory or None
        Motion to be played in place of a drawn one.

    """

    payload: float
    seconds: float
    rate: float
    damping: float
    motion_seed: int
    noise_seed: int
    push_seed: int
    pushes: int = 0
    imperfections: Imperfections = Imperfections()  # noqa: RUF009 (frozen)
    loads: tuple[LoadChange, ...] = ()
    held: bool = False
    trajectory: Trajectory | None = None


@dataclass(frozen=True, repr=False)
class StimulusResult(Shown):
    """What a recording came to."""

    bag: str  # directory of the bag
    samples: int  # messages of each topic
    pushes: tuple[Push, ...]  # pushes, the truth about `/applied_wrench`
    damper: dict[str, dict[str, float]]  # how long the damper of each joint was in which state [s]
    notes: tuple[str, ...]  # what to know of it, one sentence each

    def content(self) -> dict[str, Any]:
        """Give it as plain values for YAML and JSON."""
        result = asdict(self)
        result['pushes'] = [{**item, 'force': list(item['force'])} for item in result['pushes']]
        result['notes'] = list(self.notes)
        return result


def record_stimulus(
    arm: Arm, spec: StimulusSpec, path: Path, progress: Callable[[int], None] | None = None, *,
    overwrite: bool = False,
) -> StimulusResult:
    """Simulate one stimulus and write its bag; overwrite: in place of the one that is there."""
    carrying = with_payload(arm, spec.payload)
    if spec.loads and carrying.spec.payload is None:  # a body for the loads to be picked up
        carrying = arm.changed(payload=InertiaPart(mass=0.0))
    loop = ClosedLoop(carrying, damping=spec.damping,
                      imperfections=spec.imperfections, seed=spec.noise_seed)
    every = steps_per_message(loop.dt, spec.rate)
    reference = (
        stimulus_motion(arm, spec.seconds, spec.motion_seed, loop.dt)
        if spec.trajectory is None else played_motion(arm, spec.trajectory, loop.dt))
    pushes = random_pushes(arm, loop.plant.mechanism, spec.pushes, spec.seconds, spec.push_seed,
                           held=spec.held)
    loop.reset(reference.q[0])
    loop.set_pushes(pushes)
    parts = []
    changes = {round(change.time / loop.dt): change.mass for change in spec.loads}
    edges = sorted({*range(0, len(reference.q), CHUNK), *changes, len(reference.q)})
    for begin, end in zip(edges[:-1], edges[1:], strict=True):
        part = slice(begin, end)
        if begin in changes:
            loop.set_payload(changes[begin])
        parts.append(loop.run(reference.q[part], reference.dq[part], every=every))
        if progress is not None:
            progress(len(reference.q[part]))
    signals = LoopRecord.joined(parts)
    stamp = FIRST_STAMP + np.round(signals.t * 1e9).astype(np.int64)
    motors = {motor.joint: motor for motor in arm.spec.motors}
    scale = [1.0 if joint.effort.unit == 'A' else motors[joint.name].joint_torque_constant
             for joint in arm.joints]
    recording = Recording(
        '', stamp, signals.q, signals.dq, signals.current * scale,
        signals.strain if arm.gauges else None, (slice(0, len(stamp)),),
        float(signals.t[1] - signals.t[0]) if len(stamp) > 1 else 0.0)
    series = [
        *recording_series(recording, arm),
        joint_signals('/joint_reference', stamp, arm.active_joints, signals.q_ref,
                      signals.dq_ref)]
    if spec.loads:
        carried = carried_at(spec.loads, spec.payload, signals.t)
        series.append(joint_signals('/applied_payload', stamp, ('payload',), carried[:, None]))
    if pushes:
        series.append(push_wrenches(arm, loop.plant.mechanism, pushes, signals, stamp))
    write_bag(path, series, custom={'payload': f'{spec.payload:g}'}, overwrite=overwrite)
    return StimulusResult(str(path), len(stamp), pushes, loop.status_seconds, tuple(
        f'{joint}: the damper was faded out for {seconds:.2f} s ({state})'
        for joint, times in loop.status_seconds.items() for state, seconds in times.items()
        if state not in ('damping', 'starting') and seconds > 0.01))


def _record_piece(
    piece: tuple[Path, str, StimulusSpec, str, bool], count: Count,
) -> StimulusResult:
    base, source, spec, path, overwrite = piece  # who does it need not stand in the same directory
    return replace(record_stimulus(
        load_arm(base / source), spec, base / path, count, overwrite=overwrite), bag=path)


def record_stimuli(
    source: str | Path, specs: Sequence[StimulusSpec], paths: Sequence[Path], jobs: int,
    progress: Callable[[int], None] = lambda _: None, *, overwrite: bool = False,
) -> list[StimulusResult]:
    """
    Simulate and record several stimuli.

    Parameters
    ----------
    source : str or Path
        Arm description; each process reads it.
    specs : sequence of StimulusSpec
        What to record.
    paths : sequence of Path
        Directory of each bag.
    jobs : int
        Number of processes; it makes no difference to the bags.
    progress : callable, optional
        Called with the number of simulation steps done so far, all stimuli together.
    overwrite : bool, default=False
        Replace bags that stand there, each when the new one is whole.

    Returns
    -------
    list of StimulusResult
        What was done, in the order of ``specs``.

    """
    pieces = [(Path.cwd(), str(source), spec, str(path), overwrite)
              for spec, path in zip(specs, paths, strict=True)]
    return in_processes(_record_piece, pieces, jobs, progress)
