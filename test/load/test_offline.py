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

"""Loads from recordings: with a scale, without one, and where nothing is shown."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
import json

import numpy as np
from payload_making import true_outputs, two_gauge_arm
import pytest
from sample_arms import gauge, LENGTH_2, multisine, planar_arm

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.errors import FitError
from tudor_dynamics.identification.fit import FitSettings
from tudor_dynamics.load.offline import estimate_payload, Presence
from tudor_dynamics.load.rows import Source
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.base import Model
from tudor_dynamics.signals.filters import MotionState
from tudor_dynamics.signals.preprocessing import Decimation, Stretch
from tudor_dynamics.typing import FloatArray

RATE = 20.0


def motion(seconds: float, seed: int, still: bool = False) -> FloatArray:
    """Move both joints smoothly, or not at all."""
    t = np.arange(0.0, seconds, 1.0 / RATE)
    rng = np.random.default_rng(seed)
    moved = multisine(t, 2, seed)
    moved[:, :2] += rng.uniform(-1.0, 1.0, 2)
    return np.asarray(0.0 * moved + moved[0] * [1, 1, 0, 0, 0, 0]) if still else moved


def stretch(arm: Arm, moved: FloatArray, payload: float, seed: int, noise: float = 1.0) -> Stretch:
    """Give a recording whose noise is as coloured as that of a model: it lasts half a second."""
    outputs = true_outputs(arm, moved, payload)
    rng = np.random.default_rng(seed)
    n = len(moved)
    white = rng.standard_normal((n + 40, 4))
    coloured = np.array([np.convolve(column, np.ones(10) / np.sqrt(10.0), 'valid')[:n]
                         for column in white.T]).T
    q, dq, ddq = np.split(moved, 3, axis=1)
    t = np.arange(n) / RATE
    return Stretch(t, (t * 1e9).astype(np.int64), MotionState(q, dq, ddq),
                   outputs['effort'] + noise * 0.1 * coloured[:, :2],
                   outputs['strain'] + noise * 10.0 * coloured[:, 2:],
                   Decimation(np.arange(n)))


@lru_cache
def models(of_all: bool, arm: Arm | None = None) -> tuple[Arm, dict[str, Model]]:
    """Fit models to exact data: of 0 and 400 g, or of 0 g."""
    arm = arm or two_gauge_arm()
    moved = motion(60.0, 1)
    found: dict[str, Model] = {}
    for output in ('effort', 'strain'):
        if of_all:
            model = AnalyticalModel.new(arm, output, FitSettings(
                estimator='wls', payloads=(0.0, 0.4)))
            x = np.vstack([np.column_stack([moved, np.full(len(moved), m)]) for m in (0.0, 0.4)])
            y = np.vstack([true_outputs(arm, moved, m)[output] for m in (0.0, 0.4)])
            found[output] = model.fit(x, y)
        else:
            plain = AnalyticalModel.new(arm, output, FitSettings(
                estimator='wls', strain_form='paper'))
            found[output] = plain.fit(moved, true_outputs(arm, moved, 0.0)[output])
    return arm, found


def test_truth_within_two_standard_deviations() -> None:
    """Of 40 short recordings most are, though their noise is far from white."""
    arm, known = models(of_all=True)
    inside, errors = 0, []
    for seed in range(40):
        told = estimate_payload(arm, known, [stretch(arm, motion(30.0, seed), 0.25, seed)])
        assert told.verdict is Presence.LOAD and told.source is Source.PAYLOADS
        errors.append(told.mass - 0.25)
        inside += abs(errors[-1]) < 2.0 * told.mass_std
    assert inside >= 32  # 37 of 40 in the mean of many seeds, less three of the count
    assert np.std(errors) == pytest.approx(told.mass_std, rel=0.6)


def test_place_and_inertia_from_torques() -> None:
    """A model of the empty arm in N m tells where a load sits, as far as a planar arm can."""
    arm, known = models(of_all=False)
    told = estimate_payload(arm, {'effort': known['effort']},
                            [stretch(arm, motion(60.0, 3), 0.3, 3, noise=0.02)])
    assert told.verdict is Presence.LOAD and told.source is Source.TORQUE and not told.at_tip
    assert told.mass == pytest.approx(0.3, abs=0.01)
    assert told.com[:2] == pytest.approx([LENGTH_2, 0.0], abs=0.02)
    assert np.isnan(told.com[2])  # along the axes of the joints
    assert abs(told.inertia[5] - 0.3 * LENGTH_2 ** 2) < 2.0 * told.inertia_std[5]
    assert np.isnan(told.inertia[0])


@pytest.mark.parametrize('of_all', [True, False])
def test_nothing_is_told_from_no_information(of_all: bool) -> None:
    """An arm that moves with nothing carries no load; one that stands tells nothing."""
    arm, known = models(of_all)
    free = estimate_payload(arm, known, [stretch(arm, motion(30.0, 5), 0.0, 5)])
    assert free.verdict is Presence.NONE and abs(free.mass) < 2.0 * free.mass_std
    still = estimate_payload(arm, known, [stretch(arm, motion(30.0, 5, still=True), 0.3, 5)])
    assert still.verdict is Presence.UNKNOWN and 'no information' in still.sentence


def test_a_model_of_one_load_tells_the_rest() -> None:
    """What the model knows counts into the mass, not into the load that it does not know."""
    arm, known = models(of_all=False)
    told = estimate_payload(arm, {'effort': known['effort']},
                            [stretch(arm, motion(30.0, 7), 0.2, 7, noise=0.1)], known=0.1)
    assert told.mass == pytest.approx(0.3, abs=0.02)


def test_one_estimate_says_where_the_load_sits() -> None:
    """Shown by the motion, at the tip, or as the payloads of the model were."""
    arm, rows = models(of_all=False)
    arm, of_all = models(of_all=True)
    effort = {'effort': rows['effort']}
    seen = estimate_payload(arm, effort, [stretch(arm, motion(60.0, 3), 0.3, 3, noise=0.02)])
    assert f', centre at x {1000 * seen.com[0]:.0f} +- ' in seen.sentence
    assert f' in the frame of {seen.frame}; the kilograms rest on ' in seen.sentence
    assumed = estimate_payload(arm, effort, [stretch(arm, motion(60.0, 3), 0.3, 3)], whole=False)
    assert assumed.at_tip and (
        ', its centre not shown by this motion: taken to sit at the tip, '
        f'x {1000 * LENGTH_2:.0f} mm, y 0 mm, z 0 mm in the frame of {assumed.frame};'
    ) in assumed.sentence
    known = estimate_payload(arm, of_all, [stretch(arm, motion(60.0, 3), 0.3, 3)])
    assert 'mounted as the loads of the model were' in known.sentence


def test_without_a_scale() -> None:
    """Strains of unknown gain tell a load as a part of the arm's own moment."""
    arm, known = models(of_all=False)
    small, large = (estimate_payload(
        arm, {'strain': known['strain']},
        [stretch(arm, motion(30.0, 9), m, 9, noise=0.1)]) for m in (0.1, 0.2))
    assert small.source is Source.NOTHING and np.isnan(small.mass)
    assert small.verdict is Presence.LOAD and 'kilograms need' in small.sentence
    assert large.relative == pytest.approx(2.0 * small.relative, rel=0.1)


