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

"""
YAML of other people: one loader for arm descriptions, model bundles and metadata of bags.

A few lines of YAML can stand for gigabytes (references to references), for hours (a number of a
million digits) and for the end of the stack (brackets in brackets). Text is looked through event
by event before anything is made of it.
"""

from __future__ import annotations

from typing import Any

import yaml

MAX_DEPTH = 50
"""Levels: the compiled loader follows any number of them until the stack ends."""
MAX_VALUES = 300_000
"""Keys and values, counted again wherever a reference stands for them."""
MAX_DIGITS = 400
"""Of a number."""
MAX_LONG = 1000
"""Integers of more than 64 bits."""


class BoundedLoader(getattr(yaml, 'CSafeLoader', yaml.SafeLoader)):  # type: ignore[misc]
    """The fast safe loader where it is compiled in, with numbers of bounded length."""

    _long = 0

    def construct_number(self, node: yaml.ScalarNode) -> float:
        """Read an integer or float; YAML has them in base 60, too, which take quadratic time."""
        value: float = 0.0
        if len(node.value) <= MAX_DIGITS:
            value = (self.construct_yaml_int(node) if node.tag.endswith('int')
                     else self.construct_yaml_float(node))
            # Long integers can be made to share one hash: many as keys take quadratic time, too.
            self._long += isinstance(value, int) and abs(value) >= 1 << 64
            if self._long <= MAX_LONG:
                return value
        raise yaml.constructor.ConstructorError(
            None, None, f'a number of more than {MAX_DIGITS} characters, or many of 64 bits',
            node.start_mark)


for _kind in ('int', 'float'):
    BoundedLoader.add_constructor(f'tag:yaml.org,2002:{_kind}', BoundedLoader.construct_number)


def load_yaml(text: str | bytes) -> Any:
    """Read YAML of which nothing is known."""
    try:
        _check(text)
        return yaml.load(text, Loader=BoundedLoader)
    except yaml.YAMLError as err:
        mark = getattr(err, 'problem_mark', None)
        where = f' in line {mark.line + 1}' if mark else ''
        what = ' '.join(str(getattr(err, 'problem', None) or err).split())[:200]
        msg = f'no valid YAML{where}: {what}'
    except RecursionError:
        msg = f'no valid YAML: more than {MAX_DEPTH} levels'
    except (OverflowError, TypeError, ValueError) as err:  # dates and numbers that are none
        msg = f'no valid YAML: {" ".join(str(err).split())[:200]}'
    raise ValueError(msg)


def _check(text: str | bytes) -> None:
    """Count levels and values, those that references stand for included."""
    values = 0
    sizes: dict[str, int] = {}  # of what has an anchor, once it is complete
    begun: list[tuple[str | None, int]] = []
    for event in yaml.parse(text, Loader=BoundedLoader):
        if isinstance(event, yaml.CollectionEndEvent):
            anchor, before = begun.pop()
            if anchor is not None:
                sizes[anchor] = values - before
            continue
        if not isinstance(event, yaml.NodeEvent):
            continue
        before = values
        if isinstance(event, yaml.AliasEvent):
            if event.anchor not in sizes:
                msg = f'the reference *{event.anchor} stands for nothing, or for itself'
                raise _refused(msg, event)
            values += sizes[event.anchor]
        else:
            values += 1
        if isinstance(event, yaml.CollectionStartEvent):
            begun.append((event.anchor, before))
        elif isinstance(event, yaml.ScalarEvent) and event.anchor is not None:
            sizes[event.anchor] = 1
        for found, most, what in ((len(begun), MAX_DEPTH, 'levels'),
                                  (values, MAX_VALUES, 'values')):
            if found > most:
                msg = f'more than {most} {what}'
                raise _refused(msg, event)


def _refused(problem: str, event: yaml.Event) -> yaml.YAMLError:
    mark: Any = event.start_mark
    return yaml.MarkedYAMLError(problem=problem, problem_mark=mark)
