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

"""An arm driven by torques in one call: inputs as functions, text or tables; files of a run."""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
import shutil
from typing import Any

from matplotlib.animation import FFMpegWriter, FuncAnimation, PillowWriter
from matplotlib.artist import Artist
from matplotlib.figure import Figure
import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import make_interp_spline
from tudor_dynamics.arm.description import Arm, by_topic, refuse_interfaces
from tudor_dynamics.bags.messages import IMU, joint_signals, Signals
from tudor_dynamics.bags.trajectory import read_trajectory
from tudor_dynamics.bags.writer import write_bag
from tudor_dynamics.errors import check_type, SimulationError, UsageError
from tudor_dynamics.files import check_target, whole, write_figure
from tudor_dynamics.mechanics import chain as at
from tudor_dynamics.mechanics.mechanism import build_mechanism, Mechanism, with_motors
from tudor_dynamics.mechanics.plant import Plant
from tudor_dynamics.mechanics.run import (
    count_steps, FIRST_STAMP, InertialSensors, PlantRecord, Probe, run_plant)
from tudor_dynamics.typing import FloatArray, Shown


# -- Figures of a run: initial configuration, signals over time and frequency

COLOURS = ('#1f5fa8', '#c8502d', '#3a8a4f', '#7a52a0')
STYLES = ('-', (0, (5, 1.5)), (0, (1, 1)), (0, (5, 1.5, 1, 1.5)))
"""Lines that can be distinguished in grey, too."""
AXES = ('x', 'y', 'z')
HIGHEST = 150.0  # frequency up to which spectra are drawn [Hz]


@dataclass(frozen=True, eq=False)
class Curves:
    """A named signal of a run: values (n_samples, n_curves), a label a curve, title and unit."""

    values: FloatArray  # values over time, a curve a column, (samples, curves)
    labels: tuple[str, ...]
    title: str  # title of the figure
    unit: str  # unit of the values


def signal_names(mechanism: Mechanism, gauges: tuple[str, ...]) -> list[str]:
    """Give the names of the signals that a run shows."""
    points = ['tip', *mechanism.joints]
    return ([f'{what}:{joint}' for what in ('q', 'dq', 'effort') for joint in mechanism.joints]
            + [f'{what}:{point}' for what in ('position', 'acceleration') for point in points]
            + [f'moment:{joint}' for joint in mechanism.beams]
            + [f'strain:{gauge}' for gauge in gauges] + ['energy'])


def plot_configuration(path: Path, mechanism: Mechanism, position: FloatArray, title: str) -> None:
    """Draw the mechanism as it stands: position (points, 3) [m]."""
    figure = Figure(figsize=(6.4, 5.6), layout='constrained')
    axes = figure.add_subplot(projection='3d')
    draw_mechanism(axes, mechanism, position)
    for joint in mechanism.joints:
        axes.text(*position[mechanism.point(joint, 0)], f'  {joint}', fontsize=8)
    axes.text(*position[mechanism.tip], '  tip', fontsize=8)
    limit_axes(axes, position)
    axes.set_title(title)
    write_figure(figure, path, 110)


def draw_mechanism(axes: Any, mechanism: Mechanism, position: FloatArray) -> None:
    """Draw beams, rigid connections, nodes and joints into three-dimensional axes [m]."""
    for row in mechanism.body_int:
        first, parent = int(row[at.POINT]), int(row[at.PARENT])
        if parent >= 0:
            node = int(mechanism.body_int[parent, at.POINT]) + max(int(row[at.NODE]), 0)
            axes.plot(*position[[node, first]].T, color='#707070', linewidth=1.5)
        if row[at.FLEXIBLE]:
            axes.plot(*position[first:first + int(row[at.ELEMENTS]) + 1].T, color=COLOURS[0],
                      linewidth=2.5, marker='.', markersize=6)
    hubs = position[[mechanism.point(joint, 0) for joint in mechanism.joints]]
    axes.plot(*hubs.T, linestyle='', marker='o', color=COLOURS[1], markersize=6)


