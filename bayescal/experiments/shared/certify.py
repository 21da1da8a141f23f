"""What a certificate of a calibrated machine states: its numbers, from the machine and the results they come from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayescal.calibrated.accuracy import (
    AXIS_CYCLES,
    CYCLES,
    AxisFigures,
    Budget,
    PoseFigures,
    Region,
    Spread,
    check_standards,
    compute_budget,
    coverage_factor,
    draw_cycles,
    enclose_measured,
    enclose_workspace,
    find_largest_cube,
    fit_cube,
    judge_axis,
    judge_poses,
    list_axis_poses,
    list_cube_poses,
    measure_beyond,
    place_lengths,
    propagate,
    sample_range,
    sample_region,
)
from bayescal.calibrated.machine import CalibratedMachine
from bayescal.calibrated.predict import check_determined
from bayescal.errors import InputError
from bayescal.experiments.frame.results import PROVENANCE_FILE, SUMMARY_FILE
from bayescal.files.atomic import read_json
from bayescal.numerics.geometry import Array

AGREED = 0.02
"""How far the expanded uncertainty k u may be from that of the draws before the latter is stated."""
BOUND = 0.95  # share of machines of the posterior whose figure of merit is not larger
SHOWN = {"mm": (1e3, "µm"), "rad": (1e6, "µrad")}
"""Factors and units in which uncertainties are stated, by inner units."""
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
        All over its range instead.
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
        Zero where figures of the standards have no meaning.
    poses : PoseFigures or None
        ISO 9283 of each machine of the posterior (S, 5).
    axes : tuple of AxisFigures
        ISO 230-2 along the tool's lengths, of each machine (S,).
    without : str
        Why there are no figures of the standards, in words; else empty.
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
    poses: PoseFigures | None
    axes: tuple[AxisFigures, ...]
    summary: dict[str, Any]
    provenance: dict[str, Any]
    region: Region | None = None
    beyond: float = 0.0
    without: str = ""

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Names of the tool's numbers."""
        return tuple(one.name for one in self.calibrated.model.tool_channels)

    @property
    def units(self) -> tuple[str, ...]:
        """Units in which they are stated."""
        return tuple(SHOWN.get(one.unit, (1.0, one.unit))[1] for one in self.calibrated.model.tool_channels)

    @property
    def scale(self) -> Array:
        """How many of these make an inner one, shape (m,)."""
        return np.array([SHOWN.get(one.unit, (1.0, ""))[0] for one in self.calibrated.model.tool_channels])

    @property
    def where(self) -> str:
        """What is certified, in words."""
        return "all over the actuators' range" if self.region is None else f"over {self.region.words}"

    @property
    def ratios(self) -> Array:
        """The expanded uncertainty k u over that of the draws, per axis, rms over the poses of both, shape (m,)."""
        checked = self.factor * self.budget.sd()[: len(self.spread.half_width)]
        return np.asarray(_rms(checked) / _rms(self.spread.half_width))

    @property
    def agrees(self) -> bool:
        """Whether k u may be stated."""
        return bool(np.all(np.abs(self.ratios - 1.0) <= AGREED))

    @property
    def expanded(self) -> Array:
        """Expanded uncertainty of each pose, (P, m): k u, or as much more or less as the draws say."""
        expanded = self.factor * self.budget.sd()
        return np.asarray(expanded if self.agrees else expanded / self.ratios)

    def list_figures(self) -> dict[str, Any]:
        """Return what is stated as numbers for files: µm and µrad, root mean squares over the workspace."""

        def name(values: Array) -> dict[str, float]:
            return dict(zip(self.axis_names, (float(f"{one:.6g}") for one in values), strict=True))

        return {
            "experiment": self.calibrated.source.experiment,
            "variant": self.calibrated.source.variant,
            "data_origin": self.calibrated.source.data,
            "problems": list(self.calibrated.source.problems),
            "coverage": self.wishes.coverage,
            "poses": len(self.budget.commands),
            "workspace": self.where,
            "share_extrapolated": float(f"{self.beyond:.4g}"),
            "unit": _group(self.axis_names, self.units),
            "standard_uncertainty": {
                **{source: name(_rms(self.budget.sd(source)) * self.scale) for source in self.budget.parts},
                "combined": name(_rms(self.budget.sd()) * self.scale),
            },
            "coverage_factor": float(f"{self.factor:.6g}"),
            "expanded_uncertainty": {
                "stated": name(_rms(self.expanded) * self.scale),
                "largest": name(self.expanded.max(axis=0) * self.scale),
                "monte_carlo": name(_rms(self.spread.half_width) * self.scale),
                "propagated_over_monte_carlo": name(self.ratios),
                "method": "k u" if self.agrees else "Monte Carlo",
            },
        }


