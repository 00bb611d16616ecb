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

"""Write what was identified into the user's URDF."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
import re
from xml.etree import ElementTree
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

import numpy as np
import pinocchio as pin
from scipy import optimize

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.kinematics import joint_axis
from tudor_dynamics.arm.schema import FRICTION_TERMS, JointSpec
from tudor_dynamics.models.comparison import FullParameters
from tudor_dynamics.models.consistent import pseudo_inertia
from tudor_dynamics.models.friction import (
    DAMPING, FRICTION, friction_columns, friction_names, term_of, TERMS)
from tudor_dynamics.typing import FloatArray


# -- Numbers as URDF and MJCF have them

def row(values: FloatArray) -> str:
    """Write numbers one after the other, with all their digits: values (n,)."""
    return ' '.join(repr(float(value)) for value in np.asarray(values).tolist())


# -- Friction as most programs know it: damping, and a torque against the motion

SPEEDS = 20  # evenly over those of a joint, at which friction is compared, in each direction
CLOSE = 0.01  # part of friction by which two numbers may miss it without a word


@dataclass(frozen=True)
class Simple:
    """Friction as most programs know it."""

    damping: float  # torque for each unit of speed, both ways [N m s/rad or N s/m]
    friction: float  # torque against the motion at any speed, likewise [N m or N]
    left_out: tuple[str, ...]  # what the two do not express, one phrase each


def simple_friction(
    joint: JointSpec, terms: dict[str, float], speed: float, load: float = 0.0,
) -> Simple:
    """Bring friction to the two numbers of URDF and MJCF that are nearest to it, both ways."""
    forward = np.linspace(0.0, speed, SPEEDS + 1)[1:]
    speeds = np.concatenate([-forward, forward])
    names = [name.partition('(')[0] for name in friction_names(joint)]
    own = np.array([0.0 if TERMS[term_of(name)].constant else terms.get(name, 0.0)
                    for name in names])
    wanted = friction_columns(joint, speeds, np.full(len(speeds), load)) @ own
    pair = joint.model_copy(update={'friction': (DAMPING, FRICTION), 'asymmetric': False})
    columns = friction_columns(pair, speeds)
    (damping, friction), _ = optimize.nnls(columns, wanted)  # both take energy
    size = float(np.linalg.norm(wanted))
    missed = float(np.linalg.norm(columns @ (damping, friction) - wanted))
    return Simple(float(damping), float(friction), (
        *(TERMS[name].exported for name in FRICTION_TERMS if terms.get(name)
          and TERMS[name].exported),
        *((f'{missed / size:.0%} of the rest',) if missed > CLOSE * size else ())))


def simple_frictions(full: FullParameters) -> dict[str, Simple]:
    """Bring the friction of all joints to two numbers, see `simple_friction`."""
    solution, drives = full.solution, full.drives
    return {joint.name: simple_friction(joint, drives[joint.name], speed, load)
            for joint, speed, load in zip(full.arm.joints, solution.speeds.tolist(),
                                          solution.loads.tolist(), strict=True)}


def both_ways(terms: dict[str, float], term: str) -> tuple[float, float]:
    """Give a coefficient of friction for each direction, positive where it takes energy."""
    if f'{term}+' not in terms:
        return terms.get(term, 0.0), terms.get(term, 0.0)
    return terms[f'{term}+'], terms[f'{term}-'] * TERMS[term].backward_sign


# -- From bodies that move as one to the links of a URDF.
#
# Links that fixed or held joints connect move as one body, of which data show the sum alone. The
# sum is reached by moving and scaling their mass as little as possible: one linear map of all of
# it, the same for each link (the optimal transport between two distributions of mass). So links
# keep their proportions, and each remains a body that can exist.

LEAST = 1e-12
"""Of the largest value of a pseudo-inertia, below which it is that of a point, line or plate."""


def link_inertias(arm: Arm, bodies: Mapping[str, FloatArray]) -> dict[str, pin.Inertia]:
    """Share bodies out among the links of the arm's URDF: bodies (10,)."""
    assert arm.urdf is not None
    described = _described(ElementTree.fromstring(arm.urdf))
    model = arm.model
    found: dict[str, pin.Inertia] = {}
    for joint, parameters in bodies.items():
        index = model.getJointId(joint)
        frames = [frame for frame in model.frames
                  if frame.type == pin.FrameType.BODY and frame.parentJoint == index]
        old = [pseudo_inertia(np.asarray(frame.placement.act(
            described[frame.name]).toDynamicParameters())) for frame in frames]
        new = pseudo_inertia(parameters)
        total = np.sum(old, axis=0)
        total = total + LEAST * np.trace(new) * np.eye(4)
        way = _transport(total, new)
        shares = [way @ part @ way.T for part in old]
        shares[0] = shares[0] + new - np.sum(shares, axis=0)  # rounding, or all where all is new
        for frame, share in zip(frames, shares, strict=True):
            if frame is frames[0] or described[frame.name].mass > 0.0:
                inertia = pin.PseudoInertia.FromMatrix(share).toInertia()
                found[frame.name] = frame.placement.actInv(inertia)
    return found


def _transport(before: FloatArray, after: FloatArray) -> FloatArray:
    """Give the symmetric A with ``A before A = after``."""
    root = _root(before)
    inverse = np.linalg.inv(root)
    return np.asarray(inverse @ _root(root @ after @ root) @ inverse)


def _root(matrix: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)


def _described(root: ElementTree.Element) -> dict[str, pin.Inertia]:
    """Let Pinocchio read the inertia of each link, in the frame of the link."""
    found = {}
    for link in root.iter('link'):
        alone = ElementTree.Element('robot', name='one')
        ElementTree.SubElement(alone, 'link', name='one').extend(link.findall('inertial'))
        text = ElementTree.tostring(alone, encoding='unicode')
        found[str(link.get('name'))] = pin.buildModelFromXML(text).inertias[0]
    return found


# -- Write what was identified into the user's URDF, and touch nothing else in it

REACH = 2.0 * np.pi  # limits of the joints of a new URDF, which needs some [rad or m]
TAG = re.compile(rb'<(?:[^>"\']|"[^"]*"|\'[^\']*\')*>')  # A '>' in quotes does not end it


@dataclass
class _Element:
    """Where an element stands in the text, in bytes, and those directly in it."""

    name: str
    attributes: dict[str, str]
    begin: int
    inside: int = 0
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

    def tag_end() -> int:
        found = TAG.match(text, parser.CurrentByteIndex)
        assert found is not None  # the parser has read it
        return found.end()

    def start(name: str, attributes: dict[str, str]) -> None:
        element = _Element(name, attributes, parser.CurrentByteIndex, inside=tag_end())
        stack[-1].parts.append(element)
        stack.append(element)

    def end(name: str) -> None:
        element = stack.pop()
        empty = text[element.inside - 2:element.inside] == b'/>'
        element.end = element.inside if empty else tag_end()

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.Parse(text, True)
    return top.parts[0]


def _change(text: bytes, element: _Element, name: str, content: str) -> tuple[int, int, bytes]:
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
