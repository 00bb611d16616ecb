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

"""``tudor simulate``: drive a mechanism of rigid and flexible links, or list its vibrations."""

from __future__ import annotations

import argparse
from pathlib import Path
import re
import warnings

import numpy as np

from tudor_dynamics.arm.description import Arm, load_arm
from tudor_dynamics.bags.storage import METADATA
from tudor_dynamics.bags.writer import write_bag
from tudor_dynamics.cli.console import add_out, bar, new_table, print_json, print_table, say
from tudor_dynamics.errors import check_budget, complain, TudorWarning, UsageError
from tudor_dynamics.files import check_target
from tudor_dynamics.mechanics.mechanism import build_mechanism, left_out, Mechanism, with_motors
from tudor_dynamics.mechanics.plant import Plant
from tudor_dynamics.mechanics.run import (
    count_steps, largest_rotation, modes, PlantRecord, Probe, run_plant)
from tudor_dynamics.mechanics.settings import LARGEST_ROTATION
from tudor_dynamics.mechanics.study import (
    check_animation, force_signal, motion_signal, plot_configuration, run_series, signal_names,
    SimulatedRun, torque_signal)

EXAMPLES = """\
examples:
  tudor simulate config/l_shape.yaml --modes 8
  tudor simulate config/l_shape.yaml --modes 8 --free motor
  tudor simulate config/l_shape.yaml --pictures --out out
  tudor simulate config/l_shape.yaml --seconds 5 --out out --picture out/l.gif \\
      --torque '0.6*(step(t-0.1) - 2*step(t-0.4) + step(t-0.7))'
  tudor simulate config/elastic_arm.yaml --dt 0.0005 --out out --hold joint3 \\
      --torque 'joint2=4.6+1.5*sin(9*t)'
  tudor simulate config/l_shape.yaml --out push --force 'z=2*step(t-0.5)' 'x=-1'
  tudor simulate config/l_shape.yaml --seconds 2 --out moved --motion motion.csv

A torque is a CSV file (columns t, JOINT, ...), JOINT=EXPRESSION, or an EXPRESSION for the first
active joint; of a joint with an entry in motors it is that of the motor, after the gear. A force
acts at the tip in the base frame: a CSV file (columns t, x, y, z), or x=EXPRESSION, y=..., z=...;
links are bent at the start by what acts at t = 0. Joints in a table of motion follow a quintic
spline through it; the table covers the whole run with at least six rows.

Expressions know t, + - * / ** %, comparisons, pi, e, sin, cos, tan, exp, log, sqrt, abs, sign,
tanh, min, max, step(x), ramp(x, width).

Beams bend by little: above an elastic rotation of 0.3 rad a warning says so, as deflections are
then more than 4 % too large (at 0.5 rad 10 %, at 1 rad 35 %).
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``tudor simulate``."""
    parser.add_argument('arm', metavar='ARM.yaml', help='arm description with links')
    parser.add_argument('--torque', metavar='T', nargs='+', default=[],
                        help='CSV file, expression in t, or JOINT=EXPRESSION [N m or N]')
    parser.add_argument('--force', metavar='F', nargs='+', default=[],
                        help='at the tip: CSV file, or x=, y=, z=EXPRESSION [N], base frame')
    parser.add_argument('--motion', metavar='FILE.csv',
                        help='joints in this table (t, JOINT, ...) follow it [rad or m]')
    parser.add_argument('--hold', metavar='JOINT', nargs='+', default=[],
                        help='joints that are held where they start')
    parser.add_argument('--seconds', type=float, default=5.0, help='length of the run (5)')
    parser.add_argument('--dt', type=float, default=2.5e-4, help='step [s] (0.00025)')
    parser.add_argument('--rate', type=float, default=1000.0, help='records per second (1000)')
    parser.add_argument('--rho', type=float, default=0.9,
                        help='numerical damping of the highest frequencies, 1 for none (0.9)')
    add_out(parser, 'DIR', 'run.npz, bag/ and figures go there', required=False)
    parser.add_argument('--pictures', action='store_true',
                        help='draw the initial configuration and, after a run, the signals')
    parser.add_argument('--signals', metavar='S', nargs='+',
                        help='what to draw, e.g. acceleration:tip moment:JOINT strain:GAUGE')
    parser.add_argument('--picture', metavar='FILE', help='.gif or .mp4 of the run')
    parser.add_argument('--modes', metavar='N', type=int, help='list N frequencies')
    parser.add_argument('--free', metavar='JOINT', nargs='+', default=[],
                        help='joints that move freely in --modes; held by default')


