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
Whatever fails, the arm stays within its limits, and its links are not shaken more than by a move.

Arm, controller and source of references in lock-step on a simulated clock. In each sample:
position, speed and acceleration within ``limits``; strain peak to peak at most 1.25 times that of
the long move without any fault.
"""

from __future__ import annotations

from collections.abc import Callable
import dataclasses
from functools import lru_cache

from hypothesis import HealthCheck, settings
from hypothesis.stateful import run_state_machine_as_test
from lying import Liar, LIES
from motion_machine import broken_limits, FIRST, go, MotionMachine, moving, SECOND, tudor
import numpy as np
import pytest
from tudor_dynamics.arm.limits import hard_limits, planned_limits
from tudor_dynamics.control.motion_controller import MotionController, State
from tudor_dynamics.control.references import ReferenceSource
from tudor_dynamics.control.settings import WATCH_PERIOD
from tudor_dynamics.mechanics.closed_loop import Sample
from tudor_dynamics.mechanics.rig import Rig

SHAKEN = 1.25


@lru_cache
def normal() -> float:
    """Give the strain of link 2 in the long move, there and back, peak to peak."""
    rig = moving()
    rig.run(3.5)
    go(rig, FIRST)
    rig.run(4.0)
    assert rig.trace.state[-1] is State.FOLLOWING
    return float(np.ptp(rig.trace.array('strain')[:, 0]))


def judge(rig: Rig) -> None:
    """Check that no limit was passed and no link shaken more than by a normal move."""
    assert not broken_limits(rig)
    assert np.ptp(rig.trace.array('strain')[:, 0]) <= SHAKEN * normal()


def still(rig: Rig, seconds: float = 1.5) -> None:
    """Check that the arm does not drift."""
    begin = len(rig.trace.q)
    rig.run(seconds)
    assert np.degrees(np.ptp(rig.trace.array('q')[begin:], axis=0)).max() < 0.3


def follows_again(rig: Rig) -> None:
    """Check that it takes the next goal, and arrives."""
    assert rig.controller is not None
    assert rig.controller.state is State.FOLLOWING, rig.controller.cause
    go(rig, FIRST)
    rig.step()
    assert rig.source is not None and rig.source.motion is not None
    rig.run(rig.source.motion.remaining + 2.0)
    assert rig.trace.q[-1] == pytest.approx(FIRST, abs=np.radians(0.3))


def states(rig: Rig) -> list[State | None]:
    """Give the states one after the other."""
    seen: list[State | None] = []
    for state in rig.trace.state:
        if not seen or seen[-1] is not state:
            seen.append(state)
    return seen


def altered(rig: Rig, change: Callable[[Sample], Sample | None], seconds: float) -> None:
    """Let samples be changed on their way for a while."""
    rig.alter = change
    rig.run(seconds)
    rig.alter = None


def test_reference_in_degrees() -> None:
    """60 and -20 as radians are refused and named; the arm stays where it is."""
    rig = Rig(tudor(), rate=250.0)
    rig.run(0.5)
    rig.source = None
    before = rig.trace.q[-1]
    for _ in range(500):
        rig.controller.reference.add(rig.t, np.array([60.0, -20.0]), np.zeros(2))
        rig.step()
    assert rig.controller.state is State.HOLDING
    assert "it sends 'joint2' to 60; send" in rig.controller.cause and (
        'not degrees' in rig.controller.cause)
    assert rig.controller.reference.refused['reference outside limits'] == 500
    assert rig.trace.q[-1] == pytest.approx(before, abs=np.radians(0.1))
    judge(rig)


@pytest.mark.parametrize('q, dq, cause', [
    ([np.nan, 0.0], [0.0, 0.0], 'not finite'), ([1.0, 0.0], [2.5, 0.0], 'too fast'),
    ([2.5, 1.0], [0.0, 0.0], 'begins where the arm'),
    ([0.7854, 0.0], [0.5, 0.0], 'send one at rest')])
def test_references_that_are_not_followed(q: list[float], dq: list[float], cause: str) -> None:
    """No numbers, too fast, far away, moving already: held, and the reason is told."""
    rig = Rig(tudor(), rate=100.0)
    rig.run(0.5)
    rig.source = None
    rig.run(0.3)
    for _ in range(250):
        rig.controller.reference.add(rig.t, np.array(q), np.array(dq))
        rig.step()
    assert rig.controller.state is State.HOLDING and cause in rig.controller.cause
    still(rig)
    judge(rig)


def test_reference_goes_stale_by_its_age_alone() -> None:
    """One reference of velocity 0 does not hold for ever."""
    rig = Rig(tudor(), rate=100.0)
    rig.run(1.0)
    assert rig.controller.state is State.FOLLOWING
    rig.source = None
    rig.run(0.2)
    assert rig.controller.state is State.HOLDING and 'no reference' in rig.controller.cause
    still(rig)


def test_source_is_killed() -> None:
    """It brakes as planned motion does, within 25 deg and the timeout's way; no drift."""
    rig = moving()
    before = rig.trace.q[-1][0]
    rig.source = None
    rig.run(1.2)
    assert np.degrees(rig.trace.q[-1][0] - before) < 24.5 + 70.0 * 0.1 + 5.0  # 5: the damper
    assert states(rig)[-1] is State.HOLDING
    rig.run(1.5)
    still(rig)
    judge(rig)


