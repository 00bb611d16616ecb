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
Simulate the same arm of two elastic blades here, in MuJoCo 4 and in Exudyn 1.13.6: time, and work.

The arm is ``config/elastic_arm.yaml`` with 200 g at its tip. All three know the rotors, the gears'
springs, the elbow and the blades with their damping, take equal steps, and are given the same
torques: those that hold the arm, and a jump. Here a blade has two cubic elements; in MuJoCo it is
a chain of three rods, as ``tudor export --to mjcf`` writes it; in Exudyn it has geometrically
exact plane elements (``ObjectBeamGeometricallyExact2D``), whose number is an option. That all do
the same work is shown by where the tip hangs, by the frequencies in the plane with the rotors
held, and by where the tip is in the end. They take turns, one thread each;
times are those of the processor, the best of several.

Exudyn is installed from PyPI into an environment of its own, the first time; MuJoCo comes with
the ``test`` extra.

    python bench/peer_simulators.py [--venv DIR] [--elements N ...] [--step DT]
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
import subprocess
import sys
import time

for _name in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'):
    os.environ[_name] = '1'  # before numpy loads

import numpy as np  # noqa: E402

VERSION = '1.13.6'
CONFIG = Path(__file__).resolve().parents[1] / 'config'
START, JUMP = (0.3, -0.2), (1.5, 0.2)
"""Angles of the rotors [rad], and torques beyond those that hold them [N m]."""
SECONDS, ROUNDS, TIP = 2.0, 3, 0.2
BASE = (0.0, 0.3)
"""Where joint 2 is; places count from there [m]."""


def described():
    """Give the arm."""
    from tudor_dynamics.arm.description import arm_from_dict
    import yaml
    content = yaml.safe_load((CONFIG / 'elastic_arm.yaml').read_text())
    content['payload'] = {'mass': TIP}
    content['simulation'] = {'rayleigh': {'beta': 2.5e-4}}
    return arm_from_dict(content, base=CONFIG, source='elastic_arm')


class Ours:
    """This package."""

    def __init__(self, step):
        from tudor_dynamics.mechanics.mechanism import build_mechanism
        from tudor_dynamics.mechanics.run import modes
        from tudor_dynamics.mechanics.plant import Plant
        self.arm = described()
        self.plant = Plant(build_mechanism(self.arm), step)
        self.start = np.array([0.0, *START])
        self.plant.reset(self.start, equilibrium=True)
        zero = np.zeros(self.plant.mechanism.size)
        self.hold = self.plant.imbalance(self.plant.coordinates.copy(), zero, zero)[
            self.plant.mechanism.q_index]
        found = modes(self.plant, 8)
        # those in the plane; the others, across it and about the blades, peers do not have
        felt = found.shape @ self.plant.mass_matrix()[self.plant.mechanism.q_index[1]]
        self.frequencies = found.frequency[np.abs(felt) > 1e-6][:3].tolist()
        self.sag = self.tip()

    def tip(self):
        """Give where the tip is [m]."""
        from tudor_dynamics.mechanics.run import Probe
        place = Probe(self.plant).observe().position[self.plant.mechanism.tip]
        return (place[[0, 2]] - BASE).tolist()

    def run(self):
        """Simulate once; give the time that it took [s], and where the tip is in the end."""
        torque = self.hold + [0.0, *JUMP]
        self.plant.reset(self.start, equilibrium=True)
        self.plant.start_torque(torque)
        step = self.plant.step
        begun = time.process_time()
        for _ in range(round(SECONDS / self.plant.dt)):
            step()
        return time.process_time() - begun, self.tip()


class MuJoCo:
    """MuJoCo, with what this package exports."""

    def __init__(self, step, ours):
        import mujoco
        from scipy.linalg import eigh
        from tudor_dynamics.show.description import ElasticDrive
        from tudor_dynamics.show.mjcf import ElasticFile
        from tudor_dynamics.models.elastic.model import ElasticModel
        self.mujoco, arm = mujoco, ours.arm
        rotors = {link.joint: link.hub_inertia for link in arm.spec.links}
        self.model = mujoco.MjModel.from_xml_string(ElasticFile(
            ElasticModel(arm, 'strain'),
            {name: ElasticDrive(1.0, {'Ia': rotors[name]}) for name in arm.active_joints}).text())
        self.model.opt.timestep = step
        self.data = mujoco.MjData(self.model)
        names = [self.model.joint(i).name for i in range(self.model.njnt)]
        self.rotors = [names.index(name) for name in arm.active_joints]
        self.free = [i for i in range(self.model.nv) if i not in self.rotors]
        self.data.qpos[self.rotors] = START
        bent = np.zeros(len(self.free))
        for _ in range(8):
            stiffness = np.array([(self.force(bent + d) - self.force(bent - d)) / 2e-6
                                  for d in 1e-6 * np.eye(len(bent))]).T
            bent = bent - np.linalg.solve(stiffness, self.force(bent))
        mass = np.array([self.force(bent, unit) - self.force(bent) for unit in np.eye(len(bent))])
        self.frequencies = (np.sqrt(eigh(0.5 * (stiffness + stiffness.T), mass,
                                         eigvals_only=True))[:3] / (2.0 * np.pi)).tolist()
        self.force(bent)
        self.begin = self.data.qpos.copy()
        self.torque = self.data.qfrc_inverse[self.rotors] + JUMP
        mujoco.mj_kinematics(self.model, self.data)
        self.sag = self.tip()

    def force(self, bent, acceleration=0.0):
        """Give what the springs lack at a place, and what its acceleration needs."""
        self.data.qpos[self.free] = bent
        self.data.qvel[:], self.data.qacc[:] = 0.0, 0.0
        self.data.qacc[self.free] = acceleration
        self.mujoco.mj_inverse(self.model, self.data)
        return self.data.qfrc_inverse[self.free].copy()

    def tip(self):
        """Give where the tip is [m]."""
        return (self.data.site('tip').xpos[[0, 2]] - BASE).tolist()

    def run(self):
        """Simulate once; give the time that it took [s], and where the tip is in the end."""
        self.mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = self.begin
        self.data.qfrc_applied[self.rotors] = self.torque
        steps = round(SECONDS / self.model.opt.timestep)
        begun = time.process_time()
        self.mujoco.mj_step(self.model, self.data, steps)
        seconds = time.process_time() - begun
        self.mujoco.mj_kinematics(self.model, self.data)
        return seconds, self.tip()


