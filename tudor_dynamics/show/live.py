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

"""A live view of a monitor: ratios to thresholds, events, load; on a terminal and as a page."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, ExitStack
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
import io
from pathlib import Path
import re
from threading import Thread

import numpy as np
from rich.console import Console, ConsoleOptions, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from tudor_dynamics.errors import complain, printable, UsageError
from tudor_dynamics.files import SIGNATURE
from tudor_dynamics.online.detector import time_of_day
from tudor_dynamics.online.settings import CLOCK_JUMP
from tudor_dynamics.typing import FloatArray

DRAWN = 0.1  # time between two pictures [s]
HISTORY, EVENTS = 30, 6  # seconds and events that are shown
BAR = 12  # characters of a ratio of 2
TAKEN = 19  # characters of method and ratio, and of the blanks beside them
STEPS = '\u2581\u2582\u2583\u2584\u2585\u2586\u2587'
ABOVE = '\u2588'
UNKNOWN = 'unknown'
COLOURS = {UNKNOWN: 'reverse', 'free': 'green', 'contact': 'yellow', 'collision': 'bold red'}
WIDTH, NARROW = 80, 46  # columns, and those of a telephone
PAGE = Path(__file__).parent / 'templates' / 'live.html'


@dataclass(slots=True)
class RatioHistory:
    """Ratios of one method over the last seconds."""

    channel: str = ''  # that of the newest ratio
    ratio: float = 0.0
    peaks: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=HISTORY))

    def add(self, stamp: int, channel: str, ratio: float) -> None:
        """Take a ratio at a stamp [ns]."""
        self.channel, self.ratio = channel, ratio
        second = stamp // 10**9
        if self.peaks and self.peaks[-1][0] == second:
            ratio = max(ratio, self.peaks.pop()[1])
        self.peaks.append((second, ratio))

    def history(self, now: int, seconds: int = HISTORY) -> Text:
        """Draw the largest ratio of each second, full at a collision, blank without samples."""
        peaks, text = dict(self.peaks), Text(no_wrap=True)
        for second in range(now // 10**9 - seconds + 1, now // 10**9 + 1):
            peak = peaks.get(second)
            if peak is None:
                text.append(' ')
            elif peak >= 1.0:
                text.append(ABOVE, COLOURS['collision'])
            else:
                text.append(STEPS[int(peak * len(STEPS))], COLOURS['free'])
        return text

    def bar(self) -> Text:
        """Draw the ratio as a bar with a mark at the threshold."""
        full = min(BAR, round(0.5 * BAR * self.ratio))
        text = Text('\u2501' * full + ' ' * (BAR - full),
                    COLOURS['collision' if self.ratio >= 1.0 else 'free'])
        return text[:BAR // 2] + Text('\u2502') + text[BAR // 2:]


class LiveView:
    """What a monitor sees; draws itself where rich prints it."""

    def __init__(self, title: str) -> None:
        self.title = title
        self.level, self.load, self.state, self.warning = UNKNOWN, '', '', ''
        self.stamp = 0
        self.traces: dict[str, RatioHistory] = {}
        self.events: deque[str] = deque(maxlen=EVENTS)

    def ratios(self, stamp: int, method: str, channels: Sequence[str], ratio: FloatArray) -> None:
        """Take the ratios of a method to its thresholds, (channels,), at a stamp [ns]."""
        if self.stamp - stamp > CLOCK_JUMP * 1e9:  # a bag or a simulation begins again
            self.stamp, self.traces = 0, {}
        self.stamp = max(self.stamp, stamp)
        place = int(np.argmax(ratio))
        self.traces.setdefault(method, RatioHistory()).add(
            stamp, channels[place], float(ratio[place]))

    def event(self, onset: int, method: str, link: str, ratios: dict[str, float]) -> str:
        """Take an event: its onset [ns], and its ratios by channel; gives it as a line."""
        channel = max(ratios, key=lambda name: ratios[name])
        self.events.append(printable(f'{time_of_day(onset)}  {link} by {method}: {channel} '
                                     f'{ratios[channel]:.2f} times its threshold'))
        return self.events[-1]

    def __rich_console__(self, _: Console, options: ConsoleOptions) -> Iterator[RenderableType]:
        """Draw it, without bars where there is little room."""
        head = Table.grid(expand=True)
        head.add_column()
        head.add_column(justify='right')
        head.add_row(Text(self.title, 'bold'),
                     time_of_day(self.stamp) if self.stamp else 'no samples yet')
        head.add_row(Text(self.level, COLOURS[self.level]), Text(self.state))
        yield head
        if self.warning:
            yield Text(self.warning, COLOURS['contact'])
        table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
        bars = options.max_width >= WIDTH
        traces = list(self.traces.items())  # at once: a page is drawn beside what adds to them
        widest = max((len(trace.channel) for _, trace in traces), default=0)
        seconds = max(1, min(HISTORY, options.max_width - TAKEN - bars * (BAR + 3) - widest))
        for name in ('method', 'channel', 'ratio', *('0     1     2',) * bars):
            table.add_column(name, justify='right' if name == 'ratio' else 'left', no_wrap=True)
        table.add_column(f'largest of each second, {seconds} s')
        for method, trace in traces:
            table.add_row(method, trace.channel, f'{trace.ratio:.2f}', *(trace.bar(),) * bars,
                          trace.history(self.stamp, seconds))
        yield table
        yield from filter(None, map(Text, (self.load, *(self.events or ('no events',)))))


def drawn(view: LiveView, width: int = WIDTH) -> Console:
    """Draw a view into memory, for pages and pictures."""
    console = Console(record=True, file=io.StringIO(), width=width)
    console.print(view)
    return console


def page_of(view: LiveView) -> str:
    """Give a page that asks for the next one after a second."""
    wide, narrow = (drawn(view, width).export_html(code_format='{code}', inline_styles=True)
                    for width in (WIDTH, NARROW))
    return PAGE.read_text().format(wide=wide, narrow=narrow)


def picture_of(view: LiveView) -> str:
    """Give a picture, as SVG; rich would load its font from the network."""
    return re.sub(r'@font-face {.*?}', '', drawn(view).export_svg(title='tudor watch'),
                  flags=re.DOTALL) + f'<!-- {SIGNATURE} -->'


@contextmanager
def served(view: LiveView, port: int) -> Iterator[None]:
    """Serve a view to this machine alone; it is drawn where a browser asks."""
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:  # noqa: N802
            self.send_response(200)
            self.send_header('Content-Type', 'text/html; charset=utf-8')
            self.end_headers()
            self.wfile.write(page_of(view).encode())

        def log_message(self, *_: object) -> None:
            pass
    try:
        server = ThreadingHTTPServer(('127.0.0.1', port), Handler)
    except (OSError, OverflowError) as err:
        raise UsageError(f'no web page on port {port}: {err}; choose another port') from None
    with server:
        complain(f'page: http://127.0.0.1:{port}/')
        Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield
        finally:
            server.shutdown()


@contextmanager
def shown(view: LiveView, port: int | None, *, terminal: bool) -> Iterator[Callable[[], None]]:
    """Show a view on the terminal, and where a port is given as a page; gives what draws it."""
    with ExitStack() as stack:
        if port is not None:
            stack.enter_context(served(view, port))
        yield stack.enter_context(Live(view, auto_refresh=False)).refresh if terminal else (
            lambda: None)
