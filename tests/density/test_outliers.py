"""Densities of rows that may be wrong: what they promise of each other, against differences and quadrature.

Poses that may be outliers: planted ones are found, and do no harm.
"""

from dataclasses import replace

import numpy as np
import pytest
import telescope_machines as machines
from scipy import integrate, stats

from bayescal.density.calibration.terms import ErrorModel, ModelErrorTerm
from bayescal.density.outliers import FREEDOM, NORMAL, WIDER, Contaminated, StudentT
from bayescal.density.priors import SharePrior
from bayescal.inference.mode import find_modes
from bayescal.machines.kinematics import solve_forward_kinematics

FAMILY = {
    "normal": NORMAL,
    "t": StudentT(4.0),
    "t, centred": StudentT.centred(4.0),
    "contaminated": Contaminated(SharePrior(0.1)),
}
ZETA = np.array([[-0.4], [0.7]])
SPARE = np.array([1, 3, 6])
SQUARE = np.array([[0.3, 4.0, 20.0], [2.0, 9.0, 40.0]])
PRIOR = SharePrior(0.02)
STEP = 1e-5
SCALES = np.arange(0.7, 1.2, 0.005)


@pytest.fixture(params=FAMILY.values(), ids=FAMILY)
def outliers(request):
    """Return one of the family."""
    return request.param


@pytest.fixture
def rows(outliers):
    """Return its density at two values of what is unknown of it."""
    return outliers.at(ZETA[:, : len(outliers.names)])


def differ(function):
    return (function(STEP) - function(-STEP)) / (2.0 * STEP)


def test_the_density_integrates_to_one(rows):
    one = np.array([1])

    def density(r):
        return float(np.exp(rows.pick(slice(0, 1)).weigh(np.array([[r * r]]), one)[0, 0]))

    whole = integrate.quad(density, -np.inf, np.inf, limit=500)[0]
    assert whole == pytest.approx(1.0, abs=1e-6)


def test_trust_and_curvature_are_those_of_the_density(rows):
    by_square = differ(lambda h: rows.weigh(SQUARE + h, SPARE))
    np.testing.assert_allclose(rows.trust(SQUARE, SPARE), -2.0 * by_square, rtol=1e-6)
    np.testing.assert_allclose(
        rows.soften(SQUARE, SPARE), -2.0 * differ(lambda h: rows.trust(SQUARE + h, SPARE)), rtol=1e-5, atol=1e-9
    )
    rest = rows.penalise(SQUARE, SPARE) + 2.0 * rows.weigh(SQUARE, SPARE)
    np.testing.assert_allclose(rest, 2.0 * rows.weigh(np.zeros_like(SQUARE), SPARE), rtol=1e-9)


def test_slopes_by_what_is_unknown_are_those_of_differences(outliers, rows):
    expected = [
        differ(lambda h, k=k: outliers.at(ZETA + h * np.eye(1)[k]).weigh(SQUARE, SPARE))
        for k in range(len(outliers.names))
    ]
    found = rows.slopes(SQUARE, SPARE)
    assert found.shape == (*SQUARE.shape, len(outliers.names))
    np.testing.assert_allclose(np.moveaxis(found, -1, 0), np.reshape(expected, (-1, *SQUARE.shape)), rtol=1e-6)


def test_without_a_spread_it_is_the_density_itself(rows):
    size = np.sqrt(SQUARE)[..., None] * np.eye(6)[0]
    found = rows.weigh_spread(size, np.zeros_like(size), SPARE)
    np.testing.assert_allclose(found, rows.weigh(SQUARE, SPARE), atol=1e-6)


def test_a_spread_is_integrated(rows):
    """One reading with a further normal error of known variance: the convolution."""
    one, variance = np.array([1]), 2.5
    rows = rows.pick(slice(0, 1))
    u = np.linspace(-60.0, 60.0, 240_001)
    inside = np.exp(rows.weigh((3.0 - u[None, :, None])[0] ** 2, one)[:, 0]) * stats.norm.pdf(u, 0.0, np.sqrt(variance))
    found = rows.weigh_spread(np.array([[[3.0]]]), np.array([[[variance]]]), one)[0, 0]
    assert np.exp(found) == pytest.approx(np.trapezoid(inside, u), rel=1e-6)


def test_widths_drawn_make_rows_of_that_density(rows, rng):
    """Residuals of unit noise times the root of drawn widths have the density's distribution function."""
    n = 40_000
    rows = rows.pick(slice(0, 1))
    drawn = rng.standard_normal(n) * np.sqrt(rows.draw_wide((1, n), rng)[0])
    grid = np.linspace(-8.0, 8.0, 8001)
    density = np.exp(rows.weigh(grid[:, None] ** 2, np.array([1]))[:, 0])
    inside = np.cumsum(density) * (grid[1] - grid[0])
    share = np.interp(2.0, grid, inside) - np.interp(-2.0, grid, inside)
    assert np.mean(np.abs(drawn) < 2.0) == pytest.approx(share, abs=0.01)


@pytest.mark.parametrize("freedom", [1.0, 4.0, 30.0])
def test_a_centred_t_scatters_about_the_stated_noise(freedom):
    """The logarithms of its rows' noise have mean zero."""
    rows = StudentT.centred(freedom)
    precision = stats.gamma(0.5 * freedom, scale=2.0 / (freedom * rows.width**2))
    assert precision.expect(np.log) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("spare", [1, 2, 3, 6])
