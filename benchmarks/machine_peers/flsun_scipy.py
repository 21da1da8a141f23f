"""A delta printer by SciPy's least squares: Klipper's cost, with a covariance by the Jacobian; argument: readings."""

import json
import sys

import numpy as np
from scipy.optimize import least_squares

table = np.genfromtxt(sys.argv[1], delimiter=",")[1:, 1:]
steps, heights, distance = np.concatenate([table[:, :3], table[:, 3:6]]), table[:, 6:8].T.ravel(), table[:, 8]
steps = np.where(np.isnan(steps), 400.0, steps)
probed, apart = np.isfinite(heights), np.isfinite(distance)
weight = np.sqrt(2.0 * apart.sum() / probed.sum())


def locate(x, steps):
    """Return nozzles (P, 3): both solutions of three spheres lie on a line; the lower one."""
    radius, angles, ends, arms = x[0], np.radians([x[1], x[2], 90.0]), x[3:6], x[6:]
    high = ends + np.sqrt(arms**2 - radius**2) - steps
    flat = np.broadcast_to(radius * np.transpose([np.cos(angles), np.sin(angles)]), (*high.shape, 2))
    centres = np.concatenate([flat, high[..., None]], axis=-1)
    square = (centres**2).sum(axis=-1) - arms**2
    planes, right = centres[:, 1:] - centres[:, :1], 0.5 * (square[:, 1:] - square[:, :1])
    along = np.cross(planes[:, 0], planes[:, 1])
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    on = np.linalg.solve(
        np.concatenate([planes, along[:, None]], axis=1),
        np.concatenate([right, (along * centres[:, 0]).sum(axis=-1, keepdims=True)], axis=1)[..., None],
    )[..., 0]
    left = np.sqrt(arms[0] ** 2 - ((on - centres[:, 0]) ** 2).sum(axis=-1, keepdims=True))
    return on - np.sign(along[:, 2:]) * left * along


def residuals(x):
    """Return heights, weighted, and distances off."""
    a, b = np.split(locate(x, steps), 2)
    off = np.concatenate([a, b])[probed, 2] - heights[probed]
    return np.concatenate([weight * off, np.linalg.norm(a - b, axis=1)[apart] - distance[apart]])


fit = least_squares(residuals, [160.0, 210.0, 330.0, *3 * [415.0], *3 * [345.0]], x_scale="jac")
covariance = np.linalg.inv(fit.jac.T @ fit.jac) * 2.0 * fit.cost / (len(fit.fun) - len(fit.x))
print(json.dumps({"found": fit.x.tolist(), "standard_deviations": np.sqrt(np.diag(covariance)).tolist()}))
