# /// script
# requires-python = ">=3.12"
# dependencies = ["figaroh==1.0.2"]
# ///
"""A UR10 by figaroh: joints and tracker positions in, positions of other rows out.

Arguments: rows, other rows, URDF, method: one of figaroh's `estimation` (`structural`, its default, `map_cv`, ...), or
`elastic`: structural with joints that give under weight.
"""

import contextlib
import json
import sys
import tempfile
import warnings
from pathlib import Path

import pandas as pd
import yaml
from figaroh.calibration.base_calibration import BaseCalibration
from figaroh.calibration.calibration_tools import calc_updated_fkm
from figaroh.tools.robot import load_robot

warnings.simplefilter("ignore")
urdf, method = Path(sys.argv[3]).resolve(), sys.argv[4]
work = Path(tempfile.mkdtemp())
robot = load_robot(str(urdf), package_dirs=str(work))
joints = list(robot.model.names[1:])
for name, path in zip(("rows", "others"), sys.argv[1:3], strict=True):
    table = pd.read_csv(path, comment="#")
    table[[f"{axis}1" for axis in "xyz"]] = 1e-3 * table[[f"tracker_{axis}_mm" for axis in "xyz"]]
    table.rename(columns={f"joint_{k}_rad": joint for k, joint in enumerate(joints, 1)}).to_csv(work / f"{name}.csv")

calibration = {
    "parameters": {
        "calibration_level": "full_params",
        "include_non_geometric": method == "elastic",
        "estimation": {"method": "structural" if method == "elastic" else method},
    },
    "kinematics": {"base_frame": "universe", "tool_frame": "tool"},
    "measurements": {"markers": [{"measurable_dof": [True, True, True, False, False, False]}]},
    "data": {
        "source_file": str(work / "rows.csv"),
        "validation_data_file": str(work / "others.csv"),
        "number_of_samples": 60,
    },
}
config = {"robot": {"name": "ur10"}, "tasks": {"calibration": calibration}}
(work / "config.yaml").write_text(yaml.safe_dump(config))


class Calibration(BaseCalibration):
    """Positions alone, in the tracker's frame."""

    def cost_function(self, var):
        """Return how far positions are off, m."""
        found = calc_updated_fkm(self.model, self.data, var, self.q_measured, self.calib_config)
        return self._compute_logmap_residuals(self.PEE_measured, found, position_frame="world")


arm = Calibration(robot, str(work / "config.yaml"))
arm.calib_config |= {"known_baseframe": False, "known_tipframe": False}
with contextlib.redirect_stdout(sys.stderr):
    arm.initialize()
    arm.solve(enable_logging=False)
held = dict(arm.calib_config, NbSample=len(arm._q_val))
found = calc_updated_fkm(arm.model, arm.data, arm.LM_result.x, arm._q_val, held).reshape(3, -1).T
print(
    json.dumps(
        {
            "predicted": (1e3 * found).tolist(),
            "parameters": len(arm.LM_result.x),
            "converged": arm.STATUS == "CALIBRATED",
            "standard_deviations": [float(one) for one in arm.std_dev],
        }
    )
)
