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

"""Files that people write or programs send: plans, trajectories, marks of pushes, fleets."""

import contextlib
import io
import json
import shutil
from types import SimpleNamespace

from fleet_making import write_fleet
from fuzzing.bundles import Bundles
from fuzzing.mutate import in_bytes, in_values
import numpy as np
from rosbags.typesys import get_typestore, Stores
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.arm.limits import Limits
from tudor_dynamics.bags.messages import joint_signals, Signals, WRENCH_STAMPED
from tudor_dynamics.bags.reader import BOOL
from tudor_dynamics.bags.storage import RawMessages
from tudor_dynamics.bags.trajectory import (
    is_table, read_trajectories, TRAJECTORY, Trajectory, write_trajectories)
from tudor_dynamics.bags.writer import write_bag
from tudor_dynamics.cli.main import main
from tudor_dynamics.control.trajectory import Follower, of_all
from tudor_dynamics.errors import quiet, TudorError
from tudor_dynamics.files import load_yaml
from tudor_dynamics.fleet.study import load_plan, study, StudySettings
from tudor_dynamics.identification.dataset import BagChoice, BagData, parse_choice
from tudor_dynamics.identification.detection import (
    find_truth, roc_of, score, truth_of_file, WatchedBag)
from tudor_dynamics.identification.excitation_plan import read_motion, read_plan
from tudor_dynamics.identification.fit import FitSettings
from tudor_dynamics.identification.next_steps import compare_with_plan
from tudor_dynamics.library import fit_choices
from tudor_dynamics.mechanics.campaign import played_motion
from tudor_dynamics.models.bundle import dump_yaml, load_bundle
from tudor_dynamics.online.feedforward import Feedforward
from tudor_dynamics.signals.filters import MotionState
from tudor_dynamics.signals.motion_profile import denser

START, SECONDS, RATE = 1_700_000_000_000_000_000, 30.0, 50.0
CELLS = ('nan', 'inf', '-inf', '1e999', '-1', '0', '1e300', '1e-300', '', 'x', '1_0', '0x10',
         '1e15', '-0.0', '\u0661', '#', '"', '1;2', '"a\nb"', '1e9', '0.1 s', 'y' * 5000,
         '\x1b[2J')
"""What may stand in a cell of a table."""
NUMBERS = (float('nan'), float('inf'), -float('inf'), 1e300, -1e300, 1e15, 1e-300, 0.0, -1.0, 1e6)


def _one(rng, items):
    return items[int(rng.integers(len(items)))]


def in_table(rng, text):
    """Damage cells, rows and columns of a table, or its bytes."""
    rows = [line.split(',') for line in text.splitlines()]
    for _ in range(int(rng.integers(1, 5))):
        if not rows:
            break
        kind, at = rng.integers(9), 0 if rng.random() < 0.15 else int(rng.integers(len(rows)))
        if kind < 4 and rows[at]:
            rows[at][int(rng.integers(len(rows[at])))] = _one(rng, CELLS)
        elif kind == 4:
            rows.insert(at, list(_one(rng, rows)))
        elif kind == 5:
            del rows[at:at + int(_one(rng, [1, 1, 3, 10_000]))]
        elif kind == 6 and rows[at]:
            del rows[at][int(rng.integers(len(rows[at])))]
        elif kind == 7:
            column = int(rng.integers(max(len(rows[0]), 1)))
            value = _one(rng, CELLS)
            for row in rows[1:]:
                row[column:column + 1] = [value]
        else:
            rows[at].append(_one(rng, CELLS))
    data = '\n'.join(','.join(row) for row in rows).encode()
    return in_bytes(rng, data) if data and rng.random() < 0.2 else data


def _fresh(folder, name):
    path = folder / name
    shutil.rmtree(path, ignore_errors=True)
    path.unlink(missing_ok=True)
    return path


