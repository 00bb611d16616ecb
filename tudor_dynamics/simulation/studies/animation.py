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

"""A run as a moving picture: GIF, or MP4 where ffmpeg is installed."""

from __future__ import annotations

from pathlib import Path
import shutil

from matplotlib.animation import FFMpegWriter, FuncAnimation, PillowWriter
from matplotlib.artist import Artist
from matplotlib.figure import Figure
import numpy as np

from tudor_dynamics.errors import SimulationError
from tudor_dynamics.files import whole
from tudor_dynamics.simulation.mechanics.mechanism import Mechanism
from tudor_dynamics.simulation.plant.run import Run
from tudor_dynamics.simulation.studies.plots import COLOURS, draw_mechanism, limit_axes

MAX_FRAMES = 600


def check_target(path: Path) -> None:
    """Say before a run whether its animation can be written."""
    if path.suffix.lower() not in ('.gif', '.mp4'):
        msg = f'{path}: animations are .gif or .mp4'
        raise SimulationError(msg)
    if path.suffix.lower() == '.mp4' and shutil.which('ffmpeg') is None:
        msg = f'{path}: .mp4 needs ffmpeg, which is not installed; use .gif'
        raise SimulationError(msg)


def animate(path: Path, run: Run, mechanism: Mechanism, *, rate: float = 25.0) -> None:
    """Draw a run as a moving picture in real time: rate [Hz]."""
    check_target(path)
    seconds = float(run.t[-1] - run.t[0])
    rate = min(rate, MAX_FRAMES / max(seconds, 1e-6))
    frames = np.unique(np.searchsorted(run.t, np.arange(run.t[0], run.t[-1], 1.0 / rate)))
    figure = Figure(figsize=(5.2, 4.8))
    axes = figure.add_subplot(projection='3d')
    tip = run.position[:, mechanism.tip]

    def draw(frame: int) -> list[Artist]:
        axes.clear()
        draw_mechanism(axes, mechanism, run.position[frame])
        axes.plot(tip[:frame + 1, 0], tip[:frame + 1, 1], tip[:frame + 1, 2], linewidth=0.7,
                  color=COLOURS[2])
        limit_axes(axes, run.position)
        axes.set_title(f't = {run.t[frame]:.2f} s')
        return []

    pictures = max(int(round(rate)), 1)
    writer = (PillowWriter(fps=pictures) if path.suffix.lower() == '.gif'
              else FFMpegWriter(fps=pictures))
    with whole(path) as scratch:
        FuncAnimation(figure, draw, frames=frames).save(scratch, writer=writer, dpi=80)
