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

"""URDFs with faults that people and programs make."""

import shutil
from xml.etree import ElementTree

from fuzzing.arms import use_arm
from fuzzing.mutate import in_bytes
import numpy as np
from robot_making import URDF
from tudor_dynamics.arm.limits import hard_limits, planned_limits
from tudor_dynamics.models.bundle import dump_yaml

NUMBERS = ('nan', 'inf', '-inf', '1e999', '-1', '0', '1e300', '1e-300', '', 'x', '1,5', '1_0',
           '0x10', '${mass}', '$(arg prefix)1', '1 2', '1e15', '-0.0', '\u0661')
VECTORS = ('0 0 0', '0 0 nan', '1e-300 0 0', '0 0', '1 1 1 1', '', '${xyz}', '0 0 1e300', '0 0 2')
CHAIN = ('<link name="x{0}"/><joint name="y{0}" type="{2}"><parent link="{1}"/>'
         '<child link="x{0}"/><axis xyz="0 0 1"/>'
         '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>')


class Urdfs:
    """Two arms whose URDFs get one to three faults each."""

    def __init__(self, folder, root):
        """Read the samples."""
        self._samples = {'tudor': (root / 'config' / 'tudor.urdf').read_text(), 'robot': URDF}

    @property
    def samples(self):
        """Names of what can be damaged."""
        return sorted(self._samples)

    def make(self, rng, sample, folder):
        """Write one description with its URDF; without a generator, a whole one."""
        text = self._samples[sample]
        root = ElementTree.fromstring(text)
        names = [joint.get('name') for joint in root.iter('joint')
                 if joint.get('type') in ('revolute', 'continuous', 'prismatic')]
        if rng is not None:
            for _ in range(int(rng.integers(1, 4))):
                FAULTS[int(rng.integers(len(FAULTS)))](rng, root)
            text = ElementTree.tostring(root, encoding='unicode')
            if rng.random() < 0.1:
                text = in_bytes(rng, text.encode()).decode(errors='replace')
        path = folder / 'arm'
        shutil.rmtree(path, ignore_errors=True)
        path.mkdir(parents=True)
        (path / 'arm.urdf').write_text(text, encoding='utf-8')
        (path / 'arm.yaml').write_bytes(dump_yaml({
            'name': 'arm', 'kinematics': {'urdf': 'arm.urdf'},
            'joints': [{'name': name} for name in names]}).encode())
        return path / 'arm.yaml'

    def use(self, path):
        """Load, build all models, compute rows and limits; TudorError where it is refused."""
        arm, found = use_arm(path)
        hard_limits(arm)
        planned_limits(arm)
        return found

    def compare(self, path, found):
        """Say which rows are no numbers."""
        bad = [name for name, rows in found.items() if not np.all(np.isfinite(rows))]
        return f'{", ".join(bad)}: rows are no numbers' if bad else None


def _one(rng, items):
    return items[int(rng.integers(len(items)))]


def _some(rng, root, *tags):
    found = [item for tag in tags for item in root.iter(tag)]
    return _one(rng, found) if found else root


def _links(root):
    return [link.get('name') for link in root.iter('link')] or ['none']


def _joint(root, name, parent, child, kind='revolute'):
    text = CHAIN.format('', parent, kind).partition('/>')[2]
    joint = ElementTree.fromstring(text.replace('link="x"', f'link="{child}"'))
    joint.set('name', name)
    root.append(joint)


def loop(rng, root):
    """Join two links once more, or a link to itself."""
    links = _links(root)
    _joint(root, f'loop{rng.integers(9)}', _one(rng, links), _one(rng, links),
           _one(rng, ['revolute', 'fixed', 'continuous']))


def many_roots(rng, root):
    """Add links that nothing leads to, or an island that goes round."""
    for name in ('p', 'q'):
        ElementTree.SubElement(root, 'link', name=name)
    if rng.random() < 0.7:
        _joint(root, 'pq', 'p', 'q')
        if rng.random() < 0.7:
            _joint(root, 'qp', 'q', 'p')


