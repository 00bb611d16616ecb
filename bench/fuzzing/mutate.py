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

"""Damage: to bytes, and to plain values."""

import copy

ODD_BYTES = (0x00, 0x01, 0x7F, 0x80, 0xFE, 0xFF)
ODD_NUMBERS = (0, 1, 2**7, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**62, 2**63 - 1, 2**63,
               2**64 - 1)
ODD_VALUES = (None, True, 0, -1, 1, 0.0, -0.0, 1e-300, 1e300, -1e300, 1e15, float('nan'),
              float('inf'), float('-inf'), 10**30, '', 'x', '\x1b[2J', 'ü' * 40, 'y' * 5000, [],
              {}, [[]], [0] * 200, {'a': {'b': 'c'}}, '../../etc/passwd', '/dev/zero', '1e3', '~')


def in_bytes(rng, data):
    """Give a copy of bytes with one to four kinds of damage."""
    data = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        if not data:
            break
        at = int(rng.integers(len(data)))
        size = int(rng.integers(1, 1 + min(64, len(data) - at)))
        other = int(rng.integers(len(data)))
        kind = rng.integers(9)
        if kind == 0:
            data[at] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            data[at] = int(rng.integers(256))
        elif kind == 2:
            data[at] = ODD_BYTES[int(rng.integers(len(ODD_BYTES)))]
        elif kind == 3:
            width = int(rng.choice([2, 4, 8]))
            number = ODD_NUMBERS[int(rng.integers(len(ODD_NUMBERS)))] % (1 << 8 * width)
            data[at:at + width] = number.to_bytes(width, rng.choice(['little', 'big']))
        elif kind == 4:
            data[at:at + size] = data[other:other + size]
        elif kind == 5:
            data[at:at] = data[other:other + size]
        elif kind == 6:
            del data[at:at + size]
        elif kind == 7:
            data[at:at] = rng.bytes(size)
        elif rng.random() < 0.2:
            del data[at:]
    return bytes(data)


def _places(content, path=()):
    """Give the path of every value in nested dictionaries and lists."""
    found = [path] if path else []
    if isinstance(content, dict):
        items = content.items()
    elif isinstance(content, list):
        items = enumerate(content)
    else:
        return found
    for key, item in items:
        found += _places(item, (*path, key))
    return found


def in_values(rng, content):
    """Give a copy of nested plain values with one to three of them damaged."""
    content = copy.deepcopy(content)
    for _ in range(int(rng.integers(1, 4))):
        places = _places(content)
        if not places:
            break
        *path, key = places[int(rng.integers(len(places)))]
        holder = content
        for step in path:
            holder = holder[step]
        kind = rng.integers(6)
        if kind == 0:
            del holder[key]
        elif kind == 1 and isinstance(holder, list):
            holder.insert(key, copy.deepcopy(holder[key]))
        elif kind == 2 and isinstance(holder, dict):
            holder[str(ODD_VALUES[int(rng.integers(len(ODD_VALUES)))])[:60]] = holder.pop(key)
        elif kind == 3 and isinstance(holder[key], (int, float)):
            holder[key] = holder[key] * float(rng.choice([-1, 1e3, 1e-3, 1e9, 1e-9, 0.5, 1e100]))
        elif kind == 4:
            *path, other = places[int(rng.integers(len(places)))]
            source = content
            try:
                for step in path:
                    source = source[step]
                holder[key] = copy.deepcopy(source[other])
            except (KeyError, IndexError, TypeError):
                continue  # was damaged before
        else:
            holder[key] = copy.deepcopy(ODD_VALUES[int(rng.integers(len(ODD_VALUES)))])
    return content
