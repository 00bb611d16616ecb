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

"""The model bundle: models of one arm by kind, all that is known of them, and their files."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
import hashlib
import io
from pathlib import Path
from typing import Any, Literal
import zipfile
import zlib

import numpy as np
from tudor_dynamics import files
from tudor_dynamics._version import __version__
from tudor_dynamics.arm.description import Arm, arm_from_dict
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.errors import ArmError, check_type, ModelError, TudorError
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.base import AGAIN, BundlePart, Model, read, SAME
from tudor_dynamics.models.elastic.model import ElasticModel
from tudor_dynamics.models.elm import ExtremeLearningMachine
from tudor_dynamics.models.estimation import Products
from tudor_dynamics.models.flexible_tool import FlexibleTool
from tudor_dynamics.typing import FloatArray, Shown
import yaml


@dataclass(frozen=True)
class Kind:
    """A kind of model."""

    label: str  # what tables and legends call it
    model: type[Model]  # its class
    compared: bool = False  # whether verdicts go by the others, where there are others


KINDS: dict[str, Kind] = {
    'analytical': Kind('analytical', AnalyticalModel),
    'elm': Kind('ELM', ExtremeLearningMachine, compared=True),
    'elastic': Kind('elastic', ElasticModel)}
"""Kinds by the names that commands, parameters and bundles use."""


@dataclass(frozen=True, eq=False)
class CausalModels:
    """Models fitted with causal filters, as they run beside the robot."""

    preprocessing: PreprocessingSpec  # filters and rate
    models: dict[str, dict[str, Model]]  # as those of `ModelBundle`


@dataclass(eq=False)
class ModelBundle(Shown):
    """
    Models of one arm, with the preprocessing that they were fitted to.

    Attributes
    ----------
    arm : Arm
        Arm that the models belong to.
    preprocessing : PreprocessingSpec
        Filters and rate.
    models : dict of str to dict of str to model
        Output (``effort``, ``strain``) to kind, see `KINDS`, to model.
    facts : dict
        What else is known: training bags with checksums, validation figures, verdicts,
        thresholds. Plain values only.
    causal : CausalModels or None
        The models for the robot, where ``models`` were fitted with filters that look ahead.
    digest : str
        Checksum of the file that they were read from; empty for others.
    tool : FlexibleTool or None
        What rings at the flange, where that was fitted.

    """

    arm: Arm
    preprocessing: PreprocessingSpec
    models: dict[str, dict[str, Model]]
    facts: dict[str, Any] = field(default_factory=dict)
    causal: CausalModels | None = None
    digest: str = ''
    tool: FlexibleTool | None = None

    def __post_init__(self) -> None:
        """Let the strain model correct the effort model that was fitted with it."""
        effort, strain = elastic_of(self, 'effort'), elastic_of(self, 'strain')
        if effort and strain:
            effort.strain_model = strain

    def __repr__(self) -> str:
        """Write the models with their verdict and their fit on unseen bags, one line each."""
        found = self.facts.get('validation')
        judged = found if isinstance(found, dict) else {}
        lines = [f'ModelBundle of {self.arm.name}']
        if self.payload_range is not None:
            lines[0] += ', loads from {:g} to {:g} kg'.format(*self.payload_range)
        for output, kinds in self.models.items():
            for kind, model in kinds.items():
                line = f'  {output} {kind}: {", ".join(model.channels)}'
                with suppress(KeyError, TypeError, ValueError):  # made by hand: nothing is known
                    facts = judged[output][kind]
                    line += (f'; fit {facts["validation"]["fit"]:.1f} % ({facts["method"]}): '
                             f'{facts["verdict"]}')
                lines.append(line)
        lines += [] if self.tool is None else [f'  tool: {self.tool}']
        return '\n'.join(lines)

    def beside_robot(self) -> ModelBundle:
        """Give the bundle as it predicts beside the robot: with its causal models, if any."""
        if self.causal is None:
            return self
        return replace(self, preprocessing=self.causal.preprocessing, models=self.causal.models,
                       causal=None)

    @property
    def payload_range(self) -> tuple[float, float] | None:
        """Give the loads that the models were fitted to [kg]; None where they know of none."""
        ranges = (model.payload_range for kinds in self.models.values()
                  for model in kinds.values())
        return next((found for found in ranges if found is not None), None)

    @property
    def payload(self) -> float | None:
        """Load of all training bags [kg]; None if unknown, different, or if models take any."""
        bags = self.facts.get('training')
        if self.payload_range is not None or not isinstance(bags, list) or not bags:
            return None
        found = [bag.get('payload') if isinstance(bag, dict) else None for bag in bags]
        masses = [float(mass) for mass in found if isinstance(mass, (int, float))]
        if len(masses) < len(found) or not max(masses) - min(masses) < SAME:
            return None
        return masses[0]

    def at(self, payload: float) -> ModelBundle:
        """
        Give models of the motion alone for a mass [kg] at the tip.

        This bundle itself where its models are of one load and that, or none (0), is asked for; a
        ModelError if another one is.
        """
        if self.payload_range is None:
            known = self.payload
            if payload == 0.0 or (known is not None and abs(payload - known) < SAME):
                return self
            what = ('one load of unknown mass; give none' if known is None else
                    f'one load of {known:g} kg; give that one')
            raise ModelError(f'the model cannot predict for a load of {payload:g} kg, as it '
                             f'was fitted to {what}, or fit a model to bags with several loads '
                             '(tudor fit BAGS --payload-of BAG=KG ...)')
        causal = self.causal
        if causal is not None:
            causal = replace(causal, models=_at(causal.models, payload))
        return replace(self, models=_at(self.models, payload), causal=causal)

    def mass_at(self, payload: float) -> float:
        """Give the mass at the tip that the models assume there: that asked for, or their own."""
        return payload if self.payload_range is not None else self.payload or 0.0


def _at(models: dict[str, dict[str, Model]], payload: float) -> dict[str, dict[str, Model]]:
    return {output: {kind: model if model.payload_range is None else model.at(payload)
                     for kind, model in kinds.items()}
            for output, kinds in models.items()}


def elastic_of(bundle: ModelBundle, output: str) -> ElasticModel | None:
    """Find the elastic model of an output; None where there is no such model in the bundle."""
    model = bundle.models.get(output, {}).get('elastic')
    return model if isinstance(model, ElasticModel) else None


def tool_of(bundle: ModelBundle) -> FlexibleTool:
    """Give the flexible tool of a bundle, or say how to learn it."""
    if bundle.tool is None:
        raise ModelError('the model has no tool that vibrates', remedy='record motions that '
                         'end with 3 s of rest, and run tudor fit --models analytical vibration')
    return bundle.tool


# -- Files of a model bundle: bytes in, checked values out, and back.
#
# ``model.yaml`` can be read and compared by a person; ``arm.yaml`` (and ``arm.urdf``) is the arm;
# ``elm.npz`` holds the ELM's arrays, ``data.npz`` what training bags come to. Bundles are
# untrusted: sizes are bounded, nothing is unpickled, every byte is covered by a checksum. A bundle
# is written under a temporary name and renamed, so that a reader never sees half of one.

MAX_BYTES = {'model.yaml': 20_000_000, 'arm.yaml': 2_000_000, 'arm.urdf': 20_000_000,
             'elm.npz': 200_000_000, 'data.npz': 200_000_000}
FORMAT = 'tudor_dynamics/model'
VERSION = 1
GIVE_FOLDER = 'give the folder that tudor fit wrote'
MARK = 'checksum: '  # begins the last line of ``model.yaml``, a checksum over all before it


class _Dumper(getattr(yaml, 'CSafeDumper', yaml.SafeDumper)):  # type: ignore[misc]
    """The fast safe dumper, without references between equal lists."""

    def ignore_aliases(self, data: object) -> bool:
        return True


def dump_yaml(content: Any) -> str:
    """Write plain values as YAML, without references."""
    text: str = yaml.dump(content, Dumper=_Dumper, sort_keys=False, width=99,
                          allow_unicode=True, default_flow_style=None)
    return text


def load_yaml(text: str | bytes, file: Path) -> Any:
    """Read the YAML of a bundle; the file is for messages."""
    try:
        return files.load_yaml(text)
    except ValueError as err:
        raise ModelError(str(err), place=file, remedy=AGAIN) from None


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def load_npz(data: bytes, file: Path) -> dict[str, FloatArray]:
    """Read arrays from an npz archive of numbers that unpacks to no more than it may."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            size = sum(item.file_size for item in archive.infolist())
        if size > MAX_BYTES['elm.npz']:
            raise ModelError(f'its arrays have {size / 1e6:.0f} MB, more than the limit of '
                             f'{MAX_BYTES["elm.npz"] / 1e6:g} MB', place=file, remedy=AGAIN)
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except ModelError:
        raise
    except (zipfile.BadZipFile, zlib.error, OSError, EOFError, MemoryError, RuntimeError,
            TypeError, ValueError) as err:
        raise ModelError(f'not a valid NumPy archive ({err})', place=file, remedy=AGAIN) from None
    for name, array in arrays.items():
        if not isinstance(array, np.ndarray) or array.dtype.kind not in 'fiu':
            raise ModelError(f'the array {name[:100]!r} is not made of numbers', place=file,
                             remedy=AGAIN)
    return {name: array.astype(float) for name, array in arrays.items()}


