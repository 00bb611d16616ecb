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

"""Motors that turn with a neighbouring joint: described or not."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from tudor_dynamics.arm.description import Arm, load_arm
from tudor_dynamics.arm.schema import CouplingPair, CouplingsSpec
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.identification.doctor.examine import examine

ROOT = Path(__file__).resolve().parents[3]


@lru_cache
def _arm() -> Arm:
    return load_arm(ROOT / 'config' / 'two_blade_arm.yaml')


def _bag() -> Recording:
    return read_recording(ROOT / 'bags' / 'two_blade_test', _arm())


def _coupled(ratio: float) -> Arm:
    return _arm().changed(couplings=CouplingsSpec(
        pairs=(CouplingPair(motor='joint3', joint='joint2', ratio=ratio),),
        positions='motors', efforts='motors'))


def _at_motors(recording: Recording, ratio: float) -> Recording:
    """Give what coupled motors without friction would have shown."""
    matrix = np.array([[1.0, 0.0], [ratio, 1.0]])
    assert recording.effort is not None
    return replace(recording, q=recording.q @ matrix.T, dq=None,
                   effort=recording.effort @ np.linalg.inv(matrix))


@pytest.mark.parametrize('ratio', [1.0, -1.0])
def test_a_coupling_that_is_not_described(ratio: float) -> None:
    """Motor, joint, direction, and the lines that the description wants."""
    findings = examine(_arm(), _at_motors(_bag(), ratio)).findings
    found = next(item for item in findings if item.kind == 'coupling_missing')
    assert found.channels == ('joint3', 'joint2') and found.size == ratio
    assert f'motor: joint3, joint: joint2, ratio: {ratio:g}' in found.remedy


def test_a_coupling_that_is_described_is_none_of_its_business() -> None:
    """The same recording with the right description has nothing of it."""
    findings = examine(_coupled(1.0), _at_motors(_bag(), 1.0)).findings
    assert not {'coupling_missing', 'coupling_wrong'} & {item.kind for item in findings}


def test_a_coupling_that_is_described_and_not_there() -> None:
    """The plain arm, described with coupled motors."""
    found = examine(_coupled(1.0), _bag()).findings[0]
    assert found.kind == 'coupling_wrong' and set(found.channels) == {'joint2', 'joint3'}
    assert "remove the key 'couplings'" in found.remedy