def limit_axes(axes: Any, position: FloatArray) -> None:
    """Give all axes the same scale, with the base in view: position (..., 3) [m]."""
    points = np.vstack([position.reshape(-1, 3), np.zeros(3)])
    low, high = points.min(axis=0), points.max(axis=0)
    middle, half = 0.5 * (low + high), 0.55 * float((high - low).max()) + 1e-3
    for name, centre in zip(AXES, middle, strict=True):
        getattr(axes, f'set_{name}lim')(centre - half, centre + half)
        getattr(axes, f'set_{name}label')(f'{name} [m]')
    axes.set_box_aspect((1, 1, 1))


# -- A run as a moving picture: GIF, or MP4 where ffmpeg is installed

MAX_FRAMES = 600


def check_animation(path: Path, *, overwrite: bool = True, name: str = 'path') -> None:
    """Say before a run whether its animation can be written."""
    check_target(path, overwrite=overwrite, name=name, endings=('.gif', '.mp4'),
                 kind=SimulationError)
    if path.suffix.lower() == '.mp4' and shutil.which('ffmpeg') is None:
        raise SimulationError(f'{path}: .mp4 needs ffmpeg, which is not installed; use .gif')


MAX_EXPRESSION = 2000


FUNCTIONS: dict[str, Callable[..., FloatArray]] = {
    'sin': np.sin, 'cos': np.cos, 'tan': np.tan, 'exp': np.exp, 'sqrt': np.sqrt, 'abs': np.abs,
    'sign': np.sign, 'log': np.log, 'tanh': np.tanh, 'min': np.minimum, 'max': np.maximum,
    'step': lambda x: np.where(np.asarray(x) >= 0.0, 1.0, 0.0),
    'ramp': lambda x, width=1.0: np.clip(x / width, 0.0, 1.0),
}
OPERATORS: dict[type, Callable[..., FloatArray]] = {
    ast.Add: np.add, ast.Sub: np.subtract, ast.Mult: np.multiply, ast.Div: np.divide,
    ast.Pow: np.power, ast.Mod: np.mod, ast.USub: np.negative, ast.UAdd: np.positive,
    ast.Lt: np.less, ast.LtE: np.less_equal, ast.Gt: np.greater, ast.GtE: np.greater_equal,
}
Drive = ArrayLike | Callable[[float], float]
"""What drives a joint: a constant, an expression, values, or a function of the time."""
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
    raise SimulationError(f'{text!r} is not allowed in an expression; use t, numbers, + - * / ** '
                          f'%, comparisons, pi, e and {", ".join(sorted(FUNCTIONS))}')


def evaluate_expression(text: str, t: FloatArray) -> FloatArray:
    """Evaluate an expression in t without Python's eval: t [s]."""
    if len(text) > MAX_EXPRESSION:
        msg = f'an expression of {len(text)} characters is too long (at most {MAX_EXPRESSION})'
        raise SimulationError(msg)
    try:
        tree = ast.parse(text.strip(), mode='eval').body
        with np.errstate(all='ignore'):
            values = np.broadcast_to(_evaluate(tree, t), t.shape).astype(float)
    except SimulationError as err:
        raise err.at(f'expression {text!r}') from None
    except SyntaxError:
        msg = f'{text!r} is neither a file nor an expression in t; example: "0.6*sin(2*pi*t)"'
        raise SimulationError(msg) from None
    except (TypeError, ValueError, RecursionError, MemoryError) as err:
        raise SimulationError(f'{text!r} cannot be evaluated ({err}); correct it') from None
    if not np.isfinite(values).all():
        when = t[np.flatnonzero(~np.isfinite(values))[0]]
        raise SimulationError(f'expression {text!r} is not finite at t = {when:g} s; correct it')
    return values


