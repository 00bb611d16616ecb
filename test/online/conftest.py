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

"""Thresholds that several tests use."""

from __future__ import annotations

import pytest
from threshold_making import CHANNELS, ringing

from tudor_dynamics.online.threshold_learning import learn_thresholds
from tudor_dynamics.online.thresholds import MethodThresholds


@pytest.fixture(scope='package')
def learned() -> MethodThresholds:
    """Learn thresholds from 240 s of ringing."""
    return learn_thresholds([ringing(120, 1), ringing(120, 2)], CHANNELS)
