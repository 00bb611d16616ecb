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

"""Arrays that no call of the library can use are a TudorError; no NaN goes to a controller."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from payload_making import true_outputs, two_gauge_arm
import pytest
from sample_arms import random_states
import tudor_dynamics as td
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.mechanics.campaign import random_loads, random_pushes
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.regressor import EffortRegressor

ROOT = Path(__file__).parent.parent
NAN, Z, NUMBER = np.full(2, np.nan), np.zeros(2), float('nan')


@pytest.fixture(scope='module')
def made() -> dict[str, Any]:
    """Make objects of the library of small arms."""
    arm, motion = two_gauge_arm(), random_states(300, 2, 0)
    fitted = AnalyticalModel(EffortRegressor(arm), 2).fit(
        motion, true_outputs(arm, motion, 0.0)['effort'])
    bundle = td.ModelBundle(arm, PreprocessingSpec(), {'effort': {'analytical': fitted}})
    tudor = td.load_arm(ROOT / 'config' / 'tudor.yaml')
    mechanism = td.build_mechanism(tudor)
    loop = td.ClosedLoop(tudor)
    loop.reset(loop.described)
    return {'ff': td.Feedforward(bundle), 'bundle': bundle, 'arm': tudor, 'mechanism': mechanism,
            'plant': td.Plant(mechanism), 'limits': td.motion_limits(tudor), 'loop': loop,
            'link': td.load_arm(ROOT / 'config' / 'single_flexible_link.yaml')}


def path(made: dict[str, Any], **changes: Any) -> td.Trajectory:
    """Give a trajectory of which something is not as it has to be."""
    return td.Trajectory(**{'joints': made['ff'].joints, 't': np.arange(3.0),
                            'q': np.zeros((3, 2)), **changes})


def recorded(**changes: Any) -> td.Recording:
    """Give a recording of which something is not as it has to be."""
    return td.Recording(**{
        'path': '', 'stamp': np.arange(300) * 10**7, 'q': np.zeros((300, 2)), 'dq': None,
        'effort': None, 'strain': None, 'segments': (slice(0, 300),), 'dt': 0.01, **changes})


CALLS = {
    'efforts nan': lambda m: m['ff'].efforts(np.full((2, 6), np.nan)),
    'efforts inf': lambda m: m['ff'].efforts(np.full((2, 6), np.inf)),
    'efforts shape': lambda m: m['ff'].efforts(np.zeros((2, 5))),
    'efforts of one': lambda m: m['ff'].efforts(np.zeros(6)),
    'efforts text': lambda m: m['ff'].efforts('abc'),
    'carry': lambda m: m['ff'].carry(NUMBER),
    'along t': lambda m: m['ff'].along(path(m, t=np.array([0.0, np.nan, 2.0]))),
    'along t falls': lambda m: m['ff'].along(path(m, t=np.array([0.0, 2.0, 1.0]))),
    'along q': lambda m: m['ff'].along(path(m, q=np.full((3, 2), np.nan))),
    'along dq': lambda m: m['ff'].along(path(m, dq=np.full((3, 2), np.inf))),
    'along shape': lambda m: m['ff'].along(path(m, q=np.zeros((4, 2)))),
    'reset': lambda m: td.ClosedLoop(m['arm']).reset(NAN),
    'reset shape': lambda m: td.ClosedLoop(m['arm']).reset(np.zeros(5)),
    'step': lambda m: m['loop'].step(NAN, Z), 'step dq': lambda m: m['loop'].step(Z, NAN),
    'run': lambda m: m['loop'].run(np.full((9, 2), np.nan), np.zeros((9, 2))),
    'force': lambda m: m['loop'].set_force([np.nan, 0.0, 0.0]),
    'load': lambda m: m['loop'].set_payload(NUMBER),
    'plant reset': lambda m: m['plant'].reset(NAN), 'plant': lambda m: m['plant'].step(NAN),
    'plant shape': lambda m: m['plant'].step(np.zeros(9)),
    'plant dt': lambda m: td.Plant(m['mechanism'], NUMBER),
    'score': lambda m: td.score(np.full((9, 1), np.nan), np.zeros((9, 1)), ['a']),
    'score shape': lambda m: td.score(np.zeros((9, 1)), np.zeros((8, 1)), ['a']),
    'score names': lambda m: td.score(np.zeros((9, 1)), np.zeros((9, 1)), ['a', 'b']),
    'targets': lambda m: td.follow_targets(NAN, [Z[:1]] * 2, [Z[:1]] * 2, m['limits'], 0.1, 9),
    'switches': lambda m: td.follow_targets(Z, [NAN] * 2, [Z] * 2, m['limits'], 0.1, 9),
    'samples': lambda m: td.follow_targets(Z, [Z] * 2, [Z] * 2, m['limits'], 0.1, 10**12),
    'simulate': lambda m: td.simulate(m['link'], np.full(101, np.nan), seconds=0.1, dt=1e-3),
    'simulate f': lambda m: td.simulate(m['link'], lambda t: NUMBER, seconds=0.1, dt=1e-3),
    'monitor': lambda m: td.Monitor(m['bundle'], td.MonitorSettings(methods=('effort',))
                                    ).add_joints(10**9, np.zeros(5)),
    'load of an arm': lambda m: td.with_payload(m['arm'], NUMBER),
    'loads': lambda m: random_loads(1, NUMBER, 0.0, 0),
    'pushes': lambda m: random_pushes(m['arm'], m['mechanism'], 1, NUMBER, 0),
    'stimulus': lambda m: td.stimulus_motion(m['arm'], NUMBER, 0, 1e-3),
    'stimulus dt': lambda m: td.stimulus_motion(m['arm'], 10.0, 0, 1e-300),
    'stimulus dt 0': lambda m: td.stimulus_motion(m['arm'], 10.0, 0, 0.0),
    'prepare': lambda m: td.prepare(recorded(q=np.full((300, 2), np.nan)), PreprocessingSpec()),
    'prepare effort': lambda m: td.prepare(recorded(effort=np.zeros((9, 2))), PreprocessingSpec()),
}


@pytest.mark.parametrize('name', CALLS)
def test_refused(name: str, made: dict[str, Any]) -> None:
    """A short line says which argument it is."""
    with pytest.raises(td.TudorError) as caught:
        CALLS[name](made)
    assert str(caught.value).isprintable() and 10 < len(str(caught.value)) < 400
