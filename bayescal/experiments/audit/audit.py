"""The audit as a whole: from a design to everything that is said of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bayescal.experiments.audit.changes import ChangeEffect, SweepPoint, check_changes, evaluate_changes
from bayescal.experiments.audit.planned import Planned
from bayescal.experiments.frame.parallel import Run
from bayescal.identifiability.directions import Direction, Verdict, find_directions, judge_parameters
from bayescal.identifiability.information import Information
from bayescal.identifiability.requirements import Forecast, Outlook
from bayescal.identifiability.ridges import Ridge
from bayescal.identifiability.selection import ReducedSet, Selection, judge_reduced, select_parameters
from bayescal.identifiability.structure import Structure
from bayescal.limits import NINETY_FIVE

type Harm = Literal["harmless", "noticeable", "harmful", "unknown"]

HARMLESS = 0.1  # of a limit, that the remaining uncertainty along a direction may take
HARMFUL = 1.0


@dataclass(frozen=True, eq=False)
class Analysis:
    """What the plan tells of the parameters, without words: what is fast and what tests and sweeps want.

    Attributes
    ----------
    structure : Structure
    information : Information
    selection : Selection
    directions : list of Direction
    verdicts : tuple of str
        Of each parameter.
    reduced : ReducedSet or None
        What a calibration of the selected parameters alone claims and errs by; None where these are none, or all.
    """

    structure: Structure
    information: Information
    selection: Selection
    directions: list[Direction]
    verdicts: tuple[Verdict, ...]
    reduced: ReducedSet | None


@dataclass(frozen=True, eq=False)
class Audit:
    """An audit with everything it says.

    Attributes
    ----------
    inputs : Planned
    analysis : Analysis
    ridges : list of Ridge
        The structural and practical directions, described.
    forecast : Forecast
        Of the workspace, or of the planned poses where there is no workspace.
    outlooks : list of Outlook
        One per requirement.
    together : float
        Probability that all requirements are kept; NaN without any.
    what_ifs : list of ChangeEffect
    sweeps : list of SweepPoint
    """

    inputs: Planned
    analysis: Analysis
    ridges: list[Ridge]
    forecast: Forecast
    outlooks: list[Outlook]
    together: float
    what_ifs: list[ChangeEffect]
    sweeps: list[SweepPoint]

    def measure_left(self) -> float:
        """Return the error that unknown parameters leave over the workspace, rms after by before, over all units."""
        after = self.forecast.covariance(self.analysis.information.covariance)
        before = self.forecast.covariance(np.eye(self.forecast.slope.shape[-1]))
        parts = [np.diagonal(one, axis1=-2, axis2=-1).mean(axis=0) for one in (after, before)]
        moved = parts[1] > 0.0
        return float(np.sqrt(np.mean(parts[0][moved] / parts[1][moved]))) if moved.any() else float("nan")

    def harm(self, direction: Direction) -> tuple[Harm, float, str]:
        """Return whether what remains unknown along a direction matters, the share of a limit, and of which.

        The share is that of 1.96 standard deviations that remain, anywhere in the workspace.
        """
        requirements = self.inputs.requirements
        if not requirements or not np.isfinite(self.forecast.slope).all():
            return "unknown", float("nan"), ""
        share, name = self.forecast.share_of_limit(direction.vector, requirements)
        share *= NINETY_FIVE * float(np.sqrt(max(0.0, 1.0 - direction.contraction)))
        return ("harmless" if share < HARMLESS else "noticeable" if share < HARMFUL else "harmful"), share, name


def analyse(inputs: Planned) -> Analysis:
    """Return what the plan tells of the parameters."""
    structure = inputs.find_structure(np.random.default_rng([inputs.config.seed, 2]))
    information = inputs.inform()
    selection = select_parameters(information, inputs.symbols, inputs.frames)
    frames = tuple(k for k, symbol in enumerate(inputs.symbols) if symbol in inputs.frames)
    directions = find_directions(information, structure.null_space, selection.fixed, frames)
    verdicts = judge_parameters(information, structure.null_space)
    reduced = judge_reduced(information, selection.free)
    return Analysis(structure, information, selection, directions, verdicts, reduced)


def judge(inputs: Planned) -> Audit:
    """Return what the plan tells and how requirements stand, without other plans."""
    analysis, forecast = analyse(inputs), inputs.forecast()
    rng, requirements = np.random.default_rng([inputs.config.seed, 3]), inputs.requirements
    outlooks, together = forecast.judge(requirements, analysis.information, rng, analysis.selection.free)
    return Audit(inputs, analysis, [], forecast, outlooks, together if requirements else float("nan"), [], [])


def run_audit(inputs: Planned, run: Run) -> Audit:
    """Return the audit of a plan; one of poses chosen I-optimally stands among the changes."""
    return complete(judge(inputs), run)


def complete(audit: Audit, run: Run) -> Audit:
    """Return an audit with its ridges in words and with other plans."""
    inputs = audit.inputs
    check_changes(inputs)
    ridges = inputs.describe(audit.analysis.directions)
    what_ifs, sweeps = evaluate_changes(inputs, audit.forecast, run)
    return replace(audit, ridges=ridges, what_ifs=what_ifs, sweeps=sweeps)
