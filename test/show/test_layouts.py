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

"""Layouts for PlotJuggler and Foxglove: every topic and field is one that a node publishes."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module, util
import json
from pathlib import Path
import re
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

import pytest
from tudor_dynamics.arm.description import Arm, arm_from_dict, load_arm
from tudor_dynamics.cli.main import main
from tudor_dynamics.show.description import layout_of, LAYOUTS

HOSTILE = 'a "b" <c> & --> {{ d }}'


@pytest.fixture(scope='module')
def reference(root: Path) -> ModuleType:
    """Table of the topics of all nodes, which `test_documentation.py` compares with them."""
    spec = util.spec_from_file_location('nodes_reference', root / 'tools/nodes_reference.py')
    assert spec is not None and spec.loader is not None
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def spatial(names: tuple[str, ...]) -> Arm:
    """Give an arm of joints that drive alone, with torques."""
    return arm_from_dict({
        'name': HOSTILE, 'kinematics': {'dh': [[0.3, 0.0, 0.0, 0.0]] * len(names)},
        'joints': [{'name': name, 'effort': {'unit': 'N m'}} for name in names]},
        base=Path(), source='test')


def plotted(text: str) -> Iterator[list[str]]:
    """Give the curves of a layout of PlotJuggler: topic, then fields."""
    for curve in ElementTree.fromstring(text).iter('curve'):
        yield curve.attrib['name'].lstrip('/').split('/')


def subscribed(text: str) -> Iterator[list[str]]:
    """Give the paths of all panels of Foxglove: topic, then fields."""
    panels = json.loads(text)['configById']
    used = re.findall('"([A-Za-z0-9]+![a-z_]+)"', json.dumps(json.loads(text)['layout']))
    assert sorted(used) == sorted(panels), 'every panel stands in the layout, once'
    for panel in panels.values():
        paths = [item['value'] for item in panel.get('paths', ())]
        paths += [panel[key] for key in ('topicPath', 'topicToRender') if key in panel]
        for path in [*paths, *panel.get('topics', ())]:
            yield re.sub(r'\[\d+\]', '', path).lstrip('/').split('.')


def has(message: Any, fields: list[str]) -> bool:
    """Say whether a message has a field, and one of that, and so on."""
    return not fields or (hasattr(message, fields[0])
                          and has(getattr(message, fields[0]), fields[1:]))


@pytest.mark.parametrize('names', [('q1',), tuple(f'axis{k}' for k in range(7)), None])
@pytest.mark.parametrize('program', LAYOUTS)
def test_topics_are_those_of_the_nodes(
    root: Path, reference: ModuleType, program: str, names: tuple[str, ...] | None,
) -> None:
    """Each has its field; each channel of each method has ratio, residual and threshold."""
    arm = load_arm(root / 'config/two_blade_arm.yaml') if names is None else spatial(names)
    text = layout_of(arm, program)
    found = list(plotted(text) if program == 'plotjuggler' else subscribed(text))
    published = {topic.lstrip('/') for _, topics in reference.TOPICS.values() for topic in topics}
    channels: dict[str, list[str]] = {}
    for topic, *fields in found:
        assert topic in published or topic == 'diagnostics'
        kind = reference.CONTENT.get(topic, reference.CONTENT.get(f'/{topic}'))[0]
        package, message = kind.split('/')
        if kind == reference.STATE:
            if program == 'plotjuggler':
                channels.setdefault(topic, []).append(fields.pop(0))
            assert len(fields) == 1
        assert has(getattr(import_module(f'{package}.msg'), message)(), fields), (topic, fields)
    topics = [topic for topic, *_ in found]
    for output, own in (('effort', arm.active_joints), ('momentum', arm.active_joints),
                        ('strain', arm.gauge_names)):
        for what in ('ratios', 'residuals', 'thresholds'):
            assert topics.count(f'{output}_{what}') == len(own)
            assert channels.get(f'{output}_{what}', list(own)) == list(own)
    assert {'payload', 'collision', 'contact', 'contact_wrench'} <= set(topics)
    if program == 'foxglove':
        assert {'contact_marker', 'diagnostics', 'collision_record'} <= set(topics)


@pytest.mark.parametrize('program', LAYOUTS)
def test_the_layouts_of_the_sample_arm(
    root: Path, two_blades: Path, tmp_path: Path, program: str, capsys: pytest.CaptureFixture[str],
) -> None:
    """Those in config are what `tudor export` writes for the sample arm; nothing is replaced."""
    out = tmp_path / 'layout'
    command = ['export', str(two_blades), '--to', program, '--out', str(out)]
    assert main(command) == 0
    assert out.read_text() == (root / 'config' / LAYOUTS[program]).read_text()
    assert main(command) == 2
    assert 'exists already' in capsys.readouterr().err


def test_hostile_names_stay_names() -> None:
    """An arm and its joints may be called what they like."""
    arm = spatial((HOSTILE,))
    assert [f'effort_ratios/{HOSTILE}/effort'.split('/')] == [
        path for path in plotted(layout_of(arm, 'plotjuggler')) if path[0] == 'effort_ratios']
    panels = json.loads(layout_of(arm, 'foxglove'))['configById']
    assert panels['Plot!effort_ratios']['paths'][0]['label'] == HOSTILE
