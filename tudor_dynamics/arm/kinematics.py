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

"""From a URDF or a D-H table to a Pinocchio model; axes and gauges of any model."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
import math
import os
from pathlib import Path
import re
import sys
import tempfile
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
import pinocchio as pin

from tudor_dynamics.arm.schema import ArmSpec, GaugeSpec, LARGEST
from tudor_dynamics.errors import ArmError
from tudor_dynamics.files import read_text


# -- URDFs, which come from anywhere: read within bounds and checked before Pinocchio sees them.
#
# The parsers that Pinocchio uses follow a chain of links by recursion until the stack ends, and a
# loop for ever; they take NaN for a mass, and an axis without length for one of no motion.

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
            raise ArmError(f'{path}: {count} {tag}s; at most {MAX_LINKS} are read: remove some')
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
        parent, child = (next((element.get('link', '') for element in joint.findall(end)), '')
                         for end in ('parent', 'child'))
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


# -- From a URDF or a D-H table to a model

STEP = math.pi / 4
NEAR = 1e-3
"""
What is closer to a multiple of `STEP` is taken as that [rad].

A file says 1.5708 where the drawing has a quarter turn. Axes that are parallel on the arm are
then not quite so in the model, and base parameters appear that only that difference shows:
columns of 4e-6, coefficients of 5e4 (measured on `ROUNDED` of test/arm/test_open_and_rounded.py).
Where an arm was measured to be off by less than a milliradian, its dynamics do not show it.
"""
PRINTED = 1e-6  # smaller differences are those of printed digits, and not reported [rad]
SHOWN = 3  # angles that one note names


def exact(angle: float) -> float:
    """Give the multiple of 45 degrees that an angle [rad] was rounded from, or the angle."""
    nearest = round(angle / STEP) * STEP
    return nearest if abs(angle - nearest) <= NEAR else angle


class ExactAngles:
    """Takes angles as what they were rounded from, and remembers which it changed."""

    def __init__(self) -> None:
        self._changed: list[str] = []

    def take(self, angle: float, where: str) -> float:
        """Give the exact angle: angle [rad]."""
        found = exact(angle)
        if abs(found - angle) > PRINTED:
            self._changed.append(f'{where} {angle:.7g} becomes {found:.7g}')
        return found

    def note(self) -> str:
        """Say in one sentence what was changed; nothing where nothing was."""
        if not self._changed:
            return ''
        more = len(self._changed) - SHOWN
        shown = ', '.join(self._changed[:SHOWN]) + (f' and {more} more' if more > 0 else '')
        return (f'angles within {NEAR:g} rad of a multiple of 45 degrees are taken as that '
                f'multiple: {shown} rad; nothing needs to be done')


def build_model(
    spec: ArmSpec, base: Path, source: str,
) -> tuple[pin.Model, str | None, tuple[str, ...]]:
    """Build the model of a description; returns model, text of the URDF, and notes."""
    urdf, angles, notes = None, ExactAngles(), []
    if spec.kinematics.urdf is not None:
        file = base / spec.kinematics.urdf
        urdf = read_urdf(file)
        model = model_from_urdf(urdf, str(file), angles)
        notes = remarks(parse(urdf, str(file)), [joint.name for joint in spec.joints])
    else:
        rows = [(a, angles.take(alpha, f'alpha of row {number}'), d,
                 angles.take(theta, f'theta of row {number}'))
                for number, (a, alpha, d, theta) in enumerate(spec.kinematics.dh or (), start=1)]
        model = model_from_dh(rows, [joint.name for joint in spec.joints],
                              [joint.type or 'revolute' for joint in spec.joints],
                              spec.kinematics.convention)
    _check_against_model(spec, model, source)
    model.gravity = pin.Motion(np.array(spec.gravity), np.zeros(3))
    return model, urdf, tuple(filter(None, [angles.note(), *notes]))


def _check_against_model(spec: ArmSpec, model: pin.Model, source: str) -> None:
    known = list(model.names)[1:]
    for joint in spec.joints:
        if joint.name not in known:
            raise ArmError(f'{source}: joint {joint.name!r} is not among the joints of the URDF '
                           f'that can move, {known}; correct joints[].name (joints that mimic '
                           'another count as fixed)')
    for joint in spec.joints:
        prismatic = is_prismatic(model, joint.name)
        kind, unit = ('prismatic', 'N') if prismatic else ('revolute', 'N m')
        if joint.type is not None and prismatic != (joint.type == 'prismatic'):
            raise ArmError(f'{source}: joint {joint.name!r} is {kind} in the URDF, but '
                           f'its type here is {joint.type}; correct joints[].type')
        if joint.effort.unit not in ('A', unit):
            raise ArmError(f'{source}: joint {joint.name!r} is {kind}, but its effort.unit '
                           f'is {joint.effort.unit!r}; give {unit!r} or A')
        for gauge in spec.gauges:
            if prismatic and gauge.joint == joint.name and gauge.axis is None:
                msg = (f'{source}: gauge {gauge.name!r} is after the prismatic joint '
                       f'{joint.name!r}, whose axis is no bending axis; give gauges[].axis')
                raise ArmError(msg)


@contextmanager
def _stderr_of_libraries() -> Iterator[Callable[[], str]]:
    """Keep what compiled code writes to standard error, for the caller to pass on."""
    try:
        sys.stderr.flush()
        usual = os.dup(2)
    except (AttributeError, OSError):  # there is no standard error
        yield lambda: ''
        return
    with tempfile.TemporaryFile() as file:
        def taken() -> str:
            file.seek(0)
            return file.read(10_000).decode(errors='replace')
        os.dup2(file.fileno(), 2)
        try:
            yield taken
        finally:
            os.dup2(usual, 2)
            os.close(usual)


def model_from_urdf(text: str, path: str, angles: ExactAngles | None = None) -> pin.Model:
    """Build a model from a URDF; continuous joints become angles, fixed ones merge."""
    root = parse(text, path)
    adapt(root, path)
    check(root, path)
    angles = angles or ExactAngles()
    for joint in root.iter('joint'):
        origin = joint.find('origin')
        if origin is not None and origin.get('rpy') is not None:
            exactly = [angles.take(float(word), f'{joint.get("name")} rpy')
                       for word in origin.get('rpy', '').split()]
            origin.set('rpy', ' '.join(map(repr, exactly)))
    model, cause = None, None
    with _stderr_of_libraries() as taken:
        try:
            model = pin.buildModelFromXML(ElementTree.tostring(root, encoding='unicode'))
        except (ValueError, RuntimeError, IndexError) as err:
            cause = str(err)
        said = taken()
    # urdfdom reports an inertia that it cannot read, and goes on without it
    errors = re.findall(r'^Error: *(.*)', said, re.MULTILINE)
    if model is None or errors:
        cause = errors[0] if errors else cause
        raise ArmError(f'{path}: Pinocchio cannot read this URDF ({cause}); correct the URDF')
    if said and sys.stderr is not None:
        sys.stderr.write(said)
    return model


def unit_vector(axis: str | Sequence[float]) -> NDArray[np.float64]:
    """Give the unit vector of an axis name or of any vector; returns (3,)."""
    if isinstance(axis, str):
        return np.array(np.eye(3)['xyz'.index(axis)])
    vector = np.asarray(axis, dtype=float)
    norm = float(np.linalg.norm(vector))
    if norm < 1e-12:
        raise ArmError(f'height_axis or direction of a beam is {list(axis)}: give x, y or z')
    return np.asarray(vector / norm)


def gauge_point(gauge: GaugeSpec) -> NDArray[np.float64]:
    """Give the place (3,) of a gauge [m], for the regressor's cut and for the simulator's beam."""
    return gauge.distance * unit_vector(gauge.direction)


# Standard rows: link i follows joint i by Rz(theta + q) Tz(d) Tx(a) Rx(alpha) (Siciliano et al.,
# Robotics: Modelling, Planning and Control, 2009, Eq. 2.52), or Tz(d + q) for a prismatic joint.
# The frame of joint i turns with the joint and has its x axis along the link, so that a gauge is
# found at ``distance`` along x.
#
# Modified rows: joint i follows joint i - 1 by Rx(alpha) Tx(a) Rz(theta + q) Tz(d) (Craig,
# Introduction to Robotics, 2005, Eq. 3.6), and its frame is that of the table.


def model_from_dh(
    rows: Sequence[Sequence[float]],  # a [m], alpha [rad], d [m], theta_offset [rad], base first
    names: Sequence[str], types: Sequence[str],  # of the joints: ``revolute`` or ``prismatic``
    convention: str = 'standard',  # or ``modified``, which may have one row more, for a flange
) -> pin.Model:
    """Build a chain of links without mass by Denavit-Hartenberg rows, to the frame ``tip``."""
    model = pin.Model()
    placement = pin.SE3.Identity()
    parent = 0
    for number, (a, alpha, d, theta) in enumerate(rows):
        # along the joint's axis and across it: where the joint stands between them differs
        turn = pin.SE3(pin.utils.rotate('z', theta), np.zeros(3))
        rise = pin.SE3(np.eye(3), np.array([0.0, 0.0, d]))
        across = pin.SE3(pin.utils.rotate('x', alpha), np.array([a, 0.0, 0.0]))
        standard = convention == 'standard'
        placement = placement * (turn if standard else across * turn * rise)
        if number < len(names):
            slides = types[number] == 'prismatic'
            joint = pin.JointModelPZ() if slides else pin.JointModelRZ()
            parent = model.addJoint(parent, joint, placement, names[number])
            model.addJointFrame(parent)
            placement = rise * across if standard else pin.SE3.Identity()
    model.addFrame(pin.Frame('tip', parent, placement, pin.FrameType.OP_FRAME))
    return model


def is_prismatic(model: pin.Model, joint: str) -> bool:
    """Say whether a joint moves along its axis, not about it."""
    short: str = model.joints[model.getJointId(joint)].shortname()
    return short.startswith('JointModelP')


def joint_axis(model: pin.Model, joint: str) -> NDArray[np.float64]:
    """Give the axis of a joint in its own frame; returns (3,)."""
    data = model.createData()
    pin.computeJointJacobians(model, data, np.zeros(model.nq))
    index = model.getJointId(joint)
    column = pin.getJointJacobian(model, data, index, pin.ReferenceFrame.LOCAL)
    column = column.reshape(6, -1)[:, model.joints[index].idx_v]
    linear, angular = column[:3], column[3:]
    axis = angular if np.linalg.norm(angular) > 0.5 else linear
    return np.asarray(axis, dtype=float)


def gauge_axis(model: pin.Model, gauge: GaugeSpec) -> NDArray[np.float64]:
    """Give the axis (3,) that a gauge's link bends about, in the frame of its joint."""
    return joint_axis(model, gauge.joint) if gauge.axis is None else unit_vector(gauge.axis)


