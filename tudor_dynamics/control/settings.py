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

Kernels use some of them: `tudor_dynamics.compiled` has this file in its checksum. What a bench or
a test measures was measured on the reference arm of `config/tudor.yaml`; where a value was chosen
first and a bench only shows that it does, the comment says "held by".
"""

import math

# -- Motion envelope

# Part of the speed limit that is commanded: the rest is for what drive and load make of it
# (extremes over many seeds: bench/recorded_limits.py).
COMMANDED_SPEED = 0.93
# A position limit is kept off by what the speed limit goes in this time, for readings that are
# rounded and joints that stick and slip [s]: 0.24 deg at 120 deg/s (bench/recorded_limits.py).
POSITION_MARGIN = 0.002
# Part of the acceleration limit with which the arm stops before a position limit: the rest is for
# what drive and load make of a command; held by bench/motion_sequences.py.
BRAKING_SHARE = 0.6
# Time of the approach over the lag: a place that is approached by v = way / T through a lag is not
# overshot from T = e lag on (second-order system, critical damping).
APPROACH_TIME = math.e

# -- Cascade

# Corner of the integrator over the bandwidth: costs atan(0.2) = 11 deg of phase there.
INTEGRAL_SHARE = 0.2

# -- Damper (docs/explanation/damping.md)

# Part of the planned speed at which a reference counts as moving in full.
MOVING_REFERENCE = 0.1
# Fastest plausible change of strain [1/s]: 2000 um/m at 16 Hz.
PLAUSIBLE_RATE = 0.2
# Largest plausible strain: beyond the yield point of spring steel.
PLAUSIBLE_STRAIN = 5e-3
# Without a change of the reading, until a gauge counts as a fault [s]; how far a joint moves until
# then is measured in test/control/test_damper.py and test/mechanics/test_fault_table.py.
DEAD_GAUGE_TIME = 0.05
# Without a reading, until a gauge counts as a fault [s]; measured as DEAD_GAUGE_TIME.
STALE_GAUGE_TIME = 0.05
# In which a gauge's share fades in or out [s]; measured with DEAD_GAUGE_TIME: below half a degree
# together.
FADE_TIME = 0.1
# For which a gauge must have been well before its share comes back [s].
RECOVERY_TIME = 0.5

# -- Test of the damper's sign

SHORTEST_DECAY = 2.0  # of a strain that is judged [s]: five periods of TUDOR's links at 2.5 Hz
# Step that the test asks for [rad]: it rings well above the noise, measured in
# test/mechanics/test_closed_loop.py.
SIGN_STEP = math.radians(3.0)
# Parts of the damper's gain; the next one where the last was unclear.
SIGN_SHARES = (0.25, 0.5, 1.0)
# With the right sign the decay lasts at most this part of the time without the damper.
SIGN_DECAY = 0.9
# A response whose last half second is so many times larger than its first one grows.
SIGN_GROWTH = 1.5
# Slow motion of the joint does not count as ringing [Hz]: well below the first mode, measured as
# 1.7 to 3.3 Hz (bench/damping_study.py).
SIGN_HIGH_PASS = 0.7

# -- Motion that is not as commanded (found and never falsely: bench/lying.py,
#    bench/false_faults.py)

# A reading that stands still is frozen where the joint should have gone on for so long at its
# speed limit [s]: 1.8 deg at 120 deg/s; held by bench/lying.py.
FROZEN_TIME = 0.015
# Readings that must be the same: slow joints give the same count twice.
FROZEN_SAMPLES = 3.0
# A reading may change by so many times the speed limit, and in addition by what the speed limit
# makes of this time [s]; more has jumped.
JUMP_SPEED, JUMP_TIME = 3.0, 0.02
# Less has jumped where one sample has more than this part of what nobody commanded.
JUMP_SHARE = 0.8
# Farther beyond a position limit than the speed limit goes in this time is no pose [s].
RANGE_TIME = 0.2
# Excess that is no fault at rest, as what the speed limit makes of this time [s]: 0.84 deg at
# 120 deg/s. Where 400 g swing undamped, free motion has 0.8 to 1.1 times what is allowed in all
# (parts 5, 9 and 11 of bench/false_faults.py): false faults are rare there, but not gone.
EXCESS_TIME = 0.007
# The same in motion, in addition, as what the commanded speed makes of this time [s].
EXCESS_LATE = 0.01
# Part of both that is a fault already where so many times as much again leads beyond a limit: it
# keeps the 1 deg that a limit may be passed by (drives that swap or creep, bench/lying.py).
EXCESS_AT_END, EXCESS_GROWS = 0.4, 2.0
# So many times it counts before a limit, for drifts too slow to be found in a fast move: 1.1 deg
# beyond by 1 deg/s (bench/motion_sequences.py --seed 2). By 1.5 drives that negate are found late.
EXCESS_COUNTS = 1.25
# Part of it from which on a joint counts as away from its commands.
EXCESS_SMALL = 0.2
# A joint may be faster than its commands by so much of its speed limit, and of their speed: 5.5
# deg/s is the most of honest arms (bench/false_faults.py), 2800 deg/s^2 what a driver makes of its
# current that takes radians for degrees (bench/lying.py).
AHEAD_SPEED, AHEAD_SHARE = 0.1, 0.1
# One sample suffices, or an effort at its end, above this part of the speed limit, and where the
# joint will be past a limit in this time [s]; elsewhere two samples are early enough
# (bench/lying.py).
CRITICAL_SPEED, CRITICAL_TIME = 0.4, 0.1
# Part of that which is allowed where it will be past a limit in this time [s]: drives that creep
# by 10 deg/s are found in time, those that swap not too soon to be known
# (test/mechanics/test_lying.py).
AHEAD_NEAR, NEAR_BY = 0.6, 0.05
# Part of that which is allowed where its effort is at its end, too, and pushes the way it goes: of
# honest arms the fastest then was 0.6 deg/s slower than its commands (bench/false_faults.py).
AHEAD_PUSHED = 0.125
# One sample says so where it is so far ahead, as what the speed limit makes of this time [s], and
# so many counts more: 0.09 deg at 120 deg/s; counts of 0.25 deg with noise of one are no fault
# (test/control/test_joint_answers.py).
COARSE_TIME, COARSE_COUNTS = 0.00075, 3.0
# Uncertainty of the delay of the loop [s]; shorter ones raise false faults of arms that swing.
LAG_MARGIN = 0.012
# How fast it may rise [s/s]: an encoder that stops looks like a delay that grows by 1 s/s.
LAG_RISE = 0.02
# Drives wander off their commands at so much of the speed limit, and of their speed: slower lies
# cannot be found. 0.24 deg/s at 120 deg/s.
WANDER_SPEED, WANDER_SHARE = 0.002, 0.05
# Part of the largest effort at which a drive may be held up by its load, and for how long after
# it [s].
OVERLOADED, OVERLOAD_LASTS = 0.9, 0.1
# For so long after it [s] a drive may be off its commands by this part of its speed, and each
# joint by what the speed limit makes of the third number [s]: it mends part 11 of
# bench/false_faults.py, but not part 5.
OVERLOAD_AFTER, WANDER_LOADED, EXCESS_JERKED = 1.0, 0.5, 0.006
# Until a joint has answered its commands they are at most this part of its speed limit: 2 deg/s of
# 120, which a driver that takes radians for degrees makes 115 of.
UNCONFIRMED_SPEED = 1.0 / 60.0
# Commands below the first part of the speed limit, that before a joint has answered, and at most
# below the second are ended at once at a fault: held by test_a_drive_creeps_where_a_move_ends and
# 379 sequences of bench/motion_sequences.py --seed 1.
STOPPED_AT_ONCE = (1.01 * UNCONFIRMED_SPEED, 5.0 * 1.01 * UNCONFIRMED_SPEED)
# Joints that have to be tested first go no farther than the speed limit goes in this time [s]:
# 2.4 deg at 120 deg/s, four nudges of joint_test; nor at more of the limit.
UNTESTED_TIME, UNTESTED_SHARE = 0.02, 0.125
# A driver that was silent for longer counts as one that has started again [s]. Machines pause for
# 0.4 s (bench/closed_loop_topics.py); one that is back sooner is known by its publisher.
DRIVER_STARTS = 1.0
# The speed grows with the way that was confirmed as if it were gone in this time [s].
CONFIRMING_TIME = 0.05
# Time in which an arm is braked at a fault, and where it moves as nobody commands it [s]; the
# second is bounded by its largest acceleration.
FAULT_STOP_TIME, ASTRAY_STOP_TIME = 0.3, 0.05
# After positions did not come, commands may not have come either: for so long nothing is judged
# [s], in which drives brake by themselves or take them up again.
FREE_AFTER = 0.3
# For so long standstill is commanded after a fault [s], once at least, and twice in a fast motion,
# as a message may be lost; then nothing is, and drives hold by themselves, also one that creeps.
STOPPING_TIME = 0.015
# Time of readings from which a cause is named [s].
TELLING_TIME = 0.6
# For so long after a fault its cause is named again with what was seen meanwhile [s].
TELLING_AFTER = 0.15
# Not with each sample, since telling takes up to 3 ms (bench/controller_cost.py) [s].
TELLING_EVERY = 0.02
# Delays of the loop that are tried for each explanation.
LAGS_TRIED = 7
# Part of the way below which a joint stands still.
STANDS = 0.07
# Times the commanded way from which on a joint runs away, and up to which it may be as far as it
# is commanded, in the other direction.
RUNAWAY, SAME_SIZE = 4.0, 2.5
# Times as far from which on radians are likelier than another scale: of 57, 41 to 70 are seen.
RADIANS_FROM = 30.0
# Part of the motion that any other explanation of a runaway has to leave less than; and of what is
# off its commands, where effort shows it: swapped drives leave less (bench/lying.py).
RUNS, PUSHES = 0.3, 0.7
# Part of the speed limit above which a drift is less likely than another scale.
FAST_DRIFT = 0.3
# Part of what is allowed that two joints are off their commands, and these differ by, where they
# may be swapped.
SWAPPED = 0.3
# Part of the excess from which on positions contradict the driver's own speeds.
CONTRADICTS = 0.5
# An explanation with a figure that is fitted has to leave so many times less; one that leaves less
# than this part of what counts as small is as good as any.
FREE, ROUGH = 1.5, 0.3

# -- A damper that excites

# Time over which the size of an oscillation is taken [s]: most of a period at the lowest first
# frequencies, measured by bench/damping_study.py.
RINGING_WINDOW = 0.4
# Time after the reference came to rest that is not judged [s]; links settle in 0.5 s, measured by
# bench/damping_study.py.
RINGING_SETTLING = 0.6
# Part of the speed limit below which an oscillation is of no concern: 4.5 deg/s at 120 deg/s.
RINGING_LOUD = 0.04
# Windows in a row without decay.
RINGING_LASTS = 4
# An oscillation decays if it is smaller than this part of itself two windows before.
RINGING_DECAY = 0.85
# An oscillation that is so much larger than a window before, twice in a row, grows.
RINGING_GROWTH = 1.3
# Part of the speed limit that nothing but an oscillation adds to a reference for long; held by
# bench/motion_sequences.py.
WILD_COMMAND = 0.5
# Part of a window in which commands are cut, or wild, that no damping needs; held by
# bench/motion_sequences.py.
WILD_SHARE = 0.3
# Such windows in a row.
WILD_WINDOWS = 2

# -- Taking over an arm that somebody else has moved

# Time for which an arm is observed first, in addition to the delay of the loop [s]: drives without
# commands brake after as long (docs/explanation/safety.md).
TAKEOVER_TIME = 0.1
# Part of the planned acceleration from which on an arm brakes; held by bench/motion_sequences.py.
TAKEOVER_BRAKING = 0.1

# -- Following of a reference (docs/explanation/safety.md)

# A reference is near the arm within what the planned speed goes in this time [s]: 4.9 deg.
NEAR_TIME = 0.07
# Following error at which the arm stops, as such a time [s]: 21 deg; no false stop in
# bench/soak.py.
FOLLOWING_TIME = 0.3
# Part of the planned speed below which a reference rests.
RESTING_SPEED = 0.05
# A reference is not extrapolated for longer than this, whatever the timeout [s]: 9 deg at the
# planned speed of the reference arm; the timeout by default.
LONGEST_EXTRAPOLATED = 0.1
# Without positions for so long standstill is commanded, whatever the timeout [s]; longer than
# machines without real time hold up a process as a rule.
LONGEST_BLIND = 0.25
# A sample so much later than usual counts as none, at the speed limit [s]: 12 deg at 120 deg/s; a
# quarter of the 0.4 s with which an arm went 48 deg past its goal. Slower joints go as far in a
# longer time, up to the second number.
LATE_AT_SPEED, LONGEST_LATE = 0.1, 0.2
# Commands that answer samples which come by fits and starts jerk, and drives follow them worse: by
# this memory, and from this lateness on, twice as much is allowed [s] (bench/busy_machine.py).
LATE_MEMORY, LATE_DOUBLES = 0.5, 0.05
# For which the smallest age of samples is known [s]: clocks drift by 1 ms meanwhile.
AGE_MEMORY = 10.0
# Ages are judged once their least was the same, within this, in two such times [s]: a simulated
# arm may be slower than the clock.
AGE_STEADY, AGE_LEARNED = 0.02, 0.5
# Periods without a sample after which commands slow down.
MISSED_PERIODS = 1.5
# `watch` is called so many periods after each sample: just more than MISSED_PERIODS, so that an
# arm slows down within two at any rate; and the longest time between two calls [s].
WATCHED_PERIODS = 1.6
WATCH_PERIOD = 0.005
# Without a command for so long beyond the timeout, drives have stopped by themselves [s]: their
# own timeout (docs/explanation/safety.md).
ASLEEP_TIME = 0.1

# -- Measured delay of the loop

# Longest delay that is looked for [s]: three times the longest of bench/damper_delay.py.
DELAY_LONGEST = 0.25
# Between two delays that are tried [s]; a parabola goes between them.
DELAY_STEP = 0.002
# Time of motion after which an error counts 1/e [s].
DELAY_MEMORY = 2.0
# Time of motion needed before a delay is estimated [s].
DELAY_MOTION = 0.2
# At the best delay, commands leave at most this part of the motion's energy unexplained.
DELAY_CLEAR = 0.35
# Part of the speed limit above which a joint moves.
DELAY_MOVING = 0.02

# -- What the delay leaves of gains

# Power with which the damper's share falls with the delay: below the border of stability that
# bench/damper_delay.py measures.
DELAY_SLOPE = 1.5
# Multiples of the full delay between which the rest fades to none (bench/damper_delay.py).
DELAY_FADES, DELAY_GONE = 4.0, 5.0
# Position gain times delay: 14 deg of phase at the corner of the position loop; commands decay for
# delays of 0 to 80 ms (bench/damper_delay.py --moves).
DELAY_PHASE = 0.25
# Parts of the damper's gains that the loop stands at most: twice them is 26 deg past a goal with
# 400 g at 100 Hz and 20 ms (test/mechanics/test_lying.py).
LARGEST_SHARE = 1.25
# In which the damper's share comes up or goes away [s].
SHARE_RAMP_TIME = 0.5
# Delay of the loop that is assumed until it was measured [s].
UNKNOWN_DELAY = 0.03
# The same where the way to a limit is judged [s]: the longest for which drives go on without
# commands.
CAREFUL_DELAY = 0.1
# A shorter period is learned so many times sooner than a longer one; the error it leaves with lost
# samples is measured in test/control/test_following.py.
PERIOD_QUICK = 10.0

# -- Gains that follow a schedule (damping and overshoot: test/mechanics/test_adaptive_damping.py)

# In which scheduled gains take the place of fixed ones, or the other way round [s].
SCHEDULE_BLEND_TIME = 1.0
# Time constant with which the payload in use follows the one that was reported [s]; the motion
# that it leaves is measured in test/mechanics/test_adaptive_damping.py.
PAYLOAD_TIME = 0.3
# The mean's corner is so much higher while the payload in use changes by much [Hz]; as
# PAYLOAD_TIME, measured there.
MEAN_HURRY = 0.5
# Part of the schedule's range of payloads that is much.
PAYLOAD_MUCH = 0.1
# A payload may be so far beyond the grid: a part of its range, and a mass [kg].
PAYLOAD_MARGIN, PAYLOAD_MARGIN_MASS = 0.1, 0.02
# Time constant of the reference's acceleration [s].
ACCELERATION_TIME = 0.02

# -- References

# Part of the planned speed at which a joint complies at most.
COMPLY_SPEED = 0.5
# Time in which a retreat comes to speed [s].
RETREAT_RAMP = 0.15
# Length of random targets before others begin [s].
TARGETS_SECONDS = 600.0
# A pause is not made up for beyond this [s]: the timeout of the controller.
LARGEST_PERIOD = 0.1
# A resting reference that the arm is not near for so long begins again at the arm [s].
LOST_TIME = 0.5
# A reset during a collision is believed if it is asked for again within this [s]; long enough to
# read the refusal and to repeat the command.
RESET_AGAIN = 15.0

# -- Force at the tip (docs/explanation/force_control.md; `python -m papers force` has the steps)

# Time over which readings without contact are followed [s].
FORCE_FOLLOWED = 0.5
# So long before contact is detected it may have begun [s]: at 0.02 m/s on 100 N/m, the softest
# floor measured by `python -m papers force`, 0.4 N take 0.2 s.
FORCE_BACK = 0.3
# A reading that does not change for so long is that of a dead gauge [s].
FORCE_STUCK = 0.3
# Standard deviations, of noise and of force, that gauges may differ by from one force.
FORCE_APART = 8.0
# Part of its share of the force that a gauge may be off by.
FORCE_SHARE = 0.6
# Time constant of the force that is fed back [s].
FORCE_SMOOTH = 0.02
# Part of the wanted force below which contact counts as lost.
FORCE_SOFT = 0.15

# -- Test of how joints answer (held by test/control/test_joint_answers.py)

# Nudge there and back [rad, m], with the time of each way, and of standing after it [s]: 1 deg/s,
# below what a joint that has not answered yet is commanded.
NUDGE, NUDGE_SLIDE = math.radians(0.5), 1e-3
NUDGE_TIME, NUDGE_DWELL = 0.5, 0.3
# Standing before it [s]; a nudge that was unclear is repeated twice as large, up to this one.
NUDGE_STANDS, NUDGE_LARGEST = 1.0, 4.0
# Speeds are differences over this time [s]: long for encoders, short for what sticks.
ANSWER_WINDOW = 0.1
# Half widths of what sticks before it slides, over the way of the commands: presliding of the
# reference arm's gears takes 0.23 deg.
STICKING = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4)
# Standard deviations that an answer is away from none, and the least scale that is one: a tenth of
# that of radians for degrees.
ANSWER_ERRORS, LEAST_ANSWER = 4.0, 0.002
# Scales between these are right: friction keeps up to a quarter of half a degree.
SCALE_DOWN, SCALE_UP = 0.75, 1.3
# Standard deviation of a scale from which on it is unclear.
SCALE_ERROR = 0.25
# Scales that have a name, and how near one is called by it, as a logarithm.
KNOWN_SCALES = {180.0 / math.pi: 'degrees confused with radians', 1000.0: 'mm confused with m',
                30.0 / math.pi: 'rpm confused with rad/s, or a wrong decimal place',
                4.0: 'encoder edges confused with lines', 2.0: 'encoder edges confused with lines'}
SCALE_NEAR = 0.75
# Another joint that moves by more than this part moves, too.
MOVES_TOO = 0.2
# Some other joint is judged, too, if it is so much of a nudge off its commands.
STRAYED = 0.5
# Nudges that commands make at most before the test stops, and that positions may be off them:
# below what is a fault of `MotionController`.
ASTRAY, OFF = 2.5, 0.8
# What comes later than this after the test stopped the arm does not count [s].
ASTRAY_AFTER = 0.05
# Own motion that is an error, in nudges per second, and how straight it must be: the part of it
# that a line may leave.
DRIFT, STRAIGHT = 0.15, 0.25
# Part of the nudge that commands must have made to be judged; samples that a verdict needs.
LEAST_WAY, LEAST_SAMPLES = 0.05, 5
# Delay from which on an answer is late: multiples of the full delay, but not below this [s]: a
# loop at 100 Hz has 30 ms, with 20 ms on the way 45.
LATE_SHARE, LATE = 2.5, 0.05
# Joints so far beyond a position limit stand where they cannot [rad or m].
BEYOND = 0.01
# A time without positions, longer than this, is left out [s].
ANSWER_GAP = 0.08
# Part of the motion that an answer may leave unexplained, and of the time that may be gaps.
# Below this, what stood before was no drift.
UNEXPLAINED, EXPLAINED = 0.15, 0.02
