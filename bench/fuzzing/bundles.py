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

"""Model bundles, damaged, with checksums that are right again."""

import hashlib
import io
import shutil
import zipfile

from fuzzing.mutate import in_bytes, in_values, ODD_VALUES
import numpy as np

from tudor_dynamics.arm.description import arm_from_dict
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.errors import TudorError
from tudor_dynamics.files import load_yaml
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import dump_yaml, load_bundle, ModelBundle, save_bundle
from tudor_dynamics.models.elastic.model import driven_arm, ElasticModel, PhysicalParameter
from tudor_dynamics.models.elm import ExtremeLearningMachine
from tudor_dynamics.models.regressor import EffortRegressor, StrainRegressor
from tudor_dynamics.online.settings import LAGS, WINDOW
from tudor_dynamics.online.threshold_learning import stored_thresholds, thresholds_to_dict
from tudor_dynamics.online.thresholds import MethodThresholds, Tail

MARK = b'checksum: '
JOINTS = ('j1', 'j2')
GAUGES = ('g1', 'g2')
BLADE = {'section': {'shape': 'rectangle', 'height': 0.004, 'width': 0.015},
         'material': {'E': 2.06e11, 'nu': 0.29, 'rho': 7850}, 'elements': 1, 'stretch': False}
ARM = {'name': 'blades', 'kinematics': {'dh': [[0.42, 0, 0, 0], [0.35, 0, 0, 0]]},
       'gravity': [0.0, -9.81, 0.0], 'joints': [{'name': name} for name in JOINTS],
       'gauges': [{'name': gauge, 'joint': joint, 'distance': 0.05}
                  for gauge, joint in zip(GAUGES, JOINTS)],
       'links': [{'joint': 'j1', 'flexible': {**BLADE, 'lumped': [{'mass': 0.8}]}},
                 {'joint': 'j2', 'flexible': BLADE}],
       'motors': [{'joint': name, 'gear_ratio': 200, 'torque_constant': 0.05, 'stiffness': 200.0,
                   'damping': 0.2, 'backlash': 0.01} for name in JOINTS],
       'payload': {'mass': 0.2}, 'simulation': {'rayleigh': {'beta': 5e-4}}}
PHYSICAL = (PhysicalParameter('bending(j1)', 15.25, 'N m^2', 0.125, True),
            PhysicalParameter('play(j2)', 0.003, 'rad', 0.004, False),
            PhysicalParameter('payload', 0.2, 'kg'))


def _motion(samples):
    t = 0.01 * np.arange(samples)[:, None]
    rate = np.array([2.0, 3.0])
    return np.hstack([np.sin(rate * t), rate * np.cos(rate * t), -rate**2 * np.sin(rate * t)])


def _elastic(arm, output):
    model = ElasticModel(arm, output, PHYSICAL)
    model.coefficients_ = tuple(np.linspace(0.1, 0.7, len(c)) for c in model.columns)
    model.standard_errors_ = tuple(np.full(len(c), 0.01) for c in model.columns)
    model.noise_ = np.array([2.0, 3.0])
    return model


def _thresholds(channels):
    n = len(channels)
    return thresholds_to_dict(MethodThresholds(
        channels, 0.01, np.zeros((LAGS + WINDOW, n, n)), np.ones((2 * n, 1 + 4 * len(JOINTS))),
        tuple(Tail(1.0, 0.1, 0.1, 0.1, 2.0, 100) for _ in range(3 * n)), 60.0,
        np.ones(n), np.ones(len(JOINTS)), np.zeros(n)))


