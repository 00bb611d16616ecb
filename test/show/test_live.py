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
from html import unescape
import io
import re
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
    """It says so, and of an arm that nobody watches not that it is free."""
    text = '\n'.join(drawn(LiveView('arm')))
    assert 'no samples yet' in text and 'no events' in text
    assert 'unknown' in text and 'free' not in text


@pytest.mark.parametrize('width', [80, 46])
def test_a_warning_leaves_title_and_level(width: int) -> None:
    """However long it is, and on a telephone, it wraps below them; nothing is cut."""
    view = filled()
    view.warning = 'weak collisions are missed: ' + 'the motion is outside the training, ' * 6
    view.traces['strain'].channel = 'shoulder_pan_joint'
    lines = drawn(view, width)
    assert lines[0].startswith('arm: run4') and lines[0].endswith(time_of_day(39 * SECOND))
    assert lines[1].startswith('collision') and lines[1].endswith('98 % judged')
    assert lines[2].startswith('weak collisions') and not lines[2].endswith('training, ')
    assert ' '.join(lines).count('outside the') >= 5 and max(map(len, lines)) <= width
    assert not any('\u2026' in line for line in lines)
    strain = next(line for line in lines if line.startswith('strain'))
    assert strain.endswith('\u2586'), 'the newest second is at the right'


def test_stamps_that_go_back() -> None:
    """A bag or a simulation begins again, and the time with it; a late message changes nothing."""
    view = filled()
    view.ratios(39 * SECOND - SECOND // 2, 'strain', ('hub',), np.array([0.1]))
    assert view.stamp == 39 * SECOND and set(view.traces) == {'strain', 'momentum'}
    view.ratios(3 * SECOND, 'strain', ('hub',), np.array([0.1]))
    assert view.stamp == 3 * SECOND
    assert [list(trace.peaks) for trace in view.traces.values()] == [[(3, 0.1)]]


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


def test_page(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    """
    A browser gets what is drawn next, names as they are; the address, a port taken are said.

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

        assert capsys.readouterr().err == f'page: {url}\n'
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


def test_a_page_is_read_on_a_telephone() -> None:
    """Where 80 columns would need letters below 12 px, a narrower view takes their place."""
    page = page_of(filled())
    wide, narrow = re.findall('<pre class="[a-z]+">(.*?)</pre>', page, re.DOTALL)
    widest = [max(len(line) for line in unescape(re.sub('<[^>]*>', '', text)).splitlines())
              for text in (wide, narrow)]
    assert widest[0] <= 80 and widest[1] <= 46
    letter = 0.6 * 12  # width of a monospaced letter of 12 px
    assert widest[1] * letter + 16 <= 360 and 'clamp(12px' in page
    limit = re.search(r'max-width: (\d+)px', page)
    assert limit and float(limit[1]) * 0.019 >= 12
