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
Let other programs read exported files, and move by them as the arm did.

The UR10 and the UR10e are fitted to the first 60 % of their recordings, with the URDF that their
maker publishes, and exported. Pinocchio, MuJoCo, urdf_parser_py and yourdfpy, from PyPI in an
environment of their own, read the URDF (MuJoCo without its meshes, whose files are not here, and
the MJCF too); what they print is shown. Then the files are judged by the efforts of the last 40 %
(relative error by joint, and of all joints): the URDF by Pinocchio's inverse dynamics with the
damping and friction that it has, the MJCF by MuJoCo's. "friction of files" are base parameters
with viscous and Coulomb friction alone, the least error that such friction leaves. Then each
effect that an MJCF lacks is added alone to what it has. MuJoCo moves
under the recorded torques, a quarter of a second at a time from where the arm was, once by the
maker's URDF, once by the maker's bodies with the friction and rotors that suit them best, once by
the exported MJCF. Shown is the root mean square of what positions are off at the end of each
time, in degrees by joint. The UR10's URDF is that of example-robot-data (PyPI), the UR10e's stands
in DATA.

    python bench/exported.py --data DATA [--venv DIR]
"""

from __future__ import annotations

import argparse
import copy
from dataclasses import replace
import os
from pathlib import Path
import re
import subprocess
import sys
import tempfile

import mujoco
import numpy as np
import pinocchio as pin
from reference_fits import CONFIG, fit, tudor
from tables import show
from tudor_dynamics.identification.dataset import load, parse_choice
from tudor_dynamics.models.bundle import load_bundle
from tudor_dynamics.models.comparison import (
    described_parameters_of, effort_model, file_effects, file_parameters)
from tudor_dynamics.show.mjcf import mjcf_of
import yaml

PARSERS = ('pin==4.1.0', 'mujoco==4.0.0', 'urdf-parser-py==0.0.4', 'yourdfpy==0.0.60')
ROBOTS = 'example-robot-data==6.0.0'
UR10 = 'cmeel.prefix/share/example-robot-data/robots/ur_description/urdf/ur10_robot.urdf'
READ = {
    'Pinocchio': 'import sys, pinocchio; pinocchio.buildModelFromUrdf(sys.argv[1])',
    'urdf_parser_py': 'import sys; from urdf_parser_py.urdf import URDF; '
                      'URDF.from_xml_file(sys.argv[1])',
    'yourdfpy': 'import sys; from yourdfpy import URDF; '
                'assert URDF.load(sys.argv[1], load_meshes=False).validate()',
    'MuJoCo': 'import sys, mujoco; mujoco.MjModel.from_xml_path(sys.argv[1])'}
SLOW = 0.02
"""Speed over which dry friction changes its sign [rad/s], the default of descriptions."""
MOST = 1.3
"""Error of a file over that of the model, at most."""
HORIZON, STEP = 0.25, 1e-3
"""Of a motion from where the arm was, and of MuJoCo in it [s]."""


def environment(place):
    """Install the programs that read, and the UR10's URDF, unless they are there."""
    python, robots = place / 'bin' / 'python', place / 'robots'
    if not (place / 'installed').exists():
        subprocess.run([sys.executable, '-m', 'venv', str(place)], check=True)
        pip = [str(python), '-m', 'pip', 'install', '--quiet']
        subprocess.run([*pip, *PARSERS], check=True)
        subprocess.run([*pip, '--no-deps', '--target', str(robots), ROBOTS], check=True)
        (place / 'installed').write_text('\n'.join((*PARSERS, ROBOTS)))
    return python, robots / UR10


def without_shapes(urdf):
    """Take the meshes out, whose files are not here."""
    return re.sub(r'<(visual|collision)\b.*?</\1>', '', urdf, flags=re.DOTALL)


def said(python, program, path):
    """Let a program read a file; give what it says."""
    done = subprocess.run([python, '-c', READ[program], str(path)],
                          capture_output=True, text=True, check=False)
    words = (done.stdout + done.stderr).strip()
    return words.splitlines()[-1] if words else ('nothing' if done.returncode == 0 else 'failed')


def read_by_others(python, folder, maker, exported, mjcf):
    """Print what the programs say of the files."""
    for name, text in (('maker', maker), ('exported', exported)):
        (folder / f'{name}.urdf').write_text(text)
        (folder / f'{name}_bare.urdf').write_text(without_shapes(text))
    (folder / 'exported.xml').write_text(mjcf)
    for program in READ:
        files = ('maker_bare.urdf', 'exported_bare.urdf', 'exported.xml') if (
            program == 'MuJoCo') else ('maker.urdf', 'exported.urdf')
        for file in files:
            print(f'  {program:15} says of {file:20} {said(python, program, folder / file)}',
                  flush=True)


