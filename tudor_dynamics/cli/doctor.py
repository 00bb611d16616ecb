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

"""``tudor doctor``: whether this machine has what is needed; what a bug report says of a call."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout
import ctypes
from dataclasses import asdict, dataclass
from importlib.util import find_spec
import io
import json
import os
from pathlib import Path
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
from typing import Any, TextIO

from tudor_dynamics.bags.info import describe
from tudor_dynamics.cli.console import print_json, say, say_verdict, steps, write
from tudor_dynamics.compiled import DIRECTORY
from tudor_dynamics.files import check_target, installed, provenance, read_bounded, SIGNATURE
from tudor_dynamics.identification.dataset import parse_choice
from tudor_dynamics.identification.validation import Grade
from tudor_dynamics.online.settings import BAGS, RING_BYTES

EXAMPLES = """\
examples:
  tudor doctor --json

It looks at versions, ROS 2, clock, processor, rights and space, writes into the folders that nodes
use, listens for 5 s to live topics of joint states, and says what to do. exit codes: 0 nothing to
do; 1 something to do.
"""
DETAILS = 'print the variables of the environment that change what runs, too'
VARIABLES = 'AMENT_', 'CYCLONEDDS_', 'FASTDDS_', 'NUMBA_', 'PYTHON', 'RMW_', 'ROS_', 'TUDOR_'
LAST_DOMAIN = 101  # the ports of larger ones are among those that Linux gives to any program
FIRST_YEAR = 2024  # a clock that is set is not before it
OLDEST, YOUNGEST = 0.1, -0.01  # ages of stamps that clocks in step give [s]
PAUSE = 0.1  # within which a stream that runs sends again [s]
OTHER_CLOCK = 3e6  # age from which on stamps are of a simulation or a bag [s]
UNSYNCHRONISED = 5  # what adjtimex answers while nothing sets the clock of the kernel
LONGEST = 1_000_000  # characters of the output that a bug report keeps


@dataclass(frozen=True)
class Check:
    """What was looked at, what was found, and what to do; empty for nothing."""

    name: str
    found: str
    remedy: str = ''


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``tudor doctor``."""


def run(args: argparse.Namespace) -> int:
    """Look at everything, and print it."""
    with steps(2) as step:
        step('machine')
        found = list(checks())
        step('live topics')
        found += live_topics()
    remedies = [check for check in found if check.remedy]
    if args.json:
        print_json({'made': provenance(), 'checks': [asdict(check) for check in found]})
    else:
        say_verdict(*((Grade.USABLE, 'to do:') if remedies else (Grade.GOOD, 'nothing to do')))
        say(*(f'  {check.name}: {check.remedy}' for check in remedies))
        variables = [item for item in sorted(os.environ.items()) if item[0].startswith(VARIABLES)]
        say(*(f'{name}: {text}' for name, text in (
            *provenance().items(), *((check.name, check.found) for check in found),
            *variables * args.verbose)))
    return 1 if remedies else 0


def checks() -> Iterator[Check]:
    """Look at one thing after the other."""
    yield from _ros()
    yield _clock()
    cores, busy = len(os.sched_getaffinity(0)), os.getloadavg()[0]
    yield Check('processor', f'{cores} cores, load {busy:.1f}', '' if busy < cores else (
        'other programs use all cores: nodes will be late, and samples not judged'))
    yield _writable('compiled loops', DIRECTORY, 'set NUMBA_CACHE_DIR to a folder that can be '
                    'written: each process compiles for a minute otherwise')
    home = Path(os.environ.get('ROS_HOME') or '~/.ros').expanduser()
    events = home / 'tudor_dynamics' / 'events'
    yield _writable('bags of events', events, 'set ROS_HOME, or event_bags of the monitor')
    free, wanted = shutil.disk_usage(_existing(events)).free, BAGS * RING_BYTES
    yield Check('space for them', f'{free / 1e9:.1f} GB', '' if free > wanted else (
        f'events need up to {wanted / 1e9:.1f} GB there'))
    yield _writable('temporary files', Path(tempfile.gettempdir()), 'set TMPDIR')


def _ros() -> Iterator[Check]:
    if find_spec('rclpy') is None:
        yield Check('ROS 2', 'no rclpy', 'source /opt/ros/jazzy/setup.bash for nodes; bags, fits '
                    'and simulation need none')
        return
    distribution = os.environ.get('ROS_DISTRO', '')
    yield Check('ROS 2', f'{distribution or "wheels"}, rclpy {installed("rclpy") or "there"}',
                '' if distribution in ('', 'jazzy') else 'only jazzy is tested: source its '
                'setup.bash')
    yield Check('middleware', _said(sys.executable, '-c', 'import rclpy; print('
                                    'rclpy.get_rmw_implementation_identifier())') or 'not known')
    domain = os.environ.get('ROS_DOMAIN_ID', '')
    known = not domain or (domain.isdecimal() and int(domain) <= LAST_DOMAIN)
    yield Check('domain', domain or '0, the default',
                '' if known else f'set ROS_DOMAIN_ID to 0 to {LAST_DOMAIN}')
    yield Check('discovery', os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE') or 'SUBNET, the '
                'default', 'unset ROS_LOCALHOST_ONLY, which overrides the discovery range of jazzy'
                if os.environ.get('ROS_LOCALHOST_ONLY') == '1' else '')


