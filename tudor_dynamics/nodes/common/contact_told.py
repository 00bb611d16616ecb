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

"""What a node tells of contacts: wrench, point and diagnostics."""

from __future__ import annotations

import math
from typing import Any

from geometry_msgs.msg import PointStamped, WrenchStamped

from tudor_dynamics.contact.estimate import ContactEstimate, ContactRecord
from tudor_dynamics.monitoring.watch import Watch
from tudor_dynamics.nodes.common.base import TudorNode
from tudor_dynamics.nodes.common.interfaces import CONTACT_POINT, CONTACT_WRENCH
from tudor_dynamics.nodes.common.messages import time_message


class ContactTold:
    """Publishes what touches an arm."""

    def __init__(self, node: TudorNode) -> None:
        self._wrench = node.publish_on(WrenchStamped, CONTACT_WRENCH)
        self._point = node.publish_on(PointStamped, CONTACT_POINT)
        self._last: ContactEstimate | None = None
        self._record: ContactRecord | None = None
        self._summary: dict[str, Any] = {}

    def tell(self, watch: Watch, estimate: ContactEstimate) -> None:
        """Publish an estimate: a wrench at each sample, the point while it is known."""
        self._last = estimate
        if estimate.felt:
            if self._record is None and watch.contact is not None:
                self._record = watch.contact.record()
            if self._record is not None:
                self._record.add(estimate)
        elif self._record is not None:
            self._summary, self._record = self._record.summary(), None
        wrench = WrenchStamped()
        wrench.header.stamp, wrench.header.frame_id = time_message(estimate.stamp), estimate.link
        if estimate.felt:
            for vector, values in ((wrench.wrench.force, estimate.force),
                                   (wrench.wrench.torque, estimate.torque)):
                vector.x, vector.y, vector.z = (float(value) for value in values)
        self._wrench.publish(wrench)
        if estimate.located:
            point = PointStamped(header=wrench.header)
            point.point.x, point.point.y, point.point.z = (float(v) for v in estimate.point)
            self._point.publish(point)

    def values(self, watch: Watch) -> dict[str, str]:
        """Give what the diagnostics say."""
        if watch.no_contact:
            return {'contact': f'not estimated: {watch.no_contact}'}
        if watch.contact is None:
            return {}
        last = self._last
        values = {'contact': f'by {watch.contact.source}'}
        if last is not None and last.felt:
            values['contact'] += ', felt'
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
            found = self._summary
            where = ('place not told from force' if found['place'] is None else
                     f'{found["place"]:.3f} m from its joint')
            values['last contact'] = f'{found["link"]}, {found["force"]:.2f} N, {where}'
        return values
