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
WINDOWS = 10
QUIET = 0.2
"""A channel that is dead moves by less than this part of what it did."""
LIVES = 0.5
"""Relative residual of a channel while it lives."""
KNOWN = 0.8
"""Relative residual above which nobody knows what to expect."""
FOLLOWS, FOLLOWS_NOT = 0.7, 0.35
"""Slopes of measured over explained output in a window."""


def trends(
    case: Case, name: str, explained: Explained, output: FloatArray,
) -> list[Finding]:
    """
    Look for drift and for channels that die, in what the model of the bag leaves over.

    Parameters
    ----------
    case : Case
        Bag with its arm.
    name : {'effort', 'strain'}
        Output that is looked at.
    explained : Explained
        Rows of the output.
    output : ndarray of shape (n, n_channels)
        Measured values of its channels.

    Returns
    -------
    list of Finding
        One at most for each channel.

    """
    t = case.thinned.t
    left = explained.residuals(output)
    line = (t - t.mean())[:, None]
    straight = explained.extended(line)
    findings = []
    for i, channel in enumerate(case.bodies[name].channels):
        if not case.sound[name][i]:
            continue
        y = output[:, i]
        known = np.std(left[:, i]) < KNOWN * np.std(y)
        dead = _dies(t, y, y - left[:, i]) if known else None
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
        if np.log(now / both) > DRIFT_GAIN and abs(rise) > DRIFT_SIZE * float(np.std(y)):
            findings.append(Finding(
                'drift', f'{_words(name)} {channel} drifts by {rise:.4g} in '
                f'{t[-1] - t[0]:.4g} s', 'let the sensor warm up, or mend its zero; shorter '
                'parts BAG@BEGIN-END% drift less', case.recording.path, (channel,), 0.0, rise,
                '', 'relative residual', float(np.sqrt(now)), float(np.sqrt(both))))
    return findings


def _words(name: str) -> str:
    return 'gauge' if name == 'strain' else 'effort of'


def _dies(t: FloatArray, measured: FloatArray, expected: FloatArray) -> float | None:
    """Say from when on a channel does not follow what is expected of it, to the end."""
    if t[-1] - t[0] < WINDOWS:
        return None  # in less than a second each, windows tell nothing
    edges = np.linspace(t[0], t[-1], WINDOWS + 1)
    spread = float(np.std(expected))
    slopes, quiet, rest = np.full((3, WINDOWS), np.nan)
    for k in range(WINDOWS):
        inside = (t >= edges[k]) & (t <= edges[k + 1])
        if inside.sum() < 10:
            continue
        x, y = expected[inside], measured[inside]
        x, y = x - x.mean(), y - y.mean()
        if np.std(x) > 0.3 * spread:
            slopes[k] = float(x @ y) / float(x @ x)
            quiet[k] = float(np.std(y))
            rest[k] = float(np.std(y - x)) / max(float(np.std(y)), 1e-300)
    told = np.flatnonzero(np.isfinite(slopes))
    if len(told) < 4 or not np.all(np.abs(slopes[told[-2:]]) < FOLLOWS_NOT):
        return None
    well = told[slopes[told] > FOLLOWS]
    if not len(well) or np.median(slopes[told[:max(2, len(told) // 3)]]) < FOLLOWS:
        return None
    if np.median(rest[well]) > LIVES:
        return None  # nobody knows what it did before
    if np.max(quiet[told[-2:]]) > QUIET * float(np.median(quiet[well])):
        return None  # it moves, if not as expected
    last = int(well[-1])
    after = told[told > last]
    return float(edges[last + 1]) if len(after) else None
