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
    """
    A physical parameter; ``described`` is what the arm description says of it.

    Attributes
    ----------
    name : str
        Name of the parameter.
    symbol : str
        Name as the bundle has it.
    value : float
        Identified value, in its unit.
    unit : str
        Unit of the value.
    standard_error : float
        Standard deviation, in the same unit.
    described : float
        What the arm description says, in the same unit.
    note : str
        What is odd about it.

    """

    name: str
    symbol: str
    value: float
    unit: str
    standard_error: float
    described: float
    note: str


@dataclass(frozen=True)
class GaugeRow:
    """
    Gain and offset of a gauge, with their standard deviations.

    Attributes
    ----------
    name : str
        Name of the gauge.
    gain : float
        Reading per bending moment, in the unit below.
    gain_error : float
        Its standard deviation.
    gain_unit : str
        Unit of the gain.
    offset : float
        Reading without load, in the unit of the gauge.
    offset_error : float
        Its standard deviation.
    unit : str
        Unit of the gauge.

    """

    name: str
    gain: float
    gain_error: float
    gain_unit: str
    offset: float
    offset_error: float
    unit: str


@dataclass(frozen=True)
class StartRow:
    """
    A stiffness that the search began with; ``fit`` in percent, on the pieces compared.

    Attributes
    ----------
    factor : float
        Factor on the stiffness.
    share : str
        What the gears have of the compliance, in words.
    fit : float
        Fit on the pieces compared [%].
    note : str
        What became of it.

    """

    factor: float
    share: str
    fit: float
    note: str


@dataclass(frozen=True)
class RingRow:
    """
    A ring-down with its bag and pose as the page writes them.

    Attributes
    ----------
    bag : str
        Bag as the page writes it.
    pose : str
        Pose as the page writes it.
    unit : str
        Unit of the amplitude.
    ring : Ringdown
        Ring-down that was measured and predicted.

    """

    bag: str
    pose: str
    unit: str
    ring: Ringdown


@dataclass(frozen=True, eq=False)
class ElasticSection:
    """
    All that the page shows of the elastic arm; figures as data URI.

    Attributes
    ----------
    parameters : tuple of ParameterRow
        Physical parameters of the arm.
    payload : float
        Mass at the tip that was identified or given [kg].
    payloads : bool
        Whether the model is of all payloads.
    gauges : tuple of GaugeRow
        Gain and offset of each gauge.
    modes : str or None
        Figure of the modes as data URI.
    ringdowns : int
        Number of ring-downs in all bags.
    ringdown_rows : tuple of RingRow
        Ring-downs that the table shows.
    ringdown_figure : str or None
        Figure of the ring-downs as data URI.
    ringdown_summary : str
        How well they are predicted, in words.
    shortest : float
        Shortest standstill that counts [s].
    starts : tuple of StartRow
        Starts of the search.
    fit : float
        Fit on the training bags [%].
    runs : int
        Simulations done in all.
    settings : str
        How it was identified, in words.

    """

    parameters: tuple[ParameterRow, ...]
    payload: float
    payloads: bool
    gauges: tuple[GaugeRow, ...]
    modes: str | None
    ringdowns: int
    ringdown_rows: tuple[RingRow, ...]
    ringdown_figure: str | None
    ringdown_summary: str
    shortest: float
    starts: tuple[StartRow, ...]
    fit: float
    runs: int
    settings: str
