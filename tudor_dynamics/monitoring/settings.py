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

"""Choices of a monitor, and what becomes known with a message."""

from __future__ import annotations

from dataclasses import dataclass, field

from tudor_dynamics.contact.estimate import ContactEstimate
from tudor_dynamics.monitoring.detector import CollisionEvent, DetectorSettings
from tudor_dynamics.monitoring.payload_stage import LoadFound
from tudor_dynamics.monitoring.residuals import Residual
from tudor_dynamics.monitoring.thresholds.excess import Excess, Rates

METHODS = ('strain', 'effort', 'momentum')
SOURCE = {'strain': 'strain', 'effort': 'effort', 'momentum': 'effort'}
"""Output that each method needs."""


@dataclass(frozen=True)
class MonitorSettings:
    """
    Choices of a monitor.

    Attributes
    ----------
    kind : str
        Kind of model whose residuals are watched.
    observer : {'off', 'ringing'}
        Whether measured strain corrects an elastic model.
    methods : tuple of str
        What the detector listens to, of `METHODS`; empty for all that the model has thresholds
        for, or without any thresholds for all that it has models for.
    rates : Rates
        False alarms allowed, all methods together.
    detector : DetectorSettings
        Times and hysteresis.
    observer_gain : float
        Bandwidth of the momentum observer [1/s].
    gap : float
        Longest time between samples that is not a gap [s]; 0 for five periods.
    contact : bool
        Whether force and place of contacts are estimated.

    """

    kind: str = 'analytical'
    observer: str = 'ringing'
    methods: tuple[str, ...] = ('strain',)
    rates: Rates = Rates()
    detector: DetectorSettings = DetectorSettings()
    observer_gain: float = 30.0
    gap: float = 0.0
    contact: bool = False


@dataclass(eq=False, slots=True)
class Found:
    """What became known with one message."""

    residuals: list[tuple[str, Residual]] = field(default_factory=list)  # method and residual
    # Method and ratios, where thresholds are known.
    excesses: list[tuple[str, Excess]] = field(default_factory=list)
    events: list[CollisionEvent] = field(default_factory=list)  # collisions that begin with it
    # Collisions from before that turned out to be loads.
    loads: list[LoadFound] = field(default_factory=list)
    # What touches the arm, where that is estimated.
    contacts: list[ContactEstimate] = field(default_factory=list)
