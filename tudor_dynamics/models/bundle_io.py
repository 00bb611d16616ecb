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

"""Model bundles on disk: files, products of training bags, reading and writing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import hashlib
import io
from pathlib import Path
from typing import Any
import zipfile
import zlib

import numpy as np

from tudor_dynamics import files
from tudor_dynamics._version import __version__
from tudor_dynamics.arm.description import Arm, arm_from_dict
from tudor_dynamics.arm.schema import FRICTION_KEYS
from tudor_dynamics.errors import ArmError, check_type, ModelError, TudorError
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.bundle import CausalModels, ModelBundle
from tudor_dynamics.models.bundle_parts import HeadPart, ModelsPart, read
from tudor_dynamics.models.estimation import Products, summed, triangular
from tudor_dynamics.models.kinds import KINDS
from tudor_dynamics.typing import FloatArray
import yaml


# -- Files of a model bundle: bytes in, checked values out, and back.
#
# Bundles are untrusted: reads are bounded and of regular files only, nothing is unpickled.

MAX_BYTES = {'model.yaml': 20_000_000, 'arm.yaml': 2_000_000, 'arm.urdf': 20_000_000,
             'elm.npz': 200_000_000, 'data.npz': 200_000_000}
FORMAT = 'tudor_dynamics/model'
VERSION = 1
MARK = 'checksum: '
"""Begins the last line of ``model.yaml``, a checksum over all before it."""


class _Dumper(getattr(yaml, 'CSafeDumper', yaml.SafeDumper)):  # type: ignore[misc]
    """The fast safe dumper, without references between equal lists."""

    def ignore_aliases(self, data: object) -> bool:
        return True


def dump_yaml(content: Any) -> str:
    """
    Write plain values as YAML, without references.

    Parameters
    ----------
    content : dict
        Mapping of plain values.

    Returns
    -------
    str
        Text.

    """
    text: str = yaml.dump(content, Dumper=_Dumper, sort_keys=False, width=99,
                          allow_unicode=True, default_flow_style=None)
    return text


def load_yaml(text: str | bytes, file: Path) -> Any:
    """
    Read the YAML of a bundle.

    Parameters
    ----------
    text : str or bytes
        Text of the file.
    file : Path
        Where it came from, for messages.

    Returns
    -------
    object
        Plain values.

    Raises
    ------
    ModelError
        If it is no YAML, or stands for more than it may.

    """
    try:
        return files.load_yaml(text)
    except ValueError as err:
        raise ModelError(str(err), place=file, remedy='fit the model again') from None


def sha256(data: bytes) -> str:
    """
    Give the SHA-256 of bytes in hexadecimal digits.

    Parameters
    ----------
    data : bytes
        Content of a file.

    """
    return hashlib.sha256(data).hexdigest()


def dump_npz(arrays: dict[str, FloatArray]) -> bytes:
    """Write arrays as an npz archive."""
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def load_npz(data: bytes, file: Path) -> dict[str, FloatArray]:
    """
    Read arrays from an npz archive.

    Parameters
    ----------
    data : bytes
        Bytes of the archive.
    file : Path
        Where it came from, for messages.

    Returns
    -------
    dict of str to ndarray
        Arrays.

    Raises
    ------
    ModelError
        If it is no archive, unpacks to too much, or holds anything but numbers.

    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if sum(item.file_size for item in archive.infolist()) > MAX_BYTES['elm.npz']:
                msg = 'unpacks to more than a model can have'
                raise ModelError(msg, place=file)
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except ModelError:
        raise
    except (zipfile.BadZipFile, zlib.error, OSError, EOFError, MemoryError, RuntimeError,
            TypeError, ValueError) as err:
        msg = f'no archive of numbers ({err}); fit the model again'
        raise ModelError(msg, place=file) from None
    for name, array in arrays.items():
        if not isinstance(array, np.ndarray) or array.dtype.kind not in 'fiu':
            msg = (f'no archive of numbers ({name[:100]!r} holds others); fit the model '
                   'again')
            raise ModelError(msg, place=file)
    return {name: array.astype(float) for name, array in arrays.items()}


