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

"""Fits bag by bag: the figures of any other fit, whatever is broken, killed or doubled."""

from __future__ import annotations

from collections.abc import Sequence
import json
from pathlib import Path
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from typing import Any
import warnings

import numpy as np
from patience import PATIENCE
import pytest

from tudor_dynamics import fit, load_arm
from tudor_dynamics.arm.description import Arm
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.bags.writer import recording_series, write_bag
from tudor_dynamics.cli.main import main
from tudor_dynamics.errors import FitError, TudorWarning, UsageError
from tudor_dynamics.identification.dataset import BagChoice, cut
from tudor_dynamics.identification.fit import FitSettings
from tudor_dynamics.identification.many_bags import FROM, Streaming, streams
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import ModelBundle

PARTS = ('@0-50%', '@50-100%')


@pytest.fixture(scope='module')
def parts(root: Path) -> list[str]:
    """Give four parts of the sample bags."""
    return [f'{root}/bags/two_blade_train_{number}{part}' for number in (1, 2) for part in PARTS]


def settled(root: Path) -> Arm:
    """Describe the arm with nothing left open, which a fit would spend its time on."""
    arm = load_arm(root / 'config/two_blade_arm.yaml')
    return arm.with_joints({joint.name: {'friction': ('viscous', 'coulomb')}
                            for joint in arm.spec.joints})


def quickly(
    parts: Sequence[str | Path], root: Path, folder: Path | None, **more: Any,
) -> ModelBundle:
    """Fit bag by bag, or all at once, with causal filters and given friction."""
    arm = settled(root)
    spec = arm.spec.preprocessing.model_copy(update={'filter': 'causal'})
    return fit(list(parts), arm, preprocessing=spec, settings=FitSettings(estimator='wls'),
               streaming=None if folder is None else Streaming(folder), **more)


@pytest.fixture(scope='module')
def usual(
    parts: list[str], root: Path, tmp_path_factory: pytest.TempPathFactory,
) -> tuple[ModelBundle, Path]:
    """Fit bag by bag once, and keep the sums."""
    sums = tmp_path_factory.mktemp('usual') / 'sums'
    return quickly(parts, root, sums), sums


def fitted(parts: Sequence[str], root: Path, folder: Path | None, **more: object) -> ModelBundle:
    """Fit bag by bag, or all at once."""
    streaming = None if folder is None else Streaming(
        folder, **more)  # type: ignore[arg-type]
    return fit(list(parts), load_arm(root / 'config/two_blade_arm.yaml'), streaming=streaming)


def assert_same(one: ModelBundle, other: ModelBundle) -> None:
    """Compare coefficients, figures and thresholds of two bundles."""
    assert (one.causal is None) == (other.causal is None)
    for first, second in ((one, other), (one.causal, other.causal)):
        if first is None or second is None:
            continue
        for output in ('effort', 'strain'):
            a, b = (item.models[output]['analytical'] for item in (first, second))
            assert isinstance(a, AnalyticalModel) and isinstance(b, AnalyticalModel)
            np.testing.assert_allclose(a.coefficients(), b.coefficients(), rtol=1e-10, atol=1e-12)
    for name in ('validation', 'causal_validation', 'thresholds', 'training', 'choices',
                 'ringing'):
        a, b = (json.dumps(item.facts.get(name), sort_keys=True) for item in (one, other))
        assert a == b, name


def test_one_by_one_is_as_all_at_once(parts: list[str], root: Path, tmp_path: Path) -> None:
    """Coefficients, validation, thresholds and choices are those of the ordinary fit."""
    three = parts[:3]
    assert_same(fitted(three, root, tmp_path / 'sums', jobs=2), fitted(three, root, None))


