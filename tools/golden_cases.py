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
The cases of ``tools/golden.py``: one a line, ``name = arguments of tudor``.

``OUT`` is the folder of the case; what an earlier case has written is named by that case's name,
and is made first where only some cases are asked for. A name with ``+`` is one of the quick ones.
Arguments that begin with ``!`` go to ``golden_objects.py``.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
import re
import shlex

import numpy as np

COMMANDS = ('init', 'fit', 'evaluate', 'fleet', 'payload', 'info', 'export', 'feedforward',
            'compare', 'excite', 'record', 'simulate', 'tune')
T1, T2, TEST = 'bags/two_blade_train_1', 'bags/two_blade_train_2', 'bags/two_blade_test'
PUSHES, BLADES, TUDOR = 'bags/two_blade_pushes', 'config/two_blade_arm.yaml', 'config/tudor.yaml'
DAMPED, UNDAMPED = 'bags/tudor_damped/stimulus_01', 'bags/tudor_undamped/stimulus_01'
SHORT = f'{T1}@0-40% {T2}@0-40% --test {TEST}@0-50% --arm {BLADES} --out OUT/model --jobs 1'
TABLE = f"""
help/all+ = --help
help/version+ = --version
{chr(10).join(f"help/{name}{'+' * (name == 'fit')} = {name} --help" for name in COMMANDS)}

info/blades+ = info {T1} {T2} {TEST} {PUSHES} --arm {BLADES} --json
info/text = info {DAMPED} {UNDAMPED} --arm {TUDOR}
info/guess = info {DAMPED} {TEST} --json
info/file = info {TEST}/two_blade_test.mcap

init/dh+ = init {T1} {T2} --dh inputs/dh.txt --out OUT/arm.yaml
init/urdf = init {DAMPED} --urdf config/tudor.urdf --out OUT/arm.yaml

record/empty = record --arm {TUDOR} --out OUT/bags --stimuli 1 --seconds 10 --seed 3 --jobs 1
record/full = record --arm {TUDOR} --out OUT/bags --payload 0.3 --stimuli 1 --seconds 10 --seed 4 \
  --jobs 1 --json
record/pushed+ = record --arm {TUDOR} --out OUT/bags --stimuli 1 --seconds 16 --pushes 2 --held \
  --loads 1 --no-damping --ideal friction backlash --jobs 1 --json
record/planned = record --arm {TUDOR} --out OUT/bags --trajectory excite/tudor/plan --stimuli 1 \
  --jobs 1

simulate/shape+ = simulate config/l_shape.yaml --seconds 0.3 --out OUT --torque \
  '0.6*(step(t-0.1) - 2*step(t-0.2))' --json
simulate/modes+ = simulate config/l_shape.yaml --modes 6 --free motor --json
simulate/force = simulate config/elastic_arm.yaml --seconds 0.3 --dt 0.0005 --out OUT \
  --hold joint3 --torque 'joint2=4.6+1.5*sin(9*t)' --force 'z=2*step(t-0.1)' --plot

fit/rigid+ = fit {T1} {T2} --test {TEST} --arm {BLADES} --out OUT/model --jobs 1 --json
fit/text = fit {SHORT}
fit/folds = fit {T1}@0-30% {T2}@0-30% {TEST}@0-30% --arm {BLADES} --out OUT/model --jobs 1 --json
fit/elm = fit {SHORT} --models analytical elm --elm-hidden 30 --json
fit/ols = fit {SHORT} --estimator ols --friction viscous coulomb stribeck --filter causal --json
fit/huber = fit {SHORT} --estimator huber --friction viscous cube_root square offset \
  --filter zero_phase --cutoff 6 --rate 50 --json
fit/wls = fit {SHORT} --estimator wls --friction viscous coulomb presliding load \
  --currents shared --strain-form paper --filter causal --output-cutoff 20 --json
fit/friction = fit {SHORT} --friction auto --currents separate --strain-form exact --json
fit/stream+ = fit {SHORT} --stream --estimator ols --friction viscous coulomb --filter causal \
  --json
fit/stream_auto = fit {T1} {T2} {TEST} --arm {BLADES} --out OUT/model --jobs 1 --stream --json
fit/masses = fit record/empty/bags/stimulus_01 record/full/bags/stimulus_01 --arm {TUDOR} \
  --out OUT/model --jobs 1 --force --json
fit/payload_of = fit {T1}@0-50% {T2}@0-50% --payload-of {T1}=0.2 {T2}=0.4 \
  --arm {BLADES} --out OUT/model --jobs 1 --json --force
fit/ignored = fit record/empty/bags/stimulus_01 record/full/bags/stimulus_01 --arm {TUDOR} \
  --out OUT/model --jobs 1 --force --ignore-payload --json
fit/ringing = fit {UNDAMPED} --arm {TUDOR} --out OUT/model --jobs 1 --force
fit/elastic = fit {T1}@0-30% --test {TEST}@0-20% --arm {BLADES} --models elastic analytical \
  --out OUT/model --jobs 1 --json --force
fit/planned = fit record/planned/bags/stimulus_01 --plan excite/tudor/plan --arm {TUDOR} \
  --out OUT/model --jobs 1 --json --force

evaluate/json+ = evaluate {TEST} --model fit/rigid/model --save OUT/values.npz --json \
  --report OUT/page.html
evaluate/text = evaluate {TEST} {PUSHES} --model fit/rigid/model --arm {BLADES}
evaluate/causal = evaluate {TEST}@20-80% --model fit/rigid/model --causal --rate full --json \
  --save OUT/values.npz
evaluate/elm = evaluate {TEST} --model fit/elm/model --json --save OUT/values.npz
evaluate/elastic = evaluate {TEST}@50-100% --model fit/elastic/model --save OUT/values.npz --json
evaluate/payload = evaluate record/pushed/bags/stimulus_01 --model fit/masses/model --payload 0.1 \
  --json
evaluate/collisions+ = evaluate {PUSHES} --model fit/rigid/model --collisions --json
evaluate/roc = evaluate {PUSHES} {TEST} --model fit/rigid/model --collisions \
  --report OUT/pushes.html --false-alarms 5 --debounce 0.02
evaluate/free = evaluate {TEST} --model fit/rigid/model --collisions --free --json
evaluate/pushes = evaluate {PUSHES} --model fit/rigid/model --collisions --json \
  --pushes inputs/pushes.csv
evaluate/elastic_hits = evaluate {PUSHES}@0-50% --model fit/elastic/model --collisions \
  --kind elastic --json

compare/models = compare fit/rigid/model fit/ols/model {TEST} --json
compare/arm+ = compare {TUDOR} fit/ignored/model --json
compare/text = compare fit/rigid/model fit/huber/model

payload/json+ = payload record/pushed/bags/stimulus_01 --model fit/masses/model --json
payload/known = payload record/full/bags/stimulus_01 --model fit/masses/model --payload-of \
  record/full/bags/stimulus_01=0.3
payload/elastic = payload {PUSHES}@0-30% --model fit/elastic/model --kind elastic --json
payload/two = payload {T1} --model fit/payload_of/model --json

export/urdf+ = export fit/ignored/model --to urdf --out OUT/arm.urdf
export/mjcf = export fit/ignored/model --to mjcf --out OUT/arm.xml
export/yaml+ = export fit/rigid/model --to yaml --out OUT/drives.yaml
export/csv+ = export fit/rigid/model --to csv --out OUT/parameters.csv
export/arm = export fit/elastic/model --to arm --out OUT/arm.yaml
export/elastic = export fit/elastic/model --to mjcf --out OUT/arm.xml
export/stiff = export fit/elastic/model --to mjcf --rigid --out OUT/arm.xml

feedforward/csv+ = feedforward inputs/path.csv --model fit/rigid/model --out OUT/path.csv
feedforward/torque = feedforward inputs/path.csv --model fit/rigid/model --unit current --rate 50 \
  --friction-at-rest kept --out OUT/path.csv
feedforward/elastic = feedforward inputs/path.csv --model fit/elastic/model --kind elastic \
  --positions motor --rate 100 --out OUT/path.csv
feedforward/bag = feedforward excite/tudor/plan/bag --model fit/masses/model --payload 0.2 \
  --out OUT/plan

excite/tudor = excite {TUDOR} --floor 0 --out OUT/plan --steps 2 --seconds 10 --json
excite/model = excite {TUDOR} --floor 0 --out OUT/plan --steps 2 --seconds 10 \
  --model fit/ignored/model --seed 2

tune/description = tune {TUDOR} --payloads 0 0.3 --out OUT/schedule.yaml --json
tune/model = tune inputs/damped.yaml --model fit/elastic/model --payloads 0.2 \
  --out OUT/schedule.yaml --json

fleet/models = fleet inputs/fleet.yaml --out OUT/fleet --jobs 1 --json
fleet/text = fleet inputs/fleet.yaml --out OUT/fleet --jobs 1 --no-models

errors/none+ = {''}
errors/command+ = nonsense
errors/bag+ = info no_such_bag
errors/empty = info inputs/empty.mcap
errors/noise = info inputs/noise.mcap
errors/option = fit {T1} --estimator best --arm {BLADES} --out OUT/model
errors/arm+ = fit {T1} --arm no_such.yaml --out OUT/model
errors/yaml = fit {T1} --arm inputs/dh.txt --out OUT/model
errors/key = fit {T1} --arm inputs/unknown_key.yaml --out OUT/model
errors/draft = fit {T1} --arm inputs/draft.yaml --out OUT/model
errors/other_arm = fit {DAMPED} --arm config/emps.yaml --out OUT/model
errors/part = fit {T1}@80-20% --arm {BLADES} --out OUT/model
errors/stream = fit {T1} --arm {BLADES} --out OUT/model --stream
errors/exists = fit {T1} --arm {BLADES} --out fit/rigid/model
errors/model+ = evaluate {TEST} --model bags
errors/not_this_arm = evaluate {TEST} --model fit/rigid/model --arm {TUDOR}
errors/payload = evaluate {TEST} --model fit/rigid/model --payload 0.3
errors/limits = excite {BLADES} --out OUT/plan
errors/damper = tune config/emps.yaml --out OUT/schedule.yaml
errors/expression = simulate config/l_shape.yaml --torque 'open(1)' --out OUT
errors/links = simulate config/emps.yaml --modes 2
errors/fleet = fleet {BLADES} --out OUT
errors/masses = export fit/masses/model --to urdf --out OUT/arm.urdf
errors/format = export fit/rigid/model --to arm --out OUT/arm.yaml
errors/path = feedforward inputs/pushes.csv --model fit/rigid/model --out OUT/path.csv

objects/arms+ = ! arms config
objects/bags+ = ! bags {BLADES} {T1} {T2} {TEST} {PUSHES}
objects/tudor_bags = ! bags {TUDOR} {DAMPED} {UNDAMPED}
objects/library = ! library {BLADES} {T1}@0-40% {T2}@0-40% {TEST}
objects/plants = ! plants config/l_shape.yaml config/elastic_arm.yaml
objects/monitor+ = ! monitor fit/rigid/model {PUSHES} strain effort momentum
objects/monitor_elm = ! monitor fit/elm/model {TEST} strain kind=elm
objects/monitor_elastic = ! monitor fit/elastic/model {PUSHES} strain kind=elastic contact
objects/load = ! monitor fit/masses/model record/pushed/bags/stimulus_01 strain effort load contact
objects/feedforward = ! feedforward fit/rigid/model {TEST}
objects/rig+ = ! rig {TUDOR}
objects/node = ! nodes fit/rigid/model {PUSHES} monitor:estimate_contact=true
objects/nodes+ = ! nodes fit/rigid/model {PUSHES} joint_state_filter dynamics_predictor \
  collision_detector
objects/load_nodes = ! nodes fit/masses/model record/pushed/bags/stimulus_01 payload_estimator
objects/damper = ! nodes {TUDOR} {UNDAMPED} oscillation_damper
objects/references = ! nodes {TUDOR} {DAMPED} reference_generator:mode=aprbs
objects/ahead = ! nodes fit/ignored/model excite/tudor/plan/bag \
  feedforward:/joint_trajectory=/wanted_trajectory
objects/press = ! nodes {TUDOR} {DAMPED} force_controller
objects/interfaces = ! nodes none {DAMPED} monitor joint_state_filter dynamics_predictor monitors \
  collision_detector payload_estimator feedforward oscillation_damper force_controller \
  reference_generator arm_simulator bag_player bag_recorder
"""


