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

"""Sums on disk, and bags that are sent with the work on them."""

from __future__ import annotations

from pathlib import Path

import pytest

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.errors import BagError
from tudor_dynamics.fleet.cluster import packed, unpacked
from tudor_dynamics.identification import passes
from tudor_dynamics.identification.dataset import BagChoice, SurveyedBag, Unused
from tudor_dynamics.identification.fit import FitSettings
from tudor_dynamics.identification.passes import Folder, Found, Memory, Task, Trial
from tudor_dynamics.parallel import Count

OLD, NEW = ('-'.join((24 * letter, 16 * letter)) + '.npz' for letter in 'ab')


def test_a_folder_keeps_what_is_used(tmp_path: Path) -> None:
    """It is made where it is not; what is of before goes, files of others stay."""
    folder = Folder(tmp_path / 'model.sums')
    assert folder.read(OLD) is None
    for name in (OLD, NEW, 'notes.txt'):
        folder.write(name, name.encode())
    assert folder.read(NEW) == NEW.encode()
    folder.forget({NEW})
    assert sorted(file.name for file in folder.path.iterdir()) == [NEW, 'notes.txt']
    assert folder.place(NEW) == str(tmp_path / 'model.sums' / NEW)


def test_what_is_too_large_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file that no bag can come to counts as none: it is made again."""
    monkeypatch.setattr(passes, 'LARGEST', 10)
    folder = Folder(tmp_path)
    folder.write(OLD, b'x' * 11)
    folder.write(NEW, b'x' * 10)
    assert folder.read(OLD) is None and folder.read(NEW) == b'x' * 10


def asked(root: Path, base: Path, name: str) -> Trial:
    """Ask for a bag in a folder."""
    arm = load_arm(root / 'config' / 'two_blade_arm.yaml')
    task = Task(arm, (arm.spec.preprocessing,), ('effort',), FitSettings(), base, Memory())
    return Trial(task, (SurveyedBag(BagChoice(name), 'a' * 64),), {}, {})


def weighed(trial: Trial, count: Count) -> Found:
    """Keep the bytes of a bag, and complain about the place where it stands."""
    bag, = trial.bags
    place = trial.task.place(bag)
    files = sorted(place.iterdir()) if place.is_dir() else [place]
    for file in files:
        trial.task.store.write(file.name, file.read_bytes())
    count(1)
    return [Unused(bag.choice.path, f'{place}: looked at')]


@pytest.mark.parametrize('name', ['run', 'run.mcap'])
def test_a_bag_travels_with_its_work(name: str, root: Path, tmp_path: Path) -> None:
    """There it has the same files, here the name by which it was given; no copy stays."""
    if name == 'run':
        (tmp_path / name).mkdir()
        (tmp_path / name / 'metadata.yaml').write_bytes(b'one')
        (tmp_path / name / 'run_0.mcap').write_bytes(b'two')
        content = {'metadata.yaml': b'one', 'run_0.mcap': b'two'}
    else:
        (tmp_path / name).write_bytes(b'three')
        content = {name: b'three'}
    trial, counts = asked(root, tmp_path, name), list[int]()
    found, kept = unpacked(packed(weighed, trial), counts.append)
    assert found == [Unused(name, f'{name}: looked at')]
    assert kept == content and counts == [1]
    assert trial.task.store.read('metadata.yaml') is None  # the answer brings it


def test_a_bag_that_has_gone_says_so(root: Path, tmp_path: Path) -> None:
    """It is looked for when its turn comes."""
    with pytest.raises(BagError, match='leave the bags where they are') as caught:
        packed(weighed, asked(root, tmp_path, 'gone'))
    assert caught.value.place == 'gone'