def test_a_centred_t_finds_the_noise_of_normal_rows(spare):
    """The scale that has the largest mean log-density of clean rows; a t of the stated scale is up to 17 % off."""
    square = stats.chi2.ppf((np.arange(20_000) + 0.5) / 20_000, spare)

    def find_scale(rows):
        mean = [np.mean(rows.weigh(square / s**2, spare)) - spare * np.log(s) for s in SCALES]
        return SCALES[int(np.argmax(mean))]

    assert find_scale(StudentT.centred(4.0)) == pytest.approx(1.0, abs=0.055)
    assert find_scale(StudentT(4.0)) < 0.92


def test_widths_given_a_row_have_the_mean_precision_that_counts(rows, rng):
    square, spare = np.full((1, 60_000), 12.0), np.full(60_000, 3)
    rows = rows.pick(slice(0, 1))
    width = rows.draw_widening(square, spare, rng)
    assert np.mean(1.0 / width) == pytest.approx(rows.trust(square, spare)[0, 0], rel=0.02)


def test_wrong_rows_are_t_distributed(rng):
    spread = rng.standard_normal((6, 6))
    covariance = spread @ spread.T + np.eye(6)
    errors = 10.0 * rng.standard_normal((20, 6))
    square = np.einsum("bi,ij,bj->b", errors, np.linalg.inv(covariance), errors)
    wrong = stats.multivariate_t(np.zeros(6), WIDER**2 * covariance, FREEDOM).logpdf(errors)
    normal = stats.multivariate_normal(np.zeros(6), covariance).logpdf(errors)
    zeta = np.array([[0.3]])
    share = PRIOR.value(zeta[0])
    np.testing.assert_allclose(
        Contaminated(PRIOR).at(zeta).weigh(square[None], 6)[0] - NORMAL.weigh(square, 6),
        np.logaddexp(np.log1p(-share) + normal, np.log(share) + wrong) - normal,
        rtol=1e-9,
        atol=1e-9,
    )


# --- what it is for --------------------------------------------------------------------------------------------------

SMALLEST, LARGEST = 0.05, 1.0  # mm
MACHINE = machines.build_machine("matrix")
TRUTH = machines.telescope_truth(MACHINE)


def simulate(seed):
    """Return 40 simulated poses of the telescope, with a model error of 1 µm."""
    rng = np.random.default_rng(seed)
    return machines.simulate_poses(MACHINE, TRUTH, machines.table_3_actuators(), np.full(6, 1e-3), rng)


def spoil(poses, rng):
    """Return poses of which two are off by 0.05 to 1 mm somewhere, and which."""
    which = rng.choice(poses.n_poses, 2, replace=False)
    size = np.exp(rng.uniform(np.log(SMALLEST), np.log(LARGEST), 2))
    way = rng.standard_normal((2, 3))
    position = poses.position.copy()
    position[which] += (size / np.linalg.norm(way, axis=1))[:, None] * way
    return replace(poses, position=position), set(which.tolist())


def build(poses, outliers=NORMAL):
    return machines.build_posterior("matrix", poses, machines.let_err(outliers=outliers)).with_pose_guesses()


def suspect(poses, rng):
    """Return how probable it is that each calibration pose is an outlier, by draws of Laplace's approximation."""
    posterior = build(poses, Contaminated(PRIOR))
    mode = find_modes(posterior)[0]
    y = mode.y + rng.standard_normal((100, len(mode.y))) @ np.linalg.cholesky(mode.covariance).T
    theta, errors, zeta = posterior.at(y)
    square = posterior.likelihood.explain(theta, errors, zeta)[1].square
    return errors.tails(zeta).suspect(square, posterior.likelihood.n_spare).mean(axis=0)


def find_planted(seeds):
    """Return how many of the planted outliers were found, of how many, and false alarms of how many clean poses."""
    found, false, n = 0, 0, 0
    for seed in seeds:
        rng = np.random.default_rng(seed)
        poses, planted = spoil(simulate(seed), rng)
        named = set(np.flatnonzero(suspect(poses, rng) > 0.5).tolist())
        found, false, n = found + len(named & planted), false + len(named - planted), n + poses.n_poses - 2
    return found, 2 * len(seeds), false, n


def test_planted_outliers_are_found():
    found, planted, false, _ = find_planted(range(3))
    assert found == planted
    assert false == 0


@pytest.mark.slow
def test_planted_outliers_of_many_twins_are_found():
    found, planted, false, n = find_planted(range(100, 200))
    assert found >= 0.95 * planted
    assert false < 0.01 * n


def measure_error(posterior, poses):
    """Return the rms error, mm, of the positions that a posterior's mode predicts at poses, seen by the truth."""
    theta = posterior.theta(find_modes(posterior)[0].y[None])[0]
    found, expected = (solve_forward_kinematics(MACHINE, one, poses.actuators).position for one in (theta, TRUTH))
    return float(np.sqrt(np.mean((found - expected) ** 2)))


def test_one_pose_a_millimetre_off_does_no_harm():
    """Its error enters a plain posterior's predictions, whether τ takes it or not."""
    twin = simulate(4)
    position = twin.position.copy()
    position[7, 0] += 1.0
    poses = replace(twin, position=position)
    clean, plain = (measure_error(build(one), twin) for one in (twin, poses))
    assert plain > 3.0 * clean
    assert measure_error(build(poses, Contaminated(PRIOR)), twin) < 1.2 * clean
    assert suspect(twin, np.random.default_rng(1)).max() < 0.5


def test_every_unknown_of_an_error_model_has_its_term():
    """Outliers come last and belong to no term."""
    own = ModelErrorTerm("motor", np.ones(2, dtype=bool), 1.0, "mm")
    model = ErrorModel((own, own), Contaminated(SharePrior(0.1)))
    assert len(model.owners) == len(model.names) == len(model.priors) == 3
    assert model.owners == (own, own, None)
