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
Fit the same data by this package and by FIGAROH 1.0.2: error, bodies that can exist, time, memory.

FIGAROH (PyPI, Apache-2.0) is installed from PyPI into an environment of its own, the first time.
Both get the same samples, filtered and thinned out as ``tudor fit`` chose for the recording, the
same description of the bodies, and the same terms: rotor inertia, viscous and Coulomb friction and
an offset for each joint. Both find base parameters by least squares weighted by joint, and then
bodies that can exist: FIGAROH by its semidefinite program (``solve_direct_effort_fit``, CVXOPT),
this package by its log-Cholesky search. ``giving`` counts drives that give energy. Each runs in a
process of its own, whose time is that of all that is done with the arrays, and whose memory is its
peak above that after its imports.
Currents are torques by the published constants, for FIGAROH refuses currents.

    python bench/peer_figaroh.py --data DATA [--venv DIR]
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
import resource
import subprocess
import sys
import tempfile
import time

for _name in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'):
    os.environ[_name] = '1'  # before numpy loads

import numpy as np  # noqa: E402

VERSION = '1.0.2'
TERMS = ('viscous', 'coulomb', 'offset')
CASES = (
    ('UR10e, published constants', 'ur10e_gains.yaml', ['ur10e_unloaded@0-60%'],
     ['ur10e_unloaded@60-100%']),
    ('Airbot Play', 'airbot.yaml', ['airbot_chirp'], ['airbot_trapezoidal']),
    ('EMPS', 'emps.yaml', ['emps_estimation'], ['emps_validation']),
    ('UR10', 'ur10.yaml', ['ur10_exciting@0-60%'], ['ur10_exciting@60-100%']))