class Bundles:
    """Bundles of all kinds of models."""

    name = 'bundles'

    def __init__(self, folder):
        """Write the samples."""
        arm = arm_from_dict(ARM, base=folder, source='fuzz')
        motion = _motion(300)
        rng = np.random.default_rng(0)
        rigid = {}
        for output, regressor in (('effort', EffortRegressor(arm)),
                                  ('strain', StrainRegressor(arm))):
            rows = regressor.rows(motion)
            values = rows @ rng.uniform(0, 1, rows.shape[2]) + rng.normal(0, 0.1, rows.shape[:2])
            rigid[output] = {
                'analytical': AnalyticalModel(regressor, 2).fit(motion, values),
                'elm': ExtremeLearningMachine(regressor.channels, hidden=5).fit(motion, values)}
        thresholds = {method: {'analytical': _thresholds(channels)} for method, channels in (
            ('effort', JOINTS), ('strain', GAUGES), ('momentum', JOINTS))}
        elastic = {output: {'elastic': _elastic(arm, output)} for output in ('effort', 'strain')}
        self._samples = {}
        for name, models, facts in (('rigid', rigid, {'thresholds': thresholds}),
                                    ('elastic', elastic, {'training': [{'bag': 'run 1'}]})):
            save_bundle(ModelBundle(arm, PreprocessingSpec(), models, facts), folder / name)
            self._samples[name] = {file.name: file.read_bytes()
                                   for file in (folder / name).iterdir()}

    @property
    def samples(self):
        """Names of what can be damaged."""
        return sorted(self._samples)

    def make(self, rng, sample, folder):
        """Write one damaged bundle; without a generator, a whole one."""
        files = dict(self._samples[sample])
        if rng is not None:
            files = self._damage(rng, files)
        path = folder / 'model'
        shutil.rmtree(path, ignore_errors=True)
        path.mkdir(parents=True)
        for name, data in files.items():
            (path / name).write_bytes(data)
        return path

    def _damage(self, rng, files):
        head = files['model.yaml'].rpartition(MARK)[0]
        kind = rng.random()
        if kind < 0.1:
            name = sorted(files)[int(rng.integers(len(files)))]
            return {**files, name: in_bytes(rng, files[name])}
        if kind < 0.65:
            head = _dump(in_values(rng, load_yaml(head)))
        elif kind < 0.75:
            head = in_bytes(rng, head)
        else:
            if kind < 0.85 or 'elm.npz' not in files:
                name = 'arm.yaml'
                data = (in_bytes(rng, files[name]) if rng.random() < 0.3 else
                        _dump(in_values(rng, load_yaml(files[name]))))
            else:
                name = 'elm.npz'
                data = (in_bytes(rng, files[name]) if rng.random() < 0.3 else
                        _arrays(rng, files[name]))
            files = {**files, name: data}
            content = load_yaml(head)
            content['files'][name] = hashlib.sha256(data).hexdigest()
            if name == 'arm.yaml':
                try:  # else nothing past the digest is ever seen
                    arm = arm_from_dict(load_yaml(data), base=None, source='')
                    content['arm']['digest'] = arm.digest
                except Exception:  # noqa: S110 (the check says how it ends, not this)
                    pass
            head = _dump(content)
        return {**files,
                'model.yaml': head + MARK + hashlib.sha256(head).hexdigest().encode() + b'\n'}

    def use(self, path):
        """Load and predict; TudorError where the bundle is refused."""
        bundle = load_bundle(path)
        motion = _motion(40)
        n = len(bundle.arm.active_joints)
        if n != len(JOINTS):
            motion = np.tile(motion[:, :1], (1, 3 * n))
        for kind in ('analytical', 'elm'):
            try:
                stored_thresholds(bundle.facts.get('thresholds'), bundle.arm, kind)
            except TudorError:
                pass
        predicted = {}
        for output, kinds in bundle.models.items():
            for kind, model in kinds.items():
                if getattr(model, 'payload_range', None) is not None:
                    model = model.at(0.1)
                values = (model.prepared()(driven_arm(model.arm, model.values).follow(
                    motion[:, :model.n_joints],
                    np.where(np.arange(len(motion)), 0.01, 0.0)), motion)
                    if isinstance(model, ElasticModel) else model.predict(motion))
                predicted[output, kind] = values
        return predicted

    def compare(self, path, found):
        """Say which predictions are no numbers."""
        bad = [f'{output} {kind}' for (output, kind), values in found.items()
               if not np.all(np.isfinite(values))]
        return f'{", ".join(bad)}: predicts no numbers' if bad else None


def _dump(content):
    return dump_yaml(content).encode()


def _arrays(rng, data):
    """Damage one array: a value, its shape, its type, or its name."""
    with np.load(io.BytesIO(data)) as archive:
        arrays = {name: archive[name] for name in archive.files}
    name = sorted(arrays)[int(rng.integers(len(arrays)))]
    array = arrays[name].copy()
    kind = rng.integers(5)
    if kind == 0:
        value = ODD_VALUES[int(rng.integers(3, 14))]
        array.flat[int(rng.integers(array.size))] = min(float(value), 1e308)
    elif kind == 1:
        array = array.reshape(-1)[:int(rng.integers(array.size))]
    elif kind == 2:
        array = array.astype(str(rng.choice(['f4', 'i8', 'c16', 'U5', 'S3', 'bool', 'f2'])))
    elif kind == 3:
        arrays.pop(name)
        name += 'x'
    else:
        array = array * float(rng.choice([1e-300, 1e10, 1e100, -1, np.nan]))
    arrays[name] = array
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    content = buffer.getvalue()
    if rng.random() < 0.2:  # a member that no archive of arrays has
        with zipfile.ZipFile(buffer, 'a') as archive:
            archive.writestr('more.txt', rng.bytes(50))
        content = buffer.getvalue()
    return content
