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


@dataclass(frozen=True)
class Simple:
    """
    Friction as most programs know it.

    Attributes
    ----------
    damping : float
        Torque for each unit of speed, the mean of both directions [N m s/rad or N s/m].
    friction : float
        Torque against the motion at any speed, likewise [N m or N].
    left_out : tuple of str
        Terms that the two do not express.

    """

    damping: float
    friction: float
    left_out: tuple[str, ...]


def simple_friction(terms: dict[str, float]) -> Simple:
    """
    Bring friction to the two numbers that URDF and MJCF have for it.

    Parameters
    ----------
    terms : dict of str to float
        Terms of a joint, as ``FullParameters.drives`` gives them.

    Returns
    -------
    Simple
        Damping and friction.

    """
    known = {'Ia', *(f'{term}{way}' for term in ('viscous', 'coulomb') for way in ('', '+', '-'))}
    means = {term: sum(both_ways(terms, term)) / 2.0 for term in ('viscous', 'coulomb')}
    return Simple(max(0.0, means['viscous']), max(0.0, means['coulomb']), (
        *(f'{term} below zero' for term, value in means.items() if value < 0.0),
        *(term for term, value in terms.items() if term not in known and value != 0.0)))


def both_ways(terms: dict[str, float], term: str) -> tuple[float, float]:
    """
    Give a coefficient of friction for each direction, positive where it takes energy.

    Parameters
    ----------
    terms : dict of str to float
        Terms of a joint, as for `simple_friction`.
    term : {'viscous', 'coulomb'}
        Which.

    Returns
    -------
    (float, float)
        Forward and backward; the same where they were not told apart, 0 where there is none.

    """
    if f'{term}+' not in terms:
        return terms.get(term, 0.0), terms.get(term, 0.0)
    # the Coulomb coefficient of the backward direction is that of a constant, not of its size
    return terms[f'{term}+'], terms[f'{term}-'] * (-1.0 if term == 'coulomb' else 1.0)