def test_source_is_restarted() -> None:
    """A new source begins at the arm, and goals are taken."""
    rig = moving()
    rig.source = None
    rig.run(0.5)
    rig.start_source()
    rig.run(1.5)
    follows_again(rig)
    judge(rig)


@pytest.mark.parametrize('dead', [0.0, 0.05, 0.3, 1.0])
def test_controller_is_killed_and_restarted(dead: float) -> None:
    """The drive brakes by itself; a new controller takes over at the speed that the arm has."""
    rig = moving()
    rig.controller = None
    rig.run(dead)
    rig.start_controller()
    rig.run(3.0)
    follows_again(rig)
    judge(rig)


@pytest.mark.parametrize('who, seconds', [
    ('controller', 0.15), ('controller', 3.0), ('source', 0.15), ('source', 3.0)])
def test_process_is_stopped_for_a_while(who: str, seconds: float) -> None:
    """SIGSTOP and SIGCONT: nothing jumps, and goals are taken again."""
    rig = moving()
    rig.frozen = {who}
    rig.run(seconds)
    rig.frozen = set()
    rig.run(3.0)
    follows_again(rig)
    judge(rig)


def test_deactivated_and_activated_with_a_goal_between() -> None:
    """It brakes at deactivation, and holds at activation until the reference is there."""
    rig = moving()
    rig.active = False
    rig.run(1.0)
    assert not rig.process.speed.any()
    rig.source.go(FIRST)
    rig.run(0.3)
    rig.activate()
    rig.run(3.0)
    follows_again(rig)
    judge(rig)


@pytest.mark.parametrize('elsewhere', [False, True])
def test_driver_stops(elsewhere: bool) -> None:
    """No positions for 3 s; the arm may be elsewhere then."""
    rig = moving()
    altered(rig, lambda sample: None, 3.0)
    assert rig.controller.missing and not rig.process.speed.any()
    if elsewhere:
        rig.process.reset()
    rig.run(3.0)
    follows_again(rig)
    if elsewhere:  # what the hand did to the arm is not the controller's
        assert not broken_limits(rig)
    else:
        judge(rig)


@pytest.mark.parametrize('seconds', [0.05, 0.5, 5.0])
def test_network_is_cut(seconds: float) -> None:
    """Nothing arrives anywhere; all comes back by itself."""
    rig = moving()
    rig.loss = 1.0
    rig.run(seconds)
    rig.loss = 0.0
    rig.run(3.0)
    follows_again(rig)
    judge(rig)


def test_positions_are_no_numbers() -> None:
    """Not a number for 3 s is as no positions."""
    rig = moving()
    altered(rig, lambda sample: dataclasses.replace(sample, q=sample.q * np.nan), 3.0)
    assert State.FAULT not in states(rig)
    rig.run(3.0)
    follows_again(rig)
    judge(rig)


