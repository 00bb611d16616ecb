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

"""A short run of ``bench/fuzz.py``, the long one of which takes minutes."""

from __future__ import annotations

from pathlib import Path
import subprocess
import sys

import pytest


def test_damaged_input(root: Path) -> None:
    """Some damaged bags, bundles and arms: refused on one line, or read as rosbags does."""
    done = subprocess.run(
        [sys.executable, 'bench/fuzz.py', '--bags', '120', '--bundles', '60', '--arms', '60',
         '--seed', '7'], cwd=root, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        check=False)
    assert done.returncode == 0, done.stdout
    lines = [line for line in done.stdout.splitlines() if not line.startswith('compiling')]
    assert [line.split(':')[0] for line in lines] == ['bags', 'bundles', 'arms']
    assert lines[0].startswith('bags: 120 mutations') and ' 0 wrong; ' in lines[0]


@pytest.mark.parametrize(('script', 'counts'), [
    ('fuzz_bags.py', {'losses': 2}), ('fuzz_urdfs.py', {'urdfs': 200}),
    ('fuzz_files.py', {'plans': 0, 'trajectories': 60, 'truths': 60, 'fleets': 0})])
def test_of_one_kind(root: Path, script: str, counts: dict[str, int]) -> None:
    """Fits of bags that lost messages, URDFs with people's faults, files that programs send."""
    words = [word for kind, count in counts.items() for word in (f'--{kind}', str(count))]
    done = subprocess.run(
        [sys.executable, f'bench/{script}', *words, '--seed', '3'], cwd=root,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    assert done.returncode == 0, done.stdout
    for kind, count in counts.items():
        said, = (line for line in done.stdout.splitlines() if line.startswith(f'{kind}:'))
        assert said.startswith(f'{kind}: {count} mutations') and ' 0 wrong; ' in said
