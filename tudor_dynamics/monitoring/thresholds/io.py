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

"""Thresholds as plain values in a model bundle, and back, with every shape checked."""

from __future__ import annotations

from typing import Any

import numpy as np

from tudor_dynamics.errors import ModelError
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.monitoring.thresholds.onset import LAGS, WINDOW
from tudor_dynamics.monitoring.thresholds.thresholds import MethodThresholds, Tail

DIGITS = 10
DOMAIN = ('usual', 'reach')
TAIL = ('location', 'scale', 'shape', 'share', 'largest', 'count')


def thresholds_to_dict(thresholds: MethodThresholds) -> dict[str, Any]:
    """
    Make plain values of thresholds.

    Parameters
    ----------
    thresholds : MethodThresholds
        Thresholds of one method.

    Returns
    -------
    dict
        YAML-ready; numbers of ten digits.

    """
    def short(x: float) -> float:
        return float(f'{x:.{DIGITS}g}')

    def listed(x: Any) -> Any:
        return [listed(item) for item in x] if isinstance(x, list) else short(x)

    return {
        'channels': list(thresholds.channels), 'seconds': round(thresholds.seconds, 3),
        'step': short(thresholds.step), 'taps': listed(thresholds.taps.tolist()),
        'profile': listed(thresholds.profile.tolist()),
        'tails': [{key: short(getattr(t, key)) for key in TAIL}
                  for t in thresholds.tails],
        # infinite means unknown, and is left out as in bundles that are older
        **{key: listed(values.tolist()) for key in DOMAIN
           if np.isfinite(values := getattr(thresholds, key)).all()},
        **({'stiction': listed(thresholds.stiction.tolist())} if thresholds.stiction.any()
           else {})}


def thresholds_from_dict(
    content: Any, channels: tuple[str, ...], n_joints: int,
) -> MethodThresholds:
    """
    Read thresholds; older ones without ``usual`` and ``reach`` are never widened.

    Parameters
    ----------
    content : dict
        As from `thresholds_to_dict`.
    channels : tuple of str
        Channels that the arm has.
    n_joints : int
        Its active joints.

    Returns
    -------
    MethodThresholds
        Thresholds of one method.

    Raises
    ------
    ModelError
        If anything is missing or of another shape.

    """
    n = len(channels)
    try:
        named = tuple(str(name) for name in content['channels'])
        taps = np.asarray(content['taps'], dtype=float)
        profile = np.asarray(content['profile'], dtype=float)
        tails = tuple(Tail(*(float(tail[key]) for key in TAIL))
                      for tail in content['tails'])
        step, seconds = float(content['step']), float(content['seconds'])
        usual, reach = (
            np.asarray(content[key], dtype=float) if key in content else np.full(size, np.inf)
            for key, size in zip(DOMAIN, (n, n_joints), strict=True))
        stiction = np.asarray(content.get('stiction', [0.0] * n), dtype=float)
        good = (named == channels and taps.shape == (LAGS + WINDOW, n, n)
                and profile.shape == (2 * n, 1 + 4 * n_joints) and len(tails) in (2 * n, 3 * n)
                and np.isfinite(taps).all() and np.isfinite(profile).all()
                and (profile >= 0).all() and (profile[:, 0] > 0).all() and step > 0
                and usual.shape == (n,) and reach.shape == (n_joints,)
                and (usual > 0).all() and (reach > 0).all()
                and stiction.shape == (n,) and np.isfinite(stiction).all()
                and (stiction >= 0).all() and (n == n_joints or not stiction.any())
                and all(t.scale > 0 and t.location > 0 and 0 <= t.shape <= 1 and 0 < t.share <= 1
                        and t.largest > 0 and t.count >= 1
                        for t in tails))
    except (AttributeError, KeyError, TypeError, ValueError) as err:
        msg = f'the thresholds of the model cannot be read ({err}); fit the model again'
        raise ModelError(msg) from None
    if not good:
        msg = ('the thresholds of the model do not fit its arm, or are no numbers; fit the model '
               'again')
        raise ModelError(msg)
    return MethodThresholds(channels, step, taps, profile, tails, seconds, usual, reach,
                            stiction)


def stored_thresholds(bundle: ModelBundle, kind: str) -> dict[str, MethodThresholds]:
    """
    Give the thresholds that a bundle carries for one kind of model.

    Parameters
    ----------
    bundle : ModelBundle
        Fitted models, with facts of their thresholds.
    kind : str
        Kind of model; the momentum observer always goes with the analytical one.

    Returns
    -------
    dict of str to MethodThresholds
        Method to thresholds; methods without any are left out.

    """
    stored = bundle.facts.get('thresholds')
    found: dict[str, MethodThresholds] = {}
    if not isinstance(stored, dict):
        return found
    arm = bundle.arm
    for method, channels in (('strain', arm.gauge_names), ('effort', arm.active_joints),
                             ('momentum', arm.active_joints)):
        kinds = stored.get(method)
        own = 'analytical' if method == 'momentum' else kind
        if isinstance(kinds, dict) and own in kinds:
            found[method] = thresholds_from_dict(kinds[own], channels, len(arm.active_joints))
    return found
