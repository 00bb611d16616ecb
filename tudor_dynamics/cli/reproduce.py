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

"""``tudor reproduce``, which has moved out of the package."""

from __future__ import annotations

import argparse

from tudor_dynamics.errors import UsageError

EXAMPLES = """\
python -m papers, in a checkout of the sources, has taken its place; see python -m papers --help
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Take whatever was an option before."""
    parser.add_argument('words', nargs=argparse.REMAINDER, help='whatever it took before')


def run(args: argparse.Namespace) -> int:
    """Say what has taken its place."""
    raise UsageError('the experiments of the papers are a study beside the package now',
                     remedy='run "make papers", or "python -m papers", in a checkout')
