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
import ast
import inspect
import json
from pathlib import Path
import re
import sys
import textwrap

from tudor_dynamics import errors
from tudor_dynamics.cli.main import build_parser, SUBCOMMANDS
from tudor_dynamics.control import schedule
from tudor_dynamics.fleet import study
from tudor_dynamics.identification import excitation_plan
from tudor_dynamics.models import bundle
from tudor_dynamics.models.analytical import AnalyticalPart
from tudor_dynamics.models.elastic.model import ElasticPart
from tudor_dynamics.models.elm import ElmPart
from tudor_dynamics.nodes.common.interfaces import NODES
from tudor_dynamics.online.threshold_learning import ThresholdsPart

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / 'tools'))

from json_keys import FILE as JSON_KEYS, MEANING  # noqa: E402, I100
from messages import messages  # noqa: E402, I100
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


FORMATS: tuple[tuple[str, str, tuple[type, ...]], ...] = (
    ('Model: a folder of `tudor fit`', '`model.yaml` has the keys below and ends with its '
     'checksum; `files` names the others with theirs: `arm.yaml`, the description with all that '
     'it names; `elm.npz`, weights of an ELM; `data.npz`, sums over the training bags, for '
     '`tudor export`. `report.html` is for people. A file that was changed is refused.',
     (bundle.HeadPart, bundle.ModelsPart, bundle.ArmPart, AnalyticalPart, ElasticPart,
      ElmPart, ThresholdsPart)),
    ('Plan: a folder of `tudor excite`', '`trajectory.csv` and `bag` hold the motion, '
     '`motion.png` shows it, `plan.json` says what was asked for and what it will show. '
     '`tudor fit --plan` reads:', (excitation_plan._Head,)),
    ('Schedule: `tudor tune`', 'YAML, read by `oscillation_damper` and `reference_generator`; '
     '`nodes` has a row for each payload and pose, `columns` names its values.',
     (schedule.ScheduleFile,)),
    ('Plan of a fleet', 'YAML, written by hand for `tudor fleet`.',
     (study.FleetPlan, study.FleetArm)),
    ('Bag of an event', 'A rosbag2 (MCAP) of the last 30 s with all that the monitor heard. Its '
     '`custom_data` has the key `tudor_events`: JSON, a list with a record for each event, as the '
     'topic `collision_record` publishes it: `onset` and `stamp` [ns], `time`, `method`, `link`, '
     '`channel`; by channel `measured`, `expected`, `residual`, `threshold`, `ratio`; `motion` '
     '(q, dq, ddq of the active joints); `last_second`, of `channel`, at most 50 rows of seconds '
     'from `stamp` on, measured, expected, threshold, ratio; `sensors`, by joint or gauge ok, '
     'stuck or silent; `load`, its `mass` and `std` [kg], null where nobody estimates it, and '
     '`source` (parameter, estimate, topic, model); `apart`, by topic how much later its newest '
     'stamp is than that of the joint states [s]; `state`, the diagnostics with `message`; '
     '`settings`, the parameters; `digest` of the model; `made`, versions. The key `tudor_states` '
     'has, by part (model, load, observer, method), its `state` at two `stamp`s before the first '
     'event, and `thresholds`, those of `~/calibrate`. '
     'The topic `tudor_asked` has, in order: the load that was heard [kg], and 1 where another '
     'load was announced, or the monitor was reset. `tudor why` reads it.', ()),
    ('Recordings', 'rosbag2, MCAP or SQLite, of the topics that the arm description names. '
     '`tudor record` adds `/applied_wrench` or `/applied_payload` (the truth), `payload` [kg] in '
     '`custom_data`, and `campaign.yaml`: arm, digest, seed and what was asked for, and for each '
     'bag its pushes and loads.', ()),
    ('Tables', 'CSV with a head. Trajectories: [trajectories](../trajectories.md). Pushes, for '
     '`tudor evaluate --pushes`: `begin,end[,tolerance]` [s] since the beginning of the bag. '
     'Motion and torque of `tudor simulate`: `t`, then a column for each joint.', ()),
    ('Arrays', 'NPZ without pickle. `run.npz` of `tudor simulate`: time, joints, motors, tip, '
     'strain, energy, with names of joints, gauges and beams. `tudor evaluate --save`: for each '
     'output and model `OUTPUT_KIND_stamp`, `_measured`, `_predicted`, `_residual`, `_bag`, and '
     '`OUTPUT_channels`.', ()))