@dataclasses.dataclass(frozen=True)
class Case:
    """A command: its arguments, other cases whose files it uses, whether it is a quick one."""

    name: str
    arguments: tuple[str, ...]
    needs: tuple[str, ...]
    quick: bool


def read_table(text: str = TABLE) -> dict[str, Case]:
    """Give the cases of a table in an order in which each follows those that it needs."""
    found: dict[str, Case] = {}
    for line in text.replace('\\\n', ' ').splitlines():
        if line.strip():
            name, _, command = line.partition(' = ')
            known = name.rstrip('+')
            words = tuple(word.replace('OUT', known) for word in shlex.split(command))
            found[known] = Case(known, words, (), name.endswith('+'))
    for case in found.values():
        needs = tuple(other for other in found if other != case.name and any(
            re.match(re.escape(other) + '/', word) for word in case.arguments))
        found[case.name] = dataclasses.replace(case, needs=needs)
    return {case.name: case for case in ordered(found, list(found))}


def ordered(table: dict[str, Case], names: list[str]) -> list[Case]:
    """Give cases with all that they need, each after what it needs."""
    done: dict[str, Case] = {}
    for name in names:
        if name not in done:
            for case in ordered(table, list(table[name].needs)):
                done.setdefault(case.name, case)
            done[name] = table[name]
    return list(done.values())


