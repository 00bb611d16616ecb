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

"""From the plan of a fleet to its comparison, with a model of each arm."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
import datetime
from functools import lru_cache
import hashlib
from itertools import chain
import json
from pathlib import Path

from pydantic import Field, field_validator, ValidationError

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.arm.schema import Name, Spec, validation_message
from tudor_dynamics.errors import FitError, quiet, TudorError, UsageError
from tudor_dynamics.files import load_yaml, read_bounded, read_text, source_digest, write_whole
from tudor_dynamics.fleet.comparison import (
    aged, Fleet, Measure, measures, Named, named_aged, named_outliers, Observation, parted,
    quantities, Quantity, ring_quantities, rings, stiffness_quantities)
from tudor_dynamics.identification import many_bags
from tudor_dynamics.identification.choice import choices_of, choose
from tudor_dynamics.identification.dataset import (
    BagData, common_outputs, filtered, found_choices, load, spread_sample, SurveyedBag, Unused)
from tudor_dynamics.identification.elastic_problem import records_of
from tudor_dynamics.identification.elastic_search import identify
from tudor_dynamics.identification.fit import check_arm, FitSettings, RowTrainer
from tudor_dynamics.identification.many_bags import (
    fold_models, FoldModels, go_through, Summing, survey, Task)
from tudor_dynamics.identification.next_steps import ErrorChange
from tudor_dynamics.library import fit
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import load_bundle
from tudor_dynamics.models.elastic.model import PhysicalParameter
from tudor_dynamics.parallel import Count, in_processes
from tudor_dynamics.typing import Progress


# -- The plan of a fleet: which arms, their bags by date

LARGEST = 5_000_000  # bytes of a plan


class FleetArm(Spec):
    """One arm of the fleet."""

    name: Name
    """What it is called, on the page and in the names of folders."""
    arm: Name | None = None
    """Its description, where it is not that of all; relative to the plan."""
    bags: dict[datetime.date, Name | tuple[Name, ...]] = Field(min_length=1, max_length=10_000)
    """Date to bags, folders of bags or patterns; relative to the plan."""

    @field_validator('name')
    @classmethod
    def _is_a_folder(cls, name: str) -> str:
        if any(letter in name for letter in '/\\\0') or name.startswith('.'):
            raise ValueError(f'{name!r} cannot name a folder; take letters and digits')
        return name


class FleetPlan(Spec):
    """A whole plan."""

    name: Name = 'fleet'
    """What the fleet is called."""
    arm: Name | None = None
    """Description of the arms; relative to the plan."""
    arms: tuple[FleetArm, ...] = Field(min_length=1, max_length=10_000)
    """The arms."""

    @field_validator('arms')
    @classmethod
    def _have_own_names(cls, arms: tuple[FleetArm, ...]) -> tuple[FleetArm, ...]:
        name, count = Counter(arm.name for arm in arms).most_common(1)[0]
        if count > 1:
            raise ValueError(f'two arms are called {name!r}; give each its own name')
        return arms


def load_plan(path: Path) -> FleetPlan:
    """Read a plan, YAML as in docs/howto/fleet.md; every arm in it has a description."""
    text = read_text(path, LARGEST, 'the plan', UsageError, 'check the path')
    try:
        plan = FleetPlan.model_validate(load_yaml(text))
    except ValueError as err:
        cause = validation_message(err) if isinstance(err, ValidationError) else str(err)
        raise UsageError(cause, place=path,
                         remedy='docs/howto/fleet.md shows a plan') from None
    lacking = [arm.name for arm in plan.arms if arm.arm is None]
    if plan.arm is None and lacking:
        raise UsageError(f'arm {lacking[0]!r} has no description', place=path,
                         remedy='write arm: FILE.yaml in its entry, or at the top for all arms')
    return plan


# -- What is done for each arm of a fleet in a process of its own: ring-downs, and a model

Rings = list[tuple[str, float, float]]
Asked = tuple[Task, tuple[SurveyedBag, ...]]  # what is asked of an arm, and its bags at a date
ModelPiece = tuple[str, Task, tuple[SurveyedBag, ...], Path]
"""Name of an arm, what is asked of it, bags to learn from, folder of the fleet."""


def _rings(piece: Asked, count: Count) -> Rings:
    """Find the ring-downs of an arm at a date: gauge, frequency [Hz], damping."""
    task, bags = piece
    found: Rings = []
    with quiet():
        for seen in bags:
            try:
                there = replace(seen.choice, path=str(task.base / seen.choice.path))
                found += rings(task.arm, load(there, task.arm, task.specs[0]))
            except TudorError:
                continue  # named when its parts were gone through
    count(1)
    return found


def made_model(piece: ModelPiece, count: Count) -> Path | Unused:
    """Make the model of an arm, unless it is there."""
    name, task, bags, folder = piece
    out, mark = folder / 'models' / name, folder / 'sums' / f'{name}.model'
    depends = hashlib.sha256(json.dumps([
        task.arm.digest, task.arm.spec.model_dump_json(), task.specs[0].model_dump_json(),
        repr(task.settings), [str(seen.choice) for seen in bags], [seen.checksum for seen in bags],
        task.source]).encode()).hexdigest()
    try:
        with quiet():
            if not (mark.is_file() and mark.read_text() == depends and _stands(out)):
                fit([str(task.base / str(seen.choice)) for seen in bags], task.arm,
                    settings=task.settings, preprocessing=task.specs[0], out=out, overwrite=True)
                write_whole(mark, depends.encode())
    except TudorError as err:
        return Unused(f'model of {name}', err.advice)
    finally:
        count(1)
    return out


def _stands(out: Path) -> bool:
    with suppress(TudorError):
        load_bundle(out)
        return True
    return False


# -- Stiffnesses of a fleet: a search for the elastic model of each arm at each of its dates.
#
# What a search has found is kept with the sums of the bags, under a name of all that it depends
# on: bags, arm, filters, sources, and the date before, where the search began.

SEARCHED_WITH = (*many_bags.PARTS, 'mechanics')  # parts of the package that a search depends on
Physical = tuple[PhysicalParameter, ...]
Dates = tuple[Task, tuple[Sequence[SurveyedBag], ...]]
"""What is asked of an arm, and its bags date by date."""


def stiffnesses(
    tasks: Mapping[str, Task], bags: Mapping[tuple[str, datetime.date], Sequence[SurveyedBag]],
    jobs: int, progress: Callable[[int], None],
) -> tuple[list[Observation], list[Unused]]:
    """Search for the stiffnesses of arms over time; what was found before is taken up."""
    whens = {name: sorted(when for when in bags if when[0] == name) for name in tasks}
    found = in_processes(_over_time, [(task, tuple(bags[when] for when in whens[name]))
                                      for name, task in tasks.items()], jobs, progress)
    seen: list[Observation] = []
    unused: list[Unused] = []
    for when, answer in zip(chain(*whens.values()), chain(*found), strict=True):
        if isinstance(answer, str):
            unused.append(Unused(f'{when[0]} {when[1]}', f'no stiffness: {answer}'))
        else:
            seen += [Observation(*when, 'elastic', item) for item in answer]
    return seen, unused


def _over_time(piece: Dates, count: Count) -> list[list[Quantity] | str]:
    task, dates = piece
    found: list[list[Quantity] | str] = []
    warm: dict[str, float] | None = None
    with quiet():
        for bags in dates:
            try:
                known = _known(task, bags, warm)
            except TudorError as err:
                found.append(err.advice)
            else:
                # it is the same arm: the next date begins where this one ended
                warm = {item.name: item.value for item in known}
                found.append(stiffness_quantities(known))
            count(1)
    return found


def _known(task: Task, bags: Sequence[SurveyedBag], warm: dict[str, float] | None) -> Physical:
    """Take up what was found in the bags of a date, or search for it and keep it."""
    file = task.store / task.name(bags[0], '.json', json.dumps(
        ['elastic', source_digest(SEARCHED_WITH), warm, [task.name(bag, '') for bag in bags[1:]]]))
    known: Physical = ()
    with suppress(OSError, ValueError, TypeError):  # nothing whole is there
        content = json.loads(read_bounded(file, many_bags.LARGEST))
        known = tuple(PhysicalParameter(**item) for item in content)
    if not known:
        known = identify(task.arm, records_of([task.read(bag) for bag in bags]),
                         warm=warm).physical
        write_whole(file, json.dumps([asdict(item) for item in known]).encode())
    return known


# -- From the plan of a fleet to what is compared: the same choices for all arms, part by part

When = tuple[str, datetime.date]  # arm and date

PARTS = 6  # parts of the data of a date, at least: for standard errors


@dataclass(frozen=True)
class StudySettings:
    """How a fleet is gone through."""

    base: Path  # directory that the names in the plan are relative to
    out: Path  # where models and sums go
    jobs: int = 1  # number of processes
    models: bool = True  # whether each arm gets a model of its last date
    elastic: bool = False  # whether stiffnesses are compared, by a search for each date


@dataclass(eq=False)
class _Date:
    """An arm at a date: its parts, their sums and models."""

    whole: list[SurveyedBag] = field(default_factory=list)
    sights: list[SurveyedBag] = field(default_factory=list)
    models: dict[str, FoldModels] = field(default_factory=dict)  # by output

    @property
    def used(self) -> tuple[SurveyedBag, ...]:
        """Give the bags that at least one part of is used."""
        names = {sight.choice.path for sight in self.sights}
        return tuple(seen for seen in self.whole if seen.choice.path in names)


def study(plan: FleetPlan, run: StudySettings, progress: Progress = lambda _: None) -> Fleet:
    """Fit all arms of a fleet at all dates, and compare them."""
    return _Study(plan, run, progress).done()


class _Study:
    """The steps of a study, and what they share."""

    def __init__(self, plan: FleetPlan, run: StudySettings, progress: Progress) -> None:
        self.plan, self.run, self.progress = plan, run, progress
        self.unused: list[Unused] = []
        read = lru_cache(load_arm)  # load_plan has seen to it that each has a description
        self.arms = {item.name: read(run.base / str(item.arm or plan.arm)) for item in plan.arms}
        (first, one), *_ = self.arms.items()
        for name, arm in self.arms.items():
            if arm.channels != one.channels:
                raise UsageError(f'arm {name!r} has other joints or gauges than {first!r}; arms '
                                 'of a plan have the same', remedy='make a plan for each kind')
        self.dates: dict[When, _Date] = {}

    def done(self) -> Fleet:
        """Go through all bags."""
        first = next(iter(self.arms.values()))
        if self.run.elastic:
            check_arm(first)
        self._see()
        sample = self._sample()
        self.chosen = chosen = choose(first, sample, first.spec.preprocessing, FitSettings(),
                                      self.progress, summable=True)
        outputs = common_outputs(sample)
        friction = {joint.name: choices_of(joint) for joint in chosen.arm.joints}
        self.arms = {name: arm.with_joints(friction) for name, arm in self.arms.items()}
        bags = [filtered(bag, chosen.preprocessing) for bag in sample]
        some = {output: self._measures(output, bags) for output in outputs}
        self._gather(outputs)
        self.progress('compare')
        seen = [Observation(*when, output, item) for when, date in self.dates.items()
                for output, of in date.models.items()
                for item in quantities(some[output], of.whole, list(of.others.values()))]
        seen += self._rings()
        if self.run.elastic:
            stiff, without = stiffnesses(
                self._tasks(('strain',)), {when: date.used for when, date in self.dates.items()},
                self.run.jobs, lambda done: self.progress('stiffness'))
            seen += stiff
            self.unused += without
        named = [*named_outliers(seen), *self._aged(outputs)]
        models = self._models() if self.run.models else {}
        order = list(self.arms)
        named.sort(key=lambda item: (order.index(item.arm), item.kind, -abs(item.sigmas)))
        return Fleet(self.plan.name, tuple(order), tuple(seen), tuple(named),
                     tuple(str(choice) for choice in chosen.made), models, tuple(self.unused))

    def _see(self) -> None:
        """Find the bags of each date, and see what they are."""
        named = [(arm, date, replace(choice, path=choice.path.removeprefix(f'{self.run.base}/')))
                 for arm in self.plan.arms for date, bags in sorted(arm.bags.items())
                 for choice in found_choices([str(self.run.base / text) for text in (
                     (bags,) if isinstance(bags, str) else bags)])]
        answers = survey([choice for _, _, choice in named], {}, self.run.base, self.run.jobs,
                         lambda done: self.progress('see bags'))
        known: dict[str, str] = {}
        masses: dict[float | None, str] = {}
        for (arm, date, choice), sight in zip(named, answers, strict=True):
            if isinstance(sight, Unused):
                self.unused.append(sight)
                continue
            other = known.setdefault(sight.checksum, f'{arm.name} {date}')
            if other != f'{arm.name} {date}':
                self.unused.append(Unused(str(choice), f'is a copy of a bag of {other}'))
                continue
            masses.setdefault(sight.payload, str(choice))
            self.dates.setdefault((arm.name, date), _Date()).whole.append(sight)
        if len(masses) > 1:
            said = ', '.join(f'{"unknown" if mass is None else f"{mass:g} kg"} ({bag})'
                             for mass, bag in list(masses.items())[:2])
            raise UsageError(f'bags of several loads cannot be compared ({said})',
                             remedy='list bags of one load in the plan')
        if not self.dates:
            raise FitError(f'none of {len(self.unused)} bags in the plan can be used; the first '
                           f'is {self.unused[0]}')
        for date_ in self.dates.values():
            date_.sights = parted(date_.whole, PARTS)

    def _sample(self) -> list[BagData]:
        """Read some bags, evenly among arms and dates."""
        def read(item: tuple[When, _Date]) -> BagData:
            choice, arm = item[1].whole[0].choice, self.arms[item[0][0]]
            return load(replace(choice, path=str(self.run.base / choice.path)), arm,
                        arm.spec.preprocessing, learn=True)

        found = spread_sample(list(self.dates.items()), read)
        if not found or not common_outputs(found):
            raise FitError('the bags share neither efforts nor strains' if found else
                           'no bag tried can be used', remedy='check each with `tudor info BAG`')
        return found

    def _measures(self, output: str, bags: Sequence[BagData]) -> list[Measure]:
        arm = next(iter(self.arms.values()))
        model = RowTrainer('analytical', arm, self.chosen.settings).fit(bags, output)
        assert isinstance(model, AnalyticalModel)
        return measures(arm, output, model, bags)

    def _tasks(self, outputs: tuple[str, ...]) -> dict[str, Task]:
        sums = (self.run.out / 'sums').absolute()
        return {name: Task(arm, (self.chosen.preprocessing,), outputs, self.chosen.settings,
                           self.run.base.absolute(), sums) for name, arm in self.arms.items()}

    def _gather(self, outputs: tuple[str, ...]) -> None:
        """Multiply out all parts, and fit each date."""
        tasks = self._tasks(outputs)
        facts = iter(go_through(
            [Summing(tasks[name], tuple(date.sights)) for (name, _), date in self.dates.items()],
            self.run.jobs, lambda done: self.progress('multiply out')))
        for (name, when), date in list(self.dates.items()):
            pairs = [(sight, next(facts)) for sight in date.sights]
            used = [sight for sight, fact in pairs if not isinstance(fact, Unused)]
            wrong = {fact.bag.rpartition('@')[0] or fact.bag: fact.why  # the bag of a part
                     for _, fact in pairs if isinstance(fact, Unused)}
            good = {sight.choice.path for sight in used}
            self.unused += [Unused(bag, why) for bag, why in wrong.items() if bag not in good]
            date.sights = [replace(sight, fold=i) for i, sight in enumerate(used)]
            try:
                if len(used) < 2:
                    raise FitError(f'{len(used)} parts of its bags can be used, but 2 are needed',
                                   remedy='record more')
                date.models = {output: found for (_, output), found in fold_models(
                    Summing(tasks[name], tuple(date.sights))).items()}
            except TudorError as err:
                self.unused.append(Unused(f'{name} {when}', err.advice))
                del self.dates[name, when]
        if not self.dates:
            raise FitError(f'no arm has usable bags: {self.unused[0]}', remedy='correct the plan')

    def _rings(self) -> list[Observation]:
        if not any(arm.gauges for arm in self.arms.values()):
            return []
        tasks = self._tasks(())
        asked = [(tasks[name], tuple(date.whole)) for (name, _), date in self.dates.items()]
        found = in_processes(_rings, asked, self.run.jobs,
                             lambda done: self.progress('ring-downs'))
        return [Observation(*when, 'ring', item)
                for when, rings in zip(self.dates, found, strict=True)
                for item in ring_quantities(rings)]

    def _aged(self, outputs: Sequence[str]) -> list[Named]:
        """Judge the model of each arm's first date on its last one."""
        found: dict[str, list[ErrorChange]] = {}
        for name in self.arms:
            dates = sorted(date for arm, date in self.dates if arm == name)
            if len(dates) > 1:
                old, new = self.dates[name, dates[0]], self.dates[name, dates[-1]]
                found[name] = [change for output in outputs for change in aged(
                    output, old.models[output], new.models[output])]
        return named_aged(found)

    def _models(self) -> dict[str, str]:
        """Make a bundle of each arm's last date."""
        last = {name: max(date for arm, date in self.dates if arm == name)
                for name, _ in self.dates}
        tasks = self._tasks(())
        asked = [(name, tasks[name], tuple(self.dates[name, date].whole), self.run.out.absolute())
                 for name, date in last.items()]
        answers = in_processes(made_model, asked, self.run.jobs,
                               lambda done: self.progress('models'))
        self.unused += [item for item in answers if isinstance(item, Unused)]
        return {name: f'models/{name}' for name, made in zip(last, answers, strict=True)
                if not isinstance(made, Unused)}
