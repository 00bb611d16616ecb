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

"""Node collision_detector: predictions and measurements in, residuals and collisions out."""

from __future__ import annotations

from collections import Counter, OrderedDict
from functools import partial
from typing import Any

from tudor_dynamics.compiled import all_finite
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.nodes.common.detection import DetectNode
from tudor_dynamics.nodes.common.interfaces import JOINT_MOTION, PREDICTED
from tudor_dynamics.nodes.common.messages import (
    JointSample, MotionDecoder, MotionReader, NamedReader, PointSample)
from tudor_dynamics.nodes.settings import WAITING
from tudor_dynamics.online.monitor import FIELD, Watch
from tudor_dynamics.online.streams import Motion


class CollisionDetectorNode(DetectNode):
    """Detector node; ``**kwargs`` go to rclpy's Node."""

    CHAIN = Watch

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('collision_detector', **kwargs)
        self._motion_drops: Counter[str] = Counter()
        self._inputs: dict[str, Any] = {}
        self.start()
        self._motion_input = self.hear(JOINT_MOTION, self._on_motion, MotionDecoder(self.drops))

    def use(self, bundle: ModelBundle, prepared: Watch) -> None:
        self.adopt(bundle, prepared, JOINT_MOTION, (self._motion_drops,), PREDICTED)
        self._motion_reader = MotionReader(bundle.arm.active_joints, self._motion_drops)
        self._motions: dict[str, OrderedDict[int, Motion]] = {
            output: OrderedDict() for output in prepared.outputs}
        self._predictions: dict[str, OrderedDict[int, Any]] = {
            output: OrderedDict() for output in prepared.outputs}
        self._prediction_readers = {output: NamedReader(bundle.arm.channels[output], self.drops)
                                    for output in prepared.outputs}
        for output in prepared.outputs:
            predicted = PREDICTED[output]
            if predicted not in self._inputs:
                self._inputs[predicted] = self.hear(
                    predicted, partial(self._on_predicted, output))
            for topic in bundle.arm.topics[output]:
                if topic not in self._inputs:  # one each, whatever the topic carries
                    self._inputs[topic] = self.hear_sensors(
                        bundle.arm, topic, partial(self.on_measured, topic))

    def _on_motion(self, message: PointSample) -> None:
        self.meter.begin()
        self.came(JOINT_MOTION, message.stamp)
        if self.watch is None:
            return
        motion = self._motion_reader.read(message)
        if motion is None:
            return
        for output, waiting in self._motions.items():
            predicted = self._predictions[output].pop(motion.stamp, None)
            if predicted is not None or not motion.settled(self.watch.bundle.preprocessing.settle):
                # predictions come only once the filters have settled
                self.report(self.watch.add_motion(motion, {output: predicted}, (output,)))
                continue
            waiting[motion.stamp] = motion
            if len(waiting) > WAITING:
                waiting.popitem(last=False)
                self._lack_prediction(self.watch, output)

    def _lack_prediction(self, watch: Watch, output: str) -> None:
        self.drops['no_prediction'] += 1
        watch.counts[output]['no_prediction'] += 1

    def _on_predicted(self, output: str, message: JointSample) -> None:
        self.came(PREDICTED[output], message.stamp)
        if self.watch is None or output not in self._motions:
            return
        values = self._prediction_readers[output].read(message, FIELD[output])
        if values is None:
            return
        if not all_finite(values):
            self.drops['not_finite'] += 1
            return  # a comparison with NaN would find no collision, ever
        stamp = message.stamp
        waiting = self._motions[output]
        motion = waiting.get(stamp)
        if motion is None:
            early = self._predictions[output]
            early[stamp] = values
            if len(early) > WAITING:
                early.popitem(last=False)
            return
        while waiting:  # those before it have lost their predictions
            first, _ = waiting.popitem(last=False)
            if first == stamp:
                break
            self._lack_prediction(self.watch, output)
        self.report(self.watch.add_motion(motion, {output: values}, (output,)))

    def counters(self) -> list[Counter[str]]:
        return [*super().counters(), self._motion_drops]