def read_file(path: Path, name: str) -> bytes:
    """
    Read one file of a bundle.

    Parameters
    ----------
    path : Path
        Directory of the bundle.
    name : str
        File in it, of `MAX_BYTES`.

    Returns
    -------
    bytes
        Content.

    Raises
    ------
    ModelError
        If it cannot be read, is larger than it may be, or is no file.

    """
    file = path / name
    try:
        return files.read_bounded(file, MAX_BYTES[name])
    except OSError as err:
        msg = f'cannot be read ({err.strerror}); expected a model bundle of tudor fit'
        raise ModelError(msg, place=file) from None


def write_directory(content: dict[str, bytes], path: Path) -> None:
    """
    Write a directory of files, whole or not at all, in place of one that may stand there.

    Parameters
    ----------
    content : dict of str to bytes
        Names and contents of the files.
    path : Path
        Directory to be made.

    Raises
    ------
    ModelError
        If it cannot be written; what stood there still stands then.

    """
    try:
        files.write_directory(path, content)
    except OSError as err:
        msg = f'cannot be written ({err.strerror or err}); choose another place'
        raise ModelError(msg, place=path) from None


def sealed(content: dict[str, Any]) -> bytes:
    """Give a head as a file: format and version before the content, its checksum behind."""
    body = dump_yaml({'format': FORMAT, 'version': VERSION, **content})
    return f'{body}{MARK}{sha256(body.encode())}\n'.encode()


def read_head(path: Path) -> HeadPart:
    """
    Read the head of a bundle.

    Parameters
    ----------
    path : Path
        Directory of the bundle.

    Returns
    -------
    HeadPart
        Arm, files, preprocessing, outputs and facts.

    Raises
    ------
    ModelError
        If it is not there, damaged, altered, or of another version.

    """
    file = path / 'model.yaml'
    try:
        text = read_file(path, 'model.yaml').decode()
    except UnicodeDecodeError:
        msg = f'{file}: no text; expected a model bundle of tudor fit'
        raise ModelError(msg) from None
    body, mark, checksum = text.rpartition(MARK)
    if not mark or checksum != f'{sha256(body.encode())}\n':
        msg = (f'{file}: altered or cut short (checksum differs); fit the model again instead of '
               'editing it')
        raise ModelError(msg)
    head = load_yaml(body, file)
    if not isinstance(head, dict) or head.get('format') != FORMAT:
        msg = f'{file}: not in the format {FORMAT!r}'
        raise ModelError(msg)
    if head.get('version') != VERSION:
        msg = (f'{file}: bundle version {head.get("version")!r}; this program reads version '
               f'{VERSION}: update tudor_dynamics, or fit the model again')
        raise ModelError(msg)
    try:
        return read(HeadPart, head)
    except ModelError as err:
        raise err.at(file) from None


# -- What training bags come to, beside the models: products, in a file that no prediction reads.
#
# With them a bag is added to a model or taken from it within a second, and full parameters are
# found that the data themselves prefer.

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


# -- Writing and reading model bundles.
#
# ``model.yaml`` can be read and compared by a person; ``arm.yaml`` (and ``arm.urdf``) is the arm;
# ``elm.npz`` holds the ELM's arrays. Bundles are untrusted: sizes are bounded, nothing is
# unpickled, every byte is covered by a checksum. A bundle is written under a temporary name and
# renamed, so that a reader never sees half of one.

CAUSAL = 'causal_'
"""Begin of the names of arrays of the models for the robot."""


