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

"""``tudor evaluate --collisions``: figures on recorded pushes, plot, wrong input."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime
import json
from pathlib import Path
import re

import numpy as np
from printed import unwrapped
import pytest
import tudor_dynamics as td
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.bags.storage import open_bag
from tudor_dynamics.bags.writer import write_bag
from tudor_dynamics.cli.main import main
from tudor_dynamics.models.bundle import load_bundle
from tudor_dynamics.online.black_box import messages_of, replayed
from tudor_dynamics.online.monitor import Monitor, MonitorSettings


@pytest.mark.shared
def test_recorded_pushes(
    laboratory: Path, shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """Six of seven pushes within 80 ms (median), no false alarm; each is a touch to why, too."""
    bags = shared_data / 'bags'
    assert main(['evaluate', '--model', str(laboratory), str(bags / 'arm_200g_pushes'),
                 str(bags / 'arm_200g_free_4'), '--collisions', '--report',
                 str(tmp_path / 'r.html'), '--json']) == 0
    found = json.loads(capsys.readouterr().out)['collisions']
    assert list(found) == ['all', 'strain', 'effort', 'momentum']
    for together in (found['all'], found['strain']):
        assert together['pushes'] == 7 and together['found'] >= 6
        assert together['latency_median'] <= 0.08
    assert all(item['false_alarms'] == 0 for item in found.values())
    assert found['effort']['found'] >= 5 and found['momentum']['found'] >= 5
    assert 'pushes found of 7' in (tmp_path / 'r.html').read_text()
    # what the node does, event by event, the weakest of them included
    why = ['why', str(bags / 'arm_200g_pushes'), '--model', str(laboratory), '--json']
    assert main(why) == 0
    said = json.loads(capsys.readouterr().out)
    assert [(item['onset'], item['ratio']) for item in said] == [
        (item['onset'], item['ratio']) for item in found['all']['event_list']]
    assert min(item['ratio'] for item in said) < 1.1
    assert {item['cause'] for item in said} == {'touch'}


def test_gaps_are_no_free_time(
    root: Path, model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """What was lost, and what settles after it, promises no alarm; how much that is, is said."""
    arm = load_arm(root / 'config/two_blade_arm.yaml')
    whole = read_recording(root / 'bags/two_blade_test', arm)
    kept = whole.t % 3.0 > 0.8
    write_bag(tmp_path / 'bag', Recording.from_arrays(
        whole.t[kept], **{name: values[kept] for name, values in whole.signals.items()}), arm=arm)
    command = ['evaluate', '--model', str(model), str(tmp_path / 'bag'), '--collisions', '--free']
    assert main(command) == 0
    assert ' % of the time was not judged' in ' '.join(capsys.readouterr().out.split())
    assert main([*command, '--json']) == 0
    strain = json.loads(capsys.readouterr().out)['collisions']['strain']
    assert 3600.0 * strain['hours'] < 0.01 * kept.sum() - 2.0, 'filters settle after gaps, too'
    assert strain['hours'] + strain['unjudged'] == pytest.approx(whole.t[-1] / 3600.0, rel=0.1)
    assert main([*command[:3], str(root / 'bags/two_blade_test'), *command[4:]]) == 0
    assert 'not judged' not in capsys.readouterr().out


def thinned(bag: Path, out: Path, loss: float | None) -> None:
    """Lose all messages for 0.27 s in each 0.9 s, or each message with a probability."""
    raw = open_bag(bag).read(list(open_bag(bag).topics))
    random, kept = np.random.default_rng(3), []
    for item in raw.values():
        t = (item.log_time - next(iter(raw.values())).log_time[0]) * 1e-9
        there = t % 0.9 > 0.27 if loss is None else random.random(len(t)) > loss
        there |= item.topic.endswith('applied_wrench')
        kept.append(replace(item, log_time=item.log_time[there], data=[
            data for data, stays in zip(item.data, there, strict=True) if stays]))
    write_bag(out, kept)


@pytest.mark.parametrize('loss', [None, 0.05])
def test_a_busy_machine_is_judged_as_by_the_monitor(
    root: Path, model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    loss: float | None,
) -> None:
    """The same samples and events as by the monitor from the same messages; the rest is said."""
    thinned(root / 'bags/two_blade_pushes', tmp_path / 'bag', loss)
    bundle = load_bundle(model)
    monitor = Monitor(bundle, MonitorSettings(methods=()))
    judged, events = set(), []
    for _, found in replayed(messages_of(open_bag(tmp_path / 'bag'), bundle.arm), bundle.arm,
                             monitor):
        judged |= {excess.residual.motion.stamp for _, excess in found.excesses}
        events += found.events
    assert len(judged) > 400 and events
    together = td.detect(bundle, tmp_path / 'bag')[0]
    watched, = together.watched
    assert together.method == 'all' and watched.stamp.tolist() == sorted(judged)
    assert [(item.event.onset, item.event.stamp, item.event.ratios)
            for item in watched.sightings] == [(item.onset, item.stamp, item.ratios)
                                               for item in events]
    assert watched.not_judged == pytest.approx(0.85 if loss is None else 0.0, abs=0.02)
    words = ['evaluate', '--model', str(model), str(tmp_path / 'bag'), '--collisions']
    assert main(words) == 0
    said = unwrapped(capsys.readouterr().out)
    assert said.startswith('all methods together, as a monitor runs, find')
    assert ('% of the time was not judged: gaps' in said) == (loss is None)
    # of a bag of gaps, no fit can learn what free motion is
    assert main([*words, '--free']) == 0
    said = unwrapped(capsys.readouterr().out)
    assert ('most was not judged; record that motion without gaps' in said) == (loss is None)
    assert ('tudor fit' in said) == (loss is not None)
    table = tmp_path / 'pushes.csv'
    table.write_text('1,2\n', encoding='utf-8')
    assert [*td.roc({'built in': bundle}, tmp_path / 'bag', bundle.arm, [table])] == [
        f'built in: {name}' for name in ('all', 'strain', 'effort', 'momentum')]


@pytest.mark.usefixtures('replayed_once')
def test_the_page_has_the_events_of_the_terminal(
    root: Path, model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """A row for each, in seconds and with the time of day; picture, contents, caption."""
    command = ['evaluate', '--model', str(model), str(root / 'bags/two_blade_pushes'),
               '--collisions']
    assert main([*command, '--report', str(tmp_path / 'r.html')]) == 0
    printed = capsys.readouterr().out
    text = (tmp_path / 'r.html').read_text()
    page = text.partition('<section id="events"')[2].partition('</table>')[0]
    begin, = re.findall('Time 0 s is (.*?)[.]<', page)
    assert f', 0 s is {begin}' in ' '.join(printed.split())  # a long path breaks its line
    rows = [re.findall('<td.*?>(.*?)</td>', row) for row in page.split('<tr>')[2:]]
    assert len(rows) >= 2
    for row in rows:
        assert ' '.join(row).replace('±', '+-') in ' '.join(printed.split())
        at, zero = (datetime.fromisoformat(text) for text in (
            f'{begin[:10]} {row[5]}', begin.removesuffix(' UTC')))
        assert (at - zero).total_seconds() == pytest.approx(float(row[4]), abs=0.006)
    for anchor in re.findall('<li><a href="#(.*?)">', text):
        assert f'<section id="{anchor}"' in text
    assert 'Joints and gauges at the median pose of the bags.' in text
    caption = text.partition('<section id="roc"')[2].partition('</figcaption>')[0]
    windows = re.findall(r'(strain|effort|momentum) (\d+) windows of 1 s in ([.\d]+) min', caption)
    assert len(windows) == 3
    assert all(0 <= int(count) - 60.0 * float(minutes) < 6 for _, count, minutes in windows)


@pytest.mark.usefixtures('replayed_once')
def test_events_where_nothing_more_fits(
    root: Path, model: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    """A narrow terminal has no time of day in the table; its title says when 0 s is."""
    command = ['evaluate', '--model', str(model), str(root / 'bags/two_blade_pushes'),
               '--collisions']
    for width, there in (('80', True), ('60', False)):
        monkeypatch.setenv('COLUMNS', width)
        assert main(command) == 0
        events = unwrapped(capsys.readouterr().out.partition('events in')[2])
        assert ('08:53:28.' in events) is there and '2025-10-09 08:53:20.000 UTC' in events