def read_table(path: Path, names: tuple[str, ...]) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Read a CSV table: time [s], then one column a joint, or a direction."""
    table = read_trajectory(path)
    if len(table.t) < 2 or not {*table.joints} <= {*names}:
        raise SimulationError(f'{path}: it has {len(table.t)} rows of {", ".join(table.joints)}; '
                              f'give two rows or more, of t and some of {", ".join(names)}')
    return table.t, dict(zip(table.joints, table.q.T, strict=True))


def named_inputs(
    words: Sequence[str], t: FloatArray, names: tuple[str, ...], in_tables: tuple[str, ...],
    other: str,
) -> dict[str, Drive]:
    """Take NAME=EXPRESSION and tables from the command line, at times [s]; name the others."""
    found: dict[str, Drive] = {}
    for word in words:
        name, _, text = word.partition('=')
        if text and name.strip() in names and not text.startswith('='):
            found[name.strip()] = text
        elif word.lower().endswith('.csv') or Path(word).is_file():
            times, columns = read_table(Path(word), in_tables)
            found |= {column: np.interp(t, times, values) for column, values in columns.items()}
        else:
            found[other] = word
    return found


def torque_signal(
    words: Sequence[str], t: FloatArray, joints: tuple[str, ...], active: tuple[str, ...],
) -> FloatArray:
    """Give the torques (samples, joints) [N m or N] that the command line asks for, or zero."""
    found = named_inputs(words, t, joints, active, active[0])
    return sampled_columns('torque', found, t, joints, joints)


def force_signal(words: Sequence[str], t: FloatArray) -> FloatArray:
    """Give the force at the tip (samples, 3) [N] that the command line asks for, or zero."""
    found = named_inputs(words, t, AXES, AXES, '')
    if '' in found:
        raise SimulationError(f'force= {found[""]!s} names no axis; give x=EXPRESSION, y=... or '
                              'z=... [N, base frame], or a CSV file with columns t, x, y, z')
    return sampled_columns('force', found, t, AXES, AXES)


def motion_signal(
    path: Path, t: FloatArray, joints: tuple[str, ...],
) -> tuple[tuple[FloatArray, FloatArray, FloatArray], list[str]]:
    """Give the motion of joints that follow a CSV table of t, JOINT, ...: a quintic spline."""
    times, columns = read_table(path, joints)
    if times[0] > t[0] + 1e-9 or times[-1] < t[-1] - 1e-9 or times.size < 6:
        msg = (f'{path}: covers {times[0]:g} to {times[-1]:g} s with {times.size} rows, but the '
               f'run needs 6 rows or more, from 0 to {t[-1]:g} s; add them, or run for less time')
        raise SimulationError(msg)
    result = tuple(np.zeros((t.size, len(joints))) for _ in range(3))
    for joint, values in columns.items():
        spline = make_interp_spline(times, values, k=5)
        for order in range(3):
            result[order][:, joints.index(joint)] = spline(t, nu=order)
    return (result[0], result[1], result[2]), list(columns)


def sampled(value: Drive, t: FloatArray, name: str) -> FloatArray:
    """Sample, at times [s], a constant, expression in t, function of time, or values."""
    if isinstance(value, str):
        return evaluate_expression(value, t)
    # not in the try below: what a function of the user raises is best seen as it is
    given = [value(time) for time in t.tolist()] if callable(value) else value
    try:
        values = np.broadcast_to(np.asarray(given, dtype=float), t.shape)
    except (TypeError, ValueError) as err:
        msg = (f'the {name} is {repr(value)[:60]} ({err}); expected a number, an '
               f'expression in t, a function of the time, or an array of {t.size} values')
        raise SimulationError(msg) from None
    if not np.isfinite(values).all():
        when = t[np.flatnonzero(~np.isfinite(values))[0]]
        raise SimulationError(f'the {name} is not finite at t = {when:g} s; correct it')
    return values


def sampled_columns(
    what: str, given: Mapping[str, Drive], t: FloatArray, columns: tuple[str, ...],
    allowed: tuple[str, ...],
) -> FloatArray:
    """Sample torques of joints, or a force's components, (samples, columns), zero by default."""
    result = np.zeros((t.size, len(columns)))
    for name, value in given.items():
        if name not in allowed:
            raise SimulationError(f'{what}: there is no {name!r}; use some of {list(allowed)}')
        result[:, columns.index(name)] = sampled(value, t, f'{what} of {name}')
    return result


