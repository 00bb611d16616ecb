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

"""Inputs of a run: torques, forces and motion as expressions in t or tables, checked first."""

from __future__ import annotations

import ast
from collections.abc import Callable
from io import StringIO
from pathlib import Path

import numpy as np
from scipy.interpolate import make_interp_spline

from tudor_dynamics.errors import SimulationError
from tudor_dynamics.files import read_bounded
from tudor_dynamics.typing import FloatArray

MAX_EXPRESSION = 2000
MAX_TABLE_BYTES = 50_000_000


def _ramp(x: FloatArray, width: float = 1.0) -> FloatArray:
    return np.clip(x / width, 0.0, 1.0)


FUNCTIONS: dict[str, Callable[..., FloatArray]] = {
    'sin': np.sin, 'cos': np.cos, 'tan': np.tan, 'exp': np.exp, 'sqrt': np.sqrt, 'abs': np.abs,
    'sign': np.sign, 'log': np.log, 'tanh': np.tanh, 'min': np.minimum, 'max': np.maximum,
    'step': lambda x: np.where(np.asarray(x) >= 0.0, 1.0, 0.0), 'ramp': _ramp,
}
OPERATORS: dict[type, Callable[..., FloatArray]] = {
    ast.Add: np.add, ast.Sub: np.subtract, ast.Mult: np.multiply, ast.Div: np.divide,
    ast.Pow: np.power, ast.Mod: np.mod, ast.USub: np.negative, ast.UAdd: np.positive,
    ast.Lt: np.less, ast.LtE: np.less_equal, ast.Gt: np.greater, ast.GtE: np.greater_equal,
}
DIRECTIONS = ('x', 'y', 'z')
CONSTANTS = {'pi': np.pi, 'e': np.e}


def _evaluate(node: ast.AST, t: FloatArray) -> FloatArray:
    if isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
        return np.asarray(float(node.value))
    if isinstance(node, ast.Name) and node.id == 't':
        return t
    if isinstance(node, ast.Name) and node.id in CONSTANTS:
        return np.asarray(CONSTANTS[node.id])
    if isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
        return OPERATORS[type(node.op)](_evaluate(node.left, t), _evaluate(node.right, t))
    if isinstance(node, ast.UnaryOp) and type(node.op) in OPERATORS:
        return OPERATORS[type(node.op)](_evaluate(node.operand, t))
    if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in OPERATORS:
        left, right = _evaluate(node.left, t), _evaluate(node.comparators[0], t)
        return np.asarray(OPERATORS[type(node.ops[0])](left, right), dtype=float)
    if (isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
            and node.func.id in FUNCTIONS and not node.keywords):
        return FUNCTIONS[node.func.id](*(_evaluate(arg, t) for arg in node.args))
    text = ast.unparse(node) if isinstance(node, ast.expr) else type(node).__name__
    msg = (f'{text!r} is not allowed in an expression: use t, numbers, + - * / ** %, comparisons, '
           f'pi, e and {", ".join(sorted(FUNCTIONS))}')
    raise SimulationError(msg)


def evaluate_expression(text: str, t: FloatArray) -> FloatArray:
    """Evaluate an expression in t without Python's eval: t [s]."""
    if len(text) > MAX_EXPRESSION:
        msg = f'an expression of {len(text)} characters is too long (at most {MAX_EXPRESSION})'
        raise SimulationError(msg)
    try:
        tree = ast.parse(text.strip(), mode='eval').body
        with np.errstate(all='ignore'):
            values = np.broadcast_to(_evaluate(tree, t), t.shape).astype(float)
    except SyntaxError:
        msg = f'{text!r} is neither a file nor an expression in t; example: "0.6*sin(2*pi*t)"'
        raise SimulationError(msg) from None
    except (TypeError, ValueError, RecursionError, MemoryError) as err:
        msg = f'the expression {text!r} cannot be evaluated ({err})'
        raise SimulationError(msg) from None
    if not np.isfinite(values).all():
        when = t[np.flatnonzero(~np.isfinite(values))[0]]
        msg = f'the expression {text!r} is not finite at t = {when:g} s'
        raise SimulationError(msg)
    return values


