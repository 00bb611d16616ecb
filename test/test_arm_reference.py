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


"""The reference of the arm description says what the schema says, about every key."""

from __future__ import annotations

import importlib.util
from pathlib import Path
import re
from types import ModuleType
from typing import Any, get_args

from pydantic import BaseModel
import pytest
from tudor_dynamics.arm.description import arm_from_dict
from tudor_dynamics.arm.schema import ArmSpec
import yaml

DIMENSIONLESS = {'gear_ratio', 'efficiency', 'breakaway', 'load_friction', 'nu', 'direction',
                 'height_axis', 'axis'}


@pytest.fixture(scope='module')
def tool(root: Path) -> ModuleType:
    """Load the script that writes the page."""
    spec = importlib.util.spec_from_file_location('arm_reference', root / 'tools/arm_reference.py')
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(__import__('sys').modules, 'arm_reference', module)  # for its dataclass
        spec.loader.exec_module(module)
    return module


def parts(kind: Any) -> list[type[BaseModel]]:
    """Find the models in an annotation."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return [kind]
    return [found for inner in get_args(kind) for found in parts(inner)]


def paths(model: type[BaseModel], prefix: str = '') -> list[str]:
    """List the keys of a model by its fields, without its JSON schema."""
    result = []
    for name, field in model.model_fields.items():
        result.append(prefix + name)
        for inner in parts(field.annotation)[:1]:
            listed = '[]' if 'tuple' in str(field.annotation) else ''
            result += paths(inner, f'{prefix}{name}{listed}.')
    return result


def test_the_page_is_what_the_schema_says(tool: ModuleType) -> None:
    """The page is up to date; ``python tools/arm_reference.py`` writes it again."""
    assert tool.PAGE.read_text(encoding='utf-8') == tool.page()


def test_every_key_is_there_and_described(tool: ModuleType) -> None:
    """No key is missing, without a meaning, without a reader, or a number without a unit."""
    keys = {key.path: key for key in tool.keys_of()}
    assert sorted(keys) == sorted(paths(ArmSpec)) and len(keys) > 110
    for path, key in keys.items():
        assert len(key.meaning.split()) >= 2, f'{path}: {key.meaning!r} says nothing'
        assert set(key.readers) <= set(tool.READERS)
        number = 'number' in key.values and 'whole' not in key.values
        if number and path.rpartition('.')[2] not in DIMENSIONLESS:
            assert key.unit, f'{path} has no unit: [..] at the end of its description'


def test_who_reads_a_key_reads_its_part(tool: ModuleType) -> None:
    """A part is read by all that read one of its keys."""
    keys = {key.path: key for key in tool.keys_of()}
    for path, key in keys.items():
        part = path.rpartition('.')[0].removesuffix('[]')
        if part:
            assert set(key.readers) <= set(keys[part].readers), path


def test_changing_a_page_by_hand_is_seen(tool: ModuleType) -> None:
    """The comparison sees a single changed default."""
    assert tool.page().replace('`0.02`', '`0.03`') != tool.page()


def test_the_arm_of_the_readme_is_one(root: Path) -> None:
    """The ten lines of the README are a description that is accepted."""
    text = (root / 'README.md').read_text(encoding='utf-8')
    found = re.search(r'^```yaml\n(.*?)^```$', text, re.MULTILINE | re.DOTALL)
    assert found is not None and len(found[1].splitlines()) <= 10
    arm = arm_from_dict(yaml.safe_load(found[1]), base=root, source='README.md')
    assert arm.gauge_names == ('upper_arm', 'forearm')
