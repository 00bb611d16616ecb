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
Find the bodies of a simulated seven-joint arm from planned motion with noise, and compare.

The description is wrong on purpose: its masses by factors of e^0.25 (standard deviation), centres
by 2 cm, moments of inertia by e^0.2. An arm of revolute joints alone has no mass that efforts fix
by themselves: mass in the axis of a joint cannot be told from mass of the link before it. So the
same arm is taken with a last joint that slides as well, whose body can be weighed.

    python bench/known_truth.py
"""

from __future__ import annotations

from pathlib import Path
import tempfile
import time

from excitation import order_of, recorded, SEVEN, wanted
import numpy as np
import pinocchio as pin

from tudor_dynamics.arm.description import arm_from_dict
from tudor_dynamics.identification.excitation_plan import make_plan
from tudor_dynamics.models.comparison import full_parameters_of
from tudor_dynamics.models.regressor import EffortRegressor, random_inputs

MASSES = (3.6, 3.3, 2.9, 2.6, 2.2, 1.5, 0.9)


def described_arm(folder, *, seed, last='revolute'):
    """Write a URDF of seven links whose bodies are off, and give the arm with the true bodies."""
    generator = np.random.default_rng(seed)
    places = [(0, 0, 0.33), (0, 0, 0), (0, -0.32, 0), (0.08, 0, 0), (-0.08, 0.38, 0), (0, 0, 0),
              (0.09, 0, 0)]
    turns = [0, -1, 1, 1, -1, 1, 1]
    links, joints, truth = ['<link name="base"/>'], [], []
    for i, (place, turn, mass) in enumerate(zip(places, turns, MASSES, strict=True), start=1):
        centre = generator.uniform(-0.06, 0.06, 3)
        radii = generator.uniform(0.04, 0.09, 3)
        body = pin.Inertia(mass, centre, mass * np.diag(
            [radii[1]**2 + radii[2]**2, radii[0]**2 + radii[2]**2, radii[0]**2 + radii[1]**2]))
        truth.append(body.toDynamicParameters())
        said = mass * np.exp(generator.normal(0.0, 0.25))
        wrong = body.inertia * said / mass * np.exp(generator.normal(0.0, 0.2))
        spot = centre + generator.normal(0.0, 0.02, 3)
        links.append(
            f'<link name="link{i}"><inertial><origin xyz="{" ".join(map(str, spot))}"/><mass '
            f'value="{said}"/><inertia ixx="{wrong[0, 0]}" iyy="{wrong[1, 1]}" '
            f'izz="{wrong[2, 2]}" ixy="0" ixz="0" iyz="0"/></inertial></link>')
        slides = last == 'prismatic' and i == 7
        angle, speed = (0.15, 0.5) if slides else SEVEN[i - 1]
        joints.append(
            f'<joint name="joint{i}" type="{"prismatic" if slides else "revolute"}"><parent '
            f'link="{f"link{i - 1}" if i > 1 else "base"}"/><child link="link{i}"/><origin '
            f'xyz="{" ".join(map(str, place))}" rpy="{turn * np.pi / 2} 0 0"/><axis '
            f'xyz="0 0 1"/><limit lower="{-angle}" upper="{angle}" velocity="{speed}" '
            'effort="200"/></joint>')
    (folder / 'arm.urdf').write_text(f'<robot name="a">{"".join(links + joints)}</robot>')
    return arm_from_dict({
        'name': 'seven bodies', 'kinematics': {'urdf': 'arm.urdf'}, 'joints': [
            {'name': f'joint{i}', 'effort': {'unit': 'N' if last == 'prismatic' and i == 7
                                             else 'N m'},
             'limits': {'acceleration': 15.0}} for i in range(1, 8)]},
        base=folder, source=str(folder / 'arm.yaml')), np.array(truth)


def separable(regressor, bodies):
    """Say which masses are fixed by efforts alone: unit vectors within the span of the rows."""
    rows = regressor.rows(random_inputs(regressor, bodies, 200, 1)).reshape(
        -1, len(regressor.columns))
    _, sizes, ways = np.linalg.svd(rows, full_matrices=False)
    ways = ways[sizes > 1e-9 * sizes[0]]
    return [bool(np.linalg.norm(ways[:, 10 * i]) > 1.0 - 1e-9) for i in range(bodies)]


def main():
    """Go through arms, descriptions and noise."""
    noise = 0.1
    for last in ('revolute', 'prismatic'):
        for seed in range(4):
            with tempfile.TemporaryDirectory() as folder:
                arm, bodies = described_arm(Path(folder), seed=seed, last=last)
                target = wanted(arm, noise)
                plan = make_plan(target, order_of(arm, 20, seed))
                regressor = EffortRegressor(arm)
                drives = np.abs(np.random.default_rng(seed).normal(
                    0.3, 0.1, len(regressor.columns) - 70))
                parameters = np.tile(np.concatenate([bodies.ravel(), drives]), (7, 1))
                model = recorded(arm, target, plan.trajectory, parameters, noise, seed)
                begun = time.process_time()
                full = full_parameters_of(arm, model)
            found, sigma = full.solution.bodies[:, 0], full.solution.body_errors[:, 0]
            sources = full.sources()[:70:10]
            off = (found - bodies[:, 0]) / sigma
            before = np.array([float(item.mass) for item in list(arm.model.inertias)[1:]])
            alone = separable(regressor, 7)
            print(f'{last} last joint, seed {seed}: separable '
                  f'{[i + 1 for i in range(7) if alone[i]] or "none"}, by data '
                  f'{[i + 1 for i in range(7) if sources[i] == "data"] or "none"}; masses off by '
                  f'{np.abs(off).max():.2f} standard errors at most ('
                  + ', '.join(f'{value:.2f}' for value in np.abs(off))
                  + f'), rms {100 * np.sqrt(np.mean((found / bodies[:, 0] - 1)**2)):.1f} %, '
                  f'described {100 * np.sqrt(np.mean((before / bodies[:, 0] - 1)**2)):.1f} %; '
                  f'{time.process_time() - begun:.1f} s', flush=True)


if __name__ == '__main__':
    main()
