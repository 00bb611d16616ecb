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
What training bags come to, beside the models: products, in a file that no prediction reads.

With them a bag is added to a model or taken from it within a second, and full parameters are found
that the data themselves prefer.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from tudor_dynamics.errors import ModelError
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.estimation.products import Products, summed, triangular
from tudor_dynamics.models.storage.files import load_npz
from tudor_dynamics.typing import FloatArray

FILE = 'data.npz'
LARGEST = 100_000_000
"""Bytes of products above which the parts are kept as their sum alone."""

Models = Mapping[str, Mapping[str, Model]]


def pack(sets: Mapping[str, Models]) -> tuple[dict[str, list[str]], dict[str, FloatArray]]:
    """Collect the data of all models that keep some."""
    kept = list(_kept(sets))
    size = sum(product.gram.nbytes for _, model in kept for part in model.data_.values()
               for group in part for product in group)
    names: dict[str, list[str]] = {}
    arrays: dict[str, FloatArray] = {}
    for name, model in kept:
        data = model.data_
        if size > LARGEST:
            data = {f'{len(data)} bags': summed(data.values())}
        names[name] = list(data)
        for number in range(len(model.groups_)):
            groups = [part[number] for part in data.values()]
            arrays[f'{name}_{number}'] = np.array([[_matrix(p) for p in g] for g in groups])
            arrays[f'{name}_{number}_n'] = np.array([[p.n for p in g] for g in groups])
        arrays[f'{name}_triangular'] = np.array([float(triangular(data.values()))])
    return names, arrays


def unpack(
    sets: Mapping[str, Models], names: Mapping[str, Sequence[str]], content: bytes, file: Path,
) -> None:
    """Give models their data back."""
    arrays = load_npz(content, file)
    try:
        for name, model in _kept(sets, empty=True):
            if name not in names:
                continue
            factors = bool(arrays[f'{name}_triangular'][0])
            parts: dict[str, list[list[Products]]] = {str(part): [] for part in names[name]}
            for number, group in enumerate(model.groups_):
                size = len(group.base.kept) + 1
                values = arrays[f'{name}_{number}']
                counts = arrays[f'{name}_{number}_n']
                shape = (len(parts), len(group.base.channels), size, size)
                if values.shape != shape or counts.shape != shape[:2] or not (
                        np.all(np.isfinite(values)) and np.all(counts >= 0.0)):
                    msg = f'{name}: {values.shape} where finite numbers {shape} were expected'
                    raise ValueError(msg)
                for part, matrices, n in zip(parts.values(), values, counts, strict=True):
                    part.append([_product(matrix, int(k), factors)
                                 for matrix, k in zip(matrices, n, strict=True)])
            model.data_ = parts
    except (KeyError, TypeError, ValueError, IndexError) as err:
        raise ModelError(f'the data do not belong to the models ({err})', place=file,
                         remedy='fit the model again') from None


def _kept(
    sets: Mapping[str, Models], *, empty: bool = False,
) -> Iterator[tuple[str, AnalyticalModel]]:
    for prefix, models in sets.items():
        for output, kinds in models.items():
            for kind, model in kinds.items():
                if isinstance(model, AnalyticalModel) and (empty or model.data_):
                    yield f'{prefix}{output}_{kind}', model


def _matrix(product: Products) -> FloatArray:
    if product.triangle is None:
        return product.gram
    full = np.zeros_like(product.gram)
    full[:len(product.triangle)] = product.triangle
    return full


def _product(matrix: FloatArray, n: int, factors: bool) -> Products:
    return Products(matrix.T @ matrix, n, matrix) if factors else Products(matrix, n)
