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

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, ExitStack
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
import io
from pathlib import Path
import re
from secrets import token_urlsafe
import shlex
from threading import Thread

from jinja2 import Template
from markupsafe import Markup
from rich.console import Console, ConsoleOptions, Group, RenderableType
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
KEPT = 200  # events that a page has
BAR = 12  # characters of a ratio of 2
STEPS = '\u2581\u2582\u2583\u2584\u2585\u2586\u2587'
ABOVE = '\u2588'
UNKNOWN, OK = 'unknown', 'ok'
COLOURS = {UNKNOWN: 'reverse', 'free': 'green', 'contact': 'yellow', 'collision': 'bold red',
           OK: 'green', 'not judged': 'yellow', 'stuck': 'bold red', 'silent': 'bold red'}
RATIO, *_ = PARTS = 'ratio', 'residual', 'threshold'
WIDTH, NARROW = 80, 46  # columns, and those of a telephone
TALL = 10**4  # lines of what nothing limits
PAGE = Template((Path(__file__).parent / 'templates' / 'live.html').read_text(), autoescape=True)


def history(peaks: Mapping[int, float], now: int) -> Text:
    """Draw the largest ratio of each second, full at a collision, blank without samples."""
    text = Text(no_wrap=True)
    for second in range(now // 10**9 - HISTORY + 1, now // 10**9 + 1):
        peak = peaks.get(second)
        if peak is None:
            text.append(' ')
        elif peak < 1.0:
            text.append(STEPS[int(peak * len(STEPS))], COLOURS['free'])
        else:
            text.append(ABOVE, COLOURS['collision'])
    return text


def bar(ratio: float) -> Text:
    """Draw a ratio as a bar with a mark at the threshold."""
    full = round(0.5 * BAR * ratio) if ratio < 2.0 else BAR
    text = Text('\u2501' * full + ' ' * (BAR - full),
                COLOURS['free' if ratio < 1.0 else 'collision'])
    return text[:BAR // 2] + Text('\u2502') + text[BAR // 2:]


def number(value: float) -> str:
    """Write a value with three digits, and without an exponent where it is large."""
    return f'{value:.0f}' if abs(value) >= 1e3 else f'{value:.3g}'


@dataclass(frozen=True)
class Channel:
    """A channel of a method as it is now; no values where they are of another time."""

    method: str
    name: str
    unit: str
    state: str  # empty where nobody has said it
    ratio: float | None
    residual: str
    threshold: str

    def line(self, names: int, units: int, *, wide: bool) -> Text:
        """Write it on one line, on two where there is little room, by the longest of all."""
        drawn, near = (' ' * (BAR + 1), '') if self.ratio is None else (
            bar(self.ratio), f'{self.ratio:.2f}')
        state = Text(self.state, COLOURS.get(self.state, ''))
        if wide:
            return Text.assemble(f'  {self.name:<{names}} {self.residual:>8} {self.threshold:>9} '
                                 f'{self.unit:<{units}} {near:>5} ', drawn, ' ', state)
        size = f' {self.residual} of {self.threshold} {self.unit}' * bool(self.residual)
        return Text.assemble(f'  {self.name:<{names}} {near:>5} ', state, '\n    ', drawn, size)


class LiveView:
    """What a monitor sees; draws itself where rich prints it."""

    def __init__(self, title: str) -> None:
        self.title = title
        self.level, self.load, self.state, self.warning = UNKNOWN, '', '', ''
        self.events: dict[str, str] = {}  # as lines, with the command that explains it once known
        self.states: dict[tuple[str, str], tuple[str, str]] = {}  # method, channel: unit, state
        self.forget()

    def forget(self) -> None:
        """Forget all samples."""
        self.stamp = 0
        self.values: dict[tuple[str, str], dict[str, float]] = {}  # method, part: by channel
        self.peaks: dict[str, dict[int, float]] = {}  # of each method, by second

    def take(
        self, stamp: int, method: str, part: str, channels: Sequence[str], values: FloatArray,
    ) -> None:
        """Take a method's ratios, residuals or thresholds, (channels,), at a stamp [ns]."""
        if self.stamp - stamp > CLOCK_JUMP * 1e9:  # a bag or a simulation begins again
            self.forget()
        self.stamp = max(self.stamp, stamp)
        self.values[method, part] = dict(zip(channels, values.tolist(), strict=True))
        if part == RATIO:
            peaks, second = self.peaks.setdefault(method, {}), stamp // 10**9
            peaks[second] = max(float(values.max()), peaks.get(second, 0.0))
            if len(peaks) > HISTORY:
                del peaks[min(peaks)]

    def diagnosed(self, values: Mapping[str, str]) -> None:
        """Take what diagnostics say of channels, load and bags of events."""
        self.load = values.get('load', self.load)
        self.state = f'{values["judged [%]"]} % judged' if 'judged [%]' in values else self.state
        found = {key: re.fullmatch(r'state: (\S+) (.+) \[(.*)\]', key) for key in values}
        self.states = {(match[1], match[2]): (match[3], values[key])
                       for key, match in found.items() if match} or self.states
        times = tuple(filter(None, values.get('events in it', '').split(', ')))
        for line in self.events:
            if line.startswith(times):
                self.events[line] = shlex.join(['tudor', 'why', values.get('last bag', '')])

    def event(self, onset: int, method: str, link: str, ratios: dict[str, float], why: str = '',
              ) -> str:
        """Take an event: its onset [ns], and its ratios by channel; gives it as a line."""
        channel = max(ratios, key=lambda name: ratios[name])
        line = printable(f'{time_of_day(onset)}  {link} by {method}: {channel} '
                         f'{ratios[channel]:.2f} times its threshold')
        why = why or self.events.get(line, '')  # a record may come again
        self.events = dict([*self.events.items(), (line, why)][-KEPT:])
        return line

    def _channels(self) -> Iterator[Channel]:
        values, states = dict(self.values), dict(self.states)  # at once: others add to them
        for method, name in states or [(method, name) for (method, part), known in values.items()
                                       if part == RATIO for name in known]:
            unit, state = states.get((method, name), ('', ''))
            known = [values.get((method, part), {}).get(name) for part in PARTS]
            ratio, *others = known if state in ('', OK, 'stuck') else [None] * len(PARTS)
            yield Channel(method, printable(name), printable(unit), state, ratio, *(
                '' if value is None else number(value) for value in others))

    def parts(self, width: int, height: int) -> Iterator[RenderableType]:
        """Draw all but the events; channels that nothing is wrong with go where lines lack."""
        head = Table.grid(expand=True)
        head.add_column()
        head.add_column(justify='right')
        head.add_row(Text(self.title, 'bold'),
                     time_of_day(self.stamp) if self.stamp else 'no samples yet')
        head.add_row(Text(self.level, COLOURS[self.level]), Text(self.state))
        yield head
        if self.warning:
            yield Text(self.warning, COLOURS['contact'])
        channels, wide = list(self._channels()), width >= WIDTH
        names, units = (max((len(getattr(item, part)) for item in channels), default=0)
                        for part in ('name', 'unit'))
        methods = dict.fromkeys(item.method for item in channels)
        calm = sorted((item for item in channels if item.state in ('', OK)),
                      key=lambda item: item.ratio or 0.0)
        each, used = 1 if wide else 2, 4 + len(methods) - -len(self.warning) // width
        lack = used + each * len(channels) - height
        hidden = calm[:(lack + each) // each if lack > 0 else 0]
        if wide and channels:
            yield Text(f'{"":<{names}}   residual threshold {"":<{units}} ratio '
                       '0     1     2 state')
        for method in methods:
            yield Text.assemble(
                (f'{method:<9}', 'bold'), history(dict(self.peaks.get(method, {})), self.stamp),
                f'  largest of each second, {HISTORY} s' * wide)
            yield from (item.line(names, units, wide=wide) for item in channels
                        if item.method == method and item not in hidden)
        if hidden:
            yield Text(f'{len(hidden)} channels with smaller ratios have no room')
        if self.load:
            yield Text(self.load)

    def __rich_console__(self, _: Console, options: ConsoleOptions) -> Iterator[RenderableType]:
        """Draw it with the newest events, and how to explain the last of them."""
        events = list(self.events.items())[:-EVENTS - 1:-1]
        below = [Text(line) for line, _ in events] or [Text('no events')]
        below[1:1] = [Text(f'  {why}', overflow='fold') for _, why in events[:1] if why]
        yield from self.parts(options.max_width, options.size.height - len(below))
        yield from below


def drawn(what: RenderableType, width: int = WIDTH) -> Console:
    """Draw into memory, for pages and pictures."""
    console = Console(record=True, file=io.StringIO(), width=width, height=TALL)
    console.print(what)
    return console


def page_of(view: LiveView, *, whole: bool = True) -> str:
    """Give a page that fetches its body again each second, or that body, with all events."""
    wide, narrow = (drawn(Group(*view.parts(width, TALL)), width).export_html(
        code_format='{code}', inline_styles=True) for width in (WIDTH, NARROW))
    return PAGE.render(whole=whole, nonce=token_urlsafe(), wide=Markup(wide),
                       narrow=Markup(narrow), events=list(view.events.items())[::-1])


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
            self.wfile.write(page_of(view, whole=self.path != '/body').encode())

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
