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

"""Bags in folders, and patterns for them."""

from __future__ import annotations

from pathlib import Path

import pytest

from tudor_dynamics.bags.storage import bags_below
from tudor_dynamics.errors import UsageError
from tudor_dynamics.identification.dataset import found_choices


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Make folders that look as if they had bags."""
    for name in ('monday/run_10', 'monday/run_9', 'tuesday/run_1', '.hidden/run', 'empty'):
        (tmp_path / name).mkdir(parents=True)
    for name in ('monday/run_10', 'monday/run_9', '.hidden/run'):
        (tmp_path / name / 'metadata.yaml').touch()
    (tmp_path / 'tuesday/run_1/run_1.mcap').touch()
    (tmp_path / 'notes.txt').touch()
    return tmp_path


def test_a_folder_gives_its_bags(folder: Path) -> None:
    """Numbers count by size; hidden folders, other files and folders without bags do not."""
    names = ['monday/run_9', 'monday/run_10', 'tuesday/run_1']
    assert bags_below(folder) == [folder / name for name in names]
    assert bags_below(folder / 'monday/run_9') == [folder / 'monday/run_9']
    assert bags_below(folder / 'empty') == [folder / 'empty']  # an error says what is missing
    assert bags_below(folder, 1) == [folder]


def test_arguments_name_folders_and_patterns(
    folder: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A part of a folder is that part of each of its bags."""
    monkeypatch.chdir(folder)
    assert [str(choice) for choice in found_choices(['monday@0-50%', 'tuesday/run_1'])] == [
        'monday/run_9@0-50%', 'monday/run_10@0-50%', 'tuesday/run_1']
    assert [str(choice) for choice in found_choices(['monday/run_*'])] == [
        'monday/run_9', 'monday/run_10']
    assert [str(choice) for choice in found_choices(['nowhere'])] == ['nowhere']
    with pytest.raises(UsageError, match='no file has such a name'):
        found_choices(['tuesday/x*'])
    (folder / 'monday/run_[1]').mkdir()  # a name that is one is no pattern
    assert [choice.path for choice in found_choices(['monday/run_[1]'])] == ['monday/run_[1]']
