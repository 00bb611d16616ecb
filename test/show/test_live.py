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
    ABOVE, bar, EVENTS, HISTORY, history, KEPT, LiveView, number, page_of, served, shown)

SECOND = 10**9


def drawn(view: LiveView, width: int = 80) -> list[str]:
    """Draw a view as text."""
    file = io.StringIO()
    Console(file=file, width=width, color_system=None).print(view)
    return [line.rstrip() for line in file.getvalue().splitlines()]


def filled() -> LiveView:
    """Give a view of two methods and an event."""
    view, names = LiveView('arm: run4'), ('hub', 'middle')
    for k in range(40):
        view.take(k * SECOND, 'strain', 'ratio', names, np.array([0.1, 0.02 * k]))
        view.take(k * SECOND, 'momentum', 'ratio', ('joint2',), np.array([1.5 * (k == 20)]))
    view.take(39 * SECOND, 'strain', 'residual', names, np.array([-12.34, 1234.5]))
    view.take(39 * SECOND, 'strain', 'threshold', names, np.array([123.4, 2345.6]))
    view.event(20 * SECOND, 'momentum', 'link2', {'joint1': 0.3, 'joint2': 1.5})
    view.diagnosed({'state: strain hub [um/m]': 'ok', 'state: strain middle [um/m]': 'stuck',
                    'state: momentum joint2 [N m]': 'ok', 'state: effort joint2 [N m]': 'silent',
                    'judged [%]': '98', 'load': 'load 0.200 +- 0.012 kg, estimated'})
    view.level = 'collision'
    return view


def test_what_it_draws() -> None:
    """Level, each channel with its state, the event with its time."""
    lines = drawn(filled())
    assert lines[0].startswith('arm: run4') and lines[0].endswith(time_of_day(39 * SECOND))
    assert lines[1].startswith('collision') and lines[1].endswith('98 % judged')
    rows = {method: [line.replace('\u2501', '').split() for line in lines[lines.index(head) + 1:][
        :count]] for method, count in (('strain', 2), ('momentum', 1), ('effort', 1))
        for head in lines if head.startswith(method)}
    assert rows == {'strain': [['hub', '-12.3', '123', 'um/m', '0.10', '\u2502', 'ok'],
                               ['middle', '1234', '2346', 'um/m', '0.78', '\u2502', 'stuck']],
                    'momentum': [['joint2', 'N', 'm', '0.00', '\u2502', 'ok']],
                    'effort': [['joint2', 'N', 'm', 'silent']]}
    (event,) = [line for line in lines if '1.50 times its threshold' in line]
    assert event.startswith(time_of_day(20 * SECOND)) and 'link2 by momentum: joint2' in event
    assert 'load 0.200 +- 0.012 kg, estimated' in lines and max(map(len, lines)) <= 80
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
    view.diagnosed({f'state: {method} {name} [um/m]': 'not judged' for method, name in (
        ('strain', 'shoulder_pan_joint'), ('strain', 'middle'), ('momentum', 'joint2'))})
    lines = drawn(view, width)
    assert lines[0].startswith('arm: run4') and lines[0].endswith(time_of_day(39 * SECOND))
    assert lines[1].startswith('collision') and lines[1].endswith('98 % judged')
    assert lines[2].startswith('weak collisions') and not lines[2].endswith('training, ')
    assert ' '.join(lines).count('outside the') >= 5 and max(map(len, lines)) <= width
    assert not any('\u2026' in line for line in lines)
    strain = next(line for line in lines if line.startswith('strain'))
    assert strain[:39].endswith('\u2586'), 'the newest second is at the right'
    assert sum(line.endswith('not judged') for line in lines) == 3
    assert any('shoulder_pan_joint' in line for line in lines)