def _keys(kind: type) -> list[str]:
    """Write the keys of a part of a file: type, default, and what the code says of it."""
    text = textwrap.dedent(inspect.getsource(kind))
    lines, body = text.splitlines(), ast.parse(text).body[0].body  # type: ignore[attr-defined]
    rows = []
    for item, after in zip(body, [*body[1:], None], strict=True):
        if not isinstance(item, ast.AnnAssign) or ast.unparse(item.target) == 'model_config':
            continue
        said = re.search(r'  # (?!noqa)(.+)$', lines[(item.end_lineno or item.lineno) - 1])
        above = lines[item.lineno - 2].strip()
        meaning = said[1] if said else above[2:] if above.startswith('# ') else ''
        if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            meaning = str(after.value.value)
        name = 'format' if ast.unparse(item.target) == 'kind' else ast.unparse(item.target)
        meaning = meaning or {'format': 'name of the format', 'version': 'of the format'}[name]
        value = '' if item.value is None else ast.unparse(item.value)
        default = f'`{value}`' if value and not value.startswith('Field(') else ''
        shape = re.sub(r'^Annotated\[(.+), Field\(.*\)\]$', r'\1', ast.unparse(item.annotation))
        rows.append(f'| `{name}` | {_cell(meaning)} | `{_cell(shape)}` | {_cell(default)} |')
    return ['', f'`{kind.__name__.strip("_")}`: {(kind.__doc__ or "").strip()}', '',
            '| key | meaning | type | default |', '|---|---|---|---|', *rows]


def formats() -> str:
    """Write the page of all files that the package writes and reads."""
    lines = ['# File formats', '', 'Written from the code that reads them. Reads are bounded, '
             'nothing is unpickled, and files are written whole or not at all.', '',
             'The description of an arm: [arm description](../arm_yaml.md).']
    for title, text, kinds in FORMATS:
        lines += ['', f'## {title}', '', text, *(line for kind in kinds for line in _keys(kind))]
    return '\n'.join(lines) + '\n'


def error_page() -> str:
    """Write the page of the classes of errors."""
    kinds = [kind for kind in vars(errors).values() if isinstance(kind, type)
             and issubclass(kind, (errors.TudorError, errors.TudorWarning))]
    lines = ['# Errors', '',
             'Every error that the package raises on purpose has the text `place: cause; remedy`, '
             'on one line. Programs read its attributes `place`, `cause` and `remedy`, never the '
             'text. Commands print it and end with exit code 2. All texts: '
             '[messages](messages.md).', '',
             '| class | also a | what it is |', '|---|---|---|']
    for kind in kinds:
        bases = ', '.join(f'`{base.__name__}`' for base in kind.__bases__
                          if base is not errors.TudorError)
        text = (kind.__doc__ or '').strip().split('\n\n')[0]
        lines.append(f'| `{kind.__name__}` | {bases} | {_cell(text)} |')
    return '\n'.join(lines) + '\n'


KINDS = ('error', 'warning', 'log', 'diagnostic', 'finding')
"""Kinds of messages that people look up; of others, help and reports, commands have pages."""
ROOMS = {'arm': 'Arm description', 'bags': 'Bags', 'cli': 'Commands', 'control': 'Damper, '
         'references and other control', 'fleet': 'Fleet', 'identification': 'Fit and doctor',
         'library': 'Library and files', 'load': 'Load', 'mechanics': 'Simulation',
         'models': 'Models', 'nodes': 'Nodes', 'online': 'Monitor', 'show': 'Reports and pictures',
         'signals': 'Filters and shaping'}
"""Parts of the code, as the page of messages calls them."""
NO_NAME = re.compile(r"'[^']*'|!r|\[[^][]*\]")
WORDS = ('self', 'args', 'join', 'str', 'format', 'map', 'repr', 'or', 'and', 'for', 'in', 'if',
         'else', 'not', 'sorted', 'set', 'x', 'rstrip', 'lower', 'partition', 'replace', 'strip')


