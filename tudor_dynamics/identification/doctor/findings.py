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
from typing import Any, NamedTuple


class Check(NamedTuple):
    """What can be found."""

    title: str
    remedy: str = ''  # empty where it depends on the finding
    unit: str = ''  # unit of the size; empty for a factor
    measure: str = ''  # what the evidence is
    one_bag: bool = False  # it happened while one bag was recorded: never of several at once


RESIDUAL = 'relative residual'
UNSEEN = 'relative prediction error on data left out of the fit'
NAMES = 'correct names and order of the values in the driver, or the names in the arm description'
UNIT = 'correct joints[].effort.unit in the arm description, or scale the efforts in the driver'
CHANGED = 'check bond, cable and amplifier of the gauge; if they are fine, fit again with this bag'
PLACE = 'give gauges[].distance in the arm description in metres, from joint axis along the link'
STEPPED = 'check amplifier and connectors, or use the part before or after the change: BAG@5s-50s'
CHECKS = {
    'gravity_axis': Check('the arm description has a wrong gravity vector', '', 'deg', RESIDUAL),
    'dh_in_millimetres': Check('lengths of the kinematics look like millimetres', 'give a and d '
                               'of kinematics.dh in the arm description in metres', 'm'),
    'dh_in_degrees': Check(
        'angles of the kinematics look like degrees',
        'give alpha and theta_offset of kinematics.dh in the arm description in radians', 'rad'),
    'gauge_in_millimetres': Check('the distance of a gauge looks like millimetres', PLACE, 'm'),
    'gauge_beyond_link': Check('a gauge is described beyond the end of its link', PLACE, 'm'),
    'joint_not_listed': Check(
        'a joint moves that is not active in the arm description', 'list it in the arm '
        'description under joints, and under active_joints if that key is given'),
    'effort_unit': Check('efforts are in another unit than the arm description says', UNIT, '',
                         RESIDUAL),
    'effort_sign': Check('an effort has the wrong sign',
                         'change the sign of the effort in the driver', '', RESIDUAL),
    'joint_sign': Check(
        'a joint position has the wrong sign', 'change the sign of the position in the driver, or '
        'the direction of the joint axis in the URDF or D-H rows', '', RESIDUAL),
    'strain_unit': Check(
        'strains are in another unit than the arm description says', 'correct gauges[].unit in '
        'the arm description, or scale the readings in the amplifier'),
    'gauge_sign': Check('a gauge has the wrong sign', 'find out which of the two bags has the '
                        'right sign; record the other one again, or leave it out'),
    'efforts_exchanged': Check('efforts of two joints are exchanged', NAMES, '', RESIDUAL),
    'joints_exchanged': Check('two joints are exchanged', NAMES, '', RESIDUAL),
    'coupling_missing': Check('the arm description lacks a coupling between a motor and another '
                              'joint', '', '', RESIDUAL),
    'coupling_wrong': Check(
        'the data do not show the couplings of the arm description', "remove the key 'couplings' "
        'from the arm description, or correct its pairs, positions and efforts', '', RESIDUAL),
    'gauges_exchanged': Check('two gauges are exchanged', NAMES, '', RESIDUAL),
    'clock_set_back': Check('the clock was set back while recording', 'synchronise clocks before '
                            'recording; correct them gradually (chrony without steps)', 's',
                            one_bag=True),
    'velocity_zeros': Check('velocities are all zero',
                            'let the driver publish measured velocities, or none'),
    'velocity_late': Check(
        'velocities and positions are shifted in time', 'correct the filter in the driver, or set '
        'preprocessing.measured_velocity: false in the arm description', 's', RESIDUAL),
    'effort_late': Check(
        'efforts and positions are shifted in time', 'let the driver stamp efforts when they are '
        'measured, or take efforts from the topic of the positions', 's', RESIDUAL),
    'strain_late': Check(
        'strains and positions are shifted in time', 'let the amplifier stamp strains when they '
        'are measured, not when they arrive', 's', RESIDUAL),
    'jitter': Check('time stamps jitter, although samples are taken at a constant rate',
                    'let the driver set the stamp when it takes the sample', 's',
                    'roughness of the positions over time'),
    'outlier': Check('single samples lie far from their neighbours', 'repair driver or wiring, or '
                     'use only a sound part of the bag, such as BAG@5s-50s', one_bag=True),
    'positions_wrapped': Check('positions jump by a full turn', 'let the driver count full turns, '
                               'so that positions are continuous', 'rad', one_bag=True),
    'position_jump': Check('a position jumps', 'check encoder, coupling and index mark, or use '
                           'only a sound part of the bag, such as BAG@5s-50s', one_bag=True),
    'position_held': Check('a position freezes for a while', 'check encoder and bus, or use only '
                           'a sound part of the bag, such as BAG@5s-50s', 's', one_bag=True),
    'coarse_positions': Check('positions have a coarse resolution',
                              'let the driver publish the full resolution of the encoder'),
    'noisy_positions': Check('positions are noisy', 'check the shielding of the encoder cable'),
    'stale': Check('positions repeat while the joint moves',
                   'let the driver publish each reading once, with the stamp of its sampling'),
    'filled': Check('lost samples were filled by interpolation', 'record without filling gaps: a '
                    'fit leaves gaps out by itself', 's', one_bag=True),
    'copied_channel': Check('two signals have the same values', NAMES),
    'alternating': Check('a signal has zeros between its samples',
                         'let the driver publish a value only when one was measured'),
    'rectified': Check('a signal has lost its sign', 'let the driver publish signed values', '',
                       RESIDUAL),
    'coarse_channel': Check('a signal has a coarse resolution', 'match the measuring range of '
                            'sensor or driver to the signal'),
    'hum': Check('a signal has a steady oscillation of one frequency', 'check grounding and '
                 'shielding of the sensor, or sample faster and filter', 'Hz', RESIDUAL),
    'gain_step': Check('a signal changes its gain', STEPPED, '', RESIDUAL, one_bag=True),
    'offset_step': Check('a signal changes its zero offset', STEPPED, '', RESIDUAL, one_bag=True),
    'payload_changed': Check('the load changed while recording', 'use only the part of the bag '
                             'before or after the change: BAG@5s-50s', '', RESIDUAL, one_bag=True),
    'unexplained': Check('the model does not explain a signal', 'plot this signal '
                         'and the positions to find why, or leave these bags out', '', RESIDUAL),
    'joint_scale': Check('positions of a joint have a wrong scale', 'correct counts per turn or '
                         'the gear ratio in the driver', '', RESIDUAL),
    'time_scale': Check('time stamps run too fast or too slowly', 'take stamps from the clock in '
                        'the driver, or correct the rate they are computed with', '', RESIDUAL),
    'position_drift': Check(
        'a position drifts away from the true one', 'check belt, coupling and mounting of the '
        'encoder, or use part of the bag, such as BAG@5s-50s', 'rad', RESIDUAL, one_bag=True),
    'position_ripple': Check('a position has an error that repeats with the angle', 'centre the '
                             'encoder disc, and check coupling and bearing', 'rad', RESIDUAL),
    'saturated': Check('a signal is saturated', 'widen the range of amplifier or driver, or move '
                       'more slowly', one_bag=True),
    'held': Check('a signal freezes for a while', 'check sensor, wiring and driver, or use only '
                  'a sound part of the bag, such as BAG@5s-50s', 's', one_bag=True),
    'dying': Check('a signal stops working', '', 's', one_bag=True),
    'drift': Check('a signal drifts', 'let the sensor warm up before recording; shorter parts of '
                   'the bag drift less, such as BAG@5s-50s', '', RESIDUAL, one_bag=True),
    'constant': Check('a signal never changes',
                      'check the sensor and its driver; no model can be fitted to this signal'),
    'same_recording': Check('the same recording is given twice', 'give another recording: a copy '
                            'is no test of what was learned', '', 'share of common samples'),
    'rings': Check('the tool or load goes on ringing after motion', '', 'Hz'),
    'standstill': Check('the arm stands still at the ends of the bag', '', 's', one_bag=True),
    'payload_wrong': Check(
        'the load stated for a bag is wrong', 'correct it with tudor fit --payload-of BAG=KG, '
        "or payload under custom_data in the bag's metadata.yaml", 'kg', 'payload [kg]'),
    'gauge_gain': Check('the gain of a gauge has changed since the fit', CHANGED),
    'gauge_zero': Check('the zero offset of a gauge has changed since the fit', CHANGED),
    'load_unknown': Check(
        'the arm carries a load that the model lacks', 'fit a model to bags with this load, or to '
        'bags of two known loads (tudor fit --payload-of BAG=KG)', 'kg', 'relative model error')}
