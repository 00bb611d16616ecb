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

"""A finding: what is wrong with a recording or a description, by what evidence, and what to do."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

KINDS = {
    'gravity_axis': 'gravity of the description along another axis',
    'axes_parallel_to_gravity': 'no axis can feel gravity, but the outputs follow the pose',
    'dh_in_millimetres': 'lengths of the kinematics in millimetres',
    'dh_in_degrees': 'angles of the kinematics in degrees',
    'gauge_in_millimetres': 'distance of a gauge in millimetres',
    'gauge_beyond_link': 'gauge beyond its link',
    'joint_not_listed': 'a joint moves that the description does not list',
    'effort_unit': 'effort in another unit than described',
    'effort_sign': 'effort with its sign turned',
    'joint_sign': 'joint counted in the other direction',
    'gauge_sign': 'gauge with its sign turned',
    'efforts_exchanged': 'efforts of two joints exchanged',
    'joints_exchanged': 'two joints exchanged',
    'coupling_missing': 'a motor turns with another joint, and the description does not say so',
    'coupling_wrong': 'coupled drives of the description that the outputs do not show',
    'gauges_exchanged': 'two gauges exchanged',
    'clock_set_back': 'the clock was set back while recording',
    'velocity_zeros': 'velocities are all zero',
    'velocity_late': 'velocities late',
    'effort_late': 'efforts late',
    'strain_late': 'strains late',
    'jitter': 'stamps jitter on an even sampling',
    'outlier': 'single samples far off',
    'saturated': 'channel saturated',
    'held': 'channel held for a while',
    'dying': 'channel dies',
    'drift': 'channel drifts',
    'constant': 'channel that never changes',
    'same_recording': 'the same recording twice',
    'standstill': 'the arm stands still at the ends',
    'payload_wrong': 'payload stated wrong',
    'load_unknown': 'the arm carries what the model does not know'}
"""Stable keys of what can be found, with titles for people."""


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong."""

    kind: str
    what: str  # the same in a sentence, with place and size
    remedy: str  # what to do
    bag: str = ''  # bag it was found in; empty where the description alone tells
    # Joints or gauges concerned; empty for all, or none in particular.
    channels: tuple[str, ...] = ()
    time: float | None = None  # where it begins, since the start of the bag [s]
    size: float | None = None  # how large it is, in `unit`
    unit: str = ''  # unit of the size; empty for a factor
    measure: str = ''  # what `now` and `otherwise` are
    # Evidence: the measure as things are, and with the remedy.
    now: float | None = None
    otherwise: float | None = None

    def __post_init__(self) -> None:
        """Keep to the kinds that there are."""
        assert self.kind in KINDS, self.kind

    @property
    def title(self) -> str:
        """Say what it is, for people."""
        return KINDS[self.kind]

    @property
    def evidence(self) -> str:
        """Put the evidence in words; empty where the sentence has it all."""
        if self.now is None:
            return ''
        other = '' if self.otherwise is None else f', {self.otherwise:.3g} with the remedy'
        return f'{self.measure} {self.now:.3g}{other}'

    def __str__(self) -> str:
        """Write what, evidence and remedy on one line."""
        shown = f' ({self.evidence})' if self.evidence else ''
        return f'{self.what}{shown}; {self.remedy}'

    def as_dict(self) -> dict[str, Any]:
        """Give it as plain values without what is not there."""
        content = asdict(self) | {'channels': list(self.channels)}
        return {key: value for key, value in content.items() if value not in (None, '', [])}
