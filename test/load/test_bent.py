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

"""Links that bend: found from motion, kept in facts, used sample by sample."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
import json

import numpy as np
from payload_making import true_outputs, two_gauge_arm
import pytest
from sample_arms import multisine, recording_of

from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.errors import ModelError
from tudor_dynamics.load.bending import (
    bends, bent_links, BentLinks, FACT, find_bending, links_of, relearned, smoothed, Watched)
from tudor_dynamics.load.live import BentSense
from tudor_dynamics.load.offline import estimate_payload, PayloadEstimate
from tudor_dynamics.load.rows import LoadWorth
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.regressor import PayloadRegressor, StrainRegressor
from tudor_dynamics.signals.preprocessing import prepare, Stretch

DT, BENDING = 0.01, np.array([[-2e-4, 0.0], [-3e-4, -5e-4]])


def bent_motion(seconds: float, payload: float, seed: int, *, rigid: bool = False) -> Watched:
    """Give motors and strains of links that turn by their strains."""
    t = np.arange(0.0, seconds, DT)
    links = multisine(t, 2, seed)
    strain = true_outputs(two_gauge_arm(), links, payload)['strain']
    motors = links[:, :2] - (0.0 if rigid else strain @ BENDING.T)
    noise = np.random.default_rng(seed).standard_normal(strain.shape)
    return Watched(np.full(len(t), DT), motors, strain + (20.0 if rigid else 0.5) * noise, payload)


def model() -> AnalyticalModel:
    """Give a model that is not fitted yet."""
    arm = two_gauge_arm()
    return AnalyticalModel(PayloadRegressor(StrainRegressor(arm, 'paper'), arm, (0.0, 0.4)), 2)


@lru_cache
def found() -> BentLinks:
    """Find how links bend, with 0 and 400 g."""
    bent = find_bending(two_gauge_arm(), model(),
                        [bent_motion(40.0, m, k) for k, m in enumerate((0.0, 0.4))])
    assert bent is not None
    return bent


def test_found() -> None:
    """Angles per strain are those of the links, each gauge turns its joint and the next one."""
    assert found().bending == pytest.approx(BENDING, abs=3e-5)
    assert bends(two_gauge_arm()).tolist() == [[True, False], [True, True]]
    # strains of hundreds, of which curved motion after linear filters keeps a little
    assert np.sqrt(np.diag(found().density)).max() < 2.5


def test_rigid_links_do_not_bend() -> None:
    """Where nothing is gained there is nothing; nor in too little motion."""
    arm = two_gauge_arm()
    assert find_bending(arm, model(), [bent_motion(20.0, m, k, rigid=True)
                                       for k, m in enumerate((0.0, 0.4))]) is None
    assert find_bending(arm, model(), [bent_motion(0.6, 0.0, 1)]) is None
    assert find_bending(arm, model(), []) is None


def test_kept() -> None:
    """Through plain values it is the same; what is impossible is refused."""
    arm, bent = two_gauge_arm(), found()
    content = json.loads(json.dumps(bent.as_dict(arm)))
    again = bent_links({FACT: content}, arm)
    assert again is not None and again.cutoff == bent.cutoff
    assert np.array_equal(again.bending, bent.bending)
    assert again.model.coefficients() == pytest.approx(bent.model.coefficients())
    assert bent_links({}, arm) is None
    nothing = [[float('nan')] * 2] * 2
    for key, value in (('cutoff', 0.0), ('bending', [[1.0]]), ('bending', 'x'),
                       ('density', [[1.0, 2.0], [2.0, 1.0]]), ('density', nothing),
                       ('model', {'groups': 3})):
        with pytest.raises(ModelError):
            bent_links({FACT: {**content, key: value}}, arm)
    with pytest.raises(ModelError):
        bent_links({FACT: [1]}, arm)


@pytest.mark.parametrize('every', [1, 5])
def test_sensed(every: int) -> None:
    """What is left over is the load times what a kilogram adds, at other rates as well."""
    arm, bent = two_gauge_arm(), found()
    sense = BentSense(bent, LoadWorth(arm, 'strain', bent.model), 0.1)
    watched = bent_motion(6.0, 0.3, 7)
    t = np.arange(0.0, 5.9, DT / every)
    q, strain = (np.column_stack([np.interp(t, np.arange(600) * DT, column) for column in x.T])
                 for x in (watched.q, watched.strain))
    sensed = [sense.step(DT / every, np.concatenate([row, np.zeros(4)]), reading)
              for row, reading in zip(q, strain, strict=True)]
    assert sensed[0] is None and sensed[-1] is not None
    kept = [item for item in sensed if item is not None]
    left = np.array([item[0] for item in kept]).ravel()
    worth = np.array([item[1] for item in kept]).ravel()
    assert left @ worth / (worth @ worth) == pytest.approx(0.2, abs=0.005)
    assert sense.step(0.0, np.zeros(6), strain[0]) is None


def stretches(watched: Watched) -> list[Stretch]:
    """Give the same recording as models of rigid links take it."""
    return prepare(recording_of(watched.q, 1.0 / DT, strain=watched.strain), PreprocessingSpec())


@lru_cache
def rigid() -> AnalyticalModel:
    """Fit rigid links to the motors of those that bend, with 0 and 400 g."""
    motion, strain = [], []
    for k, mass in enumerate((0.0, 0.4)):
        for item in stretches(bent_motion(40.0, mass, k)):
            kept = item.decimation.keep
            motion.append(np.column_stack([item.motion[kept], np.full(len(kept), mass)]))
            strain.append(item.decimation(item.strain))
    return model().fit(np.vstack(motion), np.vstack(strain))


def test_recordings() -> None:
    """Of a recording the load is told by where links are; without it, by where motors are."""
    arm, masses = two_gauge_arm(), (0.1, 0.2, 0.3)

    def told(mass: float, seed: int, bent: BentLinks | None, least: float) -> PayloadEstimate:
        watched = bent_motion(30.0, mass, seed)
        return estimate_payload(arm, {'strain': rigid()}, stretches(watched), bent=bent, watched=[
            replace(watched, dt=watched.dt[:round(least / DT)], q=watched.q[:round(least / DT)],
                    strain=watched.strain[:round(least / DT)])])
    bent = [told(mass, 20 + k, found(), 30.0) for k, mass in enumerate(masses)]
    motors = [told(mass, 20 + k, None, 30.0) for k, mass in enumerate(masses)]
    assert all(item.outputs[0].bent for item in bent) and not motors[0].outputs[0].bent
    off, others = (np.array([item.mass for item in each]) - masses for each in (bent, motors))
    assert np.abs(off).max() < 2.5e-3 and np.abs(others).max() > 0.1
    assert bent[0].outputs[0].after < 0.3 * motors[0].outputs[0].after
    # where the filter never settles, motors are what there is
    assert told(0.1, 20, found(), 0.4).mass == motors[0].mass


def test_learned_anew() -> None:
    """Another part of the motion gives another model of links that bend as before."""
    part = [bent_motion(20.0, m, 30 + k) for k, m in enumerate((0.0, 0.4))]
    again = relearned(found(), part)
    assert again.bending is found().bending
    ours, theirs = again.model.coefficients(), found().model.coefficients()
    assert not np.array_equal(ours, theirs) and ours == pytest.approx(theirs, rel=0.2, abs=2.0)
    item = smoothed(part[:1], again.cutoff)[0]
    left = item.strain - again.model.at(0.0).predict(links_of(item.states, again.bending))
    assert np.abs(left).max() < 0.02 * np.ptp(item.strain)
