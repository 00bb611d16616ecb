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

"""Single experiments behind figures: a move with and without damping, gauges, the L."""

from __future__ import annotations

from typing import Any

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.arm.limits import free_of_positions
from tudor_dynamics.reproduction.lshape import run_paper
from tudor_dynamics.reproduction.plan import arm_content, Campaign, grams
from tudor_dynamics.reproduction.result_cache import Cached, RECORDING
from tudor_dynamics.signals.motion_profile import follow_targets, motion_limits
from tudor_dynamics.simulation.loop.closed_loop import ClosedLoop
from tudor_dynamics.simulation.loop.drive import Imperfections
from tudor_dynamics.simulation.loop.stimulus_motion import stimulus_motion, stimulus_seeds
from tudor_dynamics.simulation.studies.plots import pick_signal, spectrum
from tudor_dynamics.typing import FloatArray

EXPERIMENT = (*RECORDING, 'reproduction/experiments.py', 'reproduction/lshape.py')
"""Parts of the package that these depend on."""
MOVE = (45.0, -45.0)
"""Move that shows the damping, from stretched out and horizontal [deg]."""
MOVE_AT = 1.0
MOVE_SECONDS = 9.0
JOINT = 1e-6
"""Distance of a gauge that is at its joint [m]."""
LSHAPE = ('effort:motor', 'acceleration:motor', 'acceleration:tip', 'moment:corner')


def damping_move(campaign: Campaign, payload: float) -> Cached:
    """
    Move two joints at once, with and without damping, as in Figure 2 of Malzahn et al.

    Parameters
    ----------
    campaign : Campaign
        Arm and stages.
    payload : float
        Mass at the tip [kg].

    Returns
    -------
    Cached
        ``t`` [s], ``end`` of the reference [s], and for ``damped`` and ``undamped`` ``_q`` [rad],
        ``_strain`` [units of the gauges] and ``_current`` [A]; ``q_ref`` [rad].

    """
    def make() -> Cached:
        arrays: dict[str, FloatArray] = {}
        for name, damping in (('damped', 1.0), ('undamped', 0.0)):
            # The paper's move begins below the range of its stimuli.
            loop = ClosedLoop(free_of_positions(campaign.carrying(payload)), damping=damping,
                              seed=1)
            n = len(campaign.arm.active_joints)
            start = np.zeros(n)
            loop.reset(start)
            targets = [np.radians([MOVE[i] if i < len(MOVE) else 0.0]) for i in range(n)]
            reference = follow_targets(start, [np.array([MOVE_AT])] * n, targets,
                                       motion_limits(campaign.arm), loop.dt,
                                       int(MOVE_SECONDS / loop.dt))
            seen = loop.run(reference.q, reference.dq, every=4)
            arrays |= {'t': seen.t, 'q_ref': seen.q_ref, f'{name}_q': seen.q,
                       f'{name}_strain': seen.strain, f'{name}_current': seen.current}
            moving = np.flatnonzero(np.abs(seen.dq_ref).max(axis=1) > 1e-9)
        return Cached({'end': float(arrays['t'][moving[-1]])}, arrays)

    return _staged(campaign, f'move_{grams(payload)}', {'payload': payload, 'move': MOVE}, make)


def _staged(campaign: Campaign, name: str, depends: dict[str, Any], make: Any) -> Cached:
    text = name.replace('_', ' ')
    campaign.progress(text, 0.0)
    result = campaign.stages.result(name, {'arm': arm_content(campaign.arm), **depends}, make,
                                    EXPERIMENT)
    campaign.progress(text, 1.0)
    return result


def _at_joints(arm: Arm) -> Arm:
    """Move all gauges but those that the damper needs to their joints."""
    assert arm.spec.damper is not None
    used = {item.gauge for item in arm.spec.damper.joints}
    gauges = tuple(gauge if gauge.name in used else gauge.model_copy(update={'distance': JOINT})
                   for gauge in arm.gauges)
    spec = arm.spec.model_copy(update={'gauges': gauges})
    return Arm(spec, arm.full_model, arm.source, arm.urdf)


def gauge_moments(campaign: Campaign, payload: float) -> Cached:
    """
    Compare the bending moments at the gauges with those at the joints before them.

    The paper takes their difference, Delta tau of its Eq. (12), for constant.

    Parameters
    ----------
    campaign : Campaign
        Arm with a gauge beside the damper's on each link, and stages.
    payload : float
        Mass at the tip [kg].

    Returns
    -------
    Cached
        ``t`` [s], and for each joint ``JOINT_0`` and ``JOINT_DISTANCE in mm``: bending moments at
        the joint and at its gauges [N m].

    """
    plan = campaign.plan

    def make() -> Cached:
        arm = campaign.carrying(payload)
        gain = {sensor.gauge: sensor.gain for sensor in arm.spec.sensors}
        arrays: dict[str, FloatArray] = {}
        for variant in (arm, _at_joints(arm)):
            loop = ClosedLoop(variant, imperfections=Imperfections.none())
            motion = stimulus_seeds(plan.seed + round(1000 * payload), 0)[0]
            reference = stimulus_motion(arm, 'aprbs', min(plan.seconds, 40.0), motion, loop.dt)
            loop.reset(reference.q[0])
            seen = loop.run(reference.q, reference.dq, every=20)
            arrays['t'] = seen.t
            for index, gauge in enumerate(variant.gauges):
                name = f'{gauge.joint}_{1000 * gauge.distance:.0f}'
                arrays[name] = seen.strain[:, index] / gain[gauge.name]
        return Cached({}, arrays)

    return _staged(campaign, 'gauge_moments',
                   {'payload': payload, 'seed': plan.seed, 'seconds': plan.seconds}, make)


def l_shape_run(campaign: Campaign) -> Cached:
    """
    Repeat the experiment of Gasparetto et al. on the L-shaped mechanism.

    Returns
    -------
    Cached
        ``t`` [s], and for each of `LSHAPE` its curves, ``SIGNAL spectrum`` and ``f`` [Hz]; labels
        and units in ``content[SIGNAL]``.

    """
    def make() -> Cached:
        plant, run = run_paper(2, 2.5e-4)
        arrays: dict[str, FloatArray] = {'t': run.t}
        content: dict[str, Any] = {}
        for name in LSHAPE:
            signal = pick_signal(run, plant.mechanism, (), name)
            arrays[name] = signal.values
            arrays['f'], arrays[f'{name} spectrum'] = spectrum(
                signal.values, float(run.t[1] - run.t[0]))
            content[name] = {'labels': list(signal.labels), 'unit': signal.unit}
        return Cached(content, arrays)

    return _staged(campaign, 'lshape', {}, make)
