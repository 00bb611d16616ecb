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

"""
Tuned numbers of the doctor.

source of all, where no other is named: ``bench/doctor.py`` puts 862 faults into recordings of
seven robots. The numbers were chosen on the two-blade arm, UR10, Airbot and EMPS and proven on
reference arm, UR10e, TX40 and Quanser (docs/doctor.md): 97.9 % of the faults are named, nothing
is found in 66 recordings without faults.
"""

from __future__ import annotations

import numpy as np

# -- Decimated recordings (case.py)
CUTOFF = 8.0  # corner of the zero-phase filter of motion and outputs [Hz]
LEAST_SECONDS = 3.0  # shorter stretches are left out [s]
MARGIN = 0.25  # left out at both ends of a stretch: filter edges, room for lags [s]
MOST_SAMPLES = 600  # samples kept of a bag
LEAST_STEP = 0.03  # no two samples kept are nearer [s]
SMALLEST = 1e-9  # directions of the scaled Gram matrix below this part of the largest are left out
PREDICTING = 1e-5  # the same where samples are predicted that were not learned from
FLOOR = 1e-6  # no output counts as explained better than to this part of its variance
PASSES = 2  # weightings of channels that share parameters
ENOUGH_SECONDS = 20.0  # shorter recordings have to show more [s]
MOVING_SPAN = 0.02  # a joint that goes no farther does not move [rad or m]

# -- Descriptions (examine.py)
LONGEST_ARM = 20.0  # no arm reaches farther [m]; source: length of the largest industrial arms
TURN = 2.0 * np.pi + 0.05  # no angle of a table is larger [rad]

# -- Loads that a model does not know (examine.py)
LOAD_GAIN = 1.0  # sum of log ratios by which a load has to reduce the residual
LOAD_SHARE = 0.5  # upper bound of the part of the relative error that remains with a load
LOAD_ERROR = 0.1  # relative error, friction left out, below which a model is as it was

# -- Alternatives of a description (alternatives.py)
LEAST_GAIN = 1.0  # sum of log ratios by which the residuals have to be smaller: 1/e in one channel
HINTED_GAIN = 0.3  # the same where friction that drives points at the channel
GRAVITY_GAIN = 0.5  # the same for gravity, which all channels feel
COUPLED_GAIN = 1.5  # the same for drives that are coupled in one of many ways
REFINED_GAIN = 0.5  # the same for gravity that is turned away from an axis
FIRST_TURN, LAST_TURN = 0.35, 0.04  # steps of that search [rad]
DRIVING = -0.5  # correlation of friction and speed below which friction drives
SCALES = tuple(10.0 ** (sign * exponent) for sign in (1.0, -1.0)
               for exponent in (0.5, 0.75, 1.0, 1.25, 1.5, 2.75, 3.0, 3.25))
"""Factors between units of efforts that are tried: those of gears with motors, and thousandths."""
NEARLY = 2.0  # a scale within this factor of a thousand or a thousandth is taken for it
LAGS = np.arange(-0.06, 0.1501, 0.01)  # lags that are tried [s]
LAG_SHARE = 0.6  # upper bound of the relative residual with a lag: above, something else is wrong

# -- Trends of a channel (samples.py)
DRIFT_GAIN = 0.6  # log ratio by which a straight line in time has to reduce the residual
DRIFT_SIZE = 0.15  # drift over the recording, in standard deviations of the channel, at least
WINDOWS = 20  # windows of a recording in which a channel may have died
SHORTEST = 8.0  # shorter recordings do not show that a channel dies [s]
QUIET = 0.3  # a dead channel moves by less than this part of what it did, and of the expectation
EXPECTED = 0.3  # part of what a channel did that has to be expected of it, to be missed
ALIVE = 0.5  # upper bound of the relative residual of a channel while it lives
DEAD_GAIN = 1.0  # log ratio by which a dead end has to reduce the residual
FOLLOWS = 0.7  # slope of measured over expected output in a window in which a channel lives

# -- Units of efforts by their size (samples.py)
LARGEST_EFFORT = {'A': 150.0, 'N m': 3000.0, 'N': 20000.0}
"""No joint of an arm has more; source: data sheets of the largest industrial arms."""
BEYOND_LIMIT = 10.0  # as many times the effort limit of the URDF is another unit
UNLIMITED = 1e6  # limits of a URDF from here on are none
FEW_TIMES = 3.3  # masses of a URDF are wrong by less
THOUSANDTH = 30.0  # factors beyond are those between a unit and its thousandth

# -- Values of single channels (samples.py)
FAR = 20.0  # an outlier is as many times farther off than 99.5 % of the samples
FAR_RANGE = 0.3  # ... and by this part of the channel's range or more
SINGLE = 3  # more samples in a row are no outliers
RETURNED = 0.3  # part of the jump that may remain after an outlier
HELD_SECONDS = 0.4  # a channel that keeps one value for longer while the arm moves is held [s]
LIVELY = 10  # as many times its longest other run of one value is a hold by itself
FLAT = 4  # samples in a row at the end of the range that make a saturation
FLAT_SHARE = 0.004  # ... and the share of all samples there
STANDSTILL = 3.0  # ends without motion that are longer are reported [s]

# -- Comparisons of bags (between.py)
COMPARABLE = 0.5  # share of an output that a model of another bag has to explain
OTHER_UNIT = 3.0  # factors beyond are those of units
THOUSANDTH_OF_BAGS = 100.0  # factors beyond are those between a unit and its thousandth
LEAST_PAYLOAD = 0.02  # payloads that differ by less count as the same [kg]
PAYLOAD_OFF = 0.3  # part of the largest payload by which a stated one may be off
DIFFERENT = 0.15  # relative error of a prediction from which two bags differ in load
SAME_SHARE = 0.9  # part of the samples that two recordings have in common where they are one
