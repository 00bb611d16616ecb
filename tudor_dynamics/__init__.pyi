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

from .arm.description import Arm, arm_from_dict, load_arm
from .arm.limits import planned_limits
from .bags.messages import joint_signals
from .bags.reader import read_recording
from .bags.recording import Recording
from .bags.trajectory import Trajectory
from .bags.writer import write_bag
from .control.schedule import Schedule
from .errors import TudorError
from .identification.detection import Detector
from .identification.fit import FitSettings
from .identification.validation import score
from .library import carried, detect, excitation, fit, predict, roc
from .mechanics.campaign import record_stimuli, stimulus_motion, StimulusSpec
from .mechanics.closed_loop import ClosedLoop
from .mechanics.hardware import Imperfections, Push, with_payload
from .mechanics.mechanism import build_mechanism
from .mechanics.plant import Plant
from .mechanics.rig import Loop, Rig
from .mechanics.run import modes
from .mechanics.study import simulate, SimulatedRun
from .models.bundle import load_bundle, ModelBundle, save_bundle
from .models.elastic.model import ElasticModel
from .online.contact import ContactEstimator
from .online.feedforward import Feedforward
from .online.monitor import Monitor, MonitorSettings
from .parallel import on_cluster
from .signals.motion_profile import follow_targets, motion_limits
from .signals.preprocessing import prepare

__version__: str

__all__ = [
    'Arm', 'ClosedLoop', 'ContactEstimator', 'Detector', 'ElasticModel', 'Feedforward',
    'FitSettings', 'Imperfections', 'Loop', 'ModelBundle', 'Monitor', 'MonitorSettings', 'Plant',
    'Push', 'Recording', 'Rig', 'Schedule', 'SimulatedRun', 'StimulusSpec', 'Trajectory',
    'TudorError', 'arm_from_dict', 'build_mechanism', 'carried', 'detect', 'excitation', 'fit',
    'follow_targets', 'joint_signals', 'load_arm', 'load_bundle', 'modes', 'motion_limits',
    'on_cluster', 'planned_limits', 'predict', 'prepare', 'read_recording', 'record_stimuli',
    'roc', 'save_bundle', 'score', 'simulate', 'stimulus_motion', 'with_payload', 'write_bag',
]