class Plans:
    """Folders of `tudor excite`: compared with a fit, and played in simulation."""

    memory = 1 << 30
    samples = ('rigid',)

    def __init__(self, folder, root):
        """Plan a short motion of each kind, and fit a bag of the same arm."""
        folder.mkdir(parents=True, exist_ok=True)
        self._arm = load_arm(root / 'config' / 'tudor.yaml')
        self._files = {}
        for kind in self.samples:
            with contextlib.redirect_stdout(io.StringIO()):
                code = main(['excite', self._arm.source, '--floor', '-2', '--for', kind,
                             '--seconds', '10', '--rate', '20', '--steps', '9', '--out',
                             str(folder / kind)])
            if code:
                raise SystemExit(f'no plan: exit code {code}')
            self._files[kind] = {name: (folder / kind / name).read_bytes()
                                 for name in ('plan.json', 'trajectory.csv')}
        with quiet():
            bag = root / 'bags' / 'tudor_damped' / 'stimulus_01'
            self._fit = fit_choices(
                self._arm, [parse_choice(f'{bag}@0-40%')], [], self._arm.spec.preprocessing,
                FitSettings(kinds=('analytical',)), {}).result

    def make(self, rng, sample, folder):
        """Write a plan with a damaged head or table; without a generator, a whole one."""
        path, files = _fresh(folder, 'plan'), dict(self._files[sample])
        if rng is not None:
            head, table = files['plan.json'], files['trajectory.csv'].decode()
            kind = rng.random()
            if kind < 0.35:
                files['plan.json'] = dump_json(in_values(rng, load_yaml(head)))
            elif kind < 0.45:
                files['plan.json'] = in_bytes(rng, head)
            if kind > 0.4:
                files['trajectory.csv'] = in_table(rng, table)
            if kind > 0.98:
                del files[_one(rng, sorted(files))]
        path.mkdir(parents=True)
        for name, data in files.items():
            (path / name).write_bytes(data)
        return path

    def use(self, path):
        """Play the motion and compare the plan; what one refuses the other may read."""
        refused = None
        try:
            motion = played_motion(self._arm, read_motion(path), 0.002).motion
        except TudorError as err:
            motion, refused = np.zeros(0), err
        promises = compare_with_plan(self._fit, read_plan(path)).content()
        if refused is not None:
            raise refused
        return motion, promises

    def compare(self, path, found):
        """Say what is no number: errors of parameters may be infinite."""
        motion, promises = found
        bad = [item['name'] for item in promises['parameters'] if np.isnan(item['expected'])]
        if not np.isfinite(promises['runs']) or promises['runs'] <= 0.0:
            bad.append('runs')
        return None if np.all(np.isfinite(motion)) and not bad else f'no numbers: {bad}'


def dump_json(content):
    """Write plain values as JSON, with what JSON has not, as programs do."""
    return json.dumps(content, default=str).encode()


