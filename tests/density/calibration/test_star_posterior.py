"""The posterior with its poses integrated out, against parameters and poses sampled together and closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from calibration_problems import pointwise
from numpy.polynomial.hermite_e import hermegauss
from reading_machines import (
    TOLERANCES,
    JointTarget,
    Sensors,
    Tolerances,
    draw_machines,
    find_poses_of,
    gaussian_log_evidence,
    sensors_of,
    small_posterior,
    star_density,
)
from sliding_platforms import SETS, WORKSPACE, sliding_star, star_of

from bayescal.density.calibration.terms import NO_ERRORS
from bayescal.density.posterior import Posterior
from bayescal.density.priors import NormalPrior
from bayescal.errors import InputError
from bayescal.inference.bridge import estimate_by_bridge
from bayescal.inference.exploration import explore
from bayescal.inference.importance import estimate_by_importance
from bayescal.inference.mode import find_modes
from bayescal.inference.sampling import sample_posterior

TINY = Tolerances(1e-3, *np.radians([1e-4, 1e-3]))


def sample(target, seed, steps=120):
    """Return draws in sampling coordinates (S, n), and the evidence by importance and by bridge sampling."""
    seeds = np.random.SeedSequence(seed).spawn(2)
    found = explore(target, seeds[0], 64)
    density = found.straight.log_density
    importance = estimate_by_importance(density, found.proposal, np.random.default_rng(seed), 4000)
    draws = sample_posterior(found, seeds[1], 4, 64, 20, steps)
    rng = np.random.default_rng(seed + 1)
    bridge = estimate_by_bridge(density, draws.straight, draws.log_density, rng, 4000, found.proposal)
    assert not draws.diagnostics.list_problems()
    return draws.y.reshape(-1, target.n_parameters), importance.log_evidence, bridge.log_evidence


def covariance_at(posterior, y):
    """Return the covariance of the coordinates to first order at y, shape (n, n)."""
    return np.linalg.inv(-posterior.gradient(y)[1])


# --- against the poses as unknowns -----------------------------------------------------------------------------------

JOINT = [
    pytest.param(3, ("s", "phi"), 6, id="three legs"),
    pytest.param(4, SETS[8], 10, id="8 sensors", marks=pytest.mark.slow),
    pytest.param(4, SETS[4], 20, id="4 sensors", marks=pytest.mark.slow),
    pytest.param(4, SETS[12], 15, id="12 sensors", marks=pytest.mark.slow),
    pytest.param(5, ("s", "psi"), 15, id="five legs", marks=pytest.mark.slow),
]


@pytest.mark.runs
@pytest.mark.parametrize(("n_legs", "names", "n_poses"), JOINT)
def test_parameters_and_poses_sampled_together_give_the_same(n_legs, names, n_poses):
    posterior = small_posterior(names, n_poses, 3, sliding_star() if n_legs == 4 else star_of(n_legs))
    joint = JointTarget(posterior)
    own, *evidence = sample(posterior, 1)
    both, *joint_evidence = sample(joint, 2)
    both = both[:, : posterior.n_parameters]
    assert np.abs((own.mean(axis=0) - both.mean(axis=0)) / own.std(axis=0)).max() < 0.1
    np.testing.assert_allclose(both.std(axis=0), own.std(axis=0), rtol=0.05)
    assert np.ptp([*evidence, *joint_evidence]) < 0.1


@pytest.mark.parametrize("names", SETS.values(), ids=[f"{n} sensors" for n in SETS])
def test_the_poses_follow_their_normal_given_the_parameters(names, rng):
    """Without any sampler: joint density by eliminated density times the pose's normal is one, wherever one looks."""
    posterior = small_posterior(names, 20, 5)
    joint = JointTarget(posterior)
    mode = find_modes(posterior)[0]
    y = mode.y + rng.standard_normal((300, posterior.n_parameters)) @ np.linalg.cholesky(mode.covariance).T
    theta = posterior.theta(y)
    pose = find_poses_of(posterior.likelihood, theta)
    slope = joint.sensors.linearise(theta[:, None], pose, with_parameters=False).by_pose
    factor = np.linalg.cholesky(np.linalg.inv(np.swapaxes(slope, -1, -2) @ slope))
    normal = rng.standard_normal(pose.shape)
    density = -0.5 * (normal**2).sum(axis=(1, 2)) - 30 * np.log(2 * np.pi) - np.linalg.slogdet(factor)[1].sum(axis=1)
    stands = joint.join(y, pose + np.einsum("bpij,bpj->bpi", factor, normal))
    log_joint = joint.log_density(stands) - np.linalg.slogdet(joint.unit)[1].sum()
    weight = log_joint - posterior.log_density(y) - density
    assert np.abs(weight).max() < 1e-2
    assert abs(weight.mean()) < 1e-4


def test_the_joint_density_of_the_tests_has_its_gradient():
    joint = JointTarget(small_posterior(SETS[8], 6, 3))
    y = joint.least_squares_start() + 1e-3
    steps = 1e-4 * np.eye(len(y))
    differences = (joint.log_density(y + steps) - joint.log_density(y - steps)) / 2e-4
    gradient = joint.gradient(y)[0]
    np.testing.assert_allclose(gradient, differences, rtol=0, atol=1e-7 * np.abs(gradient).max())


# --- closed forms ----------------------------------------------------------------------------------------------------


