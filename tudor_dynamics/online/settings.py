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
Tuned numbers of detection and contact, with unit, meaning and where each was settled.

``bench/sweep.py online`` shows what each of them changes. Of a number that names no bench, paper
or measurement none is left.
"""

import math

# Live streams.

CLOCK_JUMP = 1.0
"""A stamp that is older by more is a clock that was set back, not a late message [s]."""
PERIOD_INTERVALS = 5  # intervals that are needed before a period is estimated
PERIOD_RENEWAL = 16
"""Intervals between two estimates of the period, each of which takes a microsecond:
bench/monitor_cost.py."""
LOST_STEP = 1.6
"""Longer steps may hide a sample that was lost [periods]; test_live_filter.py has late ones."""
EARLY_STEP = 0.9
"""Shorter steps make up for a sample that was late before them [periods]; the same."""
PAIRING_QUEUE = 400
"""Samples that may wait for their partner; docs/reference/nodes.md: up to 400 apart they meet."""
STRAIN_QUEUE = 16
"""Readings of strain that wait for their motion: those of one instant come in any order."""
STRAIN_APART = 3.0  # readings farther apart are not interpolated [steps of the motion]

# Momentum observer.

OBSERVER_GAIN = 30.0
"""Bandwidth by default [1/s]; the observer is that of the paper Haddadin et al., IEEE T-RO 33(6),
2017."""
MOMENTUM_STEP = 1e-5
"""Change of position for the central difference along the speed [rad or m];
test_momentum_observer.py."""
MOMENTUM_LAGS = 5.0  # lags of the observer until its beginning is forgotten: exp(-5) is below 1 %

# Columns of a threshold.

REVERSAL_SPEED = 0.02  # slower is no direction of motion [rad/s or m/s]
REVERSAL_WINDOW = 0.15
"""Time for which a reversal counts: friction and play do not settle at once [s]; false alarms
measured by bench/false_alarms.py."""
ACCELERATION_MEMORY = 0.5
"""Time constant with which an acceleration is forgotten: links ring on after it [s]; false alarms
measured by bench/false_alarms.py."""
STANDING = 2.0 * REVERSAL_SPEED
"""Slower joints may stick; friction has its sign from there on [rad/s or m/s]."""

# Onset statistic.

STEP = 0.01
"""Step of the autoregression; longer where samples come more slowly [s]; latencies are measured by
bench/detection_over_topics.py."""
LAGS = 10  # steps of the past that predict the next; bench/detection_over_topics.py
WINDOW = 10  # steps over which errors are summed: 100 ms; bench/detection_over_topics.py

# Accumulated onset: a cumulative sum.

DRIFT = 1.0
"""Ratio to the onset's profile that adds nothing: four fifths of free motion stay below. The sum
is that of the paper Page, Biometrika 41, 1954; bench/soft_hits.py."""
LONGEST_STEP = 0.1  # a sample counts for no longer than this, however late the next one comes [s]
FRICTION_UNCERTAIN = 0.5
"""Share of the friction that may hold a joint by which it may be larger for a while;
bench/soft_hits.py, bench/false_alarms.py."""
SUM_BOUND = 1.1
"""Upper bound of a sum, in thresholds: it must fall back when the force has gone;
bench/soft_hits.py."""
HOLDING_TIME = 0.5
"""Time constant with which a residual that stays is taken for friction that holds [s];
bench/soft_hits.py, bench/false_alarms.py."""

# Thresholds from free motion.

ALARM_SHARES = (50.0, 50.0, 1.0)
"""Shares of a false-alarm rate: residual, onset, accumulated onset, which detects soft hits that
the others detect late; bench/soft_hits.py."""
BLOCK = 1.0
"""Time of which the largest ratio counts: longer than the ringing's memory of one event [s];
false alarms measured by bench/false_alarms.py."""
GROUP = 0.08  # time of which the largest value counts for the profile [s]
PROFILE_QUANTILE = 0.8  # share of the groups that stay below the profile
PROFILE_ROWS = 1500  # rows of a quantile regression; more make it slow and hardly better
PROFILE_FLOOR = 0.1
"""Least size at rest, in medians: without it standstill would make any noise a collision."""
LEAST_BLOCKS = 8  # least free motion to estimate a tail [s]; docs/explanation/thresholds.md
LEAST_SHOWN = 10
"""Groups that friction does not cover, below which a part of the motion has no profile of its own:
the two largest of ten lie above `PROFILE_QUANTILE`."""
LARGEST_SHAPE = 0.5
"""Tails that end more abruptly are an artefact of few peaks; false alarms measured by
bench/false_alarms.py."""
TAIL_SHARE = 0.2
"""Share of the peaks whose excess makes up the tail, where there are enough; false alarms measured
by bench/false_alarms.py."""
TAIL_PEAKS = 20  # peaks that make up a tail at least, where there are no more; the same bench
LARGEST_TAIL_SHARE = 0.5  # more of the peaks are no tail
SHAPE_ERROR = 2.0 / math.sqrt(3.0)
"""Standard error of an exponential tail's shape by L-moments, times the root of the number of
peaks: the paper Hosking and Wallis, Technometrics 29(3), 1987."""
SHAPE_ERRORS = 2.0
"""Standard errors of the shape by which a bound is doubted: 3 to 24 false alarms became 0 to 2 in
40 minutes, measured by bench/false_alarms.py."""
LEAST_SCALES = (0.1, 0.1, 0.02)
"""Least scales: of residual and onset as ratios to their profiles, of the sum of onsets [s]."""
MOST_MOTIONS = 5  # groups of motions that are left out in turn; more take as many times as long
CALIBRATION_SAMPLES = 2_000_000  # upper bound of what a calibration keeps: half an hour at 1 kHz
CALIBRATION_STRIDE = 100  # samples of which one is taken for the friction of a joint

# Widening of thresholds.

LEVEL_QUANTILE = 0.8
"""Share of the samples that stay below the level that is followed; events in free motion are
measured by bench/detection_over_topics.py."""
LEVEL_SPEED = 0.5
"""How fast the level follows, in its logarithm [1/s]: 0.4 a second upwards; the same bench."""
WIDEST = 4.0
"""Thresholds are not widened more than so many times: the detector would detect nothing."""
USUAL_SHARE = 0.9
"""Share of the time in free motion for which the level was lower than what counts as usual;
bench/detection_over_topics.py."""
WIDENING_WARNING = 1.5  # widening that the user should know of
OUTLIER = 6.0  # ratios that are so many times the level are collisions, and do not move it
LOWEST_LEVEL = 0.5
"""The level does not fall further below that of free motion: an arm at rest would forget it."""

# Events.

HIGHEST_RAISE = 10.0
"""Upper bound of a raised threshold: a model that loses the arm for a moment has residuals without
bound, and would make the detector blind for as long as that takes to fade; bench/soak.py."""
RINGING_SHARE = 0.15
"""Part of an excess that comes back after it and is no contact: the arm rings, teeth meet; how
long flags stand is measured by bench/detection_over_topics.py."""
RINGING_FADE = 1.0  # time constant with which it is forgotten [s]; the same bench

# Coverage: which samples are judged. What is a warning is said in docs/reference/nodes.md.

SENSOR_SPEED = 0.05  # a joint that is faster moves: its sensors have to change [rad/s or m/s]
STUCK_TIME = 1.0  # time without any change after which a sensor counts as stuck, by default [s]
COVERAGE_TIME = 1.0  # time of which shares are reported [s]
COVERAGE_PERIOD = 0.1
"""Time between two looks at the counts [s]; their cost: bench/monitor_cost.py."""
UNJUDGED_WARNING, UNJUDGED_ERROR = 0.01, 0.2
"""Shares not judged: a warning and an error; docs/reference/nodes.md."""
STAMPS_APART = 0.02
"""Stamps of two topics that are further apart than this, and than `PERIODS_APART`, are reported
[s]; docs/reference/nodes.md."""
PERIODS_APART = 2.5  # the same in periods of either topic; the same

# Contacts. The study is papers/contact.py; docs/explanation/contact.md has its figures.

CONTACT_STEP = 0.0039
"""Samples that follow sooner are passed over [s]; docs/explanation/contact.md."""
PUSH_DEVIATION = 10.0
"""Standard deviation of a force before anything is known [N]; docs/explanation/contact.md."""
FORCE_MEMORY, HELD_FORCE_MEMORY = 0.7, 2.0
"""Times over which a force is forgotten while an elastic model moves, and otherwise [s]; errors of
force and place measured by papers/contact.py."""
MOVING_DEVIATIONS = 11.0
"""Deviations of a sample for which the residual of a moving arm counts: it is no white noise but
rings, and taken for white it lets the span with most freedom win. So it begins, until more is
learned. The residual of rigid models is that with the ringing in it. Right links and places
measured by papers/contact.py."""
RINGING_SAMPLES, RINGING_MEMORY = 8.0, 10.0
"""The residual of free motion rings in all gauges at once: its covariance counts this many times,
as samples of 0.01 s are not independent, and is learned over this time [s]: places are closer by a
quarter, measured by papers/contact.py."""
RINGING_FLOOR = 0.15  # part of the deviation of a sample that no direction falls below
EVIDENCE_MEMORY = 0.6
"""Time over which it is forgotten which span was the likely one [s]; papers/contact.py."""
FREE_EVIDENCE_MEMORY = 0.03  # the same while no contact is detected [s]
RIGID_DETECTED, RIGID_ENDED, RIGID_OFFSET = 49.0, 16.0, 9.0
"""With a rigid model: squared standard deviations from which, and until which, a contact is
detected, and below which a residual is taken for an offset; docs/explanation/contact.md: 7 and
4."""
ELASTIC_DETECTED, ELASTIC_ENDED, ELASTIC_OFFSET = 8.0, 3.0, 4.0
"""The same with an elastic model, whose deviations are widened for what rings: 2.8 and 1.7, by the
share of pushes detected while they last, measured by papers/contact.py."""
INNOVATION_BOUND = 1.5
"""Standard deviations up to which an innovation counts by its square (Huber)."""
LARGEST_FORCE = 1e3
"""More is no contact, but a followed arm that readings have driven beyond all reason [N]."""
STANDING_SPEED = 0.03  # speed below which an arm stands [rad/s or m/s]
STANDING_DEVIATION = 0.2  # part of the usual deviation that a standing arm keeps at least
STANDING_VARIANCE = 0.1  # part of the usual variance below which an arm is known to stand
STANDING_MEMORY = 0.5  # time over which the noise of a standing arm is learned [s]
OFFSET_MEMORY = 3.0
"""Time over which a standing arm takes a residual for an offset [s];
docs/explanation/contact.md."""
PLACE_CERTAIN = 0.5
"""Part of a place's prior deviation; one that is less certain is not reported: of pushes in motion
a fifth, measured by papers/contact.py."""
OTHER_SHARE = 0.1  # probability from which another place that explains a contact is reported
TOUCH_SHARE = 0.05
"""Part of its largest force below which a touch has not begun, or has ended: half and 0.2 leave
twice the error of the mean force, measured by papers/contact.py."""
PEAK_TIME = 0.15  # time over which the peak of a force is averaged [s]: bench/other_plant.py
TORQUE_DETECTED, TORQUE_ENDED = 5.0, 3.0
"""Standard deviations of free motion from which, and until which, a joint detects a contact by
efforts alone; docs/explanation/contact.md: 5."""

# The elastic arm that contacts are estimated with.

DEVIATION_STEP = 0.01  # sample time that deviations of single samples belong to [s]
SLOWEST_STATIC = 40.0
"""Vibrations above follow a force at once [Hz], so that no sample rate is too low for them;
docs/explanation/contact.md."""
FOLLOWING_RATE = 3.0
"""Rate at which the followed arm is drawn to the real one [1/s]: 8 takes part of a contact for
vibration, 1 does not follow through play, 2 to 4 are the same, measured by papers/contact.py."""
VIBRATION_RATE = 2.0  # rate at which a vibration that nobody explains is forgotten [1/s]

# Readings of a resting arm.

SPAN_LENGTH = 1e-3  # ends of a span are at least so far apart, also where the place is known [m]
POSE_CHANGE = 1e-3
"""Change of a joint below which readings of the weight are those of before [rad or m];
docs/explanation/force_control.md."""
FORCE_CHANGE = 0.5
"""Change of the force, and least one, for which levers are computed again [N]; the same."""

# Feed-forward by an elastic arm.

NEWTON_STEPS = 40  # most steps to a bent arm; test_bending.py has one that is too weak
NEWTON_SETTLED = 1e-6
"""Change of a coordinate at which an arm has settled: a micrometre at its end [rad or m]."""
LEAST_LEVER = 1e-6
"""Part of the largest squared lever below which a joint cannot move the ends, and stays."""
HELD_WITHIN = 0.01  # how far a joint that is held may be from there [rad or m]

# Black box.

RING_TIME = 30.0
"""Messages are kept for so long [s]: filters forget their beginning."""
MEMORY_EVERY, MEMORY_OLDEST, MEMORY_APART = 5.0, 25.0, 10.0
"""Memories of thresholds, loads and models: how often they are kept, how old they may be so that
filters settle before them, and how much later the second of an event is [s]; that replays are then
equal is tested by test/online/test_memory.py."""
RING_BYTES = 64 << 20
"""Messages that are kept at most [bytes]: 30 s of 1 kHz on four topics are 20 MB."""
BAGS = 20  # bags of events in a folder, after which the oldest goes
RECORD_TIME, RECORD_ROWS = 1.0, 50  # time of the channel in an event's record [s], rows of it
RECORD_SAMPLES = 1000  # samples of each method that are kept for it: a second of 1 kHz
RECORDED_AFTER = 3.0
"""A bag goes on for so long after the event [s]: a touch has ended then, a load has not."""
