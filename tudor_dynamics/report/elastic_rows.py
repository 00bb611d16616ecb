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


"""Rows and section of the elastic arm, as the page takes them."""

from __future__ import annotations

from dataclasses import dataclass

from tudor_dynamics.identification.elastic.ringdowns import Ringdown


@dataclass(frozen=True)
class ParameterRow:
    """A physical parameter; ``described`` is what the arm description says of it."""

    name: str
    symbol: str  # name as the bundle has it
    value: float  # identified value, in its unit
    unit: str  # unit of the value
    standard_error: float  # standard deviation, in the same unit
    described: float  # what the arm description says, in the same unit
    note: str  # what is odd about it


@dataclass(frozen=True)
class GaugeRow:
    """Gain and offset of a gauge, with their standard deviations."""

    name: str
    gain: float  # reading per bending moment, in the unit below
    gain_error: float  # its standard deviation
    gain_unit: str
    offset: float  # reading without load, in the unit of the gauge
    offset_error: float  # its standard deviation
    unit: str


@dataclass(frozen=True)
class StartRow:
    """A stiffness that the search began with; ``fit`` in percent, on the pieces compared."""

    factor: float  # factor on the stiffness
    share: str  # what the gears have of the compliance, in words
    fit: float  # fit on the pieces compared [%]
    note: str  # what became of it


@dataclass(frozen=True)
class RingRow:
    """A ring-down with its bag and pose as the page writes them."""

    bag: str  # bag as the page writes it
    pose: str  # pose as the page writes it
    unit: str  # unit of the amplitude
    ring: Ringdown  # ring-down that was measured and predicted


@dataclass(frozen=True, eq=False)
class ElasticSection:
    """All that the page shows of the elastic arm; figures as data URI."""

    parameters: tuple[ParameterRow, ...]  # physical parameters of the arm
    payload: float  # mass at the tip that was identified or given [kg]
    payloads: bool  # whether the model is of all payloads
    gauges: tuple[GaugeRow, ...]  # gain and offset of each gauge
    modes: str | None  # figure of the modes as data URI
    ringdowns: int  # number of ring-downs in all bags
    ringdown_rows: tuple[RingRow, ...]  # ring-downs that the table shows
    ringdown_figure: str | None  # figure of the ring-downs as data URI
    ringdown_summary: str  # how well they are predicted, in words
    shortest: float  # shortest standstill that counts [s]
    starts: tuple[StartRow, ...]  # starts of the search
    fit: float  # fit on the training bags [%]
    runs: int  # simulations done in all
    settings: str  # how it was identified, in words
