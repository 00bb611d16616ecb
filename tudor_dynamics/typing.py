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
Types with one name everywhere, and what arrays of one name hold where a docstring says no more.

Samples come first, channels last; a single sample has no axis of samples. ``t`` and ``dt`` are the
time and the time since the sample before [s], where 0 restarts a filter; ``stamp`` is the stamp of
a message [ns]. ``motion``, of one sample ``row``, is ``[q, dq, ddq]`` of the active joints in
columns, shape (samples, 3 joints) [rad, rad/s, rad/s^2 or m, m/s, m/s^2]. ``measured``,
``predicted``, ``residual`` and ``output`` have the shape (samples, channels) and the units of the
arm description, ``strain`` (samples, gauges), and ``moment`` the same [N m]. Of a motion, ``q``,
``dq``, ``ddq`` are its parts, and so are positions and speeds that joints are commanded or
``held`` at, each (joints,) for one sample; ``now`` is the time by the clock of this machine [s].
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from html import escape
import re
from textwrap import shorten

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tudor_dynamics.errors import SignalError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
IndexArray = NDArray[np.intp]
Progress = Callable[[str], None]  # told what is done next


def finite_array(values: ArrayLike, name: str, *shape: int | None) -> FloatArray:
    """Take finite numbers of a shape, in which None is any length; anything else is refused."""
    try:
        found = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise SignalError(f'{name} is {repr(values)[:60]}; expected numbers') from None
    if found.ndim != len(shape) or any(
            wanted not in (None, size) for wanted, size in zip(shape, found.shape, strict=True)):
        words = ', '.join('any' if size is None else str(size) for size in shape)
        raise SignalError(f'{name} has the shape {found.shape}; expected ({words})')
    if not np.isfinite(found).all():
        raise SignalError(f'{name} has NaN or infinite values', remedy='leave out such samples')
    return found


# -- How results show themselves: as lines on a terminal, as a table in a notebook

LONGEST = 200  # characters of a part: less than three lines of 80


class Shown:
    """A result that shows a line of what it is, and an indented one for each of its parts."""

    def __repr__(self) -> str:
        """Write fields, or public attributes: arrays by shape and range, others in short."""
        names = [item.name for item in fields(self)] if is_dataclass(self) else vars(self)
        return '\n'.join([type(self).__name__, *(
            f'  {name}: {in_short(getattr(self, name))}' for name in names if name[0] != '_')])

    def _repr_html_(self) -> str:
        caption, *lines = escape(repr(self)).splitlines()
        rows = ''.join(
            '<tr><th style="text-align: left">{}</th><td style="text-align: left">{}</td></tr>'
            .format(name, text) for name, _, text in (line.partition(': ') for line in lines))
        return f'<table><caption>{caption}</caption>{rows}</table>'


def in_short(value: object) -> str:
    """Write a value in a line: what is long by its length, kind and range."""
    if isinstance(value, np.ndarray):
        numeric = value.dtype.kind in 'fiu' and value.size and not np.isnan(value).all()
        ends = f' from {np.nanmin(value):.4g} to {np.nanmax(value):.4g}' if numeric else ''
        return f'{value.dtype} {value.shape}{ends}'
    if isinstance(value, float):
        return f'{value:.4g}'
    text = re.sub(r'<(?:function )?(?:[\w<>]+\.)*([\w<>]+)(?: object)? at 0x\w+>', r'\1',
                  repr(value))
    if isinstance(value, (tuple, list, dict)) and (len(text) > LONGEST or '\n' in text):
        kinds = sorted({type(item).__name__ for item in (
            value.values() if isinstance(value, dict) else value)})
        return f'{len(value)} of {" or ".join(kinds)}'
    return shorten(text.partition('\n')[0], LONGEST, placeholder=' ...')
