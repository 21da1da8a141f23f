"""Claims on which parameters the poses can tell: information of the calibration poses against tolerances."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayescal.experiments.study.rows import ClaimRow
from bayescal.machines.kinematics import Machine
from bayescal.numerics.geometry import Array
from rr8096.evidence import REFERENCE, ClaimEvidence, ClaimRows, judge
from rr8096.geometry import MICRO
from rr8096.identified import POINTS
from rr8096.least_squares import identify

IDENTIFIED = 0.5
"""A direction counts as identified where the poses at least halve its tolerance."""
SHARE = 0.3  # tolerance of a stiffness as a share of its nominal value
TOLERANCE = {"u_x": 0.05, "u_y": 0.05, "kappa": 0.01, "beta": 0.1}
LENGTH_TOLERANCE = 2.0  # mm
WITH_DIRECTION = (*POINTS, "l", "u_x")
WITH_KAPPA = (*POINTS, "l", "kappa")
LENGTHS = ("a_z", "b_z", "l")
STIFFNESSES = ("k1_d", "k2_d", "k3_d", "k1_l", "k2_l", "k3_l")
EVERYTHING = ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "u_x", "u_y", "l", "rho0")
HOW = "Narrowing of the tolerance (2 mm for lengths, 0.05 for u, 0.01 for κ) by the calibration poses, by information"
RULE = f"a direction counts as identified from {100 * IDENTIFIED:.0f} % on."


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def one_of_lengths(evidence: ClaimEvidence) -> ClaimRows:
    """Section 6.3.1, eq. (36): one of a_z, b_z and l."""
    machine = evidence.best_machine()
    free = WITH_KAPPA if "kappa" in machine.layout.index else WITH_DIRECTION
    together = compute_contraction(evidence, machine, (*free, "a_z", "b_z"), LENGTHS)
    alone = compute_contraction(evidence, machine, LENGTHS, LENGTHS)
    first, second = float(together[:, 0].min()), float(together[:, 1].max())
    yield ClaimRow(
        claim="one_of_lengths",
        section="6.3.1",
        statement="Of a_z, b_z and l of a leg only one can be identified.",
        expected="one direction of three",
        found=f"one direction narrowed by {_percent(first)} or more, the other two by {_percent(second)} at most",
        value=second,
        unit="1",
        verdict=judge(first > IDENTIFIED > second),
        reason=f"{HOW}; {RULE} Were a_x, a_y, b_x, b_y known, all three could be told "
        f"({_percent(float(alone[:, -1].min()))} or more): λ is not constant enough to explain it alone.",
    )


def null_direction(evidence: ClaimEvidence) -> ClaimRows:
    """Section 6.3.1: moving along what cannot be identified changes no leg length."""
    machine, noise = evidence.best_machine(), MICRO * evidence.target_noise
    layout = machine.layout
    free = WITH_KAPPA if "kappa" in layout.index else WITH_DIRECTION
    slope, _ = evidence.linearise(machine, evidence.identified(machine))
    alone, followed = 0.0, 0.0
    for leg in range(evidence.mechanism.n_legs):
        columns = slope[:, leg, [layout.index[s][leg] for s in LENGTHS]]
        others = slope[:, leg, [layout.index[s][leg] for s in free if s != "l"]]
        for direction in np.linalg.svd(columns, full_matrices=False)[2][1:]:
            change = columns @ direction
            rest = change - others @ np.linalg.lstsq(others, change, rcond=None)[0]
            alone, followed = max(alone, np.abs(change).max()), max(followed, np.abs(rest).max())
    alone, followed = MICRO * float(alone), MICRO * float(followed)
    yield ClaimRow(
        claim="null_direction",
        section="6.3.1",
        statement="A millimetre along the two hidden combinations of a_z, b_z and l changes no leg length noticeably.",
        expected=f"less than the noise of {noise:g} µm",
        found=f"{alone:.1f} µm at most; {followed:.2f} µm once the leg's other parameters follow",
        value=followed,
        unit="µm",
        verdict=judge(followed < noise),
        reason="Identified 6-PUS at the calibration poses.",
    )


def parameters_per_leg(evidence: ClaimEvidence) -> ClaimRows:
    """Section 7.1.1: six parameters per leg."""
    machine = evidence.machine(REFERENCE)
    if machine is None:
        return
    fit, n_legs = identify(machine, evidence.poses, EVERYTHING), evidence.mechanism.n_legs
    yield ClaimRow(
        claim="parameters_per_leg",
        section="7.1.1",
        statement="Six parameters of a leg can be identified.",
        expected="6 per leg",
        found=f"{fit.n_identified} directions of {len(EVERYTHING) * n_legs} parameters, "
        f"{fit.n_identified / n_legs:g} per leg",
        value=fit.n_identified / n_legs,
        unit="1",
        verdict=judge(fit.n_identified == 6 * n_legs),
        reason="All of a, b, u, l and ρ^0 free in the 6-PUS: directions a unit of which, 1 mm or 0.01, moves the "
        "residuals by more than their noise.",
    )


def one_of_directions(evidence: ClaimEvidence) -> ClaimRows:
    """Sections 7.1.1 and 7.1.2: one component of u."""
    for model, section, what in (
        (REFERENCE, "7.1.1", "6-PUS without deformation, all else free; with model error the second narrows less."),
        ("jacobian", "7.1.2", "Jacobian-based model without deformation, all else free; it knows u by z · u alone."),
    ):
        machine = evidence.machine(model)
        if machine is None:
            continue
        free, chosen = (*WITH_DIRECTION, "u_y"), ("u_x", "u_y")
        found = compute_contraction(evidence, machine, free, chosen)
        other = compute_contraction(evidence, machine, free, chosen, evidence.identified(machine))
        yield _one_of_two(
            f"one_of_directions_{model}",
            section,
            "Of the two components of an actuator's direction only one can be identified.",
            found,
            f"{what} Noise reaches the legs by the nominal machine; by the identified one it would be "
            f"{_percent(float(other[:, 1].max()))} at most.",
        )


def kappa_and_direction(evidence: ClaimEvidence) -> ClaimRows:
    """Sections 7.2 and 7.3: κ and u_x."""
    for deformation, section, what in (("linear", "7.2", "κ"), ("matrix", "7.3", "the diagonal of K")):
        machine = evidence.machine(REFERENCE, deformation)
        if machine is None:
            continue
        found = compute_contraction(evidence, machine, (*WITH_KAPPA, "u_x"), ("u_x", "kappa"))
        yield _one_of_two(
            f"kappa_and_direction_{deformation}",
            section,
            f"Of {what} and u_x only one can be identified.",
            found,
            f"6-PUS with the {deformation} deformation, all else free.",
        )


def _one_of_two(claim: str, section: str, statement: str, contraction: Array, reason: str) -> ClaimRow:
    first, second = float(contraction[:, 0].min()), float(contraction[:, 1].max())
    return ClaimRow(
        claim=claim,
        section=section,
        statement=statement,
        expected="one direction of two",
        found=f"one direction narrowed by {_percent(first)} or more, the other by "
        f"{_percent(float(contraction[:, 1].min()))} to {_percent(second)}",
        value=second,
        unit="1",
        verdict=judge(first > IDENTIFIED > second),
        reason=f"{HOW}; {RULE} {reason}",
    )


def initial_positions(evidence: ClaimEvidence) -> ClaimRows:
    """Section 7.1.2: singular values with and without ρ^0."""
    machine = evidence.machine("jacobian")
    if machine is None:
        return
    free, held = (_singular_values(evidence, machine, s) for s in ((*WITH_DIRECTION, "rho0"), WITH_DIRECTION))
    rounding = float(len(free) * np.finfo(float).eps * free[0])
    null = int(np.sum(free < rounding))
    how = (
        "Singular values of JᵀJ of the Jacobian-based closure at its identified parameters and the calibration poses; "
        "absolute, in mm (u without unit)"
    )
    yield ClaimRow(
        claim="initial_positions_free",
        section="7.1.2",
        statement="With ρ^0 free six singular values of JᵀJ are under 1e-14.",
        expected="6 below 1e-14",
        found=f"{null} are zero to rounding (below {rounding:.0e}, the largest is {free[0]:.0f}), the next is "
        f"{free[-null - 1]:.1e}",
        value=float(null),
        unit="1",
        verdict=judge(null == evidence.mechanism.n_legs),
        reason=f"{how}. A joint moved along its leg, with ρ^0 and l, leaves the model as it is.",
    )
    smallest = float(held[-1])
    yield ClaimRow(
        claim="initial_positions_held",
        section="7.1.2",
        statement="Without ρ^0 the smallest singular value of JᵀJ is 1e-4.",
        expected="1e-4",
        found=f"{smallest:.1e}, {smallest / held[0]:.0e} of the largest",
        value=smallest,
        unit="1",
        verdict=judge(round(np.log10(smallest)) == -4),
        reason=f"{how}, to the order of ten. In metres it is {_singular_values_in_metres(evidence, machine):.0e}.",
    )


def _closure_jacobian(evidence: ClaimEvidence, machine: Machine, symbols: tuple[str, ...]) -> tuple[Array, np.ndarray]:
    poses, index = evidence.poses, np.concatenate([machine.layout.index[s] for s in symbols])
    here = machine.linearise(evidence.identified(machine), poses.position, poses.rotation, poses.actuators)
    return here.parameters[..., index].reshape(-1, len(index)), index


def _singular_values(evidence: ClaimEvidence, machine: Machine, symbols: tuple[str, ...]) -> Array:
    """Return the singular values of JᵀJ as it is formed, rounding and all, largest first."""
    jacobian, _ = _closure_jacobian(evidence, machine, symbols)
    return np.linalg.svd(jacobian.T @ jacobian, compute_uv=False)


def _singular_values_in_metres(evidence: ClaimEvidence, machine: Machine) -> float:
    """Return the smallest singular value with residuals and lengths in metres: the columns of u shrink."""
    jacobian, index = _closure_jacobian(evidence, machine, WITH_DIRECTION)
    jacobian = jacobian * np.where(np.array(machine.layout.units)[index] == "mm", 1.0, 1e-3)
    return float(np.linalg.svd(jacobian.T @ jacobian, compute_uv=False)[-1])


def beam_parameters(evidence: ClaimEvidence) -> ClaimRows:
    """Section 7.1.3: β and l_b."""
    machine = evidence.machine("beam")
    if machine is None:
        return
    largest = float(compute_contraction(evidence, machine, (*WITH_DIRECTION, "beta", "l_b"), ("beta", "l_b")).max())
    yield ClaimRow(
        claim="beam_parameters",
        section="7.1.3",
        statement="Neither β nor the length l_b of the flexures can be identified.",
        expected="nothing learnt",
        found=f"narrowed by {_percent(largest)} at most",
        value=largest,
        unit="1",
        verdict=judge(largest < IDENTIFIED),
        reason=f"{HOW}, 0.1 for β; {RULE} Beam model without deformation.",
    )


def stiffness_parameters(evidence: ClaimEvidence) -> ClaimRows:
    """Section 7.1.4: stiffness."""
    machine = evidence.machine("stiffness")
    if machine is None:
        return
    largest = float(compute_contraction(evidence, machine, (*WITH_DIRECTION, *STIFFNESSES), STIFFNESSES).max())
    yield ClaimRow(
        claim="stiffness_parameters",
        section="7.1.4",
        statement="None of the six stiffness parameters can be identified.",
        expected="nothing learnt",
        found=f"a tolerance of 30 % narrowed by {_percent(largest)} at most",
        value=largest,
        unit="1",
        verdict=judge(largest < IDENTIFIED),
        reason=f"{HOW}; {RULE} Stiffness model without deformation. The report's own objective is least for no "
        "stiffness at all, so that it cannot identify any either.",
    )


CLAIMS = (
    one_of_lengths,
    null_direction,
    parameters_per_leg,
    one_of_directions,
    initial_positions,
    beam_parameters,
    stiffness_parameters,
    kappa_and_direction,
)


def tolerance_of(machine: Machine) -> Array:
    """Return the standard deviation (D,) within which each parameter is known a priori."""
    layout = machine.layout
    sd = np.empty(layout.size)
    for block in layout.blocks:
        size = TOLERANCE.get(block.symbol, LENGTH_TOLERANCE)
        nominal = np.array(block.nominal)
        sd[layout.index[block.symbol]] = size if block.unit in ("mm", "1") else SHARE * np.abs(nominal)
    return sd


def compute_contraction(
    evidence: ClaimEvidence, machine: Machine, free: Sequence[str], chosen: Sequence[str], carrier: Array | None = None
) -> Array:
    """Return by how much the calibration poses narrow some parameters of a leg, all free ones unknown.

    Parameters
    ----------
    evidence : ClaimEvidence
    machine : Machine
        Linearised at its identified parameters, with the poses' noise and no model error.
    free : sequence of str
        What is unknown, each within its tolerance.
    chosen : sequence of str
        The parameters to look at, in all directions of their common space.
    carrier : ndarray, shape (D,), optional
        The machine by which the noise reaches the legs, instead of the nominal one.

    Returns
    -------
    ndarray, shape (N, K)
        1 - sd after / sd before along the principal directions of each leg, largest first; for parameters of the
        whole machine one row. Zero says nothing was learnt, one everything.
    """
    layout, sd = machine.layout, tolerance_of(machine)
    slope, noise = evidence.linearise(machine, evidence.identified(machine), carrier)
    index = np.concatenate([layout.index[symbol] for symbol in free])
    slope = slope[..., index] * sd[index]
    data = np.einsum("pik,pij,pjm->km", slope, np.linalg.inv(noise), slope, optimize=True)
    covariance = np.linalg.inv(data + np.eye(len(index)))
    place = {position: k for k, position in enumerate(index)}
    groups = np.stack([layout.index[symbol] for symbol in chosen], axis=1)
    rows = []
    for group in groups:
        at = [place[position] for position in group]
        rows.append(1.0 - np.sqrt(np.maximum(np.linalg.eigvalsh(covariance[np.ix_(at, at)]), 0.0)))
    return np.array(rows)