def print_modes(plant: Plant, count: int, free: list[str], *, as_json: bool) -> None:
    """Print the table of frequencies."""
    result = modes(plant, count, tuple(free))
    if as_json:
        print_json({'free_joints': free, 'frequency_hz': result.frequency.tolist(),
                    'damping_ratio': result.damping.tolist()})
        return
    state = f'{", ".join(free)} free' if free else 'all joints held'
    table = new_table(f'{plant.mechanism.name}, {state}',
                      figures=('mode', 'frequency [Hz]', 'damping ratio [%]'))
    table.add_column('moves most', overflow='fold')
    for number, shape in enumerate(result.shape):
        largest = plant.mechanism.coordinate_names[int(np.argmax(np.abs(shape)))]
        table.add_row(str(number + 1), f'{result.frequency[number]:.3f}',
                      f'{100.0 * result.damping[number]:.3f}', largest)
    print_table(table)


def _runs(args: argparse.Namespace) -> bool:
    return bool(args.torque or args.force or args.motion is not None)


def _check(args: argparse.Namespace, mechanism: Mechanism) -> None:
    for name in args.free + args.hold:
        if name not in mechanism.joints:
            option = '--free' if name in args.free else '--hold'
            raise UsageError(f'{option} {name}: {args.arm} has no such joint; give one of '
                             f'{", ".join(mechanism.joints)}')
    count_steps(args.seconds, args.dt, args.rate)  # says so if they are impossible
    if args.modes is not None and args.modes < 1:
        raise UsageError(f'--modes {args.modes}: give the number of modes to list, 1 or more')
    if (args.pictures or args.picture is None) and args.out is None and (
            args.pictures or _runs(args)) and not args.json:
        raise UsageError('no option says where results go; give --out DIR, or --json for figures')
    if args.picture is not None:
        check_animation(Path(args.picture), overwrite=args.overwrite, name='picture')


def _simulate(args: argparse.Namespace, plant: Plant, probe: Probe, active: tuple[str, ...],
              ) -> PlantRecord:
    mechanism = plant.mechanism
    steps, every = count_steps(args.seconds, args.dt, args.rate)
    check_budget('torques and motion', steps, 32.0 * (2 + len(mechanism.joints)))
    t = np.arange(steps + 1) * args.dt
    motion, start, rate = None, plant.state.q.copy(), None
    if args.motion is not None:
        motion, moved = motion_signal(Path(args.motion), t, mechanism.joints)
        for joint in moved:
            plant.drive(joint, 'motion')
            column = mechanism.joints.index(joint)
            start[column] = motion[0][0, column]
        rate = motion[1][0]
    force = force_signal(args.force, t) if args.force else None
    if motion is not None or force is not None:
        plant.reset(start, rate, external_force=None if force is None else force[0])
    torque = torque_signal(args.torque, t, mechanism.joints, active)
    plant.start_torque(torque[0])
    with bar(steps, 'simulating') as advance:
        return run_plant(plant, probe, torque, every=every, motion=motion, force=force,
                         progress=lambda done: advance(advance=done))


