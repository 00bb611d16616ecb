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

"""An arm as the rest of the package sees it, and how its description is read and checked."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
import hashlib
import json
from pathlib import Path
from typing import Any
import warnings

import numpy as np
from numpy.typing import NDArray
import pinocchio as pin
from pydantic import ValidationError

from tudor_dynamics.arm.kinematics import (
    build_model, gauge_axis, gauge_point, is_prismatic, joint_axis, with_gauge_joints)
from tudor_dynamics.arm.schema import (
    ArmSpec, DamperSpec, FRICTION_KEYS, GaugeSpec, JointSpec, SourceSpec, validation_message)
from tudor_dynamics.errors import ArmError, check_type, TudorWarning
from tudor_dynamics.files import load_yaml, read_text, YamlError
from tudor_dynamics.typing import FloatArray, Shown


OUTPUTS = ('effort', 'strain')
OPEN = '?'
"""Stands in a description for what nobody has said yet; nothing is read from such a file."""
SHOWN = 8  # open values that one message names
KeyPath = tuple[str | int, ...]  # keys and places in lists that lead to a value


def open_values(content: Any, path: KeyPath = ()) -> Iterator[KeyPath]:
    """Find the values that are still open."""
    if isinstance(content, dict):
        for key, value in content.items():
            yield from open_values(value, (*path, str(key)))
    elif isinstance(content, (list, tuple)):
        for number, value in enumerate(content):
            yield from open_values(value, (*path, number))
    elif isinstance(content, str) and content.strip() == OPEN:
        yield path


def spelled(content: Any, path: KeyPath) -> str:
    """Write where a value stands, entries of lists by their names where they have some."""
    text, here = '', content
    for step in path:
        here = here[step]
        if isinstance(step, int):
            name = here.get('name') if isinstance(here, dict) else None
            text += f'[{name if isinstance(name, str) and name != OPEN else step}]'
        else:
            text += f'.{step}' if text else step
    return text


@dataclass(frozen=True, eq=False)
class Arm(Shown):
    """
    An arm description that was read and checked, with its models.

    Attributes
    ----------
    spec : ArmSpec
        What stands in the YAML.
    full_model : pinocchio.Model
        All joints of the description.
    source : str
        File the description came from, for messages.
    urdf : str or None
        Text of the URDF, where the kinematics come from one.
    notes : tuple of str
        What was taken otherwise than it stands in the files, one sentence each.

    """

    spec: ArmSpec
    full_model: pin.Model
    source: str = field(default='')
    urdf: str | None = field(default=None, repr=False)
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """Write joints with their efforts, and gauges with their places, one line each."""
        held = ''.join(f', {name} held at {place:g}' for name, place in self.held_joints.items())
        return '\n'.join([
            f'Arm {self.name!r} of {self.source}: {len(self.active_joints)} active joints{held}',
            *(f'  joint {joint.name}: effort [{joint.effort.unit}] on {joint.effort.topic}, '
              f'friction {", ".join(joint.friction)}' for joint in self.joints),
            *(f'  gauge {gauge.name}: strain [{gauge.unit}] on {gauge.topic}, {gauge.distance:g} '
              f'm after {gauge.joint}' for gauge in self.gauges)])

    @property
    def name(self) -> str:
        """Name of the arm."""
        return self.spec.name

    @cached_property
    def active_joints(self) -> tuple[str, ...]:
        """Names of the joints that the model describes, in the order of the description."""
        names = tuple(joint.name for joint in self.spec.joints)
        return names if self.spec.active_joints is None else self.spec.active_joints

    @cached_property
    def joints(self) -> tuple[JointSpec, ...]:
        """Descriptions of the active joints."""
        by_name = {joint.name: joint for joint in self.spec.joints}
        return tuple(by_name[name] for name in self.active_joints)

    @cached_property
    def movable_joints(self) -> tuple[str, ...]:
        """Names of all joints that can move, active and held, in the order of the kinematics."""
        return tuple(self.full_model.names)[1:]

    @cached_property
    def held_joints(self) -> dict[str, float]:
        """Joints that are not active, and where each is held [rad or m]."""
        hold = {joint.name: joint.hold for joint in self.spec.joints}
        return {name: hold.get(name, 0.0) for name in self.movable_joints
                if name not in self.active_joints}

    @cached_property
    def gauges(self) -> tuple[GaugeSpec, ...]:
        """Gauges of all joints, active or held."""
        return self.spec.gauges

    @property
    def gauge_names(self) -> tuple[str, ...]:
        """Names of the gauges."""
        return tuple(gauge.name for gauge in self.gauges)

    @property
    def channels(self) -> dict[str, tuple[str, ...]]:
        """Names of the channels of each output."""
        return {'effort': self.active_joints, 'strain': self.gauge_names}

    @property
    def topics(self) -> dict[str, dict[str, list[str]]]:
        """Topics of each output with the channels that they carry, in the order of the arm."""
        carried = {'effort': by_topic(joint.effort for joint in self.joints),
                   'strain': by_topic(self.gauges)}
        return {output: {topic: [names[i] for i in carried[output][topic]]
                         for topic in carried[output]} for output, names in self.channels.items()}

    def _reduce(self, model: pin.Model, keep: tuple[str, ...]) -> pin.Model:
        reference = np.zeros(model.nq)
        locked = [i for i, name in enumerate(model.names) if i and name not in keep]
        for index in locked:
            reference[model.joints[index].idx_q] = self.held_joints[model.names[index]]
        try:
            return pin.buildReducedModel(model, locked, reference) if locked else model
        except ValueError as err:  # names that several parts of a URDF share
            msg = f'{self.source}: joints cannot be held ({err}); give joints and links own names'
            raise ArmError(msg) from None

    @cached_property
    def model(self) -> pin.Model:
        """Model of the active joints; the others are locked where they are held."""
        return self._reduce(self.full_model, self.active_joints)

    @cached_property
    def gauge_model(self) -> pin.Model:
        """Model of the active joints with a virtual joint at each gauge."""
        cut = with_gauge_joints(self.full_model, [
            (gauge.name, gauge.joint, gauge_point(gauge), gauge_axis(self.full_model, gauge))
            for gauge in sorted(self.gauges, key=lambda gauge: gauge.distance)])
        return self._reduce(cut, self.active_joints + self.gauge_names)

    @cached_property
    def velocity_index(self) -> NDArray[np.intp]:
        """Index in ``model``'s velocity vector of each active joint."""
        model = self.model
        return np.array([model.joints[model.getJointId(name)].idx_v
                         for name in self.active_joints], dtype=np.intp)

    def held_pose(self) -> tuple[FloatArray, list[int]]:
        """Give a pose of ``full_model``, held joints in their places; index of active ones."""
        joints, q = self.full_model.joints, np.zeros(self.full_model.nq)
        index = {name: int(joints[self.full_model.getJointId(name)].idx_q)
                 for name in self.movable_joints}
        for name, place in self.held_joints.items():
            q[index[name]] = place
        return q, [index[name] for name in self.active_joints]

    def changed(self, **parts: Any) -> Arm:
        """Give the same arm with other parts of its description, not checked again."""
        return replace(self, spec=self.spec.model_copy(update=parts))

    def under(self, gravity: FloatArray) -> Arm:
        """Give the same arm under another gravity (3,) [m/s^2]."""
        model = self.full_model.copy()
        model.gravity.linear = gravity
        return replace(self.changed(gravity=tuple(gravity.tolist())), full_model=model)

    def with_joints(self, changes: Mapping[str, Mapping[str, Any]]) -> Arm:
        """Give the same arm with other values of some keys of its joints, not checked again."""
        return self.changed(joints=tuple(
            joint.model_copy(update=dict(changes.get(joint.name, {})))
            for joint in self.spec.joints))

    def with_gauges(self, names: Collection[str]) -> Arm:
        """Give the same arm with the named ones of its gauges."""
        return self.changed(
            gauges=tuple(gauge for gauge in self.spec.gauges if gauge.name in names),
            sensors=tuple(item for item in self.spec.sensors if item.gauge in names))

    def with_friction_of(self, other: Arm) -> Arm:
        """Give the same arm with the friction that the joints of another have."""
        return self.with_joints({joint.name: {key: getattr(joint, key) for key in FRICTION_KEYS}
                                 for joint in other.spec.joints})

    def with_open_friction(self) -> Arm:
        """Give the same arm without a word on the friction of its joints, for a fit to choose."""
        return self.changed(joints=tuple(JointSpec.model_validate(joint.model_dump(
            exclude_unset=True, exclude=set(FRICTION_KEYS))) for joint in self.spec.joints))

    @cached_property
    def coupling(self) -> FloatArray | None:
        """Speeds of the motors by those of the active joints; None where nothing is coupled."""
        if self.spec.couplings is None:
            return None
        names = [joint.name for joint in self.spec.joints]
        index = [names.index(name) for name in self.active_joints]
        return self.spec.couplings.speeds(names)[np.ix_(index, index)]

    @property
    def torque_constants(self) -> FloatArray:
        """Torque or force at each joint by a current of 1 A, (joints,); NaN where unknown."""
        motors = {motor.joint: motor.joint_torque_constant for motor in self.spec.motors}
        return np.array([joint.effort.torque_constant or motors.get(joint.name, np.nan)
                         for joint in self.joints])

    @property
    def damper(self) -> DamperSpec:
        """Give the section of the damper; an ArmError where it is missing."""
        if self.spec.damper is None:
            raise ArmError("the key 'damper' is missing", place=self.source,
                           remedy='add it with gauges and gains, as in config/tudor.yaml')
        return self.spec.damper

    def is_prismatic(self, joint: str) -> bool:
        """Say whether a joint moves along its axis instead of about it."""
        return is_prismatic(self.full_model, joint)

    @cached_property
    def position_units(self) -> dict[str, str]:
        """Name the unit of the position of each joint that can move."""
        return {name: 'm' if self.is_prismatic(name) else 'rad' for name in self.movable_joints}

    @cached_property
    def digest(self) -> str:
        """
        SHA-256 of all that a fitted model depends on.

        Two files with the same content under other comments or names of files are the same arm,
        whatever else they say of limits, motors, sensors, damper, links and preprocessing.
        """
        content = self.spec.model_dump(
            mode='json', include={'name', 'gravity', 'active_joints', 'joint_topic'})
        content['joints'] = [joint.for_digest() for joint in self.spec.joints]
        content['gauges'] = [gauge.for_digest() for gauge in self.spec.gauges]
        if self.spec.couplings is not None:
            content['couplings'] = self.spec.couplings.model_dump(mode='json')
        model = self.full_model
        content['tree'] = [
            [model.names[i], int(model.parents[i]), model.joints[i].shortname(),
             _rounded(model.jointPlacements[i].homogeneous),
             _rounded(joint_axis(model, model.names[i]))]
            for i in range(1, model.njoints)]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _rounded(values: NDArray[np.float64]) -> Any:
    # + 0.0 turns the -0.0 that one platform rounds to and another does not into 0.0
    return (np.round(values, 9) + 0.0).tolist()


