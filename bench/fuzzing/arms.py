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

"""Arm descriptions and URDFs, damaged."""

import re
import shutil

from fuzzing.mutate import in_bytes, in_values, ODD_VALUES
import numpy as np

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.errors import TudorError
from tudor_dynamics.files import load_yaml
from tudor_dynamics.mechanics.mechanism import build_mechanism
from tudor_dynamics.models.bundle import dump_yaml
from tudor_dynamics.models.regressor import EffortRegressor, StrainRegressor

MAX_JOINTS = 12
"""More joints only make the check slow."""


class Arms:
    """Every description of ``config``, and the URDF."""

    name = 'arms'

    def __init__(self, folder, root):
        """Read the samples."""
        self._urdf = (root / 'config' / 'tudor.urdf').read_bytes()
        self._samples = {file.stem: file.read_bytes()
                         for file in sorted((root / 'config').glob('*.yaml'))
                         if file.name != 'nodes.yaml'}

    @property
    def samples(self):
        """Names of what can be damaged."""
        return sorted(self._samples)

    def make(self, rng, sample, folder):
        """Write one damaged description; without a generator, a whole one."""
        description, urdf = self._samples[sample], self._urdf
        if rng is not None:
            kind = rng.random()
            uses_urdf = b'urdf:' in description
            if uses_urdf and kind < 0.7:
                urdf = in_bytes(rng, urdf) if kind < 0.25 else _in_xml(rng, urdf)
            elif kind < 0.8:
                description = dump_yaml(in_values(rng, load_yaml(description))).encode()
            else:
                description = in_bytes(rng, description)
        path = folder / 'arm'
        shutil.rmtree(path, ignore_errors=True)
        path.mkdir(parents=True)
        (path / 'arm.yaml').write_bytes(description)
        (path / 'tudor.urdf').write_bytes(urdf)
        return path / 'arm.yaml'

    def use(self, path):
        """Load, build all models, compute rows; TudorError where it is refused."""
        return use_arm(path)[1]

    def compare(self, path, found):
        """Say which rows are no numbers."""
        bad = [name for name, rows in found.items() if not np.all(np.isfinite(rows))]
        return f'{", ".join(bad)}: rows are no numbers' if bad else None


def use_arm(path):
    """Load an arm, build all models, compute rows."""
    arm = load_arm(path)
    arm.digest  # noqa: B018 (computed when asked for)
    n = len(arm.active_joints)
    if n > MAX_JOINTS:
        return arm, {}
    motion = np.random.default_rng(0).uniform(-1, 1, (5, 3 * n))
    found = {'effort': EffortRegressor(arm).rows(motion)}
    if arm.gauges:
        found['strain'] = StrainRegressor(arm).rows(motion)
    try:
        build_mechanism(arm)
    except TudorError:
        pass
    return arm, found


def _in_xml(rng, text):
    """Damage attributes, or whole elements."""
    text = text.decode()
    for _ in range(int(rng.integers(1, 4))):
        places = list(re.finditer(r'="([^"]*)"', text))
        at = places[int(rng.integers(len(places)))]
        if rng.random() < 0.7:
            value = str(ODD_VALUES[int(rng.integers(len(ODD_VALUES)))])
            other = places[int(rng.integers(len(places)))][1]
            value = re.sub(r'[<>&"\x00-\x1f]', '', value if rng.random() < 0.6 else other)
            text = f'{text[:at.start(1)]}{value}{text[at.end(1):]}'
            continue
        elements = list(re.finditer(r'<(link|joint)\b.*?</\1>|<\w+ [^>]*/>', text, re.DOTALL))
        if elements:
            chosen = elements[int(rng.integers(len(elements)))]
            again = chosen[0] if rng.random() < 0.5 else ''
            text = f'{text[:chosen.start()]}{again * 2}{text[chosen.end():]}'
    return text.encode()
