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
URDFs, which come from anywhere: read within bounds and checked before Pinocchio sees them.

The parsers that Pinocchio uses follow a chain of links by recursion until the stack ends, and a
loop for ever; they take NaN for a mass, and an axis without length for one of no motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
import re
import sys
from typing import Any
from xml.etree import ElementTree

import numpy as np

from tudor_dynamics.arm.schema import LARGEST
from tudor_dynamics.errors import ArmError
from tudor_dynamics.files import read_text


MAX_URDF_BYTES = 20_000_000
MAX_ELEMENTS = 100_000  # XML elements of all kinds
MAX_DEPTH = 50  # levels of XML elements; a URDF has six
MAX_LINKS = 1000
"""Links, and joints with the fixed ones: Pinocchio's parser ends the process at some thousands."""

NUMBERS = {
    'mass': {'value': 1}, 'origin': {'xyz': 3, 'rpy': 3}, 'axis': {'xyz': 3},
    'inertia': dict.fromkeys(('ixx', 'iyy', 'izz', 'ixy', 'ixz', 'iyz'), 1),
    'limit': dict.fromkeys(('lower', 'upper', 'effort', 'velocity'), 1),
    'dynamics': dict.fromkeys(('damping', 'friction'), 1), 'mesh': {'scale': 3},
    'box': {'size': 3}, 'sphere': {'radius': 1}, 'cylinder': {'radius': 1, 'length': 1},
    'mimic': {'multiplier': 1, 'offset': 1}}
"""Elements and attributes that are numbers, and how many."""


class _Bounded(ElementTree.TreeBuilder):
    """Builds the tree while it is small."""

    def __init__(self) -> None:
        super().__init__()
        self._depth = self._count = 0

    def start(self, tag: str, attrs: dict[Any, Any], /) -> Any:
        self._depth += 1
        self._count += 1
        if self._depth > MAX_DEPTH or self._count > MAX_ELEMENTS:
            raise ArmError(f'has {self._count} elements on {self._depth} levels or more; at '
                           f'most {MAX_ELEMENTS} and {MAX_DEPTH} are read')
        return super().start(tag, attrs)

    def end(self, tag: str, /) -> Any:
        self._depth -= 1
        return super().end(tag)

    def doctype(self, name: str, public: str | None, system: str | None) -> None:
        """Refuse what could define entities, of which a few lines can stand for gigabytes."""
        raise ArmError('has a <!DOCTYPE>, which may not be in a URDF: remove it')


def read_urdf(path: Path) -> str:
    """Read a URDF file, of bounded size."""
    return read_text(path, MAX_URDF_BYTES, 'the URDF', ArmError, 'check kinematics.urdf')


def parse(text: str, path: str) -> ElementTree.Element:
    """Parse a description within bounds."""
    parser = ElementTree.XMLParser(target=_Bounded())
    try:
        parser.feed(text)
        root: ElementTree.Element = parser.close()
    except ArmError as err:
        raise ArmError(f'{path}: {err}; expected the URDF of an arm') from None
    except (ElementTree.ParseError, ValueError) as err:
        raise ArmError(f'{path}: no valid XML ({err}); correct it; for xacro files run xacro '
                       'first') from None
    for tag in ('link', 'joint'):
        count = sum(1 for _ in root.iter(tag))
        if count > MAX_LINKS:
            msg = f'{path}: {count} {tag}s; at most {MAX_LINKS} are read: remove other parts'
            raise ArmError(msg)
    return root


def adapt(root: ElementTree.Element, path: str,
          drawn: tuple[str, ...] = ('visual', 'collision')) -> None:
    """Turn continuous joints into angles, fix joints that mimic, leave out what is drawn."""
    for joint in root.findall('joint'):
        kind = joint.get('type')
        if joint.find('mimic') is not None:  # it has no coordinate of its own
            joint.set('type', 'fixed')
        elif kind == 'continuous':
            # Pinocchio would use (cos q, sin q); one angle a joint keeps nq == nv, and the
            # dynamics are the same.
            joint.set('type', 'revolute')
            limit = joint.find('limit')
            if limit is None:
                limit = ElementTree.SubElement(joint, 'limit')
            limit.attrib.update(lower='-1e9', upper='1e9')
            limit.attrib.setdefault('effort', '1e9')
            limit.attrib.setdefault('velocity', '1e9')
        elif kind in ('floating', 'planar'):
            raise ArmError(f'{path}: joint {joint.get("name")!r} is {kind}, but only revolute, '
                           'continuous, prismatic and fixed ones can be modelled; change its type')
    for link in root.iter('link'):  # meshes are not needed and often not there
        for tag in drawn:
            for element in link.findall(tag):
                link.remove(element)


