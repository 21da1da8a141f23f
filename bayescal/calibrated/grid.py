"""A grid of corrections over the workspace, for a controller that has the nominal machine and a table.

Asked for a tool t, such a controller sends the commands s = h(d, v) of the nominal machine d that has it there,
t = t(d, v). By them the calibrated machine goes elsewhere. The correction c(t) is what has to be asked for more: its
tool is t at the commands by which the nominal one has t + c. v is found by Newton's method with the nominal machine's
slopes, which are nearly the calibrated one's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.stats import qmc

from bayescal.calibrated.carried import SAMPLES, describe_share
from bayescal.calibrated.machine import CalibratedMachine
from bayescal.calibrated.one_place import take_one_place
from bayescal.calibrated.predict import PosePrediction, bound_workspace, check_determined, is_pose, predict_poses
from bayescal.calibrated.tables import FINE, TOOL, name_column, show_unit
from bayescal.errors import InputError
from bayescal.files.csv_tables import format_table
from bayescal.machines.readings import ReadingModel
from bayescal.numerics.geometry import Array

MOST = 1000  # nodes in all
ALONG = (3, 5, 7, 9, 11)  # a coordinate, its middle among them
ARRIVED = 1e-10  # of a tool's number, or of its unit
STEPS = 8  # of Newton's method, each of which leaves some thousandths of what there was


@dataclass(frozen=True, eq=False)
class _Controller:
    """A calibrated machine by the commands of the nominal one."""

    calibrated: CalibratedMachine
    drawn: ReadingModel

    def find_tool(self, pose: Array) -> Array:
        """Return the nominal machine's tool (P, m) at coordinates (P, q)."""
        return self.drawn.tool_values(self.drawn.layout.nominal, pose)

    def go(self, pose: Array) -> PosePrediction:
        """Return where the calibrated machine goes where the nominal one is sent to coordinates (P, q)."""
        given = self.calibrated.typical(len(pose))
        commands = self.drawn.read(self.drawn.layout.nominal, pose, given)[:, self.calibrated.commanded]
        return predict_poses(self.calibrated, commands, given)

    def move(self, pose: Array, error: Array) -> Array:
        """Return coordinates (P, q) at which the nominal tool is elsewhere by errors (P, m), to first order."""
        tool, slopes, _ = self.drawn.tool(self.drawn.layout.nominal, pose, False)
        slopes = self.calibrated.comparison.pull_back(np.zeros_like(tool), tool, slopes)
        return pose + (np.linalg.pinv(np.nan_to_num(slopes)) @ error[..., None])[..., 0]

    def correct(self, pose: Array) -> tuple[Array, PosePrediction]:
        """Return coordinates to send the nominal machine to, and where the calibrated one goes then."""
        wanted, sent = self.find_tool(pose), pose
        for _ in range(STEPS):
            sent = self.move(sent, self.calibrated.comparison.subtract(wanted, self.go(sent).tool))
        return sent, self.go(sent)


def list_grid_files(calibrated: CalibratedMachine) -> dict[str, bytes]:
    """Return ``grid.csv``: nominal tools all over the workspace, corrections of each, and their standard deviations.

    Standard deviations are those of the posterior. A rotation's correction is a rotation vector about the base axes.
    InputError for a machine whose drawing is no longer known, or whose commands do not tell its tool.
    """
    calibrated = take_one_place(calibrated)
    check_determined(calibrated)
    if calibrated.drawn is None:
        raise InputError("format grid: found an exported mechanism, expected results of a study")
    controller = _Controller(calibrated, calibrated.drawn)
    low, high = bound_workspace(replace(calibrated, model=calibrated.drawn))
    n = max((one for one in ALONG if one ** len(low) <= MOST), default=2)
    axes = [np.linspace(*ends, n) for ends in zip(low, high, strict=True)]
    pose = np.array(list(product(*axes)))
    sent, there = controller.correct(pose)
    wanted, compared = controller.find_tool(pose), calibrated.comparison
    correction = compared.subtract(controller.find_tool(sent), wanted)
    with np.errstate(invalid="ignore"):
        left = np.abs(compared.subtract(wanted, there.tool)) <= ARRIVED * (1.0 + np.abs(wanted))
    good = there.found & np.isfinite(correction).all(axis=1) & left.all(axis=1)
    if not good.any():
        raise InputError(f"format grid: machine {calibrated.name!r}: found no pose of the workspace within reach")
    tool, coordinates = calibrated.model.tool_channels, calibrated.model.pose_channels
    shown = () if is_pose(calibrated) else coordinates
    units, fine = [show_unit(calibrated, one)[1] for one in tool], [FINE.get(one.unit, (one.unit, 1.0)) for one in tool]
    columns = [name_column(calibrated, one) for one in shown]
    columns += [f"{TOOL if shown else ''}{name_column(calibrated, one)}" for one in tool]
    columns += [f"correction_{name_column(calibrated, one)}" for one in tool]
    parts = [pose / [show_unit(calibrated, one)[1] for one in coordinates]] if shown else []
    parts += [wanted / units, correction / units]
    said = [
        *calibrated.source.describe(),
        "Command the nominal machine to tool + correction. Rotations: vectors about base axes.",
        f"{n} nodes along each of {', '.join(one.name for one in coordinates)}.",
        f"Of {len(good)} nodes {len(good) - good.sum()} are out of reach, or singular.",
    ]
    if there.of_geometry is not None:
        said.append("sd: standard uncertainty of a correction.")
        columns += [f"sd_{one.stem}_{unit}" for one, (unit, _) in zip(tool, fine, strict=True)]
        parts.append(np.sqrt(np.diagonal(there.of_geometry, axis1=1, axis2=2)) * [size for _, size in fine])
    digits = ["{:.6g}" if name.startswith("sd_") else "{:.10f}" for name in columns]
    rows = [[form.format(x + 0.0) for form, x in zip(digits, row, strict=True)] for row in np.hstack(parts)[good]]
    said.append(_describe_between(controller, axes, np.where(good[:, None], correction, np.nan)))
    return {"grid.csv": format_table(said, columns, rows).encode()}


def _describe_between(controller: _Controller, axes: list[Array], correction: Array) -> str:
    """Return how much of corrections (P, m) a controller has that interpolates linearly between the nodes.

    Corrections that are NaN are none, and where a node lacks one there is none between either.
    """
    low, high = np.array([[one[0], one[-1]] for one in axes]).T
    pose = qmc.scale(qmc.Sobol(len(low), rng=1).random(SAMPLES), low, high)
    between = RegularGridInterpolator(axes, correction.reshape(*map(len, axes), -1))(pose)
    known = np.isfinite(between).all(axis=1)
    pose, between = (pose[known], between[known]) if known.any() else (pose, np.zeros_like(between))
    calibrated, wanted = controller.calibrated, controller.find_tool(pose)
    own = calibrated.lengths if len(calibrated.lengths) else np.arange(correction.shape[1])
    unit, size = show_unit(calibrated, calibrated.model.tool_channels[own[0]])
    off = [
        calibrated.comparison.subtract(wanted, controller.go(one).tool)[:, own] / size
        for one in (pose, controller.move(pose, between))
    ]
    whole, left = (float(np.sqrt(np.nanmean((one**2).sum(axis=1)))) for one in off)
    return describe_share(whole, left, "Interpolated linearly the file", unit)
