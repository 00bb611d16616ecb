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

"""Arm description: YAML, URDF or D-H table to a Pinocchio model, joints, gauges, units."""

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.loading import arm_from_dict, load_arm
from tudor_dynamics.arm.schema import ArmSpec, GaugeSpec, JointSpec, PreprocessingSpec

__all__ = ['Arm', 'ArmSpec', 'GaugeSpec', 'JointSpec', 'PreprocessingSpec', 'arm_from_dict',
           'load_arm']
