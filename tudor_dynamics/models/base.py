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

"""What every model of outputs offers, whatever is inside."""

from __future__ import annotations

from typing import Protocol

from tudor_dynamics.typing import FloatArray


class OutputModel(Protocol):
    """A model that gives outputs for motion."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the outputs."""

    def predict(self, motion: FloatArray) -> FloatArray:
        """
        Predict outputs, shape (n_samples, n_channels), for ``[q, dq, ddq]``.

        Parameters
        ----------
        motion : ndarray of shape (n_samples, 3 n_joints)
            ``[q, dq, ddq]`` of the active joints, in columns [rad, rad/s, rad/s^2 or m, m/s,
            m/s^2].

        """
