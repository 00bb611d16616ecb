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

"""What collision_detector and monitor share: residuals, collisions, contacts, load."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Sequence
import json
import math
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PointStamped, WrenchStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Header, String

from tudor_dynamics.arm.kinematics import base_frame
from tudor_dynamics.errors import TudorError
from tudor_dynamics.files import provenance
from tudor_dynamics.load.live import CarriedLoad
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.nodes.common.base import ERROR, Figure, OK, TudorNode, WARN
from tudor_dynamics.nodes.common.interfaces import (
    CALIBRATE, COLLISION, COLLISION_EVENT, COLLISION_RECORD, CONTACT, CONTACT_MARKER,
    CONTACT_POINT, CONTACT_WRENCH, RATIOS, RESET, RESIDUALS, RINGING, THRESHOLDS)
from tudor_dynamics.nodes.common.messages import (
    force_marker, JointSample, JointStateEncoder, ListenedPublisher, NamedReader, set_vector,
    time_message, wrench_stamped)
from tudor_dynamics.nodes.common.model_node import Gripper, ModelNode
from tudor_dynamics.online.black_box import record_of
from tudor_dynamics.online.contact import contact_text, ContactEstimate, ContactRecord
from tudor_dynamics.online.coverage import ALSO, Coverage, CoverageLevel, MEANING
from tudor_dynamics.online.detector import CollisionEvent, Excess, Level
from tudor_dynamics.online.monitor import (
    FIELD, Found, METHODS, Monitor, MonitorSettings, SOURCE, warm_up, Watch)
from tudor_dynamics.online.settings import RECORD_SAMPLES
from tudor_dynamics.online.streams import Residual
from tudor_dynamics.online.threshold_learning import (
    Calibration, stored_thresholds, thresholds_to_dict)
from visualization_msgs.msg import Marker


class CollisionOutput:
    """Publishes levels as they change, and collisions as they come."""

    def __init__(self, node: TudorNode) -> None:
        self._node = node
        self.flags = {Level.COLLISION: node.publish_on(Bool, COLLISION, latch=True),
                      Level.CONTACT: node.publish_on(Bool, CONTACT, latch=True)}
        self._events = node.publish_on(Header, COLLISION_EVENT)
        self._records = node.publish_on(String, COLLISION_RECORD, latch=True)
        self._published: dict[Level, bool] = {}
        self.last: dict[str, str] = {}  # what the diagnostics say of the last collision
        self.level(Level.FREE)

    def level(self, level: Level) -> None:
        """Publish how strongly the arm is touched."""
        for of, publisher in self.flags.items():
            state = level >= of
            if self._published.get(of) is not state:
                self._published[of] = state
                publisher.publish(Bool(data=state))

    def event(self, event: CollisionEvent, record: dict[str, Any]) -> None:
        """Publish a collision."""
        node = self._node
        self.last = {'last collision [ns]': str(event.onset), 'last link': event.link}
        self._records.publish(String(data=json.dumps(record)))
        node.get_logger().warning(
            f'collision at {event.link}, detected by {event.method} at {record["time"]}: the '
            f'residual of {record["channel"]} is {record["ratio"][record["channel"]]:.2f} times '
            'its threshold')
        header = Header(frame_id=event.link)
        header.stamp = time_message(event.onset)
        self._events.publish(header)
        values = {'method': event.method, 'link': event.link, 'onset [ns]': str(event.onset),
                  'certain after [ms]': f'{(event.stamp - event.onset) * 1e-6:.1f}',
                  **{f'residual {k}': f'{v:.6g}' for k, v in event.residuals.items()}}
        node.publish_diagnostics(DiagnosticStatus(
            level=WARN, name=f'{node.get_name()}: collision', hardware_id=node.hardware(),
            message=f'collision at {event.link}, detected by {event.method}: check the arm',
            values=[KeyValue(key=k, value=v) for k, v in values.items()]))


class ContactOutput:
    """Publishes what touches an arm."""

    def __init__(self, node: TudorNode) -> None:
        self._wrench = node.publish_on(WrenchStamped, CONTACT_WRENCH)
        self._point = node.publish_on(PointStamped, CONTACT_POINT)
        self._marker = node.publish_on(Marker, CONTACT_MARKER)
        self._last: ContactEstimate | None = None
        self._record: ContactRecord | None = None
        self._summary: dict[str, Any] = {}

    def publish(self, watch: Watch, estimate: ContactEstimate) -> None:
        """Publish an estimate: a wrench at each sample, the point while it is known."""
        self._last = estimate
        if estimate.felt:
            assert watch.contact is not None  # which made it
            self._record = self._record or watch.contact.record()
            self._record.add(estimate)
        elif self._record is not None:
            self._summary, self._record = self._record.summary(), None
        wrench = wrench_stamped(
            time_message(estimate.stamp), estimate.link,
            *((estimate.force, estimate.torque) if estimate.felt else ()))
        self._wrench.publish(wrench)
        if not math.isnan(estimate.place):
            point = PointStamped(header=wrench.header)
            set_vector(point.point, estimate.point)
            self._point.publish(point)
        if self._marker.get_subscription_count():
            self._marker.publish(force_marker(wrench.header, estimate))

    def values(self, watch: Watch) -> dict[str, str]:
        """Give what the diagnostics say."""
        if watch.contact is None:
            return {'contact': f'not estimated: {watch.no_contact}'} if watch.no_contact else {}
        last = self._last
        values = {'contact': f'by {watch.contact.source}'}
        if last is not None and last.felt:
            values['contact'] += ', now'
            values['contact link'] = last.link
            values |= {name: f'{value:.3g}' for name, value in (
                ('contact force [N]', float((last.force**2).sum()) ** 0.5),
                ('contact force deviation [N]', last.force_deviation),
                ('contact torque deviation [N m]', last.torque_deviation),
                ('contact place [m]', last.place),
                ('contact place deviation [m]', last.place_deviation)) if not math.isnan(value)}
            if last.note:
                values['contact note'] = last.note
        if self._summary:
            values['last contact'] = '; '.join(
                filter(None, (contact_text(self._summary), self._summary['note'])))
        return values


class DetectNode(ModelNode):
    """Base of the nodes that find collisions and know of a load."""

    CHAIN: type[Monitor | Watch]  # what takes measurements
    FIGURES: tuple[Figure, ...] = (
        Figure('level', lambda watch: watch.level.name.lower(), 'watch'),
        Figure('methods', lambda watch: ', '.join(watch.stages) or 'none', 'watch'),
        Figure('not judged [%]', lambda node: node.watch and (
            f'{100.0 * node.coverage.verdict.share:.1f}')),
        Figure('not judged: CAUSE', lambda node: node.watch and {
            cause: f'{100.0 * share:.1f}'
            for cause, share in sorted(node.coverage.verdict.causes.items())}),
        Figure('', lambda node: node.watch and node.watch.figures(node.value('stuck_time'))),
        Figure('rings', lambda watch: watch.ringing, 'watch'),
        Figure('thresholds widened: METHOD', lambda watch: {
            method: f'{factor:.2f} ({channel})'
            for method, (factor, channel) in watch.widened.items()}, 'watch'),
        Figure('', lambda node: node.watch and node.contact_output.values(node.watch)),
        Figure('', lambda node: node.watch and node.collision_output.last))

    def __init__(self, name: str, **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        self.watch: Watch | None = None
        self._calibration: Calibration | None = None
        self._learned: dict[str, Any] = {}  # thresholds of `CALIBRATE`, as facts of a bundle
        self._made = provenance()  # once: it takes 30 ms
        self.coverage = Coverage()
        self._residuals, self._thresholds, self._ratios = (
            {method: ListenedPublisher(self.publish_on(JointState, topics[method]))
             for method in METHODS} for topics in (RESIDUALS, THRESHOLDS, RATIOS))
        self._ringing = ListenedPublisher(self.publish_on(JointState, RINGING))
        self.collision_output = CollisionOutput(self)
        self.contact_output = ContactOutput(self)
        self.serve(RESET, self._reset)
        self.serve(CALIBRATE, self._calibrate)
        self.gripper = Gripper(self, self.port.announce, lambda: (
            () if self.bundle is None else tuple(self.bundle.arm.full_model.names)))

    def settings(self) -> MonitorSettings:
        """Give the settings that the parameters stand for."""
        return MonitorSettings.of({name: self.value(name) for name in self.params})

    def prepare(self, bundle: ModelBundle, whole: ModelBundle, load: CarriedLoad | None) -> Any:
        warm_up(bundle, self.settings())
        return self.CHAIN(bundle, self.settings(), payload=load)

    def adopt(
        self, bundle: ModelBundle, chain: Monitor | Watch, motion: str,
        drops: Sequence[Counter[str]], predictions: dict[str, str],
    ) -> None:
        """Put another model into use."""
        watch = chain.watch if isinstance(chain, Monitor) else chain
        self.bundle, self.watch, self._chain = bundle, watch, chain
        names = bundle.arm.channels
        topics = {output: bundle.arm.topics[output] for output in watch.outputs}
        self._sensor_drops: dict[str, Counter[str]] = {output: Counter() for output in topics}
        self._readers = {(output, topic): NamedReader(channels, self._sensor_drops[output])
                         for output, of in topics.items() for topic, channels in of.items()}
        self._past = {method: deque[Excess](maxlen=RECORD_SAMPLES) for method in watch.methods}
        for method in watch.methods:
            for publishers in (self._residuals, self._thresholds, self._ratios):
                publishers[method].encoder = JointStateEncoder(
                    names[SOURCE[method]], (FIELD[method],), base_frame(bundle.arm.full_model))
        self._ringing.encoder = JointStateEncoder(bundle.arm.active_joints, ('effort',))
        self.coverage.begin()
        for output, of in topics.items():
            self.coverage.add(
                output, motion, predictions.get(output), tuple(of),
                [*drops, watch.counts[output]],
                [self._sensor_drops[output], *watch.gathering[output].drops,
                 watch.pairing[output].drops], watch.settle)
        self._calibration, self._learned = None, {}
        unserved = [m for m in self.value('methods') if m not in watch.methods]
        self._unserved = '' if not unserved else (
            f'methods {", ".join(unserved)} need a model of kind {self.value("kind")} (momentum: '
            "analytical), which is missing; change the parameter 'methods' or 'kind'")
        missing = [m for m in watch.methods if m not in watch.stages]
        self._note = '' if not missing else (
            MEANING['no_thresholds'].replace(';', f' for {", ".join(missing)};', 1))

    def came(self, topic: str, stamp: int) -> None:
        """Count a message that the detector needs; say at once where fewer are judged."""
        if self.coverage.came(topic, stamp, self.meter.last_arrival or 0.0):
            self.publish_diagnostics()

    def check(self, values: dict[str, Any]) -> None:
        """Refuse a contact rate below that of collisions."""
        super().check(values)
        collision = values.get('false_alarms_per_hour', self.value('false_alarms_per_hour'))
        contact = values.get('contact_alarms_per_hour', self.value('contact_alarms_per_hour'))
        if contact < collision:
            raise TudorError(f'contact_alarms_per_hour {contact:g} is below false_alarms_per_hour '
                             f'{collision:g}; raise the first parameter or lower the second')

    def apply(self) -> None:
        super().apply()
        if self.watch is None:
            return
        settings = self.settings()
        self.watch.set_rates(settings.rates)
        self.watch.detector.settings = settings.detector

    def on_measured(self, topic: str, message: JointSample) -> None:
        """Take a message that only sensors send."""
        begun = self.meter.begin()
        self.came(topic, message.stamp)
        self.measured(topic, message)
        self.meter.end(begun)

    def measured(self, topic: str, message: JointSample) -> None:
        """Hand readings of each output to the detector and report what it found."""
        if self.watch is None:
            return
        for output in self.watch.outputs:
            reader = self._readers.get((output, topic))
            values = None if reader is None else reader.read(message, FIELD[output])
            if values is None:
                continue
            for stamp, whole in self.watch.gather(output, topic, message.stamp, values):
                self.report(self._chain.add_measured(output, stamp, whole))

    def report(self, found: Found) -> None:
        """Publish what was found, and the load."""
        for method, residual in found.residuals:
            if self._calibration is not None and method in self._calibration.channels:
                self._collect(self._calibration, method, residual)
            self._residuals[method].publish(residual.motion.stamp, residual.value)
        for method, excess in found.excesses:
            stamp = excess.residual.motion.stamp
            self._thresholds[method].publish(stamp, excess.threshold)
            self._ratios[method].publish(stamp, excess.collision)
            self._past[method].append(excess)
        for stamp, amplitude in found.rings:
            self._ringing.publish(stamp, amplitude)
        for event in found.events:
            _, verdict, values = self.status()
            message, others = self.problems(verdict)
            record = record_of(event, self._past[event.method]) | {
                'digest': self.bundle.digest if self.bundle else '', 'made': self._made,
                'settings': {**{name: self.value(name) for name in self.params},
                             'model': str(Path(self.source).absolute())},  # readers are elsewhere
                'sensors': self.watch.sensors(self.value('stuck_time')) if self.watch else {},
                'load': self.load_facts(), 'apart': self.coverage.apart(),
                'state': {**values, **others, 'message': message}}
            self.collision_output.event(event, record)
            self.keep(record, lambda: {'thresholds': self._learned, **{
                name: one.before(event.stamp) for name, one in self._chain.memories.items()}})
        for estimate in found.contacts:
            assert self.watch is not None  # which found it
            self.contact_output.publish(self.watch, estimate)
        if self.watch is not None and found.excesses:
            self.collision_output.level(self.watch.level)
        for load in found.loads:
            self.get_logger().info(f'the load changed without a collision to {load.mass:.3f} kg')
        if found.residuals:
            self.port.publish(found.residuals[-1][1].motion.stamp, len(found.loads))

    def keep(self, record: dict[str, Any], states: Callable[[], dict[str, Any]]) -> None:
        """Take note of an event, and of what lasted for longer than its bag."""

    def _reset(self) -> str:
        """Restart, with the load as well: nothing touches the arm now."""
        self.asked('reset')
        if self.watch is not None:
            self.watch.answer(None, 0.0, 1.0)
        self.collision_output.level(Level.FREE)
        return 'armed'

    def _calibrate(self) -> str:
        if self.watch is None or self.bundle is None:
            raise TudorError(f'cannot calibrate, as {self.fault or "no model is loaded"}')
        if self.meter.stale(float(self.value('timeout'))):
            raise TudorError('cannot calibrate, as no samples arrive', remedy='start the driver '
                             'of the arm, then call the service ~/calibrate again')
        seconds = float(self.value('calibration_time'))
        self._calibration = Calibration(
            {method: self.bundle.arm.channels[SOURCE[method]] for method in self.watch.methods},
            seconds, self.watch.stiction)
        self._note = (f'collision thresholds are learned for {seconds:g} s, in which the old ones '
                      'apply; move the arm as usual, and let nothing touch it')
        return self._note

    def _collect(self, calibration: Calibration, method: str, residual: Residual) -> None:
        calibration.add(method, residual)
        if not calibration.done or self._loader is not None:
            return
        self._calibration = None
        bundle, settings = self.bundle, self.settings()

        def learn() -> Callable[[], None]:
            learned = {method: {
                'analytical' if method == 'momentum' else settings.kind: thresholds_to_dict(found)
            } for method, found in calibration.learn().items()}

            def take() -> None:
                if self.bundle is bundle is not None and self.watch is not None:
                    self._learned = learned
                    self.watch.use_thresholds(
                        stored_thresholds(learned, bundle.arm, settings.kind), settings)
                    self._note = ('collision thresholds learned by the service ~/calibrate apply '
                                  'until a model is loaded; to have them in the model, record '
                                  'the motion of the calibration, and fit again with that bag')
            return take

        def refuse(why: str) -> None:
            self._note = (f'calibration failed, as {why}, and call the service ~/calibrate again '
                          'while it moves; the previous thresholds stay in use')
            self.get_logger().error(self.named(self._note))
        self.in_background(learn, refuse)

    def counters(self) -> list[Counter[str]]:
        if self.watch is None:
            return [self.drops]
        return [self.drops, *self._sensor_drops.values(),
                *(pairing.drops for pairing in self.watch.pairing.values()),
                *(drops for item in self.watch.gathering.values() for drops in item.drops)]

    def about(self) -> dict[str, str]:
        methods = self.watch.methods if self.watch is not None else ()
        return {**super().about(), 'methods': ', '.join(methods) or 'none'}

    def verdict(self) -> tuple[bytes, str]:
        """Say what is not judged, and why."""
        level, message = super().verdict()
        watch = self.watch
        if watch is None:
            return level, message
        self.coverage.look(self.steady())
        rivals = self.rivals(self.collision_output.flags[Level.COLLISION])
        verdict = self.coverage.verdict
        text = '' if self._calibration is not None and not watch.stages else verdict.text
        errors = [watch.stuck(self.value('stuck_time')), '' if watch.methods else self._unserved,
                  text if verdict.level is CoverageLevel.NONE else '']
        warnings = [
            text, self._unserved, watch.outside_training,
            '' if 'no thresholds' in text and 'no thresholds' in self._note else self._note,
            f'{", ".join(rivals)} can also publish on {COLLISION}; give each node its own '
            'namespace, or remap the topic' if rivals else '']
        own, said = next(((of, ALSO.join(filter(None, texts))) for of, texts in (
            (ERROR, errors), (WARN, warnings)) if any(texts)), (OK, ''))
        if level in (OK, WARN) and own > level:
            return own, said
        return level, f'{message}{ALSO}{said}' if level == own == WARN else message
