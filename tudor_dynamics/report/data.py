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

"""What the report's figures show: signals of the first validation bag, positions of the joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.identification.dataset import all_stretches, BagData
from tudor_dynamics.identification.fit import FitResult, FittedOutput
from tudor_dynamics.identification.validation import Trace
from tudor_dynamics.models.units import output_units
from tudor_dynamics.report.plots import ComparedSignal, JointPositions
from tudor_dynamics.typing import FloatArray

DETAIL = 10.0
"""Length of the stretch shown in detail [s]."""
MAX_PAIRS = 3


@dataclass(frozen=True)
class JointCoverage:
    """Where a joint has been, in training and in validation."""

    # Joint and the unit of its position.
    joint: str
    unit: str
    # Smallest and largest position; None without test bag.
    training: tuple[float, float]
    # Largest in training, per second and per second squared.
    speed: float
    acceleration: float
    test: tuple[float, float] | None = None
    # Share of the validation samples outside the training range of positions [%].
    outside: float | None = None
    # Largest in validation.
    test_speed: float | None = None
    test_acceleration: float | None = None


def channel_series(fitted: Sequence[FittedOutput], arm: Arm) -> list[ComparedSignal]:
    """Collect what the models of one output say of the first validation bag."""
    traces = {item.kind: item.validation.traces[0] for item in fitted}
    first = next(iter(traces.values()))
    units = output_units(arm, fitted[0].output)
    return [ComparedSignal(fitted[0].output, name, units[name], first.t, first.measured[:, i],
                           {kind: trace.predicted[:, i] for kind, trace in traces.items()})
            for i, name in enumerate(fitted[0].validation.channels)]


def channel_errors(
    fitted: Sequence[FittedOutput], arm: Arm,
) -> list[tuple[str, str, dict[str, FloatArray]]]:
    """Collect the errors over all validation bags."""
    units = output_units(arm, fitted[0].output)
    return [(name, units[name],
             {item.kind: np.concatenate([trace.measured[:, i] - trace.predicted[:, i]
                                         for trace in item.validation.traces]) for item in fitted})
            for i, name in enumerate(fitted[0].validation.channels)]


def _speed(trace: Trace, data: Sequence[BagData]) -> FloatArray:
    """Squared speed over all joints at a trace's samples, each joint by its own spread."""
    for bag in sorted(data, key=lambda item: str(item.choice) != trace.bag):
        stamp = np.concatenate([s.stamp[s.decimation.keep] for s in bag.stretches])
        dq = np.vstack([s.states.dq[s.decimation.keep] for s in bag.stretches])
        # a part of a bag need not have been decimated to the same samples as the whole
        place = np.minimum(np.searchsorted(stamp, trace.stamp), len(stamp) - 1)
        if stamp[0] - 10**9 <= trace.stamp[0] and trace.stamp[-1] <= stamp[-1] + 10**9:
            spread = np.maximum(dq.std(axis=0), 1e-12)
            return np.sum((dq[place] / spread) ** 2, axis=1)
    return np.ones(len(trace.t))


def liveliest(trace: Trace, data: Sequence[BagData]) -> tuple[float, float]:
    """Find the stretch with the most motion [s]."""
    t = trace.t
    length = min(DETAIL, 0.5 * float(t[-1] - t[0]))
    total = np.concatenate([[0.0], np.cumsum(_speed(trace, data))])
    end = np.searchsorted(t, t + length)
    possible = t <= t[-1] - length
    best = int(np.argmax(np.where(possible, total[end] - total[:-1], -1.0)))
    return float(t[best]), float(t[best]) + length


def joint_axes(result: FitResult) -> list[JointPositions]:
    """Collect the positions of each joint at the samples used, in training and in validation."""
    training, test = _kept(result.training, 'q'), _kept(result.test, 'q')
    return [JointPositions(joint.name, 'm' if result.arm.is_prismatic(joint.name) else 'rad',
                           training[:, i], test[:, i] if len(test) else np.zeros(0))
            for i, joint in enumerate(result.arm.joints)]


def _kept(data: Sequence[BagData], signal: str) -> FloatArray:
    parts = [getattr(s.states, signal)[s.decimation.keep] for s in all_stretches(data)]
    return np.vstack(parts) if parts else np.zeros((0, 0))


def joint_pairs(axes: Sequence[JointPositions]) -> list[tuple[JointPositions, JointPositions]]:
    """Pair neighbours among the joints that move; their combinations matter most."""
    moving = [axis for axis in axes if np.ptp(axis.training) > 1e-3]
    return list(zip(moving, moving[1:], strict=False))[:MAX_PAIRS]


def coverage(result: FitResult) -> list[JointCoverage]:
    """Say where each joint has been and how fast."""
    peaks = [[np.max(np.abs(_kept(data, name)), axis=0) for name in ('dq', 'ddq')]
             if data else None for data in (result.training, result.test)]
    rows = []
    for i, axis in enumerate(joint_axes(result)):
        low, high = float(axis.training.min()), float(axis.training.max())
        seen, unseen = peaks
        assert seen is not None  # there is a training bag in every fit
        row = JointCoverage(
            axis.name, axis.unit, (low, high), float(seen[0][i]), float(seen[1][i]))
        if unseen is not None:
            beyond = np.mean((axis.test < low) | (axis.test > high))
            row = JointCoverage(
                row.joint, row.unit, row.training, row.speed, row.acceleration,
                (float(axis.test.min()), float(axis.test.max())), 100.0 * float(beyond),
                float(unseen[0][i]), float(unseen[1][i]))
        rows.append(row)
    return rows
