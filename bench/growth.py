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
How cost grows with samples, joints, bags and arms: measured, and drawn.

Samples and joints: regressor, base parameters and weighted least squares, as
`bench/identify_seven_joints.py` does them. Bags: `tudor fit --stream` on bags of 20 s in one
process, as `bench/many_bags.py`. Arms: monitors at 100 Hz, as `bench/many_arms.py`.

What was measured is kept in a file of figures, so that parts may be measured one by one; the
picture has all that are in it.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
import json
from pathlib import Path
from statistics import median
import sys
from typing import Any

from identify_seven_joints import alone
from many_arms import LAYOUTS, measure
from many_bags import ARM, make, timed
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from tables import show

from tudor_dynamics import load_arm

SAMPLES = (1_000, 3_000, 10_000, 30_000, 100_000)
JOINTS = (1, 2, 3, 5, 7, 10, 14)
PER_JOINTS = 20_000
"""Samples of an arm of each number of joints."""
BAGS = (2, 8, 32, 128)
BAG_SECONDS = 20.0
ARMS = {'one process': (1, 2, 4, 8, 16), 'one each': (1, 2, 4, 8)}
ARM_RATE, ARM_SECONDS = 100.0, 6.0
REPEATS = 3

Rows = list[dict[str, Any]]


def samples(folder: Path, model: str) -> Rows:
    """Time and memory of an identification, by the number of samples."""
    return [{'samples': n, **identified(n, 7)} for n in SAMPLES]


def joints(folder: Path, model: str) -> Rows:
    """Time and memory of an identification, by the number of joints."""
    return [{'joints': n, **identified(PER_JOINTS, n)} for n in JOINTS]


def identified(n: int, count: int) -> dict[str, float]:
    """Give medians of time [s] and memory above the beginning [MiB]."""
    runs = [alone('this package', n, count) for _ in range(REPEATS)]
    return {key: median(run[key] for run in runs) for key in ('seconds', 'mib')}


def bags(folder: Path, model: str) -> Rows:
    """Time and memory of a fit, by the number of bags."""
    found: Rows = []
    for count in BAGS:
        made, out = folder / f'bags_{count}', folder / f'model_{count}'
        make(load_arm(ARM), made, count, BAG_SECONDS, 1)
        run = timed([sys.executable, '-m', 'tudor_dynamics', 'fit', str(made), '--stream',
                     '--arm', ARM, '--jobs', '1', '--out', str(out), '--overwrite', '--exit-zero'])
        if run.code:
            msg = f'the fit of {count} bags ended with exit code {run.code}'
            raise RuntimeError(msg)
        found.append({'bags': count, 'cpu': run.cpu,
                      'mib': max(peak for peak, _ in run.peaks.values())})
    return found


def arms(folder: Path, model: str) -> Rows:
    """CPU and memory of monitors, by the number of arms, in one process and one each."""
    found: Rows = []
    for layout in LAYOUTS:
        for count in ARMS[layout]:
            cost = measure(layout, count, model, ARM_RATE, ARM_SECONDS)
            found.append({
                'arms': count, 'layout': layout, 'cores': cost.cpu * ARM_RATE * count,
                'mb': cost.memory, 'lost': cost.lost, 'p99': cost.p99, 'others': cost.others})
    return found


PARTS: dict[str, Callable[[Path, str], Rows]] = {
    'samples': samples, 'joints': joints, 'bags': bags, 'arms': arms}
OF = {'samples': 'samples of seven joints', 'joints': f'joints, {PER_JOINTS} samples',
      'bags': f'bags of {BAG_SECONDS:g} s', 'arms': 'arms'}


def curve(axes: Axes, rows: Rows, x: str, y: str, style: str, label: str) -> None:
    """Draw one column over another."""
    axes.loglog([row[x] for row in rows], [row[y] for row in rows], style, color='k',
                markersize=5, markerfacecolor='w', label=label)


def slope(axes: Axes, rows: Rows, x: str, y: str, power: int) -> None:
    """Draw what grows as a power, through the last point."""
    last = rows[-1]
    axes.loglog([row[x] for row in rows],
                [last[y] * (row[x] / last[x]) ** power for row in rows], ':', color='0.5',
                linewidth=1.0 if power == 1 else 2.0,
                label='in proportion' if power == 1 else f'power {power}')


