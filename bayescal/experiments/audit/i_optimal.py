"""Poses for an audit: as many as it plans, chosen so that the calibrated machine predicts its workspace best."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import threadpool_limits

from bayescal.errors import InputError
from bayescal.identifiability.design import Plan
from bayescal.identifiability.requirements import find_limits
from bayescal.identifiability.sensitivity import compute_sensitivity
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM
from bayescal.pose_selection import (
    ActuatorBox,
    Selection,
    SelectionProblem,
    WorkspaceBox,
    factorial_candidates,
    random_candidates,
    select,
)
from bayescal.pose_selection.criteria import IOptimality

if TYPE_CHECKING:
    from bayescal.experiments.audit.inputs import AuditInputs

SEED = 21
N_CANDIDATES = 729


def plan_i_optimal(inputs: AuditInputs, n: int | None = None, n_candidates: int = N_CANDIDATES) -> Plan:
    """Return an audit's plan with I-optimal poses in place of its own; sensors and noise stay.

    Parameters
    ----------
    inputs : AuditInputs
    n : int, optional
        How many poses; as many as planned by default.
    n_candidates : int
        On a full factorial over the actuators' range, three levels each by default, since far corners tell most; where
        legs are redundant random ones within the workspace.

    Raises
    ------
    InputError
        Where legs are redundant and there is no workspace, or poses are too few for the parameters.
    """
    return replace(inputs.plan, actuators=select_i_optimal(inputs, n, n_candidates).actuators)


def select_i_optimal(inputs: AuditInputs, n: int | None = None, n_candidates: int = N_CANDIDATES) -> Selection:
    """Return I-optimal poses for an audit, found by exchange; see `plan_i_optimal`.

    They minimise the expected posterior variance of the predicted pose, averaged over the poses of the audit's
    workspace (those of its plan where it has none) and in units of its requirements (see `find_limits`).
    """
    knowledge = inputs.knowledge
    rng = np.random.default_rng([inputs.config.seed, SEED])
    workspace = compute_sensitivity(knowledge, inputs.workspace_actuators)
    limits = find_limits(inputs.requirements, workspace.slope * knowledge.sd)
    criterion = IOptimality(inputs.plan, workspace=workspace, sd=knowledge.sd, limits=limits)
    if knowledge.machine.mechanism.n_legs == DEGREES_OF_FREEDOM:
        domain = ActuatorBox(knowledge)
        candidates = factorial_candidates(domain, n_candidates)
    else:
        if inputs.workspace is None:
            raise InputError("I-optimal poses: found redundant legs without [workspace], expected it")
        candidates = random_candidates(WorkspaceBox(knowledge, inputs.workspace.half), n_candidates, rng)
    count = inputs.plan.n_poses if n is None else n
    problem = SelectionProblem(candidates, criterion, count)
    with threadpool_limits(1), np.errstate(all="ignore"):
        return select(problem, "exchange", rng)
