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

"""Messages and events that are kept: bounds, order, and what is removed."""

from __future__ import annotations

import json
from pathlib import Path
import signal
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from tudor_dynamics.bags.storage import bags_below, open_bag
from tudor_dynamics.errors import BagError
from tudor_dynamics.online.black_box import (
    ASKED, EVENTS, Heard, MessageRing, record_of, replayed, write_events)
from tudor_dynamics.online.detector import CollisionEvent, Excess
from tudor_dynamics.online.settings import BAGS, RING_BYTES, RING_TIME
from tudor_dynamics.online.streams import Motion, Residual

KIND = 'std_msgs/msg/String'
RECORD = {'onset': 5, 'link': 'link3'}


def ring(count: int = 3, size: int = 8) -> MessageRing:
    """Fill a ring with a message each millisecond."""
    made = MessageRing()
    for k in range(count):
        made.add(10**9 + k * 10**6, '/a' if k % 2 else '/b', KIND, bytes([k % 256]) * size)
    return made


def test_messages_of_one_instant_keep_their_order() -> None:
    """Also of several topics: log times increase."""
    made = MessageRing()
    for k, topic in enumerate(('/b', '/a', '/b', '/a')):
        made.add(7, topic, KIND, bytes([k]))
    assert [data[0] for _, _, _, data in made.kept()] == [0, 1, 2, 3]
    times = [time for time, _, _, _ in made.kept()]
    assert times == sorted(set(times))


