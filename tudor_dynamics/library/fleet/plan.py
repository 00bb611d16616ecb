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

"""The plan of a fleet: which arms, their bags by date."""

from __future__ import annotations

import datetime
from pathlib import Path

from pydantic import Field, field_validator, ValidationError

from tudor_dynamics.arm.fields import Name, Spec
from tudor_dynamics.arm.loading import validation_message
from tudor_dynamics.bounded_yaml import load_yaml
from tudor_dynamics.errors import UsageError
from tudor_dynamics.files import read_bounded

LARGEST = 5_000_000
"""Bytes of a plan."""
FORBIDDEN = '/\\\0'
"""Characters that the name of a folder cannot have."""


class FleetArm(Spec):
    """One arm of the fleet."""

    name: Name
    """What it is called, on the page and in the names of folders."""
    arm: Name | None = None
    """Its description, where it is not that of all; relative to the plan."""
    bags: dict[datetime.date, Name | tuple[Name, ...]] = Field(min_length=1, max_length=10_000)
    """Date to bags, folders of bags or patterns; relative to the plan."""

    @field_validator('name')
    @classmethod
    def _is_a_folder(cls, name: str) -> str:
        if any(letter in name for letter in FORBIDDEN) or name.startswith('.'):
            raise ValueError(f'{name!r} is no name of a folder')
        return name

    @property
    def dates(self) -> list[datetime.date]:
        """Give the dates in their order."""
        return sorted(self.bags)

    def named(self, date: datetime.date) -> tuple[str, ...]:
        """
        Give what stands at a date.

        Parameters
        ----------
        date : date
            One of the arm's dates.

        """
        bags = self.bags[date]
        return (bags,) if isinstance(bags, str) else bags


class FleetPlan(Spec):
    """A whole plan."""

    name: Name = 'fleet'
    """What the fleet is called."""
    arm: Name | None = None
    """Description of the arms; relative to the plan."""
    arms: tuple[FleetArm, ...] = Field(min_length=1, max_length=10_000)
    """The arms."""

    @field_validator('arms')
    @classmethod
    def _have_own_names(cls, arms: tuple[FleetArm, ...]) -> tuple[FleetArm, ...]:
        names = [arm.name for arm in arms]
        twice = next((name for name in names if names.count(name) > 1), None) if (
            len({*names}) < len(names)) else None
        if twice is not None:
            raise ValueError(f'two arms are called {twice!r}')
        return arms


def load_plan(path: Path) -> FleetPlan:
    """
    Read the plan of a fleet.

    Parameters
    ----------
    path : Path
        YAML file, see docs/fleet.md.

    Returns
    -------
    FleetPlan
        Checked plan, in which every arm has a description.

    Raises
    ------
    UsageError
        If it cannot be read or is wrong; the message names file, key and expectation.

    """
    remedy = 'docs/fleet.md describes a plan'
    try:
        plan = FleetPlan.model_validate(load_yaml(read_bounded(path, LARGEST).decode()))
    except OSError as err:
        raise UsageError(f'the plan cannot be read ({err.strerror})', place=path,
                         remedy='check the path') from None
    except ValidationError as err:
        raise UsageError(validation_message(err), place=path, remedy=remedy) from None
    except ValueError as err:
        raise UsageError(str(err), place=path, remedy=remedy) from None
    lacking = [arm.name for arm in plan.arms if arm.arm is None]
    if plan.arm is None and lacking:
        raise UsageError(f'there is no description of {lacking[0]}', place=path,
                         remedy='give arm: my_arm.yaml, for all or for this one')
    return plan