def test_stamps_that_go_back() -> None:
    """A bag or a simulation begins again, and the time with it; a late message changes nothing."""
    view = filled()
    view.take(39 * SECOND - SECOND // 2, 'strain', 'ratio', ('hub',), np.array([0.1]))
    assert view.stamp == 39 * SECOND and set(view.peaks) == {'strain', 'momentum'}
    view.take(3 * SECOND, 'strain', 'ratio', ('hub',), np.array([0.1]))
    assert view.stamp == 3 * SECOND and view.peaks == {'strain': {3: 0.1}}
    assert view.values == {('strain', 'ratio'): {'hub': 0.1}}


def test_history() -> None:
    """The largest ratio of each second counts; seconds without samples stay blank."""
    view = LiveView('arm')
    for stamp, ratio in ((0.0, np.nan), (1.0, 0.1), (1.5, 2.0), (1.9, 0.1), (4.0, 0.999),
                         (5.0, 0.0)):
        view.take(round(stamp * SECOND), 'strain', 'ratio', ('hub',), np.array([ratio]))
    text = history(view.peaks['strain'], 5 * SECOND).plain
    assert len(text) == HISTORY and text[-6:] == f'{ABOVE}{ABOVE}  \u2587\u2581' and not text[
        :-6].strip()


def test_a_long_time() -> None:
    """What is kept does not grow: seconds that are shown, and the newest events."""
    view = LiveView('arm')
    for k in range(500):
        view.take(k * SECOND, 'strain', 'ratio', ('hub',), np.array([0.1]))
        view.event(k * SECOND, 'strain', 'link3', {'hub': 2.0})
    assert list(view.peaks['strain']) == list(range(500 - HISTORY, 500))
    assert len(view.events) == KEPT >= 20
    lines = [line for line in drawn(view) if 'times its threshold' in line]
    assert [line[:24] for line in lines] == [
        time_of_day(k * SECOND)[:24] for k in range(499, 499 - EVENTS, -1)]
    page = page_of(view)
    assert page.count('<li>') == KEPT
    assert page.index(time_of_day(499 * SECOND)) < page.index(time_of_day(498 * SECOND))


def test_the_bag_of_an_event() -> None:
    """Each event in it has the command that explains it; one line has the newest of them."""
    view = filled()
    view.event(21 * SECOND, 'momentum', 'link2', {'joint2': 1.2})
    view.event(22 * SECOND, 'momentum', 'link2', {'joint2': 1.3})
    view.diagnosed({'last bag': '/my events/<b>', 'events in it': ', '.join(
        time_of_day(k * SECOND) for k in (21, 22))})
    why = "tudor why '/my events/<b>'"
    assert list(view.events.values()) == ['', why, why]
    lines = drawn(view)
    assert lines.count(f'  {why}') == 1 and lines[lines.index(f'  {why}') - 1].startswith(
        time_of_day(22 * SECOND))
    code = '<code>tudor why &#39;/my events/&lt;b&gt;&#39;</code>'
    assert page_of(view).count(code) == 2 and page_of(view, whole=False).count(code) == 2


@pytest.mark.parametrize('lines', [10, 18, 24])
def test_a_low_terminal(lines: int) -> None:
    """What fits is drawn: first what is wrong, then what is nearest to its threshold."""
    view, names = LiveView('arm'), [f'joint{k}' for k in range(8)]
    for method in ('effort', 'momentum'):
        view.take(SECOND, method, 'ratio', names, np.linspace(0.1, 0.8, 8))
    view.diagnosed({f'state: {method} {name} [A]': 'silent' if name == 'joint0' else 'ok'
                    for method in ('effort', 'momentum') for name in names} | {'load': 'no load'})
    file = io.StringIO()
    Console(file=file, width=80, height=lines, color_system=None).print(view)
    text = file.getvalue()
    assert text.count('silent') == 2 and 'no load' in text and 'no events' in text
    assert len(text.splitlines()) <= lines
    assert ('have no room' in text) == (lines < 24) and '0.10' not in text
    assert text.count('0.80') == 2 * (lines > 10) and text.count('0.20') == 2 * (lines == 24)


@pytest.mark.parametrize('value, text', [
    (0.0123456, '0.0123'), (-12.34, '-12.3'), (999.4, '999'), (-123456.7, '-123457')])
def test_number(value: float, text: str) -> None:
    """Three digits; large values whole, without an exponent."""
    assert number(value) == text


@pytest.mark.parametrize('ratio, full', [(0.0, 0), (1.0, 6), (7.0, 12), (np.nan, 12)])
def test_bar(ratio: float, full: int) -> None:
    """The mark is at the threshold, whatever the ratio."""
    text = bar(ratio).plain
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

    def counted(drawn: LiveView, *, whole: bool = True) -> str:
        pages.append(drawn)
        return page_of(drawn, whole=whole)

    monkeypatch.setattr(live, 'page_of', counted)
    with shown(view, port, terminal=False) as draw, ThreadPoolExecutor() as pool:
        url = f'http://127.0.0.1:{port}/'

        def asked(path: str = '') -> str:
            answer = pool.submit(urlopen, url + path)
            while not answer.done():
                draw()
            return str(answer.result().read().decode())

        assert capsys.readouterr().err == f'page: {url}\n'
        assert 'arm &lt;b&gt;' in asked() and '2.00 times' not in asked()
        view.event(0, 'strain', 'link3', {'hub': 2.0})
        assert '2.00 times' in asked()
        body = asked('body')
        assert '2.00 times' in body and body.startswith('\n<pre') and 'script' not in body
        count = len(pages)
        draw()
        assert len(pages) == count <= 6
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


def test_a_page_loads_nothing_but_itself() -> None:
    """One script, its own, which is allowed once; names are no part of it."""
    view = filled()
    view.event(0, '<script>', 'link3', {'hub': 2.0})
    view.diagnosed({'state: strain <script>alert(1)</script> [um/m]': 'ok'})
    page, again = page_of(view), page_of(view)
    nonces = re.findall(r'nonce[-=]"?([\w-]+)', page)
    assert len(nonces) == 2 and len({*nonces}) == 1 and nonces[0] not in again
    policy = re.search('Content-Security-Policy" content="(.*?)"', page)
    assert policy and policy[1].split('; ') == [
        "default-src 'none'", "style-src 'unsafe-inline'", "connect-src 'self'",
        f"script-src 'nonce-{nonces[0]}'"]
    assert page.count('<script') == 1 and 'http' not in page.replace('http-equiv', '')
    assert 'http-equiv="refresh"' in re.findall('<noscript>(.*?)</noscript>', page)[0]
    assert page.count('http-equiv="refresh"') == 1
