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
Write the keys of what commands print with ``--json`` into ``docs/reference/json_keys.json``.

    python tools/json_keys.py

Each command is run on small inputs; the reference shows the keys with their types and an example.
``test/test_json_keys.py`` runs them again and compares. Names of the user in keys, such as those
of bags and joints, stand in capitals.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import contextlib
import io
import json
import os
from pathlib import Path
import re
import shlex
import shutil
import sys
import tempfile
from typing import Any

from tudor_dynamics.cli.main import main as tudor

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / 'tools'))

from golden_cases import BLADES, PUSHES, T1, T2, TEST, TUDOR, write_inputs  # noqa: E402, I100

FILE = ROOT / 'docs' / 'reference' / 'json_keys.json'
FIT = f'fit {T1}@0-40% {T2}@0-40% --arm {BLADES} --jobs 1 --exit-zero --overwrite'
COMMANDS = {
    'tudor info': [f'info {TEST} --arm {BLADES}', f'info {TEST}'],
    'tudor fit': [f'{FIT} --test {TEST}@0-50% --out model',
                  f'{FIT} --payload-of {T1}=0.2 {T2}=0.4 --out loads'],
    'tudor evaluate': [f'evaluate {TEST} --model model'],
    'tudor evaluate --collisions': [f'evaluate {PUSHES} --model model --collisions'],
    'tudor watch BAG': [f'watch {PUSHES} --model model --false-alarms 60'],
    'tudor why': [f'why {PUSHES} --model model'],
    'tudor compare': [f'compare model model {TEST}'],
    'tudor payload': [f'payload {T1}@0-20% --model loads'],
    'tudor record': [f'record --arm {TUDOR} --stimuli 1 --seconds 16 --pushes 1 --loads 1 '
                     '--jobs 1 --out bags_made'],
    'tudor simulate': ["simulate config/l_shape.yaml --seconds 0.1 --out moved --torque '0.6'",
                       'simulate config/l_shape.yaml --modes 2'],
    'tudor excite, plan.json': [f'excite {TUDOR} --floor 0 --steps 2 --seconds 10 --out plan'],
    'tudor tune': [f'tune {TUDOR} --payloads 0 --out schedule.yaml'],
    'tudor fleet, fleet.json': ['fleet inputs/fleet.yaml --jobs 1 --out fleet']}
"""Title of a section of the page, and commands that print all of its keys."""


def printed(commands: dict[str, list[str]]) -> Iterator[tuple[str, Any]]:
    """Run the commands in a folder of their own; give the title and what each prints."""
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            for name in ('bags', 'config'):
                shutil.copytree(ROOT / name, name)
            write_inputs(Path(folder) / 'inputs')
            for title, lines in commands.items():
                for line in lines:
                    with contextlib.redirect_stdout(io.StringIO()) as text:
                        code = tudor([*shlex.split(line), '--json', '--quiet'])
                    if code not in (0, 1):
                        sys.exit(f'exit code {code}: tudor {line}')
                    yield title, json.loads(text.getvalue())
        finally:
            os.chdir(before)


