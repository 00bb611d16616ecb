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
Tuned numbers of the simulated mechanics: what each means, its unit, and where it is from.

Kernels use some of them: `tudor_dynamics.compiled` has this file in its checksum.
"""

# -- Beams and the integrator

# Elastic rotation up to which a beam bends as it should: a cantilever by 4 % too much [rad]
# (bench/small_displacements.py).
LARGEST_ROTATION = 0.3
# Elastic rotation at which a run ends [rad]: deflections are 35 % too large at 1 rad
# (bench/small_displacements.py).
MAX_ROTATION = 1.2
# Newton iterations of a step; 2 to 4 are usual (bench/simulate_speed.py).
MAX_ITERATIONS = 40
# Size of accelerations (squared, weighted by mass) that sets the integrator's tolerance in the
# closed loop, also at rest.
REST_ACCELERATION = 1e4
# Spectral radius at the highest frequencies, and tolerance of Newton's iteration, in the closed
# loop; iterations of a step: measured in test/mechanics/test_prediction.py.
LOOP_DAMPING, LOOP_TOLERANCE = 0.8, 1e-5

# -- Drives

# Angle of the fastest allowed oscillation of the rotor on its gear per step [rad]: the semi-
# implicit step is stable below 2.
RIGID_GEAR = 0.5
# Damping of a rigid gear over sqrt(stiffness inertia): a tenth of critical damping.
RIGID_GEAR_DAMPING = 0.2

# -- Recordings: random pushes and changes of load (docs/explanation/simulation.md)

# Smallest and largest mass that is picked up [kg]: the payloads of the paper's experiments.
LOADS = (0.1, 0.4)
# Not before models and filters have settled [s].
FIRST_CHANGE = 6.0
# Long enough to identify one load before the next [s].
BETWEEN_CHANGES = 6.0
# Smallest and largest force [N] and duration [s] of a push: from within the 2 to 6 N at which
# detection is measured to twice as much (docs/explanation/thresholds.md).
PUSH_FORCE, PUSH_TIME = (3.0, 12.0), (0.1, 1.0)
# Of a push that is held: where detection is measured (docs/explanation/thresholds.md).
HELD_FORCE, HELD_TIME = (2.0, 6.0), (1.5, 4.0)
# Not before the arm moves, after the rest of 1.5 s that an excitation begins with [s].
FIRST_PUSH = 3.0
