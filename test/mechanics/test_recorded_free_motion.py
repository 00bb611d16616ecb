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

"""No recorded motion is taken for one that lies: the bags of bench/false_faults.py."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.bags.recording import Recording


@pytest.fixture(autouse=True)
def bench(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let scripts of bench/ be imported."""
    monkeypatch.syspath_prepend(str(root / 'bench'))


def test_recordings_that_are_shipped() -> None:
    """All that the two blades did is believed."""
    from false_faults import recordings, replay
    bags = recordings(None)
    assert len(bags) >= 4
    assert [text for bag, arm in bags for text in replay(bag, arm)] == []


def test_recordings_of_industrial_arms(shared_data: Path) -> None:
    """So is what a UR10 and UR10e arms did, pushed or loaded."""
    from false_faults import recordings, replay
    bags = [item for item in recordings(shared_data) if item not in recordings(None)]
    assert len(bags) == 4
    assert [text for bag, arm in bags for text in replay(bag, arm)] == []


def test_a_recording_that_lies_is_found(
    shared_data: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The same replay finds an encoder that counts half of the speed that the driver gives."""
    import false_faults
    read = false_faults.read_recording

    def halved(bag: Path, arm: Arm) -> Recording:
        recording = read(bag, arm)
        return replace(recording, q=0.5 * recording.q)
    monkeypatch.setattr(false_faults, 'read_recording', halved)
    assert false_faults.replay(shared_data / 'bags/ur10e_unloaded',
                               shared_data / 'arms/ur10e.yaml')
