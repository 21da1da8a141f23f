"""Coordinates as a bijection of known volume, priors against scipy, gradients against differences."""

from __future__ import annotations

import numpy as np
import pytest
import telescope_machines as machines
from scipy import stats

from bayescal.density.errors import ModelError
from bayescal.density.legs import build_leg_posterior
from bayescal.density.priors import NormalPrior, UniformPrior
from bayescal.errors import InputError

ALL_SYMBOLS = ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "u_x", "u_y", "l", "rho0", "kappa")
SCALE = 0.01
NO_MODEL_ERROR = ModelError(None)
SUBSETS = {
    "six of a leg": ("a_x", "a_y", "b_x", "b_y", "l", "kappa"),
    "directions, attachments fixed": ("u_x", "u_y", "kappa"),
    "attachments half free": ("a_x", "a_z", "u_y", "l"),
    "initial positions alone": ("rho0",),
    "initial positions and directions": ("rho0", "a_x", "a_y", "a_z", "u_x", "u_y"),
    "kappa fixed": ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "u_x", "u_y", "l", "rho0"),
    "all": ALL_SYMBOLS,
}


def build(poses, symbols=ALL_SYMBOLS, model_error=NO_MODEL_ERROR, deformation="matrix", mechanism=None):
    """Return a posterior of the telescope, or of a machine whose home legs lean in every direction."""
    machine = machines.build_machine(deformation, mechanism)
    return machines.build_posterior(deformation, poses, model_error, symbols, machine)


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
    posterior = build(leaning_poses, model_error=ModelError(SCALE, shared), mechanism=leaning)
    y = 0.4 * rng.standard_normal((5, posterior.n_parameters))
    natural, n = posterior.natural(y), posterior.n_geometry
    for k in range(5):
        expected = 0.0
        for value, prior in zip(natural[k, :n], list(posterior.all_priors().values())[:n], strict=True):
            expected += stats.norm(prior.centre, prior.scale).logpdf(value)
        expected += stats.halfnorm(scale=SCALE).logpdf(natural[k, n:]).sum()
        jacobian = machines.central_difference(lambda x: posterior.natural(x[None])[0], y[k], np.full(y.shape[1], 1e-4))
        expected += np.linalg.slogdet(jacobian)[1]
        assert posterior.log_prior(y)[k] == pytest.approx(expected, abs=1e-5)
    assert natural.shape[1] == n + (1 if shared else 6)


def test_uniform_priors_are_kept_and_standard_normal_in_their_coordinate(twin):
    machine = machines.build_machine("matrix")
    likelihood = build(twin).likelihood
    priors = {"l[2]": UniformPrior(495.0, 503.0), "b_x[1]": NormalPrior(machine.layout.nominal[18], 2.0)}
    posterior = build_leg_posterior(likelihood, priors, ModelError(None))
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
    likelihood = build(twin).likelihood
    posterior = build_leg_posterior(likelihood, {"l[2]": NormalPrior(501.0, 1.0)}, ModelError(None), {"a_x[3]": 140.0})
    theta = posterior.theta(np.array([[0.5]]))[0]
    layout = likelihood.machine.layout
    changed = {name: value for name, value in zip(layout.names, theta - layout.nominal, strict=True) if value}
    assert changed == {"l[2]": pytest.approx(1.5), "a_x[3]": pytest.approx(140.0 - layout.nominal[2])}


def test_unknown_parameter_is_refused(twin):
    with pytest.raises(InputError, match=r"'a_q\[1\]': unknown here"):
        build_leg_posterior(build(twin).likelihood, {"a_q[1]": NormalPrior(0.0, 1.0)}, ModelError(None))


def test_names_of_the_model_errors(twin):
    assert build(twin, ("l",), ModelError(SCALE)).names[6:] == tuple(f"tau[{leg}]" for leg in range(1, 7))
    assert build(twin, ("l",), ModelError(SCALE, shared=True)).names[6:] == ("tau",)
    assert build(twin, ("l",)).names[6:] == ()


# --- density and derivatives -----------------------------------------------------------------------------------------


def test_every_coordinate_belongs_to_one_leg(twin):
    posterior = build(twin, SUBSETS["six of a leg"], ModelError(SCALE))
    legs = posterior.groups()
    np.testing.assert_array_equal(np.sort(np.concatenate(legs)), np.arange(36))
    for leg, index in enumerate(legs, start=1):
        assert all(posterior.names[k].endswith(f"[{leg}]") for k in index)
