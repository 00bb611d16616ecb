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


"""An arm driven by torques from its description, in one call: the simulator as a library."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure
import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import check_type, SimulationError, UsageError
from tudor_dynamics.simulation.mechanics.mechanism import build_mechanism, Mechanism
from tudor_dynamics.simulation.mechanics.motor_links import with_motors
from tudor_dynamics.simulation.plant.outputs import Probe
from tudor_dynamics.simulation.plant.plant import Plant
from tudor_dynamics.simulation.plant.run import Run, run_plant, Steps
from tudor_dynamics.simulation.studies.plots import (
    Curves, draw_signal, pick_signal, save_figure, signal_names, spectrum)
from tudor_dynamics.simulation.studies.results import save_run
from tudor_dynamics.simulation.studies.sampled import Drive, sampled_columns
from tudor_dynamics.simulation.studies.torque_input import DIRECTIONS
from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True, eq=False)
class SimulatedRun:
    """
    A run with the names of what it holds.

    Attributes
    ----------
    arm : Arm
        Arm that moved.
    mechanism : Mechanism
        Its tables, with the order of joints and points.
    run : Run
        Arrays over time.
    plant : Plant
        The plant in its last state, for ``modes``.

    """

    arm: Arm
    mechanism: Mechanism
    run: Run
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
        """
        Take a signal out of the run.

        Parameters
        ----------
        signal : str
            One of ``signals``.

        Returns
        -------
        ndarray of shape (n_samples, n_curves)
            Values; angles are in degrees, as they are drawn.

        Raises
        ------
        SimulationError
            If there is no such signal.

        """
        return self.curves(signal).values

    def curves(self, signal: str) -> Curves:
        """
        Take a signal out of the run, with the labels of its curves and its unit.

        Parameters
        ----------
        signal : str
            One of ``signals``.

        Returns
        -------
        Curves
            ``values`` of shape (n_samples, n_curves) as ``values`` gives them, ``labels``,
            ``title`` and ``unit``.

        Raises
        ------
        SimulationError
            If there is no such signal.

        """
        return pick_signal(self.run, self.mechanism, self.arm.gauge_names, signal)

    def spectrum(self, signal: str) -> tuple[FloatArray, FloatArray]:
        """
        Give the amplitudes of a signal over frequency, through a Hann window.

        Parameters
        ----------
        signal : str
            One of ``signals``.

        Returns
        -------
        frequency : ndarray of shape (n_frequencies,)
            Frequencies [Hz].
        amplitude : ndarray of shape (n_frequencies, n_curves)
            In the unit of the signal.

        Raises
        ------
        SimulationError
            If there is no such signal.

        """
        return spectrum(self.values(signal), float(self.run.t[1] - self.run.t[0]))

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

        Returns
        -------
        matplotlib.figure.Figure
            The figure, which a notebook shows.

        Raises
        ------
        SimulationError
            If there is no such signal.

        """
        figure = draw_signal(self.run, self.curves(signal), title=title or signal)
        if path is not None:
            save_figure(figure, Path(path))
        return figure

    def animate(self, path: str | Path) -> None:
        """
        Draw the run as a moving picture in real time.

        Parameters
        ----------
        path : str or Path
            File to write, ``.gif``, or ``.mp4`` where ffmpeg is installed.

        Raises
        ------
        SimulationError
            If it is of another kind, or ffmpeg is missing.

        """
        from tudor_dynamics.simulation.studies.animation import animate  # slow to import

        animate(Path(path), self.run, self.mechanism)

    def save(self, folder: str | Path, *, bag: bool = True) -> None:
        """
        Write ``run.npz``, and ``bag/`` as the real arm would record it.

        Parameters
        ----------
        folder : str or Path
            Directory, made where it is missing.
        bag : bool, default=True
            Whether a bag is written too.

        Raises
        ------
        BagError
            If the bag exists already.

        """
        Path(folder).mkdir(parents=True, exist_ok=True)
        save_run(Path(folder), self.run, self.arm, self.mechanism, bag=bag)


def simulate(
    arm: Arm,
    torque: Drive | Mapping[str, Drive] = 0.0,
    *,
    seconds: float = 5.0,
    dt: float = 2.5e-4,
    rate: float = 1000.0,
    start: Mapping[str, float] | None = None,
    hold: Sequence[str] = (),
    force: Mapping[str, Drive] | None = None,
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
        Told the number of steps done since its last call, now and then.

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
    steps = Steps.of(seconds, dt, rate)
    arm = with_motors(arm)
    mechanism = build_mechanism(arm)
    plant = Plant(mechanism, dt)
    for name in hold:
        plant.drive(name, 'hold')
    t = dt * np.arange(steps.total + 1, dtype=np.float64)
    by_name = torque if isinstance(torque, Mapping) else {arm.active_joints[0]: torque}
    torques = sampled_columns('torque', by_name, t, mechanism.joints, arm.active_joints)
    forces = (None if force is None else
              sampled_columns('force', force, t, DIRECTIONS, DIRECTIONS))
    if start is not None or forces is not None:
        plant.reset(_places(plant, start or {}),
                    external_force=None if forces is None else forces[0])
    plant.start_torque(torques[0])
    run = run_plant(plant, Probe(plant, arm=arm), torques, every=steps.every, force=forces,
                    progress=progress)
    return SimulatedRun(arm, mechanism, run, plant)


def _places(plant: Plant, start: Mapping[str, float]) -> FloatArray:
    joints, places = plant.mechanism.joints, plant.state.q.copy()
    for name, place in start.items():
        if name not in joints:
            msg = f'start of {name!r}: the joints are {list(joints)}'
            raise UsageError(msg)
        if not np.isfinite(place):
            msg = f'start of {name!r}: found {place}, expected a position [rad or m]'
            raise SimulationError(msg)
        places[joints.index(name)] = place
    return places
