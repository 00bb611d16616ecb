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

"""What the joints of a controlled arm do."""

from __future__ import annotations

from enum import IntEnum


class State(IntEnum):
    """What the joints do, and why not more."""

    HOLDING = 0
    """They stand, or brake to where they will: there is no reference that may be followed."""
    FOLLOWING = 1
    """They follow the reference."""
    FAULT = 2
    """They stand until they are told to begin anew: encoders cannot be believed."""
