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

"""Node dynamics_predictor: what efforts and strains the model expects of the motion."""

from __future__ import annotations

from functools import partial
from typing import Any

from sensor_msgs.msg import JointState

from tudor_dynamics.load.live import CarriedLoad
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.nodes.common.base import Figure
from tudor_dynamics.nodes.common.interfaces import JOINT_MOTION, PREDICTED
from tudor_dynamics.nodes.common.messages import (
    JointSample, JointStateEncoder, ListenedPublisher, MotionDecoder, MotionReader, NamedReader,
    PointSample)
from tudor_dynamics.nodes.common.model_node import ModelNode
from tudor_dynamics.online.monitor import FIELD, MonitorSettings, warm_up
from tudor_dynamics.online.streams import Gathering, Predictor


class DynamicsPredictorNode(ModelNode):
    """Predictor node; ``**kwargs`` go to rclpy's Node."""

    FIGURES: tuple[Figure, ...] = (Figure('kind', lambda node: node.value('kind')),)

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('dynamics_predictor', **kwargs)
        self.predictor: Predictor | None = None
        self._reader: MotionReader | None = None
        self._gauges: list[Any] = []
        self._predicted = {output: ListenedPublisher(self.publish_on(JointState, topic))
                           for output, topic in PREDICTED.items()}
        self.start()
        self._subscription = self.hear(JOINT_MOTION, self._on_motion, MotionDecoder(self.drops))

    def prepare(
        self, bundle: ModelBundle, whole: ModelBundle, load: CarriedLoad | None,
    ) -> Predictor:
        warm_up(bundle, MonitorSettings(kind=self.value('kind')))
        return Predictor(bundle, self.value('kind'))

    def use(self, bundle: ModelBundle, prepared: Predictor) -> None:
        self.bundle, self.predictor = bundle, prepared
        if self._reader is None:
            self._reader = MotionReader(bundle.arm.active_joints, self.drops)
        if self.predictor.observing and not self._gauges:
            # the gauges, which correct an elastic model
            topics = bundle.arm.topics['strain']
            self._gathering = Gathering(bundle.arm.gauge_names, topics)
            for topic, channels in topics.items():
                reader = NamedReader(channels, self.drops)
                self._gauges.append(self.hear_sensors(
                    bundle.arm, topic, partial(self._on_strain, topic, reader)))
        for output, publisher in self._predicted.items():
            publisher.encoder = JointStateEncoder(bundle.arm.channels[output], (FIELD[output],))

    def _on_strain(self, topic: str, reader: NamedReader, message: JointSample) -> None:
        values = reader.read(message, FIELD['strain'])
        if values is None or self.predictor is None:
            return
        for stamp, whole in self._gathering.add(topic, message.stamp, values):
            self.predictor.add_strain(stamp, whole)

    def _on_motion(self, message: PointSample) -> None:
        begun = self.meter.begin()
        if self.predictor is None or self._reader is None:
            return
        motion = self._reader.read(message)
        if motion is None:
            return
        wanted = [output for output, publisher in self._predicted.items() if publisher.wanted]
        predicted = self.predictor.step(motion, wanted)
        if predicted is None:
            return
        if self.port.load is not None:
            predicted = self.port.load.add_to(predicted, motion.row)
        for output, values in predicted.items():
            self._predicted[output].publish(motion.stamp, values)
        self.meter.end(begun)
