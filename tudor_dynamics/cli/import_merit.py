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

"""``tudor import-merit``: a bag of a CSV file of the public TUDOR recordings."""

from __future__ import annotations

import argparse

from tudor_dynamics.bags.merit import import_merit

EXAMPLES = """\
example:
  tudor import-merit exp1.csv --out bags/merit_exp1

The file has no header and 17 columns: t [s], q1..q3 [rad], dq1..dq3 [rad/s], I1..I3 [A],
eps21, eps22, eps31, eps32 [um/m], ddq1..ddq3 [rad/s^2]. The bag has /joint_states (joint1..3),
/motor_currents (effort) and /link_strains (link2_hub, link2_mid, link3_hub, link3_mid).
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``tudor import-merit``."""
    parser.add_argument('file', metavar='FILE.csv', help='recording of the MERIt dataset')
    parser.add_argument('--out', metavar='BAG', required=True,
                        help='directory to make; must not exist')
    parser.add_argument('--storage', choices=('mcap', 'sqlite3'), default='mcap',
                        help='storage format (default: mcap)')


def run(args: argparse.Namespace) -> int:
    """Convert the file."""
    count = import_merit(args.file, args.out, storage=args.storage)
    print(f'{args.out}: {count} samples of /joint_states, /motor_currents and /link_strains')
    return 0
