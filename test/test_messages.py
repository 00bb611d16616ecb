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

"""Messages that are understood at the first reading: rules for the texts in the source."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
import re
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / 'tools'))

from messages import Message, messages  # noqa: E402, I100

OPTION = re.compile(r'(?<![\w-])--[a-z{]')
COMMAND = re.compile(r'tudor [a-z]+|ros2 |rosbags-convert |-m ')
"""What a command line begins with; an option after it belongs to it."""
PROGRAMS = ('cli/', 'nodes/common/trial.py', 'nodes/joint_test.py', 'nodes/damper_sign_test.py')
"""Modules that read options themselves."""


@dataclass(frozen=True)
class Rule:
    """What a message must not have, and a text that has it."""

    wrong: Callable[[Message], object]
    example: Message


def error(text: str, place: str = 'models/one.py:1') -> Message:
    """Make an error of a module."""
    return Message('error', place, text)


def foreign_option(message: Message) -> bool:
    """Find an option that no command in the message has, outside modules with options."""
    found = OPTION.search(message.text)
    return (found is not None and not message.place.startswith(PROGRAMS)
            and COMMAND.search(message.text[:found.start()]) is None)


def nameless_service(message: Message) -> bool:
    """Find ``~/name`` that is not said to be a service; folders of a home are none."""
    return any(not message.text[:found.start()].endswith(('service ', 'services '))
               for found in re.finditer(r'~/(?!\.)', message.text))


def bare_name(message: Message) -> bool:
    """Find a name of the user's that may be read as a word of the sentence."""
    nouns = '(?<!training )(?:joint|gauge|bag|arm|controller|link|(?:effort|position)s? of)'
    names = re.findall(rf'{nouns} \{{([^{{}}|]*)\}}', message.text)
    return any(not name.endswith('!r') and 'repr' not in name and re.search(
        r'name|joint|gauge|bag|choice|lacking|value\(|self\._names', name)
        for name in names)


def no_remedy(message: Message) -> bool:
    """Find a refusal that says what is impossible, and neither what is expected nor a remedy."""
    return bool(re.search(r'\b(?:cannot be read|is missing|not found|does not exist)$',
                          message.text))


def pattern(text: str) -> Callable[[Message], object]:
    """Search for a pattern."""
    return lambda message: re.search(text, message.text)


RULES = {
    'two problems in one sentence': Rule(
        pattern(r'\balso: '), error('no strain came; also: no effort came')),
    'a code beside its sentence': Rule(
        lambda message: re.search(r'\((?:mainly )?(?:[a-z]+(?:_[a-z]+)+|gap|settling)\)',
                                  re.sub(r'\{[^{}]*\}', '', message.text)),
        error('samples are lost (other_names): no joint is known')),
    'a code of a value in brackets': Rule(
        pattern(r'\((?:mainly )?\{(?:cause|kind|code)\}\): '),
        error('cannot use 3 messages ({cause}): {text}')),
    'a service that is not said to be one': Rule(
        nameless_service, error('the joints are stopped until you call ~/reset')),
    'an option of no command': Rule(foreign_option, error('only 3 samples; raise --rate')),
    'a name that reads like a word': Rule(
        bare_name, error('the load of bag {bag.choice} is not known')),
    'a key or parameter that reads like a word': Rule(
        pattern(r'\b(?:the|has no) (?:key|parameter) (?:links|gauges|damper|limits|couplings|'
                r'model|arm|bag|tool|payload|joints|topics|shaping|damping|namespaces)\b'),
        error('the key links is missing; add it')),
    'a payload, which is a load': Rule(
        lambda message: re.search(
            r"(?<![-/.`'=\w])payloads?\b(?! ?[=_.'\]]| in use| std| estimated| under| gives)",
            re.sub(r'(?:topic|parameter|key|has the|in) payload|\{[^{}]*\}', '', message.text)),
        error('the payload is unknown; start payload_estimator')),
    'a unit to look up': Rule(
        pattern(r'\(units? of the (?:arm )?description\)'),
        error('kilograms come from efforts in N m or N (units of the description)')),
    'a refusal without a remedy': Rule(no_remedy, error("{path}: the key 'links' is missing")),
    'a pronoun without a noun': Rule(
        pattern(r'(?:^|[:;] )(?:it|they|them|this|that)(?:, or| or|$)'),
        error('cannot be written; it, or a folder of it, is a file')),
    'a term of the code': Rule(
        lambda message: re.search(r'\bbundles?\b|mass matrix|base parameters',
                                  re.sub(r'\{[^{}]*\}', '', message.text)),
        error('the bundle has no model of this kind; give another')),
    'a negation of a negation': Rule(
        pattern(r'\b(?:not|cannot|never) (?:\w+ )?(?:unless|without|un(?:known|able|set))\b'),
        error('the bag is not unknown; the joint cannot move unless tested')),
}
SAID = {'error', 'warning', 'log', 'diagnostic', 'finding'}
"""Kinds of messages that people meet unasked; help and reports have a context."""


@cache
def said() -> list[Message]:
    """List what people meet unasked."""
    return [message for message in messages() if message.kind in SAID]


@pytest.mark.linter
@pytest.mark.parametrize('name', RULES)
def test_rule(name: str) -> None:
    """No message breaks a rule, and its example does."""
    rule = RULES[name]
    assert rule.wrong(rule.example)
    assert [message for message in said() if rule.wrong(message)] == []


@pytest.mark.linter
def test_what_rules_allow() -> None:
    """What reads well is not refused."""
    for text in ('take fewer; `tudor fit --models elastic` fits one', 'call the service ~/reset',
                 'no bag in ~/.ros/tudor_dynamics', 'joint {joint.name!r} has no motor',
                 'the cut-off (preprocessing.cutoff) is too high', 'set it (3 of 4)'):
        assert [name for name, rule in RULES.items() if rule.wrong(error(text))] == [], text
    assert not foreign_option(error('--seconds 3: give 10 to 3600 s', 'cli/excite.py:1'))
