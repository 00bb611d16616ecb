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
What feed-forward brings in the simulated closed loop, and what it costs.

The reference arm is recorded with 0 and 400 g and its links damped, and models are fitted: rigid
efforts of all payloads, and an elastic arm from a quarter of the recordings. Then it follows other
motions with other payloads, undamped, by two kinds of controllers:

* torque: the position loop of joint_trajectory_controller on an effort interface,
  current = p (q_d - q) + d (dq_d - dq) + effort, with p and d of the arm's own cascade and no
  integrator, as is that controller's default;
* speed: a drive that takes speeds, with integrators, and a current beside it.

Each without the wanted speed, with it, with efforts as well, with friction kept at rest, and with
the motors led (positions: motor). Errors are root mean squares over all motions: of the encoders
from what each joint was asked for, and of the tip from where it is on a rigid arm. Trajectories
have 100 points a second.

    python bench/feedforward.py [--work DIR] [--other]

With --other the arm is another one: gears that lose a third as much of what they carry, 0.6 times
as stiff and with half the play, blades a quarter thicker, an elbow half as heavy.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path
import tempfile
import time

from identify_seven_joints import data, described_arm
import numpy as np
from scipy.signal import lfilter
from tables import show
import tudor_dynamics as td
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.control.cascade import INTEGRAL, INTEGRAL_GAIN
from tudor_dynamics.identification.excitation_plan import Order, random_series
from tudor_dynamics.mechanics.campaign import (
    record_stimuli, stimulus_motion, stimulus_seeds, StimulusSpec)
from tudor_dynamics.mechanics.closed_loop import ClosedLoop
from tudor_dynamics.mechanics.hardware import with_payload
from tudor_dynamics.mechanics.run import Probe
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.regressor import EffortRegressor
from tudor_dynamics.signals.filters import low_pass_gain
from tudor_dynamics.signals.motion_profile import denser, joint_range, motion_limits
from tudor_dynamics.signals.preprocessing import prepare
import yaml

CONFIG = Path(__file__).resolve().parents[1] / 'config' / 'tudor.yaml'
TRAINING = (0.0, 0.4)
MOTIONS = (('aprbs', 11, 0.1), ('aprbs', 12, 0.2), ('aprbs', 13, 0.3),
           ('fourier', 14, 0.1), ('fourier', 15, 0.2), ('fourier', 16, 0.3))
"""Kind, seed and payload [kg] of what is followed; nothing was chosen by them."""
SECONDS, RATE = 30.0, 100.0
LOOPS = ('torque', 'speed')
AHEAD = ('position', 'speed', 'effort', 'kept', 'led')
CONTROLLERS = {'torque': 'position loop on efforts', 'speed': 'drive that takes speeds',
               'speed, filtered': 'same, speeds as the drive measures them'}
FORWARD = {'position': 'nothing', 'speed': 'wanted speed', 'effort': 'and efforts',
           'kept': 'and friction kept at rest', 'led': 'and motors led'}
"""Words of the table: 'controller', 'fed forward', 'joint 2', 'joint 3', 'tip'."""


@dataclass(frozen=True, eq=False)
class Followed:
    """Errors of a run: of the joints [rad], of the tip [m], of predicted efforts [A]."""

    joints: np.ndarray
    tip: np.ndarray
    record: object


def other_arm(work: Path) -> Path:
    """Describe another arm, see above."""
    spec = yaml.safe_load(CONFIG.read_text(encoding='utf-8'))
    spec['kinematics']['urdf'] = str(CONFIG.parent / spec['kinematics']['urdf'])
    for motor in spec['motors']:
        motor['backlash'] *= 0.5
        for key, factor in (('load_friction', 1 / 3), ('stiffness', 0.6)):
            if key in motor:
                motor[key] *= factor
    for link in spec['links'][1:]:
        link['flexible']['section']['height'] *= 1.25
        for part in link['flexible'].get('lumped', []):
            part['mass'] *= 0.5
    path = work / 'other.yaml'
    path.write_text(yaml.safe_dump(spec), encoding='utf-8')
    return path


def fitted(work: Path, config: Path) -> td.ModelBundle:
    """Record and fit; a model that is there is used again."""
    if (work / 'model').exists():
        return td.load_bundle(work / 'model')
    specs, paths = [], []
    for payload in TRAINING:
        for number in range(2):
            specs.append(StimulusSpec(payload, 40.0, RATE, 1.0,
                                      *stimulus_seeds(3, number)))
            paths.append(work / f'{payload:g}_{number}')
    record_stimuli(config, specs, paths, 2)
    arm = td.load_arm(config)
    begun = time.perf_counter()
    bundle = td.fit([str(path) for path in paths], arm)
    short = [f'{paths[number]}@0-50%' for number in (0, 2)]
    elastic = td.fit(short, arm, settings=td.FitSettings(kinds=('elastic',)))
    models = {**bundle.models, 'strain': {**bundle.models['strain'],
                                          'elastic': elastic.models['strain']['elastic']}}
    print(f'recordings fitted in {time.perf_counter() - begun:.0f} s')
    td.save_bundle(replace(bundle, models=models, causal=None), work / 'model')
    return td.load_bundle(work / 'model')


