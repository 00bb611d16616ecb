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

"""The damper's self-test on made-up ring-downs."""

from __future__ import annotations

import numpy as np
import pytest

from tudor_dynamics.control.damper import check_sign, Measure, Sign, StepResponse

DT = 0.002
T = np.arange(0.0, 3.5, DT)


def ring(amplitude: float, rate: float, noise: float = 1.0, seed: int = 0) -> StepResponse:
    """Give a 2.2 Hz vibration that decays (or grows, rate < 0) in noise."""
    generator = np.random.default_rng(seed)
    strain = amplitude * np.exp(-rate * T) * np.sin(2 * np.pi * 2.2 * T)
    return StepResponse(DT, strain + generator.normal(0.0, noise, T.size))


def answers(*responses: StepResponse) -> Measure:
    """Give a measurement that answers with the responses in turn."""
    waiting = list(responses)
    return lambda joint, step, share: waiting.pop(0)


def test_a_damped_link_is_right() -> None:
    """Quick decay with the damper."""
    result = check_sign('joint3', answers(ring(40, 0.1), ring(40, 3.0, seed=1)))
    assert result.sign is Sign.RIGHT


def test_a_rest_that_rang_does_not_turn_the_answer() -> None:
    """The rest was recorded while the arm still rang, louder than the damped response."""
    result = check_sign('joint3', answers(ring(40, 0.1), ring(12, 3.0, seed=1)),
                        rest=ring(8, 0.0, seed=2))
    assert result.sign is Sign.RIGHT


@pytest.mark.parametrize('rate', [-0.8, 0.0])
def test_an_excited_link_is_wrong(rate: float) -> None:
    """The ringing grows, or does not decay any more."""
    result = check_sign('joint3', answers(ring(40, 0.3), ring(40, rate, seed=1)),
                        rest=ring(0, 0.0, seed=2))
    assert result.sign is Sign.WRONG and "reverse the sign in the gauge's driver" in result.text


def test_nothing_to_hear_is_unclear() -> None:
    """A link that hardly rings tells nothing."""
    result = check_sign('joint3', answers(ring(1, 0.1)), rest=ring(0, 0.0, seed=2))
    assert result.sign is Sign.UNCLEAR and 'a larger step' in result.text
