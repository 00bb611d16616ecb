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

"""``python -m papers import-merit`` on synthetic files of the same shape."""

from pathlib import Path
import sqlite3

import numpy as np
from papers.__main__ import main
from papers.merit import COLUMNS
import pytest

from tudor_dynamics.arm.description import arm_from_dict
from tudor_dynamics.bags.reader import read_recording

GAUGES = ('link2_hub', 'link2_mid', 'link3_hub', 'link3_mid')


def table():
    """Make 300 rows: t, three joints, currents, strains, accelerations."""
    t = np.arange(300) * 0.01
    waves = [np.sin((1 + 0.1 * i) * t) for i in range(16)]
    rows = np.column_stack([t, *waves])
    for joint in range(3):
        rows[:, 4 + joint] = (1 + 0.1 * joint) * np.cos((1 + 0.1 * joint) * t)
    return rows


def write(path, rows, **options):
    """Write rows as CSV."""
    np.savetxt(path, rows, delimiter=',', fmt='%.17g', **options)
    return str(path)


@pytest.mark.parametrize('header', ['', ','.join(COLUMNS)])
@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_columns_arrive_on_their_topics(tmp_path, capsys, header, storage):
    """Positions, velocities, currents and strains are those of the file."""
    rows = table()
    file = write(tmp_path / 'exp.csv', rows, header=header, comments='')
    out = tmp_path / 'bag'
    assert main(['import-merit', file, '--out', str(out), '--storage', storage]) == 0
    assert '300 samples' in capsys.readouterr().out
    arm = arm_from_dict({
        'name': 'tudor', 'kinematics': {'dh': [[0.4, 0.0, 0.0, 0.0]] * 3},
        'joints': [{'name': f'joint{i}', 'effort': {'topic': 'motor_currents', 'unit': 'A'}}
                   for i in (1, 2, 3)],
        'gauges': [{'name': name, 'joint': f'joint{name[4]}', 'distance': 0.1}
                   for name in GAUGES]}, base=Path(), source='test')
    found = read_recording(out, arm)
    np.testing.assert_allclose(found.t, rows[:, 0], atol=1e-9)
    for values, columns in ((found.q, slice(1, 4)), (found.dq, slice(4, 7)),
                            (found.effort, slice(7, 10)), (found.strain, slice(10, 14))):
        np.testing.assert_array_equal(values, rows[:, columns])


def changed(row, column, value):
    """Give the table with one value replaced."""
    rows = table()
    rows[row, column] = value
    return rows


@pytest.mark.parametrize(('rows', 'match'), [
    (table()[:, :16], 'found 300 rows of 16 columns; expected'),
    (changed(7, 5, np.nan), 'a value is not finite in data row 8'),
    (changed(20, 0, 0.05), 'time does not increase in data row 21'),
    (table() * 57.3, 'looks like degrees'),
    (table()[:1], 'found 1 rows of 17 columns; expected two'),
])
def test_wrong_tables_are_refused(tmp_path, capsys, rows, match):
    """Exit code 2, one line with the place, and no bag."""
    file = write(tmp_path / 'exp.csv', rows)
    assert main(['import-merit', file, '--out', str(tmp_path / 'bag')]) == 2
    err = capsys.readouterr().err
    assert match in err and file in err and len(err.splitlines()) == 1
    assert not (tmp_path / 'bag').exists()


@pytest.mark.parametrize(('content', 'match'), [
    (b'', 'found 0 rows'),
    (b'\xff\xfe\x00', 'utf'),
    (b'1,' * 16 + b'1\n' + b'x,' * 16 + b'1\n', "could not convert string 'x'"),
    (b'1;2;3\n', 'could not convert string'),
])
def test_other_files_are_refused(tmp_path, capsys, content, match):
    """Empty, binary, words, semicolons."""
    file = tmp_path / 'exp.csv'
    file.write_bytes(content)
    assert main(['import-merit', str(file), '--out', str(tmp_path / 'bag')]) == 2
    assert match in capsys.readouterr().err


def test_missing_file_and_existing_bag_are_refused(tmp_path, capsys):
    """Nothing is overwritten."""
    assert main(['import-merit', str(tmp_path / 'no.csv'), '--out', str(tmp_path / 'b')]) == 2
    (tmp_path / 'b').mkdir()
    file = write(tmp_path / 'exp.csv', table())
    assert main(['import-merit', file, '--out', str(tmp_path / 'b')]) == 2
    assert 'exists already' in capsys.readouterr().err


def test_full_disk(small_disk, tmp_path, capsys):
    """A disk that is full is one line and exit code 2, in both storages, and nothing is left."""
    file = write(tmp_path / 'exp.csv', np.repeat(table(), 9, axis=0) + np.outer(
        np.arange(2700), np.r_[0.01, np.zeros(16)]))
    for storage in ('sqlite3', 'mcap'):
        assert main(['import-merit', file, '--out', str(small_disk / 'bag'), '--storage',
                     storage]) == 2
        err = capsys.readouterr().err
        assert err.count('\n') == 1 and 'cannot be written (' in err and 'disk' in err
        assert list(small_disk.iterdir()) == []


def test_full_disk_as_sqlite_tells_it(tmp_path, capsys, monkeypatch):
    """Full disks are an error of SQLite's own, no OSError."""
    def fail(*_):
        raise sqlite3.OperationalError('database or disk is full')
    monkeypatch.setattr('rosbags.rosbag2.storage_sqlite3.Sqlite3Writer.write', fail)
    file = write(tmp_path / 'exp.csv', table())
    assert main(['import-merit', file, '--out', str(tmp_path / 'bag'), '--storage',
                 'sqlite3']) == 2
    assert 'bag: cannot be written (database or disk is full); check' in capsys.readouterr().err
    assert [item.name for item in tmp_path.iterdir()] == ['exp.csv']
