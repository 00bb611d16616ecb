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
Search that understands questions, and a build that does nothing twice.

Three things made up half of the build: numpydoc compiles its template for each object again, the
Python domain looks through all names for each type that it does not have, and the theme writes
the tree of all pages at the side of each. The modules of the library are therefore not in that
tree; ``reference/library`` leads to them.

Signatures name the types of NumPy as the code does, and leave out what Pydantic checks. Numbers
and their units stay in one line.
"""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from figure_data import UNIT
from numpydoc import docscrape_sphinx
from sphinx.addnodes import toctree
from sphinx.domains.python import PyObject, PythonDomain
from sphinx.search.en import SearchEnglish

make = docscrape_sphinx.SandboxedEnvironment
made: list[Any] = []
last: dict[str, Any] = {}  # parts of the names of objects
find = PythonDomain.find_obj
handle = PyObject.handle_signature
PLACE = r'~?(?:\w+\.)*'  # before the name of a type
ARRAY = re.compile(rf'{PLACE}ndarray\[tuple\[{PLACE}Any, \.\.\.\], '
                   rf'{PLACE}dtype\[{PLACE}(\w+)\]\]')
LIKE = re.compile(rf'{PLACE}_?Buffer \| .*?_NestedSequence\[complex \| bytes \| str\]')
MADE = re.compile(r'= <[^,()=]*>(?=[,)])')  # a default that has no text
LONG = re.compile(r'(array\(\[[^],]*),[^]]{60,}\]')
VARIABLE = re.compile(r'~(?:typing\.~)?([A-Z])\b')  # of a generic function
MOST = 300  # characters of a value that are shown
CHECKED = re.compile(rf'{PLACE}Annotated\[')


class Questions(SearchEnglish):
    """English in which words of questions do not have to be on a page."""

    stopwords = SearchEnglish.stopwords | {
        'can', 'get', 'got', 'happen', 'happens', 'know', 'many', 'much', 'mean', 'means', 'need',
        'say', 'says', 'want'}


def one_environment(loader: Any) -> Any:
    """Give numpydoc the environment that it made first, which has compiled the template."""
    if not made:
        made.append(make(loader=loader))
    return made[0]


def find_obj(self: PythonDomain, env: Any, modname: str, classname: str, name: str,
             kind: str | None, searchmode: int = 0) -> list[Any]:
    """Find a name as the domain does; what no name ends with needs no search."""
    if last.get('count') != len(self.objects):
        last.update(count=len(self.objects),
                    names={item.rpartition('.')[2] for item in self.objects})
    if searchmode == 1 and name.removesuffix('()').rpartition('.')[2] not in last['names']:
        return []
    return find(self, env, modname, classname, name, kind, searchmode)


def first_of(text: str, start: int) -> tuple[str, int]:
    """Give the first of what stands in brackets from a place on, and where they end."""
    depth, first = 1, 0
    for place in range(start, len(text)):
        depth += (text[place] in '[({') - (text[place] in '])}')
        if not first and (depth == 0 or (depth == 1 and text[place] == ',')):
            first = place
        if depth == 0:
            return text[start:first], place + 1
    return text[start:], len(text)


def short(text: str) -> str:
    """Write types of a signature as the code does: NDArray, ArrayLike, and what is annotated."""
    text = MADE.sub('= ...', text)
    text = ARRAY.sub(lambda m: 'NDArray' if m[1][0] == '_' else f'NDArray[{m[1]}]', text)
    text = VARIABLE.sub(r'\1', LONG.sub(r'\1, ...]', LIKE.sub('ArrayLike', text)))
    while match := CHECKED.search(text):
        inner, end = first_of(text, match.end())
        text = text[:match.start()] + inner + text[end:]
    return text


def handle_signature(self: PyObject[Any], sig: str, signode: Any) -> tuple[str, str]:
    """Read a signature as the domain does, with short types."""
    if 'type' in self.options:
        self.options['type'] = short(self.options['type'])
    value = self.options.get('value', '')
    if len(value) > MOST:
        self.options['value'] = f'{value[:value.rfind(",", 0, MOST)]}, ...'
    return handle(self, short(sig), signode)


def keep_units(app: Any, doctree: nodes.document) -> None:
    """Keep numbers and their units in one line."""
    for text in list(doctree.findall(nodes.Text)):
        if not isinstance(text.parent, (nodes.literal, nodes.FixedTextElement, nodes.math)):
            kept = UNIT.sub('\u00a0', text)
            if kept != text:
                text.parent.replace(text, nodes.Text(kept))


def leave_modules_out(app: Any, doctree: nodes.document) -> None:
    """Take the modules of the library out of the tree at the side."""
    if app.env.docname.startswith(('reference/library', 'reference/generated/tudor_dynamics')):
        for tree in list(doctree.findall(toctree)):
            tree.parent.remove(tree)


def setup(app: Any) -> dict[str, Any]:
    """Connect all of it."""
    docscrape_sphinx.SandboxedEnvironment = one_environment
    PythonDomain.find_obj = find_obj  # type: ignore[method-assign]
    PyObject.handle_signature = handle_signature  # type: ignore[method-assign]
    app.add_search_language(Questions)
    app.connect('doctree-read', keep_units)
    app.connect('doctree-read', leave_modules_out, priority=100)
    return {'parallel_read_safe': True, 'env_version': 1}
