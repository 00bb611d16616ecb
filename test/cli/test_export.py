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

"""The command that exports."""

from __future__ import annotations

from elastic_making import blade_arm, identified
import pinocchio as pin
from printed import unwrapped
import pytest
from robot_making import described_arm, fitted
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.cli.main import main
from tudor_dynamics.models.bundle import ModelBundle, save_bundle


@pytest.fixture(scope='module')
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp('export')
    arm = described_arm(path)
    save_bundle(ModelBundle(arm, PreprocessingSpec(), {'effort': {'analytical': fitted(
        arm, seconds=40.0)}}), path / 'model')
    return path / 'model'


@pytest.mark.parametrize('target', ['urdf', 'mjcf', 'yaml', 'csv'])
def test_each_format_is_written(model, tmp_path, capsys, target):
    out = tmp_path / f'arm.{target}'
    assert main(['export', str(model), '--to', target, '--out', str(out)]) == 0
    told = unwrapped(capsys.readouterr().out)
    assert f'{target}: {out}' in told
    assert 'column' not in told and 'turn' in told
    assert ('no place for: rotor inertias' in told) == (target == 'urdf')
    if target == 'urdf':
        assert pin.buildModelFromXML(out.read_text()).nv == 4


def test_a_file_that_is_there_stays(model, tmp_path, capsys):
    out = tmp_path / 'arm.csv'
    out.write_text('mine')
    assert main(['export', str(model), '--to', 'csv', '--out', str(out)]) == 2
    assert 'exists already' in capsys.readouterr().err
    assert out.read_text() == 'mine'
    assert main(['export', str(model), '--to', 'csv', '--out', str(out), '--overwrite']) == 0
    assert out.read_text() != 'mine'


def test_a_place_that_cannot_be_written_is_named(model, tmp_path, capsys):
    (tmp_path / 'file').write_text('')
    out = tmp_path / 'file' / 'arm.csv'
    assert main(['export', str(model), '--to', 'csv', '--out', str(out)]) == 2
    assert 'cannot be written' in capsys.readouterr().err


def test_a_model_without_data_says_what_to_do(model, tmp_path, capsys):
    assert main(['export', str(tmp_path / 'none'), '--to', 'csv', '--out', 'x.csv']) == 2
    assert 'none: no such folder; give the folder that' in capsys.readouterr().err


@pytest.fixture(scope='module')
def elastic(tmp_path_factory):
    path = tmp_path_factory.mktemp('elastic') / 'model'
    save_bundle(identified(blade_arm(), {'gear(j1)': 190.0, 'lag': 0.01}), path)
    return path


def test_an_elastic_model_becomes_a_description_that_is_simulated(elastic, tmp_path, capsys):
    out = tmp_path / 'arm.yaml'
    assert main(['export', str(elastic), '--to', 'arm', '--out', str(out)]) == 0
    assert 'arm has no place for: lag of the gauges' in unwrapped(capsys.readouterr().out)
    assert load_arm(out).spec.motors[0].stiffness == 190.0
    assert not out.with_suffix('.urdf').exists()


def test_an_elastic_model_becomes_mjcf_with_springs(elastic, tmp_path, capsys):
    out = tmp_path / 'arm.xml'
    assert main(['export', str(elastic), '--to', 'mjcf', '--out', str(out)]) == 0
    assert 'mjcf has no place for: backlash of the gear of j1' in unwrapped(
        capsys.readouterr().out)
    assert 'name="j1_gear"' in out.read_text()
    assert main(['export', str(elastic), '--to', 'mjcf', '--rigid', '--out', str(out),
                 '--overwrite']) == 2
    assert 'analytical model of efforts for one load' in capsys.readouterr().err


def test_the_urdf_of_a_description_stands_beside_it(root, tmp_path, capsys):
    """The reference arm has one; a name that would be the URDF's own is refused."""
    arm = load_arm(root / 'config' / 'tudor.yaml')
    save_bundle(identified(arm.with_gauges(['link2_hub', 'link3_hub']), {'beta': 4e-4}),
                tmp_path / 'model')
    command = ['export', str(tmp_path / 'model'), '--to', 'arm', '--out']
    assert main([*command, str(tmp_path / 'new.urdf')]) == 2
    assert 'ends in .yaml' in capsys.readouterr().err
    assert main([*command, str(tmp_path / 'new.yaml')]) == 0
    written = load_arm(tmp_path / 'new.yaml')
    assert written.urdf == arm.urdf
    assert written.spec.simulation.rayleigh.beta == 4e-4
    assert main([*command, str(tmp_path / 'new.yaml')]) == 2, 'nothing is replaced unasked'


def test_a_rigid_model_is_no_description(model, tmp_path, capsys):
    out = tmp_path / 'arm.yaml'
    assert main(['export', str(model), '--to', 'arm', '--out', str(out)]) == 2
    assert '--models analytical elastic' in capsys.readouterr().err
    assert not out.exists()
