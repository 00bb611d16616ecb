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
Writing and reading model bundles.

``model.yaml`` can be read and compared by a person; ``arm.yaml`` (and ``arm.urdf``) is the arm;
``elm.npz`` holds the ELM's arrays. Bundles are untrusted: sizes are bounded, nothing is unpickled,
every byte is covered by a checksum. A bundle is written under a temporary name and renamed, so
that a reader never sees half of one.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tudor_dynamics._version import __version__
from tudor_dynamics.arm import Arm, arm_from_dict
from tudor_dynamics.arm.schema import FRICTION_KEYS
from tudor_dynamics.errors import ArmError, check_type, ModelError, TudorError
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.bundle import CausalModels, ModelBundle
from tudor_dynamics.models.kinds import KINDS
from tudor_dynamics.models.storage import products as stored
from tudor_dynamics.models.storage.files import (
    dump_npz, dump_yaml, load_npz, load_yaml, MAX_BYTES, read_file, read_head, sealed, sha256,
    write_directory)
from tudor_dynamics.models.storage.parts import ModelsPart
from tudor_dynamics.typing import FloatArray

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
    names, products = stored.pack(_sets(bundle))
    if names:
        files[stored.FILE] = dump_npz(products)
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
    if with_data and stored.FILE in files:
        stored.unpack(_sets(bundle), head.data, files[stored.FILE], path / stored.FILE)
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
