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

"""
The published test of the L-shaped mechanism, and a comparison with an independent computation.

Gasparetto et al., "Experimental validation of a dynamic model for lightweight robots" (2013): two
aluminium beams, one motor with a horizontal axis. The arm is held statically at 135 deg, two
opposite steps of torque take it down by about 105 deg, and it comes to rest near 30 deg. The paper
prints neither the torque nor the mass of the elbow; here the angle counts from the hanging arm,
the elbow is a cube of 30 mm with its screws and accelerometer, and the steps are tuned to the
angles.
"""

from __future__ import annotations

import argparse
import copy
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from papers.campaign import FloatArray
from papers.look import table_lines
from scipy.optimize import root
import tudor_dynamics as td

START, END = np.radians(135.0), np.radians(30.0)
STEP_AT, STEP_LENGTH = 0.5, 0.3  # s

FIGURES = (
    ('figure_4_torque.png', 'effort:motor', 'torque of the motor'),
    ('figure_5_6_elbow_acceleration.png', 'acceleration:motor', 'acceleration of the elbow'),
    ('figure_7_8_tip_acceleration.png', 'acceleration:tip', 'acceleration of the tip'),
    ('figure_9_moment_link2.png', 'moment:corner', 'moment in the middle of the second link'),
    ('angle.png', 'q:motor', 'angle of the motor, from hanging'),
)

_SECTION = {'shape': 'rectangle', 'height': 0.008, 'width': 0.008, 'J': 0.1406 * 0.008**4}
_MATERIAL = {'E': 7.0e10, 'nu': 0.33, 'rho': 2700.0}
_ARM: dict[str, Any] = {
    'name': 'l_shape',
    'kinematics': {'dh': [[0.5, 0.0, 0.0, 0.0], [0.0, 0.0, 0.5, 0.0]]},
    'gravity': [0.0, 0.0, 0.0],
    'joints': [{'name': 'motor'}, {'name': 'corner'}],
    'active_joints': ['motor'],
    'links': [
        {'joint': 'motor', 'hub_inertia': 4.3e-3,
         'flexible': {'section': _SECTION, 'material': _MATERIAL}},
        {'joint': 'corner',
         'flexible': {'section': _SECTION, 'material': _MATERIAL, 'height_axis': 'y'}}],
    'simulation': {'rayleigh': {'beta': 2.0e-4}},
}


def l_shape(elements: int = 2, *, paper: bool = False, **beam: Any) -> td.Arm:
    """
    Give the L-shaped mechanism: link 1 along X, link 2 along Z, motor axis Z.

    That of the ``paper`` has gravity along X (the axis is horizontal), the elbow's mass and the
    paper's kind of damping; the other is as in the independent reference. Other keys of both
    beams, such as ``stretch``, may be given.

    """
    content = copy.deepcopy(_ARM)
    for link in content['links']:
        link['flexible'] |= {'elements': elements, **beam}
    if paper:
        content['gravity'] = [9.81, 0.0, 0.0]
        content['links'][0]['flexible']['lumped'] = [{'mass': 0.09, 'inertia': 1.35e-5}]
        content['simulation'] = {'rayleigh': {'alpha': 0.3, 'beta': 2.0e-5},
                                 'initial': {'motor': float(START)}}
    return td.arm_from_dict(content, base=Path('.'), source='l_shape')


def static_torque(plant: td.Plant) -> float:
    """Give the torque that holds the motor where it is [N m]."""
    zero = np.zeros(plant.mechanism.size)
    balance = plant.imbalance(plant.coordinates.copy(), zero, zero)
    return float(balance[plant.mechanism.q_index[0]])


def step_torque(
    first: float, second: float, before: float, after: float, t: FloatArray,
) -> FloatArray:
    """Give the torque of the test: hold, two steps, hold; changes take 5 ms [N m]."""
    times = STEP_AT + STEP_LENGTH * np.array([0.0, 1.0, 2.0])
    nodes = np.column_stack([times, times + 0.005]).ravel()
    levels = [before, first, first, second, second, after]
    return np.interp(t, nodes, levels, left=before, right=after)


def tuned_torque(plant: td.Plant, t: FloatArray) -> FloatArray:
    """Tune the two steps so that the rigid mechanism goes from 135 deg to rest at 30 deg."""
    index = plant.mechanism.q_index[0]
    inertia = plant.mass_matrix()[index, index]
    before = static_torque(plant)
    weight = before / np.sin(START)
    fine = np.arange(0.0, STEP_AT + 2.0 * STEP_LENGTH + 0.01, 1e-3)

    def miss(levels: FloatArray) -> FloatArray:
        torque = step_torque(levels[0], levels[1], before, weight * np.sin(END), fine)
        q, dq = float(START), 0.0
        for value in torque:  # semi-implicit Euler at 1 ms: 0.05 deg are enough
            dq += 1e-3 * (value - weight * np.sin(q)) / inertia
            q += 1e-3 * dq
        return np.array([q - END, dq * STEP_LENGTH])

    answer = root(miss, np.array([0.0, 1.0]))
    if not answer.success:
        raise td.TudorError('no steps of torque take the arm from 135 to 30 deg')
    first, second = answer.x.tolist()
    return step_torque(first, second, before, weight * np.sin(END), t)


