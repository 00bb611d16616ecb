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

"""``tudor simulate`` as a user calls it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from printed import unwrapped
import pytest
from rosbags.highlevel import AnyReader
from tudor_dynamics import files
from tudor_dynamics.cli.main import main
import yaml


@pytest.fixture
def description(root):
    """Content of the L-shaped mechanism."""
    return yaml.safe_load((root / 'config' / 'l_shape.yaml').read_text())


def test_frequencies_are_listed(root, capsys):
    """``--modes`` gives the table, or JSON."""
    arm = str(root / 'config' / 'l_shape.yaml')
    assert main(['simulate', arm, '--modes', '8']) == 0
    assert '23.892' in capsys.readouterr().out
    assert main(['simulate', arm, '--modes', '2', '--free', 'motor', '--json']) == 0
    assert json.loads(capsys.readouterr().out)['frequency_hz'][1] == pytest.approx(8.772, abs=2e-3)


def test_a_run_leaves_arrays_bag_figures_and_animation(root, tmp_path, capsys):
    """All files of a short run of an arm with gauges."""
    out = tmp_path / 'out'
    code = main(['simulate', str(root / 'config' / 'single_flexible_link.yaml'), '--torque',
                 '1+0.5*sin(20*t)', '--seconds', '0.3', '--rate', '100', '--out', str(out),
                 '--pictures', '--signals', 'strain:hub', 'acceleration:tip', '--picture',
                 str(tmp_path / 'a.gif')])
    assert code == 0
    with np.load(out / 'run.npz', allow_pickle=False) as file:
        assert file['t'].shape == (31,)
        strain = file['strain']
        assert file['joints'].tolist() == ['column', 'motor']
    with AnyReader([out / 'bag']) as reader:
        topics = {c.topic: c for c in reader.connections}
        assert set(topics) == {'/joint_states', '/link_strains', '/imu/tip'}
        messages = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages(
            [topics['/link_strains']])]
    assert [m.position[0] for m in messages] == pytest.approx(strain[:, 0].tolist())
    assert messages[0].name == ['hub']
    for name in ('initial.png', 'strain_hub.png', 'acceleration_tip.png'):
        assert (out / name).stat().st_size > 10_000
    assert (tmp_path / 'a.gif').stat().st_size > 10_000
    # A second run does not overwrite the bag.
    assert main(['simulate', str(root / 'config' / 'single_flexible_link.yaml'), '--torque', '0',
                 '--out', str(out)]) == 2
    assert 'exists already' in capsys.readouterr().err


def test_motion_of_a_table(root, tmp_path, capsys):
    """A joint follows a table, and the figures say where it ends."""
    t = np.linspace(0.0, 0.5, 51)
    table = tmp_path / 'motion.csv'
    np.savetxt(table, np.column_stack([t, 0.1 * t**2]), delimiter=',', header='t,motor')
    assert main(['simulate', str(root / 'config' / 'single_flexible_link.yaml'), '--motion',
                 str(table), '--seconds', '0.4', '--json']) == 0
    assert json.loads(capsys.readouterr().out)['q_end']['motor'] == pytest.approx(0.016, abs=1e-6)


def test_the_reference_arm_has_its_drives(root, tmp_path, capsys):
    """3.05 Hz stretched out as in the recordings, with the gears' twist; the rest is named."""
    content = yaml.safe_load((root / 'config' / 'tudor.yaml').read_text())
    content['kinematics']['urdf'] = str(root / 'config' / 'tudor.urdf')
    content['simulation']['initial'] = {'joint2': 0.0}
    arm = tmp_path / 'arm.yaml'
    arm.write_text(yaml.safe_dump(content))
    assert main(['simulate', str(arm), '--modes', '1', '--json']) == 0
    said = capsys.readouterr()
    assert json.loads(said.out)['frequency_hz'][0] == pytest.approx(3.05, abs=0.005)
    assert said.err.strip() == (
        "arm 'tudor': left out of the motors of joint1, joint2, joint3: Coulomb friction, "
        'backlash, current limit; tudor record has them')
    # 4 N m more than the weight turn the rotor (0.58 kg m^2) before the arm's own inertia follows
    assert main(['simulate', str(arm), '--torque', 'joint2=5.22+4', '--seconds', '0.02', '--hold',
                 'joint3', '--json']) == 0
    turned = json.loads(capsys.readouterr().out)['q_end']['joint2']
    assert turned == pytest.approx(0.5 * 4.0 / 0.582 * 0.02**2, rel=0.15)


