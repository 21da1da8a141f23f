"""Errors that are several functions of the pose at once: density, conditionals and slopes against plain formulas."""

import numpy as np
import pytest
import telescope_machines as machines
from scipy.stats import multivariate_normal
from shares import run_rest

from bayescal.data.instruments.readings import PoseReadings
from bayescal.density import functions
from bayescal.density.errors import FunctionScales, LegErrors, ModelError
from bayescal.density.few_columns import LowRankComponents
from bayescal.density.functions import FunctionLikelihood
from bayescal.density.instruments import InstrumentLikelihood
from bayescal.density.legs import build_leg_posterior
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.prediction import draw_functions, predict_given
from bayescal.density.priors import HalfCauchyPrior, NormalPrior
from bayescal.density.sorts import SORTS
from bayescal.errors import InputError
from bayescal.numerics.geometry import rotation_vector_from_matrix

N_POSES, N_HELD = 9, 3
AMPLITUDES = np.array([*[2e-3] * 6, 8e-3, 5e-3, 9e-3, 4e-3])


@pytest.fixture(scope="module", params=["whole", "position"])
def two(request):
    """Return densities of calibration poses and of others, and a machine."""
    machine = machines.build_machine("none")
    actuators = machines.table_3_actuators()[: N_POSES + N_HELD]
    theta, rng = machines.telescope_truth(machine), np.random.default_rng(1)
    found = machines.simulate_poses(machine, theta, actuators, np.full(6, 2e-3), rng)
    lots = (slice(0, N_POSES), slice(N_POSES, None))
    if request.param != "position":
        made = [PoseLikelihood(machine, found.select(one), machines.ACTUATOR_NOISE).refined().refined() for one in lots]
        return *made, theta
    made = []
    for one in lots:
        own = found.select(one)
        values = np.concatenate([own.position, rotation_vector_from_matrix(own.rotation)], axis=1)
        values[:, 3:] = np.nan
        readings = PoseReadings(own.names, own.actuators, values, own.covariance)
        made.append(InstrumentLikelihood(machine, readings, machines.ACTUATOR_NOISE))
    return *made, np.concatenate([theta, np.zeros(12)])


WAYS = ["all columns", "few columns"]
FEW_AMONG_RUNS = pytest.mark.parametrize("joined", run_rest(WAYS, 1), indirect=True)


@pytest.fixture(params=WAYS)
def joined(request, two, monkeypatch):
    """Return the density of functions of calibration poses, by whole matrices or by few columns; others; a machine."""
    calibration, held, theta = two
    if request.param == "few columns":
        monkeypatch.setattr(functions, "MOST_ROWS", 20)
    likelihood = build(calibration, held)
    assert isinstance(likelihood.components, LowRankComponents) == (request.param == "few columns")
    return likelihood, held, theta


def build(base, *others, sorts=tuple(SORTS)):
    names = [name for one in (base, *others) for name in one.pose_names]
    return FunctionLikelihood(base, sorts, machines.ACTUATOR_RANGE, {name: k / 12 for k, name in enumerate(names)})


def plain_kernel(z, t, k, leg):
    """Return the sort k of functions of a leg, entry by entry."""
    n = len(z)
    result = np.empty((n, n))
    for p in range(n):
        for q in range(n):
            far = [np.exp(-0.5 * np.sum(one**2)) for one in (z[p] - z[q], z[p], z[q])]
            result[p, q] = [
                z[p] @ z[q],
                z[p, leg] * z[q, leg],
                far[0] - far[1] - far[2] + 1.0,
                min(t[p], t[q]) + 0.02,
            ][k]
    return result


def list_kernels(likelihood, held):
    """Return kernels of all poses by sort and leg (4, 6, P, P), normalised, and what few columns leave to each pose."""
    place = likelihood.place.join(likelihood.place_of(held))
    if isinstance(likelihood.components, LowRankComponents):
        shape = (6, len(place.time), len(place.time))
        made = likelihood.functions.between(place, place)
        return np.array([np.broadcast_to(one, shape) for one in made]), likelihood.functions.left
    z = np.concatenate([one.actuators for one in (likelihood.base, held)]) - machines.INITIAL_POSITION
    z, t = z / machines.ACTUATOR_RANGE, np.arange(N_POSES + N_HELD) / 12
    found = np.array([[plain_kernel(z, t, sort, leg) for leg in range(6)] for sort in range(4)])
    norm = np.diagonal(found, axis1=2, axis2=3)[..., :N_POSES].mean(axis=(1, 2))
    return found / norm[:, None, None, None], np.zeros(4)


