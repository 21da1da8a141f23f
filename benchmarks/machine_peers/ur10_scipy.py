"""A UR10 by SciPy's least squares: joints and tracker positions in, those of other rows out.

Arguments: rows, other rows, model. `links`: six errors of each joint's frame but the first, the tracker's frame, the
target. `sines`: joints err by sines of their angle, too. `weighted ...`: a second fit weighs rows by what the joints'
noise does at the target.
"""

import json
import sys

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

(q, seen), (q_held, _) = (
    (t[:, :6], t[:, 6:]) for t in (np.genfromtxt(n, delimiter=",")[1:, 2:] for n in sys.argv[1:3])
)
A = [0.0, -612.0, -572.3, 0.0, 0.0, 0.0]
D = [127.3, 0.0, 0.0, 163.941, 115.7, 92.2]
ALPHA = np.radians([90.0, 0.0, 0.0, 90.0, -90.0, 0.0])
N_LINKS, N_SINES = 5 * 6, 24 if "sines" in sys.argv[3] else 0
JOINT, TRACKER, STEP = np.radians(0.01), 0.02, 1e-6


def move(position, turn, along, about):
    """Return a frame, position and rotation, moved within itself."""
    return position + turn.apply(along), turn * about


def tip(links, sines, q):
    """Return the flange, positions (P, 3) and rotations, for errors of frames and of joints."""
    if len(sines):
        s1, c1, s2, c2 = sines.reshape(4, 6)
        q = q + s1 * np.sin(q) + c1 * np.cos(q) + s2 * np.sin(2.0 * q) + c2 * np.cos(2.0 * q)
    errors = np.vstack([np.zeros(6), links.reshape(5, 6)])
    position, turn = np.zeros((len(q), 3)), Rotation.identity(len(q))
    for k in range(6):
        position, turn = move(position, turn, errors[k, :3], Rotation.from_rotvec(1e-3 * errors[k, 3:]))
        position, turn = move(position, turn, np.zeros(3), Rotation.from_rotvec(q[:, k, None] * [0.0, 0.0, 1.0]))
        position, turn = move(position, turn, [A[k], 0.0, D[k]], Rotation.from_rotvec([ALPHA[k], 0.0, 0.0]))
    return position, turn


def predict(x, q):
    """Return where the tracker sees the target, (P, 3)."""
    links, sines = x[9 : 9 + N_LINKS], 1e-3 * x[9 + N_LINKS :]
    position, turn = tip(links, sines, q)
    return Rotation.from_rotvec(x[3:6]).apply(position + turn.apply(x[6:9])) + x[:3]


position, _ = tip(np.zeros(N_LINKS), [], q)
turn, _ = Rotation.align_vectors(seen - seen.mean(axis=0), position - position.mean(axis=0))
start = np.zeros(9 + N_LINKS + N_SINES)
start[:3], start[3:6] = seen.mean(axis=0) - turn.apply(position.mean(axis=0)), turn.as_rotvec()
fit = least_squares(lambda x: (predict(x, q) - seen).ravel(), start)
if "weighted" in sys.argv[3]:
    slopes = [predict(fit.x, q + one) - predict(fit.x, q - one) for one in STEP * np.eye(6)]
    slope = np.stack(slopes, axis=-1) * JOINT / (2.0 * STEP)
    root = np.linalg.inv(np.linalg.cholesky(slope @ slope.transpose(0, 2, 1) + TRACKER**2 * np.eye(3)))
    fit = least_squares(lambda x: (root @ (predict(x, q) - seen)[..., None]).ravel(), fit.x)
print(
    json.dumps({"predicted": predict(fit.x, q_held).tolist(), "parameters": len(start), "converged": bool(fit.success)})
)
