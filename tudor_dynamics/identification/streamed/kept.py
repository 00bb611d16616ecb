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

"""What bags came to, in files that a fit takes up again: whole, or as if they were not there."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
import json
from pathlib import Path
import re
from typing import Any

import numpy as np

from tudor_dynamics.errors import TudorError
from tudor_dynamics.files import read_bounded, write_whole
from tudor_dynamics.identification.bag_facts import BagFacts
from tudor_dynamics.identification.metrics import Tally
from tudor_dynamics.identification.streamed.task import Place
from tudor_dynamics.models.estimation.products import Products
from tudor_dynamics.models.storage.files import dump_npz, load_npz
from tudor_dynamics.typing import FloatArray

LARGEST = 200_000_000
"""Bytes of what one bag came to."""
NAME = re.compile(r'[0-9a-f]{24}-[0-9a-f]{16}\.(npz|json)')
"""Of a file: checksum of the bag, digest of settings and sources."""
Part = list[list[Products]]
"""Products of each group and channel."""


@dataclass(frozen=True, eq=False)
class KeptBag:
    """What a bag came to."""

    facts: BagFacts  # what is known of it
    # Filters and output to products, as Gram matrices with triangular factors.
    parts: Mapping[Place, Part]


@dataclass(frozen=True, eq=False)
class Judged:
    """How models did on a bag."""

    facts: BagFacts  # what is known of it
    # Filters and output to the sums of a model that has not seen the bag, and of that of all.
    unseen: Mapping[Place, Tally]
    seen: Mapping[Place, Tally]


def write_bag(path: Path, bag: KeptBag) -> None:
    """Write what a bag came to, whole or not at all."""
    arrays: dict[str, Any] = {'facts': np.frombuffer(json.dumps(
        asdict(bag.facts)).encode(), np.uint8)}
    for (number, output), part in bag.parts.items():
        for i, group in enumerate(part):
            arrays[f'{number} {output} {i}'] = np.array([_matrices(item) for item in group])
            arrays[f'{number} {output} {i} n'] = np.array([item.n for item in group])
    write_whole(path, dump_npz(arrays))


def read_bag(path: Path) -> KeptBag | None:
    """Read what a bag came to."""
    try:
        arrays = load_npz(read_bounded(path, LARGEST), path)
        facts = _facts(json.loads(arrays.pop('facts').astype(np.uint8).tobytes()))
        parts: dict[Place, Part] = {}
        for name, values in arrays.items():
            number, output, _, *rest = name.split()
            if rest:
                continue
            if not np.all(np.isfinite(values)):
                return None
            counts = arrays[f'{name} n'].tolist()
            parts.setdefault((int(number), output), []).append(
                [Products(gram, int(n), factor) for (gram, factor), n in
                 zip(values, counts, strict=True)])
    except (TudorError, OSError, ValueError, KeyError, TypeError):
        return None
    return KeptBag(facts, parts)


def write_judged(path: Path, judged: Judged) -> None:
    """Write how models did on a bag, whole or not at all."""
    write_whole(path, json.dumps({'facts': asdict(judged.facts)} | {
        name: [[*place, _plain(tally)] for place, tally in getattr(judged, name).items()]
        for name in ('unseen', 'seen')}).encode())


def read_judged(path: Path) -> Judged | None:
    """
    Read how models did on a bag.

    path: None is given for one that is not there, as by `read_bag`.
    """
    try:
        content = json.loads(read_bounded(path, LARGEST))
        unseen, seen = ({(int(number), str(output)): _tally(values)
                         for number, output, values in content[name]}
                        for name in ('unseen', 'seen'))
        return Judged(_facts(content['facts']), unseen, seen)
    except (OSError, ValueError, KeyError, TypeError):
        return None


def forget(folder: Path, used: Collection[Path]) -> None:
    """Remove what bags came to under settings or sources of before."""
    for file in folder.iterdir():
        if file not in used and NAME.fullmatch(file.name):
            file.unlink(missing_ok=True)


def _facts(content: dict[str, Any]) -> BagFacts:
    return BagFacts(**{**content, 'warnings': tuple(content['warnings'])})


def _plain(tally: Tally) -> list[Any]:
    values = (getattr(tally, item.name) for item in fields(Tally))
    return [value.tolist() if isinstance(value, np.ndarray) else value for value in values]


def _tally(values: Sequence[Any]) -> Tally:
    given = zip(fields(Tally), values, strict=True)
    content: dict[str, Any] = {item.name: np.array(value) if isinstance(value, list) else value
                               for item, value in given}
    return Tally(**content)


def _matrices(product: Products) -> FloatArray:
    factor = np.zeros_like(product.gram)
    assert product.triangle is not None
    factor[:len(product.triangle)] = product.triangle
    return np.array([product.gram, factor])
