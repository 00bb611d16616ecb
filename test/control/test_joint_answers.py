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

"""Answers of joints to nudges: the simulated arm that is right, and drivers that lie."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
import dataclasses
from functools import lru_cache
import math
from pathlib import Path
import re
import tempfile
from typing import Any

from motion_machine import PATH
import numpy as np
import pytest
from thinned import thinned

from tudor_dynamics.arm.description import Arm, load_arm
from tudor_dynamics.control import settings
from tudor_dynamics.control.joint_answers import (
    JointAnswer, JointRecord, nudges, order_fault, pose_fault)
from tudor_dynamics.mechanics.closed_loop import Sample
from tudor_dynamics.mechanics.rig import Rig

STEP = settings.NUDGE
LATER = 0.3
"""For which it is listened after the arm was stopped [s]."""


@lru_cache
def arm() -> Arm:
    """Give the reference arm where each of its joints could stand."""
    text = PATH.read_text(encoding='utf-8').replace(
        'urdf: tudor.urdf', f'urdf: {PATH.parent}/tudor.urdf').replace(
        'initial: {joint2: 0.7853982}', 'initial: {joint2: 0.7853982, joint3: 0.5235988}')
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / 'tudor.yaml'
        file.write_text(text, encoding='utf-8')
        return load_arm(file)


def standing(rate: float, payload: float, **options: Any) -> Rig:
    """Give an arm that stands, with its damper off."""
    rig = Rig(arm(), rate=rate, payload=payload, share=0.0, **{'delay': 0.005, **options})
    rig.run(0.5)
    return rig


def lie(rig: Rig, obey: Callable[[np.ndarray], np.ndarray] | None = None,
        alter: Callable[[Sample], Sample] | None = None) -> None:
    """Begin to lie, and start what commands the joints again."""
    rig.obey, rig.alter = obey, alter
    rig.run(0.02)  # what is on its way is true still
    rig.start_controller()
    rig.start_source()


def nudge(rig: Rig, joint: int, step: float = STEP, *, velocities: bool = True) -> JointAnswer:
    """Nudge a joint as the program does, with its ears on the way to the controller."""
    record = JointRecord(rig.arm, joint, step)
    alter, waiting = rig.alter, deque()
    heard = len(rig.trace.sent)

    def hear(sample: Sample) -> Sample | None:
        altered = sample if alter is None else alter(sample)
        waiting.append(altered)
        return altered

    def run(seconds: float) -> bool:
        nonlocal heard
        for _ in range(round(seconds * rig.rate)):
            while waiting and waiting[0].t <= rig.t - 0.5 * rig.delay + 1e-9:
                sample = waiting.popleft()
                record.positions(sample.t, sample.q, sample.dq if velocities else None)
            rig.step()
            for _, _, command in rig.trace.sent[heard:]:
                record.command(command)
            heard = len(rig.trace.sent)
            if record.astray and rig.active:
                rig.active = False
                return run(LATER)
        return rig.active

    rig.alter = hear
    if run(settings.NUDGE_STANDS):
        record.begin()
        assert rig.source is not None and rig.source.q is not None
        way = nudges(rig.arm.active_joints[joint], rig.source.q[joint], step)
        assert rig.source.take(way) == ''
        run(way.t[-1] + LATER)
    rig.alter = alter
    return record.judge()


LOADS = (100.0, 0.4), (500.0, 0.0)
"""A slow driver with the heaviest load, and a fast one with none."""
both = pytest.mark.parametrize('rate, payload', LOADS)


def some(**values: Iterable[object]) -> Any:
    """Run a test with half of the cases of some values and both loads."""
    return pytest.mark.parametrize(', '.join([*values, 'rate', 'payload']), [
        (*own, *load) for *own, load in thinned(*values.values(), LOADS)])


@some(joint=(0, 1), options=({}, {'delay': 0.02, 'loss': 0.05, 'seed': 3}), step=(STEP, -STEP))
def test_right_joints_are_right(
    rate: float, payload: float, joint: int, options: dict[str, float], step: float,
) -> None:
    """With play, friction and noise, 20 ms of delay and lost messages, there and back."""
    answer = nudge(standing(rate, payload, **options), joint, step)
    assert answer.right is True, answer
    assert answer.answered == answer.joint == arm().active_joints[joint]
    assert answer.sign == 1 and abs(answer.scale - 1.0) < 0.2
    assert answer.error < 0.25 and answer.noise < 0.1 * STEP
    assert -0.003 < answer.delay - rig_delay(options) < 0.018 + 1.5 / rate


def rig_delay(options: dict[str, float]) -> float:
    """Give the delay of messages [s]."""
    return options.get('delay', 0.005)


def told(**change: Callable[[Sample], np.ndarray]) -> Callable[[Sample], Sample]:
    """Change fields of a sample."""
    return lambda sample: dataclasses.replace(
        sample, **{name: new(sample) for name, new in change.items()})


AT = np.radians([45.0, 30.0])
FIRST = np.array([1.0, 0.0])
DRIVES: dict[str, tuple[Callable[[np.ndarray], np.ndarray], float, str]] = {
    'negated': (lambda u: u * [-1.0, 1.0], -1.0, 'moves the other way, so a sign is wrong'),
    'all negated': (lambda u: -u, -1.0, 'moves the other way, so a sign is wrong'),
    'degrees': (lambda u: u * 57.3, 57.3, ', perhaps degrees confused with radians'),
    'radians': (lambda u: u / 57.3, 1.0 / 57.3, ', perhaps degrees confused with radians'),
    'half': (lambda u: 0.5 * u, 0.5, 'times as far as commanded'),
    'tenfold': (lambda u: u * [10.0, 1.0], 10.0, 'wrong decimal place'),
    'negated tenth': (lambda u: -0.1 * u, -0.1, 'the other way')}
ENCODERS: dict[str, tuple[float, str]] = {
    'a tenth': (0.1, 'wrong decimal place'), 'a half': (0.5, 'times as far as commanded'),
    'backwards': (-1.0, 'moves the other way, so a sign is wrong')}
BOUND = 1.0
"""How far the true joint goes at most until it is found [deg]."""


def gone(rig: Rig, begin: int) -> float:
    """Give how far the true joints went since a sample [deg]."""
    q = np.array(rig.trace.q[begin:])
    return float(np.degrees(np.abs(q - q[0]).max()))


@some(name=DRIVES)
def test_drives_that_lie(name: str, rate: float, payload: float) -> None:
    """Sign and scale are told, and that position and velocity agree on them."""
    obey, scale, text = DRIVES[name]
    rig = standing(rate, payload)
    lie(rig, obey)
    begin = len(rig.trace.q)
    rig.run(0.3)
    answer = nudge(rig, 0)
    assert answer.right is False and text in answer.text, answer
    if not math.isnan(answer.scale):  # one that oscillates has none
        assert answer.sign == np.sign(scale)
        assert 0.5 < answer.scale / abs(scale) < 2.0
    assert 'its velocity is right' not in answer.text
    assert gone(rig, begin) < (3.5 if abs(scale) > 10.0 else BOUND)


@some(name=ENCODERS, whole=(False, True))
def test_encoders_that_lie(name: str, whole: bool, rate: float, payload: float) -> None:
    """Sign and scale again; a driver's velocity that is right says that it is the encoder."""
    scale, text = ENCODERS[name]
    rig = standing(rate, payload)
    place = rig.trace.q[-1]
    change = {'q': lambda sample: np.where(FIRST, place + scale * (sample.q - place), sample.q)}
    if whole:
        change['dq'] = lambda sample: np.where(FIRST, scale * sample.dq, sample.dq)
    lie(rig, alter=told(**change))
    begin = len(rig.trace.q)
    rig.run(0.3)
    answer = nudge(rig, 0)
    assert answer.right is False and text in answer.text, answer
    assert answer.sign == np.sign(scale) and 0.6 < answer.scale / abs(scale) < 1.3
    assert ('the encoder that measures' if whole else 'velocity is right') in answer.text
    assert gone(rig, begin) < BOUND


