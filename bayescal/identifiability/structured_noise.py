"""What a plan tells of a machine whose legs err by a function of the pose, the same at every pose near another.

Such an error (`bayescal.density.priors`) is g = F c over the planned poses, F Fᵀ the kernel's matrix and the
coefficients c of each leg N(0, s²): they are parameters with a prior like any other, that nobody asks for. With X and V
the rows of the parameters and of the coefficients in units of noise and prior, and Q R a factorisation of

    (V X; 1 0),    R = (R_cc R_cθ; 0 R_θθ),

the parameters have the information R_θθᵀ R_θθ = Xᵀ (1 + V Vᵀ)⁻¹ X, all digits of which are kept.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayescal.density.structured import factor_kernel
from bayescal.identifiability.design import Knowledge, Plan
from bayescal.identifiability.information import Information, information_of_rows
from bayescal.identifiability.sensitivity import Sensitivity, compute_sensitivity
from bayescal.numerics.geometry import Array


def inform(knowledge: Knowledge, plan: Plan) -> Information:
    """Return what a plan tells of the free parameters; InputError for a pose that the machine cannot take."""
    sensitivity = compute_sensitivity(knowledge, plan.actuators)
    rows = sensitivity.rows(plan)
    if plan.function is None:
        return information_of_rows(rows, knowledge.sd)
    return marginalise(rows.reshape(-1, rows.shape[-1]) * knowledge.sd, see_function(knowledge, plan, sensitivity))


def see_function(knowledge: Knowledge, plan: Plan, sensitivity: Sensitivity) -> Array:
    """Return V at the poses of a plan, shape (K, R N), for coefficients of unit prior.

    An error of a leg does to its closure what its actuator's displacement does.
    """
    assert plan.function is not None
    mechanism = knowledge.machine.mechanism
    travel = (plan.actuators - mechanism.initial_actuator_positions) / mechanism.actuator_range
    values, vectors = np.linalg.eigh(plan.function.kernel(travel, travel))
    factor = factor_kernel(np.maximum(values, 0.0)[None], vectors[None])[0]
    own = np.diagonal(sensitivity.by_actuators, axis1=-2, axis2=-1) * plan.function.scale
    by_coefficient = own[:, :, None, None] * np.eye(own.shape[1])[:, None, :] * factor[:, None, :, None]
    by_coefficient = by_coefficient.reshape(*own.shape, -1)
    unseen = np.zeros((*sensitivity.frames.shape[:2], by_coefficient.shape[-1]))
    rows = replace(sensitivity, by_parameters=by_coefficient, frames=unseen).rows(plan)
    return rows.reshape(-1, rows.shape[-1])


def marginalise(rows: Array, others: Array) -> Information:
    """Return the information of rows (K, n) on their parameters, beside others (K, q) of unit prior."""
    q = others.shape[1]
    stacked = np.block([[others, rows], [np.eye(q), np.zeros((q, rows.shape[1]))]])
    return Information(np.linalg.qr(stacked, mode="r")[q:, q:])