def _rms(values: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def _group(names: tuple[str, ...], units: tuple[str, ...]) -> dict[str, str]:
    """Return the units of names, those of one unit together."""
    return {
        ", ".join(name for name, other in zip(names, units, strict=True) if other == unit): unit
        for unit in dict.fromkeys(units)
    }


def certify(calibrated: CalibratedMachine, path: Path, wishes: Wishes) -> Certificate:
    """Return what a certificate states of a calibrated machine, loaded from a directory.

    Raises
    ------
    InputError
        Without draws of the posterior, where commands do not tell the pose, or where the cube is out of reach.
    """
    check_determined(calibrated)
    known = enclose_measured(calibrated)
    everywhere = enclose_workspace(calibrated)
    region = everywhere if wishes.whole_range else wishes.region or known or everywhere
    if region is None:
        commands = sample_range(calibrated, wishes.n_poses, wishes.seed)
    else:
        commands = sample_region(calibrated, region, wishes.n_poses, wishes.seed)
    given = calibrated.typical(len(commands))
    budget = compute_budget(calibrated, commands, given)
    checked = {name: value[:N_CHECKED] for name, value in given.items()}
    spread = propagate(calibrated, commands[:N_CHECKED], wishes.coverage, wishes.n_draws, wishes.seed + 1, checked)
    without = check_standards(calibrated)
    if without and wishes.cube_mm is not None:
        raise InputError(f"cube: not meaningful: {without}")
    cube, poses, axes = (0.0, None, ()) if without else _judge(calibrated, wishes, region, budget)
    return Certificate(
        calibrated,
        wishes,
        budget,
        coverage_factor(wishes.coverage),
        spread,
        cube,
        poses,
        axes,
        _read(path / SUMMARY_FILE),
        _read(path / PROVENANCE_FILE),
        region,
        measure_beyond(calibrated, commands, known),
        without,
    )


def _judge(
    calibrated: CalibratedMachine, wishes: Wishes, region: Region | None, budget: Budget
) -> tuple[float, PoseFigures, tuple[AxisFigures, ...]]:
    """Return the edge of a cube about home, and the standards' figures of poses and axes in it."""
    home = calibrated.model.tool_values(calibrated.theta, calibrated.model.home_pose)
    within = np.inf if region is None else find_largest_cube(calibrated, region, budget.tool)
    cube, n = wishes.cube_mm or fit_cube(calibrated, home, within or np.inf), len(calibrated.lengths)
    effort = (wishes.n_draws, wishes.seed + 2)
    visited = draw_cycles(calibrated, place_lengths(calibrated, home, list_cube_poses(cube, n)), CYCLES, *effort)
    axes = []
    for axis in range(n):
        poses = place_lengths(calibrated, home, list_axis_poses(cube, axis, n))
        axes.append(judge_axis(draw_cycles(calibrated, poses, AXIS_CYCLES, *effort)[..., axis]))
    return cube, judge_poses(visited), tuple(axes)


def _read(path: Path) -> dict[str, Any]:
    return read_json(path) if path.is_file() else {}
