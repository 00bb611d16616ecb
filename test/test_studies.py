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

"""Studies of one's own: notebooks that use exported names alone, and motions that are judged."""

from __future__ import annotations

import ast
from pathlib import Path
import re

import nbclient
import nbformat
import numpy as np
import pytest

import tudor_dynamics as td
from tudor_dynamics.errors import (
    ArgumentError, SignalError, TudorError, TudorWarning, UsageError)

EXAMPLES = Path(__file__).resolve().parents[1] / 'examples'
NOTEBOOKS = sorted(EXAMPLES.glob('*.ipynb'))
LONGEST = 60
"""Lines of code of a study."""
FOUND = {
    'own_detector': (r'my jumps finds ([0-9]+) of 15', 3, 15),
    'own_damping_law': (r'band-pass: settled after ([0-9.]+)', 0.2, 0.6),
    'own_excitation': (r'smallest volume: standard errors ([0-9.]+)', 0.005, 0.0185),
}
"""What each prints, with bounds: the second is what the built-in way of the same study gives."""


def code_of(path: Path) -> list[str]:
    """Give the code of each cell."""
    return [cell.source for cell in nbformat.read(path, 4).cells if cell.cell_type == 'code']


@pytest.mark.parametrize('path', NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook(path: Path, tmp_path: Path) -> None:
    """It runs from the first cell to the last, draws its picture, and finds what it speaks of."""
    for folder in ('config', 'bags'):
        (tmp_path / folder).symlink_to(EXAMPLES.parent / folder)
    notebook = nbformat.read(path, 4)
    nbclient.NotebookClient(notebook, timeout=300, kernel_name='python3', resources={
        'metadata': {'path': str(tmp_path)}}).execute()
    text = ''.join(output.get('text', '') for cell in notebook.cells
                   for output in cell.get('outputs', []))
    assert (tmp_path / f'{path.stem}.png').read_bytes().startswith(b'\x89PNG')
    pattern, low, high = FOUND[path.stem]
    match = re.search(pattern, text)
    assert match is not None and low <= float(match[1]) <= high, text


@pytest.mark.parametrize('path', NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_needs_exported_names_alone(path: Path) -> None:
    """It imports the package as a whole, stays short, and is kept without output."""
    cells = code_of(path)
    names = [name for node in ast.walk(ast.parse('\n'.join(cells)))
             for name in ([item.name for item in node.names] if isinstance(node, ast.Import)
                          else [node.module] if isinstance(node, ast.ImportFrom) else [])]
    assert [name for name in names if name and 'tudor' in name] == ['tudor_dynamics']
    assert sum(bool(line.strip()) for cell in cells for line in cell.split('\n')) <= LONGEST
    assert not any(cell.get('outputs') for cell in nbformat.read(path, 4).cells)
    assert path.with_suffix('.png').is_file() and path.stem in FOUND


def test_there_are_notebooks() -> None:
    """The list above is not empty by a slip of its pattern."""
    assert {path.stem for path in NOTEBOOKS} == set(FOUND)


@pytest.fixture(scope='module')
def arm(root: Path) -> td.Arm:
    """Give an arm with limits."""
    return td.load_arm(root / 'config' / 'tudor.yaml')


def swinging(arm: td.Arm, size: float, same: bool) -> td.Trajectory:
    """Make a motion of two joints, which move alike or not."""
    t = 0.01 * np.arange(1000)
    w = np.array([2.0, 2.0 if same else 3.0])
    return td.Trajectory(arm.active_joints, t, size * np.sin(np.outer(t, w)),
                         size * w * np.cos(np.outer(t, w)), -size * w**2 * np.sin(np.outer(t, w)))


def test_a_motion_is_judged_by_what_it_shows_and_by_limits(arm: td.Arm) -> None:
    """Joints that move alike show less, and cost more; a large motion leaves the limits."""
    plans = [td.excitation(arm, swinging(arm, 0.3, same)) for same in (False, True)]
    apart, alike = (np.array([item.value for item in plan.expected]) for plan in plans)
    assert np.mean(np.log(apart)) < np.mean(np.log(alike)) - 0.5
    assert plans[0].cost < plans[1].cost - 0.5
    small, large = (td.excitation(arm, swinging(arm, size, False)).beyond for size in (0.3, 3.0))
    assert small.velocity.max() < 1.0 < large.velocity.max()
    assert large.velocity == pytest.approx(10.0 * small.velocity)


def test_a_criterion_of_ones_own_is_searched_for(arm: td.Arm) -> None:
    """A search for small errors of one group alone gives it smaller ones than the built-in."""
    def first_alone(covariances: list[np.ndarray]) -> tuple[float, list[np.ndarray]]:
        value = np.linalg.slogdet(covariances[0])[1]
        return value, [-covariances[0], *(0.0 * item for item in covariances[1:])]

    plans = [td.excitation(arm, seconds=10.0, rate=50.0, steps=15),
             td.excitation(arm, seconds=10.0, rate=50.0, steps=15, criterion=first_alone)]
    count = len({item.column for item in plans[0].expected if item.output == 'effort'})
    own = td.excitation(arm, plans[0].trajectory, criterion=first_alone)
    assert own.cost > plans[1].cost
    first = [np.mean(np.log([item.value for item in plan.expected[:count]])) for plan in plans]
    rest = [np.mean(np.log([item.value for item in plan.expected[count:]])) for plan in plans]
    assert first[1] - first[0] < rest[1] - rest[0]


def test_what_is_no_motion_of_the_arm_is_refused(arm: td.Arm) -> None:
    """Other joints, an array in place of a trajectory, and no arm are named."""
    motion = swinging(arm, 0.3, False)
    with pytest.raises((SignalError, TudorError), match='elbow'):
        td.excitation(arm, td.Trajectory(('elbow', 'wrist'), motion.t, motion.q))
    with pytest.raises(ArgumentError, match='motion is'):
        td.excitation(arm, motion.q)  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match='subject is'):
        td.excitation('tudor.yaml')  # type: ignore[arg-type]


@pytest.mark.parametrize('found', [1.0, (1.0, 2.0), (1.0, []), (1.0, [np.eye(2)], 3.0), None])
def test_a_criterion_that_gives_no_slopes_is_named(arm: td.Arm, found: object) -> None:
    """A bare number, and slopes of another number or shape, end in one line."""
    with pytest.raises(UsageError, match='the criterion returned .*expected a cost'):
        td.excitation(arm, swinging(arm, 0.3, False),
                      criterion=lambda _: found)  # type: ignore[arg-type, return-value]


def test_a_motion_of_positions_alone_is_warned_of(arm: td.Arm) -> None:
    """Straight lines between points show no acceleration."""
    motion = swinging(arm, 0.3, False)
    with pytest.warns(TudorWarning, match='positions alone'):
        td.excitation(arm, td.Trajectory(motion.joints, motion.t, motion.q))


def test_the_residual_of_a_prediction(root: Path) -> None:
    """A trace gives measured minus predicted for each sample."""
    arm = td.load_arm(root / 'config' / 'two_blade_arm.yaml')
    bundle = td.fit(root / 'bags' / 'two_blade_train_1', arm, bare=True)
    [trace] = td.predict(bundle, root / 'bags' / 'two_blade_test').outputs[
        'strain']['analytical'].traces
    assert trace.residual.shape == (len(trace.t), len(arm.gauges))
    assert np.array_equal(trace.residual, trace.measured - trace.predicted)
