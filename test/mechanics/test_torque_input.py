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

"""Torques from expressions and tables."""

from __future__ import annotations

from hypothesis import given, strategies as st
import numpy as np
import pytest

from tudor_dynamics.errors import SimulationError, TudorError
from tudor_dynamics.mechanics.study import (
    evaluate_expression, motion_signal, read_table, torque_signal)

T = np.linspace(0.0, 1.0, 11)


def test_expressions_are_evaluated():
    """Arithmetic, functions, comparisons and constants."""
    assert evaluate_expression('2*sin(2*pi*t) - t**2/4', T) == pytest.approx(
        2 * np.sin(2 * np.pi * T) - T**2 / 4)
    assert evaluate_expression('0.6*(t > 0.45) + step(t-0.8)', T).tolist() == pytest.approx(
        [0.0] * 5 + [0.6] * 3 + [1.6] * 3)
    assert evaluate_expression('3', T).tolist() == [3.0] * 11


@pytest.mark.parametrize('text', [
    '__import__("os").system("true")', 'x', 't.real', '[1, 2][0]', 'open(t)', 'sin(t, x=1)',
    'lambda: 1', 't if t else 1', '"a"', 'sin', '1 +', '(' * 300 + 't', 'sin(t, t, t, t)'])
def test_anything_else_is_refused(text):
    """Names, attributes, calls and syntax that are no formula get one line."""
    with pytest.raises(SimulationError):
        evaluate_expression(text, T)


@pytest.mark.parametrize('text', ['1/t', 'log(-1-t)', '9**9**9**9', 'exp(1000)'])
def test_values_that_are_not_finite_are_refused(text):
    """The time of the first bad value is named."""
    with pytest.raises(SimulationError, match='not finite at t ='):
        evaluate_expression(text, T)


@given(st.text(max_size=60))
def test_no_text_does_harm(text):
    """Any text gives finite numbers or the one kind of error."""
    try:
        assert np.isfinite(evaluate_expression(text, T)).all()
    except SimulationError:
        pass


@given(st.binary(max_size=200))
def test_no_file_does_harm(tmp_path_factory, content):
    """Any bytes give a table or an error of ours."""
    path = tmp_path_factory.mktemp('table') / 'table.csv'
    path.write_bytes(content)
    try:
        times, columns = read_table(path, ('a', 'b'))
        assert np.isfinite(times).all()
    except TudorError:
        pass


def test_columns_of_tables(tmp_path):
    """They are found by name; joints without one get no torque."""
    path = tmp_path / 'torque.csv'
    path.write_text('t, b\n0, 1\n1, 3\n')
    assert torque_signal([str(path)], T, ('a', 'b'), ('a', 'b'))[5].tolist() == [0.0, 2.0]
    path.write_text('t, b, a\n0, 1, 5\n1, 3, 5\n')
    assert torque_signal([str(path)], T, ('a', 'b'), ('a', 'b'))[5].tolist() == [5.0, 2.0]


@pytest.mark.parametrize(('text', 'match'), [
    ('t, a\n0, 1\n1, nan\n', 'point 2 of 2 have nan'),
    ('t, a\n0, 1\n0, 2\n', 'does not increase after point 1'),
    ('t, c\n0, 1\n1, 2\n', 'it has 2 rows of c; give'),
    ('t, a\n0, 1\n', 'two rows'),
    ('0, 1\n1, 2\n', 'expected t, then each joint'), ('t, a\n', 'the table has the shape'),
    ('t, a\n0, x\n1, 2\n', 'not all numbers')])
def test_bad_tables_are_refused(tmp_path, text, match):
    """File and row are named."""
    path = tmp_path / 'torque.csv'
    path.write_text(text)
    with pytest.raises(TudorError, match=match) as caught:
        torque_signal([str(path)], T, ('a', 'b'), ('a', 'b'))
    assert 'torque.csv' in str(caught.value)


def test_words_name_joints():
    """JOINT=EXPRESSION goes to its joint, a bare expression to the first active one."""
    found = torque_signal(['b=2*t', '1'], T, ('a', 'b'), ('a', 'b'))
    assert found[:, 1] == pytest.approx(2 * T)
    assert (found[:, 0] == 1.0).all()


def test_motion_tables_are_differentiated(tmp_path):
    """A quintic spline gives position, velocity and acceleration."""
    t = np.linspace(0.0, 2.0, 201)
    path = tmp_path / 'motion.csv'
    np.savetxt(path, np.column_stack([t, np.sin(3 * t)]), delimiter=',', header='t,b')
    (q, dq, ddq), moved = motion_signal(path, T, ('a', 'b'))
    assert moved == ['b']
    assert q[:, 1] == pytest.approx(np.sin(3 * T), abs=1e-8)
    assert dq[:, 1] == pytest.approx(3 * np.cos(3 * T), abs=1e-5)
    assert ddq[3:, 1] == pytest.approx(-9 * np.sin(3 * T[3:]), abs=1e-3)
    with pytest.raises(SimulationError, match='covers'):
        motion_signal(path, 5 * T, ('a', 'b'))