def check_numbers(root: ElementTree.Element, path: str) -> None:
    """Refuse what is no finite number."""
    for part in (*root.findall('link'), *root.findall('joint')):
        for element in part.iter():
            for key, count in NUMBERS.get(element.tag, {}).items():
                text = element.get(key)
                if text is not None and not _are_numbers(text, count, element.tag):
                    what = ('a mass in kg' if element.tag == 'mass' else
                            'a finite number' if count == 1 else f'{count} finite numbers')
                    raise ArmError(f'{path}: {part.tag} {part.get("name")!r} has {element.tag} '
                                   f'{key}={text[:60]!r}; expected {what}')


def _are_numbers(text: str, count: int, tag: str) -> bool:
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        return False
    # a limit that is none may be any number
    largest = sys.float_info.max if tag == 'limit' else LARGEST
    return ('_' not in text and len(values) == count and all(abs(v) <= largest for v in values)
            and not (tag == 'mass' and min(values) < 0.0))


# -- Is this one tree of bodies that can exist? Pinocchio's parser does not say, or crashes

TYPES = ('revolute', 'continuous', 'prismatic', 'fixed')
LEFT = re.compile(r'\$[{(]')
NEGATIVE, MISFIT = 1e-6, 0.01
"""Parts of the largest principal moment: rounding below zero, and by which a moment may exceed the
sum of the other two, which no body's does."""


def check(root: ElementTree.Element, path: str) -> None:
    """Refuse what is no tree of links, is left from xacro, or has impossible axes and bodies."""
    if root.tag != 'robot':
        raise ArmError(f'begins with <{root.tag[:60]}>, expected <robot>', place=path,
                       remedy='give the URDF of an arm')
    _check_expanded(root, path)
    links, joints = _named(root, 'link', path), _named(root, 'joint', path)
    check_numbers(root, path)
    above: dict[str, str] = {}
    below: dict[str, list[str]] = {}
    for name, joint in joints.items():
        if joint.get('type') not in TYPES:
            raise _refused(path, name, f'is of type {str(joint.get("type"))[:60]!r}',
                           f'write {", ".join(TYPES)}')
        parent, child = (_link_of(joint, end) for end in ('parent', 'child'))
        for end, link in (('parent', parent), ('child', child)):
            if link not in links:
                raise _refused(path, name, f'has the {end} {link!r}, which is no link of the file',
                               'add the link, or correct its name')
        if child in above:
            raise _refused(path, name, f'has the same child {child!r} as joint {above[child]!r}',
                           'a URDF must be a tree: remove one of the two joints')
        above[child] = name
        below.setdefault(parent, []).append(child)
        _check_joint(joint, name, joints, path)
    reached = [name for name in links if name not in above]
    if len(reached) > 1:
        raise ArmError(f'{len(reached)} links have no parent joint ({", ".join(reached[:5])}), '
                       'expected one', place=path, remedy='connect them to one tree by joints')
    for link in reached:  # grows as it is gone through
        reached += below.get(link, [])
    for link in sorted(links.keys() - set(reached))[:1]:
        raise ArmError(f'link {link!r} is in a closed loop of joints', place=path,
                       remedy='a URDF must be a tree: remove one joint of the loop')
    for name, element in links.items():
        moments = _moments(element)
        if moments is not None and moments[0] < -NEGATIVE * max(abs(moments[2]), 1e-12):
            raise ArmError(f'link {name!r} has a negative moment of inertia ({moments[0]:.3g} kg '
                           'm^2), which no body has', place=path, remedy='correct its <inertia>')


