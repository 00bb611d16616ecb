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
Tuned numbers of the nodes, with unit, meaning and where each was settled.

Of a number that names no bench or measurement none is left.
"""

# Queues.

DEPTH = 10
"""Messages that may wait. One is too few: at 1 kHz it loses samples; bench/node_rates.py."""
DEEP = 100
"""Messages that may wait where every one is used however late it comes: with 10, 99.73 to 99.98 %
came through at 2 kHz, as a machine halts for 20 ms now and then, measured by bench/node_rates.py.
What commands an arm needs the newest one alone, and has the short queue."""
RECORDER_DEPTH = 1000  # messages of a topic that may wait for the recorder
WAITING = 200  # motions that may wait for their prediction

# Diagnostics.

REPEAT = 5.0  # time before another fault of the same level is logged [s]
STANDS = 1.0
"""A simulated clock that stands for so long has ended [s]: ages grow by the wall clock again. On
two cores with a load of five, gaps of 0.4 s came (bench/closed_loop_topics.py)."""
LATENCIES = 4096
"""Latencies of which percentiles are taken: to sort them takes half a millisecond, in which
samples wait; bench/node_rates.py."""
TOO_MANY = 0.2  # share of unusable messages that is a warning
AGE_SHARE = 0.02  # weight of a new age of stamps in the mean
EARLY = 0.05
"""A stamp so far in the future comes from another clock [s]: simulated time that ticks with the
samples is one sample late, which is 10 ms at 100 Hz and this at 20 Hz."""
OLD = 0.5  # a stamp so old as well: no driver keeps its readings for so long [s]
ENOUGH = 20  # stamps before a fault is reported

# Time between two looks.

SUBSCRIPTIONS_LOOK = 0.01
"""At who listens, of which each count takes 2 us [s]; bench/node_rates.py."""
SIGNAL_LOOK = 0.2  # at signals: the longest time until one is noticed [s]
ARMS_LOOK = 0.1  # at the monitors of several arms [s]
TOPICS_LOOK, SAVE = 0.2, 1.0  # at topics to record; time after which a message is on disk [s]
PUBLISHERS_LOOK = 0.5
"""At who commands the arm, and who says where it is: the graph takes 0.1 ms to ask [s]."""
VERDICT_LOOK = 0.05  # at the own state, which is published at once where its level changes [s]
MONITORS_LOOK, ALIVE = 0.5, 2.5
"""At who watches for collisions; age of a monitor's last diagnosis, of which one comes a second,
at which it counts as gone [s]."""
UNHEARD = 2.0  # time without a word of a monitor from which on a view knows nothing [s]

# Loads.

MOVED = 1e-3  # way of a finger from which on it moves [rad or m]
EVERY = 100_000_000  # time between two messages of a load that goes on changing [ns]
CHANGED = 0.1  # part of its standard deviation by which it has to have changed

# Arms that move.

LATE = 0.2  # a simulator that is so late gives up real time instead of hurrying [s]
LISTENS = 0.1
"""Part of a period for which it listens for commands after each sample, however late it is."""
ANSWERED = 0.1
"""For so long a simulator in lockstep waits for the command that answers a sample [s]: it may be
lost, and a damper without positions brakes after 0.25 s."""
SILENT = 0.1
"""Strains that are older than positions by more are missing; a longer gap between positions is an
interruption of force control [s]."""
BRAKING = 2.0  # a process that ends waits no longer than this for the arm to stand [s]
LONGEST_GAP = 60.0
"""The damper says itself what an interruption is; this is for clocks that are set [s]."""
RECORD = 3.5  # strain that the sign test listens to after each step [s]
PATIENCE = 30.0  # the sign test waits no longer than this for nodes, positions and strains [s]
ATTEMPTS = 3  # requests of a service within that time: an answer gets lost

# Trajectories.

STATE_PERIOD = 0.05
"""Time between two reports of how far a trajectory is; as often as joint trajectory controllers
look by default [s]."""
SHORTEST_STOP = 0.1
"""Least time in which a controller is to be at rest: it has to take the message before [s]."""

LISTEN = 5.0  # time to find and measure live topics: DDS announces itself every 3 s [s]
