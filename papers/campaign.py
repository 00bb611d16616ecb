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
A campaign: what is recorded, with which arm, and the results that are kept.

The name of a kept result's directory ends in a digest of all that it depends on: settings, arm and
the sources that compute it. Another digest is another directory, so that nothing out of date is
ever taken for a result; what was left under older digests is removed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
import hashlib
import io
import json
import os
from pathlib import Path
import shutil
from typing import Any
import warnings

import numpy as np
from numpy.typing import NDArray
import tudor_dynamics as td

FloatArray = NDArray[np.float64]
Progress = Callable[[str, float], None]
"""Called with what is done now, and how much of it (0 to 1)."""
OUTPUTS = ('strain', 'effort')
KINDS = {'analytical': 'analytical', 'elm': 'ELM', 'elastic': 'elastic'}
"""Kinds of models, and what tables and legends call them."""
ELASTIC = 'elastic'
QUICK_KINDS = ('analytical', 'elm')
"""Kinds that are fitted in a second, from single samples."""
MIXED_KINDS = ('analytical', 'elm')
"""Kinds of them that know of the payload."""
HERE = Path(__file__).parent


@dataclass(frozen=True, eq=False)
class Cached:
    """What was computed: figures as plain values, and signals by name."""

    content: dict[str, Any]
    arrays: dict[str, FloatArray] = field(default_factory=dict)


@lru_cache
def source_digest(*, study: bool) -> str:
    """Give a digest of the library's sources, and of those of this study as well."""
    folders = [Path(td.__file__).parent, *([HERE] if study else [])]
    digest = hashlib.sha256()
    for folder in folders:
        for file in sorted(folder.rglob('*.py')):
            digest.update(f'{file.relative_to(folder)}\n'.encode() + file.read_bytes())
    return digest.hexdigest()


class ResultCache:
    """Results below a directory, which is made where it is not there."""

    def __init__(self, root: str | Path) -> None:
        self.root = Path(root) / 'stages'
        if self.root.exists() and not self.root.is_dir():
            raise td.TudorError(f'{self.root}: is no directory', remedy='give another --out')
        self.root.mkdir(parents=True, exist_ok=True)

    def folder(self, name: str, depends: dict[str, Any], *, study: bool = False) -> Path:
        """Give the directory of a result, which may not be there yet."""
        text = json.dumps({**depends, 'source': source_digest(study=study)}, sort_keys=True)
        path = self.root / f'{name}-{hashlib.sha256(text.encode()).hexdigest()[:12]}'
        for other in self.root.glob(f'{name}-' + 12 * '[0-9a-f]'):
            if other != path:
                shutil.rmtree(other)
        return path

    def result(self, name: str, depends: dict[str, Any], make: Callable[[], Cached]) -> Cached:
        """Compute a result, or read what was computed before."""
        path = self.folder(name, depends, study=True)
        try:  # one that cannot be read is computed again
            content = json.loads((path / 'result.json').read_text(encoding='utf-8'))
            with np.load(path / 'arrays.npz', allow_pickle=False) as file:
                return Cached(content, {name: file[name] for name in file.files})
        except (OSError, ValueError, EOFError):
            shutil.rmtree(path, ignore_errors=True)
        found = make()
        path.mkdir(parents=True)
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **found.arrays)  # type: ignore[arg-type]
        text = json.dumps(found.content, indent=1, allow_nan=False)
        write_file(path / 'arrays.npz', buffer.getvalue())
        write_file(path / 'result.json', text)  # last: what has it is complete
        # what was written and read again, so that a second run sees the same
        return Cached(json.loads(text), found.arrays)


def write_file(path: Path, content: str | bytes) -> None:
    """Write a file, whole or not at all; one that is there is replaced."""
    part = path.with_name(f'.{path.name}.part')
    try:
        part.write_bytes(content.encode() if isinstance(content, str) else content)
        part.replace(path)
    except OSError as err:
        raise td.TudorError(f'{path}: cannot be written ({err.strerror or err})',
                            remedy='give another --out') from None


