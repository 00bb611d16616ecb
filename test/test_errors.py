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

"""Messages of errors: one line, whatever they repeat."""

from __future__ import annotations

import pickle

from tudor_dynamics.errors import BagError, MAX_MESSAGE, TudorError


def test_messages_are_one_line() -> None:
    """Line ends, control characters and endless names of a file do not get into a terminal."""
    assert str(BagError('a\n  b\x1b[2J: ä')) == 'a b?[2J: ä'
    assert str(TudorError('y' * 9999)) == 'y' * MAX_MESSAGE + '...'
    assert str(TudorError()) == ''


def test_errors_travel_between_processes() -> None:
    """What a worker raises arrives as it was."""
    err = pickle.loads(pickle.dumps(BagError('run1: no such bag')))
    assert isinstance(err, BagError) and str(err) == 'run1: no such bag'
