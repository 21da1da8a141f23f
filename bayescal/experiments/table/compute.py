"""Computing a look-up table: the posterior of its study, then what actuators and pose do at every place."""

from __future__ import annotations

import numpy as np

from bayescal.errors import NumericalError
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.experiments.shared.estimate import Estimate, estimate_posterior
from bayescal.experiments.shared.reading_slips import find_calibration_slip
from bayescal.experiments.table.inputs import TableInputs
from bayescal.experiments.table.plan import plan_measurements
from bayescal.experiments.table.polynomial import build_terms, fit_polynomial, format_polynomial
from bayescal.experiments.table.responses import measure_elsewhere, respond
from bayescal.experiments.table.tables import Found, summarise, tabulate

POLYNOMIAL_FILE = "polynomial.json"
ELSEWHERE = 64  # poses of the workspace


def compute_table(inputs: TableInputs, run: Run) -> Results:
    """Return the table of a study.

    Raises
    ------
    NumericalError
        Where the posterior did not converge and nobody forces it.
    """
    estimate = run.once("posterior", _estimate, inputs, (Estimate,))
    problems = estimate.list_problems()
    if problems and not inputs.config.force:
        found = f"variant {inputs.variant.name!r} did not converge ({'; '.join(problems)})"
        raise NumericalError(f"{found}, expected one that did, or --force")
    table = find_table(inputs, estimate.kept, estimate.mode)
    actuators = inputs.actuators.channels
    text = format_polynomial(table.polynomial, inputs.actuators.names, [one.unit for one in actuators])
    summary, slip = summarise(inputs, table, problems), find_calibration_slip([inputs.variant.suspicion()])
    summary |= {} if slip is None else {"slip": slip.record()}
    return Results(summary, tabulate(inputs, table), {POLYNOMIAL_FILE: text})


def _estimate(inputs: TableInputs) -> Estimate:
    """Return the posterior as the study finds it, draw by draw."""
    config = inputs.study.config
    posterior = inputs.variant.posterior().anchored()
    return estimate_posterior(posterior, config.seed, inputs.variant.name, config.sampler, config.evidence)


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
