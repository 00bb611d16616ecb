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

"""What results show of themselves, on a terminal and in a notebook."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from schedule_making import schedule
import tudor_dynamics as td
from tudor_dynamics.models.elastic.model import PhysicalParameter
from tudor_dynamics.typing import Shown


@dataclass(repr=False)
class Measured(Shown):
    """A result."""

    name: str
    values: Any
    parts: tuple[Any, ...] = ()


def rows(shown: Any) -> tuple[str, dict[str, str]]:
    """Read the table that a notebook draws: its caption, and its rows."""
    table = ElementTree.fromstring(shown._repr_html_())
    caption = table.find('caption')
    assert caption is not None and caption.text is not None
    cells = [[cell.text or '' for cell in row] for row in table.iter('tr')]
    return caption.text, {name.strip(): text for name, text in cells}


def test_fields() -> None:
    """Arrays show shape and range, long sequences their number, text is never markup."""
    shown = Measured('a < b', np.array([[1.0, np.nan], [3.0, 2.0]]),
                     tuple(Measured('inner', np.zeros(0)) for _ in range(3)))
    caption, parts = rows(shown)
    assert caption == 'Measured'
    assert parts == {'name': "'a < b'", 'values': 'float64 (2, 2) from 1 to 3',
                     'parts': '3 of Measured'}
    assert repr(Measured('x', np.full(2, np.nan))).endswith('values: float64 (2,)\n  parts: ()')
    assert repr(Measured('x', 'word ' * 1000)).count('word') < 50


def test_results_are_short(root: Path) -> None:
    """Whatever the library returns fits a screen, and is a table in a notebook."""
    arm = td.load_arm(root / 'config/two_blade_arm.yaml')
    recording = td.read_recording(root / 'bags/two_blade_test', arm)
    bundle = td.fit([root / 'bags/two_blade_train_1'], arm)
    found = td.predict(bundle, [root / 'bags/two_blade_test'])
    validation = found.outputs['strain']['analytical']
    found_pushes = td.detect(bundle, [root / 'bags/two_blade_pushes'])[0]
    for shown in (arm, recording, bundle, found, validation, validation.score,
                  validation.traces[0], found_pushes, found_pushes.watched[0],
                  td.planned_limits(arm)):
        assert len(repr(shown)) < 3000 and repr(shown).count('\n') < 25
        caption, parts = rows(shown)
        assert type(shown).__name__ in caption and len(parts) == repr(shown).count('\n')
    assert rows(recording)[1]['strain'].startswith('2 channels from -362.9')


def test_what_works_is_short(root: Path, two_blades: Path) -> None:
    """Loops, plants and monitors show what they are made of, settings and pushes their values."""
    arm, bundle = td.load_arm(root / 'config/tudor.yaml'), td.load_bundle(two_blades)
    push = td.Push(1.0, 0.5, 'joint2', 0.2, (1.0, 0.0, 0.0))
    elastic = td.ElasticModel(arm, 'strain', (PhysicalParameter('payload', 0.2, 'kg', 0.0),))
    elastic.coefficients_ = tuple(np.array([121.4, 0.0]) for _ in arm.gauges)
    elastic.noise_ = np.full(len(arm.gauges), 6.0)
    flexible = td.ModelBundle(arm, arm.spec.preprocessing, {'strain': {'elastic': elastic}})
    for shown in (td.Loop(arm, lambda _: None), td.Rig(arm), td.ClosedLoop(arm),
                  td.Plant(td.build_mechanism(arm)), td.Monitor(bundle), td.Feedforward(bundle),
                  td.ContactEstimator(flexible, 'elastic'), schedule(), elastic, push,
                  td.FitSettings(), td.MonitorSettings(), td.Imperfections()):
        text = repr(shown)
        assert len(text) < 3000 and 1 <= text.count('\n') < 25 and ' at 0x' not in text, text
        caption, parts = rows(shown)
        assert type(shown).__name__ in caption and len(parts) == text.count('\n')
    assert rows(push)[1]['force'] == '(1.0, 0.0, 0.0)'
    assert rows(td.Monitor(bundle))[1]['watch'] == 'Watch'
    assert rows(elastic)[1]['payload'] == '0.2 kg'