def test_gains_of_gauges_are_a_scale() -> None:
    """With the gain of its gauges an arm tells kilograms, give or take that of the gain."""
    joints = [{'name': name, 'friction': ['viscous', 'coulomb']} for name in ('j1', 'j2')]
    arm = planar_arm(joints, [gauge('g1', 'j1', 0.0), gauge('g2', 'j2', 0.0)],
                     sensors=[{'gauge': 'g1', 'gain': 100.0}, {'gauge': 'g2', 'gain': 80.0}])
    moved = motion(60.0, 1)
    model = AnalyticalModel.new(arm, 'strain', FitSettings(estimator='wls', strain_form='exact'))
    model.fit(moved, true_outputs(arm, moved, 0.0)['strain'])
    told = estimate_payload(arm, {'strain': model},
                            [stretch(arm, motion(60.0, 3), 0.3, 3, noise=0.1)])
    assert told.source is Source.GAIN and told.scale_std == pytest.approx(0.05, rel=0.01)
    assert told.mass == pytest.approx(0.3, abs=2.0 * told.mass_std) and told.mass_std > 0.01


def test_errors_of_the_model_count() -> None:
    """What models were off by on motion that they had not seen widens the standard deviation."""
    arm, known = models(of_all=True)
    recording = [stretch(arm, motion(30.0, 2), 0.25, 2)]
    sure = estimate_payload(arm, known, recording)
    unsure = estimate_payload(arm, known, recording, errors={'effort': 0.05, 'strain': 0.05})
    assert unsure.mass_std > max(2.0 * sure.mass_std, 0.03)


def test_plain_values() -> None:
    """What is not known is null, and all of it is JSON."""
    arm, known = models(of_all=True)
    told = estimate_payload(arm, known, [stretch(arm, motion(20.0, 2), 0.25, 2)])
    content = told.as_dict()
    assert content['com'] == [None] * 3 and content['scale'] == 'payloads'
    assert content['mass'] == pytest.approx(told.mass, rel=1e-5)
    assert content['outputs']['strain']['channels'].keys() == {'g1', 'g2'}
    assert json.loads(json.dumps(content)) == content


def test_outputs_agree_and_count_by_what_they_know() -> None:
    """The mass lies between those of the outputs, nearer to the surer one, and is surer."""
    arm, known = models(of_all=True)
    told = estimate_payload(arm, known, [stretch(arm, motion(30.0, 4), 0.25, 4)])
    one, other = told.outputs
    assert min(one.mass, other.mass) <= told.mass <= max(one.mass, other.mass)
    surer, less = sorted((one, other), key=lambda item: item.std)
    assert abs(told.mass - surer.mass) <= abs(told.mass - less.mass)
    assert told.mass_std < surer.std
    for item in told.outputs:
        before, after = item.leftover.sizes()
        assert (after < before).any() and item.after < item.before
        assert (item.leftover.shares() >= 0.0).all() and item.leftover.shares().max() > 0.5
        assert len(item.leftover.t) == len(item.leftover.before)


def test_recordings_without_what_the_model_predicts() -> None:
    """They are refused, with what to record; outputs that are missing in one count in none."""
    arm, known = models(of_all=True)
    recording = stretch(arm, motion(30.0, 6), 0.25, 6)
    bare = replace(recording, strain=None)
    assert [item.output for item in estimate_payload(arm, known, [bare, recording]).outputs] == [
        'effort']
    with pytest.raises(FitError, match='none of the outputs .*; record the efforts or strains'):
        estimate_payload(arm, {'strain': known['strain']}, [bare])