def remarks(root: ElementTree.Element, active: Sequence[str]) -> list[str]:
    """Say what is taken otherwise than it stands in a URDF, of joints of a description."""
    found = []
    for joint in root.findall('joint'):
        name, mimic, limit = joint.get('name'), joint.find('mimic'), joint.find('limit')
        if mimic is not None and (name in active or mimic.get('joint') in active):
            found.append(f'joint {name!r} mimics {mimic.get("joint")!r}: it is taken as fixed at '
                         '0, its motion is not modelled')
        elif (name in active and joint.get('type') in ('revolute', 'prismatic') and limit is not
              None and float(limit.get('lower', '0')) == float(limit.get('upper', '0'))):
            place = limit.get('lower', '0')
            found.append(f'joint {name!r} has limits of position from {place} to {place}: taken '
                         'as unknown; joints[].limits says them')
    for link in root.findall('link'):
        moments = _moments(link)
        if moments is not None and moments[2] - moments[1] - moments[0] > MISFIT * moments[2]:
            found.append(f'link {link.get("name")!r} has moments of inertia ({moments[0]:.3g}, '
                         f'{moments[1]:.3g}, {moments[2]:.3g} kg m^2) that no body has: one is '
                         'larger than the sum of the others')
    return found


def _refused(path: str, joint: str, cause: str, remedy: str) -> ArmError:
    return ArmError(f'joint {joint!r} {cause}', place=path, remedy=remedy)


def _link_of(joint: ElementTree.Element, end: str) -> str:
    element = joint.find(end)
    return '' if element is None else element.get('link', '')


def _check_expanded(root: ElementTree.Element, path: str) -> None:
    for element in root.iter():
        left = next((value for value in element.attrib.values() if LEFT.search(value)), None)
        if 'xacro' in element.tag:
            left = f'xacro:{element.tag.rpartition("}")[2]}'
        elif element.tag not in (*NUMBERS, 'link', 'joint', 'parent', 'child'):
            continue
        if left is not None:
            raise ArmError(f'{left[:60]!r} is xacro, not URDF', place=path,
                           remedy='run `xacro IN.urdf.xacro > OUT.urdf`, and give OUT.urdf')


def _named(root: ElementTree.Element, tag: str, path: str) -> dict[str, ElementTree.Element]:
    found: dict[str, ElementTree.Element] = {}
    for element in root.findall(tag):
        name = element.get('name', '')
        if not name or name in found:
            raise ArmError(f'{tag} {name!r} is not unique' if name else f'a {tag} has no name',
                           place=path, remedy=f'give each {tag} a name of its own')
        found[name] = element
    return found


def _check_joint(
    joint: ElementTree.Element, name: str, joints: dict[str, ElementTree.Element], path: str,
) -> None:
    mimic, axis, limit = joint.find('mimic'), joint.find('axis'), joint.find('limit')
    if mimic is not None and (mimic.get('joint') not in joints or mimic.get('joint') == name):
        raise _refused(path, name, f'mimics {str(mimic.get("joint"))[:60]!r}, which is no other '
                       'joint of the file', 'correct its <mimic>')
    if joint.get('type') == 'fixed':
        return
    if axis is not None and axis.get('xyz') is not None and sum(
            float(word) ** 2 for word in axis.get('xyz', '').split()) < 1e-12:
        raise _refused(path, name, f'has the axis {axis.get("xyz")!r} without length',
                       'give it a direction, such as "0 0 1"')
    for key in ('effort', 'velocity'):
        if limit is not None and float(limit.get(key, '0')) < 0.0:
            raise _refused(path, name, f'has a negative limit of {key}', 'leave the minus out')
    if limit is not None and float(limit.get('lower', '0')) > float(limit.get('upper', '0')):
        raise _refused(path, name, f'has limits from {limit.get("lower", "0")} to '
                       f'{limit.get("upper", "0")}', 'write the smaller one as lower')


def _moments(link: ElementTree.Element) -> list[float] | None:
    """Give the principal moments of inertia of a link, ascending [kg m^2]; None without any."""
    inertia = link.find('inertial/inertia')
    if inertia is None:
        return None
    x, y, z, xy, xz, yz = (float(inertia.get(key, '0')) for key in (
        'ixx', 'iyy', 'izz', 'ixy', 'ixz', 'iyz'))
    moments: list[float] = np.linalg.eigvalsh([[x, xy, xz], [xy, y, yz], [xz, yz, z]]).tolist()
    return moments
