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

"""The damaged and unusual bags beside the checkout, each with what must come of it."""

import os
from pathlib import Path
import warnings

import numpy as np
from papers.merit import main as import_merit
import pytest

from tudor_dynamics.arm.description import arm_from_dict
from tudor_dynamics.bags.info import describe
from tudor_dynamics.bags.reader import read_recording, read_wrenches
from tudor_dynamics.bags.storage import open_bag
from tudor_dynamics.cli.main import main
from tudor_dynamics.errors import BagError, TudorWarning

DATA = Path(os.environ.get('TUDOR_SHARED_DATA')
            or Path(__file__).resolve().parents[3] / 'shared' / 'data')
ODD = DATA / 'bags' / 'odd'
UR10 = ('shoulder_pan_joint', 'shoulder_lift_joint', 'elbow_joint', 'wrist_1_joint',
        'wrist_2_joint', 'wrist_3_joint')
pytestmark = [pytest.mark.shared,
              pytest.mark.skipif(not ODD.is_dir(), reason=f'no recordings in {DATA}')]

REFUSED = {
    'derived_constant_pose': 'no joint moves',
    'derived_degrees': 'look like degrees',
    'derived_effort_short': 'message 1 on /joint_states has 4 values in effort, but 6 names',
    'derived_no_effort': 'neither efforts nor strains',
    'derived_one_message': 'too short: 1 usable',
    'derived_truncated_sqlite3': 'malformed',
    'derived_zero_stamps': 'messages on /joint_states were recorded do not increase',
    'rosbag2_empty_bag': 'record the joint states',
    'rosbag2_split_no_metadata_sqlite3': 'record the joint states',
}
# Name: samples, lengths of segments, dropped, a word of the warning.
READ = {
    'derived_duplicate_stamps': (899, [301, 598], {'duplicate_stamp': 19}, 'duplicate'),
    'derived_gap_2s': (718, [200, 518], {}, 'gap'),
    'derived_joint_order_alphabetical': (918, [918], {}, None),
    'derived_metadata_garbled': (918, [918], {}, 'cannot be used'),
    'derived_nan_effort': (908, [100, 808], {'not_finite': 10}, 'NaN'),
    'derived_no_metadata_mcap': (918, [918], {}, 'metadata.yaml is missing'),
}


def ur10():
    """Make a UR10 with its joints alone; the dynamics do not matter here."""
    return arm_from_dict({'name': 'ur10', 'kinematics': {'dh': [[0.1, 0.0, 0.0, 0.0]] * 6},
                          'joints': [{'name': name} for name in UR10]},
                         base=Path(), source='test')


def read(path):
    """Read for learning; give the recording and the warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter('always', TudorWarning)
        found = read_recording(path, ur10(), need_output=True, need_motion=True)
    return found, [str(item.message) for item in caught]


def test_every_odd_bag_has_an_outcome():
    """No bag of the folder is forgotten here."""
    assert {item.name for item in ODD.iterdir()} == set(REFUSED) | set(READ)


@pytest.mark.parametrize('name', REFUSED)
@pytest.mark.filterwarnings('ignore::tudor_dynamics.errors.TudorWarning')
def test_unusable_bag_is_refused(name):
    """One line with the path and the cause."""
    with pytest.raises(BagError) as caught:
        read(ODD / name)
    text = str(caught.value)
    assert REFUSED[name] in text and text.startswith(str(ODD / name)) and '\n' not in text


@pytest.mark.parametrize('name', READ)
def test_odd_bag_is_read_right(name):
    """The samples are those of the whole recording at the same stamps."""
    samples, segments, dropped, word = READ[name]
    found, texts = read(ODD / name)
    assert len(found.stamp) == samples and found.dropped == dropped
    assert [part.stop - part.start for part in found.segments] == segments
    assert any(word in text for text in texts) if word else not texts
    whole, _ = read(DATA / 'bags' / 'ur10_exciting')
    place = np.searchsorted(whole.stamp, found.stamp)
    np.testing.assert_array_equal(whole.stamp[place], found.stamp)
    for field in ('q', 'dq', 'effort'):
        np.testing.assert_array_equal(getattr(whole, field)[place], getattr(found, field))


def test_published_file_is_read():
    """A bare .db3 in a directory, stamps from 0 s: valid, and equal to the converted bag."""
    found, _ = read(DATA / 'bags' / 'ur10_native')
    whole, texts = read(DATA / 'bags' / 'ur10_exciting')
    assert len(found.stamp) == 3441 and found.dropped == {} and not texts
    np.testing.assert_array_equal(found.q, whole.q)
    np.testing.assert_array_equal(found.effort, whole.effort)


def test_pushes_have_their_truth():
    """Pushes of 2 to 6 N are found in the wrenches."""
    found = read_wrenches(open_bag(DATA / 'bags' / 'arm_200g_pushes'))
    largest = np.linalg.norm(found.values['force'], axis=1).max()
    assert len(found.stamp) == 8000 and 2 <= largest <= 6.01


@pytest.mark.parametrize('name', sorted(set(REFUSED) | set(READ)))
def test_every_odd_bag_is_described(name, capsys):
    """Info describes what can be read (0) and refuses the truncated file (2)."""
    truncated = name == 'derived_truncated_sqlite3'
    assert main(['info', str(ODD / name)]) == (2 if truncated else 0)
    if not truncated:
        report = describe(ODD / name)
        assert report.effort_model == (name in READ)
        assert name in READ or report.verdict.startswith('nothing, as ')
    out, err = capsys.readouterr()
    assert 'Traceback' not in out + err


@pytest.mark.skipif(not (DATA / 'merit_exp1.csv').is_file(), reason='no MERIt recording')
def test_real_merit_recording_is_imported(tmp_path):
    """8000 samples at 100 Hz, both models possible."""
    out = tmp_path / 'merit'
    assert import_merit([str(DATA / 'merit_exp1.csv'), '--out', str(out)]) == 0
    report = describe(out)
    assert report.samples == 8000 and report.effort_model and report.strain_model
