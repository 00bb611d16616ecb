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
Weights of the generalised-alpha method, and what a step makes of accelerations.

Arnold and Bruels (Multibody System Dynamics 18, 2007): of second order, damping of the
highest frequencies chosen by rho. One set for the simulator and for the elastic model.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from tudor_dynamics.compiled import compiled


class AlphaStep(NamedTuple):
    """A step of one length and damping."""

    dt: float  # length of the step [s]
    # Weights of accelerations at both ends, and of what they make of speed and place.
    alpha_m: float
    alpha_f: float
    gamma: float
    beta: float
    # What a correction of the acceleration adds to the method's own acceleration, to the speed [s]
    # and to the place [s^2].
    gain: float
    speed_gain: float
    place_gain: float


@compiled
def alpha_step(rho: float, dt: float) -> AlphaStep:
    """Choose the weights by the spectral radius at high frequencies."""
    alpha_m, alpha_f = (2.0 * rho - 1.0) / (rho + 1.0), rho / (rho + 1.0)
    gamma = 0.5 + alpha_f - alpha_m
    beta = 0.25 * (gamma + 0.5) ** 2
    gain = (1.0 - alpha_f) / (1.0 - alpha_m)
    return AlphaStep(dt, alpha_m, alpha_f, gamma, beta, gain, dt * gamma * gain,
                     dt * dt * beta * gain)


@compiled
def averaged(step: AlphaStep, ddz: Any, old_ddz: Any, old_acc: Any) -> Any:
    """Give the method's own acceleration at the end of a step."""
    return ((1.0 - step.alpha_f) * ddz + step.alpha_f * old_ddz - step.alpha_m * old_acc) / (
        1.0 - step.alpha_m)


@compiled
def place_after(step: AlphaStep, z: Any, dz: Any, old_acc: Any, acc: Any) -> Any:
    """Give the place at the end of a step from that and the speed at its begin."""
    return z + step.dt * (dz + step.dt * ((0.5 - step.beta) * old_acc + step.beta * acc))


@compiled
def speed_after(step: AlphaStep, dz: Any, old_acc: Any, acc: Any) -> Any:
    """Give the speed at the end of a step from that at its begin."""
    return dz + step.dt * ((1.0 - step.gamma) * old_acc + step.gamma * acc)