def test_force_at_the_tip(root, tmp_path, capsys):
    """1 N at 0.25 m from the middle of link 2 is 167 um/m / 4; accelerations are in the bag."""
    out, table = tmp_path / 'out', tmp_path / 'force.csv'
    arm = str(root / 'config' / 'l_shape.yaml')
    t = np.linspace(0.0, 0.1, 11)
    np.savetxt(table, np.column_stack([t, np.full(11, 0.02)]), delimiter=',', header='t,z')
    assert main(['simulate', arm, '--hold', 'motor', '--force', 'y=1', str(table), '--seconds',
                 '0.1', '--rate', '100', '--out', str(out)]) == 0
    with np.load(out / 'run.npz', allow_pickle=False) as file:
        strain = dict(zip(file['gauges'].tolist(), file['strain'].T, strict=True))
        assert file['sensors'].tolist() == ['motor', 'tip']
        felt = file['sensor_acceleration']
    # y/EI = 4 mm / 23.89 N m^2; both beams carry it at rest, as it has acted from before
    np.testing.assert_allclose(strain['link2_mid'], 1e6 * 0.25 * 0.004 / 23.89, rtol=2e-2)
    np.testing.assert_allclose(np.abs(felt), 0.0, atol=1e-6)
    with AnyReader([out / 'bag']) as reader:
        topics = {c.topic: c for c in reader.connections}
        assert set(topics) == {'/joint_states', '/link_strains', '/imu/motor', '/imu/tip'}
        _, _, raw = next(reader.messages([topics['/imu/tip']]))
        message = reader.deserialize(raw, topics['/imu/tip'].msgtype)
    assert message.header.frame_id == 'tip_imu'
    assert message.linear_acceleration.x == pytest.approx(felt[0, 1, 0])
    capsys.readouterr()
    assert main(['simulate', arm, '--force', 'z=step(t-0.01)', '--seconds', '0.05', '--json']) == 0
    assert json.loads(capsys.readouterr().out)['largest_rotation'] > 0.0


def test_large_bending_is_told(root, tmp_path, capsys):
    """The largest elastic rotation stands with the figures; above the limit there is a warning."""
    arm = str(root / 'config' / 'single_flexible_link.yaml')
    words = ['--seconds', '0.05', '--rate', '100', '--json']
    assert main(['simulate', arm, '--torque', '1', *words]) == 0
    said = capsys.readouterr()
    assert 0.0 < json.loads(said.out)['largest_rotation'] < 0.3 and 'beams bend' not in said.err
    content = yaml.safe_load((root / 'config' / 'single_flexible_link.yaml').read_text())
    content['payload'] = {'mass': 15.0}
    soft = tmp_path / 'soft.yaml'
    soft.write_text(yaml.safe_dump(content))
    assert main(['simulate', str(soft), '--torque', '1', *words]) == 0
    said = capsys.readouterr()
    largest = json.loads(said.out)['largest_rotation']
    assert largest > 0.3
    assert f'beams bend by up to {largest:.2f} rad' in said.err and said.err.count('\n') == 1
    assert main(['simulate', str(soft), '--torque', '1', *words[:-1], '--out',
                 str(tmp_path / 'o')]) == 0
    assert f'largest elastic rotation {largest:.3g} rad' in unwrapped(capsys.readouterr().out)
    assert main(['simulate', str(soft), '--modes', '2']) == 0
    assert 'beams bend' in capsys.readouterr().err


def change(content, path, value):
    """Set a value deep inside a description; None removes the key."""
    for key in path[:-1]:
        content = content[key]
    if value is None:
        del content[path[-1]]
    else:
        content[path[-1]] = value


BEAM = ('links', 0, 'flexible')


@pytest.mark.parametrize(('path', 'value', 'words'), [
    ((*BEAM, 'length'), -0.5, 'length'),
    ((*BEAM, 'section'), None, 'section'),
    ((*BEAM, 'section', 'height'), None, 'height'),
    ((*BEAM, 'section', 'width'), -1, 'width'),
    ((*BEAM, 'material', 'E'), 0, 'links[0].flexible.material.E'),
    ((*BEAM, 'material', 'nu'), None, 'Poisson'),
    ((*BEAM, 'elements'), 0, 'elements'),
    ((*BEAM, 'colour'), 'blue', 'unknown key'),
    ((*BEAM, 'height_axis'), 'x', 'height_axis'),
    ((*BEAM, 'lumped'), [{'node': 7, 'mass': 1}], 'node 7'),
    (('links', 1), None, "the key 'links' has no entry for the link after 'corner'"),
    (('links',), [], "the key 'links' is missing"),
    (('links', 1, 'joint'), 'knee', 'knee'),
    (('links', 1, 'rigid'), {'mass': 1}, 'rigid and flexible'),
    (('kinematics', 'dh'), [[0.5, 0, 0, 0]] * 3, '3 D-H rows for 2 joints'),
    (('kinematics', 'dh'), [[0.0, 0, 0, 0]] * 2, 'starts and ends at'),
    (('payload',), {'mass': 1, 'inertia': [1, 1, 9, 0, 0, 0]}, 'inertia'),
    (('simulation', 'initial'), {'elbow': 1}, 'elbow'),
])
def test_bad_mechanisms_get_one_line(description, tmp_path, capsys, path, value, words):
    """Exit code 2 and one line that names the file and the matter."""
    change(description, path, value)
    arm = tmp_path / 'arm.yaml'
    arm.write_text(yaml.safe_dump(description))
    assert main(['simulate', str(arm), '--modes', '2']) == 2
    message = capsys.readouterr().err.strip()
    assert '\n' not in message
    assert words in message
    assert 'arm.yaml' in message