def read_table(path: Path, names: tuple[str, ...]) -> tuple[FloatArray, dict[str, FloatArray]]:
    """
    Read a CSV table: time, then one column a joint, or a direction.

    Returns times [s].
    """
    try:
        text = read_bounded(path, MAX_TABLE_BYTES).decode()
    except (OSError, ValueError) as err:  # ValueError: no UTF-8, or a NUL in the path
        cause = getattr(err, 'strerror', None) or err
        msg = f'{path}: the table cannot be read ({cause})'
        raise SimulationError(msg) from None
    first = text.lstrip().split('\n', 1)[0]
    head = [word.strip() for word in first.lstrip('#').split(',')]
    columns = ['t', *names]
    try:
        float(head[0])
    except ValueError:
        columns = head
        text = text.lstrip().split('\n', 1)[1] if '\n' in text.lstrip() else ''
    if not text.strip():
        msg = f'{path}: the table has no rows; expected columns t, {", ".join(names)}'
        raise SimulationError(msg)
    try:
        data = np.loadtxt(StringIO(text), delimiter=',', ndmin=2, comments='#')
    except ValueError as err:
        msg = f'{path}: no table of numbers ({err}); expected columns t, {", ".join(names)}'
        raise SimulationError(msg) from None
    unknown = [name for name in columns[1:] if name not in names]
    if unknown or columns[0] not in ('t', 'time') or data.shape[1] != len(columns):
        msg = (f'{path}: found the columns {columns if unknown else data.shape[1]}, expected t '
               f'and some of {list(names)}')
        raise SimulationError(msg)
    if data.shape[0] < 2:
        msg = f'{path}: at least two rows are needed, found {data.shape[0]}'
        raise SimulationError(msg)
    if not np.isfinite(data).all():
        row = int(np.flatnonzero(~np.isfinite(data).all(axis=1))[0])
        msg = f'{path}: the value in data row {row + 1} is not finite (NaN or inf); mend the table'
        raise SimulationError(msg)
    if (np.diff(data[:, 0]) <= 0.0).any():
        row = int(np.flatnonzero(np.diff(data[:, 0]) <= 0.0)[0])
        msg = f'{path}: time does not increase after data row {row + 1}'
        raise SimulationError(msg)
    return data[:, 0], {name: data[:, 1 + i] for i, name in enumerate(columns[1:])}


def torque_signal(
    words: list[str], t: FloatArray, joints: tuple[str, ...], active: tuple[str, ...],
) -> FloatArray:
    """
    Give the torques of a run from what the command line says.

    t (samples,) [s]; returns (samples, joints) [N m or N], zero where nothing was said.
    """
    result = np.zeros((t.size, len(joints)))
    for word in words:
        if not _put_named(result, word, t, joints, active):
            result[:, joints.index(active[0])] = evaluate_expression(word, t)
    return result


def _put_named(
    result: FloatArray, word: str, t: FloatArray, names: tuple[str, ...],
    in_tables: tuple[str, ...],
) -> bool:
    """Take NAME=EXPRESSION or a table into the columns it names; False for anything else."""
    name, _, text = word.partition('=')
    if text and name.strip() in names and not text.startswith('='):
        result[:, names.index(name.strip())] = evaluate_expression(text, t)
        return True
    if word.lower().endswith('.csv') or Path(word).is_file():
        times, columns = read_table(Path(word), in_tables)
        for column, values in columns.items():
            result[:, names.index(column)] = np.interp(t, times, values)
        return True
    return False


def force_signal(words: list[str], t: FloatArray) -> FloatArray:
    """
    Give the force at the tip from what the command line says.

    t (samples,) [s]; returns (samples, 3) [N], zero where nothing was said.
    """
    result = np.zeros((t.size, len(DIRECTIONS)))
    for word in words:
        if not _put_named(result, word, t, DIRECTIONS, DIRECTIONS):
            msg = (f'{word!r} is no force: give x=EXPRESSION, y=... or z=... [N, base frame], or '
                   'a CSV file with columns t, x, y, z')
            raise SimulationError(msg)
    return result


def motion_signal(
    path: Path, t: FloatArray, joints: tuple[str, ...],
) -> tuple[tuple[FloatArray, FloatArray, FloatArray], list[str]]:
    """
    Give the motion of joints that follow a table: quintic spline and its derivatives.

    t (samples,) [s]; path: CSV file with columns t, JOINT, ... [rad or m].
    """
    times, columns = read_table(path, joints)
    if times[0] > t[0] + 1e-9 or times[-1] < t[-1] - 1e-9 or times.size < 6:
        msg = (f'{path}: covers {times[0]:g} to {times[-1]:g} s with {times.size} rows, but the '
               f'run needs 0 to {t[-1]:g} s and at least 6 rows; give --seconds or a longer table')
        raise SimulationError(msg)
    result = tuple(np.zeros((t.size, len(joints))) for _ in range(3))
    for joint, values in columns.items():
        spline = make_interp_spline(times, values, k=5)
        for order in range(3):
            result[order][:, joints.index(joint)] = spline(t, nu=order)
    return (result[0], result[1], result[2]), list(columns)
