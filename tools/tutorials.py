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
Run the tutorials of ``docs/tutorials`` and write on their pages what the commands print.

    python tools/tutorials.py [PAGE ...]

A block ``sh`` is run; the block ``text`` that follows it holds its output. A line ``...`` on the
page stands for any number of lines; a shown line is replaced by the line of the output that is
most like it. A block that holds nothing but ``...`` becomes the whole output. ``text rough`` is
for output whose numbers depend on the machine.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from difflib import SequenceMatcher
import os
from pathlib import Path
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile

from tudor_dynamics.nodes.common.interfaces import NODES

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted((ROOT / 'docs' / 'tutorials').glob('*_*.md'))
FENCE = re.compile(r'^```(sh|text|text rough)\n(.*?)^```$', re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r'[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?')
SPACE = re.compile(r'[\s─]+')
STEP = re.compile(r'^(?:\d+ s: |compiling functions,).*\n', re.MULTILINE)
"""Progress, which is named on a slow machine alone, or at the first run."""
CLOSE = 0.05
"""Numbers of two machines differ by less, as a share."""
CUT = '...'


@dataclass(frozen=True)
class Block:
    """A block of commands with the output that the page shows, if it shows one."""

    commands: str
    shown: str | None
    rough: bool
    span: tuple[int, int]  # of the shown output on the page


def blocks(text: str) -> Iterator[Block]:
    """Give the blocks of a page, one after the other."""
    found = list(FENCE.finditer(text))
    for at, match in enumerate(found):
        if match[1] != 'sh':
            continue
        after = found[at + 1] if at + 1 < len(found) and found[at + 1][1] != 'sh' else None
        yield Block(match[2], after and after[2], after is not None and after[1] == 'text rough',
                    after.span(2) if after else (0, 0))


def checkout(folder: Path) -> dict[str, str]:
    """Make a place to run them in, with what a checkout has; give its environment."""
    folder.mkdir(exist_ok=True)
    for name in ('config', 'bags'):
        shutil.copytree(ROOT / name, folder / name)
    (folder / 'bin').mkdir()
    modules = {'python': '', 'tudor': '-m tudor_dynamics ',
               **{node: f'-m tudor_dynamics.nodes {node} ' for node in NODES}}
    for tool, words in modules.items():
        file = folder / 'bin' / tool
        file.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} {words}"$@"\n')
        file.chmod(0o755)
    return {**os.environ, 'PATH': f'{folder}/bin:{os.environ["PATH"]}', 'PYTHONPATH': str(ROOT),
            'PYTHONDONTWRITEBYTECODE': '', 'COLUMNS': '80', 'TZ': 'UTC'}


def run(commands: list[str], folder: Path, patience: float) -> list[str]:
    """
    Run blocks in one shell; give what each printed, standard error included.

    The first block that fails ends it, with what it printed in the error. patience: for all [s].
    """
    environment = checkout(folder)
    script = 'set -e\n' + ''.join(f'exec > out_{k} 2>&1\n{text}\n'
                                  for k, text in enumerate(commands))
    process = subprocess.Popen(['bash', '-c', script], cwd=folder, env=environment,
                               start_new_session=True)
    try:
        code = process.wait(patience)
    except subprocess.TimeoutExpired:
        code = None
    finally:
        try:
            os.killpg(process.pid, signal.SIGKILL)
        except ProcessLookupError:
            left = False
        else:
            left = code is not None
    outputs = [STEP.sub('', path.read_text(encoding='utf-8')) for k in range(len(commands))
               if (path := folder / f'out_{k}').exists()]
    logs = '\n'.join(f'{path.name}: {path.read_text()[-1000:]}' for path in folder.glob('*.log'))
    if code != 0:
        raise RuntimeError(f'exit code {code}: {commands[len(outputs) - 1]}{outputs[-1]}{logs}')
    if left:
        raise RuntimeError('processes go on when all commands have ended')
    return outputs


def same(shown: str, line: str, *, rough: bool) -> bool:
    """Say whether two lines have the same words, and numbers that are close."""
    parts = [SPACE.sub(' ', NUMBER.sub('0', text)).strip() for text in (shown, line)]
    if parts[0] != parts[1]:
        return False
    pairs = zip(NUMBER.findall(shown), NUMBER.findall(line), strict=True)
    return rough or all(abs(float(a) - float(b)) <= CLOSE * max(abs(float(a)), abs(float(b)))
                        for a, b in pairs)


def differences(block: Block, output: str) -> list[str]:
    """Name the shown lines that the output does not have, in their order."""
    lines, free, missing = iter(output.splitlines()), False, []
    for shown in (block.shown or '').splitlines():
        if shown == CUT:
            free = True
            continue
        for line in lines:
            if same(shown, line, rough=block.rough):
                break
            if not free:
                missing.append(f'{shown!r} is shown, {line!r} was printed')
                break
        else:
            missing.append(f'{shown!r} was not printed')
            return missing
        free = False
    if not free and (rest := next(lines, None)) is not None:
        missing.append(f'{rest!r} is not shown')
    return missing


def shown_again(block: Block, output: str) -> str:
    """Give the output as the page is to show it."""
    new = [line.rstrip() for line in output.splitlines()]
    old = (block.shown or '').splitlines()
    if old == [CUT]:
        return '\n'.join(new) + '\n'
    if CUT not in old:
        return '\n'.join(new) + '\n'
    found, at = [], 0
    for line in old:
        if line == CUT:
            found.append(CUT)
        elif at < len(new):
            at = max(range(at, len(new)), key=lambda k: SequenceMatcher(
                None, line.split(), new[k].split()).ratio())
            found.append(new[at])
            at += 1
    return '\n'.join(found) + '\n'


def main() -> None:
    """Write the pages."""
    for page in map(Path, sys.argv[1:] or PAGES):
        text = page.read_text(encoding='utf-8')
        found = list(blocks(text))
        with tempfile.TemporaryDirectory() as folder:
            outputs = run([block.commands for block in found], Path(folder), 600.0)
        for block, output in reversed(list(zip(found, outputs, strict=True))):
            if block.shown is not None:
                text = (text[:block.span[0]] + shown_again(block, output)
                        + text[block.span[1]:])
        page.write_text(text, encoding='utf-8')


if __name__ == '__main__':
    main()