def test_encoder_freezes() -> None:
    """The same reading while commanded: a fault within a few degrees, left by a reset alone."""
    rig = moving()
    kept = rig.trace.q[-1].copy()
    altered(rig, lambda sample: dataclasses.replace(sample, q=kept), 0.06)
    assert rig.controller.state is State.FAULT and 'frozen' in rig.controller.cause
    assert 'joint2' in rig.controller.cause
    assert np.degrees(rig.trace.q[-1][0] - kept[0]) < 5.5
    rig.run(3.0)
    still(rig)
    assert rig.controller.state is State.FAULT and not rig.process.speed.any()
    rig.controller.reset()
    rig.run(2.0)
    follows_again(rig)
    judge(rig)


@pytest.mark.parametrize('at_rest', [False, True])
def test_encoder_jumps(at_rest: bool) -> None:
    """57 deg more than before: a fault at once, and standstill."""
    rig = Rig(tudor(), rate=100.0) if at_rest else moving()
    rig.run(1.0 if at_rest else 0.0)
    rig.alter = lambda sample: dataclasses.replace(sample, q=sample.q + [np.radians(57.0), 0.0])
    rig.run(0.02)
    assert rig.controller.state is State.FAULT and 'jumped' in rig.controller.cause
    rig.run(2.0)
    still(rig)
    judge(rig)


def test_encoder_out_of_range() -> None:
    """A start with readings that are no pose of the arm is a fault, not a motion."""
    rig = Rig(tudor(), rate=250.0)
    rig.alter = lambda sample: dataclasses.replace(sample, q=sample.q + [4.0, 0.0])
    rig.run(1.0)
    assert rig.controller.state is State.FAULT and 'far outside' in rig.controller.cause
    still(rig)
    judge(rig)


def test_gauges_fail_in_motion() -> None:
    """Strains are no numbers: the move goes on undamped, and the damper comes back."""
    rig = moving()
    altered(rig, lambda sample: dataclasses.replace(sample, strain=sample.strain * np.nan), 3.0)
    rig.run(1.0)
    follows_again(rig)
    judge(rig)


@pytest.mark.parametrize('loss', [0.05, 0.2])
def test_messages_get_lost(loss: float) -> None:
    """Some of all messages: it goes on, and all is quiet after the move."""
    rig = moving(loss=loss, seed=3)
    rig.run(7.0)
    assert np.degrees(np.abs(rig.trace.array('command')[-100:])).max() < 1.0
    assert rig.controller.state is State.FOLLOWING
    follows_again(rig)
    judge(rig)


@pytest.mark.parametrize('rate, delay, payload', [
    (100.0, 0.08, 0.0), (100.0, 0.08, 0.4), (250.0, 0.04, 0.4), (500.0, 0.08, 0.4),
    (1000.0, 0.06, 0.0)])
def test_delay_in_the_loop(rate: float, delay: float, payload: float) -> None:
    """The damper takes what the measured delay allows: 5 s after a move all commands rest."""
    rig = Rig(tudor(), rate=rate, delay=delay, payload=payload)
    rig.run(1.0)
    go(rig, FIRST)
    rig.run(8.0)
    begin = len(rig.trace.t)
    rig.run(0.5)
    assert np.degrees(np.abs(rig.trace.array('command')[begin:])).max() < 1.0
    assert rig.controller.state is State.FOLLOWING and not rig.controller.gains.excited
    # half a delay is a whole number of samples here, one sample is held, one is waited for
    assert rig.controller.gains.delay.delay == pytest.approx(delay, abs=2.0 / rate + 0.002)
    assert rig.controller.gains.allowed_share < 1.0
    assert not broken_limits(rig)


def test_position_gain_that_swings() -> None:
    """A gain of 100 is bounded by the delay, and 0 is that of the description again."""
    rig = Rig(tudor(), rate=100.0)
    rig.run(1.0)
    rig.controller.gains.asked = 100.0
    go(rig, FIRST)
    rig.run(7.0)
    assert np.degrees(np.abs(rig.trace.array('command')[-100:])).max() < 1.0
    assert rig.controller.gains.position_gain_in_use < 30.0
    rig.controller.gains.asked = 0.0
    assert rig.controller.gains.position_gain_in_use == pytest.approx(3.0)
    judge(rig)


