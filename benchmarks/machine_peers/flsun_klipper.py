"""A delta printer by the formulas of Klipper's DELTA_CALIBRATE, written down again; argument: readings.

Its cost is the sum of squares of heights, which weigh (distances / heights / 0.5) as much, and of distances. Its search
moves one parameter at a time, by a step that grows by a tenth where that helps and shrinks by a tenth where neither way
does. It starts where the firmware's file stood. A user writes none of this, but the commands in COMMANDS.
"""

import json
import math
import sys

import numpy as np

COMMANDS = """
DELTA_CALIBRATE
SAVE_CONFIG
DELTA_ANALYZE SCALE=1
DELTA_ANALYZE CENTER_DISTS=...
DELTA_ANALYZE CENTER_PILLAR_WIDTHS=...
DELTA_ANALYZE OUTER_DISTS=...
DELTA_ANALYZE OUTER_PILLAR_WIDTHS=...
DELTA_ANALYZE CALIBRATE=extended
SAVE_CONFIG
"""
DISTANCE_WEIGHT = 0.5


def locate(x, steps):
    """Return the nozzle: where three spheres of the arms' lengths about the carriages meet, below them."""
    radius, first, second, *rest = x
    arms, ends = rest[3:], rest[:3]
    towers = [
        (radius * math.cos(a), radius * math.sin(a)) for a in (math.radians(first), math.radians(second), 0.5 * math.pi)
    ]
    high = [e + math.sqrt(a * a - radius * radius) - s for e, a, s in zip(ends, arms, steps, strict=True)]
    # differences of two spheres are planes: x and y are linear in z
    (x1, y1), z1, a1 = towers[0], high[0], arms[0]
    rows = []
    for (xk, yk), zk, ak in zip(towers[1:], high[1:], arms[1:], strict=True):
        square = xk * xk + yk * yk + zk * zk - x1 * x1 - y1 * y1 - z1 * z1
        rows.append((2.0 * (xk - x1), 2.0 * (yk - y1), a1 * a1 - ak * ak + square, -2.0 * (zk - z1)))
    (a, b, c, d), (e, f, g, h) = rows
    det = a * f - b * e
    x0, xz, y0, yz = (c * f - b * g) / det, (d * f - b * h) / det, (a * g - c * e) / det, (a * h - d * e) / det
    # on the first sphere
    p, q, r = (
        1.0 + xz * xz + yz * yz,
        (x0 - x1) * xz + (y0 - y1) * yz - z1,
        (x0 - x1) ** 2 + (y0 - y1) ** 2 + z1 * z1 - a1 * a1,
    )
    z = (-q - math.sqrt(q * q - p * r)) / p
    return x0 + xz * z, y0 + yz * z, z


def descend(cost, x, tolerance=1e-5, n_rounds=10_000):
    """Return the parameters where single steps help no more, and the rounds."""
    x, step, least, rounds = list(x), [1.0] * len(x), cost(x), 0
    while sum(step) > tolerance and rounds < n_rounds:
        rounds += 1
        for i, here in enumerate(tuple(x)):
            for there in (here + step[i], here - step[i]):
                x[i] = there
                found = cost(x)
                if found < least:
                    least, step[i] = found, 1.1 * step[i]
                    break
            else:
                x[i], step[i] = here, 0.9 * step[i]
    return x, rounds


if __name__ == "__main__":
    table = np.genfromtxt(sys.argv[1], delimiter=",")[1:, 1:]
    heights = [(r[6 + k], r[3 * k : 3 * k + 3]) for r in table.tolist() for k in (0, 1) if not math.isnan(r[6 + k])]
    distances = [(r[8], r[:3], r[3:6]) for r in table.tolist() if not math.isnan(r[8])]
    weight = len(distances) / (DISTANCE_WEIGHT * len(heights))

    def cost(x):
        """Return the weighted sum of squares."""
        above = sum((locate(x, steps)[2] - height) ** 2 for height, steps in heights)
        return weight * above + sum((math.dist(locate(x, a), locate(x, b)) - far) ** 2 for far, a, b in distances)

    found, rounds = descend(cost, [160.0, 210.0, 330.0, 415.0, 415.0, 415.0, 345.0, 345.0, 345.0])
    print(json.dumps({"found": found, "rounds": rounds}))