@dataclass(frozen=True)
class Plan:
    """Size of a reproduction."""

    arm: str  # path of the arm description
    payloads: tuple[float, ...] = (0.0, 0.1, 0.2, 0.3, 0.4)  # masses at the tip [kg]
    stimuli: int = 10  # recordings a payload, half of them for training
    seconds: float = 80.0  # length of each [s]
    seed: int = 0  # of motions, noise and pushes
    pushes: int = 6  # in each recording with collisions
    jobs: int = field(default_factory=lambda: os.cpu_count() or 1)  # processes that record
    kinds: tuple[str, ...] = tuple(KINDS)  # kinds of models
    elastic_seconds: float = 160.0  # of recordings that a search is given, at most

    def quick(self) -> Plan:
        """Give a small one that takes seconds, to see that all of it works."""
        # one process: starting others takes longer than so little takes to compute
        return Plan(self.arm, (0.0, 0.2, 0.4), 2, 12.0, self.seed, 1, 1,
                    tuple(kind for kind in self.kinds if kind in QUICK_KINDS))


def grams(payload: float) -> str:
    """Write a payload for a name."""
    return f'{1000.0 * payload:.0f}g'


def arm_content(arm: td.Arm) -> dict[str, Any]:
    """Give all of a description that a recording may depend on."""
    return {'spec': arm.spec.model_dump(mode='json'), 'urdf': arm.urdf}


def as_described(arm: td.Arm) -> td.Arm:
    """Leave nothing about friction open, so that every fit takes the terms of the description."""
    return arm.with_joints({joint.name: {
        'friction': joint.friction, 'asymmetric': joint.asymmetric,
        'friction_velocity': joint.friction_velocity} for joint in arm.joints})


def stimulus_seeds(seed: int, stimulus: int) -> tuple[int, int, int]:
    """Give the seeds of motion, noise and pushes of a stimulus."""
    first, second, third = np.random.SeedSequence([seed, stimulus]).generate_state(3).tolist()
    return first, second, third


@dataclass(eq=False)
class Campaign:
    """The recordings of a plan."""

    plan: Plan
    stages: ResultCache  # where they are kept
    progress: Progress = lambda text, share: None  # noqa: E731

    def __post_init__(self) -> None:
        """Read the arm, and refuse one that cannot be simulated."""
        self.arm = as_described(td.load_arm(self.plan.arm))
        if not self.arm.gauges:
            raise td.TudorError('the arm has no gauges', place=self.plan.arm,
                                remedy='the papers are about strains: name another --arm')
        td.ClosedLoop(self.arm)  # says what the description lacks

    def described(self, payload: float, *, damped: bool) -> dict[str, Any]:
        """Give what the recordings of a payload depend on."""
        plan = self.plan
        return {'arm': arm_content(self.arm), 'payload': payload, 'damped': damped,
                'seconds': plan.seconds, 'stimuli': plan.stimuli, 'seed': plan.seed}

    def record(self, payload: float, *, damped: bool = True, pushes: int = 0) -> list[Path]:
        """Record what is not recorded yet."""
        plan = self.plan
        name = f'bags_{grams(payload)}_{"damped" if damped else "undamped"}'
        depends: dict[str, Any] = self.described(payload, damped=damped)
        del depends['stimuli']  # each bag is kept for itself
        if pushes:
            name, depends = f'{name}_pushed', {**depends, 'pushes': pushes}
        folder = self.stages.folder(name, depends)
        paths = [folder / f'stimulus_{k + 1:02d}' for k in range(plan.stimuli)]
        missing = [k for k, path in enumerate(paths) if not path.exists()]
        # motions differ between payloads, so that a model of all of them has seen none of these
        seed = plan.seed + round(1000.0 * payload) + (7919 if pushes else 0)
        specs = []
        for number in missing:
            motion, noise, push = stimulus_seeds(seed, number)
            specs.append(td.StimulusSpec(payload, plan.seconds, 100.0, 1.0 if damped else 0.0,
                                         motion, noise, push, pushes))
        text = (f'record {grams(payload)}, {"damped" if damped else "undamped"}'
                f'{", pushed" if pushes else ""}')
        self.progress(text, 0.0)
        if specs:
            steps = len(specs) * plan.seconds * self._rate()
            td.record_stimuli(plan.arm, specs, [paths[k] for k in missing], plan.jobs,
                              lambda done: self.progress(text, done / steps))
        for scratch in folder.glob('.stimulus_*'):  # of a run that was interrupted
            shutil.rmtree(scratch, ignore_errors=True)
        self.progress(text, 1.0)
        return paths

    def _rate(self) -> float:
        assert self.arm.spec.damper is not None  # ClosedLoop has seen to that
        return float(self.arm.spec.damper.rate)

    def carrying(self, payload: float) -> td.Arm:
        """Give the arm with a payload."""
        return td.with_payload(self.arm, payload)