def test_damper_that_excites_is_switched_off() -> None:
    """The wrong sign: the damper goes off and says so, and a reset is needed to have it back."""
    rig = Rig(tudor(), rate=100.0, share=-1.0)
    rig.run(1.0)
    go(rig, FIRST + [0.2, 0.2])
    rig.run(8.0)
    excited = rig.controller.gains.excited
    assert 'oscillation' in excited or 'limit' in excited
    assert rig.controller.gains.allowed_share == 0.0
    assert not broken_limits(rig)
    rig.run(8.0)
    assert np.degrees(np.abs(rig.trace.array('command')[-100:])).max() < 1.0
    rig.controller.reset()
    assert rig.controller.gains.allowed_share > 0.0


def test_collision_before_the_first_positions() -> None:
    """A latched collision counts from the beginning: no goals until it is cleared."""
    rig = Rig(tudor(), rate=100.0)
    rig.source.collide(True)
    rig.run(0.5)
    assert 'collision' in rig.source.go(FIRST)
    still(rig)
    rig.source.collide(False)
    rig.source.clear()
    follows_again(rig)


def test_nobody_watches() -> None:
    """Without a monitor that is asked for, it brakes and takes no goals."""
    rig = moving()
    rig.source.halt('it sends no diagnostics')
    rig.run(2.0)
    assert 'sends no diagnostics' in rig.source.go(FIRST)
    still(rig)
    rig.source.halt('')
    follows_again(rig)
    judge(rig)


def test_comply_stays_in_range() -> None:
    """A collision that pushes on and on moves the reference to the end of the range at most."""
    rig = Rig(tudor(), rate=100.0)
    rig.start_source('comply')
    rig.run(1.0)
    rig.source.collide(True)
    rig.source.motion.yielding[:] = -0.6, 0.6
    rig.run(6.0)
    judge(rig)
    assert rig.source.q == pytest.approx(
        [planned_limits(tudor()).lower[0], planned_limits(tudor()).upper[1]])


@pytest.mark.parametrize('before', [1.0, 4.0, 20.0])
def test_reset_in_motion(before: float) -> None:
    """
    It brakes at once, and stays within limits: silence would let the arm run on.

    Found by sequence 343 of ``bench/motion_sequences.py --seed 2``.
    """
    rig = Rig(tudor(), rate=100.0, payload=0.4)
    rig.run(1.0)
    upper = hard_limits(rig.arm).upper
    go(rig, upper * [1.0, 0.0])
    while np.degrees(upper[0] - rig.trace.q[-1][0]) > before:
        rig.step()
    speed = rig.trace.command[-1]
    rig.controller.reset()
    rig.run(0.02)
    assert np.all(np.abs(rig.trace.command[-1]) < np.abs(speed))
    rig.run(2.0)
    assert not broken_limits(rig)
    assert np.abs(rig.trace.dq[-1]).max() < 0.05


def test_random_sequences() -> None:
    """Any order of faults and the rest; bench/motion_sequences.py has more."""
    run_state_machine_as_test(MotionMachine, settings=settings(
        max_examples=8, stateful_step_count=12, deadline=None, derandomize=True,
        suppress_health_check=list(HealthCheck)))


def test_encoder_jumps_as_the_controller_starts() -> None:
    """A jump between the first two readings is no speed to take over."""
    rig = Rig(tudor(), rate=250.0)
    rig.step()
    rig.alter = lambda sample: dataclasses.replace(sample, q=sample.q + [0.5, 0.0])
    rig.run(1.0)
    assert rig.controller.state is State.FAULT and 'jumped' in rig.controller.cause
    assert not np.any(rig.trace.command)


def test_encoder_freezes_before_a_limit() -> None:
    """An encoder that stops 1 deg before a limit does not let the arm go on through it."""
    rig = Rig(tudor(), rate=100.0, payload=0.4, delay=0.02)
    rig.run(0.5)
    lower = hard_limits(tudor()).lower
    go(rig, np.array([1.5, lower[1]]))
    while rig.trace.q[-1][1] > lower[1] + np.radians(1.0):
        rig.step()
        assert rig.t < 5.0
    kept = rig.trace.q[-1].copy()
    altered(rig, lambda sample: dataclasses.replace(sample, q=kept), 2.0)
    assert not broken_limits(rig)


