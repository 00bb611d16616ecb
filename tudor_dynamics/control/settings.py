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
Tuned numbers of the control of joints: what each means, its unit, and where it is from.

Kernels use some of them: `tudor_dynamics.compiled` has this file in its checksum. Measured on the
reference arm of `config/tudor.yaml` unless another source stands there.
"""

from __future__ import annotations

import math

# -- Motion envelope (bench/recorded_limits.py, test/control/test_envelope.py)

COMMANDED_SPEED = 0.93
"""Part of the speed limit that is commanded: the rest is for what drive and load make of it."""
POSITION_MARGIN = 0.002
"""A position limit is kept off by what the speed limit goes in this time, for readings that are
rounded and joints that stick and slip [s]: 0.24 deg at 120 deg/s."""
BRAKING_SHARE = 0.6
"""Part of the acceleration limit with which the arm stops before a position limit: the rest is for
what drive and load make of a command."""
APPROACH_TIME = math.e
"""Time of the approach over the lag: a place that is approached by v = way / T through a lag is
not overshot from T = e lag on (second-order system, critical damping)."""

# -- Cascade

INTEGRAL_SHARE = 0.2
"""Corner of the integrator over the bandwidth: costs atan(0.2) = 11 deg of phase there."""

# -- Damper (docs/tuning_the_damper.md, bench/damper_trade_off.py)

MOVING_REFERENCE = 0.1
"""Part of the planned speed at which a reference counts as moving in full; source: none known."""
PLAUSIBLE_RATE = 0.2
"""Fastest plausible change of strain [1/s]: 2000 um/m at 16 Hz."""
PLAUSIBLE_STRAIN = 5e-3
"""Largest plausible strain: beyond the yield point of spring steel."""
DEAD_GAUGE_TIME = 0.05
"""Without a change of the reading, until a gauge counts as a fault [s]
(test/mechanics/test_fault_table.py)."""
STALE_GAUGE_TIME = 0.05
"""Without a reading, until a gauge counts as a fault [s] (test/mechanics/test_fault_table.py)."""
FADE_TIME = 0.1
"""In which a gauge's share fades in or out [s]; source: none known."""
RECOVERY_TIME = 0.5
"""For which a gauge must have been well before its share comes back [s]; source: none known."""

# -- Test of the damper's sign (test/control/test_sign_test.py)

SIGN_STEP = math.radians(3.0)
"""Step that the test asks for [rad]."""
SIGN_SHARES = (0.25, 0.5, 1.0)
"""Parts of the damper's gain; the next one where the last was unclear."""
SIGN_DECAY = 0.9
"""With the right sign the decay lasts at most this part of the time without the damper."""
SIGN_HIGH_PASS = 0.7
"""Slow motion of the joint does not count as ringing [Hz]: well below the first mode at 1.6 Hz."""

# -- Encoders that cannot be believed (test/control/test_encoder_watch.py, bench/soak.py)

FROZEN_TIME = 0.015
"""A reading that stands still is frozen where the joint should have gone on for so long at its
speed limit [s]: 1.8 deg at 120 deg/s."""
FROZEN_SAMPLES = 3
"""Readings that must be the same: slow joints give the same count twice."""
JUMP_SPEED = 3.0
"""A reading may change by so many times the speed limit..."""
JUMP_TIME = 0.02
"""... and in addition by what the speed limit makes of this time [s]."""
RANGE_TIME = 0.2
"""Farther beyond a position limit than the speed limit goes in this time is no pose [s]."""

# -- A damper that excites (test/control/test_loop_gains.py, bench/motion_sequences.py)

RINGING_WINDOW = 0.4
"""Time over which the size of an oscillation is taken: most of a period at 2 Hz [s]."""
RINGING_SETTLING = 0.6
"""Time after the reference came to rest that is not judged [s]."""
RINGING_LOUD = 0.04
"""Part of the speed limit below which an oscillation is of no concern: 4.5 deg/s at 120 deg/s."""
RINGING_LASTS = 4
"""Windows in a row without decay."""
RINGING_DECAY = 0.85
"""An oscillation decays if it is smaller than this part of itself two windows before."""
RINGING_GROWTH = 1.3
"""An oscillation that is so much larger than a window before, twice in a row, grows."""
WILD_COMMAND = 0.5
"""Part of the speed limit that nothing but an oscillation adds to a reference for long."""
WILD_SHARE = 0.3
"""Part of a window in which commands are cut, or wild, that no damping needs."""
WILD_WINDOWS = 2
"""Such windows in a row."""