def test_without_a_folder_nothing_stays(
    parts: list[str], usual: tuple[ModelBundle, Path], root: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The models are the same, and what bags came to is removed."""
    arm = settled(root)
    spec = arm.spec.preprocessing.model_copy(update={'filter': 'causal'})
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path))
    assert_same(fit(parts, arm, preprocessing=spec, settings=FitSettings(estimator='wls'),
                    streaming=Streaming()), usual[0])
    assert not list(tmp_path.glob('tudor_*'))


def test_test_bags_judge(root: Path, tmp_path: Path) -> None:
    """With bags to judge by, figures are theirs in both ways."""
    bags = [f'{root}/bags/two_blade_train_{number}' for number in (1, 2)]
    ways = [quickly(bags, root, folder, test=root / 'bags/two_blade_test')
            for folder in (tmp_path / 'sums', None)]
    one, other = (bundle.facts for bundle in ways)
    assert one['validation'] == other['validation'] and one['test'] == other['test']
    assert one['validation']['strain']['analytical']['validation']['fit'] > 91.0


def test_groups_are_left_out_together(root: Path, tmp_path: Path) -> None:
    """More bags than groups: each is judged by a model that has not seen its neighbours."""
    bag = f'{root}/bags/two_blade_train_1'
    parts = [f'{bag}@{first}-{first + 8}%' for first in range(0, 96, 8)]
    facts = quickly(parts, root, tmp_path / 'sums', out=tmp_path / 'model').facts
    found = facts['validation']['strain']['analytical']
    assert found['method'] == 'leave one of 10 groups of bags out, 12 bags'
    assert found['validation']['fit'] > 80.0
    assert [item['bag'] for item in facts['training']] == parts
    assert 'figures those of 8' in ' '.join((tmp_path / 'model/report.html').read_text().split())


def shaken(root: Path, folder: Path, count: int) -> None:
    """Write bags that differ by noise."""
    arm = load_arm(root / 'config/two_blade_arm.yaml')
    source = read_recording(root / 'bags/two_blade_train_1', arm)
    for number in range(count):
        part = cut(source, BagChoice('', number / count, (number + 1) / count))
        write_bag(folder / f'bag_{number}', recording_series(part, arm))


def test_broken_bags_and_copies_are_left_out(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """Each is named; --strict refuses, and nothing is written."""
    folder = tmp_path / 'bags'
    shaken(root, folder / 'monday', 4)
    shutil.copytree(folder / 'monday/bag_2', folder / 'tuesday/copy')
    damaged = folder / 'monday/bag_1/bag_1.mcap'
    damaged.write_bytes(damaged.read_bytes()[:5000])
    (folder / 'monday/bag_0/bag_0.mcap').write_bytes(b'')
    words = ['fit', str(folder), '--stream', '--arm', str(root / 'config/two_blade_arm.yaml'),
             '--jobs', '1', '--exit-zero', '--json', '--out']
    assert main([*words, str(tmp_path / 'strict'), '--strict']) == 2
    told = capsys.readouterr().err
    assert 'bag_0' in told and '3 bags cannot be used, but --strict needs all; the first: ' in told
    assert not (tmp_path / 'strict').exists()
    assert main([*words, str(tmp_path / 'model')]) == 0
    said = capsys.readouterr()
    unused = {Path(item['bag']).name: item['why'] for item in json.loads(said.out)['unused']}
    assert set(unused) == {'bag_0', 'bag_1', 'copy'} and 'the same samples' in unused['copy']
    assert said.err.count('the fit leaves this bag out') == 3 and 'Traceback' not in said.err
    page = (tmp_path / 'model/report.html').read_text()
    assert 'Left out' in page and 'tuesday/copy' in page


def test_a_killed_fit_goes_on(
    parts: list[str], usual: tuple[ModelBundle, Path], root: Path, tmp_path: Path,
) -> None:
    """What was kept before `kill -9` is used, and the model is that of an uninterrupted fit."""
    out, sums = tmp_path / 'model', tmp_path / 'model.sums'
    process = subprocess.Popen(
        [sys.executable, '-m', 'tudor_dynamics', 'fit', *parts, '--stream', '--jobs', '1', '--arm',
         'config/two_blade_arm.yaml', '--exit-zero', '--filter', 'causal', '--friction', 'viscous',
         'coulomb', '--estimator', 'wls', '--out', str(out)], cwd=root,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + PATIENCE
    while len(list(sums.glob('*.npz'))) < 2:
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.002)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL and not out.exists()
    kept = {file: file.stat().st_mtime_ns for file in sums.glob('*.npz')}
    resumed = quickly(parts, root, sums)
    assert {file: file.stat().st_mtime_ns for file in kept} == kept
    assert len(list(sums.glob('*.npz'))) == len(parts)
    assert_same(resumed, usual[0])


def test_what_was_kept_is_checked(
    parts: list[str], usual: tuple[ModelBundle, Path], root: Path, tmp_path: Path,
) -> None:
    """A damaged file is made again, one of other settings is removed, all else stays."""
    first, sums = usual[0], shutil.copytree(usual[1], tmp_path / 'sums')
    files = sorted(sums.iterdir())
    for file in files:
        file.write_bytes(file.read_bytes()[:200])
    (sums / 'notes.txt').write_text('mine')
    stale = sums / f'{"0" * 24}-{"1" * 16}.npz'
    stale.write_bytes(b'')
    assert_same(quickly(parts, root, sums), first)
    assert not stale.exists() and (sums / 'notes.txt').exists()
    assert sorted(sums.iterdir()) == sorted([*files, sums / 'notes.txt'])


def test_payloads(root: Path, tmp_path: Path) -> None:
    """Bags of several payloads become one model of all of them, as in the ordinary fit."""
    arm = settled(root)
    source = read_recording(root / 'bags/two_blade_train_1', arm)
    for number in range(4):
        part = cut(source, BagChoice('', number / 4, (number + 1) / 4))
        write_bag(tmp_path / f'bag_{number}', recording_series(part, arm),
                  custom={'payload': f'{0.1 * (number % 2):g}'})
    bags = [tmp_path / f'bag_{number}' for number in range(4)]
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', TudorWarning)
        ways = [quickly(bags, root, folder) for folder in (tmp_path / 'sums', None)]
    assert_same(*ways)
    assert ways[0].models['strain']['analytical'].payload_range == (0.0, 0.1)


def test_when_a_fit_goes_bag_by_bag() -> None:
    """Many bags do, by default; what cannot be added up is refused with a remedy."""
    assert not streams(FROM - 1, FitSettings()) and streams(FROM, FitSettings())
    assert streams(2, FitSettings(), asked=True)
    for bags, settings, word in ((FROM, FitSettings(kinds=('analytical', 'elm')), 'elm'),
                                 (5, FitSettings(kinds=('analytical', 'elm')),
                                  'elm models need all at once; leave elm out of '
                                  'models=, or leave out stream='),
                                 (FROM, FitSettings(estimator='huber'), 'Huber'),
                                 (1, FitSettings(), 'two bags or more')):
        with pytest.raises(UsageError, match=word):
            streams(bags, settings, asked=bags < FROM)


def test_load_friction_is_refused(parts: list[str], root: Path, tmp_path: Path) -> None:
    """Its rows depend on the parameters of all bags."""
    arm = load_arm(root / 'config/two_blade_arm.yaml').with_joints(
        {name: {'friction': ('viscous', 'load'), 'asymmetric': False}
         for name in ('joint2', 'joint3')})
    with pytest.raises(UsageError, match='remove it from joints.*friction or from the fit'):
        fit(parts, arm, streaming=Streaming(tmp_path / 'sums'))


def test_a_copy_is_no_test(root: Path, tmp_path: Path) -> None:
    """A test bag with the bytes of a training bag is refused, as in the ordinary fit."""
    bags = [root / f'bags/two_blade_train_{number}' for number in (1, 2)]
    shutil.copytree(bags[0], tmp_path / 'copy')
    with pytest.raises(FitError, match='does not test the model'):
        fit(bags, load_arm(root / 'config/two_blade_arm.yaml'), test=tmp_path / 'copy',
            streaming=Streaming(tmp_path / 'sums'))