def save_bundle(
    bundle: ModelBundle,
    path: str | Path,
    *,
    overwrite: bool = False,
    extra: dict[str, bytes] | None = None,
) -> None:
    """
    Write a bundle, whole or not at all.

    Parameters
    ----------
    bundle : ModelBundle
        Models to be saved.
    path : str or Path
        Directory to be made.
    overwrite : bool, default=False
        Replace a bundle that stands there. Anything else is never replaced.
    extra : dict of str to bytes, optional
        Files for people, such as a report, that no program reads back.

    Raises
    ------
    ModelError
        If something stands there already, or nothing can be written there.
    NotFittedError
        If a model has learned nothing yet.

    """
    check_type(bundle, ModelBundle, 'bundle', 'the result of fit or load_bundle')
    check_type(path, (str, Path), 'path', 'a directory to be made')
    path = Path(path)
    check_target(path, overwrite=overwrite)
    files = _arm_files(bundle.arm)
    arrays: dict[str, FloatArray] = {}
    parts = {'outputs': _contents(bundle.models, bundle.arm, arrays, '')}
    if bundle.causal is not None:
        parts['causal'] = {
            'preprocessing': bundle.causal.preprocessing.model_dump(mode='json'),
            'outputs': _contents(bundle.causal.models, bundle.arm, arrays, CAUSAL)}
    if arrays:
        files['elm.npz'] = dump_npz(arrays)
    names, products = pack(_sets(bundle))
    if names:
        files[FILE] = dump_npz(products)
        parts['data'] = names
    files['model.yaml'] = sealed({
        'written_by': f'tudor_dynamics {__version__}',
        'arm': {'name': bundle.arm.name, 'digest': bundle.arm.digest},
        'files': {name: sha256(data) for name, data in files.items()},
        'preprocessing': bundle.preprocessing.model_dump(mode='json'),
        **parts, 'facts': bundle.facts})
    write_directory({**(extra or {}), **files}, path)


def _contents(
    models: dict[str, dict[str, Model]], arm: Arm, arrays: dict[str, FloatArray], prefix: str,
) -> dict[str, Any]:
    """Give the plain values of models; their arrays are put with the others."""
    outputs: dict[str, Any] = {}
    for output, kinds in models.items():
        outputs[output] = {}
        for kind, model in kinds.items():
            content = model.to_dict(arm, output)
            own = [name for name, value in content.items() if isinstance(value, np.ndarray)]
            arrays.update({f'{prefix}{output}_{kind}_{name}': content.pop(name) for name in own})
            outputs[output][kind] = content
    return outputs


def check_target(path: Path, *, overwrite: bool) -> None:
    """
    Refuse to write over what is there, before hours of work and not after.

    Parameters
    ----------
    path : Path
        Directory to be made.
    overwrite : bool
        Whether a bundle may be replaced.

    Raises
    ------
    ModelError
        If something stands there that may not be replaced.

    """
    if not path.exists() and not path.is_symlink():
        return
    if not overwrite:
        msg = f'{path} exists already; choose another --out, or add --overwrite'
        raise ModelError(msg)
    if not (path / 'model.yaml').is_file():
        msg = f'{path} is no model bundle and is not overwritten; choose another --out'
        raise ModelError(msg)


def _arm_files(arm: Arm) -> dict[str, bytes]:
    content = arm.spec.model_dump(mode='json', exclude_defaults=True)
    files = {}
    if arm.urdf is not None:
        content['kinematics'] = {'urdf': 'arm.urdf'}
        files['arm.urdf'] = arm.urdf.encode()
    return {'arm.yaml': dump_yaml(content).encode(), **files}


def _sets(bundle: ModelBundle) -> dict[str, dict[str, dict[str, Model]]]:
    """Give the models, and those for the robot, by the beginning of their arrays' names."""
    return {'': bundle.models, **(
        {} if bundle.causal is None else {CAUSAL: bundle.causal.models})}


