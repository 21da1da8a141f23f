"""What every posterior promises, whatever the machine, its errors and the density of its measurements.

Coordinates as a bijection of known volume, priors against scipy, gradients against differences.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import telescope_machines as machines
from calibration_problems import LINE_CASES, lines_posterior, unknown_noise
from reading_machines import small_posterior
from scipy import stats
from sliding_platforms import SETS

from bayescal.density.outliers import NORMAL, Contaminated, StudentT
from bayescal.density.priors import NormalPrior, SharePrior, UniformPrior
from bayescal.inference.mode import Mode, find_mode
from bayescal.inference.reparameterisation import straighten

PER_LEG, SHARED, NONE = machines.let_err(), machines.let_err(shared=True), machines.let_err(None)
ALL_SYMBOLS = ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "u_x", "u_y", "l", "rho0", "kappa")
SHARES = Contaminated(SharePrior(0.05))
FAR_OFF = 1e-3  # posterior standard deviations of each coordinate, of differences


def legs(rng, deformation="linear", errors=PER_LEG, symbols=None, outliers=NORMAL, uniform=False, anchored=True):
    """Return the posterior of the telescope's simulated poses."""
    machine = machines.build_machine(deformation)
    actuators = machines.table_3_actuators()
    poses = machines.simulate_poses(machine, machines.telescope_truth(machine), actuators, np.full(6, 2e-3), rng)
    found = machines.build_posterior(deformation, poses, replace(errors, outliers=outliers), symbols)
    if uniform:
        found = replace(found, priors={**found.priors, "l[2]": UniformPrior(499.0, 502.0)})
    return found.with_pose_guesses() if anchored else found


def lines(rng, anchored=True, **case):
    """Return the posterior of a point on lines."""
    found = lines_posterior(rng, **case)[0]
    return found.with_pose_guesses() if anchored else found


@dataclass(frozen=True)
class Case:
    """A posterior, and what holds of it.

    ``close``: how exact its gradient is, of the largest entry, per posterior sd; ``apart``: rows are independent given
    machine and errors.
    """

    build: Callable[..., Any]
    options: dict[str, Any]
    close: float = 1e-4
    apart: bool = True


CASES = {
    "legs": Case(legs, {}, 2e-3),
    "legs, one τ": Case(legs, {"errors": SHARED}, 2e-3),
    "legs, K, not anchored": Case(legs, {"deformation": "matrix", "anchored": False}, 2e-3),
    "legs, everything free": Case(legs, {"deformation": "matrix", "symbols": ALL_SYMBOLS, "errors": SHARED}, 5e-3),
    "legs, uniform": Case(legs, {"deformation": "matrix", "uniform": True}, 2e-3),
    "legs, contaminated": Case(legs, {"deformation": "matrix", "outliers": SHARES}, 6e-3),
    "legs, t": Case(legs, {"deformation": "matrix", "outliers": StudentT(4.0), "errors": NONE}, 2e-3),
    **{
        f"lines, {name}": Case(
            lines, case, 1e-3 if {"commanded", "terms"} & set(case) else 1e-4, "functions" not in name
        )
        for name, case in LINE_CASES.items()
    },
    "lines, not anchored": Case(lines, {"terms": unknown_noise(4), "anchored": False}),
    "Sliding Star": Case(lambda rng, **given: small_posterior(SETS[8], 20, 11, **given), {}),
    "Sliding Star, one length": Case(
        lambda rng, **given: small_posterior(SETS[4], 20, 11, **given), {"common": ("l",)}
    ),
}


@dataclass(frozen=True)
class Problem:
    """A case's posterior, a point within it, and its mode."""

    case: Case
    posterior: Any
    y: np.ndarray
    mode: Mode

    @property
    def sd(self):
        """Conditional standard deviations, shape (n,)."""
        return 1.0 / np.sqrt(np.diag(np.linalg.inv(self.mode.covariance)))


@pytest.fixture(scope="module", params=CASES.values(), ids=CASES)
def problem(request):
    """Return each case at a point one standard deviation or so from its best machine."""
    rng = np.random.default_rng(8096)
    posterior = request.param.build(rng, **request.param.options)
    mode = find_mode(posterior, posterior.refine_geometry(posterior.least_squares_start()))
    y = mode.y + np.linalg.cholesky(mode.covariance) @ rng.standard_normal(len(mode.y))
    return Problem(request.param, posterior, y, mode)


