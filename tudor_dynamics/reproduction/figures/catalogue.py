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

"""All figures with their captions, and the page that shows them."""

from __future__ import annotations

from dataclasses import dataclass
import json
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from tudor_dynamics.reproduction import experiments
from tudor_dynamics.reproduction.figures import gasparetto, malzahn, own
from tudor_dynamics.reproduction.figures.pictures import draw, Picture
from tudor_dynamics.reproduction.fits import Fits
from tudor_dynamics.reproduction.judging import read
from tudor_dynamics.reproduction.pages import render, write_file
from tudor_dynamics.reproduction.plan import grams
from tudor_dynamics.reproduction.pushes import collisions
from tudor_dynamics.reproduction.result_cache import Cached
from tudor_dynamics.reproduction.table1 import build

MALZAHN = 'Malzahn, Reinhart, Bertram: dynamics identification of a damped arm'
GASPARETTO = 'Gasparetto et al.: L-shaped mechanism'
OWN = 'Beyond the papers'
SECTIONS = (MALZAHN, GASPARETTO, OWN)


@dataclass(frozen=True, eq=False)
class Gallery:
    """
    All figures.

    Attributes
    ----------
    pictures : tuple of Picture
        In the order of the page.
    data : dict
        Figures in numbers: ``fit`` [%] on test recordings by payload, damping, output and model,
        and ``collisions`` by method.

    """

    pictures: tuple[Picture, ...]
    data: dict[str, Any]


def gallery(fits: Fits) -> Gallery:
    """
    Compute what the figures show, or read what was computed before.

    Parameters
    ----------
    fits : Fits
        Stages that the figures are made of.

    Returns
    -------
    Gallery
        Figures and numbers.

    """
    campaign = fits.campaign
    plan, arm = campaign.plan, campaign.arm
    heavy = max(plan.payloads)
    middle = sorted(plan.payloads)[len(plan.payloads) // 2]
    damped, undamped = (
        {payload: fits.separate(payload, damped=on) for payload in plan.payloads}
        for on in (True, False))
    paper = fits.separate(heavy, strain_form='paper', kinds=('analytical',))
    table = build(fits, 'stimulus')
    moves = {payload: experiments.damping_move(campaign, payload) for payload in (middle, heavy)}
    moments = experiments.gauge_moments(campaign, heavy)
    found = collisions(fits, middle)
    lshape = experiments.l_shape_run(campaign)
    two = read(campaign.carrying(heavy), campaign.record(heavy)[:2])
    weight = f'{1000 * heavy:.0f} g'
    result = [
        Picture('malzahn_2_damping', MALZAHN, 'Figure 2: damping',
                f'Both joints move at once, from (0, 0) to ({experiments.MOVE[0]:g}, '
                f'{experiments.MOVE[1]:g}) deg, with and without strain feedback; shaded: the '
                'reference moves. The joint yields to the link for a moment, which is what '
                'damps it. The move begins below the limits of position, which are lifted '
                'for it.', lambda: malzahn.damping(arm, moves)),
        Picture('malzahn_5_stimuli', MALZAHN, 'Figure 5: responses to two stimuli',
                f'Angle, velocity and acceleration of {arm.active_joints[0]} during two APRBS '
                f'stimuli with {weight}, filtered as the models are given them.',
                lambda: malzahn.stimuli(arm, two)),
        Picture('malzahn_6_strain', MALZAHN, f'Figure 6: strain with {weight}',
                'A stretch of a stimulus that the models have not seen, and the residuals; in '
                'brackets the fit of the channel over all test stimuli.',
                lambda: malzahn.measured_and_predicted(arm, 'strain', damped[heavy])),
        Picture('malzahn_7_current', MALZAHN, f'Figure 7: current with {weight}',
                'As before, for the motor currents. Most of what is left over is friction at '
                'standstill and reversal.',
                lambda: malzahn.measured_and_predicted(arm, 'effort', damped[heavy]))]
    for number, signal, spectrum in ((4, 'effort:motor', False), (5, 'acceleration:motor', False),
                                     (6, 'acceleration:motor', True),
                                     (7, 'acceleration:tip', False),
                                     (8, 'acceleration:tip', True), (9, 'moment:corner', False)):
        def drawn(signal: str = signal, *, spectrum: bool = spectrum) -> Figure:
            chosen = gasparetto.over_frequency if spectrum else gasparetto.over_time
            return chosen(lshape, signal)
        what = gasparetto.LABELS[signal] + (', over frequency' if spectrum else '')
        result.append(Picture(
            f'gasparetto_{number}', GASPARETTO, f'Figure {number}: {what}',
            'From 135 deg (from hanging) to about 30 deg by two opposite steps of torque.'
            if number == 4 else 'In global axes; axes in which nothing happens are left out.'
            if signal.startswith('acceleration') else 'In the axes of the beam.', drawn))
    result += [
        Picture('own_damping', OWN, 'Fit with and without damping',
                'Models learned from half of the stimuli and judged by the other half, for each '
                'payload, with the damper and without it. The same motions in both cases.',
                lambda: own.with_and_without_damping(damped, undamped)),
        Picture('own_one_model', OWN, 'One model for all payloads',
                f'Fitted at {1000 * table.trained_at[0]:.0f} and {1000 * table.trained_at[1]:.0f} '
                'g only (dotted lines), beside a model for each payload. The parameters of the '
                'analytical model are affine in the payload, so it knows the payloads between; '
                'to the ELM the payload is an input of which it has seen two values.',
                lambda: own.one_model(table.shared, table.trained_at)),
        Picture('own_collisions', OWN, 'Strain and current as collision detectors',
                f'{1000 * middle:.0f} g; {_pushes(found)} pushes of 2 to 6 N and 0.1 to 0.5 s, '
                'anywhere on the links and in any direction across them (so that some hardly load '
                'a gauge), during random motion. '
                'Left: pushes found over false alarms while the threshold varies. Right: how '
                'soon. The elastic model is corrected by its observer.',
                lambda: own.collisions(found)),
        Picture('own_strain_forms', OWN, "The paper's strain regressor and the exact one",
                f"{weight}. Left: the paper takes the difference Δτ between the joint's moment "
                'and that at the gauge for constant; it is not. Right: taken literally, with one '
                'scale and one offset, that costs a part of the moment even without noise '
                '(triangles: against the true moment). With parameters of its own for each gauge, '
                'as identified, the regression makes up for it, and both forms predict the '
                'measured strain alike (circles); only the parameters of the exact form are '
                'those of the part beyond the gauge.',
                lambda: own.strain_forms(arm, moments, damped[heavy], paper))]
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
    """
    Draw figures as SVG and PNG, and write the page with all of them and their numbers.

    Parameters
    ----------
    chosen : Gallery
        Figures to be written.
    arm : str
        Name of the arm.
    out : Path
        Directory for page and pictures.

    Returns
    -------
    list of str
        Names of the figures.

    """
    shown = draw(chosen.pictures, out)
    write_file(out / 'index.html', render('figures.html.j2', arm=arm, sections=SECTIONS,
                                          figures=shown,
                                          table=(out / 'table1.html').is_file()))
    write_file(out / 'figures.json', json.dumps(chosen.data, indent=1) + '\n')
    return [picture.name for picture in chosen.pictures]
