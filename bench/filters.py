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
Time of low-passes without delay: those of ``signals/filters.py`` against scipy's ``sosfiltfilt``.

Run with ``OMP_NUM_THREADS=1 python bench/filters.py``: CPU time of one pass over a minute at
1 kHz, for the columns of a recording and for those of a block of regressor rows, and of the
import.
"""

from __future__ import annotations

from collections.abc import Callable
from time import process_time

import numpy as np

from tudor_dynamics.signals.filters import (
    butterworth, chebyshev, forward_backward, low_pass_sections)

REPEATS = 5
SAMPLES = 60_000


def fastest(run: Callable[[], object]) -> float:
    """Give the least CPU time of some runs, after one [s]."""
    run()
    times = []
    for _ in range(REPEATS):
        begin = process_time()
        run()
        times.append(process_time() - begin)
    return min(times)


def main() -> None:
    """Compare."""
    begin = process_time()
    from scipy.signal import butter, cheby1, sosfiltfilt
    print(f'import of scipy.signal: {process_time() - begin:.2f} s, after numpy')
    rng = np.random.default_rng(0)
    ripple = cheby1(8, 0.05, 0.08, output='sos')
    ripple[0, :3] *= 10.0 ** (0.05 / 20.0)  # ours let a constant pass as it is
    for what, own, theirs, columns in (
            ('derivatives', low_pass_sections(butterworth(4), 0.05),
             butter(4, 0.1, output='sos'), 7),
            ('decimation', low_pass_sections(chebyshev(8, 0.05), 0.04),
             ripple, 64)):
        x = rng.normal(size=(SAMPLES, columns))
        pad = 300
        ours = fastest(lambda: forward_backward(own, x, pad))
        scipys = fastest(lambda: sosfiltfilt(theirs, x, axis=0, padlen=pad))
        difference = np.max(np.abs(forward_backward(own, x, pad)
                                   - sosfiltfilt(theirs, x, axis=0, padlen=pad)))
        print(f'{what:12} {columns:3} columns: {1e3 * ours:6.1f} ms, '
              f'scipy {1e3 * scipys:6.1f} ms, ratio {scipys / ours:.1f}; '
              f'results differ by {difference:.1g}')


if __name__ == '__main__':
    main()
