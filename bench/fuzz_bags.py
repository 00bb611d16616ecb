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
Bags that lost messages, through the whole fit: no traceback, no hang, no model without figures.

Messages are lost at random, in gaps and in bursts, stamped in slots, late or twice, by a seed;
each bag is fitted with its thresholds and report, then evaluated. Most bags are small: one joint
or two, with gauges and without, 10 to 20 s at 50 to 100 Hz; the others are those of bags/.
10 000 bags take about an hour of one core.

    python bench/fuzz_bags.py --losses 500 --seed 1
    python bench/fuzz_bags.py --only losses:17 --keep DIR
"""

import sys

from fuzz import main

if __name__ == '__main__':
    sys.exit(main(__doc__, {'losses': 500}))