def test_gradient_is_that_of_differences(problem):
    posterior, y, sd = problem.posterior, problem.y, problem.sd
    gradient, hessian = posterior.gradient(y)
    expected = machines.stencil_derivative(posterior.log_density, y, FAR_OFF * sd)
    size = np.abs(expected * sd).max()
    assert size > 0.3
    np.testing.assert_allclose(gradient * sd, expected * sd, rtol=0, atol=problem.case.close * size)
    np.testing.assert_allclose(hessian, hessian.T, rtol=1e-9, atol=1e-9 * np.abs(hessian).max())
    assert np.linalg.eigvalsh(hessian / np.outer(1.0 / sd, 1.0 / sd)).max() < 0.0


def test_everything_free_has_name_unit_prior_and_value(problem):
    posterior, y = problem.posterior, problem.y
    n = posterior.n_parameters
    assert len(set(posterior.names)) == len(posterior.units) == len(posterior.prior_sd) == n == len(y)
    assert list(posterior.all_priors()) == list(posterior.names)
    assert posterior.natural(np.tile(y, (3, 1))).shape == (3, n)
    drawn = posterior.draw_prior(4000, np.random.default_rng(4))
    zeta = posterior.errors.deviations(posterior.zeta(drawn))
    np.testing.assert_allclose(zeta.mean(axis=0), 0.0, atol=0.1)
    np.testing.assert_allclose(zeta.std(axis=0), 1.0, atol=0.1)
    natural = posterior.natural(drawn)
    good = np.isfinite(natural).all(axis=1)
    assert good.mean() > 0.5
    for k, prior in enumerate(posterior.all_priors().values()):
        if good.all():
            assert natural[:, k].std() == pytest.approx(prior.sd, rel=0.15)
        if good.all() and prior.off is None:
            assert stats.kstest(prior.standardise(natural[:, k]), "norm").pvalue > 1e-4


def test_machines_and_coordinates_lead_to_each_other(problem):
    posterior, y, m = problem.posterior, problem.y, problem.posterior.n_geometry
    theta = posterior.theta(y[None])
    np.testing.assert_allclose(posterior.sampling.y_from_theta(theta)[0], y[:m], atol=1e-7)
    np.testing.assert_allclose(posterior.to_coordinates(theta, posterior.zeta(y[None]))[0], y, atol=1e-7)
    expected = machines.stencil_derivative(posterior.sampling.theta_from_y, y[:m], np.full(m, 1e-3))
    scale = np.abs(expected).max(axis=0)
    np.testing.assert_allclose(posterior.sampling.jacobian(theta[0]) / scale, expected / scale, atol=1e-6)
    beyond = np.tile(y, (2, 1))
    beyond[1, :m] = np.nan
    assert list(np.isfinite(posterior.log_density(beyond))) == [True, False]


def test_vectors_in_a_batch_do_not_mix(problem):
    posterior, rng = problem.posterior, np.random.default_rng(3)
    y = problem.y + 0.1 * rng.standard_normal((5, len(problem.y))) * problem.sd
    alone = np.concatenate([posterior.log_density(one[None]) for one in y])
    np.testing.assert_allclose(posterior.log_density(y), alone, rtol=1e-8, atol=2e-4)
    each = np.concatenate([posterior.pointwise(one[None]) for one in y])
    np.testing.assert_allclose(posterior.pointwise(y), each, rtol=1e-8, atol=2e-4)


