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

"""Field types that all parts of the arm description share."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

LARGEST = 1e15
"""Nothing of an arm comes near it in SI units; products of a few such numbers do not overflow."""
Finite = Annotated[float, Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, le=LARGEST, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, le=LARGEST, allow_inf_nan=False)]
Vector3 = tuple[Finite, Finite, Finite]
Name = Annotated[str, Field(min_length=1, max_length=200)]


class Spec(BaseModel):
    """
    Base of all parts of the description: immutable, no unknown keys.

    The string behind a key describes it, with its unit in brackets at the end of the first
    paragraph; ``docs/arm_yaml.md`` is made of these strings.
    """

    model_config = ConfigDict(extra='forbid', frozen=True, use_attribute_docstrings=True)