def plain_normal(likelihood, held, theta, amplitudes):
    """Return rows of all poses, one behind the other, and their covariance by the plain formula."""
    both, (kernels, left) = (likelihood.base, held), list_kernels(likelihood, held)
    rows = np.concatenate([one.errors(theta[None])[0] for one in both])
    shown = np.concatenate([one.rows_of_legs * np.sqrt(one.actuator_weight)[:, None] for one in both])
    alone = np.sqrt(amplitudes[:6] ** 2 + amplitudes[6:] ** 2 @ left)
    n, k = rows.shape
    total = np.zeros((n, k, n, k))
    total[np.arange(n), :, np.arange(n)] = np.concatenate([one.error_covariance(alone) for one in both])
    for size, kernel in zip(amplitudes[6:], kernels, strict=True):
        total += size**2 * np.einsum("pki,ipq,qli->pkql", shown, kernel, shown)
    return rows.ravel(), total.reshape(n * k, -1), k


def test_density_is_that_of_all_rows_together(joined):
    likelihood, held, theta = joined
    rows, covariance, k = plain_normal(likelihood, held, theta, AMPLITUDES)
    own = slice(0, N_POSES * k)
    expected = multivariate_normal.logpdf(rows[own], cov=covariance[own, own])
    # constants of the base are those of its own density without functions
    alone = likelihood.base(theta[None], np.zeros(6))[0]
    constant = alone - sum(
        multivariate_normal.logpdf(one, cov=other)
        for one, other in zip(
            likelihood.base.errors(theta[None])[0], likelihood.base.error_covariance(np.zeros(6)), strict=True
        )
    )
    assert likelihood(theta[None], AMPLITUDES)[0] == pytest.approx(expected + constant, abs=1e-6)
    without = likelihood(theta[None], np.zeros(10))[0]
    assert without == pytest.approx(alone, abs=1e-6)


def test_vectors_some_at_a_time_have_the_densities_of_all_together(two, monkeypatch):
    calibration, held, theta = two
    likelihood = build(calibration, held)
    vectors = theta + 1e-4 * np.random.default_rng(4).standard_normal((7, len(theta)))
    vectors[3, 0] = np.nan  # no machine
    amplitudes = AMPLITUDES * np.linspace(0.5, 2.0, 7)[:, None]
    whole = likelihood(vectors, amplitudes)
    assert np.isneginf(whole[3])
    monkeypatch.setattr(functions, "AT_ONCE", 1)
    monkeypatch.setattr(functions, "FEWEST", 2)
    assert likelihood(vectors, amplitudes) == pytest.approx(whole, rel=1e-12)


def test_each_pose_given_all_others(joined):
    likelihood, held, theta = joined
    rows, covariance, k = plain_normal(likelihood, held, theta, AMPLITUDES)
    whole = likelihood(theta[None], AMPLITUDES)[0]
    for pose in (0, 4):
        rest = np.setdiff1d(np.arange(N_POSES * k), np.arange(pose * k, (pose + 1) * k))
        mine = np.arange(pose * k, (pose + 1) * k)
        given = covariance[np.ix_(mine, rest)] @ np.linalg.inv(covariance[np.ix_(rest, rest)])
        mean = given @ rows[rest]
        left = covariance[np.ix_(mine, mine)] - given @ covariance[np.ix_(rest, mine)]
        expected = -0.5 * (rows[mine] - mean) @ np.linalg.solve(left, rows[mine] - mean)
        square = likelihood.evaluate(theta[None], AMPLITUDES)[1][0, pose]
        assert -0.5 * square == pytest.approx(expected, rel=1e-7)
    assert np.isfinite(whole)


