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
Write the tables of ``docs/reference/arm_yaml.md`` from the schema and the table of friction terms.

    python tools/arm_reference.py

What stands before the marker is kept, what stands after it is written again.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import json
from pathlib import Path
import re
from typing import Any

from tudor_dynamics.arm.schema import ArmSpec, FRICTION_TERMS
from tudor_dynamics.models.friction import TERMS

PAGE = Path(__file__).resolve().parents[1] / 'docs' / 'reference' / 'arm_yaml.md'
MARKER = '<!-- From here on written by tools/arm_reference.py from the schema. -->\n'

MODELS = 'M'
ELASTIC = 'E'
SIMULATE = 'S'
RECORD = 'R'
DAMPER = 'D'
REFERENCES = 'G'
READERS = {
    MODELS: '`tudor fit`, `evaluate`, `info`; with the model, `joint_state_filter`, '
            '`dynamics_predictor`, `collision_detector`, `monitor`',
    ELASTIC: '`tudor fit --models elastic`, and what uses that model',
    SIMULATE: '`tudor simulate`',
    RECORD: '`tudor record`, `arm_simulator`, `papers/`',
    DAMPER: '`oscillation_damper`, `joint_test`, `damper_sign_test`',
    REFERENCES: '`reference_generator`',
}
"""Letter in the tables to commands and nodes."""
ALL = 'MESRDG'
UNIT = re.compile(r'\[([^\[\]]+)\]\.?$')


@dataclass(frozen=True)
class Key:
    """
    One key of the description.

    Attributes
    ----------
    path : str
        Key with all parts that it stands in, ``[]`` for an entry of a list.
    values, default, unit, meaning : str
        What may stand there, and what it means.
    needed : bool
        Whether its part cannot be without it.
    part : str
        Name of the schema of what it holds, or none.
    readers : str
        Letters of the commands that read it: ``read_by`` of the key, else of its part.

    """

    path: str
    values: str
    default: str
    unit: str
    meaning: str
    needed: bool
    part: str
    readers: str


def _refs(schema: dict[str, Any]) -> Iterator[str]:
    """Find the parts that a schema holds, at any depth of lists and choices."""
    if '$ref' in schema:
        yield schema['$ref'].rpartition('/')[2]
    for inner in (*schema.get('anyOf', ()), *schema.get('allOf', ())):
        yield from _refs(inner)
    if isinstance(schema.get('items'), dict):
        yield from _refs(schema['items'])


def _values(schema: dict[str, Any]) -> str:
    """Say in words what may stand there."""
    if 'anyOf' in schema:
        return ', or '.join(_values(inner) for inner in schema['anyOf']
                            if inner.get('type') != 'null')
    if '$ref' in schema or 'allOf' in schema:
        return 'keys below'
    if 'enum' in schema:
        return ', '.join(f'`{value}`' for value in schema['enum'])
    kind = schema.get('type')
    if kind == 'array':
        if 'prefixItems' in schema:
            return f'[{len(schema["prefixItems"])} numbers]'
        inner = _values(schema['items'])
        return 'list of entries below' if inner == 'keys below' else f'list of {inner}'
    if kind == 'object':
        return f'joint: {_values(schema["additionalProperties"])}'
    if kind in ('number', 'integer'):
        bounds = [f'{sign} {schema[key]:g}' for key, sign in (
            ('exclusiveMinimum', '>'), ('minimum', '>='), ('exclusiveMaximum', '<'),
            ('maximum', '<=')) if key in schema and abs(schema[key]) < 1e9]
        return ' '.join([{'number': 'number', 'integer': 'whole number'}[kind], *bounds])
    return {'string': 'text', 'boolean': '`true`, `false`'}.get(str(kind), str(kind))


def _default(schema: dict[str, Any], needed: bool) -> str:
    if needed:
        return 'needed'
    value = schema.get('default')
    if isinstance(value, dict) and value:
        return 'as below'
    if value in (None, [], {}):
        return 'none'
    return f'`{json.dumps(value)}`'.replace('"', '')


def keys_of(name: str = 'ArmSpec', prefix: str = '', readers: str = ALL) -> Iterator[Key]:
    """
    Go through the keys of a part, and of the parts in it.

    Parameters
    ----------
    name : str
        Name of the part's schema.
    prefix : str
        Path of the part.
    readers : str
        Letters of the commands that read the part.

    Yields
    ------
    Key
        One by one, those of a part before those of the parts in it.

    """
    schema = ArmSpec.model_json_schema()
    part = schema if name == 'ArmSpec' else schema['$defs'][name]
    readers, inner = part.get('read_by', readers), []
    for key, content in part['properties'].items():
        found = next(_refs(content), '')
        text = ' '.join(content.get('description', '').split('\n\n')[0].split())
        unit = UNIT.search(text)
        path = prefix + key
        own = content.get('read_by', readers)
        yield Key(path, _values(content), _default(content, key in part.get('required', ())),
                  unit[1] if unit else '', UNIT.sub('', text).strip(' .'),
                  key in part.get('required', ()), found, own)
        if found:
            listed = '[]' if 'list of entries' in _values(content) else ''
            inner.append((found, f'{path}{listed}.', own))
    for part_of_it in inner:
        yield from keys_of(*part_of_it)


def tables() -> str:
    """Write a table of the friction terms, and one for each part."""
    schema = ArmSpec.model_json_schema()
    lines = ['## Terms of friction', '', '| friction term | column | use |', '|---|---|---|',
             *(f'| `{name}` | {TERMS[name].column} | {TERMS[name].use} |'
               for name in FRICTION_TERMS), '', '## Keys', '', '| letter | read by |', '|---|---|',
             *(f'| {letter} | {readers} |' for letter, readers in READERS.items())]
    keys = list(keys_of())
    names = {key.path: key.part for key in keys if key.part}
    place = None
    for key in keys:
        part = key.path.rpartition('.')[0]
        if part != place:
            place = part
            text = (schema if not part else schema['$defs'][names[part.removesuffix('[]')]]).get(
                'description', '')
            heading = f'### `{part}`' if part else '### Top level'
            summary = ' '.join(text.replace('``', '`').split('\n\n')[0].split())
            lines += ['', heading, '', summary, '',
                      '| key | meaning | values | default | unit | read by |',
                      '|---|---|---|---|---|---|']
        name = key.path.rpartition('.')[2]
        lines.append(f'| `{name}` | {key.meaning.replace("``", "`")} | {key.values} | '
                     f'{key.default} | {key.unit} | {key.readers} |')
    return '\n'.join(lines) + '\n'


def page() -> str:
    """Give the page as it should be."""
    kept, marker, _ = PAGE.read_text(encoding='utf-8').partition(MARKER)
    return kept + marker + '\n' + tables()


if __name__ == '__main__':
    PAGE.write_text(page(), encoding='utf-8')
