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

"""Friction terms for each joint: added one after the other, as long as left-out parts pay."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from tudor_dynamics.arm import JointSpec
from tudor_dynamics.identification.choice.left_out import LeftOut, paid
from tudor_dynamics.typing import FloatArray

ROUNDS = 3
"""Additions that a joint may get."""
SWITCHES = (0.05, 0.25, 5.0)
"""Speeds of the smoothed sign that are tried, in that of the description."""
TERMS = ('load', 'offset', 'stribeck', 'cube_root', 'square')
"""Terms that are tried beside viscous and Coulomb friction, and presliding."""
DISTANCES = (3e-4, 1e-3, 3e-3, 1e-2, 3e-2)
"""Displacements over which friction is tried to give way [rad or m]."""
Change = Mapping[str, Any]


def choices_of(joint: JointSpec) -> dict[str, Any]:
    """Give all keys of a joint that a choice of its friction sets."""
    return {key: getattr(joint, key) for key in (
        'friction', 'asymmetric', 'friction_velocity', 'presliding_distances')}


def is_open(joint: JointSpec) -> bool:
    """Say whether the description leaves the friction terms of a joint to be chosen."""
    return not joint.model_fields_set & {'friction', 'asymmetric'}


def additions(joint: JointSpec, left_out: Collection[str]) -> dict[str, Change]:
    """
    Give what may be added to the friction of a joint, by its name.

    Returns an empty dict where all is fixed.
    """
    found: dict[str, Change] = {}
    if is_open(joint):
        for term in TERMS:
            if term in left_out or term in joint.friction or (
                    term == 'offset' and joint.asymmetric):
                continue
            found[term] = {'friction': (*joint.friction, term)}
        for distance in () if 'presliding' in left_out else DISTANCES:
            if distance not in joint.bristles:
                found[f'presliding {distance:g}'] = {
                    'friction': tuple(dict.fromkeys((*joint.friction, 'presliding'))),
                    'presliding_distances': tuple(sorted((*joint.bristles, distance)))}
        if not joint.asymmetric:
            found['asymmetric'] = {'asymmetric': True, 'friction': tuple(
                term for term in joint.friction if term != 'offset')}
    if 'friction_velocity' not in joint.model_fields_set:
        for factor in SWITCHES:
            found[f'switch {factor:g}'] = {
                'friction_velocity': JointSpec.model_fields['friction_velocity'].default * factor}
    return found


def all_candidates(
    joints: Sequence[JointSpec], left_out: Collection[str],
) -> list[JointSpec]:
    """Give the joints with all friction that can come out, for the rows to have its columns."""
    found = []
    for joint in joints:
        changes = additions(joint, left_out).values()
        for one in (joint, *(_changed(joint, change) for change in changes
                             if 'friction_velocity' in change)):
            found.append(one)
            if is_open(joint):
                every = _changed(one, {'friction': (*joint.friction, *(
                    term for term in TERMS if term not in left_out))})
                found += [every, _changed(every, {'asymmetric': True})]
        if is_open(joint) and 'presliding' not in left_out:
            found.append(_changed(joint, {'friction': ('presliding',),
                                          'presliding_distances': DISTANCES}))
    return found


def _changed(joint: JointSpec, change: Change) -> JointSpec:
    # what was open stays open: what is tried does not count as described
    content = {**{name: getattr(joint, name) for name in JointSpec.model_fields}, **change}
    return JointSpec.model_construct(_fields_set=set(joint.model_fields_set), **content)


def choose_friction(
    left_out: LeftOut, joints: Sequence[JointSpec], without: Collection[str], *,
    shared: bool, constants: FloatArray | None,
) -> list[JointSpec]:
    """
    Add friction terms to joints whose left-out errors clearly pay for them.

    All open joints are given the same addition at once, since friction shows in its own joint:
    one fit to each part tells for every joint whether it pays there.

    constants (channels,).
    """
    current = list(joints)

    def errors(candidate: Sequence[JointSpec]) -> FloatArray:
        return left_out.errors(candidate, shared=shared, constants=constants)

    for _ in range(ROUNDS):
        left_out.assume(left_out.fitted(current, shared=shared)[0])
        base = errors(current)
        options = [additions(joint, without) for joint in current]
        best: dict[int, tuple[float, JointSpec]] = {}
        for name in dict.fromkeys(name for option in options for name in option):
            candidate = [_changed(joint, option[name]) if name in option else joint
                         for joint, option in zip(current, options, strict=True)]
            found = errors(candidate)
            for i, option in enumerate(options):
                if name in option and candidate[i] != current[i] and paid(
                        base[:, i], found[:, i]):
                    gain = float(found[:, i].sum())
                    if i not in best or gain < best[i][0]:
                        best[i] = gain, candidate[i]
        chosen = [best[i][1] if i in best else joint for i, joint in enumerate(current)]
        if not best or not errors(chosen).sum() < base.sum():
            break
        current = chosen
    return current
