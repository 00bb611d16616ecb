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

import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root

from tudor_dynamics.arm import Arm, arm_from_dict
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.simulation.mechanics.mechanism import build_mechanism
from tudor_dynamics.simulation.plant.outputs import Probe
from tudor_dynamics.simulation.plant.plant import Plant
from tudor_dynamics.simulation.plant.run import Run, run_plant
from tudor_dynamics.typing import FloatArray

START, END = np.radians(135.0), np.radians(30.0)
STEP_AT, STEP_LENGTH = 0.5, 0.3  # s

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


def l_shape(elements: int = 2, *, paper: bool = False, **beam: Any) -> Arm:
    """
    Give the L-shaped mechanism: link 1 along X, link 2 along Z, motor axis Z.

    Parameters
    ----------
    elements : int
        Elements a beam.
    paper : bool
        With gravity along X (the axis is horizontal), the elbow's mass and the paper's kind of
        damping; otherwise as in the independent reference.
    **beam
        Other keys of both beams, such as ``stretch``.

    Returns
    -------
    Arm
        Description.

    """
    content = copy.deepcopy(_ARM)
    for link in content['links']:
        link['flexible'] |= {'elements': elements, **beam}
    if paper:
        content['gravity'] = [9.81, 0.0, 0.0]
        content['links'][0]['flexible']['lumped'] = [{'mass': 0.09, 'inertia': 1.35e-5}]
        content['simulation'] = {'rayleigh': {'alpha': 0.3, 'beta': 2.0e-5},
                                 'initial': {'motor': float(START)}}
    return arm_from_dict(content, base=Path('.'), source='l_shape')


def static_torque(plant: Plant) -> float:
    """Give the torque that holds the motor where it is [N m]."""
    zero = np.zeros(plant.mechanism.size)
    balance = plant.imbalance(plant.coordinates.copy(), zero, zero)
    return float(balance[plant.mechanism.q_index[0]])


def step_torque(first: float, second: float, before: float, after: float, t: FloatArray,
                ) -> FloatArray:
    """
    Give the torque of the test: hold, two steps, hold; changes take 5 ms [N m].

    Parameters
    ----------
    first : float
        Torque of the first step [N m].
    second : float
        Torque of the second step [N m].
    before : float
        Torque that holds at the start [N m].
    after : float
        Torque that holds at the end [N m].
    t : ndarray of shape (n_samples,)
        Times to evaluate at [s].

    """
    times = STEP_AT + STEP_LENGTH * np.array([0.0, 1.0, 2.0])
    nodes = np.column_stack([times, times + 0.005]).ravel()
    levels = [before, first, first, second, second, after]
    return np.interp(t, nodes, levels, left=before, right=after)


def tuned_torque(plant: Plant, t: FloatArray) -> FloatArray:
    """
    Tune the two steps so that the rigid mechanism goes from 135 deg to rest at 30 deg.

    Parameters
    ----------
    plant : Plant
        The mechanism of the paper at its start.
    t : ndarray of shape (n_samples,)
        Times to evaluate at [s].

    Returns
    -------
    ndarray of shape (n_samples, 2)
        Torques of motor and corner [N m].

    Raises
    ------
    SimulationError
        If the angles cannot be reached.

    """
    mechanism = plant.mechanism
    index = mechanism.q_index[0]
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
        msg = f'{mechanism.name}: no steps of torque take the arm from 135 to 30 deg'
        raise SimulationError(msg)
    torque = np.zeros((t.size, 2))
    first, second = float(answer.x[0]), float(answer.x[1])
    torque[:, 0] = step_torque(first, second, before, weight * np.sin(END), t)
    return torque


@dataclass(frozen=True)
class Agreement:
    """
    How far a run is from the reference, as relative RMS over all axes and samples.

    Attributes
    ----------
    elbow, tip : float
        Accelerations of elbow and tip.
    moment1, moment2 : float
        Torsion and bending moments in the middle of the links.
    angle : float
        Difference of the final joint angle [deg].

    """

    elbow: float
    tip: float
    moment1: float
    moment2: float
    angle: float


def relative_rms(found: NDArray, expected: NDArray) -> float:
    """
    Give the RMS of the difference over that of the expected values.

    Parameters
    ----------
    found : ndarray
        Values that were found.
    expected : ndarray
        Values that were expected, of the same shape.

    """
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))


def run_reference(plant: Plant, reference: dict[str, NDArray]) -> Run:
    """
    Run the experiment of the reference.

    Parameters
    ----------
    plant : Plant
        ``l_shape`` with its corner first to be observed.
    reference : dict of str to ndarray
        At least ``t`` [s] and ``tau`` [N m].

    Returns
    -------
    Run
        On the times of the reference.

    """
    t = np.asarray(reference['t'], dtype=float)
    every = int(round((t[1] - t[0]) / plant.dt))
    times = np.arange((t.size - 1) * every + 1) * plant.dt
    torque = np.zeros((times.size, 2))
    torque[:, 0] = np.interp(times, t, reference['tau'])
    return run_plant(plant, Probe(plant), torque, every=every)


def agreement(run: Run, plant: Plant, reference: dict[str, NDArray]) -> Agreement:
    """
    Compare a run with the reference.

    Parameters
    ----------
    run : Run
        Run of ``run_reference``.
    plant : Plant
        Plant of the run.
    reference : dict of str to ndarray
        Accelerations (n, 3) ``elbow_acceleration`` and ``tip_acceleration``, moments
        ``link1_mid_moment`` and ``link2_mid_moment``, and ``hub_rot`` [rad].

    Returns
    -------
    Agreement
        Relative RMS and angle.

    """
    elbow = plant.mechanism.point('motor')
    return Agreement(
        relative_rms(run.acceleration[:, elbow], reference['elbow_acceleration']),
        relative_rms(run.acceleration[:, plant.mechanism.tip], reference['tip_acceleration']),
        relative_rms(run.moment[:, 0], reference['link1_mid_moment']),
        relative_rms(run.moment[:, 1], reference['link2_mid_moment']),
        float(np.degrees(run.q[-1, 0] - reference['hub_rot'][-1, 2])))


def run_paper(elements: int = 2, dt: float = 2.5e-4, seconds: float = 5.0) -> tuple[Plant, Run]:
    """
    Repeat the test of the paper.

    Parameters
    ----------
    elements : int
        Elements a beam.
    dt : float
        Step of the integrator [s].
    seconds : float
        Length of the run [s].

    Returns
    -------
    tuple of Plant and Run
        Recorded at 1 kHz.

    """
    plant = Plant(build_mechanism(l_shape(elements, paper=True)), dt)
    t: FloatArray = np.arange(int(round(seconds / dt)) + 1) * np.float64(dt)
    torque = tuned_torque(plant, t)
    plant.start_torque(torque[0])
    return plant, run_plant(plant, Probe(plant), torque, every=max(int(round(1e-3 / dt)), 1))
