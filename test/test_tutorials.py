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

"""The blocks of the tutorials run, and print what their pages show."""

from __future__ import annotations

from pathlib import Path

import pytest
from tools import tutorials

ROOT = Path(__file__).resolve().parents[1]
PATIENCE = 400.0
"""For the blocks of a page, on a busy machine; idle, they take half a minute [s]."""


@pytest.mark.parametrize('page', tutorials.PAGES, ids=[page.stem for page in tutorials.PAGES])
def test_a_page_shows_what_comes(page: Path, tmp_path: Path) -> None:
    """Every block ends well, one after the other in a fresh copy, and prints what is shown."""
    blocks = list(tutorials.blocks(page.read_text(encoding='utf-8')))
    assert len(blocks) > 4 and sum(block.shown is not None for block in blocks) > 3
    outputs = tutorials.run([block.commands for block in blocks], tmp_path / 'work', PATIENCE)
    wrong = [f'{block.commands}{line}' for block, output in zip(blocks, outputs, strict=True)
             if block.shown is not None for line in tutorials.differences(block, output)]
    assert not wrong, '\n'.join([*wrong, 'python tools/tutorials.py writes the pages again'])


@pytest.mark.parametrize(('shown', 'printed', 'found'), [
    ('a 1.00\nb 2\n', 'a 1.01\nb 2\n', 0), ('a 1.00\n', 'a 1.20\n', 1), ('a 1\n', 'b 1\n', 1),
    ('a 1\n', 'a 1\nb 2\n', 1), ('a 1\n...\n', 'a 1\nb 2\n', 0), ('...\nb 2\n', 'a 1\nb 2\n', 0),
    ('...\nc 2\n', 'a 1\nb 2\n', 1), ('a 1\nb 2\n', 'a 1\n', 1), ('a ── 1\n', 'a ──── 1\n', 0)])
def test_another_output_is_noticed(shown: str, printed: str, found: int) -> None:
    """Words are compared, numbers to a twentieth, and ``...`` stands for any lines."""
    block = tutorials.Block('', shown, False, (0, 0))
    assert len(tutorials.differences(block, printed)) == found


def test_a_failing_block_is_named(tmp_path: Path) -> None:
    """The first block that fails ends the page, with what it printed."""
    with pytest.raises(RuntimeError, match='exit code 3: echo two; exit 3\ntwo'):
        tutorials.run(['echo one\n', 'echo two; exit 3\n', 'echo three\n'], tmp_path / 'work',
                      20.0)


def test_pages_are_written_again() -> None:
    """A line keeps its place and gets the numbers of now; what is left out stays so."""
    block = tutorials.Block('', 'fit 80 %\n...\nuse: strain\n', False, (0, 0))
    assert tutorials.shown_again(block, 'fit 93 %\nother\nmore\nuse: effort and strain\n') == (
        'fit 93 %\n...\nuse: effort and strain\n')