def _read_file(path: Path, name: str) -> bytes:
    """Read one file of a bundle, of `MAX_BYTES`."""
    try:
        return files.read_bounded(path / name, MAX_BYTES[name])
    except OSError as err:
        msg = ('no such folder' if isinstance(err, FileNotFoundError) and not path.is_dir() else
               f'{name} cannot be read ({err.strerror})')
        raise ModelError(msg, place=path, remedy=GIVE_FOLDER) from None


class ModelsPart(BundlePart):
    """Models, with the preprocessing that they were fitted to."""

    preprocessing: PreprocessingSpec  # filters and rate
    # Of each output, the models by their kind.
    outputs: dict[Literal['effort', 'strain'], dict[str, dict[str, Any]]]


class ArmPart(BundlePart):
    """What the arm was when the models were fitted."""

    digest: str  # of what a model depends on in its description


class HeadPart(ModelsPart):
    """The head itself; `facts` are read by those who know of them."""

    arm: ArmPart  # name and digest of the arm
    digest: str  # of the text itself, and so of all files
    files: dict[str, str]  # the other files, with their SHA-256
    causal: ModelsPart | None = None  # models for the running robot, where `outputs` are not
    data: dict[str, tuple[str, ...]] = {}  # models with arrays in `data.npz`, and which
    facts: dict[str, Any] = {}  # training, validation, verdicts, thresholds, versions
    tool: FlexibleTool | None = None  # what rings at the flange


