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

"""``tudor reproduce lshape``: the L-shaped mechanism of Gasparetto et al. (2013)."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from tudor_dynamics.cli.console import print_json
from tudor_dynamics.errors import UsageError
from tudor_dynamics.files import open_regular
from tudor_dynamics.reproduction.lshape import agreement, l_shape, run_paper, run_reference
from tudor_dynamics.simulation.mechanics.mechanism import build_mechanism
from tudor_dynamics.simulation.plant.modes import modes
from tudor_dynamics.simulation.plant.plant import Plant
from tudor_dynamics.simulation.studies.animation import animate, check_target
from tudor_dynamics.simulation.studies.plots import pick_signal, plot_signal

FIGURES = (
    ('figure_4_torque.png', 'effort:motor', 'torque of the motor'),
    ('figure_5_6_elbow_acceleration.png', 'acceleration:motor', 'acceleration of the elbow'),
    ('figure_7_8_tip_acceleration.png', 'acceleration:tip', 'acceleration of the tip'),
    ('figure_9_moment_link2.png', 'moment:corner', 'moment in the middle of the second link'),
    ('angle.png', 'q:motor', 'angle of the motor, from hanging'),
)


def run(args: argparse.Namespace) -> int:
    """
    Repeat the experiment.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed options of the command.

    Returns
    -------
    int
        0; errors are raised.

    """
    if args.animate is not None:
        check_target(Path(args.animate))
    if not 1 <= args.elements <= 60 or not 0.0 < args.dt < 1.0:
        msg = (f'--elements {args.elements} and --dt {args.dt} do not make a run: 1 to 60 '
               'elements, and a step below a second')
        raise UsageError(msg)
    reference = _read_reference(Path(args.reference)) if args.reference is not None else None
    folder = Path(args.out)
    folder.mkdir(parents=True, exist_ok=True)
    plant, result = run_paper(args.elements, args.dt)
    result.save(folder / 'lshape.npz', joints=np.array(plant.mechanism.joints))
    for name, signal, title in FIGURES:
        plot_signal(folder / name, result, pick_signal(result, plant.mechanism, (), signal),
                    title=title)
    if args.animate is not None:
        animate(Path(args.animate), result, plant.mechanism)
    late = result.t > 1.5
    angle = np.degrees(result.q[:, 0])
    figures = {
        'clamped_hz': modes(plant, 8).frequency.tolist(),
        'hinged_hz': modes(plant, 8, ('motor',)).frequency.tolist(),
        'angle_start_deg': float(angle[0]), 'angle_after_steps_deg': float(angle[late].mean()),
        'torque_steps_nm': [float(result.effort[:, 0].min()), float(result.effort[:, 0].max())],
        'elbow_acceleration_peak': float(np.linalg.norm(
            result.acceleration[:, plant.mechanism.point('motor')], axis=1).max()),
        'tip_acceleration_peak': float(np.linalg.norm(
            result.acceleration[:, plant.mechanism.tip], axis=1).max()),
        'moment_link2_peak': float(np.abs(result.moment[:, 1]).max()),
    }
    if reference is not None:
        other = Plant(build_mechanism(l_shape(args.elements)), args.dt)
        found = agreement(run_reference(other, reference), other, reference)
        figures['reference'] = {
            'elbow_acceleration': found.elbow, 'tip_acceleration': found.tip,
            'moment_link1': found.moment1, 'moment_link2': found.moment2,
            'final_angle_deg': found.angle}
    if args.json:
        print_json(figures)
        return 0
    for name, value in figures.items():
        print(f'{name}: {_text(value)}')
    print(f'figures and lshape.npz are in {folder}')
    return 0


def _text(value: object) -> str:
    if isinstance(value, list):
        return ', '.join(f'{item:.4g}' for item in value)
    if isinstance(value, dict):
        return ', '.join(f'{key} {item:.4g}' for key, item in value.items())
    return f'{value:.4g}'


def _read_reference(path: Path) -> dict[str, np.ndarray]:
    needed = ('t', 'tau', 'elbow_acceleration', 'tip_acceleration', 'link1_mid_moment',
              'link2_mid_moment', 'hub_rot')
    try:
        with open_regular(path) as stream, np.load(stream, allow_pickle=False) as file:
            return {name: file[name] for name in needed}
    except (OSError, ValueError, KeyError) as err:
        msg = f'{path}: no reference computation ({err}); expected arrays {", ".join(needed)}'
        raise UsageError(msg) from None