def hub_gauges(arm: td.Arm) -> list[int]:
    """Give the gauge nearest to each joint: the paper has one pair a link, close to the hub."""
    nearest: dict[str, int] = {}
    for index, gauge in enumerate(arm.gauges):
        known = nearest.get(gauge.joint)
        if known is None or gauge.distance < arm.gauges[known].distance:
            nearest[gauge.joint] = index
    return sorted(nearest.values())


def fit(
    arm: td.Arm, training: Sequence[Path], test: Sequence[Path], settings: td.FitSettings,
    progress: Callable[[str], None] = lambda _: None, *, bare: bool = True,
) -> td.ModelBundle:
    """Learn models, with nothing left to be chosen: estimator, filters and friction are fixed."""
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', UserWarning)  # they are our own recordings
        return td.fit(training, arm, test=test, settings=settings.settled(),
                      preprocessing=arm.spec.preprocessing, bare=bare, progress=progress)


def predict(models: td.ModelBundle, paths: Sequence[Path]) -> Any:
    """Let models predict recordings, also those that they were learned from."""
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', UserWarning)
        return td.predict(models, paths)


def training_and_test(paths: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Split recordings into those for training and those for testing."""
    middle = len(paths) // 2
    return list(paths[:middle]), list(paths[middle:])


def channels(arm: td.Arm, output: str) -> tuple[list[str], list[int]]:
    """Name the channels of an output, and say which the paper has: all joints, hub gauges."""
    if output == 'effort':
        return list(arm.active_joints), list(range(len(arm.active_joints)))
    return list(arm.gauge_names), hub_gauges(arm)


def units(arm: td.Arm, output: str) -> dict[str, str]:
    """Give the unit of each channel of an output."""
    if output == 'effort':
        return {joint.name: joint.effort.unit for joint in arm.joints}
    return {gauge.name: gauge.unit for gauge in arm.gauges}


def figures(
    arm: td.Arm, output: str, measured: FloatArray, predicted: FloatArray,
) -> dict[str, Any]:
    """Judge a prediction as the table does: over the channels that the paper has."""
    names, chosen = channels(arm, output)
    whole = td.score(measured[:, chosen], predicted[:, chosen], [names[i] for i in chosen])
    every = td.score(measured, predicted, names)
    return {'samples': whole.samples, 'rmse': whole.rmse, 'sigma_e': whole.sigma_e,
            'fit': whole.fit, 'fit_printed': whole.fit_printed,
            'channels': {name: {'rmse': item.rmse, 'fit': item.fit}
                         for name, item in every.channels.items()}}


def judged(arm: td.Arm, output: str, traces: Sequence[Any]) -> dict[str, Any]:
    """Judge the traces of several recordings together, as ``figures`` does."""
    return figures(arm, output, np.vstack([item.measured for item in traces]),
                   np.vstack([item.predicted for item in traces]))
