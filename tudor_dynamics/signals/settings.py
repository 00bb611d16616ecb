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
Tuned numbers of filters, motions and preprocessing: meaning, unit, and where each is from.

Kernels use some of them: `tudor_dynamics.compiled` has this file in its checksum.
"""

# -- Stamps of recordings (doctor)

# Less, relative to the sample time, changes no derivative that matters.
LEAST_JITTER = 0.02
# A stamp farther from its even place, in sample times, belongs to another one: below half of one.
LARGEST_OFFSET = 0.45
# The same where no sample was lost, and the order of the messages says which it is: below one;
# jitter of that size is among the faults of bench/doctor.py.
LARGEST_IN_ORDER = 0.9
# Even stamps are right where they reduce the roughness to less than this part (no false alarm with
# the faults of bench/doctor.py).
CLEAR = 0.8
# Stamps below which a stretch is not compared with even ones.
FEWEST_STAMPS = 200

# -- Warm-up, and ring-down of a link

# Warm-up in lags of one stage, after which an acceleration is right to 1e-4: the step response of
# three stages, measured in test/signals/test_smooth_states.py.
SETTLED = 16.0
# An arm that stays within this [rad or m] for so long [s] stands, as filters assume; it moves soon
# where it goes ten times as far before they settle. 2 mrad give false couplings: test_trials.py.
STOOD, STANDSTILL = 0.1, 2e-4
STILL = 0.02  # speed below which a stretch begins at rest [rad/s or m/s]
# Samples below which a stretch is left out, as a zero-phase filter needs as many.
FEWEST = 32
# Frequencies that count as those of links [Hz]: around the first mode of the reference arm, 1.7 to
# 3.3 Hz (bench/damping_study.py), and the second, 5 to 15 Hz.
LOWEST_RINGING, HIGHEST_RINGING = 0.5, 25.0
# A decay is averaged down to no more samples than this: the matrix pencil costs their cube.
MOST_SAMPLES = 600

# -- Planned motion

# Largest jerk over the largest acceleration [1/s]: only pulses shorter than 2 pi / JERK times the
# part of the acceleration that they reach, 0.16 s at half of it, get smaller.
JERK = 20.0
# Rest before the first target of an excitation [s]: controllers and filters settle.
REST = 1.5
# Of a trajectory that is made denser; five minutes of a 3 kHz loop.
MOST_POINTS = 1_000_000

# -- Moves without oscillation (docs/explanation/shaping.md)

# Intervals of each joint's acceleration: a linear programme of 0.05 s for two joints (measured,
# docs/explanation/shaping.md).
KNOTS = 30
# Steps between two knots, for integrals.
FINE = 16
# Part by which the first frequency may be another: what a payload of 400 g does that is 100 g off
# (measured, docs/explanation/shaping.md).
SPREAD = 0.07
# Weight of the oscillation at such frequencies against the largest jerk, each over what it is
# without shaping; its result is measured by bench/shaping_seeds.py.
ROBUST = 0.3
PROGRAMME_STEPS = 5000  # of a linear programme: 300 are usual, few never end (still_limits.py)
# Part of the limits of speed and acceleration that is planned, for rounding.
ROUNDING = 1.0 - 1e-6
# Of a period that a move may be longer than without shaping: as much as ZV takes (Singer and
# Seering's paper of 1990).
LONGER = 0.5
# Quarters of a period that are tried in addition: two periods in all.
TRIES = 8
# Most linear programmes in turn: planning takes 1.2 s at most (bench/shaping_seeds.py).
STEPS = 10
# Change of acceleration by which differences are taken, of its limit.
NUDGE = 0.01
# Change of acceleration, of its limit, in which a simulation is taken for linear at first, and at
# least; the result is measured by bench/shaping_seeds.py.
FARTHEST, SMALLEST = 0.3, 1e-3
# Parts of that, tried side by side; half of the way to each as well.
RADII = (1.0, 0.4, 0.12, 0.03)
# A step that leaves more of the oscillation than this part is the last one.
LITTLE = 0.985

# -- Trajectories of others that are shaped (shaping.py)
AT_REST = 1e-3  # speed below which a trajectory ends at rest [rad/s or m/s]
APART = 1e-6  # points of two copies that are closer are one [s]
