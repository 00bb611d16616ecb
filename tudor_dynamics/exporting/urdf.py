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

"""Write what was identified into the user's URDF, and touch nothing else in it."""

from __future__ import annotations

from dataclasses import dataclass, field
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm.kinematics import joint_axis
from tudor_dynamics.exporting.friction import Simple, simple_frictions
from tudor_dynamics.exporting.rows import row
from tudor_dynamics.exporting.sharing import link_inertias
from tudor_dynamics.models.consistent.full import FullParameters

REACH = 2.0 * np.pi
"""Limits of the joints of a new URDF, which needs some [rad or m]."""


@dataclass
class _Element:
    """Where an element stands in the text, in bytes, and those directly in it."""

    name: str
    attributes: dict[str, str]
    begin: int
    inside: int = 0
    close: int = 0
    end: int = 0
    parts: list[_Element] = field(default_factory=list)


def urdf_of(full: FullParameters) -> str:
    """Give the arm as URDF: the user's own, with identified values, or a new one."""
    if full.arm.urdf is None:
        return _new(full)
    text = full.arm.urdf.encode()
    root = _elements(text)
    inertias = link_inertias(full.arm, full.bodies)
    frictions = simple_frictions(full)
    changes: list[tuple[int, int, bytes]] = []
    for element in root.parts:
        name = element.attributes.get('name')
        if element.name == 'link' and name in inertias:
            changes.append(_change(text, element, 'inertial', _inertial(inertias[name])))
        elif element.name == 'joint' and name in frictions and element.attributes.get('type'):
            changes.append(_change(text, element, 'dynamics', _dynamics(frictions[name])))
    for begin, end, content in sorted(changes, reverse=True):
        text = text[:begin] + content + text[end:]
    return text.decode()


def _elements(text: bytes) -> _Element:
    """Find out where elements stand; the text was checked when the arm was read."""
    parser = expat.ParserCreate()
    top = _Element('', {}, 0)
    stack = [top]

    def start(name: str, attributes: dict[str, str]) -> None:
        # nothing that is quoted may hold a '>' that ends the tag
        begin = parser.CurrentByteIndex
        element = _Element(name, attributes, begin, inside=_tag_end(text, begin))
        stack[-1].parts.append(element)
        stack.append(element)

    def end(name: str) -> None:
        element = stack.pop()
        if text[element.inside - 2:element.inside] == b'/>':
            element.close = element.end = element.inside
        else:
            element.close = parser.CurrentByteIndex
            element.end = _tag_end(text, element.close)

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.Parse(text, True)
    return top.parts[0]


def _tag_end(text: bytes, begin: int) -> int:
    quote = 0
    for place in range(begin, len(text)):
        byte = text[place]
        if quote:
            quote = 0 if byte == quote else quote
        elif byte in b'"\'':
            quote = byte
        elif byte == ord('>'):
            return place + 1
    return len(text)


def _change(
    text: bytes, element: _Element, name: str, content: str,
) -> tuple[int, int, bytes]:
    """Say what to put where, so that an element has one part of that name, with that content."""
    old = next((part for part in element.parts if part.name == name), None)
    if old is not None:
        return old.begin, old.end, content.encode()
    if element.parts:  # before the first part, indented as that is
        place = element.parts[0].begin
        line = text.rfind(b'\n', 0, place) + 1
        indent = text[line:place] if not text[line:place].strip() else b''
        return place, place, content.encode() + (b'\n' + indent if indent else b'')
    tag = text[element.begin:element.inside]
    if tag.endswith(b'/>'):
        whole = tag[:-2].rstrip() + b'>' + content.encode() + f'</{element.name}>'.encode()
        return element.begin, element.inside, whole
    return element.inside, element.inside, content.encode()


def _inertial(inertia: pin.Inertia) -> str:
    tensor = np.asarray(inertia.inertia)
    values = ' '.join(f'{key}="{float(tensor[i, j])!r}"' for key, i, j in (
        ('ixx', 0, 0), ('ixy', 0, 1), ('ixz', 0, 2), ('iyy', 1, 1), ('iyz', 1, 2), ('izz', 2, 2)))
    return (f'<inertial><origin xyz="{row(inertia.lever)}" rpy="0 0 0"/>'
            f'<mass value="{float(inertia.mass)!r}"/><inertia {values}/></inertial>')


def _dynamics(simple: Simple) -> str:
    return f'<dynamics damping="{simple.damping!r}" friction="{simple.friction!r}"/>'


def _new(full: FullParameters) -> str:
    """Make a URDF of an arm that was described by D-H rows; held joints are rigid in it."""
    arm, model = full.arm, full.arm.model
    bodies, frictions = full.bodies, simple_frictions(full)
    lines = ['<?xml version="1.0"?>', f'<robot name={quoteattr(arm.name)}>',
             *(f'  <!-- {name} is held at {place:.6g} -->'
               for name, place in arm.held_joints.items()), '  <link name="base"/>']
    for index in range(1, model.njoints):
        name, parent = str(model.names[index]), int(model.parents[index])
        place = model.jointPlacements[index]
        axis = joint_axis(model, name)
        kind = 'prismatic' if arm.is_prismatic(name) else 'revolute'
        before = 'base' if parent == 0 else f'{model.names[parent]}_link'
        inertia = pin.Inertia.FromDynamicParameters(bodies[name])
        lines += [
            f'  <link name={quoteattr(f"{name}_link")}>{_inertial(inertia)}</link>',
            f'  <joint name={quoteattr(name)} type="{kind}">',
            f'    <origin xyz="{row(place.translation)}" '
            f'rpy="{row(pin.rpy.matrixToRpy(place.rotation))}"/>',
            f'    <parent link={quoteattr(before)}/>',
            f'    <child link={quoteattr(f"{name}_link")}/>',
            f'    <axis xyz="{row(axis)}"/>',
            f'    <limit lower="{-REACH!r}" upper="{REACH!r}" effort="0" velocity="0"/>',
            f'    {_dynamics(frictions[name])}', '  </joint>']
    return '\n'.join([*lines, '</robot>', ''])