def placeholder(text: str) -> str:
    """Give a name in capitals for an expression, as ARM for ``arm.source``; numbers stay."""
    if re.fullmatch(r'[-\d.]+', text):
        return text
    if text.startswith('len('):
        return 'NUMBER'
    names = [word for word in re.findall(r'[^\W\d]\w*', NO_NAME.sub(' ', text))
             if word not in WORDS] or ['text']
    if names[-1] in ('name', 'source', 'path') and len(names) > 1:
        names.pop()
    return names[-1].strip('_').upper()


def in_capitals(text: str) -> str:
    """Give a message as people may look for it: what differs is a NAME, choices have a slash."""
    def inner(match: re.Match[str]) -> str:
        first, bar, second = match[1].partition('|')
        return (f'({first.strip()} / {second.strip()})' if first and second else first or second
                ) if bar else placeholder(match[1])
    while (shorter := re.sub(r'\{([^{}]*)\}', inner, text)) != text:
        text = shorter
    return text


def message_page() -> str:
    """Write the page of the texts of errors, diagnostics and findings, by part of the code."""
    rooms: dict[str, dict[tuple[str, str], None]] = {room: {} for room in ROOMS}
    for message in messages():
        if message.kind in KINDS:
            room, inside, _ = message.place.partition('/')
            rooms[room if inside else 'library'][message.kind, in_capitals(message.text)] = None
    lines = ['# Messages', '',
             'Texts of errors, diagnostics and findings, written from the code: look for the '
             'words of a message that you see. A word in capitals stands for what the message '
             'names there, a slash for a choice. What follows the semicolon is what to do. '
             'Classes of errors: [errors](errors.md).']
    for room, found in rooms.items():
        lines += ['', f'## {ROOMS[room]}', '', '| kind | text |', '|---|---|',
                  *(f'| {kind} | {_plain(text)} |' for kind, text in found)]
    return '\n'.join(lines) + '\n'


def json_page() -> str:
    """Write the page of the keys that commands print with ``--json``, and of their files."""
    lines = ['# Keys of JSON', '',
             'What commands print with `--json`, as runs on the recordings in `bags/` gave it. '
             '`[]` is an item of a list. Words in capitals stand for a name: OUTPUT is effort, '
             'strain or momentum, KIND a kind of model, CHANNEL a joint or gauge, PART training '
             'or validation. Values that are not finite are null. Keys do not change without a '
             'line in the change log. `tudor doctor --json` has `made` (versions) and `checks[]`.']
    for title, keys in json.loads(JSON_KEYS.read_text(encoding='utf-8')).items():
        lines += ['', f'## {title}', '', '| key | meaning | type | example |', '|---|---|---|---|']
        for path, (kind, example) in keys.items():
            meaning = MEANING[path.rpartition('.')[2].removesuffix('[]')]
            shown = f'`{_cell(example)}`' if example else ''
            lines.append(f'| `{path}` | {_cell(meaning)} | {kind} | {shown} |')
    return '\n'.join(lines) + '\n'


def _plain(text: str) -> str:
    """Give a message as it may stand in a cell: no mark in it is markup, but for code."""
    parts = _cell(text).split('`')
    closed = len(parts) % 2 == 1  # of an odd number of marks, none is one of code
    return ('`' if closed else '\\`').join(
        part if closed and place % 2 else re.sub(r'([*_<>~$\[\]])', r'\\\1', part)
        for place, part in enumerate(parts))


def write(folder: Path) -> None:
    """Write the pages, and remove those of modules that have gone."""
    for page in folder.glob('tudor_dynamics.*.rst'):
        home = ROOT.joinpath(*page.stem.split('.'))
        if not (home.is_dir() or home.with_suffix('.py').exists()):
            page.unlink()
    (folder / 'nodes').mkdir(exist_ok=True)
    pages = {'commands': commands(), 'errors': error_page(), 'formats': formats(),
             'messages': message_page(), 'json': json_page(),
             **{f'nodes/{name}': SLASH.sub(r'\1<wbr>', nodes_reference.page(name))
                for name in NODES}}
    for name, text in pages.items():
        file = folder / f'{name}.md'
        if not file.exists() or file.read_text(encoding='utf-8') != text:
            file.write_text(text, encoding='utf-8')
