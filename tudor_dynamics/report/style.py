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
How figures look, on the page of a fit and as files of their own: one style, two sizes of it.

Every series has a line style, width or marker of its own, so that prints in grey stay legible; the
colours are those of Okabe and Ito, which colour-blind readers tell apart.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib

BLUE, VERMILION = '#0072b2', '#d55e00'

_COMMON: dict[str, Any] = {
    'axes.axisbelow': True, 'axes.grid': True, 'axes.spines.right': False,
    'axes.spines.top': False, 'axes.titlelocation': 'left', 'grid.color': '#dddddd',
    'grid.linewidth': 0.6, 'legend.frameon': False, 'path.simplify': True,
    # ids come from the content alone, so that equal fits give equal files
    'svg.hashsalt': 'tudor_dynamics'}
PAGE: Any = {
    **_COMMON, 'font.family': 'sans-serif', 'font.sans-serif': ['DejaVu Sans', 'Verdana'],
    'font.size': 8.5, 'axes.titlesize': 9.0, 'axes.titleweight': 'bold',
    'axes.edgecolor': '#555555', 'axes.linewidth': 0.7, 'xtick.color': '#333333',
    'ytick.color': '#333333', 'path.simplify_threshold': 0.2,
    'svg.fonttype': 'none'}  # text stays text
"""For figures inside the report of a fit."""
PRINT: Any = {
    **_COMMON, 'font.size': 9.0, 'axes.titlesize': 9.5, 'axes.labelsize': 9.0,
    'legend.fontsize': 8.5, 'legend.handlelength': 2.8, 'xtick.labelsize': 8.5,
    'ytick.labelsize': 8.5, 'svg.fonttype': 'path'}
"""For figures that are files of their own, over two columns of a paper."""

PAGE_MEASURED: dict[str, Any] = {'color': '#a3a3a3', 'linewidth': 2.4, 'linestyle': '-',
                                 'solid_capstyle': 'round'}
PAGE_MODELS: dict[str, dict[str, Any]] = {
    'analytical': {'color': BLUE, 'linewidth': 1.0, 'linestyle': '-'},
    'elm': {'color': VERMILION, 'linewidth': 1.0, 'linestyle': (0, (3.5, 1.5))},
    'elastic': {'color': '#007a57', 'linewidth': 1.3, 'linestyle': (0, (1, 0.8))}}
OTHER: dict[str, Any] = {'color': '#7a4fa3', 'linewidth': 1.1, 'linestyle': (0, (6, 1.2))}
"""Of a kind that has no look of its own."""


def page_model(kind: str) -> dict[str, Any]:
    """Say how a kind of model is drawn on the page."""
    return PAGE_MODELS.get(kind, OTHER)


@contextmanager
def style(settings: Any) -> Iterator[None]:
    """Draw in one of the styles, whatever the user's matplotlibrc says."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(settings)
        yield
