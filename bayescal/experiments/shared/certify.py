"""What a certificate of a calibrated machine states: its numbers, from the machine and the results they come from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.calibrated.region import Region, enclose_measured, measure_beyond, sample_range, sample_region
from bayescal.calibrated.standards import (
    AXIS_CYCLES,
    CYCLES,
    AxisFigures,
    PoseFigures,
    draw_cycles,
    fit_cube,
    judge_axis,
    judge_poses,
    list_axis_poses,
    list_cube_poses,
)
from bayescal.calibrated.uncertainty import (
    Budget,
    Spread,
    compute_budget,
    coverage_factor,
    propagate,
)
from bayescal.experiments.frame.results import PROVENANCE_FILE, SUMMARY_FILE
from bayescal.files.atomic import read_json
from bayescal.machines.kinematics import check_home_pose
from bayescal.numerics.geometry import Array

AGREED = 0.02
"""How far the expanded uncertainty k u may be from that of the draws before the latter is stated."""
BOUND = 0.95  # share of machines of the posterior whose figure of merit is not larger
AXES = ("x", "y", "z", "rx", "ry", "rz")
SCALE = np.array([1e3, 1e3, 1e3, 1e6, 1e6, 1e6])  # to µm and µrad, from mm and rad
N_CHECKED = 64  # poses that draws go through


@dataclass(frozen=True)
class Wishes:
    """What a certificate is to state.

    Attributes
    ----------
    coverage : float
        Probability of the expanded uncertainty.
    n_poses : int
        Of the workspace.
    n_draws : int
        Of the posterior, at most.
    cube_mm : float or None
        Edge of the cube of ISO 9283; by default the largest about home that is within reach and within the region.
    seed : int
    region : Region or None
        Where; by default that of the poses that calibrated the machine, where they are known.
    whole_range : bool
        All over the actuators' range instead.
    """

    coverage: float = 0.95
    n_poses: int = 512
    n_draws: int = 2000
    cube_mm: float | None = None
    seed: int = 0
    region: Region | None = None
    whole_range: bool = False


@dataclass(frozen=True, eq=False)
class Certificate:
    """What is certified.

    Attributes
    ----------
    calibrated : CalibratedMachine
    wishes : Wishes
    budget : Budget
    factor : float
        k of the law of propagation.
    spread : Spread
        By Monte Carlo, of the first poses of the budget.
    cube_mm : float
    poses : PoseFigures
        ISO 9283 of each machine of the posterior (S, 5).
    axes : tuple of AxisFigures
        ISO 230-2 along x, y and z, of each machine (S,).
    summary, provenance : dict
        Of the results; empty for a machine that was exported.
    region : Region or None
        Where; None for all over the actuators' range.
    beyond : float
        Share of its poses outside of the box of those that calibrated the machine.
    """

    calibrated: CalibratedMachine
    wishes: Wishes
    budget: Budget
    factor: float
    spread: Spread
    cube_mm: float
    poses: PoseFigures
    axes: tuple[AxisFigures, ...]
    summary: dict[str, Any]
    provenance: dict[str, Any]
    region: Region | None = None
    beyond: float = 0.0

    @property
    def where(self) -> str:
        """What is certified, in words."""
        return "all over the actuators' range" if self.region is None else f"over {self.region.words}"

    @property
    def ratios(self) -> Array:
        """The expanded uncertainty k u over that of the draws, per axis, rms over the poses of both, shape (6,)."""
        checked = self.factor * self.budget.sd()[: len(self.spread.half_width)]
        return np.asarray(_rms(checked) / _rms(self.spread.half_width))

    @property
    def agrees(self) -> bool:
        """Whether k u may be stated."""
        return bool(np.all(np.abs(self.ratios - 1.0) <= AGREED))

    @property
    def expanded(self) -> Array:
        """Expanded uncertainty of each pose, (P, 6), mm and rad: k u, or as much more or less as the draws say."""
        expanded = self.factor * self.budget.sd()
        return np.asarray(expanded if self.agrees else expanded / self.ratios)

    def list_figures(self) -> dict[str, Any]:
        """Return what is stated as numbers for files: µm and µrad, root mean squares over the workspace."""

        def name(values: Array) -> dict[str, float]:
            return dict(zip(AXES, (float(f"{one:.6g}") for one in values), strict=True))

        return {
            "experiment": self.calibrated.source.experiment,
            "variant": self.calibrated.source.variant,
            "data_origin": self.calibrated.source.data,
            "problems": list(self.calibrated.source.problems),
            "coverage": self.wishes.coverage,
            "poses": len(self.budget.actuators),
            "workspace": self.where,
            "share_extrapolated": float(f"{self.beyond:.4g}"),
            "unit": {"x, y, z": "µm", "rx, ry, rz": "µrad"},
            "standard_uncertainty": {
                **{source: name(_rms(self.budget.sd(source)) * SCALE) for source in self.budget.parts},
                "combined": name(_rms(self.budget.sd()) * SCALE),
            },
            "coverage_factor": float(f"{self.factor:.6g}"),
            "expanded_uncertainty": {
                "stated": name(_rms(self.expanded) * SCALE),
                "largest": name(self.expanded.max(axis=0) * SCALE),
                "monte_carlo": name(_rms(self.spread.half_width) * SCALE),
                "propagated_over_monte_carlo": name(self.ratios),
                "method": "k u" if self.agrees else "Monte Carlo",
            },
        }


def _rms(values: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def certify(calibrated: CalibratedMachine, path: Path, wishes: Wishes) -> Certificate:
    """Return what a certificate states of a calibrated machine, loaded from a directory.

    Raises
    ------
    InputError
        Without draws of the posterior, or where the cube is out of reach.
    """
    region = None if wishes.whole_range else wishes.region or enclose_measured(calibrated)
    if region is None:
        actuators = sample_range(calibrated, wishes.n_poses, wishes.seed)
    else:
        actuators = sample_region(calibrated, region, wishes.n_poses, wishes.seed)
    budget = compute_budget(calibrated, actuators)
    spread = propagate(calibrated, actuators[:N_CHECKED], wishes.coverage, wishes.n_draws, wishes.seed + 1)
    home = check_home_pose(calibrated.machine)
    position, rotation = home.position, home.rotation
    within = np.inf if region is None or region.cube == 0.0 else region.cube
    cube = wishes.cube_mm or fit_cube(calibrated, position, rotation, within)
    effort = (wishes.n_draws, wishes.seed + 2)
    visited = draw_cycles(calibrated, list_cube_poses(position, cube), rotation, CYCLES, *effort)
    axes = []
    for axis in range(3):
        along = draw_cycles(calibrated, list_axis_poses(position, cube, axis), rotation, AXIS_CYCLES, *effort)
        axes.append(judge_axis(along[..., axis]))
    return Certificate(
        calibrated,
        wishes,
        budget,
        coverage_factor(wishes.coverage),
        spread,
        cube,
        judge_poses(visited),
        tuple(axes),
        _read(path / SUMMARY_FILE),
        _read(path / PROVENANCE_FILE),
        region,
        measure_beyond(calibrated, budget.position),
    )


def _read(path: Path) -> dict[str, Any]:
    return read_json(path) if path.is_file() else {}
