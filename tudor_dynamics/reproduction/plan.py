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

"""What is recorded and fitted for the table and the figures, and with what it is recorded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
import os
from pathlib import Path
import shutil
from typing import Any

from tudor_dynamics.arm import Arm, load_arm
from tudor_dynamics.errors import UsageError
from tudor_dynamics.models.kinds import KINDS
from tudor_dynamics.reproduction.result_cache import RECORDING, ResultCache
from tudor_dynamics.simulation.loop.campaign import record_stimuli, StimulusSpec
from tudor_dynamics.simulation.loop.closed_loop import ClosedLoop
from tudor_dynamics.simulation.loop.signals import with_payload
from tudor_dynamics.simulation.loop.stimulus_motion import stimulus_seeds

QUICK_KINDS = ('analytical', 'elm')
"""Kinds of models that are fitted in a second."""
Progress = Callable[[str, float], None]
"""Told what is done now, and how much of it (0 to 1)."""


@dataclass(frozen=True)
class Plan:
    """
    Size of a reproduction.

    Attributes
    ----------
    arm : str
        Path of the arm description.
    payloads : tuple of float
        Masses at the tip [kg].
    stimuli : int
        Recordings a payload, half of them for training.
    seconds : float
        Length of each [s].
    seed : int
        Of motions, noise and pushes.
    pushes : int
        In each recording with collisions.
    jobs : int
        Processes that record.
    kinds : tuple of str
        Kinds of models.
    elastic_seconds : float
        Recordings that an elastic model is identified from, at most [s].

    """

    arm: str
    payloads: tuple[float, ...] = (0.0, 0.1, 0.2, 0.3, 0.4)
    stimuli: int = 10
    seconds: float = 80.0
    seed: int = 0
    pushes: int = 6
    jobs: int = field(default_factory=lambda: os.cpu_count() or 1)
    kinds: tuple[str, ...] = tuple(KINDS)
    elastic_seconds: float = 160.0

    def quick(self) -> Plan:
        """Give a small one that takes seconds, to see that all of it works."""
        # one process: starting others takes longer than so little takes to compute
        return Plan(self.arm, (0.0, 0.2, 0.4), 2, 12.0, self.seed, 1, 1,
                    tuple(kind for kind in self.kinds if kind in QUICK_KINDS))


def grams(payload: float) -> str:
    """Write a payload for a name."""
    return f'{1000.0 * payload:.0f}g'


def arm_content(arm: Arm) -> dict[str, Any]:
    """Give all of a description that a recording may depend on."""
    return {'spec': arm.spec.model_dump(mode='json'), 'urdf': arm.urdf}


@dataclass(eq=False)
class Campaign:
    """
    The recordings of a plan.

    Attributes
    ----------
    plan : Plan
        Size of the campaign.
    stages : ResultCache
        Where they are kept.
    progress : callable
        Told what is done.

    """

    plan: Plan
    stages: ResultCache
    progress: Progress = lambda text, share: None  # noqa: E731

    def __post_init__(self) -> None:
        """Read the arm, and refuse one that cannot be simulated."""
        self.arm = load_arm(self.plan.arm)
        if not self.arm.gauges:
            msg = f'{self.plan.arm}: the arm has no gauges; the papers are about strains'
            raise UsageError(msg)
        ClosedLoop(self.arm)  # says what the description lacks

    def described(self, payload: float, *, damped: bool) -> dict[str, Any]:
        """
        Give what the recordings of a payload depend on.

        Parameters
        ----------
        payload : float
            Mass at the tip [kg].
        damped : bool
            Whether the damper is on.

        """
        plan = self.plan
        return {'arm': arm_content(self.arm), 'payload': payload, 'damped': damped,
                'seconds': plan.seconds, 'stimuli': plan.stimuli, 'seed': plan.seed}

    def record(self, payload: float, *, damped: bool = True, pushes: int = 0) -> list[Path]:
        """
        Record what is not recorded yet.

        Parameters
        ----------
        payload : float
            Mass at the tip [kg].
        damped : bool, default=True
            With the damper.
        pushes : int, default=0
            Pushes a recording; their recordings have motions of their own.

        Returns
        -------
        list of Path
            Bags, one a stimulus.

        """
        plan = self.plan
        name = f'bags_{grams(payload)}_{"damped" if damped else "undamped"}'
        depends: dict[str, Any] = self.described(payload, damped=damped)
        del depends['stimuli']  # each bag is kept for itself
        if pushes:
            name, depends = f'{name}_pushed', {**depends, 'pushes': pushes}
        folder = self.stages.folder(name, depends, RECORDING)
        paths = [folder / f'stimulus_{k + 1:02d}' for k in range(plan.stimuli)]
        missing = [k for k, path in enumerate(paths) if not path.exists()]
        # motions differ between payloads, so that a model of all of them has seen none of these
        seed = plan.seed + round(1000.0 * payload) + (7919 if pushes else 0)
        specs = []
        for number in missing:
            motion, noise, push = stimulus_seeds(seed, number)
            specs.append(StimulusSpec(payload, plan.seconds, 100.0, 1.0 if damped else 0.0,
                                      'aprbs', motion, noise, push, pushes))
        text = (f'record {grams(payload)}, {"damped" if damped else "undamped"}'
                f'{", pushed" if pushes else ""}')
        self.progress(text, 0.0)
        if specs:
            steps = len(specs) * plan.seconds * self._rate()
            record_stimuli(plan.arm, specs, [paths[k] for k in missing], plan.jobs,
                           lambda done: self.progress(text, done / steps))
        for scratch in folder.glob('.stimulus_*'):  # of a run that was interrupted
            shutil.rmtree(scratch, ignore_errors=True)
        self.progress(text, 1.0)
        return paths

    def _rate(self) -> float:
        assert self.arm.spec.damper is not None  # ClosedLoop has seen to that
        return float(self.arm.spec.damper.rate)

    def carrying(self, payload: float) -> Arm:
        """Give the arm with a payload."""
        return with_payload(self.arm, payload)
