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

"""Options of ``tudor evaluate --collisions``, apart from what they need."""

from __future__ import annotations

import argparse

from tudor_dynamics.models.kinds import KINDS


def configure_collisions(group: argparse._ArgumentGroup) -> None:
    """Add the options of ``tudor evaluate --collisions``."""
    group.add_argument('--collisions', action='store_true',
                       help='judge the collision detector instead of the predictions')
    group.add_argument('--false-alarms', type=float, default=1.0, metavar='N',
                       help='false alarms per hour that are allowed (default: 1)')
    group.add_argument('--debounce', type=float, default=0.01, metavar='S',
                       help='time for which a threshold must be exceeded (default: 0.01 s)')
    group.add_argument('--kind', choices=tuple(KINDS), default='analytical',
                       help='model whose residuals are watched (default: analytical)')
    group.add_argument('--pushes', nargs='+', default=[], metavar='FILE.csv',
                       help='tables of begin,end in seconds since the beginning of the bag, one '
                            'for each bag')
    group.add_argument('--truth', metavar='TOPIC',
                       help='WrenchStamped or Bool that tells when the arm was touched (default: '
                            'applied_wrench, where there is one)')
    group.add_argument('--free', action='store_true',
                       help='nothing touched the arm: every event is a false alarm')
    group.add_argument('--roc', metavar='FILE',
                       help='plot detection rate over false alarms (.png, .svg, .pdf)')
    group.add_argument('--plot', metavar='FILE',
                       help='plot ratios to the thresholds, pushes and events over time')
