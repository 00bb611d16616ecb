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

"""``tudor init``: the first description of an arm, from what its bags show."""

from __future__ import annotations

import argparse
from pathlib import Path
import shlex
import sys

from tudor_dynamics.arm.description import arm_from_dict, OPEN, spelled
from tudor_dynamics.cli.console import add_out, say, say_command
from tudor_dynamics.errors import printable
from tudor_dynamics.files import check_target, other_name, write_whole
from tudor_dynamics.identification.drafting.draft import (
    answer, Draft, draft_of, question_of, text_of)

EXAMPLES = """\
examples:
  tudor init run1 run2 --urdf robot.urdf --out arm.yaml
        joints and masses of the URDF; topics, units and gauges as the bags show them
  tudor init run1 --dh rows.txt --out arm.yaml
        one row `a alpha d theta` a joint, base first [m, rad, m, rad]; the name of the joint may
        stand before it, `prismatic` after it, and pi/2 for an angle; or YAML with dh: [[...]]
  tudor fit run1 run2 --arm arm.yaml --out model
        goes on with it

What the bags do not show is '?' in the file, and asked for on a terminal (an empty answer leaves
it). Nothing reads the file before each '?' is replaced.
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``tudor init``."""
    parser.add_argument('bags', nargs='+', metavar='BAG', help='bag directory or file of the arm')
    source = parser.add_mutually_exclusive_group()
    source.add_argument('--urdf', metavar='FILE', help='its URDF; run xacro first where it is one')
    source.add_argument('--dh', metavar='FILE', help='table of its D-H rows')
    add_out(parser, 'ARM.yaml', 'description to write')


def run(args: argparse.Namespace) -> int:
    """Look at the bags, ask where somebody can answer, write the file and say what is in it."""
    out = check_target(args.out, overwrite=args.overwrite)
    draft = draft_of(args.bags, urdf=None if args.urdf is None else Path(args.urdf),
                     dh=None if args.dh is None else Path(args.dh), out=out)
    if sys.stdin.isatty() and sys.stdout.isatty():
        _ask(draft)
    if not draft.unknown:
        arm_from_dict(draft.content, base=out.parent, source=str(out))  # says what is wrong
    write_whole(out, text_of(draft).encode())
    content = draft.content
    active = content.get('active_joints', [joint['name'] for joint in content['joints']])
    efforts = sorted({f'[{joint["effort"]["unit"]}] on {joint["effort"]["topic"]}'
                      for joint in content['joints'] if 'topic' in joint.get('effort', ())})
    gauges = [gauge['name'] for gauge in content.get('gauges', ())]
    say(f'{out}: {len(active)} of {len(content["joints"])} joints move; efforts '
        f'{", ".join(efforts) or "none"}; gauges {", ".join(gauges) or "none"}')
    if 'unit' in draft.remarks:
        say(f'unit of the efforts: {draft.remarks["unit"]}')
    for note in draft.notes:
        say(note)
    left = [spelled(content, path) for path in draft.unknown]
    if left:
        say(f"left as '?', write them in: {', '.join(left)}")
    else:
        model = Path('model')
        words = ['tudor', 'fit', *args.bags, '--arm', str(out), '--out',
                 str(other_name(model) if model.exists() else model)]
        say('next:')
        say_command(shlex.join(words))
    return 0


def _ask(draft: Draft) -> None:
    for path in draft.unknown:
        question = question_of(draft, path)
        while question is not None and path in draft.unknown:
            text, convert = question
            try:
                said = input(f'{printable(spelled(draft.content, path))}: {printable(text)}? ')
            except EOFError:  # nobody will answer any more
                print()
                return
            said = said.strip()
            if said in ('', OPEN):
                break
            try:
                answer(draft, path, convert(said))
            except ValueError as err:
                say(f'  {said}: {err}')