def test_held_back_poses_given_calibration(joined):
    likelihood, held, theta = joined
    rows, covariance, k = plain_normal(likelihood, held, theta, AMPLITUDES)
    known, other = np.split(np.arange(len(rows)), [N_POSES * k])
    given = covariance[np.ix_(other, known)] @ np.linalg.inv(covariance[np.ix_(known, known)])
    mean = given @ rows[known]
    left = covariance[np.ix_(other, other)] - given @ covariance[np.ix_(known, other)]
    deviation, predicted, _ = likelihood.predict(held, theta[None], AMPLITUDES[None])
    assert deviation[0].ravel() == pytest.approx(rows[other] - mean, abs=1e-9)
    blocks = np.einsum("qkql->qkl", left.reshape(N_HELD, k, N_HELD, k))
    assert predicted[0] == pytest.approx(blocks, rel=1e-6, abs=1e-12)
    # constants of single poses are those of their own density without functions
    known_noise = held.error_covariance(np.zeros(6))
    alone = held.pointwise(theta[None], np.zeros(6))[0]
    plain = [
        multivariate_normal.logpdf(one, cov=noise)
        for one, noise in zip(held.errors(theta[None])[0], known_noise, strict=True)
    ]
    twice, both = np.array([theta, theta]), np.array([AMPLITUDES, AMPLITUDES])
    found = predict_given(likelihood, held, twice, both, np.array([1]), np.random.default_rng(5))
    joint = multivariate_normal.logpdf(rows[other], mean, left) + np.sum(alone - plain)
    assert found.together == pytest.approx(np.full(2, joint), abs=1e-6)
    for pose in range(N_HELD):
        mine = slice(pose * k, (pose + 1) * k)
        single = multivariate_normal.logpdf((rows[other] - mean)[mine], cov=left[mine, mine])
        assert found.pointwise[:, pose] == pytest.approx(np.full(2, single + alone[pose] - plain[pose]), abs=1e-6)
    assert found.replicates.errors.shape == (1, N_HELD, 6)
    seen = held.gain @ (rows[other] - mean).reshape(N_HELD, k, 1)
    known_part = np.isfinite(found.replicates.errors[0])
    assert found.replicates.errors[0][known_part] == pytest.approx(seen[..., 0][known_part], abs=1e-9)
    assert known_part.all() == (likelihood.base.of_poses is not None)


def test_calibration_poses_are_predicted_without_themselves(joined):
    likelihood, held, theta = joined
    rows, covariance, k = plain_normal(likelihood, held, theta, AMPLITUDES)
    deviation, left = likelihood.leave_out(theta[None], AMPLITUDES[None])
    own = N_POSES * k
    for pose in (0, 5):
        mine = np.arange(pose * k, (pose + 1) * k)
        rest = np.setdiff1d(np.arange(own), mine)
        given = covariance[np.ix_(mine, rest)] @ np.linalg.inv(covariance[np.ix_(rest, rest)])
        assert deviation[0, pose] == pytest.approx(rows[mine] - given @ rows[rest], abs=1e-9)
        expected = covariance[np.ix_(mine, mine)] - given @ covariance[np.ix_(rest, mine)]
        assert left[0, pose] == pytest.approx(expected, rel=1e-6, abs=1e-12)
    found = predict_given(likelihood, None, theta[None], AMPLITUDES[None], np.array([0]), np.random.default_rng(5))
    assert found.pointwise == pytest.approx(likelihood.pointwise(theta[None], AMPLITUDES[None]), abs=1e-7)
    assert found.together is None


def test_white_rows_have_the_square_of_all_rows_together(joined):
    likelihood, held, theta = joined
    rows, covariance, k = plain_normal(likelihood, held, theta, AMPLITUDES)
    own = slice(0, N_POSES * k)
    slope = np.random.default_rng(2).standard_normal((N_POSES, k, 3))
    white = likelihood.whiten(AMPLITUDES)(np.concatenate([rows[own].reshape(N_POSES, k, 1), slope], axis=-1))
    both = np.concatenate([rows[own, None], slope.reshape(-1, 3)], axis=1)
    expected = both.T @ np.linalg.solve(covariance[own, own], both)
    assert white.shape == (N_POSES, k, 4)
    assert np.einsum("pki,pkj->ij", white, white) == pytest.approx(expected, rel=1e-6)