def test_rows_make_up_the_density(problem):
    posterior, y = problem.posterior, problem.y[None]
    each = posterior.pointwise(y)
    for row in (0, each.shape[1] - 1):
        of_lone = 0.01 if getattr(posterior.likelihood, "lone", None) is not None else 1e-4  # which one row is not
        np.testing.assert_allclose(posterior.pointwise_of(y, row), each[:, row], rtol=1e-6, atol=of_lone)
    whole = posterior.log_density(y) - posterior.log_prior(y)
    if problem.case.apart:
        np.testing.assert_allclose(each.sum(axis=1), whole, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(posterior.predict_density(posterior.likelihood, y), each, rtol=1e-9, atol=1e-9)
    else:  # what rows say of each other counts
        assert np.abs(each.sum(axis=1) - whole)[0] > 0.1


def test_information_is_the_geometrys_curvature_and_that_of_the_rows(problem):
    posterior, y, m = problem.posterior, problem.y, problem.posterior.n_geometry
    information, prior = posterior.information(y)
    hessian = posterior.gradient(y)[1][:m, :m]
    close = 0.05 if posterior.errors.n_parameters else 1e-9
    close = max(close, 1e-3) if getattr(posterior.likelihood, "lone", None) is not None else close
    np.testing.assert_allclose(information + prior, -hessian, rtol=close, atol=close * np.abs(hessian).max())
    if problem.case.apart:
        rows = [posterior.row_information(y, row) for row in range(posterior.pointwise(y[None]).shape[1])]
        np.testing.assert_allclose(sum(rows), information, rtol=1e-6, atol=1e-9 * np.abs(information).max())


def test_jumps_lead_back(problem):
    posterior, y = problem.posterior, problem.y
    for jump, image in posterior.mode_candidates(y):
        assert not np.allclose(image, y)
        again = dict(posterior.mode_candidates(image))[jump]  # but for how large an error is, which being off forgets
        np.testing.assert_allclose(dict(posterior.mode_candidates(again))[jump], image, atol=1e-6)
        np.testing.assert_allclose(np.where(np.isclose(again, 0.0), y, again), y, atol=1e-6)


def test_straight_coordinates_lead_back_and_keep_volumes(problem):
    posterior, y = problem.posterior, problem.y
    straight = straighten(posterior, problem.mode)
    x = straight.x_from_y(y[None])[0]
    x = x + 0.3 * np.random.default_rng(6).standard_normal(len(x))
    there = straight.y_from_x(x[None])
    np.testing.assert_allclose(straight.x_from_y(there)[0], x, atol=1e-7)
    slope = machines.stencil_derivative(straight.y_from_x, x, np.full(len(x), 1e-3))
    volume = straight.log_density(x[None]) - posterior.log_density(there)
    assert volume[0] == pytest.approx(np.linalg.slogdet(slope)[1], abs=1e-3)


SUBSETS = {
    "six of a leg": ("a_x", "a_y", "b_x", "b_y", "l", "kappa"),
    "directions, attachments fixed": ("u_x", "u_y", "kappa"),
    "attachments half free": ("a_x", "a_z", "u_y", "l"),
    "initial positions alone": ("rho0",),
    "initial positions and directions": ("rho0", "a_x", "a_y", "a_z", "u_x", "u_y"),
    "kappa fixed": ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "u_x", "u_y", "l", "rho0"),
    "all": ALL_SYMBOLS,
}


def build(poses, symbols=ALL_SYMBOLS, errors=NONE, deformation="matrix", mechanism=None):
    """Return a posterior of the telescope, or of a machine whose home legs lean in every direction."""
    machine = machines.build_machine(deformation, mechanism)
    return machines.build_posterior(deformation, poses, errors, symbols, machine)


@pytest.fixture(scope="module")
def leaning():
    """Return a machine with tilted actuators, its home legs far from vertical."""
    return machines.build_random_mechanism(6, seed=11)


@pytest.fixture(scope="module")
def leaning_poses(leaning):
    """Return a few exact poses of that machine."""
    machine = machines.build_machine("matrix", leaning)
    actuators = leaning.initial_actuator_positions + np.random.default_rng(3).uniform(-1, 1, (4, 6))
    return machines.place_poses(machine, machine.layout.nominal, actuators, np.zeros((4, 6)))


# --- coordinates -----------------------------------------------------------------------------------------------------


@pytest.fixture(params=SUBSETS.values(), ids=SUBSETS.keys())
def coordinates(request, leaning, leaning_poses):
    """Return the coordinates of a subset of the parameters."""
    return build(leaning_poses, request.param, mechanism=leaning).sampling.coordinates


def test_coordinates_are_a_bijection(coordinates, rng):
    """Where a gain above one along a leg leaves the sphere there is no vector."""
    y = rng.standard_normal((200, len(coordinates.free)))
    theta = coordinates.theta_from_y(y)
    exists = np.isfinite(theta).all(axis=1)
    assert exists.sum() >= 20
    assert exists.all() or len(legs_on_circles(coordinates)) or len(legs_on_rings(coordinates))
    y, theta = y[exists], theta[exists]
    np.testing.assert_allclose(coordinates.y_from_theta(theta), y, atol=1e-11)
    fixed = np.setdiff1d(np.arange(coordinates.layout.size), coordinates.free)
    np.testing.assert_array_equal(theta[:, fixed], np.tile(coordinates.layout.nominal[fixed], (len(y), 1)))
    assert np.all(np.ptp(theta[:, coordinates.free], axis=0) > 0)


