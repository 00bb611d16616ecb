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

"""Whole fits of small bags with messages lost, at random, in gaps and in bursts."""

import contextlib
import io
import json
import shutil

import numpy as np
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.bags.messages import joint_signals, JOINT_STATE, load_topics, Signals
from tudor_dynamics.bags.storage import open_bag
from tudor_dynamics.bags.writer import write_bag
from tudor_dynamics.cli.main import main
from tudor_dynamics.errors import TudorError
import yaml

SAMPLES = {'two_blade_train_1': 'two_blade_arm', 'two_blade_test': 'two_blade_arm',
           'tudor_damped/stimulus_01': 'tudor', 'tudor_undamped/stimulus_01': 'tudor'}
SHAPES = ('one_joint', 'one_joint_gauge', 'two_joints', 'two_joints_gauges')
"""Small bags, of which a fit takes a quarter of a second: most cases."""
OFTEN = 12  # small bags for each of those shipped
LENGTHS = {True: (10.0, 20.0), False: (5.0, 30.0)}
"""Seconds that are kept of small bags, and of those shipped."""
RATES = (50.0, 100.0)  # of small bags [Hz]
PENDULUM = {
    'name': 'pendulum', 'kinematics': {'dh': [[0.4, 0.0, 0.0, 0.0]]}, 'gravity': [0.0, -9.81, 0.0],
    'joints': [{'name': 'hinge', 'effort': {'topic': 'joint_states', 'unit': 'N m'}}]}


class Losses:
    """Bags that a fit goes through from end to end, report and thresholds included."""

    seconds, memory = 60.0, 1 << 30
    first = ('two_blade_test', *SHAPES)  # are read whole before; all would take long

    def __init__(self, folder, root):
        """Read the samples, and make the small ones."""
        self._root, self._samples = root, {}
        for name in SAMPLES:
            bag = open_bag(root / 'bags' / name, quiet=True)
            topics = [topic for topic, info in bag.topics.items() if info.msgtype == JOINT_STATE]
            self._samples[name] = [_signals(item) for item in load_topics(bag, topics).values()]
        blades = yaml.safe_load((root / 'config/two_blade_arm.yaml').read_text())
        gauge = {'gauges': [{'name': 'hub', 'joint': 'hinge', 'distance': 0.05}]}
        arms = {'one_joint': PENDULUM, 'one_joint_gauge': PENDULUM | gauge,
                'two_joints': blades | {'gauges': []}, 'two_joints_gauges': blades}
        folder.mkdir(parents=True, exist_ok=True)
        self._arms = {name: root / 'config' / f'{arm}.yaml' for name, arm in SAMPLES.items()}
        for name, content in arms.items():
            self._arms[name] = folder / f'{name}.yaml'
            self._arms[name].write_text(yaml.safe_dump(content))
            self._samples[name] = _pendulum() if content['name'] == 'pendulum' else (
                self._samples['two_blade_train_1'])
            if not content.get('gauges'):
                self._samples[name] = [item for item in self._samples[name]
                                       if 'strain' not in item.topic]

    @property
    def samples(self):
        """Names of what can be damaged: the small ones more often."""
        return [*SHAPES * OFTEN, *SAMPLES]

    def make(self, rng, sample, folder):
        """Write a bag with losses; without a generator, a whole one."""
        path = folder / 'bag'
        shutil.rmtree(path, ignore_errors=True)
        series = self._samples[sample]
        if rng is not None:
            series = _part(rng, series, sample in SHAPES)
            ways = rng.choice(len(WAYS), size=int(rng.integers(1, 4)))
            together = rng.random() < 0.3
            state = rng.bit_generator.state
            lossy = []
            for item in series:
                if together:  # the whole machine halts: the same losses for all topics
                    rng.bit_generator.state = state
                for way in ways if rng.random() < 0.8 else ():
                    item = WAYS[way](rng, item)
                lossy.append(item)
            series = [item for item in lossy if len(item.stamp) and rng.random() > 0.02]
        write_bag(path, series or self._samples[sample][:1])
        (folder / 'arm').write_text(str(self._arms[sample]))
        return path

    def use(self, path):
        """Fit, and evaluate on the same bag; a refusal must be one line."""
        model = path.with_name('model')
        shutil.rmtree(model, ignore_errors=True)
        arm = path.with_name('arm').read_text()
        found = _run(['fit', str(path), '--arm', arm, '--out', str(model), '--json'])
        load_arm(model / 'arm.yaml')
        _run(['evaluate', str(path), '--model', str(model), '--json'])
        return found

    def compare(self, path, found):
        """Say what lacks in the figures."""
        lacking = [name for name in ('uses', 'findings') if name not in found]
        return f'no {", ".join(lacking)}' if lacking else None


