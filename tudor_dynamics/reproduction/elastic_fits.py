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

"""
Elastic models of a campaign: identified from a few recordings, each from where the last ended.

The search simulates the arm along all it learns from, hundreds of times, so it is given a part of
the training stimuli only; it is judged by all the test stimuli, as the other models are. Payload
after payload is the same arm with another mass at the tip: each search begins with what was found
for the next heavier one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tudor_dynamics.arm import Arm
from tudor_dynamics.identification.collisions.free_motion import fit_thresholds
from tudor_dynamics.identification.dataset import BagData, common_outputs
from tudor_dynamics.identification.elastic.trainer import ElasticTrainer
from tudor_dynamics.identification.validation import validate, Validation
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.reproduction.result_cache import Cached
from tudor_dynamics.typing import Progress


KIND = 'elastic'
FOUND = 'identified'
"""Key of the physical parameters in the content of a stage."""


def stimuli_for_search(count: int, seconds: float, limit: float) -> int:
    """
    Say how many training stimuli the search is given.

    Parameters
    ----------
    count : int
        Training stimuli there are.
    seconds : float
        Length of each [s].
    limit : float
        Length of all that the search is given [s].

    Returns
    -------
    int
        At least one.

    """
    return min(count, max(1, int(limit / seconds + 1e-9)))


class ElasticFit:
    """
    Elastic models of strain and effort, from one search.

    Parameters
    ----------
    arm : Arm
        Arm that was recorded.
    training : sequence of BagData
        Recordings to learn from.
    warm : mapping of str to float, optional
        Physical parameters where the search begins.
    payloads : (float, float), optional
        Least and largest payload, for one model of all between [kg].
    progress : callable
        Told what is done next.

    """

    def __init__(
        self, arm: Arm, training: Sequence[BagData], warm: Mapping[str, float] | None,
        payloads: tuple[float, float] | None = None, progress: Progress = lambda _: None,
    ) -> None:
        self.arm = arm
        trainer = ElasticTrainer(arm, payloads, progress, warm)
        self.models = {output: trainer.fit(training, output)
                       for output in common_outputs(training)}
        assert trainer.identified is not None
        self.found = {parameter.name: parameter.value
                      for parameter in trainer.identified.physical}

    def judge(self, bags: Sequence[BagData]) -> dict[str, Validation]:
        """Give each output's figures and traces on some recordings."""
        return {output: validate(model, bags, output, '')
                for output, model in self.models.items()}

    def bundle(self, bags: Sequence[BagData]) -> ModelBundle:
        """Give the models as nodes load them, with thresholds learned on free recordings."""
        preprocessing = self.arm.spec.preprocessing
        thresholds = fit_thresholds(
            [(output, KIND, seen.cases) for output, seen in self.judge(bags).items()],
            preprocessing)
        return ModelBundle(self.arm, preprocessing, {
            output: {KIND: model} for output, model in self.models.items()},
            {'thresholds': thresholds})


def merged(first: Cached, second: Cached) -> Cached:
    """
    Put the figures of more kinds of models beside those of some.

    Parameters
    ----------
    first, second : Cached
        ``content[output][kind]``, and arrays on the same recording.

    Returns
    -------
    Cached
        Both; what is not by output is that of the first where both have it.

    """
    content: dict[str, Any] = dict(first.content)
    for name, value in second.content.items():
        known = content.get(name)
        content[name] = {**known, **value} if isinstance(known, dict) else known or value
    return Cached(content, {**second.arrays, **first.arrays})