def legs_on_circles(coordinates):
    """Return the legs whose direction has linear functions of gain and azimuth for coordinates."""
    return coordinates._circles[0] if coordinates._circles else np.array([], dtype=int)


def legs_on_rings(coordinates):
    """Return the legs whose direction has quantiles of gain and azimuth for coordinates."""
    return np.array([leg for leg, _, _ in coordinates.rings], dtype=int)


def test_circles_are_for_directions_without_kappa(coordinates):
    index = coordinates.layout.index
    both = np.isin([*index["u_x"], *index["u_y"]], coordinates.free).all()
    expected = both and not np.isin(index["kappa"], coordinates.free).any()
    found = np.sort(np.concatenate([legs_on_circles(coordinates), legs_on_rings(coordinates)]))
    assert len(np.unique(found)) == len(found)
    assert bool(len(found)) == expected


def test_origin_of_the_coordinates_is_the_nominal_machine(coordinates):
    theta = coordinates.theta_from_y(np.zeros((1, len(coordinates.free))))[0]
    elsewhere = np.setdiff1d(np.arange(len(theta)), coordinates.free[coordinates.ringed])
    if len(coordinates.rings):  # whose zero is the middle of the prior, in length and joint too
        elsewhere = elsewhere[[not n.startswith(("a_", "l")) for n in np.array(coordinates.layout.names)[elsewhere]]]
        assert np.abs(theta - coordinates.layout.nominal).max() < 1.0
    np.testing.assert_allclose(theta[elsewhere], coordinates.layout.nominal[elsewhere], atol=1e-12)


def test_jacobian_of_the_coordinates(coordinates, rng):
    y = 0.5 * rng.standard_normal(len(coordinates.free))
    found = coordinates.jacobian(coordinates.theta_from_y(y[None])[0])
    expected = machines.central_difference(lambda x: coordinates.theta_from_y(x[None])[0], y, np.full(len(y), 1e-4))
    np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(expected).max())


def test_volume_of_the_coordinates(coordinates, rng):
    """The product of the scales; with gain and azimuth of a direction times u_z, since du_x du_y = u_z dw dψ."""
    y = 0.5 * rng.standard_normal((1, len(coordinates.free)))
    theta = coordinates.theta_from_y(y)[0]
    assert np.isfinite(theta).all()
    log_volume = np.linalg.slogdet(coordinates.jacobian(theta)[coordinates.free])[1]
    assert coordinates.log_scale == pytest.approx(np.log(coordinates.scale[~coordinates.standard]).sum(), abs=1e-9)
    u_x, u_y = (coordinates.layout.take(theta, symbol)[legs_on_circles(coordinates)] for symbol in ("u_x", "u_y"))
    varying = np.log(1 - u_x**2 - u_y**2).sum() / 2
    rings = coordinates.log_ring_ratio(y[0])
    for leg, places, ring in coordinates.rings:
        components = np.array([coordinates.layout.take(theta, symbol)[leg] for symbol in ("u_x", "u_y")])
        rings += stats.norm.logpdf(y[0, places]).sum() - ring.log_prior(components)
    assert log_volume == pytest.approx(coordinates.log_scale + varying + rings, abs=1e-6)
    assert coordinates.log_volume(theta) == pytest.approx(varying, abs=1e-12)


def test_shears_hold_the_initial_joint_and_the_actuator_gain(leaning, leaning_poses, rng):
    """Moving a direction alone leaves c = a + ρ^0 u where it is, and κ - u_z - the slopes times u_x, u_y."""
    coordinates = build(leaning_poses, mechanism=leaning).sampling.coordinates
    layout, names = coordinates.layout, np.array(coordinates.layout.names)[coordinates.free]
    y = np.zeros((2, len(names)))
    y[1, np.char.startswith(names.astype(str), "u_")] = rng.uniform(-1, 1, 12)
    theta = coordinates.theta_from_y(y)
    u = np.empty((2, 6, 3))
    u[..., 0], u[..., 1] = layout.take(theta, "u_x"), layout.take(theta, "u_y")
    u[..., 2] = np.sqrt(1 - u[..., 0] ** 2 - u[..., 1] ** 2)
    joint = layout.take_vector(theta, "a") + layout.take(theta, "rho0")[..., None] * u
    np.testing.assert_allclose(joint[1], joint[0], atol=1e-12)
    legs = leaning.platform_points + np.array([3.0, -2.0, 400.0]) - leaning.home_joints
    gain = layout.take(theta, "kappa") - np.einsum("bik,ik->bi", u, legs / legs[:, 2:])
    np.testing.assert_allclose(gain[1], gain[0], atol=1e-11)
    assert np.abs(u[1] - u[0]).max() > 1e-2


