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
What the small-displacement assumption of the paper's equations costs, by elastic amplitude.

Run with ``python bench/small_displacements.py [--seconds S]``. The undamped L-shaped mechanism
swings under gravity from the horizontal, for materials of rising stiffness: the elastic amplitude
falls. The simulator's own energy drift is printed beside what the paper's Eqs. (4) to (6) gain or
lose along the same motion (their power error, integrated), and how far the joint accelerations of
the two are apart. Before that, a cantilever under a force P at its end, against the elastica.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import sys

import numpy as np
from scipy.integrate import solve_bvp, trapezoid

from tudor_dynamics.arm.description import arm_from_dict
from tudor_dynamics.mechanics.mechanism import build_mechanism
from tudor_dynamics.mechanics.plant import Plant
from tudor_dynamics.mechanics.run import largest_rotation, Probe

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / 'test')]

from mechanics.erls import RigidLinkSystem  # noqa: E402, I100
from papers.lshape import l_shape  # noqa: E402, I100

HELD = np.array([False, True])


def cantilever(load: float) -> tuple[float, float]:
    """Bend a beam of 1 m by P = load EI / L^2; gives deflection [m] and elastic rotation [rad]."""
    mechanism = build_mechanism(arm_from_dict({
        'name': 'cantilever', 'kinematics': {'dh': [[1.0, 0.0, 0.0, 0.0]]},
        'gravity': [0.0, 0.0, 0.0], 'joints': [{'name': 'root'}],
        'links': [{'joint': 'root', 'flexible': {
            'section': {'shape': 'rectangle', 'height': 0.01, 'width': 0.01},
            'material': {'E': 7e10, 'nu': 0.33, 'rho': 2700}, 'elements': 8}}]},
        base=Path('.'), source='cantilever'))
    plant = Plant(mechanism, 1e-3)
    plant.drive('root', 'hold')
    plant.reset(external_force=[0.0, load * mechanism.beams['root'].EIz, 0.0], equilibrium=True)
    return float(Probe(plant).observe().position[mechanism.tip, 1]), largest_rotation(plant)


def elastica(load: float) -> float:
    """Give the deflection of an inextensible beam of 1 m under P = load EI / L^2 [m]."""
    s = np.linspace(0.0, 1.0, 201)
    found = solve_bvp(lambda _, y: np.vstack([y[1], -load * np.cos(y[0])]),
                      lambda a, b: np.array([a[0], b[1]]), s, np.zeros((2, s.size)), tol=1e-8)
    fine = np.linspace(0.0, 1.0, 2001)
    return float(trapezoid(np.sin(found.sol(fine)[0]), fine))


def mechanism_of(stiffness: float):
    """L-shaped mechanism without damping, gravity across the axis."""
    mechanism = build_mechanism(l_shape(1, material={
        'E': 7.0e10 * stiffness, 'nu': 0.33, 'rho': 2700.0}))
    beams = mechanism.body_int[:, 0] == 1
    mechanism.body_float[beams, 37:39] = 0.0
    mechanism.gravity[:] = 0.0, -9.81, 0.0
    return mechanism


def paper_error(system: RigidLinkSystem, plant: Plant) -> tuple[float, float]:
    """Give the power that the paper's equations make up, and their joint acceleration."""
    index = plant.mechanism.q_index
    z, dz = plant.coordinates.copy(), plant.rates.copy()
    q, dq, h = z[index], dz[index], 1e-6
    u = system.from_links(z, q)
    du = (system.from_links(z + h * dz, q + h * dq)
          - system.from_links(z - h * dz, q - h * dq)) / (2 * h)
    ddu, ddq = system.accelerations(q, dq, u, du, np.zeros(2), HELD)
    ahead = system.energy(q + h * dq, dq + h * ddq, u + h * du, du + h * ddu)
    behind = system.energy(q - h * dq, dq - h * ddq, u - h * du, du - h * ddu)
    return (ahead - behind) / (2 * h), float(ddq[0])


def main() -> int:
    """Print two tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seconds', type=float, default=1.5)
    args = parser.parse_args()
    print('| $P L^2/EI$ | largest elastic rotation [rad] | deflection too large by |')
    print('|---|---|---|')
    for load in (0.25, 0.6, 1.0, 2.0):
        deflection, turned = cantilever(load)
        excess = 100.0 * (deflection / elastica(load) - 1.0)
        print(f'| {load:g} | {turned:.2f} | {excess:.1f} % |')
    print()
    print('| stiffness | largest elastic rotation [rad] '
          "| energy made by the paper's form, of what is exchanged "
          '| drift of the simulator | joint accelerations apart, relative |')
    print('|---|---|---|---|---|')
    dt = 5e-4
    for stiffness in (0.25, 1.0, 4.0, 16.0, 64.0):
        mechanism = mechanism_of(stiffness)
        plant, system = Plant(mechanism, dt), RigidLinkSystem(mechanism)
        plant.reset(equilibrium=False)
        start, kinetic, drift, turned = plant.energy().total, 0.0, 0.0, 0.0
        made, largest, apart, scale = 0.0, 0.0, 0.0, 0.0
        for k in range(1, int(round(args.seconds / dt)) + 1):
            plant.step()
            now = plant.energy()
            kinetic = max(kinetic, now.kinetic)
            drift = max(drift, abs(now.total - start))
            turned = max(turned, float(np.abs(plant.coordinates[mechanism.elastic]).max()))
            if k % 2 == 0:
                power, ddq = paper_error(system, plant)
                made += power * 2 * dt
                largest = max(largest, abs(made))
                apart += (ddq - plant.state.ddq[0]) ** 2
                scale += plant.state.ddq[0] ** 2
        print(f'| {stiffness:g} | {turned:.1e} | {largest / kinetic:.1e} | '
              f'{drift / kinetic:.1e} | {np.sqrt(apart / scale):.1e} |', flush=True)
    return 0


if __name__ == '__main__':
    sys.exit(main())
