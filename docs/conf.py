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

"""Sphinx: guides, reference and library as one site; ``make docs`` builds it."""

from pathlib import Path
import sys
from types import GenericAlias
from typing import Any

import tudor_dynamics

sys.path.insert(0, str(Path(__file__).parent / '_extensions'))

import code_pages  # noqa: E402, I100

project = 'tudor_dynamics'
author = 'tudor_dynamics contributors'
copyright = '2026, tudor_dynamics contributors'  # noqa: A001
release = tudor_dynamics.__version__
# MathJax comes from disk, by a package that ships it: the pages are read without a network.
extensions = ['sphinx.ext.autodoc', 'sphinx.ext.autosummary', 'sphinx.ext.mathjax', 'numpydoc',
              'myst_parser', 'sphinx-mathjax-offline', 'figure_data',
              'site_build', 'sphinx_copybutton']
templates_path = ['_templates']
exclude_patterns = ['_templates', 'reference/generated/library.txt', 'reference/generated/nodes']
html_theme = 'furo'
html_title = f'tudor_dynamics {release}'
html_copy_source = False
html_split_index = True  # on one page it is as long as four hundred screens of a phone
html_static_path = ['_static']
html_css_files = ['site.css']
html_js_files = ['full_size.js', 'break_names.js', 'wide_tables.js']
html_favicon = '_static/favicon.svg'
html_search_scorer = str(Path(__file__).parent / '_extensions' / 'search_order.js')

myst_enable_extensions = ['dollarmath', 'amsmath', 'deflist']
myst_heading_anchors = 4
# Blocks without a language are equations and output.
highlight_language = 'text'

autosummary_generate = True
# The tree of pages at the side is made for each page again: with every member in it that takes a
# third of the build.
toc_object_entries = False
autodoc_typehints = 'signature'
autodoc_member_order = 'bysource'
autodoc_default_options = {'members': True, 'show-inheritance': True}
# One page a module: its members are documented there, not on pages of their own.
numpydoc_show_class_members = False
default_role = 'code'
smartquotes = False  # options have two hyphens in text, too

# The names of the library, each with a link to where it is defined.
library = Path(__file__).parent / 'reference' / 'generated' / 'library.txt'
library.parent.mkdir(exist_ok=True)
sources = Path(tudor_dynamics.__file__).parents[1]
for page in [*library.parent.glob('tudor_dynamics*.rst')]:
    module = sources / page.stem.replace('.', '/')
    if not module.is_dir() and not module.with_suffix('.py').is_file():
        # otherwise a build in an old checkout ends with a warning, as the page of its package does
        page.unlink(missing_ok=True)
        page.with_name(f'{page.stem.rpartition(".")[0]}.rst').unlink(missing_ok=True)
library.write_text('.. autosummary::\n   :nosignatures:\n\n' + ''.join(
    f'   ~{getattr(tudor_dynamics, name).__module__}.{name}\n' for name in tudor_dynamics.__all__))

code_pages.write(library.parent)


def skip_alias(_: Any, what: str, name: str, item: object, skip: bool, options: Any) -> bool:
    """Leave out aliases of types, which are taken for classes, and what Pydantic itself says."""
    return skip or isinstance(item, GenericAlias) or name == 'model_config'


def leave_numbers_out(
        _: Any, what: str, name: str, item: object, options: Any, lines: list[str]) -> None:
    """Leave out what Python says of the fields of a named tuple."""
    if any(line.strip().startswith('Alias for field number') for line in lines):
        lines.clear()


def setup(app: Any) -> None:
    """Connect what is above."""
    app.connect('autodoc-process-docstring', leave_numbers_out)
    app.connect('autodoc-skip-member', skip_alias)
    # It copies files when all is done, and does not say that several readers may run beside.
    app.extensions['sphinx-mathjax-offline'].parallel_read_safe = True
