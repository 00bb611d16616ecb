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

"""YAML that stands for more than it says."""

from __future__ import annotations

from hypothesis import given, settings, strategies as st
import pytest
from tudor_dynamics.files import load_yaml, MAX_VALUES
import yaml


def bomb(item: str, levels: int = 9) -> str:
    """Let each line stand for nine times what the line before stands for."""
    lines = [f'a0: &a0 {item}']
    for level in range(levels):
        references = ', '.join([f'*a{level}'] * 9)
        lines.append(f'a{level + 1}: &a{level + 1} '
                     + (f'{{<<: [{references}]}}' if ':' in item else f'[{references}]'))
    return '\n'.join(lines)


@pytest.mark.parametrize(('text', 'cause'), [
    (bomb('[1]'), 'more than 300000 values'),
    (bomb('{x: 1}'), 'more than 300000 values'),
    ('- 1\n' * (MAX_VALUES + 1), 'more than 300000 values'),
    ('[' * 900, 'more than 50 levels'),
    ('[' * 100_000, 'more than 50 levels|maximum nesting depth'),  # of libyaml, if newer
    ('- ' * 100_000, 'more than 50 levels'),
    ('a: ' + '1:' * 500_000 + '1', 'in line 1 .a number of more than 400 characters'),
    ('a: ' + '9' * 500_000, 'a number of more than 400 characters'),
    ('{' + ', '.join(f'{i * (2**61 - 1)}: 1' for i in range(80_000)) + '}', '1000 integers of'),
    ('&a [*a]', 'has no anchor before it, or is inside it'),
    ('*a', 'has no anchor'),
    ('a: [1, }', 'in line 1'),
    ('? [1]\n: 2', 'unhashable'),
    ('!!python/object/apply:os.system [echo]', 'could not determine a constructor'),
    ('2020-99-99', 'month must be'),
    ('a: \x00', 'no valid YAML'),
    (b'\xff\xfe\x00', 'no valid YAML')])
def test_refused(text: str | bytes, cause: str) -> None:
    """Each is a ValueError of one line, in little time."""
    with pytest.raises(ValueError, match=cause) as caught:
        load_yaml(text)
    assert '\n' not in str(caught.value) and len(str(caught.value)) < 300


def test_references_are_read() -> None:
    """A description may name a part once and use it again, and merge mappings."""
    assert load_yaml('a: &a {x: 1}\nb: [*a, *a]\nc: {<<: *a, y: 2}') == {
        'a': {'x': 1}, 'b': [{'x': 1}, {'x': 1}], 'c': {'x': 1, 'y': 2}}


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False)
    | st.text(st.characters(codec='utf-8', exclude_categories=('Cc', 'Cs'))),
    lambda part: st.lists(part, max_size=4) | st.dictionaries(st.text('abc', max_size=3), part,
                                                              max_size=4))


@settings(deadline=None)
@given(VALUES)
def test_what_was_written_comes_back(value: object) -> None:
    """Plain values survive, as with the loader that has no bounds."""
    text = yaml.safe_dump(value, allow_unicode=True)
    assert load_yaml(text) == yaml.safe_load(text)
