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

"""All cases of the tests that a run of all tests thins out; arguments are those of pytest."""

from __future__ import annotations

import os
from pathlib import Path
import sys

import pytest

TESTS = Path(__file__).parent.parent / 'test'
sys.path.insert(0, str(TESTS))

from thinned import ALL  # noqa: E402, I100


def main() -> int:
    """Run the files that thin out their cases."""
    os.environ[ALL] = '1'
    files = sorted(str(file) for file in TESTS.rglob('test_*.py')
                   if 'from thinned import' in file.read_text(encoding='utf-8'))
    return int(pytest.main(['-q', *sys.argv[1:], *files]))


if __name__ == '__main__':
    raise SystemExit(main())