def _read_head(path: Path) -> HeadPart:
    """Read ``model.yaml``: whole, unaltered, of this version."""
    file = path / 'model.yaml'
    try:
        text = _read_file(path, 'model.yaml').decode()
    except UnicodeDecodeError:
        raise ModelError('the file is not UTF-8 text', place=file, remedy=GIVE_FOLDER) from None
    body, mark, checksum = text.rpartition(MARK)
    if not mark or checksum != f'{_sha256(body.encode())}\n':
        raise ModelError('this file of a model was edited or is incomplete (wrong checksum)',
                         place=file, remedy=f'restore it, or {AGAIN}')
    head = load_yaml(body, file)
    if not isinstance(head, dict) or head.get('format') != FORMAT:
        raise ModelError(f'the file is no model, as its format is not {FORMAT!r}', place=file,
                         remedy=GIVE_FOLDER)
    if head.get('version') != VERSION:
        raise ModelError(f'format version {head.get("version")!r}, but this program reads version '
                         f'{VERSION}; update tudor_dynamics, or fit the model again', place=file)
    try:
        return read(HeadPart, {**head, 'digest': checksum.strip()})
    except ModelError as err:
        raise err.at(file) from None


def read_facts(path: str | Path) -> dict[str, Any]:
    """Read the facts of a bundle alone, as `save_bundle` wrote them."""
    return _read_head(Path(path)).facts


# -- What training bags come to: products, in a file that no prediction reads.
#
# With them full parameters are found that the data themselves prefer.

FILE = 'data.npz'
SUM = 'sum'  # what is kept


