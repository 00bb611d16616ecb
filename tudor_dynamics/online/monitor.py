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

"""The whole live chain in one object: filter, predictor, residuals, thresholds, detector."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm.description import OUTPUTS
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.errors import check_type, ModelError, SignalError
from tudor_dynamics.load.live import CarriedLoad, LoadFound, PayloadStage
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.flexible_tool import RingObserver
from tudor_dynamics.models.regressor import output_units
from tudor_dynamics.online.contact import AnyEstimator, contact_estimator, ContactEstimate
from tudor_dynamics.online.coverage import OF_MOTIONS, SensorHealth
from tudor_dynamics.online.detector import (
    channel_links, CollisionDetector, CollisionEvent, DetectorSettings, Excess, ExcessStage, Level,
    Rates)
from tudor_dynamics.online.memory import Memory
from tudor_dynamics.online.settings import (
    COVERAGE_TIME, LAGS, MOMENTUM_LAGS, MOMENTUM_STEP, OBSERVER_GAIN, STEP, WIDENING_WARNING,
    WINDOW)
from tudor_dynamics.online.streams import (
    Gathering, Motion, PairedSample, Pairing, Predictor, Residual, ResidualStage, StateFilter)
from tudor_dynamics.online.threshold_learning import stored_thresholds
from tudor_dynamics.online.thresholds import MethodThresholds
from tudor_dynamics.typing import FloatArray, Shown


METHODS = ('strain', 'effort', 'momentum')
SOURCE = {'strain': 'strain', 'effort': 'effort', 'momentum': 'effort'}
"""Output that each method needs."""
FIELD = {'effort': 'effort', 'momentum': 'effort', 'strain': 'position'}
"""Field of a JointState that carries each signal."""


@dataclass(frozen=True, repr=False)
class MonitorSettings(Shown):
    """
    Choices of a monitor.

    Attributes
    ----------
    kind : str
        Kind of model whose residuals are watched.
    methods : tuple of str
        What the detector listens to, of `METHODS`; empty for all that the model has thresholds
        for, or without any thresholds for all that it has models for.
    rates : Rates
        False alarms allowed, all methods together.
    detector : DetectorSettings
        Times and hysteresis.
    observer_gain : float
        Bandwidth of the momentum observer [1/s].
    gap : float
        Longest time between samples that is not a gap [s]; 0 for five periods.
    contact : bool
        Whether force and place of contacts are estimated.

    """

    kind: str = 'analytical'
    methods: tuple[str, ...] = ('strain',)
    rates: Rates = Rates()
    detector: DetectorSettings = DetectorSettings()
    observer_gain: float = OBSERVER_GAIN
    gap: float = 0.0
    contact: bool = False

    @classmethod
    def of(cls, params: Mapping[str, Any]) -> MonitorSettings:
        """Give what the parameters of a node stand for."""
        return cls(
            kind=params['kind'], methods=tuple(params['methods']),
            observer_gain=params['observer_gain'],
            rates=Rates(params['false_alarms_per_hour'], params['contact_alarms_per_hour']),
            detector=DetectorSettings(params['debounce'], params['rearm']),
            gap=params.get('gap', 0.0), contact=params['estimate_contact'])


@dataclass(eq=False, slots=True)
class Found:
    """What became known with one message."""

    residuals: list[tuple[str, Residual]] = field(default_factory=list)  # method and residual
    excesses: list[tuple[str, Excess]] = field(default_factory=list)  # by method
    events: list[CollisionEvent] = field(default_factory=list)  # collisions that begin with it
    loads: list[LoadFound] = field(default_factory=list)  # once taken for collisions
    # What touches the arm, where that is estimated.
    contacts: list[ContactEstimate] = field(default_factory=list)
    # How a tool rings, where the model knows it: stamps [ns], amplitudes in efforts (joints,).
    rings: list[tuple[int, FloatArray]] = field(default_factory=list)


# Momentum observer: the external effort without any acceleration.
#
# See Haddadin, De Luca and Albu-Schaeffer, IEEE T-RO 33(6), 2017, Section IV. With the generalised
# momentum p = M(q) dq the observer integrates what the model expects of dp/dt and takes the
# difference for the external effort, after a first-order lag of 1/gain.
#
# Nothing but predictions of the fitted effort model is needed: rows of M(q) dq come from the model
# at zero velocity with dq in place of the acceleration, dM/dt dq from a central difference along
# dq. Each row may carry a scale of its own, so the observer also works on currents of unknown
# torque constant: its result is then in amperes, joint by joint.


class MomentumObserver:
    """Observer of external efforts: gain [1/s], settle [s]."""

    REMEMBERED = '_trail', '_observed', '_carried'

    def __init__(self, model: Model, gain: float = OBSERVER_GAIN, settle: float = 0.5) -> None:
        self.model = model
        self.gain = gain
        self.settle = max(settle, MOMENTUM_LAGS / gain)
        self._observed, self._begun = np.zeros(len(model.channels)), False
        self._last = 0
        self._carried = 0.0
        self._trail = model.trail()

    def step(self, pair: PairedSample, load: CarriedLoad | None = None) -> Residual | None:
        """Observe one sample; returns None while the observer settles."""
        motion = pair.motion
        row = motion.row if self._trail is None else self._trail.step(motion.dt, motion.row)
        n = len(self.model.channels)
        momentum, expected = self._expect(row[None], n, self.model.predict)
        if load is not None and (own := load.worth.get('effort')) is not None:
            more = load.mass - load.known
            own_momentum, change = self._expect(motion.row[None], n, own.along)
            if self._begun:  # what has just come moves as the arm does already
                self._observed = self._observed + (more - self._carried) * own_momentum[0]
            self._carried = more
            momentum, expected = momentum + more * own_momentum, expected + more * change
        external = self._advance(motion.stamp, motion.dt == 0.0, momentum[0],
                                 expected[0] + pair.measured)
        if external is None or not motion.settled(self.settle):
            return None
        return Residual(motion, pair.measured, pair.measured + external, -external)

    def process(
        self, stamp: NDArray[np.int64], motion: FloatArray, measured: FloatArray,
    ) -> FloatArray:
        """Observe a gapless record at once; returns (samples, joints)."""
        momentum, expected = self._expect(motion, len(self.model.channels), self.model.predict)
        out = np.zeros_like(measured)
        for k, (time, p, u) in enumerate(zip(stamp.tolist(), momentum, expected + measured,
                                             strict=True)):
            external = self._advance(time, k == 0, p, u)
            if external is not None:
                out[k] = -external
        return out

    def _advance(
        self, stamp: int, first: bool, momentum: FloatArray, expected: FloatArray,
    ) -> FloatArray | None:
        if first or not self._begun:
            self._observed, self._last, self._begun = momentum, stamp, True
            return None
        dt = (stamp - self._last) * 1e-9
        self._last = stamp
        # backward Euler: stable for any sample time
        before = self._observed + dt * expected
        external = self.gain / (1.0 + self.gain * dt) * (momentum - before)
        self._observed = before + dt * external
        return np.asarray(external)

    @staticmethod
    def _expect(
        motion: FloatArray, n: int, efforts: Callable[[FloatArray], FloatArray],
    ) -> tuple[FloatArray, FloatArray]:
        """Give M dq, and dM/dt dq - n(q, dq): what the momentum does without effort."""
        count = len(motion)
        q, dq = motion[:, :n], motion[:, n:2 * n]
        batch = np.zeros((7, count, motion.shape[1]))
        batch[:, :, 3 * n:] = motion[:, 3 * n:]
        batch[0, :, :2 * n] = motion[:, :2 * n]
        step = MOMENTUM_STEP / np.maximum(1.0, np.abs(dq).max(axis=1, keepdims=True))
        for k, place in enumerate((q, q + step * dq, q - step * dq)):
            batch[1 + 2 * k:3 + 2 * k, :, :n] = place
            batch[1 + 2 * k, :, 2 * n:3 * n] = dq
        y = efforts(batch.reshape(7 * count, -1)).reshape(7, count, -1)
        change = ((y[3] - y[4]) - (y[5] - y[6])) / (2.0 * step)
        return y[1] - y[2], change - y[0]


class Watch:
    """Pairs, residuals, thresholds and detector: everything after the prediction."""

    def __init__(
        self, bundle: ModelBundle, settings: MonitorSettings,
        thresholds: dict[str, MethodThresholds] | None = None, payload: CarriedLoad | None = None,
        *, unloaded: bool = False,  # predictions lack the load, which may change while they wait
    ) -> None:
        self.payload, self._unloaded = payload, unloaded
        self.bundle, self.settings = bundle, settings
        spec = bundle.preprocessing
        unknown = [name for name in settings.methods if name not in METHODS]
        if unknown:
            raise ModelError(f'unknown methods {unknown}; set methods to some of {list(METHODS)}')
        if thresholds is None:
            thresholds = stored_thresholds(
                bundle.facts.get('thresholds'), bundle.arm, settings.kind)
        kinds = bundle.models
        served = tuple(name for name in settings.methods or METHODS
                       if ('analytical' if name == 'momentum' else settings.kind) in kinds.get(
                           SOURCE[name], {}))
        self.methods = served if settings.methods else (
            tuple(name for name in served if name in thresholds) or served)
        self.outputs = tuple(dict.fromkeys(SOURCE[name] for name in self.methods))
        self.gathering = {output: Gathering(bundle.arm.channels[output], bundle.arm.topics[output])
                          for output in self.outputs}
        self.stamp = 0  # of the newest motion [ns]
        # by output and topic: stamps of that motion and of the newest message [ns], its readings
        self._heard: dict[tuple[str, str], tuple[int, int, FloatArray]] = {}
        self._judged: dict[str, int] = {}  # stamp of the newest sample of each method [ns]
        self.pairing = {output: Pairing() for output in self.outputs}
        self.counts: dict[str, Counter[str]] = {output: Counter() for output in self.outputs}
        self._health = {output: SensorHealth(bundle.arm.channels[output])
                        for output in self.outputs}
        self._residual = {output: ResidualStage(spec.output_cutoff, spec.settle)
                          for output in self.outputs}
        self.observer = (MomentumObserver(kinds['effort']['analytical'], settings.observer_gain,
                                          spec.settle) if 'momentum' in self.methods else None)
        self.contact: AnyEstimator | None = None  # none if not asked for, or not possible
        self.no_contact = ''  # why force and place are not known
        if settings.contact:
            self.contact, self.no_contact = contact_estimator(
                bundle, settings.kind, self.methods)
        self.ringing = (None if bundle.tool is None or 'effort' not in self.outputs else
                        RingObserver(bundle.arm, bundle.tool))
        self._load_method = None if payload is None else self._follows(payload)
        self._memories = {'load': Memory(payload, bundle.digest),
                          'observer': Memory(self.observer, bundle.digest)}
        self.use_thresholds(thresholds, settings)

    def _follows(self, payload: CarriedLoad) -> str:
        """Choose the method whose samples the load goes by."""
        own = [name for name in self.methods if SOURCE[name] == payload.output]
        if not own and isinstance(payload, PayloadStage):
            raise ModelError(f'the load is estimated from {payload.output}, which no method of '
                             f'{list(self.methods)} uses: add {payload.output} to methods')
        return min(own or self.methods, key=lambda name: name != payload.output)

    def use_thresholds(
        self, thresholds: dict[str, MethodThresholds], settings: MonitorSettings,
    ) -> None:
        """Put other thresholds into use; the detector restarts."""
        self.settings = settings
        self.stages = {name: ExcessStage(thresholds[name], settings.rates)
                       for name in self.methods if name in thresholds}
        self.detector = CollisionDetector(
            settings.detector, {name: stage.thresholds.channels
                                for name, stage in self.stages.items()},
            channel_links(self.bundle.arm))
        self._restart = dict.fromkeys(self.methods, True)
        self._methods_of = {output: [method for method in self.methods
                                     if SOURCE[method] == output] for output in self.outputs}
        self.set_rates(settings.rates)

    def set_rates(self, rates: Rates) -> None:
        """Share the false alarms that are allowed out among the methods in use."""
        n = max(1, len(self.stages))
        for stage in self.stages.values():
            stage.allow(Rates(rates.collision / n, rates.contact / n))

    def stiction(self, method: str, q: FloatArray) -> FloatArray:
        """Give the friction that may hold each joint while it stands; see ``Model``."""
        kind = 'analytical' if method == 'momentum' else self.settings.kind
        return self.bundle.models[SOURCE[method]][kind].stiction(q)

    def answer(self, mass: float | None, expect: float, reset: float) -> None:
        """Take a load from others [kg], let one come, or restart all: nothing touches the arm."""
        if reset:
            self.detector.reset()
        if self.payload is not None:
            if mass is not None:
                self.payload.carry(mass)
            if expect:
                self.payload.expect()
            if reset and isinstance(self.payload, PayloadStage):
                self.payload.observer.reset()

    @property
    def memories(self) -> dict[str, Memory]:
        """Give what lasts for longer than a recording of an event, by its name there."""
        return {**self._memories, **{name: stage.memory for name, stage in self.stages.items()}}

    @property
    def level(self) -> Level:
        """State of the arm."""
        return self.detector.level

    @property
    def widened(self) -> dict[str, tuple[float, str]]:
        """How much wider the thresholds of each method are than learned, and the channel."""
        return {method: max(zip(stage.widening.tolist(), stage.thresholds.channels, strict=True),
                            key=lambda item: item[0]) for method, stage in self.stages.items()}

    @property
    def outside_training(self) -> str:
        """Say where the arm does not move as it did for its thresholds; empty where it does."""
        wide = [f'{factor:.1f} times for {method}'
                for method, (factor, _) in self.widened.items() if factor > WIDENING_WARNING]
        return '' if not wide else (
            'weak collisions are missed, as this motion differs from the training and thresholds '
            f'are raised ({", ".join(wide)}); call the service ~/calibrate during this motion, '
            'while nothing touches the arm, or fit the model again with bags of this motion too')

    def stuck(self, seconds: float) -> str:
        """Say which channels have not changed for a time, while the arm moved; empty for none."""
        dead = [name for health in self._health.values() for name in health.dead(seconds)]
        return '' if not dead else (f'the reading of {", ".join(dead)} has not changed for '
                                    f'{seconds:g} s of motion; check this sensor and its driver')

    def sensors(self, seconds: float) -> dict[str, str]:
        """Say whether the readings of each channel are ok, stuck for a time [s], or silent."""
        stuck = {name for health in self._health.values() for name in health.dead(seconds)}
        found: dict[str, str] = {}
        for output in self.outputs:
            for topic, names in self.bundle.arm.topics[output].items():
                at, _, values = self._heard.get((output, topic), (0, 0, [math.nan] * len(names)))
                late = abs(self.stamp - at) > COVERAGE_TIME * 1e9
                found |= {name: 'silent' if late or not math.isfinite(value) else
                          'stuck' if name in stuck else 'ok'
                          for name, value in zip(names, values, strict=True)}
        return found

    def figures(self, seconds: float) -> dict[str, str]:
        """Give the share that was judged, and the state of each channel of each method."""
        counts = sum(self.counts.values(), Counter[str]())
        count = counts.total() + sum(
            pairing.drops[cause] for pairing in self.pairing.values() for cause in OF_MOTIONS)
        found = {'judged [%]': f'{100.0 * counts["judged"] / max(count, 1):.0f}'}
        sensors, arm = self.sensors(seconds), self.bundle.arm
        for method in self.methods:
            newest = max([self.stamp, *(stamp for (output, _), (_, stamp, _) in self._heard.items()
                                        if output == SOURCE[method])])
            judged = newest - self._judged.get(method, 0) <= COVERAGE_TIME * 1e9
            units = output_units(arm, SOURCE[method])
            found |= {f'state: {method} {name} [{units[name]}]':
                      'not judged' if sensors[name] == 'ok' and not judged else sensors[name]
                      for name in arm.channels[SOURCE[method]]}
        return found

    @property
    def settle(self) -> float:
        """Time after a beginning for which nothing is judged [s]."""
        settle = self.bundle.preprocessing.settle
        return settle if self.observer is None else max(settle, self.observer.settle)

    def add_motion(
        self, motion: Motion, predicted: Mapping[str, FloatArray | None] | None,
        outputs: Sequence[str] = (),
    ) -> Found:
        """Take a motion and predictions, None while filters settle; all outputs by default."""
        found, self.stamp = Found(), motion.stamp
        for output in outputs or self.outputs:
            values = None if predicted is None else predicted.get(output)
            self._judge(output, self.pairing[output].add_motion(motion, values), found)
        return found

    def gather(
        self, output: str, topic: str, stamp: int, values: FloatArray,
    ) -> list[tuple[int, FloatArray]]:
        """Take what a topic has of an output; gives what is whole with it, for `add_measured`."""
        self._heard[output, topic] = self.stamp, stamp, values
        return self.gathering[output].add(topic, stamp, values)

    def add_measured(self, output: str, stamp: int, values: FloatArray) -> Found:
        """Take a measurement into account: stamp [ns], values (channels,) [its unit]."""
        found = Found()
        if output in self.pairing:
            self._judge(output, self.pairing[output].add_measured(stamp, values), found)
        return found

    def _judge(self, output: str, pairs: Sequence[PairedSample], found: Found) -> None:
        for pair in pairs:
            motion, before = pair.motion, len(found.excesses)
            if self._unloaded and self.payload is not None and pair.predicted is not None:
                pair.predicted = self.payload.add_to({output: pair.predicted}, motion.row)[output]
            self._health[output].step(pair)
            plain = self._residual[output].step(pair)
            if self.ringing is not None and output == 'effort' and plain is not None:
                found.rings.append((motion.stamp, self.ringing.step(
                    motion.dt, motion.row[:len(plain.value)], plain.value)))
            for method in self._methods_of[output]:
                if motion.dt == 0.0:
                    self._restart[method] = True
                residual = plain
                if method == 'momentum':
                    assert self.observer is not None
                    residual = self.observer.step(pair, self.payload)
                    self._memories['observer'].step(motion.stamp)
                if self.contact is not None and method == self.contact.source:
                    estimate = self.contact.step(
                        motion.stamp, motion.dt == 0.0, motion.row, pair.measured,
                        None if residual is None else residual.value)
                    if estimate is not None:
                        found.contacts.append(estimate)
                if residual is None:
                    continue
                found.residuals.append((method, residual))
                self._carry(method, residual, found)
                stage = self.stages.get(method)
                if stage is None:
                    continue
                excess = stage.step(residual, self._restart.pop(method, False))
                found.excesses.append((method, excess))
                self._judged[method] = motion.stamp
                event = self.detector.step(method, excess)
                if event is not None and self.payload is not None and self.payload.expecting:
                    self.detector.reset()
                elif event is not None:
                    found.events.append(event)
            judging = sum(method in self.stages for method in self._methods_of[output])
            self.counts[output][
                'no_thresholds' if not judging else
                'judged' if len(found.excesses) - before == judging else
                'settling' if not motion.settled(self.settle) else 'no_prediction'] += 1

    def _carry(self, method: str, residual: Residual, found: Found) -> None:
        """Let the load follow; a collision that is one is taken back."""
        if self.payload is None or method != self._load_method:
            return
        motion = residual.motion
        load = self.payload.step(motion.stamp, motion.dt, motion.row, residual.measured,
                                 touched=self.level is not Level.FREE)
        self._memories['load'].step(motion.stamp)
        if load is not None:
            found.loads.append(load)
            self.detector.reset()


class Monitor(Shown):
    """
    A whole chain, from joint states to collisions.

    Parameters
    ----------
    bundle : ModelBundle
        Fitted models, with the thresholds that were learned.
    settings : MonitorSettings, optional
        Kind of model, methods of detection, false alarms allowed.
    thresholds : dict of str to MethodThresholds, optional
        In place of those of the bundle.
    payload : CarriedLoad, optional
        Load that predictions have in them, and that follows the arm if it is a `PayloadStage`.

    Attributes
    ----------
    filter : StateFilter
        First stage: positions to motion.
    predictor : Predictor
        Second stage: motion to expected outputs.
    watch : Watch
        Third stage: residuals, thresholds and detector.
    motion : Motion or None
        Motion of the newest sample; None while a gap is crossed.
    predicted : dict of str to ndarray, or None
        Prediction for the newest sample; None while the filters settle.
    wanted : set of str
        Outputs to predict; those that the detector needs by default.

    """

    def __init__(
        self, bundle: ModelBundle, settings: MonitorSettings = MonitorSettings(),
        thresholds: dict[str, MethodThresholds] | None = None, payload: CarriedLoad | None = None,
    ) -> None:
        check_type(bundle, ModelBundle, 'bundle', 'the result of fit or load_bundle')
        check_type(settings, MonitorSettings, 'settings', "such as MonitorSettings(kind='elm')")
        bundle = bundle.beside_robot()
        self._sizes = {'q': len(bundle.arm.active_joints),
                       **{output: len(names) for output, names in bundle.arm.channels.items()}}
        self.filter = StateFilter(bundle.preprocessing, settings.gap)
        self.watch = Watch(bundle, settings, thresholds, payload, unloaded=True)
        self.predictor = Predictor(bundle, settings.kind)
        self.wanted = set(self.watch.outputs)
        self.motion: Motion | None = None
        self.predicted: dict[str, FloatArray] | None = None

    @property
    def memories(self) -> dict[str, Memory]:
        """Give what lasts for longer than a recording of an event, by its name there."""
        return {'model': self.predictor.memory, **self.watch.memories}

    def add_joints(
        self, stamp: int, q: FloatArray, measured_velocity: FloatArray | None = None,
    ) -> Found:
        """
        Take joint states into account.

        Parameters
        ----------
        stamp : int
            Header stamp [ns].
        q : ndarray of shape (n_joints,)
            Positions of the active joints [rad or m].
        measured_velocity : ndarray of shape (n_joints,), optional
            Velocities of the driver [rad/s or m/s].

        Returns
        -------
        Found
            What became known; ``motion`` and ``predicted`` are those of this sample, or None.

        """
        self._check('q', q)
        self.motion = self.filter.step(stamp, q, measured_velocity)
        self.predicted = None
        if self.motion is None:
            return Found()
        self.predicted = unloaded = self.predictor.step(self.motion, self.wanted)
        if self.watch.payload is not None and unloaded is not None:
            self.predicted = self.watch.payload.add_to(unloaded, self.motion.row)
        return self.watch.add_motion(self.motion, unloaded)

    def _check(self, name: str, values: FloatArray) -> None:
        if np.shape(values) != (self._sizes.get(name),):
            raise SignalError(f'{name} has the shape {np.shape(values)}; expected '
                              f'({self._sizes.get(name)},), one value a joint or gauge')

    def add_measured(self, output: str, stamp: int, values: FloatArray) -> Found:
        """
        Take efforts or strains into account.

        Parameters
        ----------
        output : {'effort', 'strain'}
            What was measured.
        stamp : int
            Header stamp [ns].
        values : ndarray of shape (n_channels,)
            Readings in the units of the arm description, NaN where there is none.

        Returns
        -------
        Found
            Residuals, ratios to the thresholds, and collisions that became known.

        """
        self._check(output, values)
        if output == 'strain':
            self.predictor.add_strain(stamp, values)
        return self.watch.add_measured(output, stamp, values)


# A few samples of an arm at rest, so that nothing is compiled or loaded while the robot runs.
#
# Compiled functions are compiled at their first call, on a new installation for seconds, and read
# from the disk at the first call in each process, for tens of milliseconds. Samples would be lost
# meanwhile.

PERIOD = 10_000_000  # time between samples [ns]


def warm_up(bundle: ModelBundle, settings: MonitorSettings) -> None:
    """Run the whole chain on an arm at rest."""
    monitor = Monitor(bundle, settings)
    arm = bundle.arm
    q = np.zeros(len(arm.active_joints))
    needed = bundle.preprocessing.settle + (LAGS + WINDOW) * STEP + 0.1
    monitor.wanted = {*OUTPUTS}
    for k in range(round(needed * 1e9) // PERIOD):
        monitor.add_joints(k * PERIOD, q, q)
        for output in monitor.watch.outputs:
            monitor.add_measured(output, k * PERIOD, np.zeros(len(arm.channels[output])))


def warm_up_filter(spec: PreprocessingSpec) -> None:
    """Filter an arm at rest, with velocities and without."""
    for measured in (None, np.zeros(1)):
        warmed = StateFilter(spec)
        for k in range(3):
            warmed.step(k * PERIOD, np.zeros(1), measured)
