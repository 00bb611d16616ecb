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

"""Friction as most programs know it: damping, and a torque against the motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import optimize

from tudor_dynamics.arm.schema import JointSpec
from tudor_dynamics.models.consistent.full import FullParameters
from tudor_dynamics.models.friction import friction_columns, friction_names

SPEEDS = 20
"""Evenly over those of a joint, at which friction is compared, in each direction."""
WITHOUT = {'offset': 'offset', 'load': 'load, but for its mean'}
"""Terms that two numbers have no place for, and what is said of them."""
CLOSE = 0.01
"""Part of friction by which two numbers may miss it without a word."""


@dataclass(frozen=True)
class Simple:
    """Friction as most programs know it."""

    damping: float  # torque for each unit of speed, both ways [N m s/rad or N s/m]
    friction: float  # torque against the motion at any speed, likewise [N m or N]
    left_out: tuple[str, ...]  # what the two do not express, one phrase each


def simple_friction(
    joint: JointSpec, terms: dict[str, float], speed: float, load: float = 0.0,
) -> Simple:
    """
    Bring friction to the two numbers that URDF and MJCF have for it.

    Those that are nearest to all of its terms over the speeds of the joint, both ways, and take
    energy: where viscous and Coulomb friction are all there is, these, or their means.

    speed [rad/s or m/s], load [N m or N].
    """
    forward = np.linspace(0.0, speed, SPEEDS + 1)[1:]
    speeds = np.concatenate([-forward, forward])
    names = [name.partition('(')[0] for name in friction_names(joint)]
    own = np.array([0.0 if name == 'offset' else terms.get(name, 0.0) for name in names])
    wanted = friction_columns(joint, speeds, np.full(len(speeds), load)) @ own
    pair = joint.model_copy(update={'friction': ('viscous', 'coulomb'), 'asymmetric': False})
    columns = friction_columns(pair, speeds)
    (damping, friction), _ = optimize.nnls(columns, wanted)
    size = float(np.linalg.norm(wanted))
    missed = float(np.linalg.norm(columns @ (damping, friction) - wanted))
    return Simple(float(damping), float(friction), (
        *(words for name, words in WITHOUT.items() if terms.get(name)),
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
    # the Coulomb coefficient of the backward direction is that of a constant, not of its size
    return terms[f'{term}+'], terms[f'{term}-'] * (-1.0 if term == 'coulomb' else 1.0)