def run_series(run: PlantRecord, arm: Arm, mechanism: Mechanism) -> list[Signals]:
    """Lay a run out on the topics of joint states, strains and accelerations."""
    refuse_interfaces(arm, 'a bag that is written here')
    stamp = FIRST_STAMP + np.rint((run.t - run.t[0]) * 1e9).astype(np.int64)
    return [
        joint_signals('/' + arm.spec.joint_topic.lstrip('/'), stamp, mechanism.joints, run.q,
                      run.dq, run.effort),
        *(joint_signals('/' + topic.lstrip('/'), stamp, [arm.gauge_names[i] for i in chosen],
                        run.strain[:, chosen], effort=run.gauge_moment[:, chosen])
          for topic, chosen in by_topic(arm.gauges).items()),
        *(Signals(f'/imu/{name}', stamp, {
            'orientation': run.orientation(index),
            'angular_velocity': run.sensor_turning[:, index],
            'linear_acceleration': run.sensor_acceleration[:, index]},
            frame=f'{name}_imu', msgtype=IMU)
          for index, name in enumerate(InertialSensors(mechanism).names))]


@dataclass(frozen=True, eq=False)
class SimulatedRun(Shown):
    """
    A run with the names of what it holds.

    Attributes
    ----------
    arm : Arm
        Arm that moved.
    mechanism : Mechanism
        Its tables, with the order of joints and points.
    run : PlantRecord
        Arrays over time.
    plant : Plant
        The plant in its last state, for ``modes``.

    """

    arm: Arm
    mechanism: Mechanism
    run: PlantRecord
    plant: Plant

    def __repr__(self) -> str:
        """Write length, joints, gauges and where the arm ends."""
        run, mechanism = self.run, self.mechanism
        ends = ', '.join(f'{name} {value:.4g}' for name, value in
                         zip(mechanism.joints, run.q[-1], strict=True))
        return (f'SimulatedRun of {self.arm.name}: {run.t[-1]:g} s, {run.t.size} samples, '
                f'largest elastic rotation {run.rotation.max():.3g} rad\n'
                f'  at the end [rad or m]: {ends}\n  signals: {", ".join(self.signals)}')

    @property
    def signals(self) -> tuple[str, ...]:
        """Names that ``values`` and ``plot`` know, such as ``strain:GAUGE``."""
        return tuple(signal_names(self.mechanism, self.arm.gauge_names))

    def values(self, signal: str) -> FloatArray:
        """Take one of ``signals`` (n_samples, n_curves); angles in degrees, as they are drawn."""
        return self.curves(signal).values

    def curves(self, signal: str) -> Curves:
        """Take one of ``signals`` with the labels of its curves, its title and its unit."""
        run, mechanism = self.run, self.mechanism
        what, _, which = signal.partition(':')
        if signal not in self.signals:
            known = ', '.join(self.signals)
            raise SimulationError(f'there is no signal {signal!r}; choose from {known}')
        if what in ('q', 'dq', 'effort'):
            values = np.asarray(getattr(run, what))[:, [mechanism.joints.index(which)]]
            unit = {'q': 'deg', 'dq': 'deg/s', 'effort': 'N m'}[what]
            return Curves(values if what == 'effort' else np.degrees(values), (which,),
                          {'q': 'angle', 'dq': 'speed', 'effort': 'torque'}[what], unit)
        if what in ('position', 'acceleration'):
            point = mechanism.tip if which == 'tip' else mechanism.point(which)
            unit = 'm' if what == 'position' else 'm/s$^2$'
            return Curves(
                np.asarray(getattr(run, what))[:, point], AXES, f'{what} of {which}', unit)
        if what == 'moment':
            number = list(mechanism.beams).index(which)
            return Curves(run.moment[:, number], ('torsion', 'about y', 'about z'),
                          f'moment in the middle of the link after {which}', 'N m')
        if what == 'strain':
            gauge = self.arm.gauge_names.index(which)
            unit = self.arm.gauges[gauge].unit
            return Curves(run.strain[:, [gauge]], (which,), 'strain',
                          'um/m' if unit in ('mV/V', 'V') else unit)
        return Curves(np.column_stack([run.energy, run.energy.sum(axis=1)]),
                      ('kinetic', 'elastic', 'gravity', 'total'), 'energy', 'J')

    def spectrum(self, signal: str) -> tuple[FloatArray, FloatArray]:
        """
        Give the amplitudes of one of ``signals`` over frequency, through a Hann window.

        Returns frequency (n_frequencies,) [Hz] and amplitude (n_frequencies, n_curves), in the
        unit of the signal.
        """
        values, dt = self.values(signal), float(self.run.t[1] - self.run.t[0])
        window = np.hanning(len(values))[:, None]
        content = np.abs(np.fft.rfft((values - values.mean(axis=0)) * window, axis=0))
        amplitude: FloatArray = 2.0 * content / window.sum()
        return np.asarray(np.fft.rfftfreq(len(values), dt), dtype=float), amplitude

    def plot(
        self, signal: str, path: str | Path | None = None, *, title: str | None = None,
    ) -> Figure:
        """
        Draw a signal over time and over frequency.

        Parameters
        ----------
        signal : str
            One of ``signals``.
        path : str or Path, optional
            PNG file to write; only drawn by default.
        title : str, optional
            Title of the figure; the name of the signal by default.

        Raises
        ------
        SimulationError
            If there is no such signal.

        """
        figure = Figure(figsize=(9.0, 5.4), layout='constrained')
        upper, lower = figure.subplots(2, 1)
        curves, t = self.curves(signal), self.run.t
        frequency, amplitude = self.spectrum(signal)
        for column, label in enumerate(curves.labels):
            look: dict[str, Any] = {
                'color': COLOURS[column % len(COLOURS)], 'linestyle': STYLES[column % len(STYLES)],
                'linewidth': 0.9, 'label': label}
            upper.plot(t, curves.values[:, column], **look)
            lower.semilogy(frequency[1:], np.maximum(amplitude[1:, column], 1e-30), **look)
        upper.set(xlabel='t [s]', ylabel=f'[{curves.unit}]', title=title or signal,
                  xlim=(0, t[-1]))
        top = max(float(amplitude[1:].max()), 1e-12)
        lower.set(xlabel='f [Hz]', ylabel=f'amplitude [{curves.unit}]',
                  ylim=(top * 1e-5, 2.0 * top), xlim=(0, min(HIGHEST, frequency[-1])))
        for axes in (upper, lower):
            axes.grid(alpha=0.3)
        upper.legend(loc='upper right', frameon=False, ncols=4, handlelength=3.0)
        if path is not None:
            write_figure(figure, Path(path), 110)
        return figure

    def animate(self, path: str | Path) -> None:
        """Draw the run in real time to ``.gif``, or with ffmpeg ``.mp4``, at up to 25 frames/s."""
        path, run = Path(path), self.run
        check_animation(path)
        rate = min(25.0, MAX_FRAMES / max(float(run.t[-1] - run.t[0]), 1e-6))
        frames = np.unique(np.searchsorted(run.t, np.arange(run.t[0], run.t[-1], 1.0 / rate)))
        figure = Figure(figsize=(5.2, 4.8))
        axes = figure.add_subplot(projection='3d')
        tip = run.position[:, self.mechanism.tip]

        def draw(frame: int) -> list[Artist]:
            axes.clear()
            draw_mechanism(axes, self.mechanism, run.position[frame])
            axes.plot(*tip[:frame + 1].T, linewidth=0.7, color=COLOURS[2])
            limit_axes(axes, run.position)
            axes.set_title(f't = {run.t[frame]:.2f} s')
            return []

        pictures = max(int(round(rate)), 1)
        writer = (PillowWriter(fps=pictures) if path.suffix.lower() == '.gif'
                  else FFMpegWriter(fps=pictures))
        with whole(path) as scratch:
            FuncAnimation(figure, draw, frames=frames).save(scratch, writer=writer, dpi=80)

    def save(self, folder: str | Path, *, bag: bool = True) -> None:
        """Write ``run.npz`` into a folder, and ``bag/`` as the real arm would record it."""
        path, arm, mechanism = Path(folder), self.arm, self.mechanism
        path.mkdir(parents=True, exist_ok=True)
        self.run.save(
            path / 'run.npz', joints=np.array(mechanism.joints),
            gauges=np.array(arm.gauge_names, dtype=str), beams=np.array(list(mechanism.beams)),
            tip=np.array(mechanism.tip), sensors=np.array(InertialSensors(mechanism).names))
        if bag:
            write_bag(path / 'bag', run_series(self.run, arm, mechanism))


