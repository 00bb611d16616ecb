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

"""``python -m tudor_dynamics.nodes NAME``: run a node of a checkout that is not installed."""

from importlib import import_module
from importlib.util import find_spec
import sys

if __name__ == '__main__':
    name = sys.argv.pop(1) if len(sys.argv) > 1 else ''
    if not name.isidentifier() or find_spec(f'{__package__}.{name}') is None:
        sys.exit(f'no node {name!r}; `ros2 pkg executables tudor_dynamics` lists them')
    module = import_module(f'{__package__}.{name}')
    own = getattr(module, f'{name.title().replace("_", "")}Node', module)  # some are no nodes
    sys.exit(own.main())
