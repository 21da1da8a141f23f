# /// script
# requires-python = ">=3.12,<3.13"
# dependencies = ["robotkinecal==0.1.0", "setuptools<81"]
# ///
"""A UR10 by robotkinecal: joints and tracker positions in, positions of other rows out.

Arguments: rows, other rows, URDF.
"""

import json
import sys
from pathlib import Path

import numpy as np
import roboticstoolbox as rtb
from robotkinecal import SerialRobotKineCal

tables = [np.genfromtxt(name, delimiter=",")[1:, 2:] for name in sys.argv[1:3]]
(q, seen), (q_held, _) = ((table[:, :6], 1e-3 * table[:, 6:]) for table in tables)

np.random.seed(1)  # noqa: NPY002 - its bases of the screws are random
calibration = SerialRobotKineCal(rtb.ERobot.URDF(str(Path(sys.argv[3]).resolve())), ee_name="tool")

# it takes positions in the robot's base: tracker and target are registered first, by the arm as drawn
poses = [calibration.forward_kinematics(7, one) for one in q]
rotation, target = np.eye(3), np.zeros(3)
for _ in range(50):
    points = np.array([pose.R @ target + pose.t for pose in poses])
    u, _, v = np.linalg.svd((seen - seen.mean(0)).T @ (points - points.mean(0)))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    rows = [np.hstack([rotation @ pose.R, np.eye(3)]) for pose in poses]
    off = np.concatenate([one - rotation @ pose.t for one, pose in zip(seen, poses, strict=True)])
    target, origin = np.linalg.lstsq(np.concatenate(rows), off, rcond=None)[0].reshape(2, 3)

calibration.zero_conf_EE_pose.t += calibration.zero_conf_EE_pose.R @ target
calibration.set_observations(q, [rotation.T @ (one - origin) for one in seen])
result = calibration.solve()
found = np.array([calibration.forward_kinematics(7, one).t for one in q_held]) @ rotation.T + origin
statistics = result.iteration_results[-1].get_statistics()
print(
    json.dumps(
        {
            "predicted": (1e3 * found).tolist(),
            "iterations": result.nb_iterations_executed,
            "converged": bool(result.has_converged),
            "joints_uncertainty": statistics["joints_uncertainty"].tolist(),
        }
    )
)
