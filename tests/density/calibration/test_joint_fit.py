"""Least squares of machine and poses along ridges: the telescope's legs, whose directions some poses hardly tell."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bayescal.density.calibration.joint_fit import JointFit
from bayescal.experiments.audit.design import load_audit, read_plans

DESIGN = Path(__file__).parents[3] / "experiments" / "audit" / "telescope_six_pus_none.toml"


@pytest.fixture(scope="module")
def plan():
    (found,) = read_plans(load_audit(DESIGN), DESIGN.parent).values()
    return found.without_systematic_errors()


@pytest.mark.parametrize("seed", [2, 5])
def test_a_fit_from_nominal_ends_where_one_from_the_truth_does(plan, seed, monkeypatch):
    """In few steps: damped by the scale of what is known well a fit creeps along ridges, with a hundred."""
    steps, propose = [], JointFit._propose
    monkeypatch.setattr(JointFit, "_propose", lambda *a: steps.append(0) or propose(*a))
    rng, variant, posterior = np.random.default_rng(seed), plan.variant, plan.posterior
    truth = rng.standard_normal(len(plan.names))
    values = variant.model.read(posterior.sampling.theta_from_y(truth[None])[0], variant.start, variant.data.given)
    values = values + variant.data.sd * rng.standard_normal(values.shape)
    found = replace(variant, data=replace(variant.data, values=values)).posterior()
    fit = JointFit(found.likelihood, found.sampling, found.errors, plan.expected[len(plan.names) :])
    ends = [fit.run(start, variant.start) for start in (np.zeros(len(truth)), truth)]
    assert len(steps) < 100  # of both
    cost = [float(y @ y) + _square(found, y, pose) for y, pose in ends]
    assert cost[0] == pytest.approx(cost[1], abs=1e-3)


def _square(posterior, y, pose):
    """Return the sum of the readings' squared deviations in units of their noise."""
    likelihood = posterior.likelihood
    read = likelihood.model.read(posterior.sampling.theta_from_y(y[None])[0], pose, likelihood.data.given)
    white = likelihood.whiten(likelihood.sd[None], np.zeros((1, 1, likelihood.sd.shape[1])))
    error = likelihood.comparison.subtract(likelihood.data.values, read)
    return float(np.sum(white.rows(error[None, ..., None]) ** 2))
