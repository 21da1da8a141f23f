"""Poses that lower the expected error of the tool most, chosen one by one; systematic errors are found with the rest.

Of errors that are functions of the pose all poses share the coefficients, which are unknowns beside the parameters, and
the machine in use errs by them. A drift, and what few columns leave out, is noise: nobody knows in which order other
poses will be read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayescal.density.calibration.measurements import Measurements
from bayescal.density.calibration.model_error import LowRankGPTerm
from bayescal.density.pose_kernels import DRIFT, KernelInput, PoseFunctions
from bayescal.errors import InputError
from bayescal.experiments.audit.planned import DesignVariant, PlannedPoses, count_poses
from bayescal.experiments.audit.schema import PlannedPosesConfig
from bayescal.experiments.shared.readings.knowledge import differentiate
from bayescal.identifiability.reading_rows import Jacobians, typical_given, whiten
from bayescal.identifiability.requirements import find_limits
from bayescal.numerics.geometry import Array
from bayescal.pose_selection.next_pose import add_poses

RANDOM = 150  # poses of the workspace, and as many of the ends of the actuators' range


def propose(plan: DesignVariant) -> tuple[str, DesignVariant] | None:
    """Return as many poses as planned, chosen I-optimally, with a name; None where the tool is not determined.

    Out of the planned ones, random ones of the workspace and, where the actuators' range is known, of its ends.
    """
    if not plan.reads_anywhere:
        return None
    bare, n = plan.without_systematic_errors(), plan.n_poses
    pools = (_list_pool(plan), plan.around.pose)
    slopes = [differentiate(bare.posterior, bare.variant, bare.expected, one) for one in pools]
    errors, noise = _share_errors(plan, [one.pose for one in slopes])
    tried, in_use = (replace(one, noise=one.noise + np.diag(noise)) for one in slopes)
    internal, every = plan.variant.internal, np.ones(len(noise), dtype=bool)
    rows = np.concatenate([tried.select_channels(every).rows, _project(tried, errors[0])], axis=-1)
    at = in_use.select_channels(internal)
    tool = at.align(np.concatenate([at.whole, -at.located @ (whiten(in_use.noise, internal) @ errors[1])], axis=-1))
    if not np.isfinite(tool).all() or len(rows) < n:
        return None
    tool = tool / find_limits(plan.requirements, at.tool)[:, None]
    order, _ = add_poses(rows, np.einsum("wti,wtj->ij", tool, tool, optimize=True), n, np.arange(len(rows)))
    poses = PlannedPoses(count_poses(n), tried.pose[order], typical_given(plan.variant.data.given, n))
    return f"{n} poses chosen I-optimally", plan.replan(poses)


def _list_pool(plan: DesignVariant) -> Array:
    """Return the poses (C, q) out of which others are chosen."""
    variant = plan.variant
    random = variant.workspace.draw(RANDOM, np.random.default_rng([plan.config.seed, 9]))
    try:
        ends = plan.maker.plan(PlannedPosesConfig(sampling="extremes", count=RANDOM)).pose
    except InputError:  # the actuators have no range, or the machine cannot stand there
        ends = random[:0]
    return np.concatenate([variant.start, random, ends])


def _share_errors(plan: DesignVariant, poses: Sequence[Array]) -> tuple[list[Array], Array]:
    """Return what coefficients of unit prior do to channels at some sets of poses, (P, K, q) each, and a variance (K,).

    Coefficients are the same at all poses.
    """
    model, given = plan.variant.model, plan.variant.data.given
    read = [model.read(model.layout.nominal, one, typical_given(given, len(one))) for one in poses]
    columns, variance = [list[Array]() for _ in poses], np.zeros(len(model.channels))
    for term in plan.variant.errors.terms_of(LowRankGPTerm):
        size, own = plan.sizes[term.sort], term.own
        if term.sort == DRIFT:
            variance[own.places] += (size / own.levers) ** 2
            continue
        places = [_locate(term, one) for one in read]
        travel = np.concatenate([own.place.travel, *(one.travel for one in places)])
        functions = PoseFunctions((term.sort,), own.place, KernelInput(travel, np.zeros(len(travel))), own.covered)
        variance[own.places] += float(functions.left[0]) * (size / own.levers) ** 2
        for found, place in zip(columns, places, strict=True):
            basis, n = functions.list_bases(place)[0], len(own.places)  # of each channel its own coefficients
            shown = np.zeros((basis.shape[1], len(model.channels), n, basis.shape[2]))
            each = np.broadcast_to(basis, (n, *basis.shape[1:])) * (size / own.levers)[:, None, None]
            shown[:, own.places, np.arange(n)] = each.transpose(1, 0, 2)
            found.append(shown.reshape(*shown.shape[:2], -1))
    nothing = [np.zeros((len(one), len(model.channels), 0)) for one in poses]
    return [np.concatenate([none, *found], axis=-1) for none, found in zip(nothing, columns, strict=True)], variance


def _locate(term: LowRankGPTerm, read: Array) -> KernelInput:
    """Return where functions are evaluated at what channels read (P, K)."""
    order = int(term.own.rows.order.max()) + 1 + np.arange(len(read))
    later = Measurements(tuple(map(str, order)), read, np.ones_like(read), order=order)
    return term.own.place_of(later)


def _project(slopes: Jacobians, shown: Array) -> Array:
    """Return white readings by coefficients (P, K, q), free of the poses."""
    white = whiten(slopes.noise, np.ones(len(slopes.noise), dtype=bool))
    slope, acted = white @ slopes.by_pose, white @ shown
    return np.asarray(acted - slope @ (np.linalg.pinv(slope) @ acted))