class Trajectories:
    """Tables and messages of trajectories: fed forward, filled, and driven."""

    memory = 1 << 30
    samples = ('positions', 'velocities', 'accelerations', 'one point', 'many')

    def __init__(self, folder, root):
        """Write a model of two links, rigid, and one of which the links bend."""
        Bundles(folder)
        self._ahead = [Feedforward(load_bundle(folder / 'rigid')),
                       Feedforward(load_bundle(folder / 'elastic'), kind='elastic',
                                   positions='motor')]
        bound = np.array([3.0, 3.0])
        self._limits = Limits(-bound, bound, bound, 10.0 * bound)
        self._types = get_typestore(Stores.ROS2_JAZZY).types

    def make(self, rng, sample, folder):
        """Write a table or a bag; without a generator, whole ones."""
        t = {'one point': np.array([1.0]), 'many': 0.01 * np.arange(1, 400)}.get(
            sample, np.linspace(0.5, 4.0, 8))
        w = np.array([0.8, 1.1])
        end = np.sin(np.pi * t / t[-1])[:, None] ** 2  # at rest at its end
        q = 0.5 * end * np.sin(w * t[:, None])
        dq, ddq = np.gradient(q, t, axis=0) if len(t) > 1 else 0.0 * q, 0.0 * q
        if len(t) > 1:
            dq[-1] = 0.0
            ddq = np.gradient(dq, t, axis=0)
        known = {'positions': 1, 'velocities': 2}.get(sample, 3)
        whole = Trajectory(('j1', 'j2'), t, *(q, dq, ddq)[:known])
        if rng is None or rng.random() < 0.5:
            path = _fresh(folder, 'path.csv')
            data = whole.table()
            path.write_bytes(data if rng is None else in_table(rng, data.decode()))
            return path
        path = _fresh(folder, 'path')
        data = [self._message(rng, whole) for _ in range(int(rng.integers(1, 4)))]
        if rng.random() < 0.2:
            data = [in_bytes(rng, item) for item in data]
        write_bag(path, [RawMessages('/joint_trajectory', TRAJECTORY, START + np.arange(
            len(data), dtype=np.int64), data)])
        return path

    def _message(self, rng, whole):
        """Encode a trajectory that no `Trajectory` takes."""
        joints, t = list(whole.joints), whole.t.copy()
        fields = [None if field is None else [row.copy() for row in field]
                  for field in (whole.q, whole.dq, whole.ddq)]
        for _ in range(int(rng.integers(1, 4))):
            kind, k = rng.integers(7), int(rng.integers(len(t)))
            field = _one(rng, [field for field in fields if field is not None])
            if kind < 2 and len(field[k]):
                field[k][int(rng.integers(len(field[k])))] = _one(rng, NUMBERS)
            elif kind == 2:
                field[k] = np.zeros(int(rng.integers(4)))
            elif kind == 3:
                t[k] = _one(rng, [-1.0, 0.0, t[0], 1e-9, 2e9, -2e9, float(t[-1])])
            elif kind == 4:
                t = t * _one(rng, [1e-9, 1e-3, 1e3, 1e8])
            elif kind == 5:
                joints[int(rng.integers(2))] = _one(rng, ['j1', 'j3', '', 'y' * 5000, '\x1b[2J'])
            else:
                fields[int(rng.integers(3))] = [np.zeros(0)] * len(t)
        fields = [field or [np.zeros(0)] * len(t) for field in fields]
        seconds = np.clip(np.floor(t), -2**31, 2**31 - 1).astype(int).tolist()
        rest = (1e9 * (t - np.floor(t))).astype(int).tolist()
        if rng.random() < 0.1:
            rest[0] = int(_one(rng, [2**32 - 1, 999_999_999]))
        types = self._types
        points = [types['trajectory_msgs/msg/JointTrajectoryPoint'](
            *(field[k] for field in fields), np.zeros(0),
            types['builtin_interfaces/msg/Duration'](seconds[k], rest[k]))
            for k in range(len(t))]
        header = types['std_msgs/msg/Header'](types['builtin_interfaces/msg/Time'](
            int(_one(rng, [0, 1, 2**31 - 1])), 0), '')
        return bytes(get_typestore(Stores.ROS2_JAZZY).serialize_cdr(
            types[TRAJECTORY](header, joints, points), TRAJECTORY))

    def use(self, path):
        """Feed forward, fill and drive each; the first that is refused ends it."""
        found, refused = [], []
        rest = MotionState(np.zeros(2), np.zeros(2), np.zeros(2))
        for sent in read_trajectories(path):
            for ahead in self._ahead:
                found.append(_or_refused(lambda ahead=ahead, sent=sent: ahead.along(
                    denser(sent.trajectory, 100.0)).effort, refused))
            found.append(_or_refused(lambda sent=sent: self._driven(sent.trajectory, rest),
                                     refused))
            out = _fresh(path.parent, 'out.csv' if is_table(path) else 'out')
            write_trajectories(out, [sent])
            again = read_trajectories(out)[0].trajectory
            if not np.array_equal(again.q, sent.trajectory.q):
                raise AssertionError('written positions are others')
        if refused and len(refused) == len(found):
            raise refused[0]
        return [item for item in found if item is not None]

    def _driven(self, trajectory, rest):
        """Drive along it, as a node does: where the reference goes."""
        follower, places = Follower(self._limits), []
        whole = of_all(trajectory, ('j1', 'j2'), rest.q, True)
        if why := follower.take(whole, 0.0, rest, True):
            raise TudorError(why)
        for _ in range(200):
            state, _ = follower.step(0.01, rest)
            if state is None:
                break
            places.append(np.concatenate([state.q, state.dq, state.ddq]))
        return np.array(places)

    def compare(self, path, found):
        """Say what is no number."""
        return None if all(np.isfinite(item).all() for item in found) else 'no numbers'


def _or_refused(do, refused):
    try:
        return do()
    except TudorError as err:
        refused.append(err)
        return None