def test_encoder_freezes_as_the_arm_creeps_to_a_limit() -> None:
    """What a frozen encoder does not show is not forgotten, however slow the arm is."""
    machine = MotionMachine()  # found by bench/motion_sequences.py --seed 3
    machine.start(delay=0.02, seed=23, payload=0.0, loss=0.0)
    machine.goal(seconds=1.9, shares=(0.2446822626325767, 0.0))
    machine.fault(kind='frozen', seconds=3.0, size=0.0)
    assert machine.rig is not None
    assert not broken_limits(machine.rig)


def test_the_way_to_a_limit_is_no_swing() -> None:
    """Where a slow loop nears the end of the range, its bounded speed does not end damping."""
    rig = Rig(tudor(), rate=100.0, payload=0.2, delay=0.08, seed=1)
    assert rig.controller is not None and rig.source is not None
    rig.run(1.0)
    planned = planned_limits(rig.arm)
    for shares in ((0.02, 0.1), (0.97, 0.9)):
        go(rig, planned.lower + np.array(shares) * (planned.upper - planned.lower))
        rig.step()
        assert rig.source.motion is not None
        rig.run(rig.source.motion.remaining + 3.0)
    assert rig.controller.state is State.FOLLOWING and rig.controller.gains.excited == ''
    assert broken_limits(rig) == []


def test_lost_samples_are_not_made_up_for_in_one_command() -> None:
    """A controller that was held up for less than a timeout steps as in one period."""
    machine = MotionMachine()  # found by bench/motion_sequences.py --seed 77
    machine.start(delay=0.0, payload=0.2, seed=82, loss=0.05)
    machine.cut(seconds=1.2951984502522442)
    machine.reset()
    machine.collide(seconds=0.1, strain=1.4)
    machine.reset()
    machine.reset()
    machine.collide(seconds=0.9, strain=-270.3)
    machine.collide(seconds=0.56, strain=0.0)
    machine.wander(seconds=2.8133413538810172, seed=9)
    machine.freeze(seconds=0.08763753888377589, who='controller')
    assert machine.rig is not None
    assert broken_limits(machine.rig) == []


def test_a_jump_away_from_a_limit_hides_it_from_nobody() -> None:
    """
    An encoder jumps by 33 deg while the arm comes up to a limit, in a loop with 60 ms of delay.

    What it says from then on is no reason to brake later: where the arm was is counted on.
    """
    machine = MotionMachine()
    machine.start(loss=0.0, payload=0.0, seed=38, delay=0.06)
    machine.goal(seconds=1.451230438753097, shares=(0.18101955332365408, 0.11405683134123662))
    machine.foreign_reference(dq=(0.0, 0.0), number=24, q=(-28.3, 3.1))
    machine.goal(seconds=3.0, shares=(0.4386520735534917, 0.81644523111043))
    machine.goal(seconds=0.946926748336506, shares=(0.0, 0.0))
    machine.fault(kind='jump', seconds=1.2541051943465202, size=0.5708148412449479)
    machine.within_limits()


def test_no_timeout_lets_a_reference_run_on() -> None:
    """However long is waited by a parameter, an arm stops where the last reference leads it."""
    rig = moving()
    rig.controller.timeout = 60.0
    speed, place = rig.trace.dq[-1][0], rig.trace.q[-1][0]
    rig.source = None
    rig.run(1.5)
    assert abs(rig.trace.q[-1][0] - place) < 0.25 * abs(speed)
    judge(rig)
    still(rig)


def test_no_timeout_leaves_an_arm_without_positions() -> None:
    """It slows down after a period and a half, and stops for good after a quarter of a second."""
    controller = moving(rate=250.0).controller
    controller.timeout = 60.0
    begin, before = controller._at, controller.envelope.command
    assert controller.watch(begin + 0.005) is None
    slower = controller.watch(begin + 0.0065)
    assert slower is not None and np.all(np.abs(slower) < np.abs(before))
    assert controller.watch(begin + 0.24) is not None and not controller.missing
    assert controller.watch(begin + 0.26) is not None and controller.missing