def test_directions_off_the_sphere_are_nan(leaning, leaning_poses):
    coordinates = build(leaning_poses, ("u_x", "l"), mechanism=leaning).sampling.coordinates
    y = np.zeros((2, 12))
    y[1, 0] = 30.0
    theta = coordinates.theta_from_y(y)
    assert np.isfinite(theta[0]).all()
    posterior = build(leaning_poses, ("u_x", "l"), mechanism=leaning)
    assert np.isfinite(posterior.log_density(y)).tolist() == [True, False]
    assert posterior.log_density(y)[1] == -np.inf


# --- priors ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shared", [False, True])
def test_prior_is_normalised_in_the_coordinates(leaning, leaning_poses, shared, rng):
    """The log-prior is the sum of scipy's densities of the parameters plus the log-Jacobian of the coordinates."""
    posterior = build(leaning_poses, errors=machines.let_err(0.01, shared), mechanism=leaning)
    y = 0.4 * rng.standard_normal((5, posterior.n_parameters))
    natural, n = posterior.natural(y), posterior.n_geometry
    for k in range(5):
        expected = 0.0
        for value, prior in zip(natural[k, :n], list(posterior.all_priors().values())[:n], strict=True):
            expected += stats.norm(prior.centre, prior.scale).logpdf(value)
        expected += stats.halfnorm(scale=0.01).logpdf(natural[k, n:]).sum()
        jacobian = machines.central_difference(lambda x: posterior.natural(x[None])[0], y[k], np.full(y.shape[1], 1e-4))
        expected += np.linalg.slogdet(jacobian)[1]
        assert posterior.log_prior(y)[k] == pytest.approx(expected, abs=1e-5)
    assert natural.shape[1] == n + (1 if shared else 6)


def test_uniform_priors_are_kept_and_standard_normal_in_their_coordinate(twin):
    machine = machines.build_machine("matrix")
    priors = {"l[2]": UniformPrior(495.0, 503.0), "b_x[1]": NormalPrior(machine.layout.nominal[18], 2.0)}
    posterior = machines.measure(machine, twin, priors)
    length = posterior.names.index("l[2]")
    y = np.zeros((5, 2))
    y[:, length] = [-40.0, -1.0, 0.0, 1.0, 40.0]
    lengths = posterior.natural(y)[:, length]
    np.testing.assert_allclose(lengths, 495.0 + 8.0 * stats.norm.cdf(y[:, length]))
    assert np.isfinite(posterior.log_density(y)).all()
    # the density of y is that of the uniform prior times |dθ/dy|
    inside = y[1:4, length]
    expected = stats.norm(0, 2).logpdf(0.0) + np.log(2.0) - np.log(8.0) + np.log(8.0 * stats.norm.pdf(inside))
    np.testing.assert_allclose(posterior.log_prior(y)[1:4], expected)
    again = posterior.sampling.y_from_theta(posterior.theta(y[1:4]))
    np.testing.assert_allclose(again, y[1:4], atol=1e-9)
    slope = posterior.sampling.jacobian(posterior.theta(y[1:2])[0])
    assert slope[posterior.sampling.free[length], length] == pytest.approx(8.0 * stats.norm.pdf(-1.0))


def test_prior_mean_and_fixed_values_set_the_start(twin):
    machine = machines.build_machine("matrix")
    posterior = machines.measure(machine, twin, {"l[2]": NormalPrior(501.0, 1.0)}, fixed={"a_x[3]": 140.0})
    theta = posterior.theta(np.array([[0.5]]))[0]
    layout = machine.layout
    changed = {name: value for name, value in zip(layout.names, theta - layout.nominal, strict=True) if value}
    assert changed == {"l[2]": pytest.approx(1.5), "a_x[3]": pytest.approx(140.0 - layout.nominal[2])}
