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

"""All figures with their captions, the single experiments that some show, and their page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
import json
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
import numpy as np
from papers import drawings
from papers.campaign import (
    arm_content, Cached, Campaign, FloatArray, grams, KINDS, stimulus_seeds, write_file)
from papers.fits import collisions, Fits
from papers.look import draw, Picture, render, table_lines
from papers.lshape import run_paper
from papers.table1 import build
import tudor_dynamics as td

MALZAHN = 'Malzahn, Reinhart, Bertram: dynamics identification of a damped arm'
GASPARETTO = 'Gasparetto et al.: L-shaped mechanism'
OWN = 'Beyond the papers'
SECTIONS = (MALZAHN, GASPARETTO, OWN)
MOVE = (45.0, -45.0)
"""Move that shows the damping, from stretched out and horizontal [deg]."""
MOVE_AT = 1.0
MOVE_SECONDS = 9.0
JOINT = 1e-6
"""Distance of a gauge that is at its joint [m]."""


def free_of_positions(arm: td.Arm) -> td.Arm:
    """Take the limits of position away, for motions that begin or end beyond them."""
    none = {'lower': None, 'upper': None}
    joints = {joint.name: {key: value.model_copy(update=none) for key, value in (
        ('limits', joint.limits), ('planned', joint.planned)) if value is not None}
        for joint in arm.spec.joints}
    model = arm.full_model.copy()
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -np.inf, np.inf
    return replace(arm.with_joints(joints), full_model=model)


def damping_move(campaign: Campaign, payload: float) -> Cached:
    """Move two joints at once, with and without damping, as in Figure 2 of Malzahn et al."""
    def make() -> Cached:
        arrays: dict[str, FloatArray] = {}
        for name, damping in (('damped', 1.0), ('undamped', 0.0)):
            # The paper's move begins below the range of its stimuli.
            loop = td.ClosedLoop(free_of_positions(campaign.carrying(payload)), damping=damping,
                                 seed=1)
            n = len(campaign.arm.active_joints)
            start = np.zeros(n)
            loop.reset(start)
            targets = [np.radians([MOVE[i] if i < len(MOVE) else 0.0]) for i in range(n)]
            reference = td.follow_targets(start, [np.array([MOVE_AT])] * n, targets,
                                          td.motion_limits(campaign.arm), loop.dt,
                                          int(MOVE_SECONDS / loop.dt))
            seen = loop.run(reference.q, reference.dq, every=4)
            arrays |= {'t': seen.t, 'q_ref': seen.q_ref, f'{name}_q': seen.q,
                       f'{name}_strain': seen.strain, f'{name}_current': seen.current}
            moving = np.flatnonzero(np.abs(seen.dq_ref).max(axis=1) > 1e-9)
        return Cached({'end': float(arrays['t'][moving[-1]])}, arrays)

    return _staged(campaign, f'move_{grams(payload)}', {'payload': payload, 'move': MOVE}, make)


def _staged(
    campaign: Campaign, name: str, depends: dict[str, Any], make: Callable[[], Cached],
) -> Cached:
    text = name.replace('_', ' ')
    campaign.progress(text, 0.0)
    result = campaign.stages.result(name, {'arm': arm_content(campaign.arm), **depends}, make)
    campaign.progress(text, 1.0)
    return result


def _at_joints(arm: td.Arm) -> td.Arm:
    """Move all gauges but those that the damper needs to their joints."""
    assert arm.spec.damper is not None
    used = {item.gauge for item in arm.spec.damper.joints}
    gauges = tuple(gauge if gauge.name in used else gauge.model_copy(update={'distance': JOINT})
                   for gauge in arm.gauges)
    return arm.changed(gauges=gauges)


def gauge_moments(campaign: Campaign, payload: float) -> Cached:
    """
    Compare the bending moments at the gauges with those at the joints before them.

    The paper takes their difference, Delta tau of its Eq. (12), for constant.

    """
    plan = campaign.plan

    def make() -> Cached:
        arm = campaign.carrying(payload)
        gain = {sensor.gauge: sensor.gain for sensor in arm.spec.sensors}
        arrays: dict[str, FloatArray] = {}
        for variant in (arm, _at_joints(arm)):
            loop = td.ClosedLoop(variant, imperfections=td.Imperfections.none())
            motion = stimulus_seeds(plan.seed + round(1000 * payload), 0)[0]
            reference = td.stimulus_motion(arm, min(plan.seconds, 40.0), motion, loop.dt)
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
    """Repeat the experiment of Gasparetto et al. on the L-shaped mechanism."""
    def make() -> Cached:
        run = run_paper(2, 2.5e-4)
        arrays: dict[str, FloatArray] = {'t': run.run.t}
        content: dict[str, Any] = {}
        for name in drawings.SIGNALS:
            signal = run.curves(name)
            arrays[name] = signal.values
            arrays['f'], arrays[f'{name} spectrum'] = run.spectrum(name)
            content[name] = {'labels': list(signal.labels), 'unit': signal.unit}
        return Cached(content, arrays)

    return _staged(campaign, 'lshape', {}, make)


@dataclass(frozen=True, eq=False)
class Gallery:
    """All figures."""

    pictures: tuple[Picture, ...]  # in the order of the page
    # figures in numbers: fit [%] on test recordings by payload, damping, output and model, and
    # collisions by method
    data: dict[str, Any]


def gallery(fits: Fits) -> Gallery:
    """Compute what the figures show, or read what was computed before."""
    campaign = fits.campaign
    plan, arm = campaign.plan, campaign.arm
    heavy = max(plan.payloads)
    middle = sorted(plan.payloads)[len(plan.payloads) // 2]
    damped, undamped = (
        {payload: fits.separate(payload, damped=on) for payload in plan.payloads}
        for on in (True, False))
    paper = fits.separate(heavy, strain_form='paper', kinds=('analytical',))
    table = build(fits, 'stimulus')
    moves = {payload: damping_move(campaign, payload) for payload in (middle, heavy)}
    moments = gauge_moments(campaign, heavy)
    found = collisions(fits, middle)
    lshape = l_shape_run(campaign)
    two = [td.read_recording(path, arm) for path in campaign.record(heavy)[:2]]
    weight = f'{1000 * heavy:.0f} g'
    result = [
        Picture('malzahn_2_damping', MALZAHN, 'Figure 2: damping',
                f'Both joints move at once, from (0, 0) to ({MOVE[0]:g}, '
                f'{MOVE[1]:g}) deg, with and without strain feedback; shaded: the '
                'reference moves. The joint yields to the link for a moment, which is what '
                'damps it. The move begins below the limits of position, which are lifted '
                'for it.', lambda: drawings.damping(arm, moves)),
        Picture('malzahn_5_stimuli', MALZAHN, 'Figure 5: responses to two stimuli',
                f'Angle, velocity and acceleration of {arm.active_joints[0]} during two APRBS '
                f'stimuli with {weight}, filtered as the models are given them.',
                lambda: drawings.stimuli(arm, two)),
        Picture('malzahn_6_strain', MALZAHN, f'Figure 6: strain with {weight}',
                'A stretch of a stimulus that the models have not seen, and the residuals; in '
                'brackets the fit of the channel over all test stimuli.',
                lambda: drawings.measured_and_predicted(arm, 'strain', damped[heavy])),
        Picture('malzahn_7_current', MALZAHN, f'Figure 7: current with {weight}',
                'As before, for the motor currents. Most of what is left over is friction at '
                'standstill and reversal.',
                lambda: drawings.measured_and_predicted(arm, 'effort', damped[heavy]))]
    for number, signal, spectrum in ((4, 'effort:motor', False), (5, 'acceleration:motor', False),
                                     (6, 'acceleration:motor', True),
                                     (7, 'acceleration:tip', False),
                                     (8, 'acceleration:tip', True), (9, 'moment:corner', False)):
        def drawn(signal: str = signal, *, spectrum: bool = spectrum) -> Figure:
            chosen = drawings.over_frequency if spectrum else drawings.over_time
            return chosen(lshape, signal)
        what = drawings.SIGNALS[signal] + (', over frequency' if spectrum else '')
        result.append(Picture(
            f'gasparetto_{number}', GASPARETTO, f'Figure {number}: {what}',
            'From 135 deg (from hanging) to about 30 deg by two opposite steps of torque.'
            if number == 4 else 'In global axes; axes in which nothing happens are left out.'
            if signal.startswith('acceleration') else 'In the axes of the beam.', drawn))
    result += [
        Picture('own_damping', OWN, 'Fit with and without damping',
                'Models learned from half of the stimuli and judged by the other half, for each '
                'payload, with the damper and without it. The same motions in both cases.',
                lambda: drawings.with_and_without_damping(damped, undamped)),
        Picture('own_one_model', OWN, 'One model for all payloads',
                f'Fitted at {1000 * table.trained_at[0]:.0f} and {1000 * table.trained_at[1]:.0f} '
                'g only (dotted lines), beside a model for each payload. The parameters of the '
                'analytical model are affine in the payload, so it knows the payloads between; '
                'to the ELM the payload is an input of which it has seen two values.',
                lambda: drawings.one_model(table.shared, table.trained_at)),
        Picture('own_collisions', OWN, 'Strain and current as collision detectors',
                f'{1000 * middle:.0f} g; {_pushes(found)} pushes of 2 to 6 N and 0.1 to 0.5 s, '
                'anywhere on the links and in any direction across them (so that some hardly load '
                'a gauge), during random motion. '
                'Left: pushes found over false alarms while the threshold varies. Right: how '
                'soon. The elastic model is corrected by its observer.',
                lambda: drawings.collisions(found)),
        Picture('own_strain_forms', OWN, "The paper's strain regressor and the exact one",
                f"{weight}. Left: the paper takes the difference Δτ between the joint's moment "
                'and that at the gauge for constant; it is not. Right: taken literally, with one '
                'scale and one offset, that costs a part of the moment even without noise '
                '(triangles: against the true moment). With parameters of its own for each gauge, '
                'as identified, the regression makes up for it, and both forms predict the '
                'measured strain alike (circles); only the parameters of the exact form are '
                'those of the part beyond the gauge.',
                lambda: drawings.strain_forms(arm, moments, damped[heavy], paper))]
    fitted = {grams(payload): {name: {
        output: {kind: item['test']['fit'] for kind, item in results[payload].content[
            output].items()} for output in ('strain', 'effort')}
        for name, results in (('damped', damped), ('undamped', undamped))}
        for payload in plan.payloads}
    scores = {method: item['score'] for method, item in found.content['methods'].items()}
    return Gallery(tuple(result), {'fit': fitted, 'collisions': scores})


def _pushes(found: Cached) -> int:
    methods = found.content['methods'].values()
    return max((len(item['pushes']) for item in methods), default=0)


def write_figures(chosen: Gallery, arm: str, out: Path) -> list[str]:
    """Draw figures as SVG and PNG, and write their page, their tables and their numbers."""
    shown = draw(chosen.pictures, out)
    write_file(out / 'index.html', render('figures.html.j2', arm=arm, sections=SECTIONS,
                                          figures=shown,
                                          table=(out / 'table1.html').is_file()))
    write_file(out / 'figures.md', markdown(chosen.data))
    write_file(out / 'figures.json', json.dumps(chosen.data, indent=1) + '\n')
    return [picture.name for picture in chosen.pictures]


def markdown(data: dict[str, Any]) -> str:
    """Write the fits without damping, and what each method detects, as tables."""
    names = [(output, kind) for output in ('strain', 'effort') for kind in KINDS]
    rows = [[name.replace('g', ' g'), *(
        f'{found[output][kind]:.1f}' if kind in (found := fits['undamped'])[output] else ''
        for output, kind in names)] for name, fits in data['fit'].items()]
    return '\n'.join([
        '# Fits on the test stimuli without damping [%]', '',
        *table_lines(('not damped', *(f'{output}: {KINDS[kind]}' for output, kind in names)),
                     rows),
        '', '# Pushes', '',
        *table_lines(('method', 'pushes found', 'median', 'false alarms'), [
            (method, f'{score["found"]} of {score["pushes"]}',
             '' if (late := score['latency_median']) is None else f'{1000 * late:.0f} ms',
             str(score['false_alarms']))
            for method, score in data['collisions'].items()]), ''])
