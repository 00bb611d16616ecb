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

"""Bags: rosbag2 to and from numpy arrays; the one place that knows message layouts offline."""

from tudor_dynamics.bags.labels import read_flags, read_wrenches
from tudor_dynamics.bags.layouts.messages import JointStateSeries, WrenchSeries
from tudor_dynamics.bags.opening import open_bag
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.bags.writer import recording_series, write_bag

__all__ = [
    'JointStateSeries', 'Recording', 'WrenchSeries', 'open_bag', 'read_flags',
    'read_recording', 'read_wrenches', 'recording_series', 'write_bag',
]
