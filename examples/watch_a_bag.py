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


"""Replay a bag past the live monitor, sample by sample, without ROS: watch_a_bag.png."""

from pathlib import Path
import sys

from matplotlib.figure import Figure
import numpy as np

import tudor_dynamics as td

ROOT = Path(__file__).resolve().parents[1]


def main(out: Path) -> None:
    """Compare residuals with the thresholds that the fit has learned."""
    bags = ROOT / 'bags'
    arm = td.load_arm(ROOT / 'config' / 'two_blade_arm.yaml')
    models = td.fit([bags / 'two_blade_train_1', bags / 'two_blade_train_2'], arm,
                    settings=td.FitSettings(kinds=('analytical',)))
    recording = td.read_recording(bags / 'two_blade_test', arm)
    assert recording.strain is not None  # others may have efforts alone
    monitor = td.Monitor(models, td.MonitorSettings(methods=('strain',)))
    stamps, residuals, thresholds, events = [], [], [], []
    for stamp, q, strain in zip(recording.stamp.tolist(), recording.q, recording.strain):
        for found in (monitor.add_joints(stamp, q),
                      monitor.add_measured('strain', stamp, strain)):
            events += found.events
            for _, excess in found.excesses:
                stamps.append(excess.residual.motion.stamp)
                residuals.append(excess.residual.value)
                thresholds.append(excess.threshold)
    print(f'{len(stamps)} samples judged, {len(events)} collisions')
    t = (np.array(stamps) - recording.stamp[0]) * 1e-9
    figure = Figure(figsize=(8.0, 4.6), layout='constrained')
    for axes, name, value, bound in zip(
            figure.subplots(len(arm.gauge_names), sharex=True), arm.gauge_names,
            np.array(residuals).T, np.array(thresholds).T):
        axes.plot(t, value, linewidth=0.8, label='residual')
        for side, label in ((bound, 'threshold'), (-bound, None)):
            axes.plot(t, side, '--', color='#c8502d', linewidth=0.8, label=label)
        axes.set(ylabel=f'{name} [um/m]')
    axes.set(xlabel='time [s]')
    figure.legend(*axes.get_legend_handles_labels(), loc='outside upper right', frameon=False,
                  ncols=2)
    figure.savefig(out / 'watch_a_bag.png', dpi=110)


if __name__ == '__main__':
    main(Path(sys.argv[1] if len(sys.argv) > 1 else '.'))
