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

"""The live view: what it draws, in 80 columns, and the page that it serves."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
import io
import socket
from urllib.request import urlopen

import numpy as np
import pytest
from rich.console import Console
from tudor_dynamics.errors import UsageError
from tudor_dynamics.online.detector import time_of_day
from tudor_dynamics.show import live
from tudor_dynamics.show.live import (
    ABOVE, HISTORY, LiveView, page_of, RatioHistory, served, shown)

SECOND = 10**9


def drawn(view: LiveView, width: int = 80) -> list[str]:
    """Draw a view as text."""
    file = io.StringIO()
    Console(file=file, width=width, color_system=None).print(view)
    return [line.rstrip() for line in file.getvalue().splitlines()]


def filled() -> LiveView:
    """Give a view of two methods and an event."""
    view = LiveView('arm: run4')
    for k in range(40):
        view.ratios(k * SECOND, 'strain', ('hub', 'middle'), np.array([0.1, 0.02 * k]))
        view.ratios(k * SECOND, 'momentum', ('joint2',), np.array([1.5 if k == 20 else 0.0]))
    view.event(20 * SECOND, 'momentum', 'link2', {'joint1': 0.3, 'joint2': 1.5})
    view.level, view.load, view.state = 'collision', 'load 0.2 kg', '98 % judged'
    return view


def test_what_it_draws() -> None:
    """Level, the channel nearest to its threshold, its ratio, the event with its time."""
    lines = drawn(filled())
    assert lines[0].startswith('arm: run4') and lines[0].endswith(time_of_day(39 * SECOND))
    assert lines[1].startswith('collision') and lines[1].endswith('98 % judged')
    strain = next(line for line in lines if line.startswith('strain'))
    assert strain.split()[1:3] == ['middle', '0.78']
    (event,) = [line for line in lines if '1.50 times its threshold' in line]
    assert event.startswith(time_of_day(20 * SECOND)) and 'link2 by momentum: joint2' in event
    assert 'load 0.2 kg' in lines and max(map(len, lines)) <= 80
    assert sum(line.count(ABOVE) for line in lines) == 1


def test_before_anything_came() -> None:
    """It says so."""
    text = '\n'.join(drawn(LiveView('arm')))
    assert 'no samples yet' in text and 'no events' in text


def test_history() -> None:
    """The largest ratio of each second counts; seconds without samples stay blank."""
    trace = RatioHistory()
    for stamp, ratio in ((1.0, 0.1), (1.5, 2.0), (1.9, 0.1), (4.0, 0.999), (5.0, 0.0)):
        trace.add(round(stamp * SECOND), 'hub', ratio)
    text = trace.history(5 * SECOND).plain
    assert len(text) == HISTORY and text[-5:] == f'{ABOVE}  \u2587\u2581' and not text[:-5].strip()


@pytest.mark.parametrize('ratio, full', [(0.0, 0), (1.0, 6), (7.0, 12)])
def test_bar(ratio: float, full: int) -> None:
    """The mark is at the threshold, whatever the ratio."""
    trace = RatioHistory('hub', ratio)
    text = trace.bar().plain
    assert len(text) == 13 and text[6] == '\u2502' and text.count('\u2501') == full


def free_port() -> int:
    """Find a port that nobody has."""
    with socket.socket() as one:
        one.bind(('127.0.0.1', 0))
        return int(one.getsockname()[1])


def test_page(monkeypatch: pytest.MonkeyPatch) -> None:
    """
    A browser gets what is drawn next, names as they are; a port that is taken is said.

    Nothing is drawn while no browser asks.
    """
    view, port = LiveView('arm <b>'), free_port()
    pages: list[LiveView] = []

    def counted(drawn: LiveView) -> str:
        pages.append(drawn)
        return page_of(drawn)

    monkeypatch.setattr(live, 'page_of', counted)
    with shown(view, port, terminal=False) as draw, ThreadPoolExecutor() as pool:
        url = f'http://127.0.0.1:{port}/'

        def asked() -> str:
            answer = pool.submit(urlopen, url)
            while not answer.done():
                draw()
            return str(answer.result().read().decode())

        assert 'arm &lt;b&gt;' in asked() and '2.00 times' not in asked()
        view.event(0, 'strain', 'link3', {'hub': 2.0})
        assert '2.00 times' in asked()
        count = len(pages)
        draw()
        assert len(pages) == count <= 5
        with pytest.raises(UsageError, match=f'no web page on port {port}'):
            with served(view, port):
                pass
    with pytest.raises(OSError):
        urlopen(url)
