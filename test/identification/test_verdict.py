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

"""The verdict in words: levels, reasons, doubts."""

from __future__ import annotations

from typing import Any

import pytest

from tudor_dynamics.identification.validation import ChannelScore, Grade, judge, Score, Validation


def _validation(fit: float, *channels: float) -> Validation:
    each = {f'c{i}': ChannelScore(1.0, value, 0.5) for i, value in enumerate(channels or (fit,))}
    return Validation('test bag x', Score(10, 1.0, 1.0, fit, fit, 0.5, each), (), tuple(each))


@pytest.mark.parametrize(('fit', 'level', 'text'), [
    (99.0, Grade.GOOD, 'fit 99.0 % (>= 85) on test bag x'),
    (88.57, Grade.GOOD, 'fit 88.6 % (>= 85)'),
    (85.0, Grade.GOOD, 'fit 85.0 % (>= 85)'),
    (84.99, Grade.USABLE, 'fit 84.9 % (usable: 60 to 85)'),
    (60.0, Grade.USABLE, '60.0 %'),
    (59.99, Grade.DO_NOT_USE, 'fit 59.9 % (< 60)'),
    (float('-inf'), Grade.DO_NOT_USE, '(< 60)')])
def test_levels(fit: float, level: Grade, text: str) -> None:
    """The fit on unseen motion decides; it is never rounded up over a bound."""
    verdict = judge(_validation(fit), training_fit=fit)
    assert verdict.level is level
    assert text in str(verdict)
    assert str(verdict).startswith(f'{level.value}: ')


@pytest.mark.parametrize(('more', 'text'), [
    ({'unexcited': ['a', 'b', 'c', 'd']}, 'does not excite a, b, c ...: trust it on similar'),
    ({'condition': 2e4}, 'condition number 20000: richer motion'),
    ({'training_fit': 99.5}, '10 points below training')])
def test_doubts(more: dict[str, Any], text: str) -> None:
    """A good figure with a doubt is usable; the doubt is named."""
    verdict = judge(_validation(89.2), **{'training_fit': 90.0, **more})
    assert verdict.level is Grade.USABLE
    assert text in str(verdict)
    poor = judge(_validation(20.0), **{'training_fit': 25.0, **more})
    assert poor.level is Grade.DO_NOT_USE


def test_weak_channel() -> None:
    """A channel that is poor where the whole is not is named."""
    assert 'channel c1 alone has 12.0 %' in str(judge(_validation(90.0, 95.0, 12.0), 90.0))
    assert 'channel c1 alone has 70.0 %, relative error 50 %: usable' in str(
        judge(_validation(90.0, 95.0, 70.0), 90.0))
    assert judge(_validation(90.0, 95.0, 70.0), 90.0).level is Grade.GOOD
    assert judge(_validation(90.0, 95.0, 12.0), 90.0).level is Grade.USABLE


def test_dead_sensor() -> None:
    """A channel that never changed is named and makes no model good; alone it makes it useless."""
    dead = judge(_validation(99.0, 99.0, float('nan')), 99.0)
    assert dead.level is Grade.USABLE
    assert 'c1 never changed on test bag x: a dead sensor' in str(dead)
    none = judge(_validation(float('nan'), float('nan')), float('nan'))
    assert none.level is Grade.DO_NOT_USE and 'c0 never changed' in str(none)


def test_noise_is_all_that_there_is() -> None:
    """An error as large as the noise of its sensor makes a usable model good, and is said."""
    limited = judge(_validation(75.0), 75.0, noise=[0.95])
    assert limited.level is Grade.GOOD
    assert 'c0: its error of 1 is near the noise of 0.95' in str(limited)
    assert judge(_validation(75.0), 75.0, noise=[0.5]).level is Grade.USABLE
    assert judge(_validation(10.0), 10.0, noise=[0.95]).level is Grade.DO_NOT_USE


def test_a_small_error_of_a_large_output() -> None:
    """Where the output hardly varies, its relative error tells more than the fit."""
    score = Score(10, 1.0, 1.0, 20.0, 20.0, 0.12, {'c0': ChannelScore(1.0, 20.0, 0.12)})
    verdict = judge(Validation('test bag x', score, (), ('c0',)), 20.0)
    assert verdict.level is Grade.USABLE and 'relative error 12.0 %' in str(verdict)
    assert verdict.channels == {'c0': Grade.USABLE}
