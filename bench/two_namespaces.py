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

"""Two hosts on one machine: network namespaces, joined by a bridge that cuts, loses and delays."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
import ctypes
from dataclasses import dataclass
import fcntl
import multiprocessing
import os
import random
import select
import shutil
import signal
import struct
import subprocess
import time
from typing import Any

CLONE_NEWNET = 0x40000000
TUNSETIFF, IFF_TAP, IFF_NO_PI = 0x400454ca, 0x0002, 0x1000
FRAME = 4096
"""More than any frame has [bytes]."""
ADDRESSES = ('10.77.0.1', '10.77.0.2')
OWN = ('unshare', '--net', '--pid', '--fork', '--mount-proc', '--kill-child')
PROBE = 'ip link set lo up && ip tuntap add dev probe mode tap && exec unshare --net true'


@dataclass(frozen=True)
class Line:
    """What the bridge does to frames, in both directions."""

    cut: bool = False  # nothing passes
    loss: float = 0.0  # share of frames that are lost
    delay: float = 0.0  # time that each takes [s]


def isolation() -> tuple[list[str], str]:
    """Give the words that put a command into namespaces of its own; or none, and why."""
    for tool in ('unshare', 'ip'):
        if shutil.which(tool) is None:
            return [], f'no {tool} (packages util-linux and iproute2)'
    found = None
    for words in (OWN, (*OWN, '--user', '--map-root-user')):
        found = subprocess.run([*words, 'sh', '-c', PROBE], capture_output=True, text=True)
        if found.returncode == 0:
            return list(words), ''
    assert found is not None
    why = found.stderr.strip().splitlines()
    return [], f'no right to make network namespaces and TAP devices ({why[-1] if why else "?"})'


def ip(*words: str) -> None:
    """Configure the network of this namespace."""
    subprocess.run(['ip', *words], check=True)


def tap(name: str) -> int:
    """Make a TAP device, and give the end at which its frames come out and go in."""
    end = os.open('/dev/net/tun', os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(end, TUNSETIFF, struct.pack('16sH', name.encode(), IFF_TAP | IFF_NO_PI))
    return end


def frames(end: int) -> list[bytes]:
    """Take all frames that wait."""
    found = []
    while len(found) < 1000:
        try:
            found.append(os.read(end, FRAME))
        except BlockingIOError:
            break
        except OSError:  # the device is still down
            break
    return found


def forward(ends: Sequence[int], orders: Any, seed: int) -> None:
    """Forward frames from each end to the other until the orders end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who gives the orders ends it
    chance = [random.Random(2 * seed + side) for side in (0, 1)]
    waiting: list[deque[tuple[float, bytes]]] = [deque(), deque()]
    line = Line()
    while True:
        due = min((queue[0][0] for queue in waiting if queue), default=None)
        patience = None if due is None else max(0.0, due - time.monotonic())
        ready, _, _ = select.select([*ends, orders], [], [], patience)
        if orders in ready:
            try:
                line = orders.recv()
            except EOFError:
                return
        now = time.monotonic()
        for side, end in enumerate(ends):
            for frame in frames(end) if end in ready else ():
                if not line.cut and chance[side].random() >= line.loss:
                    waiting[side].append((now + line.delay, frame))
            queue, target = waiting[side], ends[1 - side]
            while queue and (line.cut or queue[0][0] <= time.monotonic()):
                _, frame = queue.popleft()
                try:
                    os.write(target, frame) if not line.cut else None
                except OSError:  # its queue is full, as that of a switch can be
                    pass


def inhabit(pipe: Any, side: int, settings: dict[str, str], make: Callable[[int], Any]) -> None:
    """Be a host: a namespace, a network, and an object whose methods are called over a pipe."""
    if ctypes.CDLL(None, use_errno=True).unshare(CLONE_NEWNET) != 0:
        raise OSError(ctypes.get_errno(), 'no network namespace')
    pipe.send(os.getpid())
    pipe.recv()
    device = f'tap{side}'
    ip('link', 'set', 'lo', 'up')
    ip('addr', 'add', f'{ADDRESSES[side]}/24', 'dev', device)
    ip('link', 'set', device, 'up')
    ip('route', 'add', '224.0.0.0/4', 'dev', device)
    os.environ.update(settings)
    inhabitant = None
    try:
        inhabitant = make(side)
        pipe.send(None)
        while True:
            inhabitant.spin(0.01)
            while pipe.poll():
                name, args, values = pipe.recv()
                pipe.send(getattr(inhabitant, name)(*args, **values))
    except (EOFError, KeyboardInterrupt):
        pass
    finally:
        if inhabitant is not None:
            inhabitant.close()


class Host:
    """A host, seen from outside: methods of what lives there are called by `ask`."""

    def __init__(self, side: int, settings: dict[str, str], make: Callable[[int], Any]) -> None:
        spawn = multiprocessing.get_context('spawn')
        self._pipe, other = spawn.Pipe()
        self.process = spawn.Process(target=inhabit, args=(other, side, settings, make))
        self.process.start()
        other.close()
        ip('link', 'set', f'tap{side}', 'netns', str(self._pipe.recv()))
        self._pipe.send(None)
        self._pipe.recv()

    def ask(self, method: str, *args: Any, **values: Any) -> Any:
        """Call a method there and give its result."""
        self._pipe.send((method, args, values))
        return self._pipe.recv()

    def close(self) -> None:
        """End the host."""
        self._pipe.close()
        self.process.join(30.0)
        if self.process.is_alive():
            self.process.kill()


class Network:
    """Two hosts and the line between them."""

    def __init__(self, make: Callable[[int], Any], settings: dict[str, str], seed: int) -> None:
        self._ends = [tap(f'tap{side}') for side in (0, 1)]
        fork = multiprocessing.get_context('fork')
        self._orders, other = fork.Pipe()
        self._bridge = fork.Process(target=self._forward, args=(other, seed), daemon=True)
        self._bridge.start()
        other.close()
        self.hosts: list[Host] = []
        try:
            for side in (0, 1):
                self.hosts.append(Host(side, settings, make))
        except BaseException:
            self.close()
            raise

    def _forward(self, orders: Any, seed: int) -> None:
        self._orders.close()  # the other end, which would never end otherwise
        forward(self._ends, orders, seed)

    def set(self, line: Line) -> None:  # noqa: A003
        """Change what the bridge does."""
        self._orders.send(line)

    def close(self) -> None:
        """End hosts and bridge; devices and namespaces go with them."""
        for host in self.hosts:
            host.close()
        self._orders.close()
        self._bridge.join(5.0)
        for end in self._ends:
            os.close(end)

    def __enter__(self) -> Network:
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()
