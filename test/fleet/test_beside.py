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

"""Whose model has aged: errors that grow, and by more than those of the others."""

from __future__ import annotations

from tudor_dynamics.fleet.comparison import named_aged
from tudor_dynamics.identification.next_steps import change_of


def grown(factors: list[float]) -> list[str]:
    """Let the errors of arms grow by factors, and give those that are named."""
    changes = {f'arm_{i}': [change_of(('effort', 'analytical', 'elbow'), (0.1, 0.1 * factor),
                                      (0.03, 0.03 * factor), (0.05, 0.05))]
               for i, factor in enumerate(factors)}
    return [item.arm for item in named_aged(changes)]


def test_a_model_that_has_aged_is_named() -> None:
    """One whose errors double among others that stay, and none where nobody's grow."""
    assert grown([1.0, 1.05, 2.2, 0.95, 1.02]) == ['arm_2']
    assert grown([1.0, 1.05, 1.1, 0.95, 1.02]) == []


def test_what_all_have_in_common_is_no_age() -> None:
    """A motion that no model knows lets all errors grow; two arms are judged each alone."""
    assert grown([2.0, 2.1, 2.2, 1.9, 2.05]) == []
    assert grown([1.0, 2.2]) == ['arm_1']
    assert grown([]) == []
