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
Tuned numbers of loads, with unit, meaning and source.

"Measured" without more is on the simulated reference arm with every imperfection, as the tables
of docs/explanation/load.md have it: ``python -m papers outlook --only payload``.
"""

# -- From the unit of an output to kilograms (rows.py)
# Part of an effort that the masses of the description explain before they are believed.
BELIEVED = 0.6
# Relative standard deviations, assumed: of torques from sensors, of published torque constants
# (with the losses of the gear in them), of the gain of a gauge.
TORQUE_STD, CONSTANT_STD, GAIN_STD = 0.03, 0.10, 0.05
# Part of a joint's usual speed over which the sign of its friction is taken to change.
SLOW = 0.03
# Random motion by which masses of the description are compared with torques [samples].
SAMPLES = 200

# -- Least squares of a recording (offline.py)
# Time over which residuals are taken to depend on each other [s]: longer than an oscillation.
WINDOW = 2.0  # measured: of 42 recordings 98 % are within two standard deviations
# Turns of weights of the channels and parameters.
PASSES = 4
# Steps of Gauss and Newton of a model whose outputs are no straight line of the load.
TURNS = 4
# Difference of loads by which such a model says what a little more would do [kg].
STEP = 0.05
# Standard deviation of a mass, as a part of what weighs like the arm itself (or of the payloads of
# the model), from which on a recording says nothing of a load.
UNKNOWN_STD = 0.25
# Standard deviations from which on a load is one.
SURE = 2.0  # 95 % of a normal distribution
# A mass with a free place may be as many times as uncertain as one at the tip.
WIDER = 2.0
# Standard deviation of a place along an axis from which on it is not reported [m].
LARGEST_ARM = 0.1
# Poses over which the arm's own weight is compared with that of a load.
POSES = 200

# -- Links that bend (bending.py)
# Of the filter [Hz]: first modes pass, second ones, in which links bend otherwise, do not.
CUTOFF = 5.0  # measured: 4 to 8 Hz do as well, with 10 Hz a tenth of the loads is found later
# Time between samples that are kept [s]: aliases of noise would add to it.
FINE = 0.02
# Angle by which a gauge's usual strain is tried [rad or m].
TURN = 1e-3
# Steps of the search at most, and the part of the error by which a step has to lessen it.
STEPS, SETTLED = 12, 1e-3
# Samples that the search needs.
SEARCHED = 6000
# Upper bound of the part of the residual of rigid links that bent ones leave, in some gauge.
EXPLAINED = 0.9  # on the reference arm a measured 0.1 to 0.3 below 3 Hz
# Time over which means of residuals do not depend on each other [s].
LONG = 0.5
# Share of the largest eigenvalue below which rows say nothing.
SMALLEST = 1e-7

# -- When the load changed (live.py)
# Time over which samples are summed up [s].
BLOCK = 0.05
# Random walk of the mass, in payloads of the model over a second.
WANDERS = 0.005
# Zero of a channel in its noise: standard deviation at first, and random walk over a second.
ZERO, ZERO_WANDERS = 1.0, 0.03
# Time for which the load that is there at the beginning is learned, touched or not [s].
BEGUN = 2.0
# Past in which a change is looked for, and the same while one is announced [s].
RECENT, ANNOUNCED = 1.2, 4.0  # measured: all announced loads within 10 g after 5 s
# Time since a change until it is looked for, and until it is reported if not announced [s].
SEEN, SOONEST = 0.2, 0.6  # measured: 50 of 50 unannounced loads within a second
# What an announced change explains at least, by chance it is 1; and what any other does.
EXPECTED_GAIN, LOUD = 6.0, 40.0  # measured on other seeds than those of the tables
# A load explains it as well as a moment that stays, but for this.
TOUCH = 1.3  # measured: 1 of 100 pushes is taken for a load
# Upper bound of the residual of a load as a part of that of its weight without inertia, until it
# has stayed: on an arm that does not move the two are the same.
PRESSED = 0.9  # measured: with 1.3 three of 100 pushes are taken for loads in place of one
# Loads that are distinguished from touches, in payloads of the model.
LIGHTEST, HEAVIEST = 0.12, 1.5  # measured on other seeds than those of the tables
# What has stayed for so long [s] is a load from so little on, and be it as its weight alone.
LASTING, LIGHTER = 3.0, 0.02  # test/load/test_change.py
# What a moment that stays explains at least of a change, if something touches the arm.
ODD = 60.0  # measured on other seeds than those of the tables
# Part of a load that has just come by which it may be wrong, in addition to its own noise.
UNSURE = 0.05
# A sample stands for no more time than this [s].
LARGEST_STEP = 0.1

# -- Noise of what shows a load (live.py)
# Upper bound of the part of a change that a load leaves: by links that bend, by rigid ones.
BENT_EXPLAINED, RIGID_EXPLAINED = 0.15, 0.4  # measured, docs/explanation/load.md
# Time for which the error of a rigid model depends on itself [s].
DEPENDENT = 0.3
# Part of its mean square that is there without acceleration.
QUIET = 0.2
# Time for which a link rings after an acceleration [s].
RINGS = 0.6
# Time over which the usual acceleration is learned [s].
USUAL = 30.0
# Error of a model of which nothing is known, as a part of what loads the output.
ROUGHLY = 0.05
# Time for which a load that was announced may come [s].
EXPECTED = 3.0
# Time between two samples after which all starts again [s].
APART = 0.4
