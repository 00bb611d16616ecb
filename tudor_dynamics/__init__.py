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
    from tudor_dynamics.arm.description import Arm
    from tudor_dynamics.arm.limits import planned_limits
    from tudor_dynamics.arm.loading import arm_from_dict, load_arm
    from tudor_dynamics.bags.reader import read_recording
    from tudor_dynamics.bags.recording import Recording
    from tudor_dynamics.bags.trajectory import Trajectory
    from tudor_dynamics.cluster import on_cluster
    from tudor_dynamics.contact.estimator import ContactEstimator
    from tudor_dynamics.control.schedule import Schedule
    from tudor_dynamics.control.shaped_motion import ShapedPlanner, Shaping
    from tudor_dynamics.errors import TudorError
    from tudor_dynamics.feedforward.feedforward import Feedforward
    from tudor_dynamics.identification.fit import FitSettings
    from tudor_dynamics.identification.metrics import score
    from tudor_dynamics.library.detection import detect
    from tudor_dynamics.library.force_rig import ForceRig
    from tudor_dynamics.library.from_bags import fit
    from tudor_dynamics.library.payload import carried
    from tudor_dynamics.library.prediction import predict
    from tudor_dynamics.models.bundle import ModelBundle
    from tudor_dynamics.models.elastic.model import ElasticModel
    from tudor_dynamics.models.storage.bundle_io import load_bundle, save_bundle
    from tudor_dynamics.models.tuning.design import design, fixed_ratios, Wish
    from tudor_dynamics.models.tuning.refined_moves import MoveRefiner
    from tudor_dynamics.models.tuning.small_motion import TunedArm
    from tudor_dynamics.monitoring.followed_load import follow_load
    from tudor_dynamics.monitoring.monitor import Monitor
    from tudor_dynamics.monitoring.settings import MonitorSettings
    from tudor_dynamics.report.schedule import draw_schedule
    from tudor_dynamics.signals.motion_profile import follow_targets, motion_limits
    from tudor_dynamics.signals.preprocessing import prepare
    from tudor_dynamics.simulation.loop.campaign import record_stimuli, StimulusSpec
    from tudor_dynamics.simulation.loop.closed_loop import ClosedLoop
    from tudor_dynamics.simulation.loop.drive import Imperfections
    from tudor_dynamics.simulation.loop.load_changes import random_loads
    from tudor_dynamics.simulation.loop.push_truth import random_pushes
    from tudor_dynamics.simulation.loop.pushes import Push
    from tudor_dynamics.simulation.loop.rig import Rig
    from tudor_dynamics.simulation.loop.signals import with_payload
    from tudor_dynamics.simulation.loop.stimulus_motion import stimulus_motion
    from tudor_dynamics.simulation.mechanics.mechanism import build_mechanism
    from tudor_dynamics.simulation.plant.modes import modes
    from tudor_dynamics.simulation.plant.plant import Plant
    from tudor_dynamics.simulation.studies.study import simulate, SimulatedRun

__all__ = [
    'Arm', 'ClosedLoop', 'ContactEstimator', 'ElasticModel', 'Feedforward', 'FitSettings',
    'ForceRig', 'Imperfections', 'ModelBundle', 'Monitor', 'MonitorSettings', 'MoveRefiner',
    'Plant', 'Push', 'Recording', 'Rig', 'Schedule', 'ShapedPlanner', 'Shaping',
    'SimulatedRun', 'StimulusSpec', 'Trajectory', 'TudorError', 'TunedArm', 'Wish',
    'arm_from_dict', 'build_mechanism', 'carried', 'design', 'detect', 'draw_schedule', 'fit',
    'fixed_ratios', 'follow_load', 'follow_targets', 'load_arm', 'load_bundle', 'modes',
    'motion_limits', 'on_cluster', 'planned_limits', 'predict', 'prepare', 'random_loads',
    'random_pushes', 'read_recording', 'record_stimuli', 'save_bundle', 'score', 'simulate',
    'stimulus_motion', 'with_payload',
]

# The same as above, for the interpreter; test/test_library.py compares them.
_HOMES = {
    'tudor_dynamics.arm.description': ('Arm',),
    'tudor_dynamics.arm.limits': ('planned_limits',),
    'tudor_dynamics.arm.loading': ('arm_from_dict', 'load_arm'),
    'tudor_dynamics.bags.reader': ('read_recording',),
    'tudor_dynamics.bags.recording': ('Recording',),
    'tudor_dynamics.bags.trajectory': ('Trajectory',),
    'tudor_dynamics.cluster': ('on_cluster',),
    'tudor_dynamics.contact.estimator': ('ContactEstimator',),
    'tudor_dynamics.control.schedule': ('Schedule',),
    'tudor_dynamics.control.shaped_motion': ('ShapedPlanner', 'Shaping'),
    'tudor_dynamics.errors': ('TudorError',),
    'tudor_dynamics.feedforward.feedforward': ('Feedforward',),
    'tudor_dynamics.identification.fit': ('FitSettings',),
    'tudor_dynamics.identification.metrics': ('score',),
    'tudor_dynamics.library.detection': ('detect',),
    'tudor_dynamics.library.force_rig': ('ForceRig',),
    'tudor_dynamics.library.from_bags': ('fit',),
    'tudor_dynamics.library.payload': ('carried',),
    'tudor_dynamics.library.prediction': ('predict',),
    'tudor_dynamics.models.bundle': ('ModelBundle',),
    'tudor_dynamics.models.elastic.model': ('ElasticModel',),
    'tudor_dynamics.models.storage.bundle_io': ('load_bundle', 'save_bundle'),
    'tudor_dynamics.models.tuning.design': ('design', 'fixed_ratios', 'Wish'),
    'tudor_dynamics.models.tuning.refined_moves': ('MoveRefiner',),
    'tudor_dynamics.models.tuning.small_motion': ('TunedArm',),
    'tudor_dynamics.monitoring.followed_load': ('follow_load',),
    'tudor_dynamics.monitoring.monitor': ('Monitor',),
    'tudor_dynamics.monitoring.settings': ('MonitorSettings',),
    'tudor_dynamics.report.schedule': ('draw_schedule',),
    'tudor_dynamics.signals.motion_profile': ('follow_targets', 'motion_limits'),
    'tudor_dynamics.signals.preprocessing': ('prepare',),
    'tudor_dynamics.simulation.loop.campaign': ('record_stimuli', 'StimulusSpec'),
    'tudor_dynamics.simulation.loop.closed_loop': ('ClosedLoop',),
    'tudor_dynamics.simulation.loop.drive': ('Imperfections',),
    'tudor_dynamics.simulation.loop.load_changes': ('random_loads',),
    'tudor_dynamics.simulation.loop.push_truth': ('random_pushes',),
    'tudor_dynamics.simulation.loop.pushes': ('Push',),
    'tudor_dynamics.simulation.loop.rig': ('Rig',),
    'tudor_dynamics.simulation.loop.signals': ('with_payload',),
    'tudor_dynamics.simulation.loop.stimulus_motion': ('stimulus_motion',),
    'tudor_dynamics.simulation.mechanics.mechanism': ('build_mechanism',),
    'tudor_dynamics.simulation.plant.modes': ('modes',),
    'tudor_dynamics.simulation.plant.plant': ('Plant',),
    'tudor_dynamics.simulation.studies.study': ('simulate', 'SimulatedRun'),
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
