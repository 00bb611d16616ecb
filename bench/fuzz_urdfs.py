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
URDFs with faults that people make: no traceback, no signal, no hang.

Loops, several roots, missing links, mimic joints, axes without length, inertias that cannot be,
numbers that are none, limits of 0, remains of xacro; each is read in a process of its own kind,
and refused on one line or made a model of.

    python bench/fuzz_urdfs.py --urdfs 2000 --seed 1
    python bench/fuzz_urdfs.py --only urdfs:17 --keep DIR
"""

import sys

from fuzz import main

if __name__ == '__main__':
    sys.exit(main(__doc__, {'urdfs': 2000}))
