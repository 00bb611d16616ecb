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

"""Who may use whom: the picture in docs/architecture.md is the rule, and the code keeps it."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import lru_cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
import re

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / 'tudor_dynamics'
PAGE = PACKAGE.parent / 'docs' / 'architecture.md'
NODES, TOP, MAIN = 'nodes', '__init__', '__main__'


def modules(package: Path) -> dict[str, Path]:
    """Find all modules by their dotted names below the package; a room by its own."""
    return {'.'.join(file.relative_to(package).with_suffix('').parts).removesuffix('.__init__'):
            file for file in sorted(package.rglob('*.py'))}


@lru_cache
def imports(package: Path) -> dict[str, set[str]]:
    """Find what each module imports of the package, wherever and for whatever it does."""
    known = modules(package)
    result = {}
    for name, file in known.items():
        found: set[str] = set()
        for node in ast.walk(ast.parse(file.read_text(encoding='utf-8'))):
            found.update(_named(node, package.name, known))
        result[name] = found - {name}
    return result


def _named(node: ast.AST, package: str, known: dict[str, Path]) -> Iterator[str]:
    if isinstance(node, ast.Import):
        names = [f'{alias.name}.{TOP}' for alias in node.names]
    elif isinstance(node, ast.ImportFrom):
        assert node.level == 0, 'imports are absolute'
        names = [f'{node.module}.{alias.name}' for alias in node.names]
    else:
        return
    for name in names:
        first, *parts = name.split('.')
        while parts and '.'.join(parts) not in known and first == package:
            parts.pop()
        if first == package:
            yield '.'.join(parts) or TOP


def ranks(page: Path) -> dict[str, int]:
    """Read the rooms off the picture; what stands lower has the larger number."""
    picture = re.search(r'^```text\n(cli.*?)^```', page.read_text(encoding='utf-8'), re.M | re.S)
    assert picture
    return {room.replace('/', '.'): number
            for number, line in enumerate(picture[1].splitlines()) for room in line.split()}


def room_of(module: str, rank: dict[str, int]) -> str | None:
    """Give the room that a module stands in; None for those at the top of the package."""
    inside = [room for room in rank if f'{module}.'.startswith(f'{room}.')]
    return max(inside, key=len, default=None)


def upwards(package: Path, rank: dict[str, int]) -> list[str]:
    """Find the imports against the order of the rooms."""
    wrong = []
    for module, found in imports(package).items():
        own = room_of(module, rank)
        if module in (TOP, MAIN):
            continue
        for other in found:
            room = room_of(other, rank)
            if room == own or room is None and other != TOP:
                continue
            if own is None or room is None or rank[room] <= rank[own]:
                wrong.append(f'{module} uses {other}')
    return wrong


def test_every_module_has_a_room() -> None:
    """No folder is missing in the picture, and none in it is missing in the package."""
    rank = ranks(PAGE)
    folders = {module.split('.')[0] for module in imports(PACKAGE) if '.' in module}
    assert {room for room in rank if (PACKAGE / room).is_dir()} == folders
    assert set(rank) <= set(imports(PACKAGE))
    loose = [module for module in imports(PACKAGE)
             if '.' in module and room_of(module, rank) is None]
    assert not loose


def test_nothing_is_used_from_above() -> None:
    """A room uses those below it in the picture, and none on its own line or above."""
    assert not upwards(PACKAGE, ranks(PAGE))


def test_nodes_stand_alone() -> None:
    """ROS is imported in ``nodes`` alone, and nothing else uses them."""
    for name, file in modules(PACKAGE).items():
        if name.split('.')[0] != NODES:
            assert not {other for other in imports(PACKAGE)[name]
                        if other.split('.')[0] == NODES}, name
            assert not re.search(r'^\s*(import|from) rclpy\b', file.read_text(encoding='utf-8'),
                                 re.M), name


def test_no_cycles() -> None:
    """No module needs itself, by whatever detour."""
    graph = {module: found for module, found in imports(PACKAGE).items() if module != TOP}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as err:
        pytest.fail(' -> '.join(err.args[1]))


@pytest.mark.parametrize(('line', 'found'), [
    ('from tudor_dynamics.upper.two import x', ['lower.one uses upper.two']),
    ('def f():\n    import tudor_dynamics.upper.two', ['lower.one uses upper.two']),
    ('from tudor_dynamics.upper import two', ['lower.one uses upper.two']),
    ('from tudor_dynamics import load_arm', ['lower.one uses __init__']),
    ('from tudor_dynamics.lower import other', [])])
def test_an_import_upwards_is_seen(tmp_path: Path, line: str, found: list[str]) -> None:
    """Whether it stands at the top of a file or inside a function."""
    package = tmp_path / 'tudor_dynamics'
    for name, text in (('lower/one', line), ('lower/other', ''),
                       ('upper/two', 'from tudor_dynamics.lower.other import y')):
        file = package / f'{name}.py'
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    assert upwards(package, {'upper': 0, 'lower': 1}) == found


def test_paths_of_the_page_exist() -> None:
    """Every file and folder that the page names is there; short names follow a path."""
    text, root = PAGE.read_text(encoding='utf-8'), PACKAGE.parent
    named = re.findall(r'`((?:[a-z_]+/)+(?:[a-z_0-9]+\.[a-z0-9]+)?)`', text)
    assert len(named) > 25
    assert not [name for name in named
                if not (PACKAGE / name).exists() and not (root / name).exists()]
    files = {file.name for file in PACKAGE.rglob('*.*')}
    short = set(re.findall(r'`([a-z_0-9]+\.(?:py|yaml))`', text)) - {'metadata.yaml', 'model.yaml'}
    assert not [name for name in short if name not in files and not (root / name).exists()]