def test_old_messages_go() -> None:
    """What is older than 30 s, or too much, is forgotten from the oldest on."""
    made = ring(3)
    made.add(10**9 + round(RING_TIME * 1e9) + 1_000_000, '/a', KIND, b'')
    assert len(made.kept()) == 3
    made = ring(5, RING_BYTES // 4)
    assert [data[0] for _, _, _, data in made.kept()] == [1, 2, 3, 4]


def test_a_message_that_is_too_large_is_not_kept() -> None:
    """Whatever a topic carries, the ring stays within its bounds."""
    made = ring(3)
    made.add(2 * 10**9, '/a', KIND, bytes(RING_BYTES + 1))
    assert not made.kept()
    made.add(3 * 10**9, '/a', KIND, b'x')
    assert len(made.kept()) == 1


def test_a_load_that_was_said_long_ago_is_kept() -> None:
    """The last of them stands just before the ring, in its time."""
    made = MessageRing()
    for k, load in enumerate((b'first', b'last')):
        made.add(10**9 + k, f'/left/{ASKED}', KIND, load)
    later = 10**9 + 2 * round(RING_TIME * 1e9)
    made.add(later, '/a', KIND, b'x')
    assert [(time, data) for time, _, _, data in made.kept()] == [(later - 1, b'last'),
                                                                  (later, b'x')]


def test_a_clock_set_back_forgets_no_load() -> None:
    """What is carried is carried, whatever the clock says: the newest of all that were said."""
    made = MessageRing()
    for k, (topic, load) in enumerate(((ASKED, b'first'), (ASKED, b'last'), ('/a', b'x'))):
        made.add(10**12 + k, topic, KIND, load)
    made.add(10**9, '/a', KIND, b'y')
    assert [data for _, _, _, data in made.kept()] == [b'last', b'y']


@pytest.mark.parametrize('asked', [
    [np.nan, 0.0, 0.0], [0.2, np.nan, 0.0], [np.inf, 0.0, 1.0]])
def test_loads_that_nobody_has_are_passed_over(asked: list[float]) -> None:
    """A bag is not to be trusted; the node took none of these."""
    watch = SimpleNamespace(outputs=(), answer=lambda *given: pytest.fail(str(given)))
    arm = SimpleNamespace(spec=SimpleNamespace(joint_topic='/joint_states'))
    messages = [Heard(1, 0, ASKED, {ASKED: np.array(asked)})]
    assert not [*replayed(messages, arm, SimpleNamespace(watch=watch))]


def test_a_clock_set_back_begins_again() -> None:
    """What was kept has times that mean nothing any more."""
    made = ring(3)
    made.add(10**9 - round(RING_TIME * 1e9) - 1, '/a', KIND, b'x')
    assert [data for _, _, _, data in made.kept()] == [b'x']


def test_round_trip(tmp_path: Path) -> None:
    """The bag has the messages, and the records."""
    bag = open_bag(write_events(tmp_path / 'new', ring().kept(), [RECORD, RECORD]))
    assert {name: info.count for name, info in bag.topics.items()} == {'/a': 1, '/b': 2}
    assert json.loads(bag.metadata.custom[EVENTS]) == [RECORD, RECORD]


def test_a_record_has_what_was_known() -> None:
    """Each channel by its name, with what was measured and expected; JSON as it stands."""
    motion = Motion(7, 1.0, 0.01, np.array([0.1, 0.2, 0.3]))
    value, threshold = np.array([3.0, -1.0]), np.array([2.0, 4.0])
    residual = Residual(motion, value + 1.0, np.ones(2), value)
    excess = Excess(residual, value, value, np.array([1.5, 0.25]), value, threshold)
    record = record_of(CollisionEvent(
        5, 7, 'strain', 'link3', {'hub': 3.0, 'mid': -1.0}, {'hub': 1.5, 'mid': 0.25}), [excess])
    assert json.loads(json.dumps(record)) == record
    assert (record['onset'], record['stamp'], record['link']) == (5, 7, 'link3')
    assert record['channel'] == 'hub'
    assert record['measured'] == {'hub': 4.0, 'mid': 0.0}
    assert record['expected'] == {'hub': 1.0, 'mid': 1.0}
    assert record['residual'] == {'hub': 3.0, 'mid': -1.0}
    assert record['threshold'] == {'hub': 2.0, 'mid': 4.0}
    assert record['ratio'] == {'hub': 1.5, 'mid': 0.25} and record['motion'] == [0.1, 0.2, 0.3]
    assert record['last_second'] == [[0.0, 4.0, 1.0, 2.0, 1.5]]


@pytest.mark.parametrize('rate', [30, 100, 333, 1000])
def test_a_record_has_the_last_second(rate: int) -> None:
    """At most 50 samples, evenly until that of the event: none after it, none of before."""
    count, at = 3 * rate, 2 * rate
    excesses = []
    for k in range(count):
        row, value = np.zeros(3), np.array([float(k)])
        motion = Motion(k * (10**9 // rate), 1.0, 1.0 / rate, row)
        excesses.append(Excess(Residual(motion, value, value, value), value, value, value, value,
                               value))
    stamp = excesses[at].residual.motion.stamp
    shown = record_of(CollisionEvent(stamp, stamp, 'strain', 'link3', {'hub': 1.0},
                                     {'hub': float(at)}), excesses)['last_second']
    seconds, *_, values = np.array(shown).T
    assert min(rate, 25) <= len(seconds) <= 50 and seconds[-1] == 0.0
    assert values[-1] == at and np.ptp(np.diff(values)) == 0.0
    assert -1.0 <= seconds[0] < -0.9 and np.allclose(seconds, (values - at) / rate, atol=1e-5)


def test_the_oldest_goes_and_foreign_folders_stay(tmp_path: Path) -> None:
    """Of 22 bags 20 are left; what has no record of an event is not ours."""
    (tmp_path / 'event_notes').mkdir()
    other = tmp_path / 'event_0_other'
    write_events(tmp_path / 'elsewhere', ring().kept(), [RECORD]).rename(other)
    (other / 'metadata.yaml').write_text(
        (other / 'metadata.yaml').read_text().replace('tudor_events', 'own'))
    paths = [write_events(tmp_path, ring().kept(), [RECORD]) for _ in range(BAGS + 2)]
    assert [path.exists() for path in paths] == [False] * 2 + [True] * BAGS
    assert other.is_dir() and (tmp_path / 'event_notes').is_dir()


def test_a_full_disk(small_disk: Path) -> None:
    """One line says why, and no part of a bag is left."""
    rng = np.random.default_rng(0)
    made = MessageRing()
    made.add(10**9, '/a', KIND, rng.bytes(2_000_000))
    with pytest.raises(BagError, match='cannot be written'):
        write_events(small_disk, made.kept(), [RECORD])
    assert not [path for path in small_disk.rglob('*') if path.is_file()]


KILLED = """
import os, signal, sys
from pathlib import Path
from rosbags.rosbag2 import Writer
from tudor_dynamics.online.black_box import MessageRing, write_events
ring, written, write = MessageRing(), [], Writer.write
for k in range(20_000):
    ring.add(10**9 + k, '/a', 'std_msgs/msg/String', os.urandom(200))
def some(*arguments):
    written.append(write(*arguments))
    if len(written) == 15_000:
        os.kill(os.getpid(), signal.SIGKILL)
Writer.write = some
write_events(Path(sys.argv[1]), ring.kept(), [])
"""


def test_killed_in_the_middle(tmp_path: Path) -> None:
    """What was half written is taken for no bag, and the next event is kept beside it."""
    done = subprocess.run([sys.executable, '-c', KILLED, str(tmp_path)], check=False)
    assert done.returncode == -signal.SIGKILL
    assert sum(path.stat().st_size for path in tmp_path.rglob('*') if path.is_file()) > 10**6
    assert not list(tmp_path.glob('event_*')) and bags_below(tmp_path) == [tmp_path]
    path = write_events(tmp_path, ring().kept(), [RECORD])
    assert bags_below(tmp_path) == [path]
