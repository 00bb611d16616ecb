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

"""Units of outputs and of parameters, for tables and model files."""

from __future__ import annotations

from tudor_dynamics.arm import Arm
from tudor_dynamics.models.base_parameters import PAYLOAD

_BODY = {'m': 'kg', 'mx': 'kg m', 'my': 'kg m', 'mz': 'kg m', 'Ia': 'kg m^2'}
_FRICTION = {'viscous': '{f} s/{x}', 'coulomb': '{f}', 'offset': '{f}', 'stribeck': '{f}',
             'cube_root': '{f} (s/{x})^(1/3)', 'square': '{f} (s/{x})^2', 'load': '1',
             'presliding': '{f}'}


def output_units(arm: Arm, output: str) -> dict[str, str]:
    """Give the unit of each channel of an output."""
    if output == 'effort':
        return {joint.name: joint.effort.unit for joint in arm.joints}
    return {gauge.name: gauge.unit for gauge in arm.gauges}


def parameter_unit(column: str, unit: str, *, scaled: bool, prismatic: bool) -> str:
    """Give the unit of a parameter."""
    kind = _kind(column)
    force, length = ('N', 'm') if prismatic else ('N m', 'rad')
    if kind in _FRICTION:
        return _FRICTION[kind].format(f=unit, x=length)
    if kind == 'Ia' and prismatic:
        body = 'kg'
    else:
        body = _BODY.get(kind, 'kg m^2')
    return f'{body} ({unit})/({force})' if scaled else body


def column_unit(arm: Arm, output: str, channels: tuple[str, ...], column: str) -> str:
    """Give the unit of a parameter of an arm's model."""
    if column.startswith(PAYLOAD):
        return column_unit(arm, output, channels, column.removeprefix(PAYLOAD)) + ' / kg'
    if output == 'strain':
        unit = output_units(arm, output)[channels[0]]
        return unit if column == 'offset' else parameter_unit(
            column, unit, scaled=unit != 'N m', prismatic=False)
    owner = column.partition('(')[2][:-1]
    name = owner if owner in channels else channels[0]
    efforts = {joint.name: joint.effort for joint in arm.joints}
    effort, prismatic = efforts[name], arm.is_prismatic(name)
    absolute = effort.torque_constant is not None or (
        _kind(column) not in _FRICTION and any(
            efforts[other].unit != 'A' or efforts[other].torque_constant is not None
            for other in channels))
    if absolute:
        return parameter_unit(column, 'N' if prismatic else 'N m', scaled=False,
                              prismatic=prismatic)
    return parameter_unit(column, effort.unit, scaled=effort.unit == 'A', prismatic=prismatic)


def _kind(column: str) -> str:
    """Give what a parameter is, without its joint, direction or displacement."""
    return column.partition('(')[0].partition('@')[0].rstrip('+-')
