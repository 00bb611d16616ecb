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

"""Force control: steps of the force on floors from soft to hard, with the same gains."""

from __future__ import annotations

from typing import Any

from matplotlib.figure import Figure
import numpy as np
from papers import look
from papers.campaign import arm_content, Cached
from papers.look import Picture
from papers.outlook import Floor, Section, Setting
import tudor_dynamics as td
from tudor_dynamics.control.force_control import ForceController, ForceSettings, Phase
from tudor_dynamics.control.motion_controller import MotionController
from tudor_dynamics.mechanics import hardware
from tudor_dynamics.mechanics.closed_loop import Sample
from tudor_dynamics.online.contact_fronts import StaticStrain

RATE = 500.0
"""Of sensors and commands [Hz]."""
GAP = 0.015
"""Below the tip, where the floor is put [m]."""
STIFFNESS = (100.0, 500.0, 2000.0, 20000.0)
"""Of the floors [N/m]."""
SEEDS = 3
FIRST, SECOND = 2.0, 4.0
"""Forces before and after the step [N]."""
BAND = 0.05
"""Part of the step within which the force has settled."""
SECONDS = 3.0


class ForceRig(td.Loop):
    """The arm on a floor [N/m], its damper and the force controller, as the nodes hold them."""

    def __init__(
        self, arm: td.Arm, stiffness: float, seed: int = 0,
        settings: ForceSettings = ForceSettings(),  # noqa: B008 (frozen)
    ) -> None:
        super().__init__(arm, self._follow, rate=RATE, seed=seed)
        self._damper = MotionController(arm)
        self.controller = ForceController(arm, settings)
        self.static = StaticStrain(arm)
        self._stiffness = stiffness

    @property
    def force(self) -> np.ndarray:
        """Force of the floor at each sample so far [N]."""
        return self.trace.array('force')[:, 2]

    def _follow(self, sample: Sample) -> np.ndarray | None:
        step = 1.0 / RATE if sample.t > 0.0 else 0.0
        pose = sample.q if self.controller.pose is None else self.controller.pose
        weight, share = self.static.at(pose, self.controller.force)
        q, dq = self.controller.step(step, sample.q, sample.strain - weight, share)
        self._damper.reference.add(sample.t, q, dq)
        return self._damper.step(sample.t, step, sample.q, sample.strain,
                                 np.ones(len(sample.strain), dtype=bool))

    def approach(self, wanted: float) -> None:
        """Come to rest, put the floor below the tip, and press with a force [N] until held."""
        self.run(1.0)
        self.process.floor = hardware.Floor(float(self.process.tip()[2]) - GAP, self._stiffness)
        self.controller.press(wanted)
        self.run(3.0)


def section(setting: Setting) -> Section:
    """Compute the section."""
    campaign = setting.campaign
    floors = (500.0, 20000.0) if setting.quick else STIFFNESS
    seeds = 1 if setting.quick else SEEDS
    depends: dict[str, Any] = {'arm': arm_content(campaign.arm), 'floors': floors, 'seeds': seeds,
                               'seed': campaign.plan.seed}
    found = campaign.stages.result('force_steps', depends,
                                   lambda: _steps(setting, floors, seeds))
    rows = found.content['steps']
    soft = [row for row in rows if row['stiffness'] == 500.0]
    hard = [row for row in rows if row['stiffness'] == 20000.0]
    settled, over = (max(row[name] for row in soft) for name in ('settled', 'overshoot'))
    kept = min(row['least'] for row in soft)
    calm = max(row['ripple'] for row in hard)
    return Section(
        ('The tip presses on an elastic floor whose height and stiffness nobody knows. The '
         'force comes from all gauges together, less what the weight of the arm does there; the '
         'tip moves by what is missing. Arm and floor are springs in series, so the same gains '
         'hold on all floors.',),
        (Floor('step of 2 N on 500 N/m: settled to 5 %', 'within 1 s', f'{settled:.2f} s',
               settled <= 1.0),
         Floor('the same: overshoot', 'below 20 %', f'{100.0 * over:.0f} %', over < 0.2),
         Floor('the same: least force after the step', 'contact is kept', f'{kept:.2f} N',
               kept > 0.0),
         Floor('same gains on 20 000 N/m: ripple of the held force', 'stable',
               f'{calm:.3f} N', calm < 0.1 and all(row['held'] for row in hard))),
        (Picture('force_steps', 'Force control', 'Steps of the force',
                 'From 2 to 4 N at 0 s on floors of four stiffnesses, every imperfection on, one '
                 'seed of each.', lambda: _draw(found)),), {'steps': rows})


def _steps(setting: Setting, floors: tuple[float, ...], seeds: int) -> Cached:
    rows, traces = [], {}
    total = len(floors) * seeds
    for number, stiffness in enumerate(floors):
        for seed in range(seeds):
            setting.progress(f'{stiffness:g} N/m', (number * seeds + seed) / total)
            rig = ForceRig(setting.campaign.arm, stiffness, setting.campaign.plan.seed + seed)
            rig.approach(FIRST)
            rig.controller.press(SECOND)
            rig.run(SECONDS)
            force = rig.force[-round(SECONDS * RATE):]
            rows.append({'stiffness': stiffness, 'seed': seed,
                         'held': rig.controller.phase is Phase.HOLD, **judge(force)})
            if seed == 0:
                traces[f'{stiffness:g}'] = rig.force[-round((SECONDS + 0.5) * RATE):]
    return Cached({'steps': rows}, traces)


def judge(force: np.ndarray) -> dict[str, float]:
    """Judge a step."""
    step = SECOND - FIRST
    window = round(0.02 * RATE)
    smooth = np.convolve(force, np.full(window, 1.0 / window), 'valid')
    outside = np.flatnonzero(np.abs(smooth - SECOND) > BAND * step)
    return {'settled': 0.0 if not len(outside) else float((outside[-1] + window) / RATE),
            'overshoot': float((force.max() - SECOND) / step), 'least': float(force.min()),
            'end': float(force[-round(RATE):].mean()),
            'ripple': float(force[-round(RATE):].std())}


def _draw(found: Cached) -> Figure:
    figure, axes = look.new_figure(3.0, 1)
    for (name, force), style in zip(found.arrays.items(), look.CURVES, strict=False):
        t = np.arange(len(force)) / RATE - 0.5
        axes[0, 0].plot(t, force, label=f'{name} N/m', linewidth=1.1, **style)
    axes[0, 0].axhspan(SECOND - BAND * (SECOND - FIRST), SECOND + BAND * (SECOND - FIRST),
                       color='#dddddd', zorder=0)
    axes[0, 0].set_xlabel('time since the step [s]')
    axes[0, 0].set_ylabel('force on the tip [N]')
    look.legend_above(figure, axes[0, 0])
    return figure