"""All that can be found, by its stable key."""


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong."""

    kind: str
    what: str  # the same in a sentence, with place and size
    remedy: str  # what to do
    bag: str = ''  # bag it was found in; empty where the description alone shows it
    channels: tuple[str, ...] = ()  # joints or gauges concerned; empty: all, or none
    time: float | None = None  # where it begins, since the start of the bag [s]
    size: float | None = None  # how large it is, in `unit`
    unit: str = ''  # unit of the size; empty for a factor
    measure: str = ''  # what `now` and `otherwise` are
    # Evidence: the measure as things are, and with the remedy.
    now: float | None = None
    otherwise: float | None = None

    @property
    def title(self) -> str:
        """Say what it is, for people."""
        return CHECKS[self.kind].title

    @property
    def evidence(self) -> str:
        """Put the evidence in words; empty where the sentence has it all."""
        if self.now is None:
            return ''
        now, otherwise = (
            '' if value is None else f'{100 * value:.3g} %' if self.measure.startswith('relative')
            else f'{value:.3g}' for value in (self.now, self.otherwise))
        return f'{self.measure}: {now}' + (otherwise and f' now, {otherwise} with the remedy')

    def __str__(self) -> str:
        """Write what, evidence and remedy on one line."""
        shown = f' ({self.evidence})' if self.evidence else ''
        return f'{self.what}{shown}; {self.remedy}'

    def as_dict(self) -> dict[str, Any]:
        """Give it as plain values without what is not there."""
        content = asdict(self) | {'channels': list(self.channels)}
        return {key: value for key, value in content.items()
                if value is not None and (value or not isinstance(value, str | list))}


def found(
    kind: str, what: str, bag: str = '', channels: tuple[str, ...] = (), *,
    time: float | None = None, size: float | None = None, now: float | None = None,
    otherwise: float | None = None, remedy: str = '', measure: str = '',
) -> Finding:
    """Make a finding; remedy, measure and unit are those of its check where none are given."""
    check = CHECKS[kind]
    return Finding(kind, what, remedy or check.remedy, bag, channels, time, size,
                   '' if size is None else check.unit,
                   '' if now is None else measure or check.measure, now, otherwise)
