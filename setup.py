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

"""Packaging of tudor_dynamics; dependencies and their bounds stand in setup.cfg."""

from glob import glob

from setuptools import find_packages, setup

PACKAGE = 'tudor_dynamics'
NODES = ('joint_state_filter', 'dynamics_predictor', 'collision_detector', 'monitor',
         'monitors', 'watch', 'payload_estimator', 'feedforward',
         'oscillation_damper', 'force_controller',
         'reference_generator', 'trajectory_relay', 'arm_simulator', 'bag_player',
         'bag_recorder')

setup(
    # Not in setup.cfg: setuptools makes an object of it there, which colcon cannot read.
    python_requires='>=3.10,<3.14',
    packages=find_packages(include=[PACKAGE, f'{PACKAGE}.*']),
    package_data={PACKAGE: [
        'py.typed', '*.pyi', '**/*.html', '**/*.j2', '**/*.css', '**/*.js', '**/*.yaml']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
        (f'share/{PACKAGE}/config', sorted(glob('config/*'))),
    ],
    entry_points={
        'console_scripts': [
            'tudor = tudor_dynamics.cli.main:main',
            *(f'{node} = tudor_dynamics.nodes.{node}:{node.title().replace("_", "")}Node.main'
              for node in NODES),
            *(f'{test} = tudor_dynamics.nodes.{test}:main'
              for test in ('damper_sign_test', 'joint_test')),
        ],
    },
)
