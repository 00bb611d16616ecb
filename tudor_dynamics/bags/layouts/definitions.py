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
Is a message what its type says? The definition that the bag carries is compared with ours.

Types change between releases under the same name. A bag of MCAP or sqlite3 carries the definition
that its messages were written by; where it says otherwise than what the numbers are read by here,
nothing is read.
"""

from __future__ import annotations

from collections.abc import Mapping
import re

from tudor_dynamics.bags.layouts.carriers import DYNAMIC_JOINT_STATE, FLOAT64_MULTI_ARRAY
from tudor_dynamics.errors import BagError

Fields = tuple[tuple[str, str], ...]

EXPECTED: Mapping[str, Mapping[str, Fields]] = {
    FLOAT64_MULTI_ARRAY: {
        '': (('MultiArrayLayout', 'layout'), ('float64[]', 'data')),
        'MultiArrayLayout': (('MultiArrayDimension[]', 'dim'), ('uint32', 'data_offset')),
        'MultiArrayDimension': (('string', 'label'), ('uint32', 'size'), ('uint32', 'stride'))},
    DYNAMIC_JOINT_STATE: {
        '': (('Header', 'header'), ('string[]', 'joint_names'),
             ('InterfaceValue[]', 'interface_values')),
        'InterfaceValue': (('string[]', 'interface_names'), ('float64[]', 'values'))},
}
"""
Types to their parts (by their short names, the message itself has none) to types and names.

std_msgs and control_msgs as they are in ROS 2 Jazzy.
"""
SECTION = re.compile(r'^=+$', re.MULTILINE)


def parts_of(definition: str) -> dict[str, Fields]:
    """Split a message definition into its parts."""
    found: dict[str, Fields] = {}
    for number, section in enumerate(SECTION.split(definition)):
        lines = [line.partition('#')[0].split() for line in section.splitlines()]
        lines = [words for words in lines if words]
        name = ''
        if number:
            if not lines or lines[0][0] != 'MSG:' or len(lines[0]) != 2:
                continue
            name = lines.pop(0)[1].rpartition('/')[2]
        found[name] = tuple((words[0].rpartition('/')[2], words[1]) for words in lines
                            if len(words) > 1 and '=' not in ''.join(words[1:]))
    return found


def check_definition(msgtype: str, definition: str, topic: str, path: str) -> None:
    """Refuse messages of a definition that is not the one they are read by."""
    found = parts_of(definition)
    for part, fields in EXPECTED[msgtype].items():
        if found.get(part) != fields:
            what = msgtype if not part else f'{part} in {msgtype}'
            shown = ', '.join(' '.join(field) for field in found.get(part, ())) or 'nothing'
            msg = (f'topic {topic}: the definition of {what} in the bag is ({shown[:200]}), '
                   f'expected ({", ".join(" ".join(field) for field in fields)}); record it with '
                   'the messages of ROS 2 Jazzy')
            raise BagError(msg, place=path)
