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
Files that people write or programs send: no traceback, no hang, no number that is none.

Plans of `tudor excite`, compared with a fit and played; trajectories as tables and messages, fed
forward, filled and driven; pushes as tables and topics, by which alarms are judged; plans of
fleets, through the whole comparison. Cells, messages, values and bytes are damaged by a seed.

    python bench/fuzz_files.py --plans 1000 --seed 1
    python bench/fuzz_files.py --only truths:17 --keep DIR
"""

import sys

from fuzz import main

if __name__ == '__main__':
    sys.exit(main(__doc__, {'plans': 1000, 'trajectories': 1000, 'truths': 1000, 'fleets': 200}))
