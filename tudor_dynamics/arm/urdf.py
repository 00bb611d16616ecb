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
From a URDF to a Pinocchio model with one scalar coordinate a joint.

URDFs come from anywhere. The parsers behind Pinocchio follow a chain of links by recursion until
the stack ends, and take NaN for a mass, so both are looked for here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import re
import sys
import tempfile
from typing import Any
from xml.etree import ElementTree

import pinocchio as pin

from tudor_dynamics.arm.angles import Snapped
from tudor_dynamics.arm.fields import LARGEST
from tudor_dynamics.errors import ArmError
from tudor_dynamics.files import read_bounded

MAX_URDF_BYTES = 20_000_000
MAX_ELEMENTS = 100_000
"""XML elements of all kinds."""
MAX_DEPTH = 50
"""Levels of XML elements; a URDF has six."""
MAX_LINKS = 1000
"""Links, and joints with the fixed ones: Pinocchio's parser ends the process at some thousands."""

NUMBERS = {
    'mass': {'value': 1}, 'origin': {'xyz': 3, 'rpy': 3}, 'axis': {'xyz': 3},
    'inertia': dict.fromkeys(('ixx', 'iyy', 'izz', 'ixy', 'ixz', 'iyz'), 1),
    'limit': dict.fromkeys(('lower', 'upper', 'effort', 'velocity'), 1)}
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
            msg = f'more than {MAX_DEPTH} levels or {MAX_ELEMENTS} elements'
            raise ArmError(msg)
        return super().start(tag, attrs)

    def end(self, tag: str, /) -> Any:
        self._depth -= 1
        return super().end(tag)

    def doctype(self, name: str, public: str | None, system: str | None) -> None:
        """Refuse what could define entities, of which a few lines can stand for gigabytes."""
        msg = 'has a DOCTYPE, which no URDF needs'
        raise ArmError(msg)


def read_urdf(path: Path) -> str:
    """Read a URDF file, of bounded size."""
    try:
        return read_bounded(path, MAX_URDF_BYTES).decode()
    except (OSError, ValueError) as err:  # ValueError: no UTF-8, or a NUL in the path
        cause = getattr(err, 'strerror', None) or err
        msg = f'{path}: the URDF cannot be read ({cause}); check kinematics.urdf'
        raise ArmError(msg) from None


def parse(text: str, path: str) -> ElementTree.Element:
    """Parse a description within bounds."""
    parser = ElementTree.XMLParser(target=_Bounded())
    try:
        parser.feed(text)
        root: ElementTree.Element = parser.close()
    except (ElementTree.ParseError, ValueError) as err:
        if isinstance(err, ArmError):
            msg = f'{path}: {err}: this is no URDF of an arm'
        else:
            msg = f'{path}: no valid XML ({err}); for xacro files run xacro first'
        raise ArmError(msg) from None
    for tag in ('link', 'joint'):
        count = sum(1 for _ in root.iter(tag))
        if count > MAX_LINKS:
            msg = f'{path}: {count} {tag}s; at most {MAX_LINKS} are read: leave out what is no arm'
            raise ArmError(msg)
    return root


def adapt(root: ElementTree.Element, path: str,
          drawn: tuple[str, ...] = ('visual', 'collision')) -> None:
    """Turn continuous joints into angles, and leave out what is drawn."""
    for joint in root.iter('joint'):
        kind = joint.get('type')
        if kind == 'continuous':
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
            msg = (f'{path}: joint {joint.get("name")!r} is {kind}; revolute, continuous, '
                   'prismatic and fixed joints can be modelled')
            raise ArmError(msg)
    for link in root.iter('link'):  # meshes are not needed and often not there
        for tag in drawn:
            for element in link.findall(tag):
                link.remove(element)


def _check_numbers(root: ElementTree.Element, path: str) -> None:
    for part in (*root.findall('link'), *root.findall('joint')):
        for element in part.iter():
            for key, count in NUMBERS.get(element.tag, {}).items():
                text = element.get(key)
                if text is not None and not _are_numbers(text, count, element.tag):
                    what = ('a mass in kg' if element.tag == 'mass' else
                            'a finite number' if count == 1 else f'{count} finite numbers')
                    msg = (f'{path}: {part.tag} {part.get("name")!r} has {element.tag} '
                           f'{key}={text[:60]!r}; expected {what}')
                    raise ArmError(msg)


def _snap(root: ElementTree.Element, snapped: Snapped) -> None:
    """Take the angles between joints as what they were rounded from."""
    for joint in root.iter('joint'):
        origin = joint.find('origin')
        if origin is not None and origin.get('rpy') is not None:
            angles = [snapped.take(float(word), f'{joint.get("name")} rpy')
                      for word in origin.get('rpy', '').split()]
            origin.set('rpy', ' '.join(map(repr, angles)))


def _are_numbers(text: str, count: int, tag: str) -> bool:
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        return False
    # a limit that is none may be any number
    largest = sys.float_info.max if tag == 'limit' else LARGEST
    return ('_' not in text and len(values) == count and all(abs(v) <= largest for v in values)
            and not (tag == 'mass' and min(values) < 0.0))


@contextmanager
def _stderr_of_libraries() -> Iterator[Callable[[], str]]:
    """Keep what compiled code writes to standard error, for the caller to tell on."""
    try:
        sys.stderr.flush()
        usual = os.dup(2)
    except (AttributeError, OSError):  # nobody listens
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


def model_from_urdf(text: str, path: str, snapped: Snapped | None = None) -> pin.Model:
    """Build a model from a URDF; continuous joints become angles, fixed ones merge."""
    root = parse(text, path)
    adapt(root, path)
    _check_numbers(root, path)
    _snap(root, snapped or Snapped())
    model, cause = None, None
    with _stderr_of_libraries() as taken:
        try:
            model = pin.buildModelFromXML(ElementTree.tostring(root, encoding='unicode'))
        except (ValueError, RuntimeError, IndexError) as err:
            cause = str(err)
        said = taken()
    # urdfdom tells of an inertia that it cannot read, and goes on without it
    errors = re.findall(r'^Error: *(.*)', said, re.MULTILINE)
    if model is None or errors:
        cause = errors[0] if errors else cause
        msg = f'{path}: Pinocchio cannot build a model from this URDF ({cause})'
        raise ArmError(msg)
    if said and sys.stderr is not None:
        sys.stderr.write(said)
    if model.nq != model.nv:
        msg = f'{path}: a joint of this URDF needs more than one coordinate'
        raise ArmError(msg)
    return model
