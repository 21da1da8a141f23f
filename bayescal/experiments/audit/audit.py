"""The audit as a whole: from a design to everything that is said of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayescal.experiments.audit.changes import ChangeEffect, SweepPoint, check_changes, evaluate_changes
from bayescal.experiments.audit.inputs import AuditInputs
from bayescal.experiments.frame.parallel import Run
from bayescal.identifiability.directions import Direction, find_directions
from bayescal.identifiability.information import Information
from bayescal.identifiability.reduced import ReducedSet, judge_reduced
from bayescal.identifiability.requirements import Forecast, Outlook
from bayescal.identifiability.ridges import Ridge, describe_ridges
from bayescal.identifiability.selection import Selection, select_parameters
from bayescal.identifiability.sensitivity import compute_sensitivity
from bayescal.identifiability.structure import Structure, find_structural_rank
from bayescal.identifiability.structured_noise import inform
from bayescal.identifiability.verdicts import Verdict, judge_parameters
from bayescal.limits import NINETY_FIVE
from bayescal.machines.frames import FRAME_BLOCKS

type Harm = Literal["harmless", "noticeable", "harmful", "unknown"]

HARMLESS = 0.1  # of a limit, that the remaining uncertainty along a direction may take
HARMFUL = 1.0
FRAME_SYMBOLS = frozenset(block.symbol for block in FRAME_BLOCKS)


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
    inputs : AuditInputs
    analysis : Analysis
    ridges : list of Ridge
        The structural and practical directions, described.
    forecast : Forecast
        Of the workspace, or of the planned poses where there is no workspace.
    outlooks : list of Outlook
        One per requirement.
    what_ifs : list of ChangeEffect
    sweeps : list of SweepPoint
    """

    inputs: AuditInputs
    analysis: Analysis
    ridges: list[Ridge]
    forecast: Forecast
    outlooks: list[Outlook]
    what_ifs: list[ChangeEffect]
    sweeps: list[SweepPoint]

    def harm(self, direction: Direction) -> tuple[Harm, float, str]:
        """Return whether what remains unknown along a direction matters, the share of a limit, and of which.

        The share is that of 1.96 standard deviations that remain, anywhere in the workspace.
        """
        requirements = self.inputs.requirements
        if not requirements:
            return "unknown", float("nan"), ""
        share, name = self.forecast.share_of_limit(direction.vector, requirements)
        share *= NINETY_FIVE * float(np.sqrt(max(0.0, 1.0 - direction.contraction)))
        return ("harmless" if share < HARMLESS else "noticeable" if share < HARMFUL else "harmful"), share, name


def analyse(inputs: AuditInputs) -> Analysis:
    """Return what the plan tells of the parameters."""
    knowledge, plan = inputs.knowledge, inputs.plan
    structure = find_structural_rank(knowledge, plan, np.random.default_rng([inputs.config.seed, 2]))
    information = inform(knowledge, plan)
    selection = select_parameters(information, knowledge.symbols, FRAME_SYMBOLS)
    frames = tuple(k for k, symbol in enumerate(knowledge.symbols) if symbol in FRAME_SYMBOLS)
    directions = find_directions(information, structure.null_space, selection.fixed, frames)
    verdicts = judge_parameters(information, structure.null_space)
    reduced = judge_reduced(information, selection.free)
    return Analysis(structure, information, selection, directions, verdicts, reduced)


def run_audit(inputs: AuditInputs, run: Run) -> Audit:
    """Return the audit of a design; a plan of poses chosen I-optimally stands among the changes."""
    check_changes(inputs)
    analysis = analyse(inputs)
    knowledge, plan = inputs.knowledge, inputs.plan
    ridges = describe_ridges(knowledge, plan, inputs.workspace_actuators, analysis.directions, inputs.units)
    workspace = Forecast(compute_sensitivity(knowledge, inputs.workspace_actuators), knowledge.sd)
    rng = np.random.default_rng([inputs.config.seed, 3])
    outlooks = (
        workspace.judge(inputs.requirements, analysis.information, plan, rng, analysis.selection.free)
        if inputs.requirements
        else []
    )
    what_ifs, sweeps = evaluate_changes(inputs, workspace, run)
    return Audit(inputs, analysis, ridges, workspace, outlooks, what_ifs, sweeps)