def load_bundle(
    path: str | Path, *, arm: Arm | None = None, with_data: bool = False,
) -> ModelBundle:
    """
    Read a bundle.

    Parameters
    ----------
    path : str or Path
        Directory of the bundle.
    arm : Arm, optional
        The arm that the bundle must belong to.
    with_data : bool, default=False
        Read what the training bags came to as well, where the bundle has kept it.

    Returns
    -------
    ModelBundle
        Models that can predict.

    Raises
    ------
    ModelError
        If the bundle is not there, damaged, altered, of a newer version, or of another arm.

    """
    check_type(path, (str, Path), 'path', 'the directory of a bundle')
    path = Path(path)
    head = read_head(path)
    files = {name: read_file(path, name) for name in head.files if name in MAX_BYTES}
    for name, checksum in head.files.items():
        if name not in files:
            msg = f'{path}: names a file {name!r} that no bundle has'
            raise ModelError(msg)
        if sha256(files[name]) != checksum:
            msg = f'{path / name}: altered or cut short (checksum differs); fit the model again'
            raise ModelError(msg)
    try:
        own = _arm(load_yaml(files['arm.yaml'], path / 'arm.yaml'), files, path)
    except (KeyError, ArmError) as err:
        msg = f'{path}: its arm description cannot be used ({err})'
        raise ModelError(msg) from None
    if own.digest != head.arm.digest:
        msg = (f'{path}: the arm description inside gives another digest than when the model was '
               'fitted; fit the model again with this version')
        raise ModelError(msg)
    if arm is not None and not _same_arm(arm, own):
        msg = (f'{path}: fitted for the arm {own.name!r} as it was described then, not for '
               f'{arm.name!r} of {arm.source}; fit it again, or give the arm it was fitted for')
        raise ModelError(msg)
    try:
        arrays = load_npz(files['elm.npz'], path / 'elm.npz') if 'elm.npz' in files else {}
        models = _models(own, head, arrays, '')
        causal = None if head.causal is None else CausalModels(
            head.causal.preprocessing, _models(own, head.causal, arrays, CAUSAL))
    except ModelError as err:
        raise err.at(path) from None
    except TudorError as err:
        raise ModelError(err.advice, place=err.place or path) from None
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as err:
        msg = f'{path / "model.yaml"}: {" ".join(str(err).split())}; fit the model again'
        raise ModelError(msg) from None
    bundle = ModelBundle(own, head.preprocessing, models, head.facts, causal)
    if with_data and FILE in files:
        unpack(_sets(bundle), head.data, files[FILE], path / FILE)
    return bundle


def _same_arm(arm: Arm, own: Arm) -> bool:
    """Compare two arms, but for the friction of their joints, which a fit may choose."""
    friction = {joint.name: {key: getattr(joint, key) for key in FRICTION_KEYS}
                for joint in own.spec.joints}
    return arm.with_joints(friction).digest == own.digest


def _models(
    arm: Arm, part: ModelsPart, arrays: dict[str, FloatArray], prefix: str,
) -> dict[str, dict[str, Model]]:
    own = {name.removeprefix(prefix): array for name, array in arrays.items()
           if name.startswith(prefix)}
    return {output: {kind: _model(arm, output, kind, content, own)
                     for kind, content in kinds.items()}
            for output, kinds in part.outputs.items()}


def _arm(content: Any, files: dict[str, bytes], path: Path) -> Arm:
    kinematics = content.get('kinematics') if isinstance(content, dict) else None
    urdf = kinematics.get('urdf') if isinstance(kinematics, dict) else None
    if urdf is not None and (urdf != 'arm.urdf' or urdf not in files):
        msg = f'{path}: its arm has the URDF {urdf!r}; expected arm.urdf, with a checksum'
        raise ModelError(msg)
    return arm_from_dict(content, base=path, source=str(path / 'arm.yaml'))


def _model(
    arm: Arm, output: str, kind: str, content: dict[str, Any], arrays: dict[str, FloatArray],
) -> Model:
    if kind not in KINDS:
        msg = f'model kind {kind!r}; this version knows {", ".join(KINDS)}: update tudor_dynamics'
        raise ModelError(msg)
    prefix = f'{output}_{kind}_'
    own = {name.removeprefix(prefix): array for name, array in arrays.items()
           if name.startswith(prefix)}
    return KINDS[kind].from_content(content).from_dict({**content, **own}, arm, output)