def moved(xml, stretches, channels, constants):
    """Move from where the arm was, again and again; give how far off each joint ends [deg]."""
    model = mujoco.MjModel.from_xml_string(xml)
    model.opt.timestep = STEP
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    data = mujoco.MjData(model)
    order = [model.joint(name).qposadr[0] for name in channels]
    n, off = len(order), []
    for stretch in stretches:
        t = stretch.t - stretch.t[0]
        states, torque = stretch.motion, stretch.effort * constants
        for begin in np.arange(0.0, t[-1] - HORIZON, HORIZON):
            row = int(np.searchsorted(t, begin))
            end = int(np.searchsorted(t, t[row] + HORIZON))
            mujoco.mj_resetData(model, data)
            data.qpos[order], data.qvel[order] = states[row, :n], states[row, n:2 * n]
            for k in range(round((t[end] - t[row]) / STEP)):
                now = t[row] + k * STEP
                data.qfrc_applied[order] = [np.interp(now, t, column) for column in torque.T]
                mujoco.mj_step(model, data)
            off.append(np.degrees(data.qpos[order] - states[end, :n]))
    return np.sqrt(np.mean(np.square(off), axis=0)), len(off)


def by_pinocchio(text, channels):
    """Give the inverse dynamics of a URDF as a function of q, dq, ddq, all that it has in it."""
    model = pin.buildModelFromXML(text)
    data = model.createData()
    order = [model.joints[model.getJointId(name)].idx_v for name in channels]
    damping, friction = model.damping[order], model.friction[order]

    def efforts(row):
        q, dq, ddq = np.zeros((3, model.nv))
        q[order], dq[order], ddq[order] = row.reshape(3, -1)
        return pin.rnea(model, data, q, dq, ddq)[order] + damping * dq[order] + friction * np.tanh(
            dq[order] / SLOW)
    return efforts


def by_mujoco(text, channels):
    """Give the inverse dynamics of MJCF likewise; its dry friction is a constraint, added here."""
    model = mujoco.MjModel.from_xml_string(text)
    order = [model.joint(name).qposadr[0] for name in channels]
    friction = model.dof_frictionloss[order].copy()
    model.dof_frictionloss[:] = 0.0
    data = mujoco.MjData(model)

    def efforts(row):
        data.qpos[order], data.qvel[order], data.qacc[order] = row.reshape(3, -1)
        mujoco.mj_inverse(model, data)
        return data.qfrc_inverse[order] + friction * np.tanh(data.qvel[order] / SLOW)
    return efforts


def errors_of(efforts, stretches, constants):
    """Judge a file by recorded motion: relative errors by joint, and of all joints [%]."""
    measured, predicted = [], []
    for stretch in stretches:
        found = np.array([efforts(row) for row in stretch.motion]) / constants
        measured.append(stretch.decimation(stretch.effort))
        predicted.append(stretch.decimation(found))
    return relative(np.vstack(measured), np.vstack(predicted))


def relative(measured, predicted):
    """Give relative errors by joint, and of all joints in one [%]."""
    error = measured - predicted
    return 100.0 * np.append(
        np.linalg.norm(error, axis=0) / np.linalg.norm(measured, axis=0),
        np.linalg.norm(error) / np.linalg.norm(measured))


LABELS = {'maker, URDF alone': "maker's URDF as it is",
          'maker, with drives': 'its bodies, with all drives that suit them best',
          'exported URDF': 'exported URDF, in Pinocchio',
          'exported MJCF': 'exported MJCF, in MuJoCo',
          'friction of files': 'base parameters, viscous and Coulomb friction alone',
          'base parameters': 'base parameters, friction as chosen'}
EFFECTS = {'': 'as the file has it', 'offset': 'with zeros of efforts',
           'load': 'with friction that grows with the load',
           'presliding': 'with friction that gives way before it slides',
           'stribeck': 'with friction that falls with the speed',
           'square': 'with friction of the squared speed'}
"""Rows of the tables; head of the first: 'UR10: error', 'UR10e, currents: error'."""


def errors_of_model(model, stretches):
    """Judge a model of the package likewise."""
    return relative(
        np.vstack([stretch.decimation(stretch.effort) for stretch in stretches]),
        np.vstack([stretch.decimation(model.regressor.outputs(
            model.inputs(stretch), model.coefficients())) for stretch in stretches]))


def bare(xml):
    """Take friction and rotors out of MJCF: what a URDF says of bodies alone."""
    return re.sub(r' (armature|damping|frictionloss)="[^"]*"', '', xml)


def without_drives(described):
    """Give the model of bodies alone: neither friction nor rotors, which a URDF has not."""
    model = copy.deepcopy(described.model)
    drives = np.array([not re.match(r'(m|m[xyz]|I[xyz]{2})\(', column)
                       for column in described.columns])
    model.groups_ = tuple(
        replace(group, estimate=replace(group.estimate, parameters=np.where(
            drives[group.base.kept], 0.0, group.estimate.parameters)))
        for group in model.groups_)
    return model


def constants_of(found):
    """Give the torque of each joint for a unit of what is measured."""
    return np.array([found.torque_constants[joint] for joint in found.arm.active_joints])


