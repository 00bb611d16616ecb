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

"""What models learn from: blocks of motion with their outputs, checked."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from tudor_dynamics.errors import FitError
from tudor_dynamics.signals.preprocessing import Decimation, Stretch
from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True, eq=False)
class TrainingBlock:
    """Motion and the outputs that belong to it."""

    # `[q, dq, ddq]` of the active joints, in columns, (samples, 3 joints)
    # [rad, rad/s, rad/s^2 or m, m/s, m/s^2].
    motion: FloatArray
    output: FloatArray  # measured outputs after decimation, (kept, channels)
    # Brings rows of `motion` to rows of `output`; None where they belong together as is.
    decimation: Decimation | None = None


Blocks = Callable[[], Iterable[TrainingBlock]]
Inputs = Callable[[Stretch], FloatArray]
"""What a model takes of a stretch, a row a sample."""


def block_of(motion: FloatArray, output: FloatArray) -> Blocks:
    """
    Wrap two arrays as training data of one block, after a check of their shapes.

    output (samples, channels) [its unit]; motion (samples, inputs): ``[q, dq, ddq]`` and what else
    the model takes, in columns.
    """
    motion, output = np.asarray(motion, dtype=float), np.asarray(output, dtype=float)
    if motion.ndim != 2 or output.ndim != 2 or len(motion) != len(output):
        msg = (f'motion has shape {motion.shape} and output {output.shape}; expected '
               '(n_samples, 3 n_joints) and (n_samples, n_channels)')
        raise FitError(msg)
    if not (np.all(np.isfinite(motion)) and np.all(np.isfinite(output))):
        msg = 'motion or output has values that are not finite; leave such samples out'
        raise FitError(msg)
    return lambda: [TrainingBlock(motion, output)]


def check_block(block: TrainingBlock, n_inputs: int | None, channels: tuple[str, ...]) -> None:
    """
    Refuse a block whose columns are not those of the model.

    n_inputs: None where the model takes any number.
    """
    if n_inputs is not None:
        check_motion(block.motion, n_inputs)
    if block.output.ndim != 2 or block.output.shape[1] != len(channels):
        msg = (f'output has shape {block.output.shape}; expected (n_samples, {len(channels)}) for '
               f'the channels {list(channels)}')
        raise FitError(msg)


def check_motion(motion: FloatArray, n_inputs: int, fewer: int | None = None) -> None:
    """
    Refuse motion whose columns are not those of the model.

    motion (samples, inputs): ``[q, dq, ddq]`` and what else the model takes, in columns.
    """
    if motion.ndim != 2 or motion.shape[1] not in (n_inputs, fewer):
        msg = (f'motion has shape {motion.shape}; expected (n_samples, {n_inputs}): positions, '
               f'velocities, accelerations of {n_inputs // 3} joints')
        raise FitError(msg)
