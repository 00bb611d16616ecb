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

"""
Cost of a sample in the monitor's numerics, without ROS: a recording through the live chain.

Counting is what it costs beside the chain itself to know which share of the samples is judged;
keeping, what the black box takes of its messages, ring full, stamped by the clock of a node.

The same object runs in the node `monitor`; `tudor evaluate --collisions` replays bags through it.
An elastic model takes several steps between two samples, the more the longer the time between
them, so its cost depends on the rate: `--rate` puts other samples on the same motion.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
import time
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.models.bundle import load_bundle, ModelBundle
from tudor_dynamics.online.black_box import MessageRing
from tudor_dynamics.online.coverage import Coverage
from tudor_dynamics.online.monitor import Monitor, MonitorSettings, warm_up


@dataclass(frozen=True, eq=False)
class Taken:
    """Times of each sample after the first second: all of it, and parts of it [us]."""

    whole: np.ndarray
    prediction: np.ndarray
    counting: np.ndarray
    keeping: np.ndarray


def resampled(recording: Recording, rate: float) -> Recording:
    """Put samples at another rate on the motion of a recording without gaps."""
    t = recording.t
    new = np.arange(int(t[-1] * rate) + 1) / rate

    def smooth(values: np.ndarray | None) -> np.ndarray | None:
        return None if values is None else np.asarray(CubicSpline(t, values)(new))

    return replace(
        recording, stamp=recording.stamp[0] + np.round(new * 1e9).astype(np.int64),
        q=smooth(recording.q), dq=smooth(recording.dq), effort=smooth(recording.effort),
        strain=smooth(recording.strain), segments=(slice(0, len(new)),), dt=1.0 / rate)


def measure(bundle: ModelBundle, recording: Recording, settings: MonitorSettings) -> Taken:
    """Run a recording through."""
    warm_up(bundle, settings)
    monitor = Monitor(bundle, settings)
    predict = monitor.predictor.step
    inside = [0]

    def timed(*args: Any) -> Any:
        begin = time.perf_counter_ns()
        predicted = predict(*args)
        inside[0] = time.perf_counter_ns() - begin
        return predicted

    monitor.predictor.step = timed  # type: ignore[method-assign]
    outputs = {output: values for output, values in (
        ('effort', recording.effort), ('strain', recording.strain)) if values is not None}
    coverage = Coverage()
    for output in monitor.watch.outputs:
        coverage.add(output, 'joints', None, (output,),
                     [monitor.filter.drops, monitor.watch.counts[output]],
                     [monitor.watch.pairing[output].drops], monitor.watch.settle)
    topics = ('joints', *monitor.watch.outputs)
    taken = []
    ring, data, now = MessageRing(), bytes(200), ros_clock()
    period = round(1e9 * recording.dt)
    for time_before in range(0, 30 * 10**9, period):
        for topic in topics:
            ring.add(now() - 30 * 10**9 + time_before, topic, 'sensor_msgs/msg/JointState', data)
    for k, stamp in enumerate(recording.stamp.tolist()):
        q, dq = recording.q[k], None if recording.dq is None else recording.dq[k]
        values = [(output, outputs[output][k]) for output in monitor.watch.outputs]
        begin = time.perf_counter_ns()
        for topic in topics:
            coverage.came(topic, stamp, stamp * 1e-9)
        counted = time.perf_counter_ns() - begin
        begin = time.perf_counter_ns()
        for topic in topics:
            ring.add(now() + k * period, topic, 'sensor_msgs/msg/JointState', data)
        kept = time.perf_counter_ns() - begin
        begin = time.perf_counter_ns()
        monitor.add_joints(stamp, q, dq)
        for output, reading in values:
            monitor.add_measured(output, stamp, reading)
        taken.append((time.perf_counter_ns() - begin, inside[0], counted, kept))
    first = int(np.searchsorted(recording.stamp, recording.stamp[0] + 10**9))
    return Taken(*1e-3 * np.array(taken[first:]).T)


def ros_clock() -> Callable[[], int]:
    """Give the clock that a node has; that of Python where there is no ROS."""
    try:
        from rclpy.clock import Clock
    except ImportError:
        return time.time_ns
    now = Clock().handle.get_now
    return lambda: int(now().nanoseconds)


def choices(bundle: ModelBundle) -> Iterator[MonitorSettings]:
    """Give what is measured: every kind of model, by several methods."""
    for kind in sorted({kind for models in bundle.models.values() for kind in models}):
        every: list[tuple[str, ...]] = [('strain',), ('strain', 'effort')]
        if 'analytical' in bundle.models.get('effort', {}):
            every.append(('strain', 'effort', 'momentum'))
        for methods in every:
            yield MonitorSettings(kind=kind, methods=methods)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--model', required=True, help='bundle of tudor fit')
    parser.add_argument('--runs', type=int, default=3)
    parser.add_argument('--rate', type=float, help='samples per second (as recorded)')
    parser.add_argument('bag')
    args = parser.parse_args()
    bundle = load_bundle(args.model)
    recording = read_recording(args.bag, bundle.arm)
    if args.rate:
        recording = resampled(recording, args.rate)
    print(f'{len(recording.stamp)} samples at {1.0 / recording.dt:g} Hz, medians of {args.runs} '
          'runs, us a sample')
    print(f'{"":36s} {"whole sample":>17s} {"prediction":>17s} {"counting":>17s} {"keeping":>17s}')
    print(f'{"model":11s} {"methods":24s}' + f' {"median":>8s} {"p99":>8s}' * 4)
    for settings in choices(bundle):
        runs = [measure(bundle, recording, settings) for _ in range(args.runs)]
        figures = [float(np.median([np.percentile(values, share) for values in of]))
                   for of in ([run.whole for run in runs], [run.prediction for run in runs],
                              [run.counting for run in runs], [run.keeping for run in runs])
                   for share in (50, 99)]
        print(f'{settings.kind:11s} {", ".join(settings.methods):24s}',
              *(f'{value:8.1f}' for value in figures), flush=True)


if __name__ == '__main__':
    main()
