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

The same object runs in the node `monitor`; `tudor evaluate --collisions` replays bags through it.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from tudor_dynamics.bags import read_recording
from tudor_dynamics.models.bundle import load_bundle, ModelBundle
from tudor_dynamics.monitoring.monitor import Monitor
from tudor_dynamics.monitoring.rehearsal import rehearse
from tudor_dynamics.monitoring.watch import MonitorSettings


def measure(bundle: ModelBundle, bag: str, settings: MonitorSettings) -> np.ndarray:
    """Run a bag through; time of each sample behind the first second [us]."""
    recording = read_recording(bag, bundle.arm)
    rehearse(bundle, settings)
    monitor = Monitor(bundle, settings)
    outputs = {output: values for output, values in (
        ('effort', recording.effort), ('strain', recording.strain)) if values is not None}
    taken = []
    for k, stamp in enumerate(recording.stamp.tolist()):
        q, dq = recording.q[k], None if recording.dq is None else recording.dq[k]
        values = [(output, outputs[output][k]) for output in monitor.watch.outputs]
        begin = time.perf_counter_ns()
        monitor.add_joints(stamp, q, dq)
        for output, reading in values:
            monitor.add_measured(output, stamp, reading)
        taken.append(time.perf_counter_ns() - begin)
    first = int(np.searchsorted(recording.stamp, recording.stamp[0] + 10**9))
    return 1e-3 * np.array(taken[first:])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--model', required=True, help='bundle of tudor fit')
    parser.add_argument('--runs', type=int, default=3)
    parser.add_argument('bag')
    args = parser.parse_args()
    bundle = load_bundle(args.model)
    kinds = sorted({kind for models in bundle.models.values() for kind in models})
    print(f'{"model":12s} {"methods":26s} {"median us":>10s} {"p99 us":>8s}')
    for kind in kinds:
        for methods in (('strain',), ('strain', 'effort'), ('strain', 'effort', 'momentum')):
            settings = MonitorSettings(kind=kind, methods=methods)
            runs = [measure(bundle, args.bag, settings) for _ in range(args.runs)]
            middle = np.median([np.median(run) for run in runs])
            late = np.median([np.percentile(run, 99) for run in runs])
            print(f'{kind:12s} {", ".join(methods):26s} {middle:10.1f} {late:8.1f}')


if __name__ == '__main__':
    main()
