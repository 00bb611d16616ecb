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

"""What table1, figures and outlook have in common: plan, stages, progress."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
import sys

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from tudor_dynamics.errors import UsageError
from tudor_dynamics.models.kinds import KINDS
from tudor_dynamics.reproduction.outlook.parts import PARTS
from tudor_dynamics.reproduction.plan import Campaign, Plan
from tudor_dynamics.reproduction.result_cache import ResultCache


def default_arm() -> Path:
    """Find the description of the reference arm: in a checkout, or where it was installed."""
    places = [Path('config/tudor.yaml'),
              Path(__file__).resolve().parents[3] / 'config' / 'tudor.yaml',
              Path(sys.prefix) / 'share' / 'tudor_dynamics' / 'config' / 'tudor.yaml']
    for place in places:
        if place.is_file():
            return place
    msg = 'config/tudor.yaml is not here; name the arm description with --arm'
    raise UsageError(msg)


def stage_count(experiment: str, plan: Plan, split: str | None) -> int:
    """
    Count the stages of an experiment, for a progress bar.

    Parameters
    ----------
    experiment : {'table1', 'figures', 'outlook'}
        What is reproduced.
    plan : Plan
        Size of the campaign.
    split : {'stimulus', 'random'}, optional
        How training and test are told apart.

    Returns
    -------
    int
        Recordings and fits for each payload, and what there is once.

    """
    fits = len({KINDS[kind].model.has_memory for kind in plan.kinds})
    each = 1 + fits
    if experiment == 'outlook':
        return len(PARTS)
    if experiment == 'figures':
        return 2 * each * len(plan.payloads) + 8
    return (each + (split == 'random')) * len(plan.payloads) + 1


@contextmanager
def opened(args: argparse.Namespace) -> Iterator[Campaign]:
    """
    Open the campaign of a command, with a progress bar while a terminal watches.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed options of the command.

    Yields
    ------
    Campaign
        Recordings, made as they are asked for.

    """
    if args.seed < 0 or args.jobs < 1:
        msg = f'--seed {args.seed} --jobs {args.jobs}: give a seed of 0 or more and 1 job or more'
        raise UsageError(msg)
    plan = Plan(str(args.arm or default_arm()), seed=args.seed, jobs=args.jobs,
                kinds=tuple(dict.fromkeys(args.models)))
    if args.quick:
        plan = replace(plan.quick(), seed=args.seed)
    if args.stimuli is not None:
        plan = replace(plan, stimuli=args.stimuli)
    if args.seconds is not None:
        plan = replace(plan, seconds=args.seconds)
    if plan.stimuli < 2 or not 10.0 <= plan.seconds < float('inf'):
        msg = (f'--stimuli {plan.stimuli} --seconds {plan.seconds:g}: give two stimuli or more, '
               'half of which are for testing, of 10 s or more')
        raise UsageError(msg)
    if args.split == 'random' and all(KINDS[kind].model.has_memory for kind in plan.kinds):
        msg = '--split random: the elastic model has a memory and no random split; name others'
        raise UsageError(msg)
    stages = stage_count(args.experiment, plan, args.split)
    campaign = Campaign(plan, ResultCache(args.out))
    console = Console(file=sys.stderr)
    columns = (TextColumn('{task.description}'), BarColumn(),
               TextColumn('{task.percentage:>3.0f} %'), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True,
                  disable=not console.is_terminal) as bar:
        task = bar.add_task('', total=stages)
        done: set[str] = set()

        def show(text: str, share: float) -> None:
            name = text.partition(':')[0]
            # a stage that is asked for again is there already
            if name not in done:
                bar.update(task, description=text, completed=min(len(done) + share, stages))
            if share >= 1.0:
                done.add(name)
        campaign.progress = show
        yield campaign
