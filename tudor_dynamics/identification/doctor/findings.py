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
UNSEEN = 'relative error of parts left out'
NAMES = 'correct the names in the driver or in the description'
UNIT = 'correct joints[].effort.unit, or scale the efforts in the driver'
ONE_PART = 'leave one part out with BAG@BEGIN-END%'
CHANGED = 'look at its bond, cable and amplifier; if it stays so, fit again with this bag'
PLACE = 'give gauges[].distance in metres, from the axis of the joint along its link'
CHECKS = {
    'gravity_axis': Check('gravity of the description along another axis', '', 'deg', RESIDUAL),
    'dh_in_millimetres': Check('lengths of the kinematics in millimetres',
                               'give a and d in metres', 'm'),
    'dh_in_degrees': Check('angles of the kinematics in degrees',
                           'give alpha and theta in radians', 'rad'),
    'gauge_in_millimetres': Check('distance of a gauge in millimetres', PLACE, 'm'),
    'gauge_beyond_link': Check('gauge beyond its link', PLACE, 'm'),
    'joint_not_listed': Check(
        'a joint moves that the description does not list',
        'list them under joints, and under active_joints where that is given'),
    'effort_unit': Check('effort in another unit than described', UNIT, '', RESIDUAL),
    'effort_sign': Check('effort with its sign turned',
                         'turn the sign of the effort in the driver', '', RESIDUAL),
    'joint_sign': Check(
        'joint counted in the other direction', 'turn the sign of the position in the driver, or '
        'the axis of the joint in the kinematics', '', RESIDUAL),
    'strain_unit': Check('strain in another unit than described', 'correct gauges[].unit, or '
                         'scale the readings in the amplifier'),
    'gauge_sign': Check('gauge with its sign turned',
                        'find out which bag has the right sign; record the other again, or leave '
                        'it out'),
    'efforts_exchanged': Check('efforts of two joints exchanged', NAMES, '', RESIDUAL),
    'joints_exchanged': Check('two joints exchanged', NAMES, '', RESIDUAL),
    'coupling_missing': Check(
        'a motor turns with another joint, and the description does not say so', '', '', RESIDUAL),
    'coupling_wrong': Check(
        'coupled drives of the description that the outputs do not show', 'leave couplings out of '
        'the description, or correct pairs, positions and efforts there', '', RESIDUAL),
    'gauges_exchanged': Check('two gauges exchanged', NAMES, '', RESIDUAL),
    'clock_set_back': Check(
        'the clock was set back while recording', 'let the clock settle before recording; steer '
        'clocks slowly (chrony without steps)', 's', one_bag=True),
    'velocity_zeros': Check('velocities are all zero',
                            'let the driver measure velocities, or leave them out'),
    'velocity_late': Check(
        'velocities late', 'leave them out with preprocessing.measured_velocity: false, or mend '
        "the driver's filter", 's', RESIDUAL),
    'effort_late': Check(
        'efforts late', 'let the driver stamp efforts when they are measured, or take the efforts '
        'of the joint states', 's', RESIDUAL),
    'strain_late': Check(
        'strains late', 'let the amplifier stamp strains when they are measured, not when they '
        'arrive', 's', RESIDUAL),
    'jitter': Check('stamps jitter on an even sampling',
                    'stamp in the driver when the sample is taken', 's',
                    'roughness of the positions'),
    'outlier': Check(
        'single samples far off', 'repair the driver or the wiring, or leave this part out with '
        'BAG@BEGIN-END%', one_bag=True),
    'positions_wrapped': Check(
        'positions jump by a turn', 'let the driver count turns on', 'rad', one_bag=True),
    'position_jump': Check(
        'position jumps', 'check encoder, coupling and index mark; leave this part out with '
        'BAG@BEGIN-END%', one_bag=True),
    'position_held': Check(
        'position held for a while', 'check encoder and bus; leave this part out with '
        'BAG@BEGIN-END%', 's', one_bag=True),
    'coarse_positions': Check('positions of few digits', 'publish all digits of the encoder'),
    'noisy_positions': Check('positions noisy', 'check the shield of the encoder'),
    'stale': Check('positions repeated in motion',
                   'publish each reading once, with the stamp at which it was taken'),
    'filled': Check('lost samples filled by lines', 'record what comes, without filling: a fit '
                    'leaves gaps out by itself', 's', one_bag=True),
    'copied_channel': Check('channel gives the values of another', NAMES),
    'alternating': Check('zeros between the samples',
                         'publish a value only where there is one'),
    'rectified': Check('channel without its sign', 'let the driver publish signed values', '',
                       RESIDUAL),
    'coarse_channel': Check('channel of few digits', 'widen or narrow the range of the driver'),
    'hum': Check('wave of one frequency',
                 'check ground and shield, or sample faster and filter', 'Hz', RESIDUAL),
    'gain_step': Check('channel changes its gain', f'check amplifier and connectors; {ONE_PART}',
                       '', RESIDUAL, one_bag=True),
    'offset_step': Check('channel changes its zero', f'check amplifier and connectors; {ONE_PART}',
                         '', RESIDUAL, one_bag=True),
    'payload_changed': Check('load changed while recording', ONE_PART, '', RESIDUAL, one_bag=True),
    'unexplained': Check('channel that is not explained', 'plot it over the motion, or leave '
                         'it out', '', RESIDUAL),
    'joint_scale': Check('position of a joint in another scale', 'correct counts per turn or the '
                         'gear ratio in the driver', '', RESIDUAL),
    'time_scale': Check('stamps count another time', 'stamp in the driver, or correct the rate '
                        'that its stamps are counted by', '', RESIDUAL),
    'position_drift': Check('position creeps', 'check belt, coupling and the hold of the encoder; '
                            f'{ONE_PART}', 'rad', RESIDUAL, one_bag=True),
    'position_ripple': Check('position errs with its angle', 'centre the disc of the encoder, and '
                             'check coupling and bearing', 'rad', RESIDUAL),
    'saturated': Check('channel saturated', 'widen the range of amplifier or driver, or move more '
                       'slowly', one_bag=True),
    'held': Check('channel held for a while', 'check sensor, wiring and driver; leave this part '
                  'out with BAG@BEGIN-END%', 's', one_bag=True),
    'dying': Check('channel dies', '', 's', one_bag=True),
    'drift': Check('channel drifts', 'let the sensor warm up, or mend its zero; shorter parts '
                   'BAG@BEGIN-END% drift less', '', RESIDUAL, one_bag=True),
    'constant': Check('channel that never changes',
                      'check sensor and driver; the channel cannot be learned'),
    'same_recording': Check(
        'the same recording twice',
        'give another recording: a copy is no test of what was learned from it', '',
        'share of samples in common'),
    'rings': Check('what the arm carries rings on after motion', '', 'Hz'),
    'standstill': Check('the arm stands still at the ends', '', 's', one_bag=True),
    'payload_wrong': Check('payload stated wrong', 'correct it with --payload-of BAG=KG, or in '
                           'the metadata of the bag', 'kg', 'payload [kg]'),
    'gauge_gain': Check('gauge with another gain than the model knows', CHANGED),
    'gauge_zero': Check('gauge with another zero than the model knows', CHANGED),
    'load_unknown': Check(
        'the arm carries a load that the model lacks', 'fit a model to bags with this load; bags '
        'of two loads and --payload-of BAG=KG give one of all loads', 'kg', 'relative error')}
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
        if self.measure == UNSEEN and self.otherwise is not None:
            return f'unseen parts: {100 * self.now:.2g} % -> {100 * self.otherwise:.2g} %'
        other = '' if self.otherwise is None else f', {self.otherwise:.3g} with the remedy'
        return f'{self.measure} {self.now:.3g}{other}'

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
