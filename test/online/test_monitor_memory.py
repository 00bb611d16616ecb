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

"""The whole live chain, for hours of a robot's life: memory does not grow."""

from __future__ import annotations

import gc
from pathlib import Path
import sys
import tracemalloc

import numpy as np
import pytest

from tudor_dynamics.models.bundle import load_bundle, ModelBundle
from tudor_dynamics.online.monitor import Monitor, MonitorSettings, warm_up

PERIOD = 1_000_000
"""Time between samples [ns]."""


@pytest.fixture(scope='module')
def bundle(two_blades: Path) -> ModelBundle:
    """Model of the sample bags."""
    return load_bundle(two_blades)


class Life:
    """An arm that swings, is pushed, loses messages, and whose sensors fail now and then."""

    def __init__(self, bundle: ModelBundle, methods: tuple[str, ...]) -> None:
        settings = MonitorSettings(methods=methods)
        warm_up(bundle, settings)
        self.monitor = Monitor(bundle, settings)
        assert self.monitor.watch.stages
        self.stamp = 10**18
        self.collisions = 0

    def go(self, samples: int) -> None:
        """Live for some samples."""
        angle = np.array([2.0, 3.1]) * PERIOD * 1e-9
        for k in range(samples):
            self.stamp += PERIOD
            q = 0.5 * np.sin(k * angle)
            event = k % 5000
            if event == 1000:
                self.stamp += 1000 * PERIOD  # a gap
            elif event == 2000:
                self.monitor.add_joints(self.stamp - PERIOD, q)  # once again
            elif event == 2500:
                self.monitor.add_joints(self.stamp, np.array([np.nan, 0.0]))
            self.monitor.add_joints(self.stamp, q)
            push = 1e4 if 4000 <= event < 4100 else 0.0
            for output in self.monitor.watch.outputs:
                found = self.monitor.add_measured(output, self.stamp, 100.0 * q + push)
                self.collisions += len(found.events)


def test_a_hundred_thousand_samples(bundle: ModelBundle) -> None:
    """From half a minute at 1 kHz on the interpreter holds no more objects, gaps and faults in."""
    life = Life(bundle, ('strain',))
    life.go(30_000)
    gc.collect()
    before = sys.getallocatedblocks()
    life.go(70_000)
    gc.collect()
    assert abs(sys.getallocatedblocks() - before) < 250
    assert life.collisions > 0
    assert life.monitor.filter.drops['gap'] == 20 * 1000
    assert life.monitor.filter.drops['not_finite'] == 20


@pytest.mark.parametrize('methods', [('strain',), ('strain', 'effort', 'momentum')])
def test_traced_memory(bundle: ModelBundle, methods: tuple[str, ...]) -> None:
    """No byte more after 7000 samples than after 4000, arrays included."""
    life = Life(bundle, methods)
    tracemalloc.start()
    try:
        life.go(4000)
        gc.collect()
        before, _ = tracemalloc.get_traced_memory()
        life.go(3000)
        gc.collect()
        after, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert abs(after - before) < 10_000
    assert peak < before + 1_000_000