def test_positions_hiccup_while_their_stamps_go_on() -> None:
    """A wall clock that ran on alone: standstill is commanded until the next sample."""
    controller = MotionController(tudor())
    gauges = len(tudor().gauges)
    q, strain, fresh = FIRST, np.zeros(gauges), np.ones(gauges, dtype=bool)
    now = 0.0

    def samples(count: int) -> None:
        nonlocal now
        for _ in range(count):
            now += 0.01
            controller.reference.add(now, q, np.zeros(2))
            controller.step(now, 0.01, q, strain, fresh)
    samples(200)
    assert controller.state is State.FOLLOWING
    for _ in range(2):  # the second loss is like the first
        for _ in range(30):
            now += 0.01
            controller.watch(now)
        assert controller.missing and controller.state is State.HOLDING
        samples(200)
        assert not controller.missing and controller.state is State.FOLLOWING


@pytest.mark.parametrize('late', [0.3, 0.6])
def test_positions_that_come_late(late: float) -> None:
    """A backlog counts as no positions: it brakes, says why, and follows when it is over."""
    rig = moving()
    before = rig.trace.q[-1].copy()
    rig.late = late
    rig.run(1.5)
    assert rig.controller.state is State.HOLDING and 'ms late' in rig.controller.cause
    assert np.degrees(np.abs(rig.trace.q[-1] - before)).max() < 70.0 * 0.1 + 24.5 + 5.0
    still(rig)
    rig.late = 0.0
    rig.run(3.0)
    follows_again(rig)
    judge(rig)


@pytest.mark.parametrize('rate', [100.0, 500.0])
def test_samples_that_waited_do_not_add_up_to_a_step(rate: float) -> None:
    """However many are answered at once, commands change as fast as the limits allow."""
    rig = moving(rate=rate)
    begin = len(rig.trace.sent)
    for _ in range(4):
        rig.late = 0.09
        rig.run(0.09)
        rig.late = 0.0
        rig.run(0.1)
    times = np.array([t for t, _, _ in rig.trace.sent[begin:]])
    commands = np.array([command for _, _, command in rig.trace.sent[begin:]])
    at_once = np.array([np.ptp(commands[(times >= t - 1e-9) & (times < t + 1e-9)], axis=0)
                        for t in np.unique(times)])
    assert np.max(np.unique(times, return_counts=True)[1]) > 0.08 * rate
    most = hard_limits(rig.arm).acceleration * (max(2.0 / rate, WATCH_PERIOD) + 1e-6)
    assert np.all(at_once < most), np.degrees(at_once.max(axis=0))


@pytest.mark.parametrize('rate', [100.0, 500.0])
def test_a_driver_that_hangs_and_catches_up(rate: float) -> None:
    """
    Its samples come late, in bursts, and it hears nothing meanwhile: no lie, and hides none.

    Commands that were given meanwhile act as late as the samples come.
    """
    rig, sign = moving(rate=rate), 1.0
    rig.obey = lambda command: None if rig.late else sign * command

    def hang(times: int) -> bool:
        for _ in range(times):
            rig.late = 0.09
            rig.run(0.09)
            rig.late = 0.0
            rig.run(0.1)
            if rig.controller.state is State.FAULT:
                return True
        return False
    assert not hang(13), rig.controller.cause
    go(rig, FIRST)
    assert not hang(12), rig.controller.cause
    go(rig, SECOND)
    assert not hang(2), rig.controller.cause
    sign = -1.0
    assert hang(2)


def test_untested_joints_are_nudged_only() -> None:
    """A joint test that is required is needed again after the driver was gone."""
    rig = Rig(tudor(), rate=100.0)
    rig.controller.required = True
    rig.run(1.0)
    begin = rig.trace.q[-1].copy()
    go(rig, begin + np.radians([0.5, -0.5]))
    rig.run(2.0)
    assert rig.trace.q[-1] == pytest.approx(begin + np.radians([0.5, -0.5]), abs=3e-3)
    go(rig, FIRST)
    causes = set()
    for _ in range(20):
        rig.run(0.1)
        causes.add(rig.controller.cause)
    assert np.degrees(np.abs(rig.trace.q[-1] - begin)).max() < 4.0
    assert any('run the node joint_test' in cause for cause in causes)
    rig.controller.tested = True
    rig.run(2.0)
    follows_again(rig)
    altered(rig, lambda sample: None, 0.8)
    rig.run(1.0)
    assert rig.controller.tested  # so short a silence is no start of a driver
    rig.controller = None
    rig.run(1.0)
    rig.start_controller()
    assert not rig.controller.tested
    judge(rig)


