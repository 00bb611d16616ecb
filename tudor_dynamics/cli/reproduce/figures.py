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

"""``tudor reproduce figures``: the figures of both papers and some more."""

from __future__ import annotations

import argparse
from pathlib import Path
import time

from tudor_dynamics.cli.console import finite, print_json
from tudor_dynamics.cli.reproduce.campaign_options import opened
from tudor_dynamics.reproduction.figures.catalogue import gallery, write_figures
from tudor_dynamics.reproduction.fits import Fits


def run(args: argparse.Namespace) -> int:
    """Compute what is not there yet, draw, and write the page."""
    begun = time.perf_counter()
    out = Path(args.out)
    with opened(args) as campaign:
        chosen = gallery(Fits(campaign))
        campaign.progress('draw', 0.0)
        names = write_figures(chosen, campaign.arm.name, out)
    seconds = time.perf_counter() - begun
    if args.json:
        print_json(finite({'out': str(out), 'seconds': round(seconds, 1), 'figures': names,
                           **chosen.data}))
        return 0
    for picture in chosen.pictures:
        print(f'{picture.name}: {picture.title}')
    print(f'{len(names)} figures as SVG and PNG in {seconds:.0f} s; {out / "index.html"}')
    return 0