def pack(models: Mapping[str, AnalyticalModel]) -> dict[str, FloatArray]:
    """Collect the data of models, by the beginning of their arrays' names."""
    arrays: dict[str, FloatArray] = {}
    for name, model in models.items():
        for number, group in enumerate(model.data_):
            arrays[f'{name}_{number}'] = np.array([[_matrix(p) for p in group]])
            arrays[f'{name}_{number}_n'] = np.array([[p.n for p in group]])
        arrays[f'{name}_triangular'] = np.array([float(any(
            p.triangle is not None for group in model.data_ for p in group))])
    return arrays


def unpack(models: Mapping[str, AnalyticalModel], content: bytes, file: Path) -> None:
    """Give models their data back."""
    arrays = load_npz(content, file)
    try:
        for name, model in models.items():
            factors, data = bool(arrays[f'{name}_triangular'][0]), []
            for number, group in enumerate(model.groups_):
                size = len(group.base.kept) + 1
                key, shape = f'{name}_{number}', (1, len(group.base.channels), size, size)
                values, counts = arrays[key], arrays[f'{key}_n']
                if (values.shape, counts.shape) != (shape, shape[:2]):
                    raise ValueError(f'{key} and {key}_n have the shapes {values.shape} and '
                                     f'{counts.shape}; expected {shape} and {shape[:2]}')
                if not (np.all(np.isfinite(values)) and np.all((counts >= 0.0) & (counts < 1e15))):
                    raise ValueError(f'{key} has NaN or infinite values, or {key}_n no counts')
                data.append([Products(matrix.T @ matrix, int(k), matrix) if factors else
                             Products(matrix, int(k))
                             for matrix, k in zip(values[0], counts[0], strict=True)])
            model.data_ = data
    except (KeyError, TypeError, ValueError, IndexError) as err:
        raise ModelError(f'the file does not go with the models ({err})', place=file,
                         remedy=AGAIN) from None


def _matrix(product: Products) -> FloatArray:
    if product.triangle is None:
        return product.gram
    return np.pad(product.triangle, ((0, len(product.gram) - len(product.triangle)), (0, 0)))


# -- Writing and reading model bundles

CAUSAL = 'causal_'  # begin of the names of arrays of the models for the robot


