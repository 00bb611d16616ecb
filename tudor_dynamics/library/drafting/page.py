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

"""A first description as YAML with remarks, for people to read and go on with."""

from __future__ import annotations

from typing import Any

from tudor_dynamics.bounded_yaml import load_yaml
from tudor_dynamics.errors import printable
from tudor_dynamics.library.drafting.draft import Draft
import yaml

WIDTH = 99
"""Of remarks [characters]."""
LEFT_TO_FIT = """\
# Friction, filters and estimator are left to tudor fit, which chooses by parts of the bags that it
# leaves out, and says in its report what each choice brought. To fix them, for each joint:
#   friction: [viscous, coulomb]        # also offset, stribeck, cube_root, square
#   asymmetric: true                    # other coefficients in each direction
# and for the signals:
# preprocessing: {filter: causal, velocity_cutoff: 80, acceleration_cutoff: 20, rate: 20}
"""
NO_GAUGES = """\
# gauges:                               # for strains: where each gauge sits on its link
#   - {name: NAME, joint: JOINT, distance: 0.05}
"""


def _flow(value: Any) -> str:
    for unicode in (True, False):  # a line break of Unicode in a name has to be escaped
        text: str = yaml.safe_dump(value, default_flow_style=True, sort_keys=False,
                                   allow_unicode=unicode, width=10**6)
        text = text.removesuffix('...\n').strip()
        if load_yaml(f'[{text}]') == [value]:
            break
    return text


def _remark(text: str, indent: str = '') -> list[str]:
    """Break a remark into lines of comment."""
    lines, line = [], f'{indent}#'
    for word in printable(text).split():
        if len(line) + 1 + len(word) > WIDTH and not line.endswith('#'):
            lines.append(line)
            line = f'{indent}#'
        line += f' {word}'
    return [*lines, line]


def _list(key: str, entries: list[dict[str, Any]], draft: Draft) -> list[str]:
    lines = [f'{key}:']
    for entry in entries:
        remark = draft.remarks.get(f'{key}.{entry["name"]}')
        lines += _remark(remark, '  ') if remark else []
        lines.append(f'  - {_flow(entry)}')
    return lines


def _kinematics(content: dict[str, Any]) -> list[str]:
    rows = content.get('dh')
    if not isinstance(rows, list):
        more = [] if 'urdf' in content else _remark(
            'One row a joint, base first: dh: [[a, alpha, d, theta_offset], ...] in m and rad; or '
            'urdf: FILE. tudor init takes either, by --dh or --urdf.')
        return [*more, f'kinematics: {_flow(content)}']
    lines = ['kinematics:', '  dh:'.ljust(39) + ' # [a, alpha, d, theta_offset]']
    lines += [f'    - {_flow(row)}' for row in rows]
    return [*lines, *(f'  {key}: {_flow(value)}' for key, value in content.items() if key != 'dh')]


def text_of(draft: Draft) -> str:
    """Write a description."""
    content, remarks = draft.content, draft.remarks
    lines = _remark(f'Arm description of {content["name"]}, written by tudor init from '
                    f'{", ".join(draft.bags)}.')
    lines += _remark('docs/arm_yaml.md of tudor_dynamics has every key with unit and default.'
                     + (" A value that is '?' cannot be told from the bags: write it; nothing is "
                        'read from this file before.' if draft.unknown else ''))
    for note in draft.notes:
        lines += _remark(f'{note[0].upper()}{note[1:]}.')
    lines += [f'name: {_flow(content["name"])}', *_kinematics(content['kinematics'])]
    lines += _remark(
        'In the base frame [m/s^2]. ' + (
            f'Judged: {remarks["gravity"]}.' if 'gravity' in remarks else
            'Assumed: the base stands upright; another one for an arm that hangs or leans.'))
    lines.append(f'gravity: {_flow(content["gravity"])}')
    lines.append(f'joint_topic: {_flow(content["joint_topic"])}'.ljust(39)
                 + f' # {printable(remarks.get("joint_topic", ""))}')
    if 'unit' in remarks:
        lines += _remark(f'Unit of the efforts: {remarks["unit"]}.')
    lines += _list('joints', content['joints'], draft)
    if 'active_joints' in content:
        lines += _remark('Those that move in the bags; the others are held.')
        lines.append(f'active_joints: {_flow(content["active_joints"])}')
    if 'gauges' in content:
        lines += _list('gauges', content['gauges'], draft)
    text = '\n'.join(lines) + '\n' + ('' if 'gauges' in content else NO_GAUGES) + LEFT_TO_FIT
    assert load_yaml(text) == content, 'the file reads as what was meant'
    return text
