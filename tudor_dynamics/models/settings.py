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

"""Tuned numbers of models, their estimation and what is tuned by them: unit, meaning, source."""

import math

import numpy as np

# -- Least squares (analytical.py, estimation.py)
# Passes of weights of the samples; a fit that needs more of them warns.
WEIGHT_PASSES = 20
# Turns of loads and parameters, and the relative change at which they have settled.
LOAD_PASSES, LOAD_CHANGE = 10, 1e-3
# Residuals beyond it, in standard deviations, count less.
HUBER_CONSTANT = 1.345  # 95 % efficiency at the normal distribution (Huber, Robust Statistics)
# Condition numbers of the scaled columns: above, triangular factors take over; above, a direction
# is not shown by the motion.
LARGEST_GRAM_CONDITION, UNEXCITED_CONDITION = 1e6, 1e10  # test/models/test_estimators.py
# The prior is left out where it would move a direction by less than this part.
NEGLIGIBLE = 1e-3
# Norm of a column beyond those before it, over the largest, from which on it is one of its own.
RELATIVE_TOLERANCE = 1e-8

# -- Torque constants (estimation.py)
# Standard deviation of the logarithm of a constant about the mean of all, before any data: joints
# of one arm have drives of one kind. It decides for wrists whose bodies hardly show.
PRIOR_WIDTH = 0.5
# Samples that count as one: residuals of a motion are no white noise (2.5 s at 20 Hz).
CORRELATED = 50.0
# Turns of constants and weights of the channels.
CONSTANT_PASSES = 3
# Part of a column's own information that is added to it: parameters may be hard to distinguish.
RIDGE = 1e-9
# Of the logarithm of a constant, for differences.
CONSTANT_STEP = 1e-3

# -- Friction (friction.py)
# Displacements over which friction is tried to give way [rad or m], evenly on a logarithmic scale.
DISTANCES = (3e-4, 1e-3, 3e-3, 1e-2, 3e-2)  # 0.3 to 10 mrad: docs/explanation/validation.md

# -- Bodies and drives that can exist (consistent.py); bench/consistent.py measures what they do
# Mass of a body that is described without any, as a part of all.
LEAST_SHARE = 1e-4
# Radius of gyration added to bodies that are described as points, lines or plates [m].
LEAST_RADIUS = 0.01
# Mass per length where no mass is described at all [kg/m].
ROD = 4.0  # that of lightweight arms
# Length of the last body where nothing is known of it [m].
TOOL = 0.1
# Standard deviation of the logarithm of half a mass, described or guessed.
WIDTH_DESCRIBED, WIDTH_ROD = 0.5, 1.0  # docs/explanation/export.md
# The same of a size; of a centre of mass and of a product of inertia as a part of the size.
WIDTH_SHAPE = 0.5  # docs/explanation/export.md
# Speeds at which friction is looked at, in each direction.
GRID = 12
# Part of its largest effect from which on a term is asked to make up for others: of Coulomb
# friction at the smallest speed there is three quarters.
ACTS = 0.3
# What is raised for one direction takes an eighth of it from the other at the smallest speed.
ENERGY_PASSES = 30
# Largest speed of a motion over its root mean square: 1.4 for a sine, 3 for moves with rests.
PEAK = 2.5
# Width of what drives may contribute to an output, in units of the output's size: no knowledge,
# but a bound on what nothing shows.
WIDTH_DRIVE = 3.0
# Standard deviation of the logarithm of all torque constants together: no knowledge.
WIDTH_CONSTANT = 3.0
# Part of their weight that the data have in each search, and how strictly friction has to take
# energy: with all of both from the beginning, the way to the solution is a winding valley.
SEARCHES = ((1e-4, 1e2), (1e-2, 1e3), (1e-1, 1e3), (1.0, 1e3), (1.0, 1e4))
# Relative change of the sum of squares at which a search ends, and its evaluations at most.
ENOUGH, EVALUATIONS = 1e-9, 300

# -- Words for what a parameter comes from (comparison.py)
# Standard error over that before any data, up to which a parameter comes from the data, or both.
FROM_DATA, FROM_BOTH = 0.3, 0.8

# -- Elastic models (elastic/)
# Longest inner step [s].
# One at 500 Hz. Of 2.5e-3, crossings of a play move shares of stiffness by a tenth
# (bench/elastic_study.py --only fits).
INNER_STEP = 2e-3
# Rate at which the observer forgets what it does not know the cause of [1/s].
BANDWIDTH = 8.0
# Beginning in which it learns how links oscillate, where a stretch begins in motion [s]: 2, 4, 6
# and 8 s explain as much of bags/two_blade_test (bench/elastic_beginnings.py).
OBSERVED = 2.0
# The edge of a play is rounded over this part of it, where nothing better is known.
EDGE = 0.1
# Lag of amplifiers of gauges at most [s]: slower ones show no oscillation.
LONGEST_LAG = 0.2
# A gear of unknown stiffness is this often as stiff as the link after it.
RIGID_GEAR = 30.0