@some(what=('commands', 'readings', 'positions'), joint=(0, 1))
def test_swapped_order(what: str, joint: int, rate: float, payload: float) -> None:
    """The joint that answers is named, and where velocities are right, that positions are not."""
    rig = standing(rate, payload)
    if what == 'commands':
        lie(rig, lambda u: u[::-1].copy())
    else:
        change = {'q': lambda sample: sample.q[::-1].copy()}
        if what == 'readings':
            change['dq'] = lambda sample: sample.dq[::-1].copy()
        lie(rig, alter=told(**change))
    begin = len(rig.trace.q)
    rig.run(0.3)
    answer = nudge(rig, joint)
    own, other = arm().active_joints[joint], arm().active_joints[1 - joint]
    assert answer.right is False and (answer.joint, answer.answered) == (own, other), answer
    assert f'but the position of {other!r}' in answer.text if what == 'positions' else (
        f'{own}: commands to this joint move {other!r}; correct the order' in answer.text)
    assert gone(rig, begin) < BOUND


@both
def test_a_deaf_drive(rate: float, payload: float) -> None:
    """It does not answer; whether a frozen encoder or a brake is the cause cannot be known."""
    rig = standing(rate, payload)
    lie(rig, lambda u: u * [0.0, 1.0])
    rig.run(0.3)
    answer = nudge(rig, 0)
    assert answer.right is False and 'the joint does not answer' in answer.text, answer
    assert answer.sign == 0 and answer.answered == ''