@pytest.mark.runs
@pytest.mark.parametrize("names", SETS.values(), ids=[f"{n} sensors" for n in SETS])
def test_evidence_has_the_closed_form_where_tolerances_are_tiny(names):
    n_poses = 20 if names == SETS[4] else 10  # just enough equations
    posterior = small_posterior(names, n_poses, 7, tolerances=TINY)
    likelihood = posterior.likelihood
    pose = find_poses_of(likelihood, posterior.sampling.start[None])[0]
    moves = posterior.around(posterior.least_squares_start())[1].T
    expected = gaussian_log_evidence(sensors_of(likelihood), likelihood.data.values, pose, moves, WORKSPACE.volume)
    _, importance, bridge = sample(posterior, 3, steps=25)
    assert importance == pytest.approx(expected, abs=0.02)
    assert bridge == pytest.approx(expected, abs=0.02)


def test_covariance_is_that_of_the_draws():
    posterior = small_posterior(SETS[8], 10, 9)
    draws, _, _ = sample(posterior, 4, steps=40)
    mode = posterior.least_squares_start()
    factor = np.linalg.cholesky(covariance_at(posterior, mode))
    white = np.linalg.solve(factor, (draws - mode).T)
    np.testing.assert_allclose(np.cov(white), np.eye(len(mode)), atol=0.1)


# --- gradient, coordinates -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("priors", "fixed", "common"),
    [
        ({"l[9]": 1.0}, {}, {}),
        ({"l[1]": 1.0}, {"x": 0.0}, {}),
        ({"l": 1.0}, {}, {"l": ("l[1]", "l[7]")}),
        ({"l": 1}, {}, {}),
    ],
)
def test_unknown_parameters_are_refused(priors, fixed, common):
    likelihood = small_posterior(SETS[8], 20, 11).likelihood
    with pytest.raises(InputError, match=r"^parameter.*x_P, y_P"):
        Posterior(
            likelihood, {k: NormalPrior(0.0, v) for k, v in priors.items()}, NO_ERRORS, fixed=fixed, common=common
        )


# --- the density of one pose's readings -----------------------------------------------------------------------------


def make(names, seed=2, model=None):
    """Return sensors, a likelihood of noisy readings, and machines within the tolerances."""
    model = model or sliding_star()
    rng = np.random.default_rng(seed)
    sensors, scale = Sensors.of(model, names), TOLERANCES.scale(model, names)
    pose = WORKSPACE.draw(model, rng)
    theta = draw_machines(model, scale, rng, 1)[0]
    measured = sensors.measure(theta, pose, rng)
    near = theta + 1e-3 * (draw_machines(model, scale, rng, 4) - model.layout.nominal)
    return sensors, star_density(sensors, measured, pose), near


@pytest.mark.parametrize("names", [*SETS.values(), ("s", "phi[2]")])
def test_it_is_the_integral_over_the_pose(names):
    """Gauss-Hermite quadrature over all three coordinates of each pose, with the machine itself."""
    sensors, likelihood, theta = make(names)
    nodes, weights = hermegauss(7)
    grid = np.stack(np.meshgrid(nodes, nodes, nodes, indexing="ij"), axis=-1).reshape(-1, 3)
    weight = (weights[:, None, None] * weights[:, None] * weights).ravel()
    pose = find_poses_of(likelihood, theta[:1])
    slope = sensors.linearise(theta[0], pose[0], with_parameters=False).by_pose
    factor = np.linalg.cholesky(np.linalg.inv(np.swapaxes(slope, 1, 2) @ slope))
    stand = pose[0][:, None] + np.einsum("pij,gj->pgi", factor, grid)
    error = (likelihood.data.values[:, None] - sensors.model.read(theta[0], stand)) / sensors.noise
    scale = -np.log(sensors.noise).sum() - 0.5 * len(sensors.noise) * np.log(2 * np.pi)
    inside = -0.5 * (error**2).sum(axis=-1) + 0.5 * (grid**2).sum(axis=-1)
    log_integral = np.log(np.sum(weight * np.exp(inside - inside[:, :1]), axis=1)) + inside[:, 0]
    expected = log_integral + scale + np.linalg.slogdet(factor)[1] - np.log(WORKSPACE.volume)
    np.testing.assert_allclose(pointwise(likelihood, theta[:1])[0], expected, rtol=0, atol=1e-4)


def test_the_density_is_normalised():
    """Integrated over all readings that the workspace gives, with volume elements of its own.

    Four readings s = h(v) + t u of a machine with three legs: v over the workspace, t across its image.
    """
    model = star_of(3)
    names = ("s", "phi[1]")
    sensors = Sensors.of(model, names)
    rng = np.random.default_rng(1)
    small = replace(WORKSPACE, n_poses=400, angle_deg=10.0)
    pose = small.draw(model, rng)
    nominal, direction = model.layout.nominal, np.array([0.0, 0.0, 0.0, 1.0])
    slope = sensors.model.linearise(nominal, pose, with_parameters=False).by_pose
    element = np.abs(np.linalg.det(np.concatenate([slope, np.broadcast_to(direction[:, None], (400, 4, 1))], axis=2)))
    width = 5.0 * sensors.noise[3]
    # what of t stands out of the image is seen less of, where the other readings make up for it
    steps = np.linspace(-8.0 * width, 8.0 * width, 161)
    total = np.zeros(400)
    for t in steps:
        measured = sensors.model.read(nominal, pose) + t * direction
        likelihood = star_density(sensors, measured, pose, small.volume)
        total += np.exp(pointwise(likelihood, nominal[None])[0]) * element * (steps[1] - steps[0])
    # E over v of ∫ p |ds/d(v, t)| dt, times the volume that v is drawn from
    assert total.mean() * small.volume == pytest.approx(1.0, abs=2e-3)
