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

"""Options of commands that have much to do: how many processes, or which cluster."""

from __future__ import annotations

import argparse
import os
from typing import Any

from tudor_dynamics.errors import UsageError


def add_running(parser: Any, jobs: int | None = os.cpu_count() or 1) -> None:
    """
    Add what says where pieces of work are done.

    Parameters
    ----------
    parser : argparse.ArgumentParser or group of its options
        Parser of a command.
    jobs : int or None
        Default of ``--jobs``.

    """
    parser.add_argument('--jobs', type=int, default=jobs, metavar='N',
                        help='processes (default: one a core)')
    parser.add_argument('--cluster', metavar='tcp://HOST:PORT',
                        help='Dask scheduler whose workers do it in their place; they see the '
                             'same paths')


def check_running(args: argparse.Namespace) -> None:
    """
    Refuse numbers of processes that there cannot be.

    Parameters
    ----------
    args : argparse.Namespace
        What was given to the command.

    """
    if args.jobs < 1:
        raise UsageError(f'--jobs {args.jobs}: give 1 or more')