@FEW_AMONG_RUNS
def test_functions_drawn_given_the_data(joined):
    likelihood, held, theta = joined
    rows, covariance, k = plain_normal(likelihood, held, theta, AMPLITUDES)
    own = N_POSES * k
    n_draws = 4000
    machines_, scales = np.tile(theta, (n_draws, 1)), np.tile(AMPLITUDES, (n_draws, 1))
    mean, drawn = likelihood.draw(held, machines_, scales, np.random.default_rng(7))
    assert mean.shape == drawn.shape == (n_draws, 4, N_POSES + N_HELD, 6)
    kernels, _ = list_kernels(likelihood, held)
    shown = likelihood.base.rows_of_legs * np.sqrt(likelihood.base.actuator_weight)[:, None]
    for sort, leg in ((0, 2), (1, 4), (2, 1), (3, 0)):
        kernel = AMPLITUDES[6 + sort] ** 2 * kernels[sort, leg]
        across = np.einsum("qp,pk->qpk", kernel[:, :N_POSES], shown[:, :, leg]).reshape(len(kernel), -1)
        given = across @ np.linalg.inv(covariance[:own, :own])
        expected = given @ rows[:own]
        assert mean[0, sort, :, leg] == pytest.approx(expected, rel=1e-6, abs=1e-9)
        left = np.sqrt(np.maximum(np.diag(kernel - given @ across.T), 0.0))
        away = drawn[:, sort, :, leg] - expected
        assert np.abs(away.mean(axis=0)).max() < 4.5 * left.max() / np.sqrt(n_draws)
        assert away.std(axis=0) == pytest.approx(left, rel=0.06, abs=1e-9)
    several = draw_functions(likelihood, held, theta[None], AMPLITUDES[None], np.random.default_rng(8))
    assert several.mean == pytest.approx(mean[0].sum(axis=0), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("floors", [{}, {"linear": 0.01, "smooth": 0.003}])
def test_amplitudes_are_never_below_their_floors(floors):
    terms = [ModelError(0.01, True, 0.004), FunctionScales(tuple(SORTS), 0.02, floors)]
    errors = LegErrors.of_legs(2, terms)
    zeta = np.array([-30.0, -30.0, 0.3, -0.5, 0.1])
    found = errors.amplitudes(zeta)
    assert found[[0, 2, 4]] == pytest.approx(
        [0.004, floors.get("linear", 0.0), np.hypot(errors.natural(zeta)[3], floors.get("smooth", 0.0))], abs=1e-12
    )
    assert errors.amplitudes_of(errors.natural(zeta[None]))[0] == pytest.approx(found)
    zeta, step = np.array([0.2, -0.4, 0.3, -0.5, 0.1]), 1e-5
    ahead, behind = (np.array([errors.amplitudes(zeta + sign * one) for one in step * np.eye(5)]) for sign in (1, -1))
    assert errors.slopes_of_amplitudes(zeta) == pytest.approx((ahead - behind) / (2 * step), rel=1e-6, abs=1e-10)
    second = (ahead - 2 * errors.amplitudes(zeta) + behind) / step**2
    assert errors.curvatures_of_amplitudes(zeta) == pytest.approx(second, rel=1e-3, abs=1e-6)


def build_posterior(likelihood, shared=True):
    names = [name for name in likelihood.layout.names if name.startswith(("a_", "b_", "l["))]
    nominal = likelihood.machine.layout.nominal
    places = {name: nominal[likelihood.layout.names.index(name)] for name in names}
    priors = {name: NormalPrior(value, 0.3) for name, value in places.items()}
    terms = [FunctionScales(likelihood.functions.sorts, 0.02)]
    return build_leg_posterior(likelihood, priors, ModelError(0.01, shared=shared), terms=terms)


@FEW_AMONG_RUNS
@pytest.mark.parametrize("shared", [True, False])
def test_slopes_are_those_of_the_density(joined, shared):
    likelihood, _, truth = joined
    posterior = build_posterior(likelihood, shared)
    m = posterior.n_geometry
    off = np.random.default_rng(3).standard_normal(posterior.n_parameters)
    # at the truth: farther off the derivatives of the rows, which the base supplies, leave second orders out
    y = posterior.adopt(truth[None], 0.3 * off[None, m:] - 0.5)[0]
    step = 1e-4 * np.eye(len(y))
    gradient, hessian = posterior.newton(y)
    by_differences = (posterior.log_density(y + step) - posterior.log_density(y - step)) / 2e-4
    assert gradient == pytest.approx(by_differences, rel=1e-4, abs=1e-3 * np.abs(by_differences).max())
    ahead, behind = (np.array([posterior.gradient(y + sign * one)[0] for one in step]) for sign in (1.0, -1.0))
    curvature = (ahead - behind) / 2e-4
    assert hessian[m:, m:] == pytest.approx(curvature[m:, m:], rel=1e-3, abs=1e-2)


def test_a_scale_of_which_little_is_known():
    prior, zeta = HalfCauchyPrior(0.02), np.linspace(-3.0, 3.0, 7)
    assert prior.value(np.zeros(1))[0] == pytest.approx(0.02, rel=2e-3)
    assert prior.standardise(prior.value(zeta)) == pytest.approx(zeta, abs=1e-9)
    value = prior.value(np.random.default_rng(1).standard_normal(400_000))
    grid = np.linspace(0.0, 20.0, 2_000_001)
    assert np.exp(prior.log_density(grid)).sum() * (grid[1] - grid[0]) == pytest.approx(1.0, rel=1e-3)
    assert value.mean() == pytest.approx(prior.mean, rel=0.03)
    assert prior.sd == pytest.approx(value.std(), rel=0.1)


def test_poses_at_home_have_no_functions(two):
    calibration, _, _ = two
    home = np.broadcast_to(machines.INITIAL_POSITION, calibration.actuators.shape)
    likelihood = build(calibration)
    functions = type(likelihood.functions)(likelihood.functions.sorts, likelihood.place._replace(travel=0.0 * home))
    with pytest.raises(InputError, match="at home"):
        functions.between(functions.place, functions.place)