MAX_YAML_BYTES = 2_000_000


def arm_from_dict(content: Any, *, base: Path, source: str) -> Arm:
    """
    Check a description and build its models.

    Parameters
    ----------
    content : dict
        The description as it stands in YAML.
    base : Path
        Directory that file names in the description are relative to.
    source : str
        Where the description came from, for messages.

    Raises
    ------
    ArmError
        If a key is unknown or missing, a value impossible, or the kinematics do not fit.

    """
    if not isinstance(content, dict):
        raise ArmError(f'{source}: expected a YAML mapping with name, kinematics and joints')
    names = [spelled(content, path) for path in open_values(content)]
    if names:
        more = f' and {len(names) - SHOWN} more' if len(names) > SHOWN else ''
        msg = f'still {OPEN!r}: {", ".join(name[:100] for name in names[:SHOWN])}{more}'
        raise ArmError(msg, place=source, remedy=(
            f'replace each {OPEN!r} by a value; docs/reference/arm_yaml.md says what each key '
            'means'))
    try:
        spec = ArmSpec.model_validate(content)
    except ValidationError as err:
        raise ArmError(f'{source}: ' + validation_message(
            err, '; add it, as docs/reference/arm_yaml.md shows')) from None
    model, urdf, notes = build_model(spec, base, source)
    return Arm(spec, model, source, urdf, notes)


