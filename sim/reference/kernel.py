"""The sum over lamps as one of Dr.Jit's recorded loops. Imported only where LLVM works.

Dr.Jit reads the function's text and turns its `while` into a loop of the machine, so it is at
the top of a module and takes its names from there.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from sim.reference.lobes import INDEX, MIN_COSINE, SHORT, TABLE


@dr.syntax
def sum_over_lamps(
    scene: Any,
    facets: Any,
    table: Any,
    rows: Any,
    position: Any,
    start: Any,
    normal: Any,
    view: Any,
    lamps: Any,
    names: Any,
    axes: Any,
    across: Any,
    radius: Any,
    exponent: Any,
    weights: Any,
    count: Any,
    columns: int,
    seed: Any,
) -> list[Any]:
    """Light from all lamps at n points.

    Args:
        scene: that casts shadows.
        facets: Mitsuba's distribution of facets, each point's own roughness.
        table: (r * TABLE,) the interface's T, a row of cosines for each roughness.
        rows: (n,) place between the table's rows.
        position, start, normal, view: (n, 3) as `sim.reference.points.Points` has them.
        lamps: (m, 3) mm.
        names: (m,) each lamp's number.
        axes: (m, 3) in which lamps shine most.
        across: two (m, 3), at right angles to it.
        radius: mm, of a lamp.
        exponent: of its cosine.
        weights: (m * columns,) intensities, columns of one lamp together.
        count: m.
        columns: of the weights.
        seed: of places on lamps.

    Returns:
        `columns` sums (n,) of the light that enters, then as many of what is mirrored to the view.
    """
    size = dr.width(position)
    frame = mi.Frame3f(normal)
    out = frame.to_local(view)
    out.z = dr.maximum(out.z, MIN_COSINE)
    out = dr.normalize(out)
    row = mi.UInt32(rows)
    down = rows - mi.Float(row)
    which = dr.arange(mi.UInt32, size)
    sums = [mi.Float(0.0) for _ in range(2 * columns)]
    k = mi.UInt32(0)
    while k < count:
        # The place on a lamp is drawn for the point and the lamp, whatever others shine.
        one, other = mi.sample_tea_32(which, dr.gather(mi.UInt32, names, k) + seed, 4)
        spot = mi.warp.square_to_uniform_disk_concentric(
            mi.Point2f(mi.Float(one >> 8), mi.Float(other >> 8)) * 2.0**-24
        )
        place = dr.gather(mi.Point3f, lamps, k) + radius * (
            spot.x * dr.gather(mi.Vector3f, across[0], k)
            + spot.y * dr.gather(mi.Vector3f, across[1], k)
        )
        toward = place - position
        distance2 = dr.squared_norm(toward)
        toward = toward * dr.rsqrt(distance2)
        facing = dr.maximum(-dr.dot(toward, dr.gather(mi.Vector3f, axes, k)), 0.0)
        light = frame.to_local(toward)
        lit = (light.z > 0) & (facing > 0)
        path = place - start
        far = dr.norm(path)
        ray = mi.Ray3f(start, path / far, far * SHORT, 0.0, [])
        lit &= ~scene.ray_test(ray, lit)
        arrives = dr.select(lit, dr.power(facing, exponent) / distance2, 0.0)
        cosine = dr.minimum(light.z, 1.0) * (TABLE - 1)
        column = dr.minimum(mi.UInt32(cosine), TABLE - 2)
        right = cosine - mi.Float(column)
        corner = row * TABLE + column
        upper = dr.lerp(
            dr.gather(mi.Float, table, corner), dr.gather(mi.Float, table, corner + 1), right
        )
        corner += TABLE
        lower = dr.lerp(
            dr.gather(mi.Float, table, corner), dr.gather(mi.Float, table, corner + 1), right
        )
        enters = dr.lerp(upper, lower, down) * light.z * arrives
        half = dr.normalize(light + out)
        mirror = facets.eval(half) * facets.G(out, light, half)
        mirror *= mi.fresnel(dr.dot(out, half), INDEX)[0] / (4.0 * out.z)
        mirror = dr.select(lit, mirror * arrives, 0.0)
        for state in range(columns):
            weight = dr.gather(mi.Float, weights, k * columns + state)
            sums[state] += weight * enters
            sums[columns + state] += weight * mirror
        k += 1
    return sums