# -- Taking over an arm that somebody else has moved (test/control/test_takeover.py)

TAKEOVER_TIME = 0.1
"""Time for which an arm is observed first, in addition to the delay of the loop [s]: drives
without commands brake after as long."""
TAKEOVER_BRAKING = 0.1
"""Part of the planned acceleration from which on an arm brakes."""

# -- Following of a reference (test/control/test_following.py, docs/operation.md)

NEAR_TIME = 0.07
"""A reference is near the arm within what the planned speed goes in this time [s]: 4.9 deg."""
FOLLOWING_TIME = 0.3
"""Following error at which the arm stops, as such a time [s]: 21 deg."""
RESTING_SPEED = 0.05
"""Part of the planned speed below which a reference rests."""
WATCH_PERIOD = 0.01
"""Period at which `MotionController.watch` wants to be called [s]."""
ASLEEP_TIME = 0.1
"""Without a command for so long beyond the timeout, drives have stopped by themselves [s]."""

# -- Measured delay of the loop (test/control/test_loop_gains.py)

DELAY_LONGEST = 0.25
"""Longest delay that is looked for [s]."""
DELAY_STEP = 0.002
"""Between two delays that are tried [s]."""
DELAY_MEMORY = 2.0
"""Time of motion after which an error counts 1/e [s]."""
DELAY_MOTION = 0.2
"""Time of motion needed before a delay is estimated [s]."""
DELAY_CLEAR = 0.35
"""At the best delay, commands leave at most this part of the motion's energy unexplained."""
DELAY_MOVING = 0.02
"""Part of the speed limit above which a joint moves."""

# -- What the delay leaves of gains (bench/damper_delay.py)

DELAY_SLOPE = 1.5
"""Power with which the damper's share falls with the delay."""
DELAY_FADES, DELAY_GONE = 4.0, 5.0
"""Multiples of the full delay between which the rest fades to none."""
DELAY_PHASE = 0.25
"""Position gain times delay: 14 deg of phase at the corner of the position loop."""
SHARE_RAMP_TIME = 0.5
"""In which the damper's share comes up or goes away [s]; source: none known."""
UNKNOWN_DELAY = 0.03
"""Delay of the loop that is assumed until it was measured [s]; source: none known."""
CAREFUL_DELAY = 0.1
"""The same where the way to a limit is judged [s]; source: none known."""
PERIOD_QUICK = 10.0
"""A shorter period is learned so many times sooner than a longer one (test_following.py)."""

# -- Gains that follow a schedule (test/mechanics/test_adaptive_damping.py)

SCHEDULE_BLEND_TIME = 1.0
"""In which scheduled gains take the place of fixed ones, or the other way round [s]."""
PAYLOAD_TIME = 0.3
"""Time constant with which the payload in use follows the one that was reported [s]."""
MEAN_HURRY = 0.5
"""The mean's corner is so much higher while the payload in use changes by much [Hz]."""
PAYLOAD_MUCH = 0.1
"""Part of the schedule's range of payloads."""
PAYLOAD_MARGIN, PAYLOAD_MARGIN_MASS = 0.1, 0.02
"""A payload may be so far beyond the grid: a part of its range, and a mass [kg]."""
ACCELERATION_TIME = 0.02
"""Time constant of the reference's acceleration [s]."""

# -- References (test/control/test_reference_source.py, test/control/test_reaction.py)

RETREAT_RAMP = 0.15
"""Time in which a retreat comes to speed [s]."""
TARGETS_SECONDS = 600.0
"""Length of random targets before they begin again [s]."""
LARGEST_PERIOD = 0.1
"""A pause is not made up for beyond this [s]."""
LOST_TIME = 0.5
"""A resting reference that the arm is not near for so long begins again at the arm [s]."""

# -- Force at the tip (docs/force_control.md, test/control/test_force_controller.py)

FORCE_FOLLOWED = 0.5
"""Time over which readings without contact are followed [s]."""
FORCE_BACK = 0.3
"""So long before contact is detected it may have begun [s]."""
FORCE_STUCK = 0.3
"""A reading that does not change for so long is that of a dead gauge [s]."""
FORCE_APART = 8.0
"""Standard deviations, of noise and of force, that gauges may differ by from one force."""
FORCE_SHARE = 0.6
"""Part of its share of the force that a gauge may be off by."""
FORCE_SMOOTH = 0.02
"""Time constant of the force that is fed back [s]."""
FORCE_SOFT = 0.15
"""Part of the wanted force below which contact counts as lost."""
