"""Coefficients common to all rows, integrated out: exact without outliers, by Laplace's method with them.

Some poses at a time, and many legs without a matrix of all of them: the numbers are those of all at once.
"""

import numpy as np
import pytest
from eliminated_legs import eliminate_legs, evaluate_legs
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density import pose_likelihood as likelihood_module
from bayescal.density.exact import ExactDensity
from bayescal.density.low_rank import factor_by_columns, find_coefficients, find_low_rank
from bayescal.density.outliers import NORMAL, StudentT
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.machines.deformations import NoDeformation
from bayescal.machines.kinematics import Machine, solve_inverse_kinematics
from bayescal.machines.models.six_ups import SixUps
from bayescal.machines.read import load_mechanism
from bayescal.numerics.geometry import matrix_from_rotation_vector
from bayescal.numerics.scratch import Scratch

M = 4  # rows of each pose


def draw(rng, n_poses, outliers, size=1.0, spoilt=0):
    """Return rows (1, P, m) and columns (1, P, m, 2) with outliers as their density says, and some grosser ones."""
    columns = size * rng.standard_normal((n_poses, M, 2))
    noise = rng.standard_normal((n_poses, M))
    noise *= np.sqrt(outliers.draw_wide((1, n_poses, 1), rng)[0])
    error = columns @ rng.standard_normal(2) + noise
    error[:spoilt] += 30.0
    return error[None], columns[None]


def evaluate(error, columns, outliers):
    """Return the log-density of rows."""
    spare = np.full(error.shape[1], M)
    found = find_coefficients(error, columns, outliers, spare)
    return outliers.weigh(found.square, spare).sum(axis=1) + found.penalty


def integrate(error, columns, outliers):
    """Return the same by quadrature over both coefficients."""
    spare = np.full(error.shape[1], M)
    found = find_coefficients(error, columns, outliers, spare)
    factor, steps = np.linalg.cholesky(found.inverse[0]), np.linspace(-7.0, 7.0, 71)
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    u = found.mean[0] + grid @ factor.T
    square = ((error[0] - np.einsum("pkn,gn->gpk", columns[0], u)) ** 2).sum(axis=-1)
    inside = outliers.weigh(square, spare).sum(axis=1) - 0.5 * (u**2).sum(axis=1) - np.log(2.0 * np.pi)
    return logsumexp(inside) + np.linalg.slogdet(factor)[1] + 2.0 * np.log(steps[1] - steps[0])


def test_without_outliers_it_is_a_dense_normal(rng):
    error, columns = draw(rng, 6, NORMAL)
    flat = columns.reshape(-1, 2)
    dense = multivariate_normal(np.zeros(len(flat)), np.eye(len(flat)) + flat @ flat.T)
    assert evaluate(error, columns, NORMAL)[0] == pytest.approx(dense.logpdf(error.ravel()), rel=1e-12)


@pytest.mark.parametrize("n_poses", [10, 40, 160])
@pytest.mark.parametrize(("nu", "share"), [(2.0, 1.2), (4.0, 0.6), (30.0, 0.15)])
@pytest.mark.parametrize("spoilt", [0, 3])
def test_laplace_is_close_to_quadrature_and_the_closer_the_more_rows(n_poses, nu, share, spoilt, rng):
    """The error in nats falls with the number of poses that tell something, as the docstring says."""
    outliers = StudentT(nu)
    off = []
    for _ in range(4):
        case = draw(rng, n_poses, outliers, spoilt=spoilt)
        off.append(evaluate(*case, outliers)[0] - integrate(*case, outliers))
    assert np.abs(off).max() < share / (n_poses - spoilt)


def test_the_curvature_of_weights_alone_would_be_far_off(rng):
    """What of the curvature comes from the weights' change is a tenth of a nat for each coefficient."""
    outliers, spare = StudentT(4.0), np.full(40, M)
    error, columns = draw(rng, 40, outliers)
    found = find_coefficients(error, columns, outliers, spare)
    flat = (np.sqrt(found.trust)[..., None, None] * columns).reshape(-1, 2)
    rough = -0.5 * np.linalg.slogdet(np.eye(2) + flat.T @ flat)[1]
    assert abs(found.log_volume[0] - rough) > 0.1
    assert abs(evaluate(error, columns, outliers)[0] - integrate(error, columns, outliers)) < 0.02


@pytest.mark.parametrize(("outliers", "limit"), [(NORMAL, 1e-9), (StudentT(4.0), 0.03)], ids=["normal", "robust"])
def test_a_pose_given_the_others_is_the_ratio_of_densities(outliers, limit, rng):
    error, columns = draw(rng, 30, outliers, size=0.3, spoilt=1)
    spare = np.full(30, M)
    found = find_coefficients(error, columns, outliers, spare)
    each, whole = found.condition_each(outliers, spare)[0], integrate(error, columns, outliers)
    for p in range(4):
        others = np.arange(30) != p
        rest = error[:, others], columns[:, others]
        expected = whole - integrate(*rest, outliers)
        assert each[p] == pytest.approx(expected, abs=max(limit, 1e-6))
        told = find_coefficients(*rest, outliers, spare[1:])
        predicted = told.condition_others(error[:, [p]], columns[:, [p]], outliers, spare[:1])
        assert predicted[0, 0] == pytest.approx(expected, abs=max(limit, 1e-6))


