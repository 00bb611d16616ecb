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

"""What a monitor listens to: methods that are asked for, served, and have thresholds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from payload_making import LOAD, moving, payload_bundle, PICKED_UP, true_outputs, two_gauge_arm
import pytest
from sample_arms import multisine
from threshold_making import ringing

from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.errors import ModelError
from tudor_dynamics.load.live import carried_load, PayloadStage
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import load_bundle, ModelBundle
from tudor_dynamics.models.regressor import EffortRegressor, StrainRegressor
from tudor_dynamics.online.monitor import Monitor, MonitorSettings
from tudor_dynamics.online.threshold_learning import learn_thresholds, thresholds_to_dict


@pytest.fixture(scope='module')
def bundle() -> ModelBundle:
    """Give rigid models of efforts and strains, without thresholds."""
    arm = two_gauge_arm()
    motion = multisine(np.arange(0.0, 60.0, 0.05), 2, 1)
    truth = true_outputs(arm, motion, 0.0)
    return ModelBundle(arm, PreprocessingSpec(filter='causal'), {
        output: {'analytical': AnalyticalModel(regressor, 2).fit(motion, truth[output])}
        for output, regressor in (('effort', EffortRegressor(arm)),
                                  ('strain', StrainRegressor(arm, 'paper')))})


def with_thresholds(bundle: ModelBundle, method: str, channels: tuple[str, ...]) -> ModelBundle:
    """Add the thresholds of one method."""
    learned = thresholds_to_dict(learn_thresholds([ringing(30, 1)], channels))
    return replace(bundle, facts={'thresholds': {method: {'analytical': learned}}})


def test_methods_are_those_with_thresholds_or_all_that_are_served(bundle: ModelBundle) -> None:
    """An arm without gauges, or a model without thresholds, needs no setting of its own."""
    every = MonitorSettings(methods=())
    assert Monitor(bundle, every).watch.methods == ('strain', 'effort', 'momentum')
    known = with_thresholds(bundle, 'effort', ('j1', 'j2'))
    watch = Monitor(known, every).watch
    assert watch.methods == ('effort',) and list(watch.stages) == ['effort']
    assert watch.outputs == ('effort',)
    assert Monitor(known, MonitorSettings(methods=('strain', 'effort'))).watch.methods == (
        'strain', 'effort')


def test_what_the_model_does_not_serve_is_left_out(bundle: ModelBundle) -> None:
    """The momentum observer is always of the analytical model; a name that is none is refused."""
    efforts = replace(bundle, models={'effort': bundle.models['effort']})
    asked = MonitorSettings(methods=('strain', 'momentum'))
    assert Monitor(efforts, asked).watch.methods == ('momentum',)
    with pytest.raises(ModelError, match="unknown methods .'touch'"):
        Monitor(bundle, MonitorSettings(methods=('touch',)))


def test_a_load_needs_a_method_that_listens_to_its_output(bundle: ModelBundle) -> None:
    """It is refused where none does, and followed by the residuals of one that does."""
    stage = PayloadStage(replace(bundle, models={'effort': bundle.models['effort']}), 0.0)
    with pytest.raises(ModelError, match='effort.*add effort to methods'):
        Monitor(bundle, MonitorSettings(methods=('strain',)), payload=stage)
    monitor = Monitor(bundle, MonitorSettings(methods=('effort',)), payload=stage)
    motion = multisine(np.arange(0.0, 14.0, 0.01), 2, 5)
    heavier = true_outputs(bundle.arm, motion, 0.3)['effort']
    for k, row in enumerate(motion):
        monitor.add_joints(10_000_000 * (k + 1), row[:2])
        monitor.add_measured('effort', 10_000_000 * (k + 1), heavier[k])
    assert stage.mass == pytest.approx(0.3, abs=0.05)


@pytest.mark.parametrize('source', ['estimate', 'topic'])
@pytest.mark.parametrize('waiting', [1, 4, 24])
def test_a_load_counts_for_samples_that_wait(tmp_path: Path, source: str, waiting: int) -> None:
    """However many wait for their strains while a load becomes known, it is no second event."""
    whole, seen = load_bundle(payload_bundle(tmp_path / 'model')), moving(6.0)
    assert seen.dq is not None and seen.strain is not None
    monitor = Monitor(whole.at(0.0), MonitorSettings(), payload=carried_load(source, whole, 0.0))
    said, known, onsets = round((PICKED_UP + 0.5) * 100.0), None, []
    for first in range(0, len(seen.stamp), waiting):
        part = range(first, min(first + waiting, len(seen.stamp)))
        for k in part:
            monitor.add_joints(int(seen.stamp[k]), seen.q[k], seen.dq[k])
        if source == 'topic' and first <= said < first + waiting:
            monitor.watch.answer(LOAD, 0.0, 0.0)
        for k in part:
            found = monitor.add_measured('strain', int(seen.stamp[k]), seen.strain[k])
            onsets += [event.onset for event in found.events]
            known = found.loads[0].mass if found.loads else known
    assert known == pytest.approx(LOAD, abs=0.03)
    assert [1e-9 * (onset - int(seen.stamp[0])) for onset in onsets] == [
        pytest.approx(PICKED_UP, abs=0.02)]


def test_the_rate_of_alarms_is_shared_among_methods(bundle: ModelBundle) -> None:
    """Two methods with thresholds allow half of the alarms each."""
    one = with_thresholds(bundle, 'effort', ('j1', 'j2'))
    two = replace(one, facts={'thresholds': {
        **one.facts['thresholds'],
        **with_thresholds(bundle, 'strain', ('g1', 'g2')).facts['thresholds']}})
    alone, both = (Monitor(known, MonitorSettings(methods=())).watch for known in (one, two))
    assert alone.stages['effort'].rates.collision == 1.0
    assert [stage.rates.collision for stage in both.stages.values()] == [0.5, 0.5]
    assert both.settle == pytest.approx(alone.settle)
