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

"""Numbers, units and names as the report writes them."""

from __future__ import annotations

import math
import re

LONGEST_NAME = 40
"""Characters of a name in a figure."""


def number(value: float, digits: int = 3) -> str:
    """Write a number for a reader."""
    if not math.isfinite(value):
        return 'n/a' if math.isnan(value) else ('∞' if value > 0 else '−∞')
    if value == 0.0:
        return '0'
    exponent = math.floor(math.log10(abs(float(f'{value:.{digits - 1}e}'))))
    if -4 <= exponent < 6:
        text = f'{value:.{max(0, digits - 1 - exponent)}f}'
    else:
        text = f'{value:.{digits - 1}e}'
    return text.replace('-', '−')


def pretty_unit(unit: str) -> str:
    """Write a unit as it is printed: µ, a dot between factors, raised exponents."""
    text = re.sub(r'\((\w)\)', r'\1', unit.replace('um/m', 'µm/m'))
    for plain, raised in (('^2', '²'), ('^(1/3)', '^⅓'), (' ', '·')):
        text = text.replace(plain, raised)
    return text


def pretty_name(name: str, longest: int = LONGEST_NAME) -> str:
    """Cut a name that would run out of a figure, and leave out what SVG cannot hold."""
    short = name if len(name) <= longest else name[:longest - 3] + '...'
    return ''.join(c if c.isprintable() else '?' for c in short)