def live_topics() -> Iterator[Check]:
    """Look at joint states that arrive, in a process of its own: nodes alone use ROS."""
    if find_spec('rclpy') is None:
        return
    try:
        said = subprocess.run([sys.executable, '-m', 'tudor_dynamics.nodes', 'live_topics'],
                              capture_output=True, text=True, timeout=60.0, check=True).stdout
        heard = json.loads(said)
    except (OSError, subprocess.SubprocessError, ValueError) as err:
        yield Check('live topics', 'not heard', f'rclpy does not run ({err}): mend the '
                    'installation of ROS 2')
        return
    yield from ([_live_topic(topic, **found) for topic, found in heard.items()]
                or [Check('live topics', 'no joint states')])


def _live_topic(
    topic: str, publishers: int, rate: float = 0.0, gap: float = 0.0, age: float = 0.0,
) -> Check:
    if not publishers:
        return Check(topic, 'no node publishes it', 'a node waits for it: start its driver')
    if not rate:
        return Check(topic, 'nothing arrives', 'a node publishes it: see whether that node runs')
    foreign = abs(age) > OTHER_CLOCK
    said = [f'{publishers} nodes publish it: stop all but one'] * (publishers > 1)
    if gap > PAUSE + 3.0 / rate:
        said.append(f'{gap:.2g} s without a message: look for a busy computer or network')
    if not foreign and not YOUNGEST < age < OLDEST:
        said.append(f'stamps are {abs(age):.3g} s {"old" if age > 0.0 else "ahead"}: synchronise '
                    'the clocks (chrony, ntp), or let its driver stamp at the measurement')
    clock = 'stamps of a simulation or a bag' if foreign else f'stamps {1e3 * age:.3g} ms old'
    return Check(topic, f'{rate:.4g} Hz, longest gap {1e3 * gap:.3g} ms, {clock}', '; '.join(said))


def _clock() -> Check:
    now = time.strftime('%Y-%m-%d %H:%M:%S %Z')
    if time.localtime().tm_year < FIRST_YEAR:
        return Check('clock', now, 'set the clock: stamps of drivers are compared with it')
    known = _synchronised()
    if known is None:
        return Check('clock', f'{now}; nothing here says whether it is synchronised: see '
                     '`chronyc tracking` or `ntpq -p` where the clock is set')
    return Check('clock', f'{now}, {"not " * (not known)}synchronised', '' if known else
                 'synchronise it (chrony, ntp) where drivers run on another computer')


def _synchronised() -> bool | None:
    """Ask chrony, which need not inform the kernel, then the kernel; None where nobody answers."""
    leap = re.search('Leap status *: *(.*)', _said('chronyc', '-n', 'tracking'))
    if leap:
        return leap[1] != 'Not synchronised'
    try:  # without a request in the structure it changes nothing
        kernel = ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(256))
    except (AttributeError, OSError):  # no such call here
        return None
    return kernel != UNSYNCHRONISED if kernel >= 0 else None


def _said(*call: str) -> str:
    """Give what another program says; empty where it fails."""
    try:
        return subprocess.run(call, capture_output=True, text=True, timeout=5.0,
                              check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ''


def _existing(path: Path) -> Path:
    """Give a folder, or the one above that is there."""
    return next(folder for folder in (path, *path.parents) if folder.exists())


def _writable(name: str, path: Path, remedy: str) -> Check:
    """Write into a folder, or into the one that it will be made in."""
    try:
        with tempfile.TemporaryFile(dir=_existing(path)) as file:
            file.write(bytes(4096))
    except OSError as err:
        return Check(name, str(path), f'{path} cannot be written ({err.strerror}): {remedy}')
    return Check(name, str(path))


# -- One file with all that a bug report needs: versions, call, files, output, traceback

class _Copied:
    """A stream whose text is kept, too."""

    def __init__(self, stream: TextIO, kept: io.StringIO) -> None:
        self._stream, self._kept = stream, kept

    def write(self, text: str) -> int:
        if self._kept.tell() < LONGEST:
            self._kept.write(text)
        return self._stream.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def report(arguments: Sequence[str], output: str = '', ended: str = '') -> str:
    """Write what a bug report needs about a call, and about an exception that is handled."""
    files = [path for word in map(Path, arguments)
             for path in (word, word / 'model.yaml', word / 'arm.yaml')
             if path.suffix in ('.yaml', '.urdf') and path.is_file()
             and os.access(path, os.R_OK) and path.stat().st_size < LONGEST]
    raised = traceback.format_exc() if sys.exc_info()[0] else ''
    return '\n'.join((
        f'bug report, {SIGNATURE}', *(f'{name}: {value}' for name, value in provenance().items()),
        *(f'{check.name}: {check.found}' for check in checks()), f'folder: {Path.cwd()}',
        f'call: {shlex.join(("tudor", *arguments))}', *filter(None, (ended, output, raised)),
        *(f'{path}:\n{read_bounded(path, LONGEST).decode(errors="replace")}' for path in files),
        *filter(None, map(_summary, arguments))))


def _summary(word: str) -> str:
    """Say what is in a bag, as ``tudor info --json`` does; empty of what is no bag."""
    try:
        return f'{word}:\n{json.dumps(describe(parse_choice(word).path).as_dict(), indent=1)}'
    except Exception:  # it is perhaps what the report is about, and its error is there
        return ''


def recorded(path: Path, arguments: Sequence[str], run: Callable[[], int]) -> int:
    """Run a command, and write what a bug report needs about it, however it ends."""
    check_target(path, overwrite=None, name='debug')
    said, begun, code = io.StringIO(), time.monotonic(), None
    try:
        with redirect_stdout(_Copied(sys.stdout, said)), redirect_stderr(
                _Copied(sys.stderr, said)):
            code = run()
        return code
    finally:
        ended = 'ended by the error below' if code is None else f'exit code: {code}'
        write(path, '--debug', report(arguments, said.getvalue(), f'{ended}, after '
                                      f'{time.monotonic() - begun:.1f} s').encode())
