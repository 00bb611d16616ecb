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

"""What a detector of several outputs judges of all that comes on its topics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
import math

from tudor_dynamics.monitoring.judged import Judged, JudgedShare, LOOK, TopicCount


class Coverage:
    """Counts the messages of a detector's topics, and looks at what became of them."""

    def __init__(self) -> None:
        self.verdict = JudgedShare()
        self._streams: dict[str, TopicCount] = {}
        self._judged: list[Judged] = []
        self._looked = -math.inf

    def begin(self) -> None:
        """Forget the outputs; topics go on where they are."""
        self._judged.clear()
        self._looked = -math.inf

    def add(
        self, output: str, motion: str, predictions: str | None, sensors: Sequence[str],
        motions: Sequence[Counter[str]], measured: Sequence[Counter[str]], settle: float,
    ) -> None:
        """Look at one more output: settle [s]."""
        own = [self._stream(topic) for topic in sensors]
        predicted = [] if predictions is None else [self._stream(predictions)]
        self._judged.append(Judged(output, self._stream(motion), [*predicted, *own], own,
                                   motions, measured, settle))

    def _stream(self, topic: str) -> TopicCount:
        return self._streams.setdefault(topic, TopicCount(topic))

    def came(self, topic: str, stamp: int, now: float) -> bool:
        """
        Count a message; called for each one.

        stamp [ns], now [s].
        """
        stream = self._streams.get(topic)
        if stream is None:
            return False
        worse = False
        if now - self._looked >= LOOK:
            # before it counts: what came until now has been worked off
            before = self.verdict.sight
            worse = self.look(now).sight > before
        stream.count += 1
        stream.stamp = stamp
        return worse

    def look(self, now: float) -> JudgedShare:
        """Look at the counts, unless the last look was just before; ``now`` is steady [s]."""
        if now - self._looked >= LOOK:
            self._looked = now
            self.verdict = _together([judged.look(now) for judged in self._judged])
        return self.verdict


def _together(found: Sequence[JudgedShare]) -> JudgedShare:
    """Give the worst level with the texts that have it, and the largest shares."""
    if not found:
        return JudgedShare()
    sight = max(verdict.sight for verdict in found)
    causes: dict[str, float] = {}
    for verdict in found:
        for cause, share in verdict.causes.items():
            causes[cause] = max(share, causes.get(cause, 0.0))
    texts = dict.fromkeys(v.text for v in found if v.sight == sight and v.text)
    return JudgedShare(sight, '; '.join(texts), max(v.share for v in found), causes)
