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

"""What is odd about a bag, collected while it is read."""

from __future__ import annotations

import warnings

from tudor_dynamics.errors import TudorWarning


class Notes:
    """Collect oddities and warn of each."""

    def __init__(self, path: str, *, quiet: bool = False) -> None:
        self.path = path
        self.texts: list[str] = []
        self.lacking: list[str] = []
        self._quiet = quiet

    def add(self, text: str, *, lacking: bool = False) -> None:
        """Note an oddity, once."""
        if text in self.texts:
            return
        self.texts.append(text)
        if lacking:
            self.lacking.append(text)
        if not self._quiet:
            warnings.warn(f'{self.path}: {text}', TudorWarning, stacklevel=3)