def simulate(
    arm: Arm, torque: Drive | Mapping[str, Drive] = 0.0, *, seconds: float = 5.0,
    dt: float = 2.5e-4, rate: float = 1000.0, start: Mapping[str, float] | None = None,
    hold: Sequence[str] = (), force: Mapping[str, Drive] | None = None,
    progress: Callable[[int], None] | None = None,
) -> SimulatedRun:
    """
    Drive the mechanism of an arm by torques, as ``tudor simulate`` does.

    Of ``motors``, rotors, gears and viscous friction count; play, Coulomb friction and the limit
    of the current do not.

    Parameters
    ----------
    arm : Arm
        Description with ``links``.
    torque : float, str, callable or array, or mapping of str to these
        Of the first active joint, or of joints by name: a constant, an expression in t such as
        ``'0.6*sin(2*pi*t)'``, a function of the time [s], or values at all steps [N m or N].
    seconds : float, default=5
        Length of the run [s].
    dt : float, default=0.00025
        Step of the integrator [s].
    rate : float, default=1000
        Records per second [Hz].
    start : mapping of str to float, optional
        Where joints start; the others start as described [rad or m].
    hold : sequence of str
        Joints that are held where they start.
    force : mapping of str to float, str, callable or array, optional
        Force at the tip, of ``x``, ``y`` and ``z`` of the base frame those that act, each as a
        torque is given [N].
    progress : callable, optional
        Called with the number of steps done since its last call, now and then.

    Returns
    -------
    SimulatedRun
        Signals, with ``plot`` and ``save``.

    Raises
    ------
    SimulationError
        If the arm cannot be simulated, a torque cannot be used, or the run diverges.
    UsageError
        If a time is not positive, or a joint unknown.

    """
    check_type(arm, Arm, 'arm', "read a description with load_arm('arm.yaml')")
    steps, every = count_steps(seconds, dt, rate)
    arm = with_motors(arm)
    mechanism = build_mechanism(arm)
    plant = Plant(mechanism, dt)
    for name in hold:
        plant.drive(name, 'hold')
    t = dt * np.arange(steps + 1, dtype=np.float64)
    by_name = torque if isinstance(torque, Mapping) else {arm.active_joints[0]: torque}
    torques = sampled_columns('torque', by_name, t, mechanism.joints, arm.active_joints)
    forces = None if force is None else sampled_columns('force', force, t, AXES, AXES)
    places = plant.state.q.copy()
    for name, place in (start or {}).items():
        if name not in mechanism.joints:
            raise UsageError(f'start names {name!r}, no joint of {", ".join(mechanism.joints)}')
        if not np.isfinite(place):
            raise SimulationError(f'start of {name!r} is {place}; give a position [rad or m]')
        places[mechanism.joints.index(name)] = place
    if start is not None or forces is not None:
        plant.reset(places, external_force=None if forces is None else forces[0])
    plant.start_torque(torques[0])
    run = run_plant(plant, Probe(plant, arm=arm), torques, every=every, force=forces,
                    progress=progress)
    return SimulatedRun(arm, mechanism, run, plant)