def judge(name, python, description, bag):
    """Fit, export, let others read, and move; give errors and ways off by label."""
    figures = {}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / 'arm.yaml').write_text(yaml.safe_dump(description))
        out = folder / 'model'
        fit(out, folder / 'arm.yaml', [f'{bag}@0-60%'], [f'{bag}@60-100%'], '--models',
            'analytical')
        for kind in ('urdf', 'mjcf'):
            tudor('export', out, '--to', kind, '--out', folder / f'out.{kind}')
        bundle = load_bundle(out, with_data=True)
        print(name)
        read_by_others(python, folder, bundle.arm.urdf, (folder / 'out.urdf').read_text(),
                       (folder / 'out.mjcf').read_text())
        described = described_parameters_of(bundle.arm, effort_model(bundle))
        unseen = load(parse_choice(f'{bag}@60-100%'), bundle.arm, bundle.preprocessing, learn=True)
        urdf, mjcf = ((folder / f'out.{kind}').read_text() for kind in ('urdf', 'mjcf'))
        full = file_parameters(bundle, rotors=True)
        fit(folder / 'plain', folder / 'arm.yaml', [f'{bag}@0-60%'], [f'{bag}@60-100%'],
            '--models', 'analytical', '--friction', 'viscous', 'coulomb')
        plain = load_bundle(folder / 'plain')
        channels = bundle.arm.active_joints
        alone = without_drives(described)
        base = errors_of_model(effort_model(bundle), unseen.stretches)
        for label, errors in (
                ('maker, URDF alone', errors_of_model(alone, unseen.stretches)),
                ('maker, with drives', errors_of_model(described.model, unseen.stretches)),
                ('exported URDF', errors_of(by_pinocchio(urdf, channels), unseen.stretches,
                                            constants_of(full))),
                ('exported MJCF', errors_of(by_mujoco(mjcf, channels), unseen.stretches,
                                            constants_of(full))),
                ('friction of files', errors_of_model(
                    plain.models['effort']['analytical'], load(parse_choice(
                        f'{bag}@60-100%'), plain.arm, plain.preprocessing, learn=True).stretches)),
                ('base parameters', base)):
            ratio = errors[-1] / base[-1]
            figures[label] = [f'{errors[-1]:.1f} %', '']
            print(f'  {label:20} relative error [%]:     '
                  f'{" ".join(f"{value:7.2f}" for value in errors[:-1])}   all '
                  f'{errors[-1]:6.2f}, {ratio:5.2f} times the model', flush=True)
            if 'exported' in label and ratio > MOST:
                print(f'  FALLS SHORT of {MOST:g} times')
        for what, one in file_effects(bundle, full, rotors=True).items():
            errors = errors_of_model(one.model, unseen.stretches)[-1]
            figures[f'with {what}'] = f'{errors:.1f} %'
            print(f'  MJCF with {what or "nothing more":20} relative error {errors:6.2f} %, '
                  f'{errors / base[-1]:.2f} times the model')
        for label, found, xml in (
                ('maker, URDF alone', described, bare(mjcf_of(described))),
                ('maker, with drives', described, mjcf_of(described)),
                ('exported', full, mjcf)):
            off, times = moved(xml, unseen.stretches, channels, constants_of(found))
            print(f'  {label:20} off after {HORIZON:g} s [deg]: '
                  f'{" ".join(f"{value:7.2f}" for value in off)}   ({times} times)', flush=True)
            figures['exported MJCF' if label == 'exported' else label][1] = (
                f'{min(off):.2g} to ' + (f'{max(off):.2g} deg' if max(off) < 360.0 else 'turns'))
    return figures


def main():
    """Go through the two arms."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--data', type=Path,
                        default=Path(os.environ.get('TUDOR_SHARED_DATA', '../shared/data')))
    parser.add_argument('--venv', type=Path, default=Path('out') / 'parsers',
                        help='environment of the other programs (default: out/parsers)')
    args = parser.parse_args()
    python, ur10 = environment(args.venv)
    arms = (('UR10', CONFIG / 'ur10.yaml', ur10, 'ur10_exciting'),
            ('UR10e, currents', args.data / 'arms' / 'ur10e.yaml',
             args.data / 'arms' / 'ur10e.urdf', 'ur10e_unloaded'))
    found = {}
    for name, description, urdf, bag in arms:
        if not (args.data / 'bags' / bag).exists() or not description.exists():
            print(f'{name}: not there, left out')
            continue
        content = yaml.safe_load(description.read_text())
        content['kinematics'] = {'urdf': str(urdf.resolve())}
        for joint in content['joints']:
            joint.pop('friction', None)
        found[name] = judge(name, str(python), content, args.data / 'bags' / bag)
    show(('', *(cell for name in found for cell in (f'{name}: error', 'off after 0.25 s'))),
         [(words, *(cell for figures in found.values() for cell in figures[label]))
          for label, words in LABELS.items()])
    show(('MJCF', *found), [
        (words, *(figures.get(f'with {what}', '') for figures in found.values()))
        for what, words in EFFECTS.items()])


if __name__ == '__main__':
    main()
