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

"""Pages of the reference that are written from the code: commands, nodes, exit codes, errors."""

from __future__ import annotations

import argparse
from pathlib import Path
import re
import sys

from tudor_dynamics import errors
from tudor_dynamics.cli.main import build_parser, SUBCOMMANDS
from tudor_dynamics.nodes.common.interfaces import NODES

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / 'tools'))

import nodes_reference  # noqa: E402, I100

SLASH = re.compile(r'(?<!`)\b(\w+_msgs/)(?=\w+(?:/\w+)*\b(?!`))')
"""Types break after the slash on a phone, outside code."""
EXIT_CODES = (
    ('0', 'done'), ('1', 'data or model are not good enough'),
    ('2', 'wrong input: one line on standard error, `tudor COMMAND: place: cause; remedy`'),
    ('70', 'a defect of tudor; `--debug FILE` keeps what a report needs'), ('130', 'interrupted'))


def _cell(text: str) -> str:
    """Give text as it may stand in a cell of a table."""
    return re.sub(r'\s+', ' ', text).replace('|', '\\|').strip()


def _rows(actions: list[argparse.Action], parser: argparse.ArgumentParser) -> list[str]:
    formatter = parser._get_formatter()
    rows = []
    for action in actions:
        if action.help == argparse.SUPPRESS or isinstance(action, argparse._HelpAction):
            continue
        values = '' if action.nargs == 0 else formatter._format_args(
            action, formatter._get_default_metavar_for_optional(action) if action.option_strings
            else formatter._get_default_metavar_for_positional(action))
        name = f'`{", ".join(action.option_strings)}` ' if action.option_strings else ''
        shown = f'`{_cell(values)}`' if values else ''
        text = _cell(formatter._expand_help(action)) if action.help else ''
        rows.append(f'| {name}{shown} | {text} |')
    return rows


def command(name: str) -> str:
    """Write the section of a subcommand: usage, arguments, examples."""
    whole = build_parser(name)
    choices = next(action.choices for action in whole._actions
                   if isinstance(action, argparse._SubParsersAction))
    assert isinstance(choices, dict)
    parser = choices[name]
    lines = [f'## tudor {name}', '', f'{parser.description}', '', '```text',
             parser.format_usage().strip(), '```', '']
    for group in parser._action_groups:
        rows = _rows(group._group_actions, parser)
        if rows:
            if group.title not in ('positional arguments', 'options'):
                lines += [f'**{group.title[0].upper()}{group.title[1:]}**', '']
            lines += ['| argument | what it does |', '|---|---|', *rows, '']
    epilog = (parser.epilog or '').strip()
    if epilog:
        lines += ['```text', epilog, '```', '']
    return '\n'.join(lines)


def commands() -> str:
    """Write the page of all subcommands."""
    head = ['# Commands', '', 'Written from the parsers of `tudor`.', '',
            '| exit code | meaning |', '|---|---|',
            *(f'| {code} | {text} |' for code, text in EXIT_CODES), '']
    return '\n'.join(head) + '\n' + '\n'.join(command(name) for name in SUBCOMMANDS)


def error_page() -> str:
    """Write the page of the classes of errors."""
    kinds = [kind for kind in vars(errors).values() if isinstance(kind, type)
             and issubclass(kind, (errors.TudorError, errors.TudorWarning))]
    lines = ['# Errors', '',
             'Every error that the package raises on purpose has the text `place: cause; remedy`, '
             'on one line. Programs read its attributes `place`, `cause` and `remedy`, never the '
             'text. Commands print it and end with exit code 2.', '',
             '| class | also a | what it is |', '|---|---|---|']
    for kind in kinds:
        bases = ', '.join(f'`{base.__name__}`' for base in kind.__bases__
                          if base is not errors.TudorError)
        text = (kind.__doc__ or '').strip().split('\n\n')[0]
        lines.append(f'| `{kind.__name__}` | {bases} | {_cell(text)} |')
    return '\n'.join(lines) + '\n'


def write(folder: Path) -> None:
    """Write the pages, and remove those of modules that have gone."""
    for page in folder.glob('tudor_dynamics.*.rst'):
        home = ROOT.joinpath(*page.stem.split('.'))
        if not (home.is_dir() or home.with_suffix('.py').exists()):
            page.unlink()
    (folder / 'nodes').mkdir(exist_ok=True)
    pages = {'commands': commands(), 'errors': error_page(),
             **{f'nodes/{name}': SLASH.sub(r'\1<wbr>', nodes_reference.page(name))
                for name in NODES}}
    for name, text in pages.items():
        file = folder / f'{name}.md'
        if not file.exists() or file.read_text(encoding='utf-8') != text:
            file.write_text(text, encoding='utf-8')