def save_bundle(
    bundle: ModelBundle, path: str | Path, *, overwrite: bool = False,
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
    check_bundle_target(path, overwrite=overwrite, name='path')
    described = bundle.arm.spec.model_dump(mode='json', exclude_defaults=True)
    urdf = {} if bundle.arm.urdf is None else {'arm.urdf': bundle.arm.urdf.encode()}
    if urdf:
        described['kinematics'] = {'urdf': 'arm.urdf'}
    content = {'arm.yaml': dump_yaml(described).encode(), **urdf}
    arrays: dict[str, FloatArray] = {}
    parts = {'outputs': _contents(bundle.models, bundle.arm, arrays, '')}
    if bundle.causal is not None:
        parts['causal'] = {
            'preprocessing': bundle.causal.preprocessing.model_dump(mode='json'),
            'outputs': _contents(bundle.causal.models, bundle.arm, arrays, CAUSAL)}
    if bundle.tool is not None:
        parts['tool'] = bundle.tool.model_dump()
    if arrays:
        content['elm.npz'] = files.dump_npz(arrays)
    kept = {name: model for name, model in _analytical(bundle).items() if model.data_}
    if kept:
        content[FILE] = files.dump_npz(pack(kept))
        parts['data'] = {name: [SUM] for name in kept}
    body = dump_yaml({
        'format': FORMAT, 'version': VERSION, 'written_by': f'tudor_dynamics {__version__}',
        'arm': {'name': bundle.arm.name, 'digest': bundle.arm.digest},
        'files': {name: _sha256(data) for name, data in content.items()},
        'preprocessing': bundle.preprocessing.model_dump(mode='json'),
        **parts, 'facts': bundle.facts})
    content['model.yaml'] = f'{body}{MARK}{_sha256(body.encode())}\n'.encode()
    try:
        files.write_directory(path, {**(extra or {}), **content})
    except OSError as err:
        msg = f'cannot be written ({err.strerror or err}); choose another directory'
        raise ModelError(msg, place=path) from None


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


def check_bundle_target(path: Path, *, overwrite: bool, name: str = 'out') -> None:
    """Refuse to write over what is there, before hours of work and not after."""
    files.check_target(path, overwrite=overwrite, name=name, mark='model.yaml', kind=ModelError)


def _analytical(bundle: ModelBundle) -> dict[str, AnalyticalModel]:
    """Give the models that may keep data, by the beginning of their arrays' names."""
    sets = {'': bundle.models, CAUSAL: {} if bundle.causal is None else bundle.causal.models}
    return {f'{prefix}{output}_{kind}': model for prefix, models in sets.items()
            for output, kinds in models.items() for kind, model in kinds.items()
            if isinstance(model, AnalyticalModel)}


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

    Raises
    ------
    ModelError
        If the bundle is not there, damaged, altered, of a newer version, or of another arm.

    """
    check_type(path, (str, Path), 'path', 'the directory of a bundle')
    path = Path(path)
    head = _read_head(path)
    content = {name: _read_file(path, name) for name in head.files if name in MAX_BYTES}
    for name, checksum in head.files.items():
        if name not in content:
            raise ModelError(f'model.yaml lists an unknown file {name!r}; {AGAIN}', place=path)
        if _sha256(content[name]) != checksum:
            raise ModelError('this file of a model was edited or is incomplete (wrong checksum)',
                             place=path / name, remedy=f'restore it, or {AGAIN}')
    try:
        own = _arm(load_yaml(content['arm.yaml'], path / 'arm.yaml'), content, path)
    except (KeyError, ArmError) as err:
        raise ModelError(f'its arm.yaml cannot be used ({err}); {AGAIN}', place=path) from None
    if own.digest != head.arm.digest:
        msg = 'its arm.yaml does not match the model, or another version fitted the model'
        raise ModelError(msg, place=path, remedy=f'{AGAIN} with this version')
    # but for the friction of its joints, which a fit may choose
    if arm is not None and arm.with_friction_of(own).digest != own.digest:
        raise ModelError(
            f'this model was fitted with another description (arm {own.name!r}) than '
            f'{arm.source} (arm {arm.name!r})', place=path,
            remedy=f'set arm= to that description, or fit a model with {arm.source}')
    try:
        arrays = load_npz(content['elm.npz'], path / 'elm.npz') if 'elm.npz' in content else {}
        models = _models(own, head, arrays, '')
        causal = None if head.causal is None else CausalModels(
            head.causal.preprocessing, _models(own, head.causal, arrays, CAUSAL))
    except TudorError as err:
        raise ModelError(err.cause, place=err.place or path, remedy=err.remedy) from None
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as err:
        msg = f'not a valid model ({type(err).__name__}: {err})'
        raise ModelError(msg, place=path / 'model.yaml', remedy=AGAIN) from None
    bundle = ModelBundle(own, head.preprocessing, models, head.facts, causal, head.digest,
                         head.tool)
    if with_data and FILE in content:
        unpack({name: model for name, model in _analytical(bundle).items() if name in head.data},
               content[FILE], path / FILE)
    return bundle


def _models(
    arm: Arm, part: ModelsPart, arrays: dict[str, FloatArray], prefix: str,
) -> dict[str, dict[str, Model]]:
    found: dict[str, dict[str, Model]] = {}
    for output, kinds in part.outputs.items():
        found[output] = {}
        for kind, content in kinds.items():
            if kind not in KINDS:
                raise ModelError(f'the model has a part of the unknown kind {kind!r}; this '
                                 f'version reads {", ".join(KINDS)}, so update tudor_dynamics')
            begin = f'{prefix}{output}_{kind}_'
            own = {name.removeprefix(begin): array for name, array in arrays.items()
                   if name.startswith(begin)}
            found[output][kind] = KINDS[kind].model.from_dict({**content, **own}, arm, output)
    return found


def _arm(content: Any, known: dict[str, bytes], path: Path) -> Arm:
    kinematics = content.get('kinematics') if isinstance(content, dict) else None
    urdf = kinematics.get('urdf') if isinstance(kinematics, dict) else None
    if urdf is not None and (urdf != 'arm.urdf' or urdf not in known):
        raise ModelError(f'{path}: arm.yaml of the model names the URDF {urdf!r}, not arm.urdf; '
                         'fit the model again')
    return arm_from_dict(content, base=path, source=str(path / 'arm.yaml'))