MEANING = {
    'path': 'of the bag',
    'storage': 'mcap or sqlite3',
    'files': 'of the bag',
    'size': 'of the bag [bytes]; of a finding: how much',
    'checksum': 'SHA-256 of the files',
    'start': 'first stamp [s since 1970]',
    'duration': '[s]',
    'name': 'of the topic, channel, parameter or plan',
    'type': 'of the messages',
    'count': 'messages',
    'clock': 'stamps of the header, or log times',
    'rate': '[Hz]',
    'jitter': 'deviation of the time between messages [s]',
    'gaps': 'how many',
    'longest_gap': '[s]',
    'duplicates': 'stamps that repeat',
    'backward': 'stamps that go back',
    'names': 'of joints or gauges in the messages',
    'fields': 'that the messages have',
    'field': 'of the message',
    'minimum': 'smallest value',
    'maximum': 'largest value',
    'not_finite': 'values that are NaN or infinite',
    'effort_model': 'whether the bag can teach one',
    'strain_model': 'whether the bag can teach one',
    'verdict': 'in a word',
    'samples': 'how many',
    'odd': 'what the user should know, a sentence each',
    'payload': 'load [kg]; null: not known',
    'findings': 'of the doctor',
    'kind': 'of the finding, or of the motion',
    'what': 'in a sentence',
    'remedy': 'what to do',
    'bag': 'that it is about',
    'channels': 'joints or gauges concerned',
    'time': 'since the start of the bag [s]',
    'model': 'folder of the model',
    'report': 'its file',
    'seconds': 'how long it took, or the motion or event lasts [s]',
    'read and filter': '[s]',
    'total': '[s]',
    'fit and validate': '[s]',
    'collision thresholds': '[s]',
    'save and report': '[s]',
    'chosen': 'what the fit chose',
    'instead': 'the next best',
    'error': 'of what was chosen [%]',
    'error_instead': 'of the next best [%]',
    'unused': 'bags that could not be used, with the cause',
    'use': 'what a model may be used for',
    'why': 'figure and limit that the verdict rests on',
    'marks': 'marks of coefficients',
    'without_thresholds': 'channels without thresholds, with the cause',
    'gain': 'how much it brings',
    'command': 'that does it; empty: none',
    'reasons': 'of the verdict',
    'method': 'of validation, or of detection',
    'rmse': 'root mean square error, in the unit of the channel',
    'sigma_e': 'standard deviation of the error',
    'fit': '[%]',
    'fit_printed': 'by the formula as printed in the paper [%]',
    'relative_error': 'error over the size of the signal',
    'moving_rmse': 'of moving joints',
    'standing_rmse': 'of joints at rest',
    'CHANNEL': 'value of a joint or gauge',
    'as_it_was': 'whether no channel is worse than in validation; null: unknown',
    'then': 'error in validation',
    'now': 'error here',
    'relative_then': 'the same over the signal',
    'relative_now': 'the same over the signal',
    'sigmas': 'how far they differ, in standard deviations',
    'changed': 'by more than chance',
    'bags': 'that were given',
    'false_alarms_allowed_per_hour': 'rate that was asked for',
    'events': 'detected',
    'pushes': 'recorded as truth',
    'found': 'pushes that were detected',
    'detection_rate': 'found over pushes',
    'latency_median': '[s]',
    'latency_p95': '[s]',
    'false_alarms': 'events without a push',
    'hours': 'of free motion',
    'false_alarms_per_hour': 'measured',
    'unjudged': 'share of the samples',
    'promised': 'false alarms in these hours',
    'ratio': 'signal over threshold; of `kept`: measured over promised',
    'low': 'bound of this ratio',
    'high': 'bound of this ratio',
    'BAG': 'value for each bag',
    'stamp': 'when it was certain [ns]',
    'onset': 'when it began [ns]',
    'time_of_day': 'of the onset',
    'link': 'that was touched',
    'channel': 'joint or gauge',
    'push': 'number of the push that caused it; null: none',
    'contact': 'force and place; null: not known',
    'note': 'why force and place are not known',
    'roc': 'multiple of the thresholds, false events per hour, share of the pushes found',
    'cause': 'of the alarm',
    'evidence': 'for the cause; empty: unexplained',
    'same': 'number of the event that it belongs to',
    'one': 'first model, its value by channel',
    'other': 'second model, its value by channel',
    'joint': 'name',
    'mass': '[kg]; of two models one each',
    'centres_apart': 'distance of the centres [m]',
    'inertia': '[kg m^2]; of two models one each',
    'mass_std': 'standard deviation [kg]',
    'known': 'part of it that the model knows of [kg]',
    'com': 'centre of mass [m]; null: not shown',
    'com_std': '[m]',
    'inertia_std': '[kg m^2]',
    'frame': 'of centre and inertia',
    'at_tip': 'whether it is taken to be there',
    'scale': 'what kilograms come from',
    'scale_std': 'its relative error',
    'relative': 'moment of the load over that of the arm itself',
    'relative_std': 'its standard deviation',
    'std': '[kg]',
    'before': 'residual without the load',
    'after': 'residual with it',
    'bent_links': 'whether links were taken as bent',
    'share': 'of the squares that the load explains, 0 to 1',
    'out': 'what was written',
    'distance': 'of the push from the joint [m]',
    'force': '[N]',
    'rise': 'of the push [s]',
    'damping': 'time at work [s]',
    'starting': 'time to start [s]',
    'saturated': 'time at a limit [s]',
    'notes': 'what to know of a run',
    'arm': 'name',
    'tip_end': 'position of the tip at the end [m]',
    'energy_start': '[J]',
    'energy_end': '[J]',
    'largest_rotation': 'of a beam [rad]',
    'free_joints': 'joints that were free',
    'frequency_hz': 'of each mode',
    'damping_ratio': 'of each mode, or smallest and largest',
    'search_seconds': 'time of the search [s]',
    'format': 'of the file',
    'version': 'of the format',
    'digest': 'of the arm',
    'highest': 'largest frequency of the motion [Hz]',
    'seed': 'of the search',
    'steps': 'of the search',
    'complete': 'false: the search was cut short',
    'self_collision_pairs': 'pairs of links that were checked',
    'hidden': 'directions in which moves do not push a tool',
    'gain_over_random': 'of the errors, against random motion',
    'noise_of': 'what the noise is of',
    'noise_stated': 'whether anybody stated it',
    'output': 'effort or strain',
    'column': 'of the regression',
    'unit': 'of the value',
    'standard_error': 'of the value',
    'schedule': 'file',
    'picture': 'file',
    'asked': 'damping ratio',
    'nodes': 'points of the grid',
    'missed': 'points that reach less than was asked',
    'frequency': 'smallest and largest [Hz]',
    'position_gain': 'smallest and largest [1/s]',
    'damping_ratio_fixed_gains': 'with the gains of the description',
    'full_delay': 'delay up to which gains are whole [s]',
    'arms': 'of the plan',
    'ARM': 'folder of its model',
    'named': 'arms that stand apart from the others',
    'date': 'of the recording',
    'quantity': 'that was compared',
    'value': 'of the quantity',
    'choices': 'of the fit, in words'}