def draw(found: dict[str, Rows], path: Path) -> None:
    """Draw a panel for each part."""
    figure = Figure(figsize=(11.0, 7.0), layout='constrained')
    panels = dict(zip(PARTS, figure.subplots(2, 2).flat, strict=True))
    titles = {'samples': 'identification, seven joints',
              'joints': f'identification, {PER_JOINTS} samples',
              'bags': f'tudor fit, bags of {BAG_SECONDS:g} s, one process',
              'arms': f'monitors at {ARM_RATE:g} Hz'}
    for name, rows in found.items():
        axes = panels[name]
        groups = [(layout, [row for row in rows if row.get('layout') == layout])
                  for layout in (LAYOUTS if name == 'arms' else (None,))]
        time, unit = {'bags': ('cpu', 'CPU time [s]'), 'arms': ('cores', 'CPU [cores]')}.get(
            name, ('seconds', 'time [s]'))
        memory = {'bags': ('mib', 'MiB'), 'arms': ('mb', 'MB')}.get(name)
        for number, (layout, part) in enumerate(groups):
            of = f', {layout}' if layout else ''
            curve(axes, part, name, time, ('o-', '^-')[number], unit.split(' [')[0] + of)
        slope(axes, groups[0][1], name, time, 1)
        if name == 'joints':
            slope(axes, rows, name, time, 3)
        lines = list(axes.get_lines())
        values = [row[time] for row in rows]
        axes.set_ylim(0.3 * min(values), 30.0 * max(values))  # room for the legend
        if memory is not None:
            second = axes.twinx()
            for number, (layout, part) in enumerate(groups):
                of = f', {layout}' if layout else ''
                curve(second, part, name, memory[0], ('s--', 'D--')[number], f'memory{of}')
            second.set(ylabel=f'memory [{memory[1]}]', ylim=(10.0, 1e5))
            lines += second.get_lines()
        axes.set(xlabel=name, title=titles[name], ylabel=unit)
        counts = sorted({row[name] for row in rows})
        axes.set_xticks(counts, [f'{count:g}' for count in counts])
        axes.minorticks_off()
        axes.grid(alpha=0.3)
        axes.legend(lines, [str(line.get_label()) for line in lines], frameon=False, fontsize=8,
                    loc='upper left')
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    print(f'{path} drawn')


def main(args: Sequence[str] | None = None) -> int:
    """Measure, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--parts', nargs='*', choices=PARTS, default=list(PARTS))
    parser.add_argument('--model', default='model', help='bundle with strain, for the monitors')
    parser.add_argument('--folder', type=Path, default=Path('out/growth'))
    parser.add_argument('--out', type=Path, default=Path('out/growth.png'))
    asked = parser.parse_args(args)
    sys.setswitchinterval(1e-4)  # who listens to monitors must not wait for who sends
    asked.folder.mkdir(parents=True, exist_ok=True)
    kept = asked.folder / 'figures.json'
    found: dict[str, Rows] = json.loads(kept.read_text()) if kept.exists() else {}
    for name in asked.parts:
        found[name] = PARTS[name](asked.folder, asked.model)
        kept.write_text(json.dumps(found, indent=2) + '\n')
    parts = [(name, [row for row in rows if row.get('layout') == layout]) for name, rows in
             found.items() for layout in dict.fromkeys(row.get('layout') for row in rows)]
    some = [(name, part[at]) for name, part in parts for at in (0, len(part) // 2, -1)]
    show(('of', 'number', 'CPU time', 'memory'), (
        (f'{OF[name]}, {row["layout"]}' if 'layout' in row else OF[name], row[name],
         f'{row["cores"]:.1%} of a core' if 'cores' in row else
         f'{row.get("cpu", row.get("seconds")):.2g} s',
         f'{row["mb"]:.0f} MB' if 'mb' in row else
         f'{row["mib"]:.0f} MiB' + ('' if name == 'bags' else ' beyond the data'))
        for name, row in some))
    draw(found, asked.out)
    return 0


if __name__ == '__main__':
    sys.exit(main())