def missing(rng, root):
    """Take an element away."""
    for parent in rng.permutation(np.array([*root.iter()], dtype=object)):
        if len(parent):
            parent.remove(_one(rng, list(parent)))
            return


def renamed(rng, root):
    """Give a part another name, or that of another one."""
    item = _some(rng, root, 'link', 'joint', 'parent', 'child', 'mimic')
    key = 'link' if item.tag in ('parent', 'child') else 'name'
    item.set(key, _one(rng, [
        *_links(root), '', 'ghost', 'universe', 'a b', '\u00fc', 'root_joint']))


def mimicked(rng, root):
    """Let a joint mimic another, itself, or none."""
    names = [joint.get('name') for joint in root.iter('joint')] or ['none']
    ElementTree.SubElement(_some(rng, root, 'joint'), 'mimic', {
        'joint': str(_one(rng, [*names, 'ghost'])),
        'multiplier': _one(rng, ['1', '-1', *NUMBERS])})


def axis(rng, root):
    """Turn an axis, or make it one without length."""
    _some(rng, root, 'axis', 'origin').set(_one(rng, ['xyz', 'xyz', 'rpy']), _one(rng, VECTORS))


def body(rng, root):
    """Make a body that cannot be."""
    item = _some(rng, root, 'mass', 'inertia')
    keys = ['value'] if item.tag == 'mass' else ['ixx', 'iyy', 'izz', 'ixy', 'ixz', 'iyz']
    item.set(_one(rng, keys), _one(rng, ['-0.1', '100', *NUMBERS]))


def limits(rng, root):
    """Let limits be 0, turned round, or none."""
    item = _some(rng, root, 'limit')
    for key in ('lower', 'upper', 'effort', 'velocity'):
        if rng.random() < 0.5:
            item.set(key, _one(rng, ['0', '0', '1', '-3', *NUMBERS]))


def kind(rng, root):
    """Change the type of a joint."""
    _some(rng, root, 'joint').set('type', _one(rng, [
        'continuous', 'prismatic', 'fixed', 'floating', 'planar', 'ball', '', 'Revolute']))


def xacro(rng, root):
    """Leave something of xacro."""
    tag = _one(rng, ['macro', 'property', 'include', 'if'])
    at = _some(rng, root, 'robot', 'link', 'joint')
    if rng.random() < 0.5:
        ElementTree.SubElement(at, f'{{http://www.ros.org/wiki/xacro}}{tag}', name='x')
    else:
        at.set(_one(rng, ['name', 'type', 'other']), _one(rng, ['${prefix}link', '$(arg name)']))


def number(rng, root):
    """Write something else for any attribute."""
    items = [item for item in root.iter() if item.attrib]
    item = _one(rng, items)
    item.set(_one(rng, list(item.attrib)), _one(rng, NUMBERS))


def chain(rng, root):
    """Hang a long chain, or a wide bush, on a link."""
    last, kind = _one(rng, _links(root)), _one(rng, ['fixed', 'revolute'])
    deep = rng.random() < 0.5
    for i in range(int(_one(rng, [5, 30, 300, 999]) if kind == 'fixed' else 5)):
        for part in ElementTree.fromstring(f'<r>{CHAIN.format(i, "", kind)}</r>'):
            root.append(part)
        root[-1].find('parent').set('link', str(last))
        last = f'x{i}' if deep else last


def moved(rng, root):
    """Put an element elsewhere, or twice."""
    items = list(root.iter())
    part = _one(rng, items)
    if part is not root and not any(item is not part and part in list(item.iter())
                                    for item in part.iter()):
        target = _one(rng, [item for item in items if item not in list(part.iter())])
        target.append(part)


FAULTS = (loop, loop, many_roots, missing, missing, renamed, renamed, mimicked, axis, body, body,
          limits, limits, kind, xacro, number, number, chain, moved)