def test_a_mechanism_that_moves_nothing_is_refused(description, tmp_path, capsys):
    """A free joint without mass after it has no acceleration."""
    description['links'] = [{'joint': 'motor', 'rigid': {'mass': 0}},
                            {'joint': 'corner', 'rigid': {'mass': 0}}]
    arm = tmp_path / 'arm.yaml'
    arm.write_text(yaml.safe_dump(description))
    assert main(['simulate', str(arm), '--torque', '1', '--out', str(tmp_path / 'o')]) == 2
    assert 'or a beam, moves no mass' in capsys.readouterr().err


@pytest.mark.parametrize(('options', 'words'), [
    (['--torque', 'sin(x)'], "'x'"), (['--torque', '1/t'], 'not finite at t = 0'),
    (['--torque', '1', '--dt', '0.05'], 'too large'),
    (['--torque', '1', '--dt', '0'], '--dt 0.0: give a number above 0'),
    (['--torque', '1', '--hold', 'knee'], 'knee'), (['--modes', '0'], '--modes'),
    (['--torque', '1', '--picture', 'x.avi'], 'file that ends in .gif or .mp4'),
    (['--torque', '1', '--pictures', '--signals', 'q:knee'], '--signals: there is no q:knee'),
    (['--torque', 'missing.csv'], 'missing.csv'), (['--force', '2*t'], 'x=EXPRESSION'),
    (['--force', 'w=2'], 'x=EXPRESSION'), (['--force', 'x=1/t'], 'not finite at t = 0')])
def test_bad_options_get_one_line(root, tmp_path, capsys, options, words):
    """Exit code 2 and one line."""
    arm = str(root / 'config' / 'l_shape.yaml')
    assert main(['simulate', arm, '--out', str(tmp_path / 'o'), *options]) == 2
    message = capsys.readouterr().err.strip().splitlines()[-1]
    assert words in message


@pytest.mark.parametrize(('seconds', 'fails', 'left'), [
    ('0.4', 'bag: cannot be written (No space left on device)', ['run.npz']),
    ('2', 'run.npz: No space left on device', [])])
def test_full_disk(root, small_disk, capsys, seconds, fails, left):
    """A disk that is full is one line that names the file, and leaves nothing half written."""
    out = small_disk / 'out'
    code = main(['simulate', str(root / 'config' / 'single_flexible_link.yaml'), '--torque', '1',
                 '--seconds', seconds, '--out', str(out)])
    err = capsys.readouterr().err
    assert code == 2 and err.startswith(f'tudor simulate: {out}/{fails}') and err.count('\n') == 1
    assert [item.name for item in out.iterdir()] == left


@pytest.mark.parametrize('name', ['run.npz', 'initial.png', 'a.gif'])
def test_files_that_cannot_be_written(root, tmp_path, capsys, monkeypatch, name):
    """The same for arrays, figures and animation, each when its turn comes."""
    real = files.os.replace

    def fail(source, target):
        if Path(target).name == name:
            raise OSError(28, 'No space left on device', str(target))
        return real(source, target)
    monkeypatch.setattr(files.os, 'replace', fail)
    out = tmp_path / 'out'
    code = main(['simulate', str(root / 'config' / 'single_flexible_link.yaml'), '--torque', '1',
                 '--seconds', '0.1', '--rate', '100', '--pictures', '--signals', 'energy', '--out',
                 str(out), '--picture', str(out / 'a.gif')])
    err = capsys.readouterr().err
    assert code == 2
    assert err.endswith(f'{name}: No space left on device; free some space\n')
    assert not [item for item in out.iterdir() if item.name.startswith('.') or item.name == name]
