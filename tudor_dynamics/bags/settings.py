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
Tuned numbers of reading bags, with unit, meaning and where each is from.

``bench/sweep.py bags`` shows what each of them changes.
"""

import math

# Gaps, clocks and samples

GAP_PERIODS = 5.0  # sample times that are no gap: a lost message now and then is passed
GAP_FLOOR = 0.02
"""Shorter is no gap in fast recordings [s]: at 1 kHz a stall of a few milliseconds is scheduling,
and motion and oscillation of arms (below 20 Hz) are still sampled faster than twice their
frequency across 20 ms. source: sampling theorem."""
LEAST_SET_BACK = 3
"""Messages in a row before the newest stamp that make a clock that was set back (bench/doctor.py);
one or two were overtaken on their way."""
FEW = 0.05  # share of samples of a channel that may be no numbers and are excluded with a warning
MAX_VALUE = 1e12
"""Nothing about an arm is larger in any unit; squares and products do not overflow. source: range
of doubles."""
MIN_SEGMENT = 5
"""Samples between two gaps that are used: from fewer nothing can be differentiated. source: two
difference quotients take three."""
MIN_SAMPLES = 50  # samples of a recording
MIN_DURATION = 1.0
"""Length of a recording that outlasts the transients of the filters (``preprocessing.settle``, 0.5
s) [s] beyond that."""

# Units and motion

MANY_TURNS = 4 * math.pi
"""No revolute joint without limits in its description is taken to go farther than this [rad]."""
UNLIMITED = 1e6  # limits beyond this are none [rad or m]. source: URDFs that write 1e9 for them.
WINDOW = 0.1
"""Over which displacement and integrated velocity are compared: longer than the lag of a velocity
filter in a driver, shorter than a movement [s]."""
MIN_DISPLACEMENT = 2e-3  # less than this within a window is no movement to compare by [rad or m]
MIN_WINDOWS = 5  # windows with movement that a comparison takes
UNIT_TOLERANCE = 0.2
"""Relative distance from a ratio that is taken as that: 1, -1 and 57.3 are far from each other."""
MAX_SPREAD = 0.3
"""Median relative deviation of the ratio above which velocity does not follow position."""
FAST = 10.0  # joints of arms seldom turn faster, but ten degrees a second are common [rad/s]
FASTEST = 60.0  # no joint of an arm turns this fast, ten turns a second [rad/s]
STILL = {False: 1e-3, True: 1e-4}
"""A joint that moves less stands still, by prismatic or not [rad, m]; encoder noise is less."""
