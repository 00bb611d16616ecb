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

"""Runs a node as a process: executor, signals, exit code."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import gc
import os
import signal
import sys
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from tudor_dynamics.errors import complain, TudorError
from tudor_dynamics.nodes.settings import SIGNAL_LOOK

EXECUTORS = ('events', 'single')


def new_executor(kind: str, context: Any = None) -> Any:
    """Make an executor; kind: where this rclpy has none, ``single`` is taken."""
    if kind not in EXECUTORS:
        raise TudorError(f'TUDOR_EXECUTOR is {kind}; expected {" or ".join(EXECUTORS)}')
    if kind == 'events':
        try:
            from rclpy.experimental import EventsExecutor
            return EventsExecutor(context=context)
        except ImportError:
            print('this rclpy has no events executor: nothing to do, the single-threaded one runs',
                  file=sys.stderr)
    return SingleThreadedExecutor(context=context)


class Halt:
    """What an executor waits for in order to return: a future without rclpy's lock."""

    # A signal handler runs in the thread that it interrupts, and would wait for ever for a lock
    # that this thread holds.

    def __init__(self) -> None:
        self.asked = False
        self._callback: Callable[[Halt], None] | None = None

    def ask(self, *_: Any) -> None:
        """Ask the executor to return once the running callback is done; a signal handler."""
        self.asked = True
        if self._callback is not None:
            self._callback(self)

    def add_done_callback(self, callback: Callable[[Halt], None]) -> None:
        """Take what ends the executor's waiting; called by the executor."""
        self._callback = callback
        if self.asked:
            callback(self)

    def remove_done_callback(self, _: Callable[[Halt], None]) -> None:
        """Forget it; called by the executor."""
        self._callback = None


def spin_for(executor: Any, seconds: float, halt: Halt | None = None) -> None:
    """Do what there is to do, for some seconds."""
    # The events executor is not asked message by message, which would cost a way out to Python and
    # back for each: it waits for a future. It looks at the clock only where nothing waits to be
    # done, so that without that future a node with more to do than it can would never end.
    if isinstance(executor, SingleThreadedExecutor):
        executor.spin_once(timeout_sec=seconds)
    else:
        executor.spin_until_future_complete(Halt() if halt is None else halt, timeout_sec=seconds)


def run(factory: Callable[[], Any], args: Sequence[str] | None = None) -> int:
    """Run a node until it is asked to stop; factory: of a TudorNode; args: of the process."""
    node: Any = None
    halt = Halt()

    try:
        # Own handlers: rclpy's shut the context down under a running callback, and a damper could
        # not command standstill any more.
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, halt.ask)
        executor = new_executor(os.environ.get('TUDOR_EXECUTOR', 'events'))
        node = factory()
        executor.add_node(node)
        gc.collect()
        # a thread that writes a bag hands over sooner: p99 0.8, not 2.7 ms (bench/node_rates.py)
        sys.setswitchinterval(2e-4)
        gc.freeze()  # shortens the pauses of the collector: p99 0.56 instead of 0.81 ms
        # Shutting the context down in a callback would end it under the executor, and under
        # whatever the callback publishes next: a node that is done says so.
        while rclpy.ok() and not halt.asked and node.exit_code is None:
            spin_for(executor, SIGNAL_LOOK, halt)
    except ExternalShutdownException:
        pass
    except TudorError as err:
        complain(str(err))
        return 2
    except Exception as err:
        # rclpy's own errors of arguments, parameter files and values are not one family
        if node is not None:
            raise
        complain(f'{type(err).__name__}: {" ".join(str(err).split())}')
        return 2
    finally:
        if node is not None:
            node.close()
            node.destroy_node()
        if rclpy.ok():
            rclpy.shutdown()
    return (node and node.exit_code) or 0
