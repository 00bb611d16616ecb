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

"""The table of physical parameters: one entry is all that a new one takes."""

from __future__ import annotations

from elastic_making import blade_arm, even, GAINS, lone_arm, recorded, travel
import numpy as np
import pytest

from tudor_dynamics.errors import SimulationError
from tudor_dynamics.identification.elastic_problem import Knowledge, Record
from tudor_dynamics.identification.elastic_search import identify, knowledge_of
from tudor_dynamics.models.elastic.arm import DrivenArm
from tudor_dynamics.models.elastic.kernel import LOOSE, TIGHT
from tudor_dynamics.models.elastic.model import ElasticModel
from tudor_dynamics.models.elastic.parameters import (
    in_words, ParameterKind, PHYSICAL, physical_unit, Physics)

ARM = blade_arm()
RATE = 100.0


@pytest.fixture
def drag(monkeypatch: pytest.MonkeyPatch) -> str:
    """Enter a parameter that nobody knows: damping of a gear inside and outside of its play."""
    def act(physics: Physics, joint: str, value: float) -> None:
        physics.spring(joint)[[TIGHT, LOOSE]] += value

    monkeypatch.setitem(PHYSICAL, 'drag', ParameterKind(
        'joint', 'N m s/rad', 'drag of the gear of {}', lambda physics, joint: 0.0, act,
        width=1.5, least=0.1, unit_along='N s/m', bounds=(0.0, 5.0)))
    return 'drag(j1)'


def test_one_entry_is_simulated_found_saved_and_named(drag: str) -> None:
    """Simulated with another value, it comes out of the strain; bundle and report know it."""
    arm = lone_arm()
    assert DrivenArm(arm).parameters[drag] == 0.0
    known = knowledge_of(arm, payload=False)
    assert (known.start[drag], known.width[drag]) == (0.1, 1.5)
    truth = {'gear(j1)': 200.0, drag: 0.4}
    q = travel(12.0, RATE, 3)[:, :1]
    strain, _ = recorded(arm, truth, q, RATE)
    some = Knowledge({name: known.start[name] for name in truth},
                     {name: known.width[name] for name in truth})
    found = identify(arm, [Record(q, even(len(q), RATE), strain[:, :1], payload=0.2)],
                     warm={}, knowledge=some)
    values = {parameter.name: parameter for parameter in found.physical}
    assert values['gear(j1)'].value == pytest.approx(200.0, rel=0.02)
    assert values[drag].shown and values[drag].value == pytest.approx(0.4, rel=0.1)
    model = ElasticModel(arm, 'strain', found.physical)
    model.coefficients_ = (np.array([GAINS[0], 0.0]),)
    model.standard_errors_, model.noise_ = (np.full(2, 0.1),), np.ones(1)
    again = ElasticModel.from_dict(model.to_dict(arm, 'strain'), arm, 'strain')
    assert again.values == model.values
    assert in_words(drag) == 'drag of the gear of j1'
    assert physical_unit(arm, drag) == 'N m s/rad'


def test_bounds_of_an_entry_hold(drag: str) -> None:
    """For whoever sets a value, and in the search, whatever the recordings say."""
    arm = lone_arm()
    with pytest.raises(SimulationError, match=r'drag\(j1\) .*: 6.0, expected 0 to 5'):
        DrivenArm(arm).set_parameters({drag: 6.0})
    q = travel(12.0, RATE, 3)[:, :1]
    strain, _ = recorded(arm, {'tight(j1)': 9.0, 'loose(j1)': 9.0}, q, RATE)
    found = identify(arm, [Record(q, even(len(q), RATE), strain[:, :1], payload=0.2)],
                     warm={}, knowledge=Knowledge({drag: 2.0}, {drag: 1.5}))
    assert found.physical[0].value == pytest.approx(5.0, rel=0.01)


def test_units() -> None:
    """Every parameter of an arm has a unit; gears of prismatic joints count in N and m."""
    names = DrivenArm(ARM).parameters
    assert {physical_unit(ARM, name) for name in names} == {
        'N m^2', 'kg/m', 'kg', 'm', 'N m/rad', 'rad', 'N m s/rad', '1', '1/s', 's'}
    slider = blade_arm(gauges=[], joints=[
        {'name': 'j1', 'type': 'prismatic', 'effort': {'unit': 'N'}}, {'name': 'j2'}])
    assert physical_unit(slider, 'gear(j1)') == 'N/m'
    assert physical_unit(slider, 'play(j1)') == 'm'
    assert physical_unit(slider, 'tight(j1)') == 'N s/m'
    assert physical_unit(slider, 'gear(j2)') == 'N m/rad'


@pytest.mark.parametrize(('name', 'text'), [
    ('lumped(j2,1)', 'mass on the link after j2'),
    ('lumped(j2,3)', 'mass on the link after j2, the 3.'),
    ('play(a(b))', 'backlash of the gear of a(b), half of it'),
    ('beta', 'structural damping of the links, per stiffness'),
    ('payload', 'load at the tip')])
def test_parameters_in_words(name: str, text: str) -> None:
    """A reader gets words, whatever the joint is called."""
    assert in_words(name) == text


def test_every_parameter_has_words() -> None:
    """All that a driven arm can be told has a name in words."""
    assert all(in_words(name) for name in DrivenArm(ARM).parameters)