def write_inputs(folder: Path) -> None:
    """Write the small files that cases read."""
    folder.mkdir()
    t = np.arange(300) * 0.01
    path = np.column_stack([t, 0.3 + 0.4 * np.sin(2 * t), 0.2 * np.cos(3 * t) - 0.5])
    np.savetxt(folder / 'path.csv', path[::10], delimiter=',', fmt='%.17g', comments='',
               header='t,joint2,joint3')
    (folder / 'pushes.csv').write_text('begin,end\n5.0,5.5\n12,12.4\n')
    (folder / 'dh.txt').write_text('0 pi/2 0.3 0\n0.3928 0 0 0\n0.3928 0 0 0\n')
    (folder / 'empty.mcap').write_bytes(b'')
    (folder / 'noise.mcap').write_bytes(bytes(range(256)) * 8)
    (folder / 'unknown_key.yaml').write_text('name: a\nkinematics: {dh: [[1, 0, 0, 0]]}\n'
                                             'joints: [{name: j, colour: red}]\n')
    (folder / 'draft.yaml').write_text('name: a\nkinematics: {dh: [[1, 0, 0, 0]]}\n'
                                       "joints: [{name: j, effort: {topic: t, unit: '?'}}]\n")
    blades = (folder.parent / BLADES).read_text()
    gains = ''.join(f'  - {{joint: joint{n}, gauge: link{n}_hub, gain: 1000}}\n' for n in (2, 3))
    (folder / 'damped.yaml').write_text(
        f'{blades}\ndamper:\n  position_gain: 3.0\n  mean_frequency: 0.3\n'
        f'  velocity_bandwidth: 20.0\n  joints:\n{gains}')
    (folder / 'fleet.yaml').write_text(
        f'arm: ../{BLADES}\narms:\n- name: cell_1\n  bags: {{2026-01-10: ../{T1}, '
        f'2026-02-12: ../{TEST}}}\n- name: cell_2\n  bags: {{2026-01-11: ../{T2}}}\n'
        f'- name: cell_3\n  bags: {{2026-01-12: ../{PUSHES}}}\n')