def load_arm(path: str | Path) -> Arm:
    """
    Read an arm description.

    Parameters
    ----------
    path : str or Path
        YAML file, see ``config/tudor.yaml``.

    Raises
    ------
    ArmError
        If the file cannot be read or is wrong; the message names file, key and expectation.

    """
    check_type(path, (str, Path), 'path', 'the path of a YAML file')
    path = Path(path)
    text = read_text(path, MAX_YAML_BYTES, 'the arm description', ArmError,
                     'check the path, or write one with `tudor init`')
    try:
        content = load_yaml(text)
    except YamlError as err:
        raise ArmError(str(err), place=path, remedy='correct it') from None
    arm = arm_from_dict(content, base=path.parent, source=str(path))
    for note in arm.notes:
        warnings.warn(f'{path}: {note}', TudorWarning, stacklevel=2)
    return arm


def sources(arm: Arm) -> Iterator[tuple[str, SourceSpec]]:
    """Give where the efforts of the active joints and the readings of the gauges come from."""
    for joint in arm.joints:
        yield joint.name, joint.effort
    for gauge in arm.gauges:
        yield gauge.name, gauge


def by_topic(sources: Iterable[SourceSpec]) -> dict[str, list[int]]:
    """Give the places of sources in their list by topic."""
    found: dict[str, list[int]] = {}
    for place, source in enumerate(sources):
        found.setdefault(source.topic, []).append(place)
    return found


def array_places(arm: Arm) -> dict[str, dict[str, int]]:
    """Give the topics that carry arrays."""
    found: dict[str, dict[str, int]] = {}
    for name, source in sources(arm):
        if source.index is not None:
            found.setdefault(source.topic, {})[name] = source.index
    return found


def refuse_interfaces(arm: Arm, who: str, *, arrays: bool = False) -> None:
    """Refuse an arm whose efforts or strains come in messages that a program does not read."""
    taken = 'JointState and Float64MultiArray' if arrays else 'JointState'
    for name, source in sources(arm):
        if source.interface is not None or (source.index is not None and not arrays):
            kind = 'Float64MultiArray' if source.interface is None else 'DynamicJointState'
            raise ArmError(
                f'{name} comes on {source.topic} as {kind}, but {who} supports only {taken}',
                place=arm.source, remedy='publish JointState, and name its topic in this file')