@dataclass(frozen=True)
class Agreement:
    """How far a run is from the reference, as relative RMS over all axes and samples."""

    elbow_acceleration: float
    tip_acceleration: float
    moment_link1: float  # torsion and bending in the middle of the links
    moment_link2: float
    final_angle_deg: float  # difference of the joint angle at the end [deg]


def relative_rms(found: FloatArray, expected: FloatArray) -> float:
    """Give the RMS of the difference over that of the expected values."""
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))


def run_reference(elements: int, dt: float, reference: dict[str, FloatArray]) -> td.SimulatedRun:
    """Run the experiment of the reference, which has at least ``t`` [s] and ``tau`` [N m]."""
    t = np.asarray(reference['t'], dtype=float)
    every = int(round((t[1] - t[0]) / dt))
    times = np.arange((t.size - 1) * every + 1) * dt
    torque = np.interp(times, t, reference['tau'])
    return td.simulate(l_shape(elements), torque, seconds=float(times[-1]), dt=dt,
                       rate=1.0 / (every * dt))


def agreement(found: td.SimulatedRun, reference: dict[str, FloatArray]) -> Agreement:
    """
    Compare a run with the reference.

    That has accelerations (n, 3) ``elbow_acceleration`` and ``tip_acceleration``, moments
    ``link1_mid_moment`` and ``link2_mid_moment``, and ``hub_rot`` [rad].

    """
    run, mechanism = found.run, found.mechanism
    return Agreement(
        relative_rms(run.acceleration[:, mechanism.point('motor')],
                     reference['elbow_acceleration']),
        relative_rms(run.acceleration[:, mechanism.tip], reference['tip_acceleration']),
        relative_rms(run.moment[:, 0], reference['link1_mid_moment']),
        relative_rms(run.moment[:, 1], reference['link2_mid_moment']),
        float(np.degrees(run.q[-1, 0] - reference['hub_rot'][-1, 2])))


def run_paper(elements: int = 2, dt: float = 2.5e-4, seconds: float = 5.0) -> td.SimulatedRun:
    """Repeat the test of the paper by steps of dt [s], recorded at 1 kHz."""
    arm = l_shape(elements, paper=True)
    t = np.arange(int(round(seconds / dt)) + 1) * np.float64(dt)
    torque = tuned_torque(td.Plant(td.build_mechanism(arm), dt), t)
    return td.simulate(arm, torque, seconds=seconds, dt=dt)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Repeat the experiment, draw its figures, and give its numbers."""
    if not 1 <= args.elements <= 60 or not 0.0 < args.dt < 1.0:
        raise td.TudorError(f'--elements {args.elements} and --dt {args.dt} do not make a run',
                            remedy='give 1 to 60 elements, and a step below a second')
    reference = None if args.reference is None else _read_reference(Path(args.reference))
    folder = Path(args.out)
    folder.mkdir(parents=True, exist_ok=True)
    found = run_paper(args.elements, args.dt)
    result, mechanism = found.run, found.mechanism
    result.save(folder / 'lshape.npz', joints=np.array(mechanism.joints))
    for name, signal, title in FIGURES:
        found.plot(signal, folder / name, title=title)
    if args.animate is not None:
        found.animate(args.animate)
    angle = np.degrees(result.q[:, 0])
    elbow, tip = (np.linalg.norm(result.acceleration[:, point], axis=1).max()
                  for point in (mechanism.point('motor'), mechanism.tip))
    figures: dict[str, Any] = {
        'clamped_hz': td.modes(found.plant, 8).frequency.tolist(),
        'hinged_hz': td.modes(found.plant, 8, ('motor',)).frequency.tolist(),
        'angle_start_deg': float(angle[0]),
        'angle_after_steps_deg': float(angle[result.t > 1.5].mean()),
        'torque_steps_nm': [float(result.effort[:, 0].min()), float(result.effort[:, 0].max())],
        'elbow_acceleration_peak': float(elbow), 'tip_acceleration_peak': float(tip),
        'moment_link2_peak': float(np.abs(result.moment[:, 1]).max())}
    if reference is not None:
        figures['reference'] = asdict(agreement(
            run_reference(args.elements, args.dt, reference), reference))
    if not args.json:
        for name, value in figures.items():
            if name != 'reference':
                print(f'{name}: {_text(value)}')
        if reference is not None:
            print('\n'.join(['', *table_lines(
                ('elements, step', 'elbow acceleration', 'tip acceleration', 'moments, link 1',
                 'moments, link 2', 'final angle'),
                [(f'{args.elements}, {1000 * args.dt:g} ms',
                  *(f'{value:.1%}' for value in list(figures['reference'].values())[:4]),
                  f'{figures["reference"]["final_angle_deg"]:.4f} deg')]), '']))
        print(f'figures and lshape.npz are in {folder}')
    return figures


def _text(value: Any) -> str:
    if isinstance(value, list):
        return ', '.join(f'{item:.4g}' for item in value)
    if isinstance(value, dict):
        return ', '.join(f'{key} {item:.4g}' for key, item in value.items())
    return f'{value:.4g}'


def _read_reference(path: Path) -> dict[str, FloatArray]:
    needed = ('t', 'tau', 'elbow_acceleration', 'tip_acceleration', 'link1_mid_moment',
              'link2_mid_moment', 'hub_rot')
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in needed}
    except (OSError, ValueError, KeyError) as err:
        raise td.TudorError(f'no reference computation ({err})', place=path,
                            remedy=f'give a file with the arrays {", ".join(needed)}') from None
