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

"""Energy of a mechanism, and the forward pass that it needs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.simulation.mechanics import layout as at
from tudor_dynamics.simulation.mechanics.chain import Chain, forward, rotation_at, vector_at
from tudor_dynamics.simulation.mechanics.equations import (
    along, hermite_mass, hermite_slope, hermite_stiffness, inner, node_values)
from tudor_dynamics.simulation.mechanics.mass import own_rigid, times_inertia, unit
from tudor_dynamics.simulation.mechanics.vector import add, dot, times, turn


@compiled
def energy(
    z: NDArray, dz: NDArray, gravity: NDArray, chain: Chain,
) -> tuple[float, float, float]:
    """Give kinetic, elastic and gravitational energy [J]: z, dz (n,), gravity (3,) [m/s^2]."""
    body_int, body_float, coordinate = chain.body_int, chain.body_float, chain.coordinate
    kinetic, elastic, weight = 0.0, 0.0, 0.0
    for i in range(z.shape[0]):
        kinetic += 0.5 * coordinate[i, at.HUB] * dz[i] * dz[i]
        elastic += 0.5 * coordinate[i, at.STIFFNESS] * z[i] * z[i]
    own = np.zeros(10)
    for b in range(body_int.shape[0]):
        ints, floats, here = body_int[b], body_float[b], chain.moving[b]
        world, origin = rotation_at(here, at.WORLD), vector_at(here, at.ORIGIN)
        v, w = vector_at(here, at.VELOCITY), vector_at(here, at.OMEGA)
        if ints[at.FLEXIBLE] == 0:
            own[:] = 0.0
            own_rigid(floats, own)
            push, moment = times_inertia(own, v, w)
            kinetic += 0.5 * (dot(v, push) + dot(w, moment))
            place = add(times(own[0], origin), turn(world, (own[1], own[2], own[3])))
            weight -= dot(vector_at(gravity, 0), place)
            continue
        first, length, density = ints[at.FIRST], floats[at.LENGTH], floats[at.DENSITY]
        polar = floats[at.POLAR] * length
        for e in range(ints[at.ELEMENTS]):
            u1, u2 = node_values(z, first, e), node_values(z, first, e + 1)
            v1, v2 = node_values(dz, first, e), node_values(dz, first, e + 1)
            x = along(e * length + u1[0], (e + 1) * length + u2[0], length)
            y = (u1[1], u1[5], u2[1], u2[5])
            s = (u1[2], -u1[4], u2[2], -u2[4])
            dx, dy = along(v1[0], v2[0], length), (v1[1], v1[5], v2[1], v2[5])
            ds = (v1[2], -v1[4], v2[2], -v2[4])
            one = (1.0, 0.0, 1.0, 0.0)
            total = (0.0, 0.0, 0.0)
            for axis in range(3):
                if axis == 0:
                    a0, row, own_rate, field = v[0], (0.0, -w[2], w[1]), dx, x
                elif axis == 1:
                    a0, row, own_rate, field = v[1], (w[2], 0.0, -w[0]), dy, y
                else:
                    a0, row, own_rate, field = v[2], (-w[1], w[0], 0.0), ds, s
                p = (a0 * one[0] + row[0] * x[0] + row[1] * y[0] + row[2] * s[0] + own_rate[0],
                     row[0] * x[1] + row[1] * y[1] + row[2] * s[1] + own_rate[1],
                     a0 + row[0] * x[2] + row[1] * y[2] + row[2] * s[2] + own_rate[2],
                     row[0] * x[3] + row[1] * y[3] + row[2] * s[3] + own_rate[3])
                kinetic += 0.5 * inner(p, hermite_mass(p, length, density))
                h = hermite_mass(field, length, density)
                total = add(total, times(h[0] + h[2], unit(axis)))
            t1, t2 = w[0] + v1[3], w[0] + v2[3]
            kinetic += polar * (t1 * t1 + t1 * t2 + t2 * t2) / 6.0
            stretch = u2[0] - u1[0] + floats[at.STRETCH] * 0.5 * (
                inner(y, hermite_slope(y, length)) + inner(s, hermite_slope(s, length)))
            elastic += 0.5 * (
                floats[at.EA] / length * stretch**2
                + floats[at.GJ] / length * (u2[3] - u1[3]) ** 2
                + inner(y, hermite_stiffness(y, length, floats[at.EIZ]))
                + inner(s, hermite_stiffness(s, length, floats[at.EIY])))
            place = add(times(density * length, origin), turn(world, total))
            weight -= dot(vector_at(gravity, 0), place)
    return kinetic, elastic, weight


@compiled
def refresh(z: NDArray, dz: NDArray, ddz: NDArray, chain: Chain) -> None:
    """Run the forward pass alone, see ``chain.forward``."""
    forward(z, dz, ddz, chain, 0.0)