def numbers(arm):
    """Give what Exudyn needs to know of the arm."""
    from tudor_dynamics.mechanics import chain as at
    from tudor_dynamics.mechanics.mechanism import build_mechanism
    mechanism = build_mechanism(arm)
    blades = []
    for link in arm.spec.links:
        if link.joint in mechanism.beams:
            floats = mechanism.body_float[mechanism.body_of[link.joint]]
            section = link.flexible.section
            area = section.height * section.width
            elements = int(mechanism.body_int[mechanism.body_of[link.joint], at.ELEMENTS])
            blades.append({
                'length': float(floats[at.LENGTH]) * elements,
                'density': float(floats[at.DENSITY]),
                'bending': float(mechanism.beams[link.joint].EIz), 'area': area,
                'modulus': link.flexible.material.E, 'poisson': link.flexible.material.nu,
                'height': section.height, 'beta': float(floats[at.BETA]),
                'stiffness': link.joint_stiffness, 'damping': link.joint_damping,
                'rotor': link.hub_inertia,
                'tip': sum(item.mass for item in link.flexible.lumped)})
    blades[-1]['tip'] += TIP
    return blades


def by_exudyn(task):
    """Build the arm in Exudyn, find its rest and vibrations, and simulate it (runs over there)."""
    sys.exudynFast = True  # its build without checks of ranges, to be chosen before it loads
    import exudyn as exu
    from exudyn import itemInterface as item
    system = exu.SystemContainer().AddSystem()

    def coordinate(node, number):
        return system.AddMarker(item.MarkerNodeCoordinate(nodeNumber=node, coordinate=number))

    ground = coordinate(system.AddNode(item.NodePointGround()), 0)

    def tie(one, other=ground):
        return system.AddObject(item.CoordinateConstraint(markerNumbers=[other, one]))

    place, angle, before, rotors, held = np.zeros(2), 0.0, None, [], []
    for blade, turn in zip(task['blades'], START, strict=True):
        angle += turn
        count, along = task['elements'], np.array([np.cos(angle), np.sin(angle)])
        nodes = [system.AddNode(item.NodeRigidBody2D(referenceCoordinates=[
            *(place + blade['length'] * i / count * along), angle])) for i in range(count + 1)]
        axial = blade['modulus'] * blade['area']
        shear = axial / (2.0 * (1.0 + blade['poisson'])) * 5.0 / 6.0
        for pair in zip(nodes[:-1], nodes[1:], strict=True):
            beam = system.AddObject(item.ObjectBeamGeometricallyExact2D(
                nodeNumbers=list(pair), length=blade['length'] / count,
                massPerLength=blade['density'], bendingStiffness=blade['bending'],
                crossSectionInertia=blade['density'] * blade['height'] ** 2 / 12.0,
                axialStiffness=axial, shearStiffness=shear, axialDamping=blade['beta'] * axial,
                bendingDamping=blade['beta'] * blade['bending'],
                shearDamping=blade['beta'] * shear, includeReferenceRotations=True))
            whole = system.AddMarker(item.MarkerBodyMass(bodyNumber=beam))
            system.AddLoad(item.Gravity(markerNumber=whole, loadVector=[0.0, -9.81, 0.0]))
        system.AddObject(item.ObjectGenericODE2(
            nodeNumbers=[nodes[-1]], massMatrix=np.diag([blade['tip'], blade['tip'], 0.0])))
        system.AddLoad(item.LoadCoordinate(markerNumber=coordinate(nodes[-1], 1),
                                           load=-9.81 * blade['tip']))
        for number in range(2):
            tie(coordinate(nodes[0], number),
                ground if before is None else coordinate(before, number))
        # a rotor turns against the link before it, and drives the next one through a spring
        rotor = system.AddNode(item.Node1D(referenceCoordinates=[0.0]))
        joined = [rotor, nodes[0]] if before is None else [rotor, nodes[0], before]
        twist = np.array([1.0, 0.0, 0.0, -1.0, 0.0, 0.0, 1.0][:1 + 3 * (len(joined) - 1)])
        system.AddObject(item.ObjectGenericODE2(
            nodeNumbers=joined, massMatrix=np.diag([blade['rotor'], *np.zeros(len(twist) - 1)]),
            stiffnessMatrix=blade['stiffness'] * np.outer(twist, twist),
            dampingMatrix=blade['damping'] * np.outer(twist, twist)))
        rotors.append(coordinate(rotor, 0))
        held.append(tie(rotors[-1]))
        place, before = place + blade['length'] * along, nodes[-1]
    system.Assemble()
    settings = exu.SimulationSettings()
    settings.solution.file.write = False
    settings.parallel.numberOfThreads = 1
    system.SolveStatic(settings)
    rest = system.systemData.GetODE2Coordinates()
    holding = [float(system.GetObjectOutput(number, exu.OutputVariableType.Force))
               for number in held]
    system.systemData.SetODE2Coordinates(rest, configuration=exu.ConfigurationType.Initial)

    def tip():
        return system.GetNodeOutput(before, exu.OutputVariableType.Position)[:2].tolist()

    sag = tip()
    frequencies = system.ComputeODE2Eigenvalues(
        numberOfEigenvalues=3, convert2Frequencies=True)[0][:3].tolist()
    for number, marker, holds, jump in zip(held, rotors, holding, JUMP, strict=True):
        system.SetObjectParameter(number, 'activeConnector', False)
        system.AddLoad(item.LoadCoordinate(markerNumber=marker, load=holds + jump))
    system.Assemble()
    system.systemData.SetODE2Coordinates(rest, configuration=exu.ConfigurationType.Initial)
    settings.timeIntegration.numberOfSteps = round(SECONDS / task['step'])
    settings.timeIntegration.endTime = SECONDS
    settings.timeIntegration.generalizedAlpha.spectralRadius = 0.9
    settings.timeIntegration.newton.useModifiedNewton = True
    begun = time.process_time()
    system.SolveDynamic(settings)
    return {'seconds': time.process_time() - begun, 'tip': tip(), 'sag': sag,
            'frequencies': frequencies}


