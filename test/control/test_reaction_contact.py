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

"""Reactions with a real contact: the simulated arm on an elastic floor."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.arm.limits import planned_limits
from tudor_dynamics.control.motion_controller import MotionController
from tudor_dynamics.control.references import ReactingReference, yielding_speed
from tudor_dynamics.mechanics.closed_loop import ArmProcess
from tudor_dynamics.mechanics.hardware import Floor

DT = 0.002
FELT = 30.0
"""Change of the strain that counts as contact here, where the arm rests before [um/m]."""


def force_after(root: Path, reaction: str, rise: float = 0.04) -> tuple[float, float, float]:
    """Let the floor rise under the resting tip; give largest and last force [N], way [deg]."""
    arm = load_arm(root / 'config/tudor.yaml')
    process = ArmProcess(arm, payload=0.2, seed=1)
    controller = MotionController(arm)
    reference, at_rest, forces = None, [], []
    for k in range(round(4.0 / DT)):
        sample = process.step()
        if reference is None:
            reference = ReactingReference(planned_limits(arm), sample.q, reaction)
            start = sample.q.copy()
        if k < 500:
            at_rest.append(sample.strain)
        elif k == 500:
            rest = np.mean(at_rest[-200:], axis=0)
            ground = float(process.tip()[2])
        else:
            # within 0.2 s
            process.floor = Floor(ground + rise * min((k - 500) / 100, 1.0), 500.0)
            residual = sample.strain - rest
            if np.abs(residual[:2]).max() > FELT:
                reference.collide()
            reference.yielding[:] = [yielding_speed(float(residual[j]), 1e6, 1000.0)
                                     for j in range(2)]
            forces.append(float(np.linalg.norm(sample.force)))
        reference.step(DT)
        controller.reference.add(k * DT, reference.q, reference.dq)
        command = controller.step(k * DT, DT * min(k, 1), sample.q, sample.strain,
                                  np.ones(len(arm.gauges), dtype=bool))
        if command is not None:
            process.command(command)
    assert reference.reacting
    return (max(forces), float(np.mean(forces[-50:])),
            float(np.degrees(np.abs(reference.q - start).max())))


def test_comply_takes_the_force_away_and_hold_does_not(root: Path) -> None:
    """The arm gives way until the floor presses no more; an arm that holds goes on pressing."""
    largest, last, way = force_after(root, 'comply')
    assert largest > 2.0 and last < 0.15 * largest
    assert 0.5 < way < 20.0
    pressed, pressing, moved = force_after(root, 'hold')
    assert pressing > 0.5 * pressed and pressing > 5.0 * last
    assert moved < 1e-9
