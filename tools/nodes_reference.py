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
Write the tables of parameters of ``docs/reference/nodes.md`` from what the nodes declare.

    python tools/nodes_reference.py

Everything else on the page is kept.
"""

from __future__ import annotations

from pathlib import Path
import re

from tudor_dynamics.nodes.common.interfaces import NODES, Param

PAGE = Path(__file__).resolve().parents[1] / 'docs' / 'reference' / 'nodes.md'
HEAD = ('| name | default | unit | range | while running | what it does |\n'
        '|---|---|---|---|---|---|\n')


def _default(param: Param) -> str:
    value = param.default
    if isinstance(value, tuple):
        return str(list(value))
    return str(value).lower() if isinstance(value, bool) else str(value) or "''"


def row(param: Param) -> str:
    """Write the row of a parameter."""
    bounds = '' if param.low is None else f'{param.low:g} .. {param.high:g}'
    choices = f'; one of {", ".join(param.choices)}' if param.choices else ''
    return (f'| `{param.name}` | `{_default(param)}` | {param.unit} | {bounds} | '
            f'{"yes" if param.dynamic else "no"} | {param.text}{choices} |\n')


def page() -> str:
    """Give the page as it should be."""
    text = PAGE.read_text(encoding='utf-8')
    for name, params in NODES.items():
        table = HEAD + ''.join(row(param) for param in params)
        pattern = (rf'(^## {name}\n(?:(?!^## ).*\n)*?^### Parameters\n\n)(?:\|.*\n)*')
        text, found = re.subn(pattern, lambda match, new=table: match[1] + new, text,
                              flags=re.MULTILINE)
        assert found == 1, name
    return text


if __name__ == '__main__':
    PAGE.write_text(page(), encoding='utf-8')