@pytest.mark.parametrize('rate', [100.0, 500.0])
@pytest.mark.parametrize('name, most', [('drive negates', 1.0), ('drive swaps', 4.0)])
def test_a_driver_that_starts_again_is_tested_again(name: str, most: float, rate: float) -> None:
    """
    A driver that comes back after 1.5 s, and is wrong now, gets nudges alone.

    What was confirmed of the one before counts no more.
    """
    rig = Rig(tudor(), rate=rate)
    rig.controller.required = True
    rig.run(1.0)
    rig.controller.tested = True
    go(rig, FIRST)
    rig.run(4.0)
    follows_again(rig)
    altered(rig, lambda sample: None, 1.5)
    begin = len(rig.trace.q)
    Liar(rig).begin(next(lie for lie in LIES if lie.name == name))
    rig.run(0.5)
    assert not rig.controller.tested
    assert np.degrees(rig.controller.watched.trusted).max() < 3.0
    go(rig, SECOND)
    causes = set()
    for _ in range(20):
        rig.run(0.1)
        causes.add(rig.controller.cause)
    assert 'joints were not tested since their driver started; run the node joint_test' in causes
    moved = np.abs(rig.trace.array('q')[begin:] - rig.trace.q[begin - 1])
    assert np.degrees(moved[:, 0]).max() < most
    judge(rig)


def test_a_clock_set_back_is_a_driver_that_starts_again() -> None:
    """A simulated driver begins at 0 again, however short its silence was."""
    rig = Rig(tudor(), rate=250.0)
    rig.run(1.0)
    rig.controller.tested = True
    altered(rig, lambda sample: None, 0.5)
    rig._stamp = rig.t + 9.0
    rig.run(0.01)
    assert not rig.controller.tested


@pytest.mark.parametrize('rate', [100.0, 500.0])
@pytest.mark.parametrize('later', [False, True])
def test_two_dampers_command_one_arm(later: bool, rate: float) -> None:
    """
    Two follow references of their own, at once or one in the other's move: no limit is left.

    The first of them has its fault within a second, and the arm comes to stand. What the fault
    says: test_a_fault_beside_a_second_commander_names_it of nodes.
    """
    rig = Rig(tudor(), rate=rate, payload=0.4, seed=3)
    second, source = MotionController(rig.arm), ReferenceSource(rig.arm)
    first, stamps = rig._answer, [0.0]

    def both(sample: Sample) -> object:
        command = first(sample)
        source.measured(rig.t, sample.q)
        reference = source.step(rig.t, 1.0 / rate)
        if reference is not None:
            second.reference.add(rig.t, *reference)
        if command is not None:
            rig._send(command)
        stamps.append(sample.t)
        return second.step(
            rig.t, stamps[-1] - stamps[-2] if len(stamps) > 2 else 0.0, sample.q, sample.strain,
            np.ones(len(sample.strain), dtype=bool), age=rig.t - sample.t, dq=sample.dq,
            effort=sample.current)
    if not later:
        rig._answer = both
    rig.run(1.0)
    go(rig, SECOND)
    if later:
        rig.run(0.9)
        rig._answer = both
    else:
        assert source.go(np.radians([15.0, -70.0])) == ''
    faults = []
    for k in range(round(4.0 * rate)):
        rig.step()
        if State.FAULT in (rig.controller.state, second.state):
            faults.append(k / rate)
    assert faults[0] < 1.0
    limits, q = hard_limits(rig.arm), rig.trace.array('q')
    assert np.all(q > limits.lower) and np.all(q < limits.upper)
    assert np.all(np.abs(np.diff(q, axis=0)) * rate < 1.05 * limits.velocity)
    assert np.degrees(np.abs(rig.trace.dq[-1])).max() < 1.0
