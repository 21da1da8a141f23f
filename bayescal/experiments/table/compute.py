"""Computing a look-up table: the posterior of its study, then what actuators and pose do at every place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from bayescal.errors import InputError, NumericalError
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
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
from bayescal.machines.readings import Channel
from bayescal.numerics.geometry import Array

POLYNOMIAL_FILE = "polynomial.json"
ELSEWHERE = 64  # poses of the workspace
INTERVAL = (0.05, 0.95)


def compute_table(inputs: TableInputs, run: Run) -> Results:
    """Return the table of a study; NumericalError where the posterior did not converge and nobody forces it."""
    estimate = run.once("posterior", _estimate, inputs, (Estimate,))
    problems = estimate.list_problems()
    if problems and not inputs.config.force:
        found = f"variant {inputs.variant.name!r} did not converge ({'; '.join(problems)})"
        raise NumericalError(f"{found}, expected one that did; --force takes it all the same")
    solution = _choose_solution(inputs, estimate)
    table = find_table(inputs, estimate.kept_of(solution), estimate.mode_of(solution))
    actuators = inputs.actuators.channels
    text = format_polynomial(table.polynomial, inputs.actuators.names, [one.unit for one in actuators])
    summary = summarise(inputs, table, problems)
    summary |= {} if inputs.slip is None else {"slip": inputs.slip.record()}
    return Results(summary, tabulate(inputs, table), {POLYNOMIAL_FILE: text})


def _estimate(inputs: TableInputs) -> Estimate:
    """Return the posterior as the study finds it, draw by draw."""
    config = inputs.study.config
    posterior = inputs.variant.posterior().anchored()
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


def find_table(inputs: TableInputs, draws: np.ndarray, mode: np.ndarray) -> Found:
    """Return the table of draws (T, n) of a posterior, in its coordinates, and of its mode (n,)."""
    posterior = inputs.variant.posterior().anchored()
    responses = respond(inputs, posterior.theta(draws), inputs.cells)
    terms = build_terms(list(inputs.config.axes), inputs.reference, inputs.cells)
    covariance = np.atleast_2d(np.cov(draws[:, : posterior.n_geometry], rowvar=False))
    poses = inputs.variant.workspace.draw(ELSEWHERE, np.random.default_rng([inputs.config.seed, 22]))
    return Found(
        responses,
        fit_polynomial(terms, responses.correction),
        plan_measurements(inputs, posterior, mode, covariance),
        measure_elsewhere(inputs, posterior.theta(mode[None])[0], poses),
    )


@dataclass(frozen=True, eq=False)
class Found:
    """A table: responses of all draws, its polynomial, what to measure next, and Δq elsewhere in the workspace (n,)."""

    responses: Responses
    polynomial: Polynomial
    plan: Plan
    elsewhere: Array


def tabulate(inputs: TableInputs, found: Found) -> dict[str, pd.DataFrame]:
    """Return all tables; lengths in mm, angles in rad, columns of places in their own units."""
    actuators, coordinates = inputs.actuators.channels, inputs.variant.model.coordinates
    names, units = [one.name for one in actuators], [one.unit for one in actuators]
    pose_names, pose_units = [one.name for one in coordinates], [one.unit for one in coordinates]
    correction, offset = found.responses.correction, found.responses.offset
    polynomial, sd, plan = found.polynomial, found.polynomial.sd, found.plan
    stems = [f"{one.stem}_{one.unit}" for one in map(Channel, names, units)]  # as a controller takes it: a row a place
    lookup = dict(zip(stems, correction.mean(axis=0).T, strict=True))
    return {
        "lookup": pd.DataFrame({**_places(inputs, 1), **lookup}),
        "corrections": _describe(inputs, correction, "actuator", names, units),
        "correction_covariance": _relate(inputs, correction, names),
        "offsets": _describe(inputs, offset, "coordinate", pose_names, pose_units),
        "offset_covariance": _relate(inputs, offset, pose_names),
        "polynomial": pd.DataFrame(
            {"term": term, "actuator": name, "unit": unit, "coefficient": polynomial.mean[i, k], "sd": sd[i, k]}
            for i, term in enumerate(polynomial.terms)
            for k, (name, unit) in enumerate(zip(names, units, strict=True))
        ),
        "plan": pd.DataFrame(
            {
                "order": np.arange(1, len(plan.after) + 1),
                **{name: plan.cell[:, k] for k, name in enumerate(inputs.config.axes)},
                **{f"{one.name}_{one.unit}": plan.pose[:, k] for k, one in enumerate(coordinates)},
                "sd_after": plan.after,
                "largest_sd_after": plan.worst,
                "sd_after_random": plan.random,
            }
        ),
    }


def _places(inputs: TableInputs, times: int) -> dict[str, Array]:
    """Return the columns of the axes, each place repeated."""
    return {name: np.repeat(inputs.cells[:, k], times) for k, name in enumerate(inputs.config.axes)}


def _describe(inputs: TableInputs, drawn: Array, what: str, names: Sequence[str], units: Sequence[str]) -> pd.DataFrame:
    """Return mean, deviation and 90 % interval of each number (T, G, n)."""
    low, high = np.quantile(drawn, INTERVAL, axis=0)
    columns = {"mean": drawn.mean(axis=0), "sd": drawn.std(axis=0, ddof=1), "q05": low, "q95": high}
    labels = {what: list(names) * len(inputs.cells), "unit": list(units) * len(inputs.cells)}
    values = {key: value.reshape(-1) for key, value in columns.items()}
    return pd.DataFrame({**_places(inputs, len(names)), **labels, **values})


def _relate(inputs: TableInputs, drawn: Array, names: Sequence[str]) -> pd.DataFrame:
    """Return the covariances of the numbers (T, G, n) of each place, the upper triangle row by row."""
    left = drawn - drawn.mean(axis=0)
    covariance = np.einsum("tgi,tgj->gij", left, left) / (len(drawn) - 1)
    first, second = (one.tolist() for one in np.triu_indices(len(names)))
    return pd.DataFrame(
        {
            **_places(inputs, len(first)),
            "first": [names[k] for k in first] * len(inputs.cells),
            "second": [names[k] for k in second] * len(inputs.cells),
            "covariance": covariance[:, first, second].reshape(-1),
        }
    )


def summarise(inputs: TableInputs, found: Found, problems: list[str]) -> dict[str, Any]:
    """Return what ``summary.json`` holds; lengths in mm, angles in rad."""
    config, study = inputs.config, inputs.study
    coordinates, offset = inputs.variant.model.coordinates, found.responses.offset
    low, high = np.quantile(offset, INTERVAL, axis=0)
    return {
        "experiment": config.name,
        "title": config.title,
        "origin": study.config.origin.model_dump(),
        "machine": study.machine,
        "study": config.study,
        "variant": inputs.variant.name,
        "converged": not problems,
        "problems": problems,
        "draws": len(offset),
        "axes": {name: [min(values), max(values)] for name, values in config.axes.items()},
        "places": len(inputs.cells),
        "reference": inputs.reference,
        "pose": {one.name: float(x) for one, x in zip(coordinates, inputs.pose, strict=True)},
        "coordinates": {
            one.name: {
                "unit": one.unit,
                "largest_offset": float(np.abs(offset.mean(axis=0)[:, k]).max()),
                "largest_half_width_90": float(0.5 * (high - low)[:, k].max()),
            }
            for k, one in enumerate(coordinates)
        },
        "actuators": {
            one.name: {
                "unit": one.unit,
                "largest_correction": float(np.abs(found.responses.correction.mean(axis=0)[:, k]).max()),
                "largest_sd": float(found.responses.correction.std(axis=0, ddof=1)[:, k].max()),
                "polynomial_misfit": float(found.polynomial.misfit[k]),
                "elsewhere": float(found.elsewhere[k]),
            }
            for k, one in enumerate(inputs.actuators.channels)
        },
        "sd_by_tolerances": found.plan.prior,
        "sd_by_data": float(np.sqrt(np.mean(found.responses.correction.var(axis=0, ddof=1)))),
        "sd_before_plan": found.plan.before,
        "sd_after_plan": float(found.plan.after[-1]),
        "sd_after_random": float(found.plan.random[-1]),
        "plan_beside_data": config.plan.beside_data,
    }
