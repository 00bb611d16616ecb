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

"""Recordings of the simulated arm: stimuli, pushes, and the bags that they become."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm import Arm, load_arm
from tudor_dynamics.arm.links import InertiaPart
from tudor_dynamics.bags.layouts.messages import JointStateSeries, WrenchSeries
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.bags.writer import recording_series, write_bag
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.parallel import Count, in_processes
from tudor_dynamics.simulation.loop.closed_loop import CHUNK, ClosedLoop
from tudor_dynamics.simulation.loop.drive import Imperfections
from tudor_dynamics.simulation.loop.load_changes import carried_at, LoadChange
from tudor_dynamics.simulation.loop.push_truth import push_wrenches, random_pushes
from tudor_dynamics.simulation.loop.pushes import Push
from tudor_dynamics.simulation.loop.signals import LoopRecord, with_payload
from tudor_dynamics.simulation.loop.stimulus_motion import played_motion, stimulus_motion

START = 1_000_000_000
"""Stamp of t = 0 [ns]: a stamp of zero would mean "not set" in ROS."""


@dataclass(frozen=True)
class StimulusSpec:
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
    excitation : {'aprbs', 'fourier'}
        Kind of motion.
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
    excitation: str
    motion_seed: int
    noise_seed: int
    push_seed: int
    pushes: int = 0
    imperfections: Imperfections = Imperfections()  # noqa: RUF009 (frozen)
    loads: tuple[LoadChange, ...] = ()
    held: bool = False
    trajectory: Trajectory | None = None


@dataclass(frozen=True)
class StimulusResult:
    """What a recording came to."""

    bag: str  # directory of the bag
    samples: int  # messages of each topic
    pushes: tuple[Push, ...]  # pushes, the truth about `/applied_wrench`
    damper: dict[str, dict[str, float]]  # how long the damper of each joint was in which state [s]
    notes: tuple[str, ...]  # what is odd, one sentence each

    def content(self) -> dict[str, Any]:
        """Give it as plain values for YAML and JSON."""
        result = asdict(self)
        result['pushes'] = [{**item, 'force': list(item['force'])} for item in result['pushes']]
        result['notes'] = list(self.notes)
        return result


def record_stimulus(
    arm: Arm, spec: StimulusSpec, path: Path, progress: Callable[[int], None] | None = None,
) -> StimulusResult:
    """Simulate one stimulus and write its bag."""
    carrying = with_payload(arm, spec.payload)
    if spec.loads and carrying.spec.payload is None:
        # a place for what comes
        carrying = Arm(carrying.spec.model_copy(update={'payload': InertiaPart(mass=0.0)}),
                       arm.full_model, arm.source, arm.urdf)
    loop = ClosedLoop(carrying, damping=spec.damping,
                      imperfections=spec.imperfections, seed=spec.noise_seed)
    every = steps_per_message(loop.dt, spec.rate)
    reference = (
        stimulus_motion(arm, spec.excitation, spec.seconds, spec.motion_seed, loop.dt)
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
    signals = LoopRecord(*(np.concatenate([getattr(part, name) for part in parts])
                           for name in LoopRecord.__dataclass_fields__))
    stamp = START + np.round(signals.t * 1e9).astype(np.int64)
    series: list[JointStateSeries | WrenchSeries] = [
        *recording_series(_recording(arm, signals, stamp), arm, namespace='/'),
        JointStateSeries('/joint_reference', stamp, arm.active_joints, signals.q_ref,
                         signals.dq_ref)]
    if spec.loads:
        carried = carried_at(spec.loads, spec.payload, signals.t)
        series.append(JointStateSeries('/applied_payload', stamp, ('payload',), carried[:, None]))
    if pushes:
        series.append(push_wrenches(arm, loop.plant.mechanism, pushes, signals, stamp))
    write_bag(path, series, custom={'payload': f'{spec.payload:g}'})
    return StimulusResult(str(path), len(stamp), pushes, loop.status_seconds, _notes(loop))


def _record_piece(
    piece: tuple[Path, str, StimulusSpec, str], count: Count,
) -> StimulusResult:
    base, source, spec, path = piece  # who does it need not stand in the same directory
    return replace(record_stimulus(load_arm(base / source), spec, base / path, count), bag=path)


def record_stimuli(
    source: str | Path,
    specs: Sequence[StimulusSpec],
    paths: Sequence[Path],
    jobs: int,
    progress: Callable[[int], None] = lambda _: None,
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
        Directory of each bag; must not exist.
    jobs : int
        Number of processes; it makes no difference to the bags.
    progress : callable, optional
        Told the number of simulation steps done so far, all stimuli together.

    Returns
    -------
    list of StimulusResult
        What was done, in the order of ``specs``.

    """
    pieces = [(Path.cwd(), str(source), spec, str(path))
              for spec, path in zip(specs, paths, strict=True)]
    return in_processes(_record_piece, pieces, jobs, progress)


def steps_per_message(dt: float, rate: float) -> int:
    """Give the number of steps between two messages: dt [s], rate [Hz]."""
    every = 1.0 / (dt * rate) if rate > 0.0 else 0.0
    if every < 1.0 - 1e-9 or abs(every - round(every)) > 1e-6:
        msg = (f'a rate of {rate:g} Hz does not divide that of the loop, {1.0 / dt:g} Hz; '
               'give e.g. 100')
        raise SimulationError(msg)
    return int(round(every))


def _recording(arm: Arm, signals: LoopRecord, stamp: NDArray[np.int64]) -> Recording:
    motors = {motor.joint: motor for motor in arm.spec.motors}
    scale = [1.0 if joint.effort.unit == 'A' else motors[joint.name].joint_torque_constant
             for joint in arm.joints]
    return Recording(
        '', stamp, signals.q, signals.dq, signals.current * scale,
        signals.strain if arm.gauges else None, (slice(0, len(stamp)),),
        float(signals.t[1] - signals.t[0]) if len(stamp) > 1 else 0.0)


def _notes(loop: ClosedLoop) -> tuple[str, ...]:
    notes = []
    for joint, times in loop.status_seconds.items():
        for state, seconds in times.items():
            if state not in ('damping', 'starting') and seconds > 0.01:
                notes.append(f'{joint}: the damper was faded out for {seconds:.2f} s ({state})')
    return tuple(notes)
