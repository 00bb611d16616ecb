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

"""The load of a running robot: announced by others, or estimated sample by sample."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from payload_making import true_outputs, two_gauge_arm
import pytest
from sample_arms import multisine

from tudor_dynamics.errors import ModelError
from tudor_dynamics.identification.fit import FitSettings
from tudor_dynamics.load.live import CarriedLoad, LoadFound, PayloadStage, rigid_noise
from tudor_dynamics.load.rows import LoadWorth
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.typing import FloatArray

DT, RANGE = 0.01, (0.0, 0.4)
MOTION = multisine(np.arange(0.0, 14.0, DT), 2, 3)


@lru_cache
def bundle(*outputs: str) -> ModelBundle:
    """Fit models of 0 to 400 g to exact data."""
    arm = two_gauge_arm()
    moved = multisine(np.arange(0.0, 60.0, 0.05), 2, 1)
    motion = np.vstack([np.column_stack([moved, np.full(len(moved), m)]) for m in RANGE])
    models = {output: {'analytical': AnalyticalModel.new(
        arm, output, FitSettings(estimator='wls', strain_form='paper', payloads=RANGE)).fit(
            motion, np.vstack([true_outputs(arm, moved, m)[output] for m in RANGE]))}
        for output in outputs}
    return ModelBundle(arm, arm.spec.preprocessing, models)


@lru_cache
def readings(mass: float) -> FloatArray:
    """Give the strains of the motion with a load, and the noise of their gauges."""
    strain = true_outputs(two_gauge_arm(), MOTION, mass)['strain']
    return np.asarray(strain + np.random.default_rng(4).normal(0.0, 2.0, strain.shape))


class Robot:
    """Feeds a stage with the motion, from its first sample on."""

    def __init__(self, stage: CarriedLoad, begin: int = 10**9) -> None:
        self.stage, self.k, self.begin = stage, 0, begin
        self.found: list[tuple[float, LoadFound]] = []

    def go(self, seconds: float, mass: float, *, touched: bool = False,
           push: tuple[float, float] = (0.0, 0.0)) -> float:
        """Go on with a load in the hand; give what the stage takes for it."""
        for k in range(self.k, self.k + round(seconds / DT)):
            found = self.stage.step(
                self.begin + round(k * DT * 1e9), DT if k else 0.0, MOTION[k],
                readings(mass)[k] + push, touched=touched)
            if found is not None:
                self.found.append((k * DT, found))
        self.k += round(seconds / DT)
        return self.stage.mass


def test_a_model_without_kilograms_is_refused() -> None:
    """Strains of unknown gain, fitted to one load, show none; it is said what would help."""
    arm = two_gauge_arm()
    model = AnalyticalModel.new(arm, 'strain', FitSettings(estimator='wls')).fit(
        MOTION, readings(0.0))
    with pytest.raises(ModelError, match='two loads .*, or with effort.torque_constant'):
        CarriedLoad(ModelBundle(arm, arm.spec.preprocessing, {'strain': {'analytical': model}}),
                    0.0)


def test_predictions_with_a_load() -> None:
    """Predictions of the empty arm become those of the loaded one, in all its outputs."""
    known = bundle('effort', 'strain')
    load = CarriedLoad(known, 0.1)
    load.carry(0.3)
    empty = {output: kinds['analytical'].predict(MOTION[7:8])[0]
             for output, kinds in known.at(0.1).models.items()}
    found = load.add_to({**empty, 'other': np.ones(1)}, MOTION[7])
    wanted = true_outputs(known.arm, MOTION[7:8], 0.3)
    for output, values in wanted.items():
        assert found[output] == pytest.approx(values[0], rel=1e-6, abs=1e-6)
    assert found['other'] == pytest.approx([1.0])  # of an output that shows no kilograms
    assert load.output == 'strain' and load.place == pytest.approx([0.35, 0.0, 0.0])


def test_a_load_that_others_know_is_reported_once() -> None:
    """A change by more than a touch could be; a smaller one is taken, and not reported."""
    load = CarriedLoad(bundle('effort', 'strain'), 0.0)
    robot = Robot(load)
    robot.go(0.1, 0.0)
    load.carry(0.02)
    assert robot.go(0.1, 0.0) == 0.02 and not robot.found
    load.carry(0.32)
    robot.go(0.1, 0.3)
    (_, found), = robot.found
    assert found.mass == 0.32 and found.change == pytest.approx(0.3)


def test_announcements_end() -> None:
    """For three seconds a load may come; a clock that is set back ends that at once."""
    load = CarriedLoad(bundle('effort', 'strain'), 0.0)
    robot = Robot(load)
    robot.go(0.5, 0.0)
    assert not load.expecting
    load.expect()
    robot.go(2.5, 0.0)
    assert load.expecting
    robot.go(0.6, 0.0)
    assert not load.expecting
    load.expect()
    Robot(load, begin=0).go(0.02, 0.0)
    assert not load.expecting


def test_what_is_there_at_the_beginning_is_learned() -> None:
    """Touched or not, within two seconds; the standard deviation says how well."""
    stage = PayloadStage(bundle('strain'), 0.1)
    before = stage.std
    assert stage.mass == 0.1 and not stage.bent
    assert Robot(stage).go(2.5, 0.3, touched=True) == pytest.approx(0.3, abs=0.01)
    assert stage.std < 0.2 * before


def test_picked_up_and_put_down() -> None:
    """Each is reported within a second, by how much the load changed, with its stamp."""
    robot = Robot(PayloadStage(bundle('strain'), 0.0))
    robot.go(4.0, 0.0)
    assert robot.go(4.0, 0.25) == pytest.approx(0.25, abs=0.02)
    assert robot.go(4.0, 0.0) == pytest.approx(0.0, abs=0.02)
    (up, first), (down, second) = robot.found
    assert 4.0 < up < 5.0 and 8.0 < down < 9.0
    assert first.change == pytest.approx(0.25, abs=0.03) == -second.change
    assert first.mass == pytest.approx(0.25, abs=0.03)
    assert first.stamp == robot.begin + round(up * 1e9)


def test_an_announced_load_is_no_event() -> None:
    """It is followed as it comes, touched or not, and nothing is reported."""
    stage = PayloadStage(bundle('strain'), 0.0)
    robot = Robot(stage)
    robot.go(4.0, 0.0)
    stage.expect()
    assert robot.go(2.0, 0.25, touched=True) == pytest.approx(0.25, abs=0.03)
    assert not robot.found


def test_a_touch_is_no_load() -> None:
    """A moment that stays as it is leaves the mass where it was, and after it as well."""
    robot = Robot(PayloadStage(bundle('strain'), 0.0))
    robot.go(4.0, 0.1)
    assert robot.go(3.0, 0.1, touched=True, push=(40.0, -60.0)) == pytest.approx(0.1, abs=0.02)
    assert robot.go(3.0, 0.1) == pytest.approx(0.1, abs=0.02)
    assert not robot.found


def test_gaps_and_clocks() -> None:
    """After a gap the mass is still known; after a clock that was set back nothing is."""
    stage = PayloadStage(bundle('strain'), 0.0)
    Robot(stage).go(4.0, 0.3)
    later = Robot(stage, begin=10**11)
    assert later.go(0.1, 0.3) == pytest.approx(0.3, abs=0.02) and not later.found
    missing = stage.step(10**12, DT, MOTION[0], np.full(2, np.nan), touched=False)
    assert missing is None and stage.mass == pytest.approx(0.3, abs=0.02)
    unsure = stage.std
    Robot(stage, begin=0).go(0.02, 0.0)
    assert stage.std > 5.0 * unsure


def test_noise_of_a_model() -> None:
    """What its training left, where the bundle says so in numbers; else a part of its size."""
    known = bundle('strain')
    model = known.models['strain']['analytical']
    assert isinstance(model, AnalyticalModel)
    worth = LoadWorth(known.arm, 'strain', model)
    assumed = rigid_noise({}, 'strain', model, worth)
    assert assumed == pytest.approx(0.05 * 0.4 * worth.typical)

    def facts(value: object) -> dict[str, object]:
        return {'strain': {'analytical': {'training': {'channels': {
            name: {'rmse': value} for name in model.channels}}}}}
    assert rigid_noise({'validation': facts(7.0)}, 'strain', model, worth).tolist() == [7.0, 7.0]
    both = {'validation': facts(7.0), 'causal_validation': facts(9.0)}
    assert rigid_noise(both, 'strain', model, worth).tolist() == [9.0, 9.0]
    for strange in (0.0, float('nan'), 'seven', None):
        assert np.array_equal(rigid_noise({'validation': facts(strange)}, 'strain', model, worth),
                              assumed)
