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

"""Outputs that change in the course of a recording: they drift, or follow the arm no more."""

from __future__ import annotations

import numpy as np

from tudor_dynamics.doctor.case import Case
from tudor_dynamics.doctor.explained import Explained
from tudor_dynamics.identification.finding import Finding
from tudor_dynamics.typing import FloatArray

DRIFT_GAIN = 0.6
"""Log ratio by which a straight line in time has to lessen what is left."""
DRIFT_SIZE = 0.15
"""Part of the channel's standard deviation that it has to drift over the recording."""
WINDOWS = 20
SHORTEST = 8.0
"""Recordings that are shorter tell nothing of the end of a channel [s]."""
QUIET = 0.3
"""A channel that is dead moves by less than this part of what it did, and of what is expected."""
EXPECTED = 0.3
"""What is expected of a channel has to move by this part of what it did, to be missed."""
LIVES = 0.5
"""Relative residual of a channel while it lives."""
DEAD_GAIN = 1.0
"""Log ratio by which a dead end has to lessen what is left."""
FOLLOWS = 0.7
"""Slope of the measured over the expected output in a window in which a channel lives."""


def trends(
    case: Case, name: str, explained: Explained, output: FloatArray,
) -> list[Finding]:
    """
    Look for drift and for channels that die, in what the model of the bag leaves over.

    output (n, channels).
    """
    t = case.thinned.t
    line = (t - t.mean())[:, None]
    straight = explained.extended(line)
    findings = []
    for i, channel in enumerate(case.bodies[name].channels):
        if not case.sound[name][i]:
            continue
        y = output[:, i]
        dead = _dies(explained, i, t, y)
        if dead is not None:
            findings.append(Finding(
                'dying', f'{_words(name)} {channel} follows the arm no more from {dead:.2f} s on',
                f'check sensor and wiring; use BAG@0-{100 * dead / case.recording.t[-1]:.0f}% '
                'until then', case.recording.path, (channel,), dead, float(t[-1]) - dead, 's'))
            continue
        both = straight.alone(i, y[:, None])[0]
        now = explained.alone(i, y[:, None])[0]
        # the slope by Frisch and Waugh: both sides freed of all other columns
        x, z = explained.rest(i, line[:, 0]), explained.rest(i, y)
        rise = float(x @ z) / max(float(x @ x), 1e-300) * float(t[-1] - t[0])
        if (np.log(now / both) > DRIFT_GAIN * case.brevity
                and abs(rise) > DRIFT_SIZE * float(np.std(y))):
            findings.append(Finding(
                'drift', f'{_words(name)} {channel} drifts by {rise:.4g} in '
                f'{t[-1] - t[0]:.4g} s', 'let the sensor warm up, or mend its zero; shorter '
                'parts BAG@BEGIN-END% drift less', case.recording.path, (channel,), 0.0, rise,
                '', 'relative residual', float(np.sqrt(now)), float(np.sqrt(both))))
    return findings


def _words(name: str) -> str:
    return 'gauge' if name == 'strain' else 'effort of'


def _dies(explained: Explained, channel: int, t: FloatArray, y: FloatArray) -> float | None:
    """
    Say from when on a channel is quiet to the end, though the arm moves on.

    What is expected of it comes from what it measured before: what is dead would teach to expect
    little.
    """
    if t[-1] - t[0] < SHORTEST:
        return None  # in less than half a second each, windows tell nothing
    edges = np.linspace(t[0], t[-1], WINDOWS + 1)
    for k in range(WINDOWS // 4, WINDOWS - 1):
        before = t < edges[k]
        lived, after = float(np.std(y[before])), y[~before]
        if float(np.std(after)) > QUIET * lived:
            continue
        expected = explained.foretold(channel, y, before)
        left, spread = float(np.std((y - expected)[before])), float(np.std(expected[~before]))
        if left > LIVES * lived or spread < EXPECTED * lived:
            continue  # nobody knows what it did, or it may well be quiet
        if float(np.std(after)) > QUIET * spread:
            continue
        # what was foretold may be wrong: both parts together must not be explained as well
        apart = float(np.sum((y - expected)[before] ** 2)) + len(after) * float(np.var(after))
        together = y - explained.foretold(channel, y, np.ones(len(y), dtype=bool))
        if np.log(float(together @ together) / max(apart, 1e-300)) > DEAD_GAIN:
            return _last_alive(edges[:k + 1], t, y, expected)
    return None


def _last_alive(edges: FloatArray, t: FloatArray, y: FloatArray, expected: FloatArray) -> float:
    for begin, end in zip(edges[-2::-1], edges[:0:-1], strict=True):
        inside = (t >= begin) & (t <= end)
        x, z = expected[inside], y[inside]
        x, z = x - x.mean(), z - z.mean()
        if float(x @ z) > FOLLOWS * float(x @ x):
            return float(end)
    return float(edges[0])