def rigid_tip(arm: td.Arm, q: np.ndarray) -> np.ndarray:
    """Give the tip of the arm as if it were rigid [m]."""
    plant = td.Plant(td.build_mechanism(arm), 1e-3)
    probe = Probe(plant, [])
    active = [plant.mechanism.joints.index(name) for name in arm.active_joints]
    place, found = plant.mechanism.initial[plant.mechanism.q_index].copy(), []
    for row in q:
        place[active] = row
        plant.reset(place, equilibrium=False)
        found.append(probe.observe().position[plant.mechanism.tip].copy())
    return np.array(found)


def follow(
    loop: ClosedLoop, path: td.Trajectory, which: str, ahead: str, wanted: np.ndarray, *,
    measured: bool = False,
) -> Followed:
    """Let the arm follow a trajectory, as a controller does that lays splines through it."""
    between = denser(replace(path, effort=None), 1.0 / loop.dt)
    effort = np.zeros_like(between.q)
    if path.effort is not None:
        effort = np.column_stack([np.interp(between.t, path.t, column)
                                  for column in path.effort.T])
    speed = np.zeros_like(between.q) if ahead == 'position' else between.dq
    if measured:  # as the encoders show it: a quotient of differences after a low-pass
        share = low_pass_gain(loop.arm.spec.preprocessing.velocity_cutoff, loop.dt)
        speed = lfilter([share], [1.0, share - 1.0], np.diff(
            between.q, axis=0, prepend=between.q[:1]) / loop.dt, axis=0)
    loop.reset(between.q[0], effort[0])
    if which == 'torque':
        loop.cascade.state[:, INTEGRAL] = 0.0
    probe, tip, every = Probe(loop.plant, []), [], round(1.0 / (RATE * loop.dt))
    parts = []
    for k in range(0, len(between.q) - every, every):
        tip.append(probe.observe().position[loop.plant.mechanism.tip].copy())
        part = slice(k, k + every)
        parts.append(loop.run(between.q[part], speed[part], every=every, ahead=effort[part]))
    q, dq, current = (np.concatenate([getattr(part, name) for part in parts])
                      for name in ('q', 'dq', 'current'))
    return Followed(q - path.q[:len(q)], np.array(tip) - wanted[:len(q)], (q, dq, current))


def prediction(bundle: td.ModelBundle, payload: float, path: td.Trajectory,
               record: object) -> np.ndarray:
    """Give errors of efforts from the measured and the wanted motion, as squares [A^2]."""
    q, dq, current = record
    whole = td.Recording.from_arrays(path.t[:len(q)], q=q, dq=dq, effort=current)
    model = bundle.models['effort']['analytical'].at(payload)
    efforts = td.Feedforward(bundle, payload=payload).along(path).effort
    found = []
    for stretch in prepare(whole, bundle.preprocessing):
        truth = stretch.decimation(stretch.effort)
        found.append([np.mean((values - truth) ** 2, axis=0) for values in (
            model.follow_kept(stretch), stretch.decimation(efforts[:len(q)]))])
    return np.mean(found, axis=0)


def rms(parts: list[np.ndarray], scale: float = 1e3) -> np.ndarray:
    """Pool errors."""
    return scale * np.sqrt(np.mean(np.square(np.concatenate(parts)), axis=0))