@some(joint=(0, 1), speed=(0.1, 1.0, 10.0))
def test_an_encoder_that_drifts(joint: int, speed: float, rate: float, payload: float) -> None:
    """It is found at the joint that is nudged, and at another one."""
    rig = standing(rate, payload)
    drift, since = math.radians(speed) * np.eye(2)[joint], rig.t
    lie(rig, alter=told(q=lambda sample: sample.q + drift * (sample.t - since)))
    begin = len(rig.trace.q)
    rig.run(0.3)
    answer = nudge(rig, 0)
    assert answer.right is False, answer
    assert answer.joint == arm().active_joints[joint] and 'moves by itself' in answer.text
    found = re.search(r'by itself at (-?[\d.]+) deg/s', answer.text)
    assert found and float(found[1]) == pytest.approx(
        speed, rel=0.5), answer
    assert gone(rig, begin) < BOUND + 0.3 * speed + 6.0 * min(speed, 0.1)


@both
def test_a_late_loop(rate: float, payload: float) -> None:
    """50 ms more than there should be."""
    answer = nudge(standing(rate, payload, delay=0.055), 0)
    assert answer.right is False and 'the joint answers late' in answer.text, answer
    assert 0.055 < answer.delay < 0.055 + 2.5 / rate + 0.012


def test_drivers_without_velocities() -> None:
    """What is right stays right, what is wrong is; only whose it is stays open."""
    rig = standing(100.0, 0.2)
    assert nudge(rig, 0, velocities=False).right is True
    lie(rig, lambda u: -u)
    rig.run(0.3)
    answer = nudge(rig, 0, velocities=False)
    assert answer.right is False and 'check the drive and the encoder' in answer.text


def test_a_rough_encoder_needs_a_larger_nudge() -> None:
    """Counts of a quarter of a degree: unclear at half a degree, right at two."""
    rig = standing(100.0, 0.2)
    count = math.radians(0.25)
    lie(rig, alter=told(q=lambda sample: np.round(sample.q / count) * count))
    rig.run(0.5)
    first = nudge(rig, 1)
    assert first.right is not False, first
    larger = nudge(rig, 1, 4.0 * STEP)
    assert larger.right is True and larger.error < 0.1, larger


def test_one_command_for_two_joints() -> None:
    """A joint that moves, too, is named."""
    rig = standing(100.0, 0.2)
    lie(rig, lambda u: np.array([u[0], u[0] + u[1]]))
    rig.run(0.3)
    answer = nudge(rig, 0)
    assert answer.right is False and 'to this joint move joint3, too' in answer.text, answer


def test_what_is_not_commanded_is_unclear() -> None:
    """A controller that does not follow says nothing about the joint."""
    record = JointRecord(arm(), 0, STEP)
    assert record.judge().right is None
    for k in range(300):
        record.positions(0.01 * k, AT)
        record.command(np.zeros(2))
    assert record.judge().right is None and 'of only 0 deg in place of 0.5' in record.judge().text


def test_gaps_are_left_out() -> None:
    """A machine that stops for 0.2 s now and then leaves the verdict, or makes it unclear."""
    for every, verdict in ((90, True), (20, None)):
        record, q, speed = JointRecord(arm(), 0, STEP), AT.copy(), np.zeros(2)
        for k in range(420):
            if k == 100:
                record.begin()
            q = q + 0.01 * speed
            record.positions(0.01 * k + 0.2 * (k // every), q)
            speed = math.radians(1.0) * FIRST * (
                0.0 if k < 100 else (0, 1, 0, -1)[(k - 100) // 40 % 4])
            record.command(speed)
        answer = record.judge()
        assert answer.right is verdict, answer


def test_orders_and_poses() -> None:
    """What can be said before anything moves."""
    joints = arm().active_joints
    assert order_fault(joints, ['joint2', 'joint3']) == ''
    assert 'in this order; set' in order_fault(joints, ['joint3', 'joint2'])
    assert 'in this order' not in order_fault(joints, ['joint1', 'joint2', 'joint3']) != ''
    assert pose_fault(arm(), AT) == ''
    assert 'joint2 is at 0 rad, outside its limits' in pose_fault(arm(), np.zeros(2))


def test_what_answers_its_own_commands_is_not_moved_by_others() -> None:
    """A joint that runs away from its own commands meanwhile is what is wrong."""
    record, dt = JointRecord(arm(), 0, STEP), 0.01
    q, ways = np.zeros(2), nudges('joint2', 0.0, STEP)
    for k in range(round((1.0 + ways.t[-1] + LATER) / dt)):
        t = k * dt
        if k == round(1.0 / dt):
            record.begin()
        nudge_speed = float(np.gradient(np.interp(
            t - 1.0 + dt * np.arange(3), ways.t, ways.q[:, 0], left=0.0), dt)[1])
        speed = np.array([nudge_speed, 0.0 if t < 1.0 else 0.3 * nudge_speed - 2.0 * q[1]])
        record.positions(t, q)
        record.command(speed)
        q = q + dt * speed * [1.0, -1.0]
    answer = record.judge()
    assert answer.right is False and answer.joint == 'joint3', answer
    assert 'moves the other way, so a sign is wrong' in answer.text