def run(args: argparse.Namespace) -> int:
    """Check the mechanism, then list modes, draw, or simulate."""
    described = load_arm(args.arm)
    arm = with_motors(described)
    mechanism = build_mechanism(arm)
    _check(args, mechanism)
    if parts := left_out(described):
        names = sorted({name for found in parts.values() for name in found})
        complain(f'arm {arm.name!r}: left out of the motors of {", ".join(parts)}: '
                 f'{", ".join(names)}; tudor record has them')
    # The first call after installation compiles for some twenty seconds.
    with bar(None, 'preparing the mechanism'):
        plant = Plant(mechanism, args.dt, rho=args.rho)
        probe = Probe(plant, arm=arm)
    for name in args.hold:
        plant.drive(name, 'hold')
    known = signal_names(mechanism, arm.gauge_names)
    wanted = ['acceleration:tip', 'energy', *(
        f'{what}:{joint}' for joint in arm.active_joints for what in ('q', 'effort'))]
    signals = args.signals or [
        name for name in known if name in wanted or name.startswith(('moment:', 'strain:'))]
    for name in signals:
        if name not in known:
            raise UsageError(f'--signals: there is no {name}; choose from {", ".join(known)}')
    runs = _runs(args) or not (args.pictures or args.modes is not None)
    folder = Path(args.out) if args.out is not None else None
    pictures = {} if folder is None or not args.pictures else {
        '': folder / 'initial.png', **{name: folder / (re.sub(r'[^\w-]', '_', name) + '.png')
                                       for name in signals if runs}}
    if folder is not None:
        if runs:
            check_target(folder / 'run.npz', overwrite=args.overwrite)
            check_target(folder / 'bag', overwrite=args.overwrite, mark=METADATA)
        for path in pictures.values():
            check_target(path, overwrite=args.overwrite)
        folder.mkdir(parents=True, exist_ok=True)
    if args.modes is not None:
        print_modes(plant, args.modes, args.free, as_json=args.json)
    if initial := pictures.pop('', None):
        plot_configuration(initial, mechanism, probe.observe().position,
                           f'{arm.name}: initial configuration')
        complain(f'{initial}: initial configuration')
    if not runs:
        _warn_of(largest_rotation(plant), arm)
        return 0
    result = SimulatedRun(arm, mechanism, _simulate(args, plant, probe, arm.active_joints), plant)
    with bar(None, 'writing'):
        if folder is not None:
            result.save(folder, bag=False)
            write_bag(folder / 'bag', run_series(result.run, arm, mechanism),
                      overwrite=args.overwrite)
        for name, path in pictures.items():
            result.plot(name, path, title=result.curves(name).title)
        if args.picture is not None:
            result.animate(args.picture)
    _report(args, result.run, mechanism, arm)
    _warn_of(float(result.run.rotation.max()), arm)
    return 0


def _report(args: argparse.Namespace, result: PlantRecord, mechanism: Mechanism, arm: Arm) -> None:
    total, largest = result.energy.sum(axis=1), float(result.rotation.max())
    if args.json:
        print_json({
            'arm': arm.name, 'seconds': float(result.t[-1]), 'samples': int(result.t.size),
            'q_end': dict(zip(mechanism.joints, result.q[-1].tolist(), strict=True)),
            'tip_end': result.position[-1, mechanism.tip].tolist(),
            'energy_start': float(total[0]), 'energy_end': float(total[-1]),
            'largest_rotation': largest})
        return
    angles = ', '.join(f'{name} {np.degrees(value):.3f} deg'
                       for name, value in zip(mechanism.joints, result.q[-1], strict=True))
    where = args.out if args.out is not None else args.picture
    say(f'{where}: {result.t[-1]:g} s, {result.t.size} samples, at the end {angles}; largest '
        f'elastic rotation {largest:.3g} rad')


def _warn_of(rotation: float, arm: Arm) -> None:
    if rotation > LARGEST_ROTATION:
        msg = (f'arm {arm.name!r}: beams bend by up to {rotation:.2f} rad; above '
               f'{LARGEST_ROTATION:g} rad the computed deflections are more than 4 % too large: '
               'make the beams stiffer or shorter, or lower the load')
        warnings.warn(msg, TudorWarning, stacklevel=2)