def environment(place):
    """Install Exudyn into an environment of its own, unless it is there; give its Python."""
    python = place / 'bin' / 'python'
    if not (place / 'installed').exists():
        subprocess.run([sys.executable, '-m', 'venv', str(place)], check=True)
        subprocess.run([str(python), '-m', 'pip', 'install', '--quiet', f'exudyn=={VERSION}',
                        'scipy'], check=True)
        (place / 'installed').write_text(VERSION)
    return python


def main():
    """Let them take turns, and print what each came to."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--venv', type=Path, default=Path('out') / 'exudyn',
                        help='environment of Exudyn (default: out/exudyn)')
    parser.add_argument('--elements', type=int, nargs='+', default=[2, 4, 8],
                        help='elements a blade in Exudyn')
    parser.add_argument('--step', type=float, default=5e-4, help='step of all [s]')
    parser.add_argument('--worker', help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.worker:
        print(json.dumps(by_exudyn(json.loads(args.worker))))
        return
    python, ours = environment(args.venv), Ours(args.step)
    here = {'this package, two cubic elements a blade': ours,
            'MuJoCo, three rods a blade': MuJoCo(args.step, ours)}
    task = {'blades': numbers(ours.arm), 'step': args.step}
    found = {}
    for _ in range(ROUNDS):
        for name, peer in here.items():
            best = min((peer.run() for _ in range(3)), key=lambda item: item[0])
            found.setdefault(name, []).append({
                'seconds': best[0], 'tip': best[1], 'sag': peer.sag,
                'frequencies': peer.frequencies})
        for elements in args.elements:
            done = subprocess.run(
                [python, __file__, '--worker', json.dumps({**task, 'elements': elements})],
                capture_output=True, text=True, check=True)
            found.setdefault(f'Exudyn, {elements} linear elements a blade', []).append(
                json.loads(done.stdout.strip().splitlines()[-1]))
    reference = min(item['seconds'] for item in found[next(iter(here))])
    rows = []
    for name, runs in found.items():
        one = min(runs, key=lambda item: item['seconds'])
        rows.append((name, f'{SECONDS / one["seconds"]:.0f}',
                     f'{one["seconds"] / reference:.1f}',
                     ', '.join(f'{value:.3f}' for value in one['frequencies']),
                     *('{:.4f}, {:.4f}'.format(*one[key]) for key in ('sag', 'tip'))))
    from tables import show
    show(('simulator', 'times real time', 'duration relative to this package',
          'frequencies, rotors held [Hz]', 'tip at rest [m]', f'after {SECONDS:g} s [m]'), rows)


if __name__ == '__main__':
    main()
