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

from pathlib import Path
import re
from typing import Any, get_args

from pydantic import BaseModel
from tools import arm_reference
from tudor_dynamics.arm.description import arm_from_dict
from tudor_dynamics.arm.schema import ArmSpec
import yaml

DIMENSIONLESS = {'gear_ratio', 'efficiency', 'breakaway', 'load_friction', 'nu', 'direction',
                 'height_axis', 'axis'}


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


def test_the_page_is_what_the_schema_says() -> None:
    """The page is up to date; ``python tools/arm_reference.py`` writes it again."""
    assert arm_reference.PAGE.read_text(encoding='utf-8') == arm_reference.page()


def test_every_key_is_there_and_described() -> None:
    """No key is missing, without a meaning, without a reader, or a number without a unit."""
    keys = {key.path: key for key in arm_reference.keys_of()}
    assert sorted(keys) == sorted(paths(ArmSpec)) and len(keys) > 110
    for path, key in keys.items():
        assert len(key.meaning.split()) >= 2, f'{path}: {key.meaning!r} says nothing'
        assert set(key.readers) <= set(arm_reference.READERS)
        number = 'number' in key.values and 'whole' not in key.values
        if number and path.rpartition('.')[2] not in DIMENSIONLESS:
            assert key.unit, f'{path} has no unit: [..] at the end of its description'


def test_who_reads_a_key_reads_its_part() -> None:
    """A part is read by all that read one of its keys."""
    keys = {key.path: key for key in arm_reference.keys_of()}
    for path, key in keys.items():
        part = path.rpartition('.')[0].removesuffix('[]')
        if part:
            assert set(key.readers) <= set(keys[part].readers), path


def test_changing_a_page_by_hand_is_seen() -> None:
    """The comparison sees a single changed default."""
    assert arm_reference.page().replace('`0.02`', '`0.03`') != arm_reference.page()


def test_the_arm_of_the_readme_is_one(root: Path) -> None:
    """The ten lines of the README are a description that is accepted."""
    text = (root / 'README.md').read_text(encoding='utf-8')
    found = re.search(r'^```yaml\n(.*?)^```$', text, re.MULTILINE | re.DOTALL)
    assert found is not None and len(found[1].splitlines()) <= 10
    arm = arm_from_dict(yaml.safe_load(found[1]), base=root, source='README.md')
    assert arm.gauge_names == ('upper_arm', 'forearm')
