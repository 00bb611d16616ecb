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

from tudor_dynamics._version import __version__ as __version__  # noqa: F401

if TYPE_CHECKING:
    from tudor_dynamics.arm.description import Arm, arm_from_dict, load_arm
    from tudor_dynamics.arm.limits import planned_limits
    from tudor_dynamics.bags.messages import joint_signals
    from tudor_dynamics.bags.reader import read_recording
    from tudor_dynamics.bags.recording import Recording
    from tudor_dynamics.bags.trajectory import Trajectory
    from tudor_dynamics.bags.writer import write_bag
    from tudor_dynamics.control.schedule import Schedule
    from tudor_dynamics.errors import TudorError
    from tudor_dynamics.identification.detection import Detector
    from tudor_dynamics.identification.fit import FitSettings
    from tudor_dynamics.identification.validation import score
    from tudor_dynamics.library import carried, detect, excitation, fit, predict, roc
    from tudor_dynamics.mechanics.campaign import record_stimuli, stimulus_motion, StimulusSpec
    from tudor_dynamics.mechanics.closed_loop import ClosedLoop
    from tudor_dynamics.mechanics.hardware import Imperfections, Push, with_payload
    from tudor_dynamics.mechanics.mechanism import build_mechanism
    from tudor_dynamics.mechanics.plant import Plant
    from tudor_dynamics.mechanics.rig import Loop, Rig
    from tudor_dynamics.mechanics.run import modes
    from tudor_dynamics.mechanics.study import simulate, SimulatedRun
    from tudor_dynamics.models.bundle import ModelBundle
    from tudor_dynamics.models.bundle_io import load_bundle, save_bundle
    from tudor_dynamics.models.elastic.model import ElasticModel
    from tudor_dynamics.online.contact import ContactEstimator
    from tudor_dynamics.online.feedforward import Feedforward
    from tudor_dynamics.online.monitor import Monitor, MonitorSettings
    from tudor_dynamics.parallel import on_cluster
    from tudor_dynamics.signals.motion_profile import follow_targets, motion_limits
    from tudor_dynamics.signals.preprocessing import prepare

__all__ = [
    'Arm', 'ClosedLoop', 'ContactEstimator', 'Detector', 'ElasticModel', 'Feedforward',
    'FitSettings', 'Imperfections', 'Loop', 'ModelBundle', 'Monitor', 'MonitorSettings', 'Plant',
    'Push', 'Recording', 'Rig', 'Schedule', 'SimulatedRun', 'StimulusSpec', 'Trajectory',
    'TudorError', 'arm_from_dict', 'build_mechanism', 'carried', 'detect', 'excitation', 'fit',
    'follow_targets', 'joint_signals', 'load_arm', 'load_bundle', 'modes', 'motion_limits',
    'on_cluster', 'planned_limits', 'predict', 'prepare', 'read_recording', 'record_stimuli',
    'roc', 'save_bundle', 'score', 'simulate', 'stimulus_motion', 'with_payload', 'write_bag',
]

# The same as above, for the interpreter; test/test_library.py compares them.
_HOMES = {
    'tudor_dynamics.arm.description': ('Arm', 'arm_from_dict', 'load_arm'),
    'tudor_dynamics.arm.limits': ('planned_limits',),
    'tudor_dynamics.bags.messages': ('joint_signals',),
    'tudor_dynamics.bags.reader': ('read_recording',),
    'tudor_dynamics.bags.recording': ('Recording',),
    'tudor_dynamics.bags.trajectory': ('Trajectory',),
    'tudor_dynamics.bags.writer': ('write_bag',),
    'tudor_dynamics.control.schedule': ('Schedule',),
    'tudor_dynamics.errors': ('TudorError',),
    'tudor_dynamics.parallel': ('on_cluster',),
    'tudor_dynamics.identification.detection': ('Detector',),
    'tudor_dynamics.identification.fit': ('FitSettings',),
    'tudor_dynamics.identification.validation': ('score',),
    'tudor_dynamics.library': ('carried', 'detect', 'excitation', 'fit', 'predict', 'roc'),
    'tudor_dynamics.mechanics.campaign': ('record_stimuli', 'stimulus_motion', 'StimulusSpec'),
    'tudor_dynamics.mechanics.closed_loop': ('ClosedLoop',),
    'tudor_dynamics.mechanics.hardware': ('Imperfections', 'Push', 'with_payload'),
    'tudor_dynamics.mechanics.mechanism': ('build_mechanism',),
    'tudor_dynamics.mechanics.plant': ('Plant',),
    'tudor_dynamics.mechanics.rig': ('Loop', 'Rig'),
    'tudor_dynamics.mechanics.run': ('modes',),
    'tudor_dynamics.mechanics.study': ('simulate', 'SimulatedRun'),
    'tudor_dynamics.models.bundle': ('ModelBundle',),
    'tudor_dynamics.models.bundle_io': ('load_bundle', 'save_bundle'),
    'tudor_dynamics.models.elastic.model': ('ElasticModel',),
    'tudor_dynamics.online.contact': ('ContactEstimator',),
    'tudor_dynamics.online.feedforward': ('Feedforward',),
    'tudor_dynamics.online.monitor': ('Monitor', 'MonitorSettings'),
    'tudor_dynamics.signals.motion_profile': ('follow_targets', 'motion_limits'),
    'tudor_dynamics.signals.preprocessing': ('prepare',),
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
