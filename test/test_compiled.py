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

"""What is compiled once is used again, but never after any of the sources has changed."""

from __future__ import annotations

import ast
import importlib
import os
from pathlib import Path
import shutil
import subprocess
import sys
from types import ModuleType
from typing import Any

from tudor_dynamics import compiled

INNER = """
from tiny.compiled import compiled


@compiled
def inner(x):
    return {factor} * x
"""
OUTER = """
from tiny.compiled import compiled
from tiny.inner import inner


@compiled
def outer(x):
    return inner(x) + 1.0
"""
CALL = 'from tiny.outer import outer; print(outer(2.0), sum(outer.stats.cache_hits.values()))'

MOTIONS = """
import sys
import numpy as np
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.models.elastic.arm import DrivenArm
from tudor_dynamics.mechanics.mechanism import build_mechanism
from tudor_dynamics.mechanics.plant import Plant


def plant():
    moved = Plant(build_mechanism(arm), 0.0005)
    moved.reset([0.0, 0.3, 0.4])
    for step in range(400):
        moved.step([0.0, 0.5, 0.3 * np.sin(0.01 * step)])
    return moved.coordinates


def model():
    driven = DrivenArm(arm)
    driven.follow(np.tile([0.6, 0.5], (20, 1)), 0.01 * np.arange(20))
    return driven.tables.equations.vectors


arm = load_arm(sys.argv[1])
done = {name: globals()[name]().tobytes().hex() for name in sys.argv[2:]}
print(done['plant'], done['model'])
"""
"""What a plant and a model come to, whichever moves first."""


def call(folder: Path, **environment: str) -> list[str]:
    """Call the outer function in a process of its own: result and hits of the cache."""
    done = subprocess.run([sys.executable, '-c', CALL], cwd=folder, capture_output=True, text=True,
                          env={**os.environ, **environment})
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def tiny(folder: Path) -> Path:
    """Write a package with a function that calls one of another file."""
    package = folder / 'tiny'
    package.mkdir()
    (package / '__init__.py').touch()
    shutil.copy(str(compiled.__file__), package)
    (package / 'inner.py').write_text(INNER.format(factor=3.0))
    (package / 'outer.py').write_text(OUTER)
    return package


def test_a_changed_callee_is_compiled_again(tmp_path: Path) -> None:
    """What numba does not notice, the name of the directory does; the old one goes."""
    package = tiny(tmp_path)
    assert call(tmp_path, NUMBA_CACHE_DIR='') == ['7.0', '0']
    assert call(tmp_path, NUMBA_CACHE_DIR='') == ['7.0', '1']
    (package / 'inner.py').write_text(INNER.format(factor=5.0))
    assert call(tmp_path, NUMBA_CACHE_DIR='') == ['11.0', '0']
    assert len(list((package / '__pycache__').glob('tudor_dynamics-*'))) == 1


def test_processes_that_start_at_once_compile_once(tmp_path: Path) -> None:
    """A function that another process compiles is waited for, and read from the disk."""
    tiny(tmp_path)
    others = [subprocess.Popen([sys.executable, '-c', CALL], cwd=tmp_path, text=True,
                               stdout=subprocess.PIPE, env={**os.environ, 'NUMBA_CACHE_DIR': ''})
              for _ in range(4)]
    said = sorted(process.communicate(timeout=120.0)[0].split()[-1] for process in others)
    assert said == ['0', '1', '1', '1']


def test_bits_do_not_depend_on_what_was_called_before(root: Path) -> None:
    """Functions that two others contain exist twice, and the first that is loaded serves both."""
    first, second = (subprocess.run(
        [sys.executable, '-c', MOTIONS, str(root / 'config/tudor.yaml'), *order],
        capture_output=True, text=True, check=True).stdout.split()
        for order in (('plant', 'model'), ('model', 'plant')))
    assert len(first) == 2 and first == second


def test_nothing_can_be_kept(tmp_path: Path) -> None:
    """Where no directory can be made, functions are compiled in every process."""
    tiny(tmp_path)
    (tmp_path / 'file').touch()
    assert call(tmp_path, NUMBA_CACHE_DIR=str(tmp_path / 'file')) == ['7.0', '0']


def kernels() -> list[ModuleType]:
    """Import the modules with compiled functions."""
    return [importlib.import_module('.'.join(
        ('tudor_dynamics', *file.relative_to(compiled.PACKAGE).with_suffix('').parts)))
        for file in compiled.kernel_files()]


def origin(module: ModuleType, name: str) -> str:
    """Name the module in which a global name gets its value."""
    for node in ast.parse(Path(str(module.__file__)).read_text(encoding='utf-8')).body:
        if isinstance(node, ast.ImportFrom) and name in [
                alias.asname or alias.name for alias in node.names]:
            return str(node.module)
    return module.__name__


def test_kernels_take_few_arguments() -> None:
    """Arrays that belong together are a named tuple; from Python they come one by one."""
    many = [f'{function.__module__}.{function.__name__}' for module in kernels()
            for function in vars(module).values()
            if (body := getattr(function, 'py_func', None)) and body.__code__.co_argcount > 12]
    assert not many


def test_constants_of_kernels_are_in_kernel_files() -> None:
    """A number that is compiled into a function stands in a file that the name depends on."""
    modules = kernels()
    assert len(modules) > 20
    known, numbers = {module.__name__ for module in modules}, 0
    for module in modules:
        for function in vars(module).values():
            body: Any = getattr(function, 'py_func', None)
            if body is None:
                continue
            for name in body.__code__.co_names:
                if isinstance(vars(module).get(name), (int, float, tuple)):
                    numbers += 1
                    assert origin(module, name) in known, f'{name} of {module.__name__}'
                elif isinstance(vars(module).get(name), ModuleType) and name != 'math':
                    numbers += 1  # such as at.MASS
                    assert vars(module)[name].__name__ in known | {'numpy'}, module.__name__
    assert numbers > 100
