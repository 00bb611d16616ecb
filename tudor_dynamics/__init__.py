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
Dynamics of lightweight and elastic robot arms, learned from rosbags.

The names below are the library, for scripts and notebooks: ``import tudor_dynamics as td``. Each
is imported where it is first used, so that the import itself takes no time.
"""

import importlib
from typing import TYPE_CHECKING

from tudor_dynamics._version import __version__  # noqa: F401

if TYPE_CHECKING:
    from tudor_dynamics.arm.description import Arm
    from tudor_dynamics.arm.loading import load_arm
    from tudor_dynamics.bags.reader import read_recording
    from tudor_dynamics.bags.recording import Recording
    from tudor_dynamics.bags.trajectory import Trajectory
    from tudor_dynamics.errors import TudorError
    from tudor_dynamics.feedforward.feedforward import Feedforward
    from tudor_dynamics.identification.fit import FitSettings
    from tudor_dynamics.library.from_bags import fit
    from tudor_dynamics.library.payload import carried
    from tudor_dynamics.library.prediction import predict
    from tudor_dynamics.models.bundle import ModelBundle
    from tudor_dynamics.models.storage.bundle_io import load_bundle, save_bundle
    from tudor_dynamics.monitoring.monitor import Monitor
    from tudor_dynamics.monitoring.settings import MonitorSettings
    from tudor_dynamics.simulation.mechanics.mechanism import build_mechanism
    from tudor_dynamics.simulation.plant.modes import modes
    from tudor_dynamics.simulation.plant.plant import Plant
    from tudor_dynamics.simulation.studies.study import simulate

__all__ = [
    'Arm', 'Feedforward', 'FitSettings', 'ModelBundle', 'Monitor', 'MonitorSettings', 'Plant',
    'Recording', 'Trajectory', 'TudorError', 'build_mechanism', 'carried', 'fit', 'load_arm',
    'load_bundle', 'modes', 'predict', 'read_recording', 'save_bundle', 'simulate',
]

# The same as above, for the interpreter; test/test_library.py compares them.
_HOMES = {
    'tudor_dynamics.arm.description': ('Arm',),
    'tudor_dynamics.arm.loading': ('load_arm',),
    'tudor_dynamics.bags.reader': ('read_recording',),
    'tudor_dynamics.bags.recording': ('Recording',),
    'tudor_dynamics.bags.trajectory': ('Trajectory',),
    'tudor_dynamics.errors': ('TudorError',),
    'tudor_dynamics.feedforward.feedforward': ('Feedforward',),
    'tudor_dynamics.identification.fit': ('FitSettings',),
    'tudor_dynamics.library.from_bags': ('fit',),
    'tudor_dynamics.library.payload': ('carried',),
    'tudor_dynamics.library.prediction': ('predict',),
    'tudor_dynamics.models.bundle': ('ModelBundle',),
    'tudor_dynamics.models.storage.bundle_io': ('load_bundle', 'save_bundle'),
    'tudor_dynamics.monitoring.monitor': ('Monitor',),
    'tudor_dynamics.monitoring.settings': ('MonitorSettings',),
    'tudor_dynamics.simulation.mechanics.mechanism': ('build_mechanism',),
    'tudor_dynamics.simulation.plant.modes': ('modes',),
    'tudor_dynamics.simulation.plant.plant': ('Plant',),
    'tudor_dynamics.simulation.studies.study': ('simulate',),
}


def __getattr__(name: str) -> object:
    """Import a name of the library where it is first used (PEP 562)."""
    for module, names in _HOMES.items():
        if name in names:
            value = globals()[name] = getattr(importlib.import_module(module), name)
            return value
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')


def __dir__() -> list[str]:
    """List what is there, imported or not."""
    return sorted({*globals(), *__all__})
