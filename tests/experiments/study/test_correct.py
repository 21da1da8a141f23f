"""Corrected evidence and draws of small calibrations against sums of the exact density over a grid."""

from __future__ import annotations

import numpy as np
import pytest
import telescope_machines as machines

from bayescal.experiments.study.readings import weigh_beside
from bayescal.inference.correction import correct_draws, correct_evidence, move_sample, sample_exactly
from bayescal.inference.exploration import explore
from bayescal.inference.importance import estimate_by_importance
from bayescal.inference.sampling import sample_posterior

CASES = [("six_pus", "matrix"), ("jacobian", "linear"), ("beam", "none"), ("stiffness", "linear")]
REACH, N_NODES, SCALE = 5.0, 11, 0.01  # standard deviations to either side; steps of one lose 1e-8 of a normal


def draw_small(model, deformation, seed):
    """Return a calibration with two free lengths and one model error for all legs, all else as it truly is."""
    rng = np.random.default_rng([seed, len(model)])
    machine = machines.build_machine(deformation, model=model)
    layout, actuators, theta = machine.layout, machines.table_3_actuators()[:12], machine.layout.nominal.copy()
    for symbol in machines.FREE_SYMBOLS[deformation]:
        index = layout.index[symbol]
        theta[index] += machines.PRIOR_SD.get(symbol, 2.0) * rng.standard_normal(len(index))
    poses = machines.simulate_poses(machine, theta, actuators, np.abs(SCALE * rng.standard_normal(6)), rng)
    every = machines.list_priors(machine, ("l",))
    free = {name: every[name] for name in ("l[1]", "l[4]")}
    fixed = {name: theta[k] for k, name in enumerate(layout.names) if name not in free}
    return machines.measure(machine, poses, free, machines.let_err(SCALE, shared=True), fixed).anchored()


def look(model, deformation, seed):
    """Return a calibration as it was explored, and the density that leaves nothing out."""
    found = explore(draw_small(model, deformation, seed), np.random.SeedSequence(1))
    return found, weigh_beside(found.straight.posterior, found)


def integrate(density, found):
    """Return log-evidence and means in straight coordinates by a sum over a grid around the proposal's centre."""
    centre, factor = found.proposal.means[0], found.proposal.factors[0]
    line = np.linspace(-REACH, REACH, N_NODES)
    nodes = np.stack(np.meshgrid(*[line] * len(centre), indexing="ij"), axis=-1).reshape(-1, len(centre))
    x = centre + nodes @ factor.T
    values = density.log_density(x)
    top = values.max()
    mass = np.exp(values - top)
    step = np.linalg.slogdet(factor)[1] + len(centre) * np.log(line[1] - line[0])
    return np.log(mass.sum()) + top + step, mass @ x / mass.sum()


@pytest.mark.parametrize(("model", "deformation"), CASES)
def test_corrected_evidence_is_that_of_the_exact_density(model, deformation):
    found, costly = look(model, deformation, 5)
    explored = estimate_by_importance(found.straight.log_density, found.proposal, np.random.default_rng(2), 5000)
    correction = correct_evidence(costly, found, np.random.SeedSequence(3))
    expected, _ = integrate(costly, found)
    error = np.hypot(explored.standard_error, correction.standard_error)
    assert error < 0.05
    assert explored.log_evidence + correction.log_ratio == pytest.approx(expected, abs=4 * error)


def test_moved_draws_and_ensembles_on_the_exact_density_have_its_means():
    found, costly = look("six_pus", "matrix", 6)
    sample = sample_posterior(found, np.random.SeedSequence(2), 4, 32, 20, 80)
    correction = correct_draws(costly, found, sample, np.random.SeedSequence(3))
    moved = move_sample(sample, found, correction)
    walked = sample_exactly(costly, found, sample, correction.move, np.random.SeedSequence(4).spawn(4))
    _, mean = integrate(costly, found)
    for made, off in ((moved, 0.1), (walked, 0.25)):
        away = (made.straight.mean(axis=(0, 1, 2)) - mean) / made.straight.std(axis=(0, 1, 2))
        assert np.abs(away).max() < off
        np.testing.assert_allclose(made.natural, found.straight.posterior.natural(made.y))
    at = moved.straight[:, :8, -1].reshape(-1, 3)
    assert np.std(costly.log_density(at) - moved.log_density[:, :8, -1].ravel()) < 0.3
    at = walked.straight[0, 0]
    np.testing.assert_allclose(walked.log_density[0, 0], costly.log_density(at), rtol=1e-9)
