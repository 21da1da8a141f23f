"""Computing a look-up table: the posterior of its study, then what actuators and pose do at every place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from bayescal.errors import InputError, NumericalError
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.runner.results import Results, Summary
from bayescal.experiments.shared.estimate import Estimate, estimate_posterior
from bayescal.experiments.table.inputs import (
    Plan,
    Polynomial,
    Responses,
    TableInputs,
    build_terms,
    fit_polynomial,
    format_polynomial,
    measure_elsewhere,
    plan_measurements,
    respond,
)
from bayescal.experiments.table.rows import (
    CorrectionCovarianceRow,
    CorrectionRow,
    LookupRow,
    OffsetCovarianceRow,
    OffsetRow,
    PlanRow,
    PolynomialTermRow,
)
from bayescal.machines.readings import Channel
from bayescal.numerics.geometry import Array

POLYNOMIAL_FILE = "polynomial.json"
ELSEWHERE = 64  # poses of the workspace
INTERVAL = (0.05, 0.95)


def compute_table(inputs: TableInputs, run: Run) -> Results:
    """Return the table of a study; NumericalError where the posterior did not converge and nothing allows it."""
    estimate = run.once("posterior", _estimate, inputs, (Estimate,))
    problems = estimate.list_problems()
    if estimate.is_preliminary:
        problems = ["preliminary answer, which no chain has checked", *problems]
    if problems and not inputs.config.allow_unconverged:
        found = f"variant {inputs.variant.name!r} did not converge ({'; '.join(problems)})"
        raise NumericalError(f"{found}; --allow-unconverged uses it")
    solution = _choose_solution(inputs, estimate)
    table = find_table(inputs, estimate.kept_of(solution), estimate.mode_of(solution))
    actuators = inputs.actuators.channels
    text = format_polynomial(table.polynomial, inputs.actuators.names, [one.unit for one in actuators])
    summary = summarise(inputs, table, problems)
    summary |= {} if inputs.slip is None else {"suspected_data_error": inputs.slip.record()}
    return Results(summary, tabulate(inputs, table), {POLYNOMIAL_FILE: text})


def _estimate(inputs: TableInputs) -> Estimate:
    """Return the posterior as the study finds it, draw by draw."""
    config = inputs.study.config
    posterior = inputs.variant.posterior().with_pose_guesses()
    return estimate_posterior(posterior, config.seed, inputs.variant.name, config.sampler, config.evidence)


def _choose_solution(inputs: TableInputs, estimate: Estimate) -> int:
    """Return which solution the table is of, from 0; InputError where there are several and none is named."""
    n, wanted = 1 + len(estimate.others), inputs.config.mode
    if (wanted is None and n > 1) or (wanted or 1) > n:
        shares = ", ".join(f"{100 * p:.1f} %" for p in estimate.solutions.probability[:n])
        raise InputError(
            f"variant {inputs.variant.name!r}: mode: found {wanted or 'none'}, expected 1 to {n} of the posterior's "
            f"solutions ({shares})"
        )
    return (wanted or 1) - 1


def find_table(inputs: TableInputs, draws: np.ndarray, mode: np.ndarray) -> TableOutcome:
    """Return the table of draws (T, n) of a posterior, in its coordinates, and of its mode (n,)."""
    posterior = inputs.variant.posterior().with_pose_guesses()
    responses = respond(inputs, posterior.theta(draws), inputs.cells)
    terms = build_terms(list(inputs.config.axes), inputs.reference, inputs.cells)
    covariance = np.atleast_2d(np.cov(draws[:, : posterior.n_geometry], rowvar=False))
    poses = inputs.variant.workspace.draw(ELSEWHERE, np.random.default_rng([inputs.config.seed, 22]))
    return TableOutcome(
        responses,
        fit_polynomial(terms, responses.correction),
        plan_measurements(inputs, posterior, mode, covariance),
        measure_elsewhere(inputs, posterior.theta(mode[None])[0], poses),
    )


@dataclass(frozen=True, eq=False)
class TableOutcome:
    """A table: responses of all draws, its polynomial, what to measure next, and Δq elsewhere in the workspace (n,)."""

    responses: Responses
    polynomial: Polynomial
    plan: Plan
    elsewhere: Array


def tabulate(inputs: TableInputs, found: TableOutcome) -> dict[str, pd.DataFrame]:
    """Return all tables; lengths in mm, angles in rad, columns of places in their own units."""
    actuators, coordinates = inputs.actuators.channels, inputs.variant.model.coordinates
    names, units = [one.name for one in actuators], [one.unit for one in actuators]
    pose_names, pose_units = [one.name for one in coordinates], [one.unit for one in coordinates]
    correction, offset = found.responses.correction, found.responses.offset
    polynomial, plan = found.polynomial, found.plan
    stems = [f"{one.stem}_{one.unit}" for one in map(Channel, names, units)]  # as a controller takes it: a row a place
    n_terms, n_cells = len(polynomial.terms), len(inputs.cells)
    places = {name: plan.cell[:, k] for k, name in enumerate(inputs.config.axes)}
    return {
        "lookup": LookupRow.tabulate(
            _places(inputs, 1) | dict(zip(stems, correction.mean(axis=0).T, strict=True)),
        ),
        "corrections": CorrectionRow.tabulate(
            _places(inputs, len(names)), actuator=names * n_cells, unit=units * n_cells, **_describe(correction)
        ),
        "correction_covariance": CorrectionCovarianceRow.tabulate(
            _places(inputs, _count_pairs(names)), **_relate(correction, names)
        ),
        "offsets": OffsetRow.tabulate(
            _places(inputs, len(pose_names)),
            coordinate=pose_names * n_cells,
            unit=pose_units * n_cells,
            **_describe(offset),
        ),
        "offset_covariance": OffsetCovarianceRow.tabulate(
            _places(inputs, _count_pairs(pose_names)), **_relate(offset, pose_names)
        ),
        "polynomial": PolynomialTermRow.tabulate(
            term=np.repeat(np.array(polynomial.terms, dtype=object), len(names)),
            actuator=names * n_terms,
            unit=units * n_terms,
            coefficient=polynomial.mean.reshape(-1),
            sd=polynomial.sd.reshape(-1),
        ),
        "plan": PlanRow.tabulate(
            places | {f"{one.name}_{one.unit}": plan.pose[:, k] for k, one in enumerate(coordinates)},
            order=np.arange(1, len(plan.after) + 1),
            sd=plan.after,
            max_sd=plan.worst,
            random_sd=plan.random,
        ),
    }


def _places(inputs: TableInputs, times: int) -> dict[str, Array]:
    """Return the columns of the axes, each place repeated."""
    return {name: np.repeat(inputs.cells[:, k], times) for k, name in enumerate(inputs.config.axes)}


def _describe(drawn: Array) -> dict[str, Array]:
    """Return mean, deviation and 90 % interval of each number (T, G, n), as columns."""
    low, high = np.quantile(drawn, INTERVAL, axis=0)
    columns = {"mean": drawn.mean(axis=0), "sd": drawn.std(axis=0, ddof=1), "q05": low, "q95": high}
    return {key: value.reshape(-1) for key, value in columns.items()}


def _count_pairs(names: Sequence[str]) -> int:
    return len(names) * (len(names) + 1) // 2


def _relate(drawn: Array, names: Sequence[str]) -> dict[str, object]:
    """Return the covariances of the numbers (T, G, n) of each place, the upper triangle row by row, as columns."""
    left = drawn - drawn.mean(axis=0)
    covariance = np.einsum("tgi,tgj->gij", left, left) / (len(drawn) - 1)
    first, second = (one.tolist() for one in np.triu_indices(len(names)))
    return {
        "first": [names[k] for k in first] * drawn.shape[1],
        "second": [names[k] for k in second] * drawn.shape[1],
        "covariance": covariance[:, first, second].reshape(-1),
    }


def summarise(inputs: TableInputs, found: TableOutcome, problems: list[str]) -> Summary:
    """Return what ``summary.json`` holds; lengths in mm, angles in rad."""
    config, study = inputs.config, inputs.study
    coordinates, offset = inputs.variant.model.coordinates, found.responses.offset
    low, high = np.quantile(offset, INTERVAL, axis=0)
    return {
        "experiment": config.name,
        "title": config.title,
        "origin": study.config.provenance.model_dump(),
        "machine": study.machine,
        "study": config.study,
        "variant": inputs.variant.name,
        "converged": not problems,
        "problems": problems,
        "n_draws": len(offset),
        "axes": {name: [min(values), max(values)] for name, values in config.axes.items()},
        "n_places": len(inputs.cells),
        "reference": inputs.reference,
        "pose": {one.name: float(x) for one, x in zip(coordinates, inputs.pose, strict=True)},
        "coordinates": {
            one.name: {
                "unit": one.unit,
                "max_offset": float(np.abs(offset.mean(axis=0)[:, k]).max()),
                "max_half_width_90": float(0.5 * (high - low)[:, k].max()),
            }
            for k, one in enumerate(coordinates)
        },
        "actuators": {
            one.name: {
                "unit": one.unit,
                "max_correction": float(np.abs(found.responses.correction.mean(axis=0)[:, k]).max()),
                "max_sd": float(found.responses.correction.std(axis=0, ddof=1)[:, k].max()),
                "polynomial_misfit": float(found.polynomial.misfit[k]),
                "max_difference_elsewhere": float(found.elsewhere[k]),
            }
            for k, one in enumerate(inputs.actuators.channels)
        },
        "prior_sd": found.plan.prior,
        "posterior_sd": float(np.sqrt(np.mean(found.responses.correction.var(axis=0, ddof=1)))),
        "sd_before_plan": found.plan.before,
        "sd_after_plan": float(found.plan.after[-1]),
        "sd_after_random": float(found.plan.random[-1]),
        "plan_include_existing_data": config.plan.include_existing_data,
    }