def memory():
    """Peak memory of this process so far [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def errors(measured, predicted):
    """Relative error over all joints [%]."""
    return 100.0 * float(np.linalg.norm(measured - predicted) / np.linalg.norm(measured))


def least_eigenvalue(bodies):
    """Give the least eigenvalue of the pseudo-inertias of bodies, shape (n, 10)."""
    import pinocchio as pin
    return min(float(np.linalg.eigvalsh(np.asarray(
        pin.PseudoInertia.FromDynamicParameters(body).toMatrix())).min()) for body in bodies)


def giving(viscous, coulomb, rotor, speeds):
    """Count drives that give energy: rotors below zero, friction that drives at rest or fast."""
    return int(np.sum((rotor < -1e-6) | (coulomb < -1e-6) | (coulomb + viscous * speeds < -1e-6)))


def model_of(data):
    """Build the arm from its joints: placements, axes, parents, bodies."""
    import pinocchio as pin
    model = pin.Model()
    for i, name in enumerate(data['names'].tolist()):
        kind = (pin.JointModelPrismaticUnaligned if data['prismatic'][i]
                else pin.JointModelRevoluteUnaligned)
        joint = model.addJoint(int(data['parents'][i]), kind(*data['axes'][i]),
                               pin.SE3(data['places'][i]), name)
        model.appendBodyToJoint(joint, pin.Inertia.FromDynamicParameters(data['bodies'][i]),
                                pin.SE3.Identity())
    model.gravity.linear = data['gravity']
    return model


def by_figaroh(data):
    """Fit by FIGAROH."""
    from types import SimpleNamespace

    from figaroh.identification.parameter import (
        add_standard_additional_parameters, get_standard_parameters)
    from figaroh.identification.physical_fit import build_problem, solve_direct_effort_fit
    from figaroh.tools.regressor import build_regressor_basic
    model = model_of(data)
    n = model.nv
    robot = SimpleNamespace(model=model, data=model.createData())
    config = {'has_friction': True, 'has_actuator_inertia': True, 'has_joint_offset': True,
              'is_joint_torques': True, 'act_idxv': list(range(n)),
              **{key: [0.0] * n for key in ('fv', 'fs', 'Ia', 'off')}}
    before, begin = memory(), time.perf_counter()
    parameters = {**get_standard_parameters(model, config),
                  **add_standard_additional_parameters(model, config)}
    names = list(parameters)
    q, dq, ddq = np.split(data['motion'], 3, axis=1)
    rows = build_regressor_basic(robot, q, dq, ddq, config)
    y = data['effort'].T.reshape(-1)  # joint by joint, as FIGAROH stacks them
    prior = np.array([float(value) for value in parameters.values()])
    joints = data['names'].tolist()
    plain = build_problem(rows, y, names, joints, prior=prior)
    left = (y - rows[:, list(plain.base_indices)] @ plain.phi_ols).reshape(n, -1)
    problem = build_problem(rows, y, names, joints, prior=prior,
                            row_weight=np.repeat(1.0 / left.std(axis=1), len(q)))
    record = solve_direct_effort_fit(problem)
    seconds = time.perf_counter() - begin
    peak = memory() - before
    speeds = np.abs(dq).max(axis=0)
    q, dq, ddq = np.split(data['unseen_motion'], 3, axis=1)
    unseen = build_regressor_basic(robot, q, dq, ddq, config)
    wanted = data['unseen_effort'].T.reshape(-1)
    found = {'free': errors(wanted, unseen[:, list(problem.base_indices)] @ problem.phi_ols),
             'seconds': seconds, 'memory': peak, 'status': record.solver_status}
    if record.theta is not None:
        viscous, coulomb, rotor = record.theta[10 * n:13 * n].reshape(3, n)
        found.update(
            exist=errors(wanted, unseen @ record.theta),
            least=least_eigenvalue(record.theta[:10 * n].reshape(n, 10)),
            giving=giving(viscous, coulomb, rotor, speeds))
    return found


def by_this_package(data):
    """Fit by this package, with the same terms."""
    from tudor_dynamics.arm.description import load_arm
    from tudor_dynamics.models.analytical import AnalyticalModel
    from tudor_dynamics.models.comparison import full_parameters_of
    from tudor_dynamics.models.regressor import EffortRegressor
    arm = load_arm(str(data['description']))
    before, begin = memory(), time.perf_counter()
    model = AnalyticalModel(EffortRegressor(arm), len(arm.active_joints))
    model.fit(data['motion'], data['effort'])
    full = full_parameters_of(arm, model)
    seconds = time.perf_counter() - begin
    peak = memory() - before
    wanted = data['unseen_effort']
    speeds = np.abs(np.split(data['motion'], 3, axis=1)[1]).max(axis=0)
    return {'free': errors(wanted, model.predict(data['unseen_motion'])),
            'exist': errors(wanted, full.model.predict(data['unseen_motion'])),
            'least': least_eigenvalue(full.bodies.values()), 'seconds': seconds, 'memory': peak,
            'giving': giving(*(np.array([terms.get(term, 0.0) for terms in full.drives.values()])
                               for term in ('viscous', 'coulomb', 'Ia')), speeds),
            'status': 'optimal'}


def environment(place):
    """Install FIGAROH into an environment of its own, unless it is there; give its Python."""
    python = place / 'bin' / 'python'
    if not (place / 'installed').exists():
        subprocess.run([sys.executable, '-m', 'venv', str(place)], check=True)
        subprocess.run([str(python), '-m', 'pip', 'install', '--quiet', f'figaroh=={VERSION}'],
                       check=True)
        (place / 'installed').write_text(VERSION)
    return python


def write_case(target, folder, data, arm_file, training, test):
    """Fit as tudor does, and write the samples that it used, and the arm, as arrays."""
    from reference_fits import CONFIG, fit
    from tudor_dynamics.arm.description import load_arm
    from tudor_dynamics.arm.kinematics import joint_axis
    from tudor_dynamics.identification.dataset import parse_choice
    from tudor_dynamics.identification.dataset import load
    from tudor_dynamics.models.consistent import parameters_of, prior_of
    from tudor_dynamics.models.bundle import load_bundle
    import yaml
    source = CONFIG / arm_file if (CONFIG / arm_file).exists() else data / 'arms' / arm_file
    content = yaml.safe_load(source.read_text())
    if 'urdf' in content['kinematics']:
        urdf = source.parent / content['kinematics']['urdf']
        content['kinematics']['urdf'] = str(urdf.resolve())
    for joint in content['joints']:
        joint.update(friction=list(TERMS), asymmetric=False)
    described = folder / 'described.yaml'
    described.write_text(yaml.safe_dump(content))
    bags = [[str(data / 'bags' / bag) for bag in part] for part in (training, test)]
    fit(folder / 'model', described, *bags, '--models', 'analytical')
    preprocessing = load_bundle(folder / 'model').preprocessing
    # torques for both, with what is known of the drives
    constants = [(joint.get('effort') or {}).get('torque_constant', 1.0)
                 for joint in content['joints']]
    for joint in content['joints']:
        if joint.get('effort'):
            joint['effort'].pop('torque_constant', None)
            joint['effort']['unit'] = 'N' if joint.get('type') == 'prismatic' else 'N m'
    (folder / 'torques.yaml').write_text(yaml.safe_dump(content))
    arm, torques = load_arm(described), load_arm(folder / 'torques.yaml')
    arrays = {}
    for prefix, part in zip(('', 'unseen_'), bags, strict=True):
        stretches = [stretch for bag in part for stretch in load(
            parse_choice(bag), arm, preprocessing, learn=True).stretches]
        arrays[f'{prefix}motion'] = np.vstack([s.decimation(s.motion) for s in stretches])
        arrays[f'{prefix}effort'] = np.vstack([
            s.decimation(s.effort) for s in stretches]) * constants
    model = torques.model
    names = list(model.names)[1:]
    np.savez(target, names=np.array(names), description=str(folder / 'torques.yaml'),
             parents=np.array([model.parents[i] for i in range(1, model.njoints)]),
             places=np.array([model.jointPlacements[i].homogeneous
                              for i in range(1, model.njoints)]),
             axes=np.array([joint_axis(model, name) for name in names]),
             prismatic=np.array([torques.is_prismatic(name) for name in names]),
             bodies=np.array([parameters_of(log) for log in prior_of(torques).center]),
             gravity=np.array(torques.spec.gravity), **arrays)
    return len(arrays['motion'])


def cells(found):
    """Give the cells of a row."""
    exist = f'{found["exist"]:.2f} %' if 'exist' in found else found['status']
    return (f'{found["free"]:.2f} %', exist, f'{found.get("least", float("nan")):.1e}',
            found.get('giving', '-'), f'{found["seconds"]:.2f} s', f'{found["memory"]:.0f} MB')


def worker(method, path):
    """Run one method in this process and print what it found."""
    if method == 'figaroh':
        import figaroh.identification.physical_fit  # noqa: F401
        import picos  # noqa: F401
    else:
        import tudor_dynamics.models.comparison  # noqa: F401
    with np.load(path) as content:
        data = dict(content)
    print(json.dumps({'figaroh': by_figaroh, 'ours': by_this_package}[method](data)))


def main():
    """Go through the recordings that are there."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--data', type=Path,
                        default=Path(os.environ.get('TUDOR_SHARED_DATA', '../shared/data')))
    parser.add_argument('--venv', type=Path, default=Path('out') / 'figaroh',
                        help='environment of FIGAROH (default: out/figaroh)')
    parser.add_argument('--worker', nargs=2, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.worker:
        worker(*args.worker)
        return
    pythons = {'this package': (sys.executable, 'ours'),
               f'FIGAROH {VERSION}': (str(environment(args.venv)), 'figaroh')}
    rows = []
    for name, arm, training, test in CASES:
        if not all((args.data / 'bags' / bag.partition('@')[0]).exists()
                   for bag in (*training, *test)):
            print(f'{name}: not there, left out')
            continue
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / 'case.npz'
            samples = write_case(path, Path(folder), args.data, arm, training, test)
            for method, (python, key) in pythons.items():
                done = subprocess.run([python, __file__, '--worker', key, str(path)],
                                      capture_output=True, text=True, check=False)
                if done.returncode:
                    print(f'{name}, {method}: {done.stderr.strip().splitlines()[-1]}')
                found = ('does not run', *5 * ('',)) if done.returncode else cells(
                    json.loads(done.stdout.strip().splitlines()[-1]))
                rows.append((f'{name}, {samples} samples', method, *found))
    from tables import show
    show(('recording', 'by', 'base parameters', 'bodies that can exist',
          'least eigenvalue of a pseudo-inertia', 'drives that give energy', 'time', 'memory'),
         rows)


if __name__ == '__main__':
    main()
