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

"""Figures and animations of a run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
import shutil
from typing import Any

from matplotlib.animation import FFMpegWriter, FuncAnimation, PillowWriter
from matplotlib.artist import Artist
from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.errors import SimulationError
from tudor_dynamics.files import whole, write_figure
from tudor_dynamics.mechanics import chain as at
from tudor_dynamics.mechanics.mechanism import Mechanism
from tudor_dynamics.mechanics.run import PlantRecord
from tudor_dynamics.typing import FloatArray


# -- Figures of a run: initial configuration, signals over time and frequency

COLOURS = ('#1f5fa8', '#c8502d', '#3a8a4f', '#7a52a0')
STYLES = ('-', (0, (5, 1.5)), (0, (1, 1)), (0, (5, 1.5, 1, 1.5)))
"""Lines that can be distinguished in grey, too."""
AXES = ('x', 'y', 'z')
HIGHEST = 150.0
"""Frequency up to which spectra are drawn [Hz]."""


@dataclass(frozen=True, eq=False)
class Curves:
    """A named signal of a run: values (n_samples, n_curves), a label a curve, title and unit."""

    values: FloatArray  # values over time, a curve a column, (samples, curves)
    labels: tuple[str, ...]
    title: str  # title of the figure
    unit: str  # unit of the values


def signal_names(mechanism: Mechanism, gauges: tuple[str, ...]) -> list[str]:
    """Give the names that ``pick_signal`` knows."""
    points = ['tip', *mechanism.joints]
    return ([f'{what}:{joint}' for what in ('q', 'dq', 'effort') for joint in mechanism.joints]
            + [f'{what}:{point}' for what in ('position', 'acceleration') for point in points]
            + [f'moment:{joint}' for joint in mechanism.beams]
            + [f'strain:{gauge}' for gauge in gauges] + ['energy'])


def pick_signal(
    run: PlantRecord, mechanism: Mechanism, gauges: tuple[str, ...], name: str,
) -> Curves:
    """Take a signal out of a run."""
    what, _, which = name.partition(':')
    if name not in signal_names(mechanism, gauges):
        known = ', '.join(signal_names(mechanism, gauges))
        raise SimulationError(f'there is no signal {name!r} to plot; there are {known}')
    if what in ('q', 'dq', 'effort'):
        column = mechanism.joints.index(which)
        values = np.asarray(getattr(run, what))[:, [column]]
        unit = {'q': 'deg', 'dq': 'deg/s', 'effort': 'N m'}[what]
        return Curves(values if what == 'effort' else np.degrees(values), (which,),
                      {'q': 'angle', 'dq': 'speed', 'effort': 'torque'}[what], unit)
    if what in ('position', 'acceleration'):
        point = mechanism.tip if which == 'tip' else mechanism.point(which)
        unit = 'm' if what == 'position' else 'm/s$^2$'
        return Curves(np.asarray(getattr(run, what))[:, point], AXES, f'{what} of {which}', unit)
    if what == 'moment':
        number = list(mechanism.beams).index(which)
        return Curves(run.moment[:, number], ('torsion', 'about y', 'about z'),
                      f'moment in the middle of the link after {which}', 'N m')
    if what == 'strain':
        column = gauges.index(which)
        return Curves(run.strain[:, [column]], (which,), 'strain', 'unit of the gauge')
    return Curves(np.column_stack([run.energy, run.energy.sum(axis=1)]),
                  ('kinetic', 'elastic', 'gravity', 'total'), 'energy', 'J')


def spectrum(values: FloatArray, dt: float) -> tuple[NDArray, FloatArray]:
    """Give frequencies [Hz] and one-sided amplitudes of Hann-windowed signals."""
    window = np.hanning(len(values))[:, None]
    content = np.abs(np.fft.rfft((values - values.mean(axis=0)) * window, axis=0))
    amplitude: FloatArray = 2.0 * content / window.sum()
    return np.fft.rfftfreq(len(values), dt), amplitude


def draw_signal(run: PlantRecord, signal: Curves, *, title: str | None = None) -> Figure:
    """Draw a signal over time and over frequency."""
    figure = Figure(figsize=(9.0, 5.4), layout='constrained')
    upper, lower = figure.subplots(2, 1)
    frequency, amplitude = spectrum(signal.values, float(run.t[1] - run.t[0]))
    for column, label in enumerate(signal.labels):
        look: dict[str, Any] = {
            'color': COLOURS[column % len(COLOURS)], 'linestyle': STYLES[column % len(STYLES)],
            'linewidth': 0.9, 'label': label}
        upper.plot(run.t, signal.values[:, column], **look)
        lower.semilogy(frequency[1:], np.maximum(amplitude[1:, column], 1e-30), **look)
    upper.set(xlabel='t [s]', ylabel=f'[{signal.unit}]', title=title or signal.title,
              xlim=(0, run.t[-1]))
    top = max(float(amplitude[1:].max()), 1e-12)
    lower.set(xlabel='f [Hz]', ylabel=f'amplitude [{signal.unit}]', ylim=(top * 1e-5, 2.0 * top),
              xlim=(0, min(HIGHEST, frequency[-1])))
    for axes in (upper, lower):
        axes.grid(alpha=0.3)
    upper.legend(loc='upper right', frameon=False, ncols=4, handlelength=3.0)
    return figure


def body_lines(mechanism: Mechanism) -> list[tuple[list[int], bool]]:
    """Give for each link the points to be joined by a line, and whether it is a beam."""
    lines = []
    for row in mechanism.body_int:
        first = int(row[at.POINT])
        own = [first + node for node in range(int(row[at.ELEMENTS]) + 1)]
        parent = int(row[at.PARENT])
        if parent >= 0:
            carrier = mechanism.body_int[parent]
            lines.append(([int(carrier[at.POINT]) + max(int(row[at.NODE]), 0), own[0]], False))
        if row[at.FLEXIBLE]:
            lines.append((own, True))
    return lines


def plot_configuration(
    path: Path, mechanism: Mechanism, position: FloatArray, title: str,
) -> None:
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
    for points, beam in body_lines(mechanism):
        axes.plot(*position[points].T, color=COLOURS[0] if beam else '#707070',
                  linewidth=2.5 if beam else 1.5, marker='.' if beam else '', markersize=6)
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


def check_target(path: Path) -> None:
    """Say before a run whether its animation can be written."""
    if path.suffix.lower() not in ('.gif', '.mp4'):
        raise SimulationError(f'{path}: animations are .gif or .mp4')
    if path.suffix.lower() == '.mp4' and shutil.which('ffmpeg') is None:
        raise SimulationError(f'{path}: .mp4 needs ffmpeg, which is not installed; use .gif')


def animate(path: Path, run: PlantRecord, mechanism: Mechanism) -> None:
    """Draw a run as a moving picture in real time, with 25 frames a second at most."""
    check_target(path)
    rate = min(25.0, MAX_FRAMES / max(float(run.t[-1] - run.t[0]), 1e-6))
    frames = np.unique(np.searchsorted(run.t, np.arange(run.t[0], run.t[-1], 1.0 / rate)))
    figure = Figure(figsize=(5.2, 4.8))
    axes = figure.add_subplot(projection='3d')
    tip = run.position[:, mechanism.tip]

    def draw(frame: int) -> list[Artist]:
        axes.clear()
        draw_mechanism(axes, mechanism, run.position[frame])
        axes.plot(*tip[:frame + 1].T, linewidth=0.7, color=COLOURS[2])
        limit_axes(axes, run.position)
        axes.set_title(f't = {run.t[frame]:.2f} s')
        return []

    pictures = max(int(round(rate)), 1)
    writer = (PillowWriter(fps=pictures) if path.suffix.lower() == '.gif'
              else FFMpegWriter(fps=pictures))
    with whole(path) as scratch:
        FuncAnimation(figure, draw, frames=frames).save(scratch, writer=writer, dpi=80)
