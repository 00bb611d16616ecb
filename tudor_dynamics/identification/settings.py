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
Tuned numbers of identification: what each means, its unit, and where it is from.

``bench/doctor.py`` puts 862 faults into recordings of seven robots. Where it is named as the
source, the number was chosen by it on the two-blade arm, UR10, Airbot and EMPS and proven on
reference arm, UR10e, TX40, Quanser (docs/explanation/doctor.md): 97.9 % of faults named, nothing
is found in 66 recordings without faults.
"""

import numpy as np

# -- What a fit may be used for (uses.py)

# Poses of a bag at which the friction of joints is looked at.
STICTION_POSES = 200
PHYSICS_POSES = 200  # poses at which inertias and weights are looked at
# Share of poses at which an inertia may be negative, where parameters are uncertain.
NEGATIVE_SHARE = 0.02
# Factor between the identified weight and the described one from which on it is marked.
WEIGHT_OFF = 1.5
# Share of the largest weight below which the weight of a joint is not compared.
WEIGHTY = 0.1
# Part of what an output is at rest from which on it changes with the pose: rounding.
WEIGHTLESS = 1e-9
# Rate for which a collision detector is judged [1/h]: that which `bench/false_alarms.py` proves on
# 40 min of free motion.
FALSE_ALARMS = 1.0
# Factor between thresholds of a short recording and those of hours from which on that is said.
WIDE = 1.2
NOTICED = 0.1  # time within which a push is to be noticed [s]
TIP_POSES = 50  # poses of a bag at which forces at the tip are looked at
LEVER = 0.01  # levers below are none: a force at the tip does not move this joint [m]
# Good and usable: force at the tip that is noticed [N], the smallest quasi-static limit of a body
# region of ISO/TS 15066:2016, Table A.2 (face), and that of neck and upper arms.
TIP_FORCE = (65.0, 150.0)
# Good and usable: relative error of a joint's effort, which feed-forward leaves to the controller;
# beyond a half it is not fed.
LEFT_TO_CONTROL = (0.3, 0.5)
# Findings by which units, and so newtons and kilograms, are in doubt.
UNITS = 'effort_unit', 'dh_in_millimetres', 'dh_in_degrees', 'gauge_in_millimetres', 'joint_scale'
# Good and usable: error of a mean over `MEAN` over the range of what weight makes.
WEIGHT_SHARE = (0.05, 0.2)
MEAN = 1.0  # time over which a payload is averaged [s]

# -- What to do next, in points of fit that a step would bring (next_steps.py)

FINDING_GAIN = 100.0  # of a finding of the doctor: first of all
THRESHOLDS_GAIN = 50.0  # of collision thresholds where there are none
UNTESTED_GAIN = 8.0  # of a test by another bag
DOUBT_GAIN = 6.0  # of thresholds that are half as wide
UNEXCITED_GAIN = 5.0  # of motion that shows what no bag has shown
MILD_GAIN = 1.0  # of a finding that costs little
SMALLEST_GAIN = 0.5  # points of fit below which no step is advised
# Factor between the errors at rest and in motion from which on friction that holds is said.
STANDING = 2.0

# -- Whether a model is still what it was (next_steps.py)

# Time whose mean squared error counts as one observation: errors are correlated [s].
CORRELATED = 5.0
# Growth of the error below which nothing is said, however certain it is.
GROWTH = 1.3
# The same for the relative error: livelier motion has larger errors, not larger relative ones.
RELATIVE_GROWTH = 1.15
# Standard errors by which the error must have grown; 200 of 200 motions of the same arm are below
# (measured by test/identification/test_comparison.py).
SIGMAS = 3.0
# Relative standard error of a mean squared error where nothing is known of it.
UNKNOWN_SPREAD = 0.5
LEAST_SPREAD = 0.1  # it is no less: two motions are not alike
# Part of the time without which the error has to be as before, to be no change of the model but
# something short, such as a push.
SHORT = 0.2
# Relative difference up to which the promise of a plan counts as kept: 80 to 100 % of the
# parameters of the reference arm are within (bench/excitation.py, docs/explanation/excitation.md).
PROMISE_KEPT = 0.3

# -- The first description of an arm (drafting)

# Of each bag, evenly spread: gravity needs poses, not samples.
SAMPLES_TO_DRAFT = 400
# Over which positions are smoothed to differentiate them [s].
DERIVATIVE_WINDOW = 0.15
# Speed over which the sign of the friction is smoothed [rad/s or m/s].
SLOW = 0.05
# Another direction of gravity counts where it leaves less than one over this of the efforts'
# variance.
BETTER = 2.0
# No gravity at all counts where a direction explains hardly more.
SIMPLER = 1.05
# Share of the efforts' variance of joints that an upright arm's gravity does not load, from which
# on it follows their position, as a gravity of another direction does.
FOLLOWED = 0.05
# Part of the largest gravity moment from which on a joint carries something.
CARRIES = 0.02
# Share of an effort without friction that gravity explains, to be evidence of its unit.
EXPLAINED = 0.5
# Effort over gravity moment where efforts are torques: masses of a URDF are often rough; 1.02 was
# measured on a UR10 (docs/howto/own_arm.md).
TORQUES = (0.5, 2.0)
# Below `TORQUES` and above this, efforts are currents of drives with a gear [A/(N m)]; those of a
# UR10e are 0.09 to 0.12 by its published constants (bench/first_hour.py).
CURRENTS = 0.005
LARGEST_CURRENT = 100.0  # efforts beyond this are no currents of an arm [A]
# Largest effort over the limit of the URDF, where efforts are what the limit means.
PLAUSIBLE = (0.02, 1.5)
MICROSTRAIN = 5.0  # readings with a larger range are um/m
# Readings with a smaller range are m/m; between the two, units of bridges.
STRAIN = 0.01
# A gauge sits after the outermost joint whose moment leaves at most so many times the least.
OUTERMOST = 1.5
# Variance of a reading that no gravity moment explains: then none of them shows its place.
NOT_FOLLOWED = 0.3

# -- Decimated recordings (doctor/case.py)
CUTOFF = 8.0  # corner of the zero-phase filter of motion and outputs [Hz] (bench/doctor)
LEAST_SECONDS = 3.0  # shorter stretches are not judged [s] (bench/doctor)
LEAST_SAMPLES = 64  # nor stretches of fewer samples
MARGIN = 0.25  # left out at both ends: filter edges, room for lags [s] (bench/doctor)
MOST_SAMPLES = 600  # samples kept of a bag, for the seconds a bag that the bench prints
LEAST_STEP = 0.03  # no two samples kept are nearer [s] (bench/doctor)
SMALLEST = 1e-9  # smaller parts of the largest eigenvalue are no direction (bench/doctor)
PREDICTING = 1e-5  # the same where samples not learned from are predicted (bench/doctor)
FLOOR = 1e-6  # no output counts as better explained than to this share (bench/doctor)
PASSES = 2  # weightings of channels that share parameters (bench/doctor)
LEAST_RESIDUAL = 0.03  # part of a channel's size that its weight is bounded by (bench/doctor)
ENOUGH_SECONDS = 20.0  # shorter recordings have to show more [s] (bench/doctor)
MOVING_SPAN = 0.02  # a joint that goes no farther does not move [rad or m] (bench/doctor)

# -- Descriptions (doctor/examine.py)
LONGEST_ARM = 20.0  # no arm reaches farther [m]; source: length of the largest industrial arms
TURN = 2.0 * np.pi + 0.05  # no angle of a table is larger [rad]

# -- Loads that a model does not know (doctor/examine.py)
LOAD_GAIN = 1.0  # sum of log ratios by which a load reduces the residual (bench/doctor)
LOAD_SHARE = 0.5  # upper bound of the part of the error that remains with it (bench/doctor)
LOAD_ERROR = 0.1  # relative error without friction of a model as it was (bench/doctor)

# -- Gauges that a model knows otherwise (doctor/examine.py). Between recordings of two blades
# gains differ by up to 0.5 %, zeros by 1 % of the deviation of a gauge (bench/changed_gauges.py)
GAUGE_GAIN, GAUGE_ZERO = 0.02, 0.1  # least change of a gain, of a zero by the standard deviation
GAUGE_SURE = 5.0  # standard deviations that a change has to be
GAUGE_PARTS = 8  # parts that are left out in turn for the standard deviation
# Part of its change that the other gauges may show: a load at the tip of the two-blade arm changes
# the inner link's gauge by 0.46 of what it does to the outer's
GAUGE_ALONE = 0.25

# -- Alternatives of a description (doctor/alternatives.py)
LEAST_GAIN = 0.5  # sum of log ratios of the residuals from which on one is tried (bench/doctor)
REFINED_GAIN = 0.5  # the same for gravity that is turned away from an axis (bench/doctor)
FIRST_TURN = 0.35  # first step of that search [rad] (bench/doctor)
LAST_TURN = 0.04  # its last step [rad] (bench/doctor)
DRIVING = -0.5  # correlation of friction and speed below which friction drives (bench/doctor)
AGAINST = 0.5  # what a correlation of strain and effort may be above -1 to be of opposite signs
DRIVING_SHARE = 0.1  # by which the residual grows without such friction (bench/doctor)
# Factors between units of efforts that are tried: those of gears with motors, and thousandths.
SCALES = tuple(10.0 ** (sign * exponent) for sign in (1.0, -1.0)
               for exponent in (0.5, 0.75, 1.0, 1.25, 1.5, 2.75, 3.0, 3.25))
NEARLY = 2.0  # a scale within this factor of a thousand(th) is taken for it (bench/doctor)
PACES = (0.5, 2.0)  # of stamps that are counted
# Waves of a position's error in a turn, none for what creeps; sizes that errors may have [rad],
# which turn no reading backwards; passes that find the right angle; steps of slopes [rad].
TURNS = (0.0, *np.arange(2.0, 16.1, 0.5).tolist())
BENDS = {'position_drift': (0.03, 0.5), 'position_ripple': (0.02, 0.15)}
BACKWARDS, STRAIGHTENED, BEND_STEP = 0.8, 8, 1e-4
BEND_GAIN = 0.35  # least gain; good recordings of Airbot, UR10e with load and two-blade arm: 0.2
LAGS = np.arange(-0.06, 0.1501, 0.01)  # lags that are tried [s]
CLOCKS = np.arange(-2.0, 2.01, 0.05)  # the same of clocks that are apart [s]
LAG_FAR = 0.3  # relative residual from which on they may be: half of what 0.1 s leave at 1 Hz
# Smaller lags are the filters of drivers, which every arm has [s] (bench/doctor).
USUAL_LAG = {'effort': 0.015, 'strain': 0.015, 'velocity': 0.03}
# Sum of log ratios by which a lag has to reduce the residual (bench/doctor).
LAG_GAIN = {'effort': 0.1, 'strain': 0.1, 'velocity': 0.5}
LAG_SHARE = 0.6  # relative residual with a lag above which something else is wrong (bench/doctor)
STILL = 0.05  # part of the largest speed below which a joint shows no lag

# -- Remedies that are tried on parts left out (doctor/trials.py). Chosen on the two-blade arm,
#    UR10, Airbot and EMPS, those of ringing with a look at the Panda's beams: no proof there.
# Least win, of a structure and of a lag: squared errors without less those with the remedy, over
# their sum; 0.1 are errors smaller by a tenth.
PAYING = 0.1
PAYING_LAG = 0.05
RINGING_SHARE = 0.6  # part of a residual's power near one frequency that makes it ringing
# Part of that frequency below which remedies of an arm that rings are tried, and part of the power
# of the joints' speeds that may be above it: else it is the motion.
BELOW_RINGING, RINGING_MOVED = 0.5, 0.1
RINGING_SECONDS = 8.0  # windows in which it is looked for: an eighth of a hertz [s]
PAYING_ERRORS = 2.5  # standard errors between parts that it has to win by
PREDICTED = 0.5  # error with the remedy from which on nothing is predicted
LIKELIEST = 3  # alternatives of several bags that are tried

# -- Trends of a channel (doctor/residuals.py)
DRIFT_GAIN = 0.6  # log ratio by which a line in time reduces the residual (bench/doctor)
DRIFT_SIZE = 0.15  # least drift, in standard deviations of the channel (bench/doctor)
WINDOWS = 20  # windows of a recording in which a channel may have died (bench/doctor)
SHORTEST = 8.0  # shorter recordings do not show that a channel dies [s] (bench/doctor)
QUIET = 0.3  # part of what it did, and is expected to do, that a dead channel does (bench/doctor)
EXPECTED = 0.3  # part of what it did that has to be expected, to be missed (bench/doctor)
ALIVE = 0.5  # upper bound of the relative residual of a channel that lives (bench/doctor)
DEAD_GAIN = 1.0  # log ratio by which a dead end reduces the residual (bench/doctor)
FOLLOWS = 0.7  # slope of measured over expected output while a channel lives (bench/doctor)

# -- Units of efforts by their size (doctor/samples.py)
# No joint of an arm has more; source: data sheets of the largest industrial arms.
LARGEST_EFFORT = {'A': 150.0, 'N m': 3000.0, 'N': 20000.0}
# Strain that no link survives: spring steel yields below 1 %, foil gauges tear at 3 to 5 %.
LARGEST_STRAIN = 0.02
BEYOND_LIMIT = 10.0  # as many times the effort limit of the URDF is another unit (bench/doctor)
UNLIMITED = 1e6  # limits of a URDF from here on are none [N m or N]
FEW_TIMES = 3.3  # masses of a URDF are wrong by less (bench/doctor)
THOUSANDTH = 30.0  # factors beyond are those between a unit and its thousandth (bench/doctor)

# -- Values of single channels (doctor/samples.py)
FAR = 20.0  # an outlier is as many times farther off than 99.5 % of the samples (bench/doctor)
LEAST_FAR = 2e-3  # ... positions by more than this [rad or m] (bench/doctor)
FAR_RANGE = 0.3  # ... and by this part of the channel's range or more (bench/doctor)
# The same of steps that are taken back by the next: chosen on two-blade arm, UR10, Airbot and EMPS
# (up to 2.4 times); FER, UR10e and TX40, also clean, are the proof.
FAR_BACK, FAR_BACK_RANGE = 6.0, 0.45
SINGLE = 3  # more samples in a row are no outliers (bench/doctor)
RETURNED = 0.3  # part of the jump that may remain after an outlier (bench/doctor)
HELD_SECONDS = 0.4  # a value that is kept for longer in motion is held [s] (bench/doctor)
HELD_RUN = 4  # ... and as many times longer than any other value (bench/doctor)
HELD_MOVING = 0.7  # part of that time in which the arm moves (bench/doctor)
LIVELY = 10  # as many times its longest other run of one value is a hold by itself (bench/doctor)
VISITS = 6  # three other runs of a sixth of the longest are visits to a bound (bench/doctor)
FLAT = 4  # samples in a row at the end of the range that make a saturation (bench/doctor)
FLAT_RUN = 3.0  # ... as many times longer than 99 % of those elsewhere (bench/doctor)
FLAT_SHARE = 0.004  # ... and the share of all samples there (bench/doctor)
JOINT_SCALES = (0.5, 0.8, 1.25, 2.0)  # single for fourfold edges, gears of the next size
RESCALED = 0.95  # part of an error that another scale may leave: what bends wins 2 % by one
# (doctor/residuals.py; chosen with bench/lab_faults)
SIGNS, SIGN_PASSES = 3, 10  # first guesses of a lost sign by what bodies do; passes each
SIGNED = 0.5  # part of the residual's power that remains with the sign guessed (simulated arms)
STEP_SECONDS, STEP_WITHIN = 6.0, (0.3, 0.7)  # of recordings, in which a gain or zero may change
STEPS = 11  # times that are tried there; what changes at the ends is friction (bench/lab_faults)
SAME_TIME = 0.25  # part of the time by which changes of one load may be apart
STEPPED = (0.25, 0.42)  # residual's power after over before it: short, long recordings
STEP_LONG = 40.0  # longer recordings show more [s]
STEP_SHARE = 1e-3  # part of the variance that it explains
WAVE, WAVE_ABOVE = 0.5, 0.5  # part of a residual's power in a wave, above [Hz]
# Seconds and periods that it lasts at least; parts in which it is the same, within a half.
WAVE_SECONDS, WAVE_CYCLES, WAVE_PARTS, WAVE_EVEN = 16.0, 10, 4, 0.5
# Steps of a spectrum between samples, and its length in records: peaks 3 % low, as sinc^2(1/10).
WAVE_FINE, WAVE_LONGER = 4, 5
UNEXPLAINED = 0.6  # relative residual beyond which nothing is explained: a fit below 40 %
# (doctor/readings.py; chosen with bench/lab_faults)
COPIED, COPIED_EXACTLY = 0.05, 1e-3  # part of an effort, of a gauge, in which copies differ
STRAIGHT, LINE = 1e-6, 6  # part of the largest slope by which lines bend; samples of a line
EVEN_STAMPS = 0.5  # part by which the distance of stamps may differ where jumps are looked for
JUMPED, LEAST_JUMP = 6.0, 2e-3  # times what 99.5 % differ from the motion around; [rad or m]
WRAPPED = 0.05  # part by which a jump differs from a turn
HELD_BEFORE = 0.1  # a run before a jump that is a hold [s]
NOISY = 2e-3  # ten times the noise of bad encoders [rad or m]
STALE, STALE_WINDOW = 0.4, 0.1  # part of the samples in fast motion; [s]
STALE_LEAST = 2e-3  # fast motion is more in that time [rad or m]
FAR_FROM_ZERO, ALTERNATING = 0.2, 0.05  # of the spread of a channel; part of the samples
WHITE, WHITE_LAGS = 4.0, 8  # deviations of an autocorrelation that is none
LEVELS = 24  # values of a channel of few digits
COARSE = 2e-3  # positions in larger steps are coarse: five times those of Airbot [rad or m]
COARSE_LEVELS = 8  # with fewer values the joint stands
STANDSTILL = 3.0  # ends without motion that are longer are reported [s] (bench/doctor)

# -- Comparisons of bags (doctor/between.py)
COMPARABLE = 0.5  # share of an output that a model of another bag explains (bench/doctor)
OTHER_UNIT = 3.0  # factors beyond are those of units (bench/doctor)
THOUSANDTH_OF_BAGS = 100.0  # factors beyond are those of thousandths (bench/doctor)
LEAST_PAYLOAD = 0.02  # payloads that differ by less count as the same [kg] (bench/doctor)
PAYLOAD_OFF = 0.3  # part of the largest payload that a stated one may be off (bench/doctor)
DIFFERENT = 0.15  # relative error from which on two bags differ in load (bench/doctor)
COMPARED = 400  # samples of a recording that are looked for in another one
SAME_SHARE = 0.9  # part of the samples that a copy has in common with its original (bench/doctor)

# -- What rings on after motion (ringdowns.py); chosen on recordings of a beam held up and down,
# judged on those of the same beam level and on arms that are still (bench/still_tools.py)

# Speed below which a joint stands [rad/s or m/s], and its share of the largest speed.
RING_STILL, RING_SPEED = 0.02, 0.05
# Until when after a stop efforts are looked at, and for how long at least [s].
RING_UNTIL, RING_LEAST = 6.0, 1.0
# Time before the next motion that is left out: it has begun before its speed shows [s].
RING_BEFORE = 0.3
RING_LOWEST, RING_HIGHEST, RING_STEP = 0.7, 15.0, 0.01  # frequencies [Hz]
RING_APART = 0.08  # part by which two frequencies differ at least
RING_CLEAR = 0.5  # least share of the variance that one oscillation explains
RING_LOUD = 4.0  # amplitude over what is left, of the clearest joint
RING_DAMPED = 0.08  # damping ratio from which on it is no tool's
RING_OFTEN = 0.4  # share of rests that show it
RING_RATE = 80.0  # samples a second that are looked at [Hz]

# -- A flexible tool by its rings (tool.py); chosen on translations of a beam and on an arm in
# MuJoCo, judged on transfers of the beam and on tools of another seed (bench/flexible_tool.py,
# bench/still_moves.py)

# What is usual: foot from the last joint, length of its rod [m], damping ratio, delay [s].
TOOL_FOOT, TOOL_LENGTH, TOOL_DAMPING, TOOL_DELAY = 0.2, 0.4, 0.02, 0.03
# How far lengths of tools, frequencies of their planes and damping of these are apart, logarithms:
# grippers to fishing rods; wide beside what ten rests show (bench/still_moves.py).
TOOL_LENGTHS, TOOL_PLANES = 0.7, (0.4, 0.3)
# Error of a ring relative to it, and how many samples of a rest err on their own.
TOOL_RELATIVE, TOOL_FEW = 0.1, 20.0
TOOL_LEARN = 0.008  # step of a motion that a tool is learned from [s]
# Starts of a search: rotations, peaks of the spectrum, logarithms of frequencies over these; how
# many are tried, by so much of each rest [s], and how many then by all of it.
TOOL_WAYS, TOOL_PEAKS, TOOL_OFF = 60, 4, (-0.02, 0.02)
TOOL_TRIED, TOOL_BEGIN, TOOL_BEST = 10, 1.2, 3
TOOL_OTHER = (-0.6, 0.6, 0.01)  # logarithms of frequencies tried of a second plane, over the first
# Cost with a second bending plane, over that with one, that it is worth: true ones had up to 0.93,
# wrong ones 0.99 (still_moves.py, seeds 20 to 25).
TOOL_SECOND = 0.95
TOOL_SURE = 0.05  # least error of a predicted ring, relative to it
TOOL_HEARD = 0.05  # variance of a ring over that of noise from which on it counts
TOOL_LEAST = 3  # rests that a fit needs

# -- Causes of alarms (causes.py); chosen on the simulated arm of config/tudor.yaml, SHARED_TOUCH
# and the order of causes also on recordings of the two-blade arm; judged on an arm with stiffer
# links (bench/causes.py --stiff); SURE by elastic models of both (--elastic)
JUST_BEFORE, LONG_BEFORE = 0.1, 10.0  # times before an onset that are looked at [s]
BEGINS = 1.0  # before an onset what makes it may have begun [s]
OFFSET_SPAN, OFFSET_SUM = 3.0, 0.5  # encoders are judged so long before an event, in sums [s]
OFFSET_LARGEST, OFFSET_STEP, OFFSET_SHARE = 0.5, 0.01, 0.4  # [rad or m]; share of what is seen
JUST_AFTER, LEAP_SAMPLES = 0.5, 10  # after an event [s]; samples on each side of a leap
BRIEF = 0.15  # shorter events come by chance, or after a loss [s]
PLAYED = 0.1  # arrivals whose pace is further from that of stamps are those of a player of bags
CLOCK_STEP = 1.5  # stamps that leap by more while messages come as always [periods]
LOST_BEFORE = 0.5  # time before an event within which losses may be its cause [s]
LEAP, QUIET_CHANNEL = 0.7, 0.5  # part of a change in one sample; other channels in thresholds
STARTED, STOOD_BEFORE = 0.4, 0.3  # a joint has begun to move so lately, and stood so long [s]
FELT, SURE = 0.5, 3.0  # share of an event in which a contact is felt; or its force, in deviations
# A force lasts so long [s]; or the other sensor shows so much, in its threshold.
LEAST_TOUCH, SHARED_TOUCH = 0.06, 0.8
UNLIKE = 0.8  # of a threshold, reached before an event
FASTER = 1.1  # times the largest speed of the training
USUAL = 6.0  # where free motion reaches a ratio more often, its threshold is too low [1/h]
JUST_ABOVE = 1.3  # ratio to a threshold
LATE_LOAD = 4.0  # time after an onset until which a load is found [s]
SAME_ONSET = 0.05  # onsets of one event differ by less [s]
