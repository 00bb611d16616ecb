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

"""The page of a fleet: which arms are named, and each quantity of all arms over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import datetime

from matplotlib.dates import DateFormatter
from matplotlib.ticker import MaxNLocator

from tudor_dynamics.library.fleet.outcome import Fleet, Seen, WORDS
from tudor_dynamics.report.figure import label, new_figure, plain_text, to_uri
from tudor_dynamics.report.page import rendered
from tudor_dynamics.report.style import BLUE, PAGE, style, VERMILION

COLOURS = (VERMILION, BLUE, '#007a57', '#7a4fa3', '#a0642c', '#cc79a7')
"""Of arms that are named; those of others are grey."""
MARKERS = 'osD^vP'
MOST = 200
"""Arms that a figure draws, beside those that are named."""


@dataclass(frozen=True)
class Drawn:
    """A quantity over time."""

    title: str  # quantity and channel
    figure: str  # all arms over time, as data URI
    named: tuple[str, ...]  # arms that are named for it


def page_of(fleet: Fleet) -> str:
    """Render the page."""
    groups: dict[str, list[Seen]] = {}
    for item in fleet.seen:
        quantity = item.quantity
        groups.setdefault(f'{quantity.name}, {quantity.channel} ({item.output})', []).append(item)
    named = {title: tuple(dict.fromkeys(item.arm for item in fleet.named if item.what == title))
             for title in groups}
    drawn = [Drawn(title, _figure(title, items, named[title]), named[title])
             for title, items in groups.items()]
    dates = sorted({item.date for item in fleet.seen})
    return rendered('fleet', fleet=fleet, drawn=drawn, words=WORDS, dates=dates,
                    alike=len(fleet.arms) - len({item.arm for item in fleet.named}))


def _figure(title: str, items: Sequence[Seen], named: Sequence[str]) -> str:
    arms: dict[str, list[Seen]] = {}
    for item in items:
        arms.setdefault(item.arm, []).append(item)
    others = [arm for arm in arms if arm not in named]
    with style(PAGE):
        figure, ((axes,),) = new_figure(1, [2.2], [0.5])
        for arm in [*others[:MOST], *named]:
            some = sorted(arms[arm], key=lambda item: item.date)
            look = {'color': '#b0b0b0', 'linewidth': 0.8, 'marker': '.', 'zorder': 1}
            if arm in named:
                place = list(named).index(arm)
                look = {'color': COLOURS[place % len(COLOURS)], 'linewidth': 1.4,
                        'marker': MARKERS[place % len(MARKERS)], 'label': arm, 'zorder': 2}
            axes.errorbar([_time(item.date) for item in some],
                          [item.quantity.value for item in some],
                          yerr=[item.quantity.error for item in some], markersize=4, capsize=2,
                          elinewidth=0.7, **look)
        plain_text(axes.set_title, title)
        axes.set_ylabel(label(items[0].quantity.name.partition(' at ')[0],
                              items[0].quantity.unit))
        axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))  # whole days, few enough
        days = DateFormatter('%Y-%m-%d')  # type: ignore[no-untyped-call]
        axes.xaxis.set_major_formatter(days)
        if named:
            for text in axes.legend(loc='best').get_texts():
                text.set_parse_math(False)
        return to_uri(figure)


def _time(date: datetime.date) -> datetime.datetime:
    return datetime.datetime.combine(date, datetime.time())
