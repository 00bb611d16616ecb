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
"""

from __future__ import annotations

from typing import Any

from docutils import nodes
from numpydoc import docscrape_sphinx
from sphinx.addnodes import toctree
from sphinx.domains.python import PythonDomain
from sphinx.search.en import SearchEnglish

make = docscrape_sphinx.SandboxedEnvironment
made: list[Any] = []
last: dict[str, Any] = {}  # parts of the names of objects
find = PythonDomain.find_obj


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


def leave_modules_out(app: Any, doctree: nodes.document) -> None:
    """Take the modules of the library out of the tree at the side."""
    if app.env.docname.startswith(('reference/library', 'reference/generated/tudor_dynamics')):
        for tree in list(doctree.findall(toctree)):
            tree.parent.remove(tree)


def setup(app: Any) -> dict[str, bool]:
    """Connect all of it."""
    docscrape_sphinx.SandboxedEnvironment = one_environment
    PythonDomain.find_obj = find_obj  # type: ignore[method-assign]
    app.add_search_language(Questions)
    app.connect('doctree-read', leave_modules_out, priority=100)
    return {'parallel_read_safe': True}
