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

"""Pairs, residuals, thresholds and detector: everything behind the prediction."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from tudor_dynamics.contact.choice import AnyEstimator, contact_estimator
from tudor_dynamics.errors import ModelError
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.monitoring.detector import CollisionDetector, Level
from tudor_dynamics.monitoring.familiarity import UNLIKE
from tudor_dynamics.monitoring.link_names import channel_links
from tudor_dynamics.monitoring.momentum_observer import MomentumObserver
from tudor_dynamics.monitoring.pairing import PairedSample, Pairing
from tudor_dynamics.monitoring.payload_stage import CarriedLoad, PayloadStage
from tudor_dynamics.monitoring.residuals import Residual, ResidualStage
from tudor_dynamics.monitoring.settings import Found, METHODS, MonitorSettings, SOURCE
from tudor_dynamics.monitoring.state_filter import Motion
from tudor_dynamics.monitoring.thresholds.excess import ExcessStage, Rates
from tudor_dynamics.monitoring.thresholds.io import stored_thresholds
from tudor_dynamics.monitoring.thresholds.thresholds import MethodThresholds
from tudor_dynamics.typing import FloatArray


class Watch:
    """
    Pairs, residuals, thresholds and detector: everything behind the prediction.

    contact: None where it is not asked for, or nothing tells; no_contact: empty where they are.
    """

    def __init__(
        self,
        bundle: ModelBundle,
        settings: MonitorSettings,
        thresholds: dict[str, MethodThresholds] | None = None,
        payload: CarriedLoad | None = None,
    ) -> None:
        self.payload = payload
        self.bundle, self.settings = bundle, settings
        spec = bundle.preprocessing
        unknown = [name for name in settings.methods if name not in METHODS]
        if unknown:
            msg = f'methods {unknown} are unknown; expected some of {list(METHODS)}'
            raise ModelError(msg)
        if thresholds is None:
            thresholds = stored_thresholds(bundle, settings.kind)
        kinds = bundle.models
        served = tuple(name for name in settings.methods or METHODS
                       if ('analytical' if name == 'momentum' else settings.kind) in kinds.get(
                           SOURCE[name], {}))
        self.methods = served if settings.methods else (
            tuple(name for name in served if name in thresholds) or served)
        self.outputs = tuple(dict.fromkeys(SOURCE[name] for name in self.methods))
        self.pairing = {output: Pairing() for output in self.outputs}
        self.counts: dict[str, Counter[str]] = {output: Counter() for output in self.outputs}
        self._residual = {output: ResidualStage(spec.output_cutoff, spec.settle)
                          for output in self.outputs}
        self.observer = (MomentumObserver(kinds['effort']['analytical'], settings.observer_gain,
                                          spec.settle) if 'momentum' in self.methods else None)
        self.contact: AnyEstimator | None = None
        self.no_contact = ''
        if settings.contact:
            try:
                self.contact = contact_estimator(bundle, settings.kind, self.methods)
            except ModelError as err:
                self.no_contact = str(err)
        self._load_method = None if payload is None else self._follows(payload)
        self.use_thresholds(thresholds, settings)

    def _follows(self, payload: CarriedLoad) -> str:
        """Choose the method whose samples the load goes by."""
        own = [name for name in self.methods if SOURCE[name] == payload.output]
        if not own and isinstance(payload, PayloadStage):
            msg = (f'the load is told by {payload.output}, which none of the methods '
                   f'{list(self.methods)} listens to: add it to methods')
            raise ModelError(msg)
        return min(own or self.methods, key=lambda name: name != payload.output)

    def use_thresholds(
        self, thresholds: dict[str, MethodThresholds], settings: MonitorSettings,
    ) -> None:
        """Put other thresholds into use; the detector begins anew."""
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
        self._judging = {output: sum(method in self.stages for method in methods)
                         for output, methods in self._methods_of.items()}
        self.set_rates(settings.rates)

    def set_rates(self, rates: Rates) -> None:
        """Share the false alarms that are allowed out among the methods in use."""
        n = max(1, len(self.stages))
        for stage in self.stages.values():
            stage.rates = Rates(rates.collision / n, rates.contact / n)

    def stiction(self, method: str, q: FloatArray) -> FloatArray:
        """Give the friction that may hold each joint while it stands; see ``Model``."""
        kind = 'analytical' if method == 'momentum' else self.settings.kind
        return self.bundle.models[SOURCE[method]][kind].stiction(q)

    @property
    def level(self) -> Level:
        """State of the arm."""
        return self.detector.level

    @property
    def widened(self) -> dict[str, tuple[float, str]]:
        """How much wider the thresholds of each method are than learned, and the channel."""
        found = {}
        for method, stage in self.stages.items():
            place = int(np.argmax(stage.widening))
            found[method] = float(stage.widening[place]), stage.thresholds.channels[place]
        return found

    @property
    def unlike(self) -> str:
        """Say where the arm does not move as it did for its thresholds; empty where it does."""
        wide = [f'{method} {factor:.1f} times' for method, (factor, _) in self.widened.items()
                if factor > UNLIKE]
        return '' if not wide else (
            f'the arm moves unlike what thresholds were learned from: widened {", ".join(wide)}; '
            'learn them from such motion (~/calibrate, or more bags for tudor fit)')

    @property
    def settle(self) -> float:
        """Time behind a beginning for which nothing is judged [s]."""
        settle = self.bundle.preprocessing.settle
        return settle if self.observer is None else max(settle, self.observer.settle)

    def add_motion(self, motion: Motion, predicted: dict[str, FloatArray] | None) -> Found:
        """
        Take a motion with its predictions into account.

        predicted: None while the filters settle.
        """
        found = Found()
        for output, pairing in self.pairing.items():
            values = None if predicted is None else predicted.get(output)
            self._judge(output, pairing.add_motion(motion, values), found)
        return found

    def add_output(
        self, output: str, motion: Motion, predicted: FloatArray | None,
    ) -> Found:
        """
        Take a motion with the prediction of one output into account.

        predicted (channels,) [its unit]: None while the filters settle.
        """
        found = Found()
        if output in self.pairing:
            self._judge(output, self.pairing[output].add_motion(motion, predicted), found)
        return found

    def add_measured(self, output: str, stamp: int, values: FloatArray) -> Found:
        """Take a measurement into account: stamp [ns], values (channels,) [its unit]."""
        found = Found()
        if output in self.pairing:
            self._judge(output, self.pairing[output].add_measured(stamp, values), found)
        return found

    def _judge(self, output: str, pairs: Sequence[PairedSample], found: Found) -> None:
        for pair in pairs:
            before = len(found.excesses)
            plain = self._residual[output].step(pair)
            if self.contact is not None and output == self.contact.source:
                self._touch(pair, plain, found)
            for method in self._methods_of[output]:
                if pair.motion.dt == 0.0:
                    self._restart[method] = True
                if method == 'momentum':
                    assert self.observer is not None
                    residual = self.observer.step(pair, self.payload)
                    if self.contact is not None and method == self.contact.source:
                        self._touch(pair, residual, found)
                else:
                    residual = plain
                if residual is None:
                    continue
                found.residuals.append((method, residual))
                self._carry(method, residual, found)
                stage = self.stages.get(method)
                if stage is None:
                    continue
                excess = stage.step(residual, self._restart[method])
                self._restart[method] = False
                found.excesses.append((method, excess))
                event = self.detector.step(method, excess)
                if event is not None and self.payload is not None and self.payload.expecting:
                    self.detector.reset()
                elif event is not None:
                    found.events.append(event)
            judging = self._judging[output]
            self.counts[output][
                'no_thresholds' if not judging else
                'judged' if len(found.excesses) - before == judging else
                'settling' if not pair.motion.settled(self.settle) else 'no_prediction'] += 1

    def _carry(self, method: str, residual: Residual, found: Found) -> None:
        """Let the load follow; a collision that is one is taken back."""
        if self.payload is None or method != self._load_method:
            return
        load = self.payload.step(residual, self.level)
        if load is not None:
            found.loads.append(load)
            self.detector.reset()

    def _touch(
        self, pair: PairedSample, residual: Residual | None, found: Found,
    ) -> None:
        """Estimate what touches the arm at a sample."""
        assert self.contact is not None
        motion = pair.motion
        estimate = self.contact.step(
            motion.stamp, motion.dt == 0.0, motion.row, pair.measured,
            None if residual is None else residual.value)
        if estimate is not None:
            found.contacts.append(estimate)