def link_frame(model: pin.Model, joint: str) -> str:
    """Give the name of the frame that turns with a joint: its link's, or the joint's own."""
    index = model.getJointId(joint)
    for frame in model.frames:
        if (frame.type == pin.FrameType.BODY and frame.parentJoint == index
                and frame.placement.isIdentity(1e-9)):
            return str(frame.name)
    return joint


def link_reach(model: pin.Model, joint: str, direction: NDArray[np.float64]) -> float:
    """Give how far a link reaches from its joint along a direction (3,) [m], where known."""
    index = model.getJointId(joint)
    places = [model.jointPlacements[child].translation for child in model.children[index]]
    places += [frame.placement.translation for frame in model.frames if frame.parentJoint == index]
    return max((float(direction @ place) for place in places), default=0.0)


def base_frame(model: pin.Model) -> str:
    """Give the name of the frame that does not move: the root link of a URDF, or base."""
    name = link_frame(model, 'universe')
    return 'base' if name == 'universe' else name


def with_gauge_joints(
    model: pin.Model, places: Sequence[tuple[str, str, NDArray[np.float64], NDArray[np.float64]]],
) -> pin.Model:
    """
    Cut links at their gauges by virtual joints about the bending axes.

    The torque of such a joint, kept at zero angle, is the bending moment at the gauge: exactly the
    moment of everything outboard about the point x_s, with the reaction force's lever shortened by
    x_s and the moment's not. (Malzahn et al., Eqs. (8)-(15), take the joint's own moment instead
    and call the difference constant, which it is not.) The outboard part of a cut link has its
    mass parameters to itself.

    places: gauge, joint before it, point (3,) [m] and bending axis (3,) in the joint's frame;
    those of one joint sorted from it outwards.
    """
    cut = pin.Model()
    cut.gravity = model.gravity
    moved: dict[int, tuple[int, pin.SE3]] = {0: (0, pin.SE3.Identity())}
    for index in range(1, model.njoints):
        parent, offset = moved[model.parents[index]]
        name = model.names[index]
        new = cut.addJoint(parent, model.joints[index],
                           offset.inverse() * model.jointPlacements[index], name)
        cut.addJointFrame(new)  # buildReducedModel reads the frames of the joints it locks
        cut.appendBodyToJoint(new, model.inertias[index], pin.SE3.Identity())
        here = pin.SE3.Identity()
        for gauge, joint, point, axis in places:
            if joint != name:
                continue
            place = pin.SE3(np.eye(3), np.asarray(point, dtype=float))
            new = cut.addJoint(new, pin.JointModelRevoluteUnaligned(axis),
                               here.inverse() * place, gauge)
            cut.addJointFrame(new)
            here = place
        moved[index] = (new, here)
    return cut
