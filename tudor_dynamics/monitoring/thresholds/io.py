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

"""Thresholds as plain values in a model bundle, and back."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator, ValidationInfo

from tudor_dynamics.errors import ModelError
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.storage.parts import BundlePart, read, Text
from tudor_dynamics.monitoring.thresholds.onset import LAGS, WINDOW
from tudor_dynamics.monitoring.thresholds.thresholds import MethodThresholds, Tail

DIGITS = 10
DOMAIN = ('usual', 'reach')
TAIL = ('location', 'scale', 'shape', 'share', 'largest', 'count')


Positive = Annotated[float, Field(gt=0.0)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Size = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Matrix = tuple[tuple[Number, ...], ...]


class TailPart(BundlePart):
    """How a residual exceeds its profile, see `Tail`."""

    location: Positive
    scale: Positive
    shape: Annotated[float, Field(ge=0.0, le=1.0)]
    share: Annotated[float, Field(gt=0.0, le=1.0)]
    largest: Positive
    count: Annotated[float, Field(ge=1.0)]


class ThresholdsPart(BundlePart):
    """Thresholds of one method, of an arm whose channels and joints come as context."""

    channels: tuple[Text, ...]
    seconds: float
    step: Positive
    taps: tuple[Matrix, ...]
    profile: tuple[tuple[Size, ...], ...]
    tails: tuple[TailPart, ...]
    usual: tuple[Positive, ...] | None = None
    reach: tuple[Positive, ...] | None = None
    stiction: tuple[Size, ...] | None = None

    @model_validator(mode='after')
    def _fits(self, info: ValidationInfo) -> ThresholdsPart:
        context = info.context or {}
        channels, joints = context['channels'], context['n_joints']
        n = len(channels)
        if self.channels != channels:
            raise ValueError(f'channels {list(self.channels)} do not fit the arm; expected '
                             f'{list(channels)}')
        for name, value, shape in (
                ('taps', self.taps, (LAGS + WINDOW, n, n)),
                ('profile', self.profile, (2 * n, 1 + 4 * joints)), ('usual', self.usual, (n,)),
                ('reach', self.reach, (joints,)), ('stiction', self.stiction, (n,))):
            if value is not None and np.shape(value) != shape:
                raise ValueError(f'{name} of another shape than {shape} do not fit the arm')
        if len(self.tails) not in (2 * n, 3 * n):
            raise ValueError(f'{len(self.tails)} tails do not fit the arm; expected two or three '
                             'for each channel')
        if any(row[0] == 0.0 for row in self.profile):
            raise ValueError('profile with a size of 0 at rest')
        if n != joints and any(self.stiction or ()):
            raise ValueError('stiction of what is no joint')
        return self


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
        If anything is missing, impossible, or does not fit the arm.

    """
    try:
        part = read(ThresholdsPart, content, {'channels': channels, 'n_joints': n_joints})
    except ModelError as err:
        raise err.at('thresholds of the model') from None
    n = len(channels)
    return MethodThresholds(
        channels, part.step, np.array(part.taps), np.array(part.profile),
        tuple(Tail(**dict(tail)) for tail in part.tails), part.seconds,
        np.full(n, np.inf) if part.usual is None else np.array(part.usual),
        np.full(n_joints, np.inf) if part.reach is None else np.array(part.reach),
        np.zeros(n) if part.stiction is None else np.array(part.stiction))


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