"""What the last part of a key means."""
NAMED = ((r'effort|strain|momentum', 'OUTPUT'), (r'analytical|elm|elastic', 'KIND'),
         (r'joint\d|link\d_\w+|motor|corner', 'CHANNEL'), (r'bags/\S+', 'BAG'),
         (r'cell_\d', 'ARM'), (r'validation|training', 'PART'))
"""Keys that are names, and what stands for them."""


def found(content: Any, path: str = '') -> Iterator[tuple[str, str, str]]:
    """Give path, type and an example of each value."""
    if isinstance(content, dict):
        for name, value in content.items():
            for pattern, word in NAMED:
                if re.fullmatch(pattern, name) and path != 'bags':
                    name = word
            yield from found(value, f'{path}.{name}' if path else name)
    elif isinstance(content, list) and any(isinstance(item, (dict, list)) for item in content):
        for item in content:
            yield from found(item, f'{path}[]')
    elif isinstance(content, list):
        kinds = {kind for item in content for _, kind, _ in found(item) if kind != 'null'}
        yield path, f'list of {" or ".join(sorted(kinds))}' if kinds else 'list', (
            next((example for item in content for _, kind, example in found(item)
                  if kind != 'null'), ''))
    elif isinstance(content, bool):
        yield path, 'true or false', str(content).lower()
    elif isinstance(content, (int, float)):
        yield path, 'number', f'{content:.4g}' if isinstance(content, float) else str(content)
    else:
        yield path, 'null' if content is None else 'text', str(content or '')[:40]


def keys_of(contents: Iterator[tuple[str, Any]]) -> dict[str, dict[str, tuple[str, str]]]:
    """Give by title the paths, each with its type and an example."""
    sections: dict[str, dict[str, tuple[str, str]]] = {}
    for title, content in contents:
        section = sections.setdefault(title, {})
        for path, kind, example in found(content):
            path = re.sub(r'(?<=^bags\.)[^.]*bags/[^.]+', 'BAG', path)
            old = section.get(path, (kind, example))
            better = kind if old[0] in ('null', 'list') else old[0]
            section[path] = (better, old[1] or example)
    return sections


def main() -> None:
    """Write the file."""
    argparse.ArgumentParser(description=__doc__.strip().splitlines()[0]).parse_args()
    sections = keys_of(printed(COMMANDS))
    FILE.write_text('{' + ',\n '.join(
        f'{json.dumps(title)}: {{\n  ' + ',\n  '.join(
            f'{json.dumps(path)}: {json.dumps(list(row))}' for path, row in keys.items()) + '}'
        for title, keys in sections.items()) + '}\n', encoding='utf-8')


if __name__ == '__main__':
    main()