# -- Gains by an elastic model (tuning.py); docs/explanation/damping.md
# Of a drive, for differences [rad].
DRIVE_NUDGE = 1e-4
# Below it the approximation of a delay is as good as none [s].
LEAST_DELAY = 1e-4
# Poles below this part of the first frequency belong to means and position loops.
SLOW = 0.3
# Between nodes along a joint, where there are not too many [rad].
SPACING = math.radians(15.0)
# Most poses of a grid.
POSES = 1500
# Position gain over the first angular frequency: the position loop must not fight the damper.
STIFFNESS = 0.13
# Corner of the DC blocker [Hz]: the load is known, what remains changes slowly.
MEAN = 0.15
# Of the described gains, for a first look.
FACTORS = np.geomspace(0.1, 6.0, 22)
# Halvings of an interval in which a factor or a delay is sought.
HALVINGS = 7
# Delay from which on gains excite, over the one that they are used with.
ROOM = 2.0  # docs/explanation/damping.md: a factor that excites at twice the delay is none
# Within which, and in which ratio, delays are looked at [s].
SHORTEST_DELAY, LONGEST_DELAY, FINER = 2e-3, 0.2, 1.2
# Delays at which a factor is looked at.
LOOKS = 4
# Between samples of a simulated move [s].
MOVE_SAMPLE = 2.5e-3  # as the longest inner step
# Of them, those after a move that are compared.
EVERY = 3
# Time after the end of a move from which oscillations count [s].
AFTER_MOVE = 0.02
# An oscillation that gauges hardly show [m/m].
NOTHING = 2e-6

# -- A flexible tool (flexible_tool.py, still_timing.py); judged by bench/flexible_tool.py
# Time after a stop from which on the modes of an arm in its own drives have decayed [s].
RING_AFTER = 1.2
TOOL_CUTOFF = 25.0  # corner of the zero-phase filter of motion [Hz]
# Samples of a trajectory, and how much of it a tool remembers, from its end [s].
TOOL_STEP, TOOL_MEMORY = 0.004, 60.0
TOOL_DRAWS = 120  # random tools within the uncertainty, for an interval
TOOL_LEVER = 0.3  # translation that counts as much as a rotation of 1 rad: half a long tool [m]
TOOL_HIDDEN = 0.1  # push in a direction, over the largest, below which the direction is hidden
# Error of the ring that a direction adds in which nothing has pushed the tool, relative to it: its
# shape alone says how it is pushed there (bench/flexible_tool.py, the transfer that rotates).
TOOL_UNSEEN = 0.5
TOOL_NUDGE = 1e-4  # of its place, for differences [m]

# -- Another timing of a path (still_timing.py); measured by bench/still_moves.py
# Of a period that a motion may be longer, tried in turn: as much as ZV takes, and a fifth more.
TIMING_LONGER = (0.5, 0.55, 0.59)
# Between knots of the squared rate, in the time of the given trajectory [s]; least number of
# coefficients.
TIMING_KNOT, TIMING_FEWEST = 0.06, 32
TIMING_SPREAD = 0.05  # part by which the frequency may be another
# Ring over that of the given trajectory: which is good enough, the same where the frequency is
# off, and from which on a timing is refused.
TIMING_GOOD, TIMING_OFF, TIMING_MOST = 0.01, 0.05, 0.2
TIMING_LEAST = 0.02  # of what a motion drives in all, a ring that is not worth less
TIMING_ROUNDS = 12  # most linear programmes in turn
TIMING_WORTH = 0.95  # part that may remain after one, so that another one is tried
TIMING_CUTS = 8  # most solutions of one, each with the limits that the one before passed
TIMING_NEAR = 1e-6  # limits, and time [s], are met as near as this
# Largest change of the squared rate in a step, relative to it; what a change of 1 has to remove of
# the ring.
TIMING_RADIUS, TIMING_SMALL = 0.3, 0.1
# Part of a limit that is used, as joints need up to 0.2 % more between samples
# (bench/still_limits.py).
TIMING_FULL = 0.995
TIMING_SLOWEST = 0.05  # least rate
TIMING_SAME = 0.05  # frequencies that are closer are one to impulses
TIMING_WINDOW = 4.0  # before the end, in which a timing may be another [s]

# -- How a tool rings beside the robot: test/models/test_flexible_tool.py
# Rates of observing a mode and the mean beside it, over its angular frequency: 0.2 and 1.3 s to
# settle at 3 Hz.
RING_BANDWIDTH, RING_MEAN = 0.25, 0.04
# Of the levers of all modes, what is added where efforts do not tell them apart; and the time for
# which frequencies hold [s].
RING_RIDGE, RING_RENEWED = 0.005, 0.1