def test_machines_are_worked_on_by_themselves_and_those_that_cannot_stand_left_out(rng):
    outliers, spare = StudentT(3.0), np.full(8, M)
    pairs = [draw(rng, 8, outliers) for _ in range(3)]
    error, columns = (np.concatenate(one) for one in zip(*pairs, strict=True))
    error[1] = np.nan
    found = find_coefficients(error, columns, outliers, spare)
    assert np.isnan(found.residual[1]).all()
    for k in (0, 2):
        alone = find_coefficients(*pairs[k], outliers, spare)
        np.testing.assert_allclose(found.mean[k], alone.mean[0], rtol=0, atol=1e-12)
        assert found.penalty[k] == pytest.approx(alone.penalty[0], abs=1e-12)


NOISE = 2e-3
POSE_NOISE = np.diag([1e-2, 1e-2, 1e-2, 1e-5, 1e-5, 1e-5]) ** 2


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    """Return a machine on twelve struts."""
    k = np.arange(12)
    low, high = (2 * np.pi * (k // 2 * 2 + np.where(k % 2, one, 1.0 - one)) / 12 for one in (0.7, 0.15))
    base = np.stack([900 * np.cos(low), 900 * np.sin(low), 20.0 * np.cos(3.0 * k)], axis=1)
    platform = np.stack([600 * np.cos(high), 600 * np.sin(high), 15.0 * np.sin(2.0 * k)], axis=1)
    path = tmp_path_factory.mktemp("machine") / "machine.toml"
    path.write_text(
        f'name = "struts"\n[base]\npoints_mm = {base.tolist()}\n[platform]\npoints_mm = {platform.tolist()}\n'
        '[home]\nposition_mm = [0.0, 0.0, 700.0]\n[legs]\ndrive = "strut"\nactuator_range_mm = 50.0\n'
    )
    return Machine(load_mechanism(path), SixUps(), NoDeformation())


def measure(machine, n_poses):
    """Return the density of poses that are off by some noise."""
    rng = np.random.default_rng(n_poses)
    move = rng.uniform(-20.0, 20.0, (n_poses, 6))
    move[:, 3:] *= 1e-3
    position = machine.mechanism.home_position + move[:, :3]
    rotation = matrix_from_rotation_vector(move[:, 3:])
    actuators = solve_inverse_kinematics(machine, machine.layout.nominal, position, rotation).actuators
    seen = position + 0.01 * rng.standard_normal(position.shape)
    names = tuple(f"p{k}" for k in range(n_poses))
    covariance = np.broadcast_to(POSE_NOISE, (n_poses, 6, 6))
    return PoseLikelihood(machine, MeasuredPoses(names, seen, rotation, covariance, actuators), NOISE)


@pytest.fixture(scope="module")
def density(machine):
    return measure(machine, 21)


@pytest.fixture(scope="module")
def theta(machine):
    nominal = machine.layout.nominal
    return nominal + 0.02 * np.random.default_rng(5).standard_normal((4, len(nominal)))


def test_low_rank_is_the_density_of_all_legs(density, theta):
    tau = np.random.default_rng(1).uniform(0.0, 0.02, (4, 12))
    errors = density.errors(theta).transpose(2, 1, 0)

    def add(leg):
        return density.actuator_weight[:, leg, None] * tau.T[leg] ** 2

    expected, square = factor_by_columns(density.legs_known, add, errors, Scratch())
    found, other = density._low_rank.evaluate(add, errors, Scratch())
    np.testing.assert_allclose(found, expected, rtol=1e-10)
    np.testing.assert_allclose(other, square, rtol=1e-9)


def test_no_low_rank_where_digits_would_be_lost_or_legs_see_each_other(density):
    pose, known, few = density._pose_jacobian, density.legs_known, POSE_NOISE[None]
    assert find_low_rank(pose, few, known) is not None
    without = pose @ few @ np.swapaxes(pose, -1, -2)
    assert find_low_rank(pose, few, without + 1e-12 * np.eye(12)) is None
    assert find_low_rank(pose, few, known + 1e-5 * np.ones((12, 12))) is None
    assert find_low_rank(pose[:, :6], few, known[:, :6, :6]) is None


@pytest.mark.parametrize("kind", ["all legs alike", "each leg"])
def test_parts_are_the_whole(density, theta, monkeypatch, kind):
    tau = np.full(12, 0.01) if kind == "all legs alike" else np.random.default_rng(2).uniform(0.0, 0.02, (4, 12))
    whole = density.pointwise(theta, tau), density.errors(theta), density.evaluate(theta, tau)[1]
    exact = ExactDensity(density, NOISE)(theta, tau)
    monkeypatch.setattr(likelihood_module, "POSES", 16)  # eight poses of twelve legs
    parted = measure(density.machine, 21)
    assert len(parted.parts()) == 3
    found = parted.pointwise(theta, tau), parted.errors(theta), parted.evaluate(theta, tau)[1]
    for one, other in zip(found, whole, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(ExactDensity(parted, NOISE)(theta, tau), exact, rtol=1e-11)
    apart = np.concatenate([part.pointwise(theta, tau) for _, part in parted.parts()], axis=1)
    np.testing.assert_array_equal(apart, found[0])


def test_more_legs_than_six_have_the_density_of_the_general_route(machine):
    """Commanded positions lie on a surface of six dimensions among twelve; struts' closures are in their units."""
    density, rng = measure(machine, 6), np.random.default_rng(8)
    theta = machine.layout.nominal + 0.003 * rng.standard_normal((3, machine.layout.size))
    tau = rng.uniform(0.0, 0.02, (3, 12))
    general = eliminate_legs(machine, density.poses, NOISE, machine.layout.nominal)
    found = evaluate_legs(general, theta, tau).sum(axis=1)
    np.testing.assert_allclose(found, ExactDensity(density, NOISE)(theta, tau), atol=0.02)
