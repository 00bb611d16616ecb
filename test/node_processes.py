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

"""Nodes as processes."""

from __future__ import annotations

from collections.abc import Iterable
from multiprocessing import get_context
from multiprocessing.process import BaseProcess
import os
from pathlib import Path
import runpy
import subprocess
import sys
from typing import Any

from patience import PATIENCE
import pytest

pytest.importorskip('rclpy')

from tudor_dynamics.nodes.common.interfaces import NODES  # noqa: E402, I100

LOADED = get_context('forkserver')
"""Begins processes that have loaded the modules of all nodes, which takes three seconds."""
LOADED.set_forkserver_preload([f'tudor_dynamics.nodes.{node}' for node in NODES])


def launch(node: str, *args: str, executor: str = 'events', **how: Any) -> subprocess.Popen:
    """Start a node; ``**how`` goes to Popen."""
    return subprocess.Popen(
        [sys.executable, '-m', 'tudor_dynamics.nodes', node, '--ros-args', *args],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        env={**os.environ, 'PYTHONPATH': str(Path(__file__).parents[1]),
             'TUDOR_EXECUTOR': executor}, **how)


def finish(process: subprocess.Popen, number: int) -> str:
    """Send a signal; the exit code must be 0."""
    process.send_signal(number)
    try:
        out, _ = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
    assert process.returncode == 0, out
    assert 'Traceback' not in out, out
    return out


def _run(node: str, args: tuple[str, ...]) -> None:
    sys.argv = ['', node, *args]
    runpy.run_module('tudor_dynamics.nodes', run_name='__main__')


def fork(node: str, *args: str) -> BaseProcess:
    """Start a node as a process of its own where it does not matter how its modules are loaded."""
    process = LOADED.Process(target=_run, args=(node, ('--ros-args', *args)), daemon=True)
    process.start()
    return process


def end(processes: Iterable[BaseProcess]) -> None:
    """Ask processes to end, and see that they have."""
    processes = list(processes)
    for process in processes:
        process.terminate()
    for process in processes:
        process.join(PATIENCE)
        process.kill()
        process.join()