def _run(words):
    """Run a command: its JSON, or a TudorError of the line that it was refused with."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(words)
    if code == 2:
        raise TudorError(err.getvalue().splitlines()[-1])
    if code not in (0, 1):
        raise RuntimeError(f'{words[0]} ended with {code}: {err.getvalue()}')
    return json.loads(out.getvalue())


def _signals(decoded):
    block, = decoded.blocks
    return Signals(decoded.topic, decoded.stamp, {
        field: block.values(field).copy() for field, (_, size) in block.layout.fields.items()
        if size}, block.layout.names)


def _pendulum():
    """Give a minute of one joint that turns in the plane of gravity, with a gauge on its link."""
    t = 0.01 * np.arange(6000)
    angles = [size * np.sin(rate * t + phase) for size, rate, phase in (
        (0.8, 1.1, 0.0), (0.4, 2.7, 1.0), (0.2, 5.3, 2.0))]
    q = sum(angles)
    dq, ddq = np.gradient(q, t), np.gradient(np.gradient(q, t), t)
    noise = np.random.default_rng(0).normal(size=(2, len(t)))
    load = 0.3 * ddq + 6.0 * np.cos(q)
    stamp = 1_700_000_000_000_000_000 + 10_000_000 * np.arange(len(t))
    effort = load + 0.4 * dq + 0.5 * np.tanh(dq / 0.02) + 0.05 * noise[0]
    return [joint_signals('/joint_states', stamp, ['hinge'], *(
        x[:, None] for x in (q, dq, effort))),
        joint_signals('/link_strains', stamp, ['hub'], (12.0 * load + noise[1])[:, None])]


def _part(rng, series, small):
    """Cut a part out; of a small bag, with fewer samples a second and perhaps no velocities."""
    begin, end = series[0].stamp[0], series[0].stamp[-1]
    length = int(1e9 * rng.uniform(*LENGTHS[small]))
    if small:
        begin += int(rng.uniform(0.0, max(0, end - begin - length)))
    step = int(1e9 / rng.uniform(*RATES)) if small else 1
    quiet = small and rng.random() < 0.3
    kept = []
    for item in series:
        item = item.at((item.stamp >= begin) & (item.stamp <= begin + length))
        slots = item.stamp // step
        item = item.at(np.diff(slots, prepend=-1) > 0)
        values = {field: x for field, x in item.values.items() if not quiet or field != 'velocity'}
        kept.append(Signals(item.topic, item.stamp, values, item.names))
    return kept


def at_random(rng, item):
    """Lose a share of the messages."""
    return item.at(rng.random(len(item.stamp)) > rng.choice([0.01, 0.1, 0.3, 0.5, 0.8, 0.95]))


def gaps(rng, item):
    """Lose whole stretches."""
    keep = np.ones(len(item.stamp), bool)
    for _ in range(int(rng.choice([1, 3, 10, 50, 200]))):
        begin = rng.choice(item.stamp) if len(item.stamp) else 0
        keep &= (item.stamp < begin) | (item.stamp > begin + int(1e9 * 10 ** rng.uniform(-2, 0.7)))
    return item.at(keep)


def bursts(rng, item):
    """Lose messages as a bad radio does: it is good for a while, then bad for a while."""
    good = np.repeat(rng.random(len(item.stamp)) < 0.5, rng.integers(1, 40, len(item.stamp)))
    return item.at(good[:len(item.stamp)])


def in_time_slots(rng, item):
    """Stamp messages when a driver reads its buffer: many share a stamp."""
    slot = int(rng.choice([2, 10, 25, 100, 500]) * 1e6)
    return Signals(item.topic, item.stamp // slot * slot, item.values, item.names)


def jitter(rng, item):
    """Stamp messages late, each by another time."""
    late = (1e9 * 10 ** rng.uniform(-4, -1) * rng.random(len(item.stamp))).astype(np.int64)
    return Signals(item.topic, item.stamp + late, item.values, item.names)


def again(rng, item):
    """Repeat some messages, as a relay that receives by two ways."""
    return item.at(np.sort(np.append(np.arange(len(item.stamp)), rng.integers(
        0, max(len(item.stamp), 1), len(item.stamp) // 10))))


def not_numbers(rng, item):
    """Let a value be no number at times."""
    values = {field: x.copy() for field, x in item.values.items()}
    for x in values.values():
        x[rng.random(x.shape) < rng.choice([0.001, 0.1, 0.9])] = np.nan
    return Signals(item.topic, item.stamp, values, item.names)


def held(rng, item):
    """Let every value stay for a while, as of a sensor that is read too often or hangs."""
    step = int(rng.choice([2, 10, 100, 10_000]))
    return Signals(item.topic, item.stamp, {
        field: x[np.arange(len(x)) // step * step] for field, x in item.values.items()},
        item.names)


WAYS = (at_random, at_random, gaps, gaps, bursts, bursts, in_time_slots, jitter, again,
        not_numbers, held)