class Truths:
    """What is known of pushes: tables that people write, and topics of bags."""

    samples = ('table', 'wrench', 'flag')

    def __init__(self, folder, root):
        """Make a detector's view of one bag."""
        self._stamp = START + (1e9 / RATE * np.arange(SECONDS * RATE)).astype(np.int64)
        ratio = np.random.default_rng(0).uniform(0.0, 1.4, len(self._stamp))
        self._ratio = np.convolve(ratio, np.ones(5) / 5.0, 'same')

    def make(self, rng, sample, folder):
        """Write a table or a bag; without a generator, whole ones."""
        pushes = np.array([[2.0, 2.95, 0.1], [4.77, 6.3, 0.0], [20.0, 20.5, 0.0]])
        if sample == 'table':
            path = _fresh(folder, 'pushes.csv')
            text = 'begin,end,tolerance\n' + '\n'.join(','.join(map(str, row)) for row in pushes)
            path.write_bytes(text.encode() if rng is None else in_table(rng, text))
            return path
        path, t = _fresh(folder, f'bag_{sample}'), 1e-9 * (self._stamp - START)
        force = np.where(np.any([(t >= a) & (t <= b) for a, b, _ in pushes], axis=0), 5.0, 0.0)
        stamp, log = self._stamp.copy(), self._stamp.copy()
        if rng is not None:
            for _ in range(int(rng.integers(1, 4))):
                kind = rng.integers(6)
                some = rng.random(len(t)) < _one(rng, [0.001, 0.1, 0.9])
                if kind == 0:
                    force[some] = _one(rng, NUMBERS)
                elif kind == 1:
                    stamp = stamp + _one(rng, [-10**18, 10**18, 10**10, -START])
                elif kind == 2:
                    stamp[some] = int(_one(rng, [0, 1, 2**61, START]))
                elif kind == 3:
                    stamp = rng.permutation(stamp)
                elif kind == 4:
                    keep = slice(0, int(_one(rng, [1, 2, 10])))
                    stamp, log, force = stamp[keep], log[keep], force[keep]
                    t = t[keep]
                else:
                    force = np.where(force > 0.0, _one(rng, NUMBERS), force)
        joints = [joint_signals('joint_states', self._stamp, ('j1',), np.zeros((
            len(self._stamp), 1)))] if rng is None or rng.random() < 0.8 else []
        stamp = np.clip(stamp, 0, 2**31 * 10**9 - 1)
        if sample == 'wrench':
            topic = Signals('applied_wrench', stamp, {
                'force': np.column_stack([force, np.zeros_like(force), force]),
                'torque': np.zeros((len(stamp), 3))}, msgtype=WRENCH_STAMPED)
            write_bag(path, [topic, *joints])
        else:
            data = [b'\x00\x01\x00\x00' + bytes([int(x > 1.0)]) for x in force]
            if rng is not None and rng.random() < 0.5:
                k = int(rng.integers(len(data)))
                data[k] = in_bytes(rng, data[k])
            write_bag(path, [RawMessages('applied_wrench', BOOL, np.sort(stamp), data), *joints])
        return path

    def use(self, path):
        """Read the pushes and judge alarms by them."""
        if path.suffix == '.csv':
            recording = SimpleNamespace(stamp=self._stamp)
            truth = truth_of_file(path, BagData(BagChoice('bag', 0.5, 9.0, seconds=True),
                                                recording, ()))
        else:
            truth = find_truth(str(path), 'applied_wrench')
        events = [SimpleNamespace(event=SimpleNamespace(stamp=int(stamp)))
                  for stamp in self._stamp[self._ratio > 0.9]]
        watched = WatchedBag('bag', self._stamp, self._ratio, truth, tuple(events), self._stamp)
        found = score([watched])
        return truth, found, list(roc_of([watched], found.hours))

    def compare(self, path, found):
        """Say which figure cannot be."""
        truth, one, curve = found
        kept = one.kept(1.0)
        if (not 0 <= one.found <= one.pushes == len(truth.pushes)
                or not 0.0 <= one.hours <= SECONDS / 3600.0
                or not 0 <= (one.false_alarms or 0) <= one.events
                or kept is not None and not kept['low'] <= kept['ratio'] <= kept['high']):
            return f'{one}'
        for factor, per_hour, share in curve:
            if not (factor > 0.0 and per_hour >= 0.0 and 0.0 <= share <= 1.0):
                return f'at {factor} times the thresholds {per_hour} an hour, {share} found'
        return None if all(push.begin <= push.end for push in truth.pushes) else 'ends before'


class Fleets:
    """Plans of fleets, through the whole comparison."""

    seconds, memory = 60.0, 1 << 30
    samples = ('fleet',)

    def __init__(self, folder, root):
        """Write the bags of two arms at two dates."""
        self._base = folder
        self._plan = load_yaml(write_fleet(folder, 2, lambda arm, date: 1.0, 2).read_bytes())

    def make(self, rng, sample, folder):
        """Write a plan beside the bags; without a generator, a whole one."""
        data = dump_yaml(self._plan if rng is None else in_values(rng, self._plan)).encode()
        path = self._base / 'damaged.yaml'
        path.write_bytes(in_bytes(rng, data) if rng is not None and rng.random() < 0.3 else data)
        return path

    def use(self, path):
        """Compare the arms."""
        plan = load_plan(path)
        out = _fresh(path.parent, 'out')
        with quiet():
            return study(plan, StudySettings(path.parent, out, 1, models=False),
                         lambda text: None).as_dict()

    def compare(self, path, found):
        """Say what lacks."""
        return None if 'named' in found else 'no arms are named'