def closed_loop(bundle: td.ModelBundle, arm: td.Arm) -> None:
    """Follow all motions in all ways, and print tables."""
    found: dict[tuple[str, str], list[Followed]] = {}
    efforts = []
    for kind, seed, payload in MOTIONS:
        carrying = with_payload(arm, payload)
        loops = {which: ClosedLoop(carrying, damping=0.0, seed=seed) for which in LOOPS}
        loops['torque'].cascade.rows[:, INTEGRAL_GAIN] = 0.0
        dt = loops['speed'].dt
        reference = (stimulus_motion(arm, SECONDS, seed, dt) if kind == 'aprbs' else random_series(
            joint_range(arm), motion_limits(arm), Order(SECONDS, 0.5, dt, 1, seed)))
        step = round(1.0 / (RATE * dt))
        path = td.Trajectory(
            arm.active_joints, np.arange(len(reference.q[::step])) / RATE, reference.q[::step],
            reference.dq[::step], reference.ddq[::step])
        wanted = rigid_tip(carrying, path.q)
        plain, led = (td.Feedforward(bundle, payload=payload, positions=positions).along(path)
                      for positions in ('wanted', 'motor'))
        kept = td.Feedforward(bundle, payload=payload, friction_at_rest='kept').along(path)
        paths = {'position': path, 'speed': path, 'effort': plain, 'kept': kept, 'led': led}
        for which, loop in loops.items():
            for ahead in AHEAD:
                run = follow(loop, paths[ahead], which, ahead, wanted)
                found.setdefault((which, ahead), []).append(run)
                if (which, ahead) == ('torque', 'effort'):
                    efforts.append(prediction(bundle, payload, path, run.record))
        for ahead in ('speed', 'effort'):
            found.setdefault(('speed, filtered', ahead), []).append(
                follow(loops['speed'], paths[ahead], 'speed', ahead, wanted, measured=True))
    rows = []
    names = ', '.join(arm.active_joints)
    print(f'loop             fed forward  joints [mrad] ({names}; both)   tip [mm]')
    for (which, ahead), runs in found.items():
        joints = rms([run.joints for run in runs])
        tip = rms([np.linalg.norm(run.tip, axis=1) for run in runs])
        print(f'{which:16} {ahead:12} {np.round(joints, 2)!s:16} {np.linalg.norm(joints):8.2f}'
              f'{float(tip):20.2f}')
        rows.append((CONTROLLERS[which], FORWARD[ahead],
                     *(f'{value:.3g} mrad' for value in joints), f'{float(tip):.3g} mm'))
    show(('controller', 'fed forward', *(name.replace('joint', 'joint ') for name in
                                         arm.active_joints), 'tip'), rows)
    for which, before, after in (
            ('torque', 'speed', 'effort'), ('torque', 'speed', 'kept'),
            ('speed', 'speed', 'effort'),
            ('speed, filtered', 'speed', 'effort')):
        one, other = (rms([run.joints for run in found[which, name]])
                      for name in (before, after))
        each = [round(100 * (1 - float(np.linalg.norm(rms([b.joints]))
                                       / np.linalg.norm(rms([a.joints])))))
                for a, b in zip(found[which, before], found[which, after], strict=True)]
        both = 100 * (1 - np.linalg.norm(other) / np.linalg.norm(one))
        print(f'{which}, {after}: efforts take off {np.round(100 * (1 - other / one), 1)} % of '
              f'the errors of the joints, {both:.1f} % of both; motion by motion {each} %')
    for which in LOOPS:
        one, other = (float(rms([np.linalg.norm(run.tip, axis=1) for run in found[which, name]]))
                      for name in ('speed', 'led'))
        print(f'{which}: led motors take off {100 * (1 - other / one):.1f} % of the error of the '
              'tip')
    measured, wished = np.sqrt(np.mean(efforts, axis=0))
    print(f'efforts from the measured motion are off by {np.round(measured, 4)} A, from the '
          f'wanted one by {np.round(wished, 4)} A: {np.round(wished / measured, 3)} times')


def speed(bundle: td.ModelBundle) -> None:
    """Print the time a point takes; the best of five counts."""
    t = np.arange(0.0, 30.0, 0.01)
    angle = np.column_stack([1.2 + 0.8 * np.sin(t), 0.7 * np.cos(1.3 * t)])
    path = td.Trajectory(('joint2', 'joint3'), t, angle, np.gradient(angle, t, axis=0),
                         np.gradient(np.gradient(angle, t, axis=0), t, axis=0))
    motion, tau = data(3000)
    arm = described_arm()
    seven = td.ModelBundle(arm, PreprocessingSpec(), {'effort': {'analytical': AnalyticalModel(
        EffortRegressor(arm), 7).fit(motion, tau)}})
    long = td.Trajectory(arm.active_joints, t, *np.split(motion, 3, axis=1))
    for name, ahead, wanted in (
            ('two joints', td.Feedforward(bundle), path),
            ('two joints, motors led', td.Feedforward(bundle, positions='motor'), path),
            ('seven joints', td.Feedforward(seven), long)):
        took = []
        for _ in range(6):
            begun = time.perf_counter()
            ahead.along(wanted)
            took.append(time.perf_counter() - begun)
        print(f'{name}: {1e6 * min(took[1:]) / len(t):.1f} us a point')


def main() -> None:
    """Record, fit, follow, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().split('\n\n')[0])
    parser.add_argument('--work', type=Path, help='directory that keeps recordings and model')
    parser.add_argument('--other', action='store_true', help='another arm')
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        work = args.work or Path(scratch)
        config = other_arm(work) if args.other else CONFIG
        bundle = fitted(work, config)
        closed_loop(bundle, td.load_arm(config))
        speed(bundle)


if __name__ == '__main__':
    main()
