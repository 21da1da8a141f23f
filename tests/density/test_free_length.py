"""A structured model error whose length is free: against the dense kernel at each length, and fixed lengths."""

import numpy as np
import pytest
import telescope_machines as machines

from bayescal.density.errors import KernelLength, KernelScale, ModelError
from bayescal.density.exact import ExactDensity
from bayescal.density.legs import build_leg_posterior
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.prediction import pointwise_given
from bayescal.density.priors import LogNormalPrior, NormalPrior, QuadraticKernel, SmoothKernel, build_kernel
from bayescal.density.structured import REACH, StructuredLikelihood, count_nodes

KERNELS = ("quadratic", "smooth")
LENGTHS = LogNormalPrior(1.5, 0.6)
TOLERANCE = 5e-3  # nats


@pytest.fixture(scope="module")
def poses():
    machine = machines.build_machine("none")
    actuators = machines.table_3_actuators()[:15]
    theta, rng = machines.telescope_truth(machine), np.random.default_rng(1)
    found = machines.simulate_poses(machine, theta, actuators, np.full(6, 2e-3), rng)
    seen = np.arange(15) < 12
    calibration, held = (PoseLikelihood(machine, found.select(k), machines.ACTUATOR_NOISE) for k in (seen, ~seen))
    return calibration, held, theta


@pytest.fixture(scope="module", params=KERNELS)
def free(request, poses):
    return request.param, StructuredLikelihood(
        poses[0], build_kernel(request.param, LENGTHS.median), machines.ACTUATOR_RANGE, LENGTHS
    )


def fix(poses, name, length):
    return StructuredLikelihood(poses[0], build_kernel(name, length), machines.ACTUATOR_RANGE)


def draw(theta, n, length=None):
    """Return vectors near the truth and model errors with their lengths."""
    rng = np.random.default_rng(2)
    vectors = np.tile(theta, (n, 1))
    vectors[:, :12] += 2e-3 * rng.standard_normal((n, 12))
    length = LENGTHS.draw(n, rng) if length is None else np.full(n, length)
    return vectors, np.column_stack(
        [1e-3 * rng.uniform(0.5, 3.0, (n, 6)), 1e-2 * rng.uniform(0.3, 2.0, (n, 6)), length]
    )


def test_density_is_that_of_the_dense_kernel_at_every_length(poses, free):
    name, likelihood = free
    theta, errors = draw(poses[2], 60)
    dense = [fix(poses, name, one[-1])(theta[k : k + 1], one[None, :-1])[0] for k, one in enumerate(errors)]
    assert np.abs(likelihood(theta, errors) - dense).max() < TOLERANCE
    assert np.ptp(dense) > 50.0


@pytest.mark.parametrize("part", ["pointwise", "single", "together", "mean", "covariance", "factor"])
def test_at_a_node_everything_is_that_of_a_known_length(poses, free, part):
    name, likelihood = free
    length = float(np.exp(likelihood.log_nodes[300]))
    theta, errors = draw(poses[2], 3, length)
    known = fix(poses, name, length)

    def evaluate(one, errors):
        if part == "pointwise":
            return one.pointwise(theta, errors)
        if part in ("single", "together"):
            return pointwise_given(one, poses[1], theta, errors)[part == "together"]
        if part == "factor":
            factor = one.factor(errors)
            return np.broadcast_to(factor @ np.swapaxes(factor, 1, 2), (3, 12, 12))
        return getattr(one.condition(poses[1], theta, errors), part)

    expected = evaluate(known, errors[:, :-1])
    np.testing.assert_allclose(evaluate(likelihood, errors), expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())


def test_each_vector_has_a_length_of_its_own(poses, free):
    _, likelihood = free
    theta, errors = draw(poses[2], 5)
    one_by_one = np.concatenate([likelihood(theta[k : k + 1], errors[k : k + 1]) for k in range(5)])
    np.testing.assert_allclose(likelihood(theta, errors), one_by_one, rtol=1e-12)
    single, _ = pointwise_given(likelihood, poses[1], theta, errors)
    last, _ = pointwise_given(likelihood, poses[1], theta[4:], errors[4:])
    np.testing.assert_allclose(single[4:], last, rtol=1e-10)


def test_exact_density_has_the_length(poses, free):
    name, likelihood = free
    length = float(np.exp(likelihood.log_nodes[300]))
    theta, errors = draw(poses[2], 2, length)
    known, found = (
        ExactDensity(poses[0], machines.ACTUATOR_NOISE, functions=one) for one in (fix(poses, name, length), likelihood)
    )
    np.testing.assert_allclose(found(theta, errors), known(theta, errors[:, :-1]), atol=1e-5)


# --- posterior -------------------------------------------------------------------------------------------------------


def build_posterior(poses, likelihood, shared=True):
    layout = poses[0].machine.layout
    names = [name for name in layout.names if name.split("[")[0] in machines.FREE_SYMBOLS["none"]]
    nominal = dict(zip(layout.names, layout.nominal, strict=True))
    priors = {n: NormalPrior(nominal[n], machines.PRIOR_SD.get(n.split("[")[0], 2.0)) for n in names}
    scale, error = KernelScale(0.02, 0.3, shared), ModelError(0.01)
    if likelihood.is_free:
        return build_leg_posterior(likelihood, priors, error, terms=(scale, KernelLength(LENGTHS)))
    return build_leg_posterior(likelihood, priors, error, terms=(scale,))


@pytest.fixture(scope="module")
def start(poses, free):
    posterior = build_posterior(poses, free[1])
    y = posterior.polish(posterior.approach())
    y += np.random.default_rng(3).standard_normal(posterior.n_parameters) / np.sqrt(-np.diag(posterior.gradient(y)[1]))
    return posterior, y


def test_gradient_is_that_of_the_dense_kernel(poses, free, start):
    (name, _), (posterior, y) = free, start
    gradient, hessian = posterior.gradient(y)
    assert np.linalg.eigvalsh(hessian).max() < 0.0
    sd = 1.0 / np.sqrt(-np.diag(hessian))
    expected = machines.stencil_derivative(posterior.log_density, y, np.full(len(y), 1e-3))
    off = np.abs((gradient - expected) * sd)
    # the legs' errors are found by iteration, their derivative is exact; in τ and s nothing is iterated
    assert off[: posterior.n_geometry].max() < 0.02
    assert off[posterior.n_geometry : -1].max() < 1e-6

    def dense(c):
        known = build_posterior(poses, fix(poses, name, float(LENGTHS.value(c[0]))))
        return known.log_density(y[None, :-1]) - 0.5 * c[:1] ** 2

    step = 1e-3
    slope = (dense(y[-1:] + step) - dense(y[-1:] - step))[0] / (2.0 * step)
    assert abs(gradient[-1] - slope) * sd[-1] < 1e-3
    assert abs(slope) * sd[-1] > 0.1


def test_curvature_by_length_is_expected_curvature(poses, free, start):
    """The mean over data of the outer product of scores, of whitened errors drawn from the density itself."""
    (posterior, y), n = start, 1000
    errors, rng = posterior.errors.amplitudes(posterior.zeta(y)), np.random.default_rng(5)
    likelihood = posterior.likelihood.nearest(errors)
    local = likelihood.linearise(*posterior.around(y), posterior.errors, posterior.zeta(y))
    root = np.linalg.cholesky(np.linalg.inv(local.precision))
    scores = []
    for _ in range(n):
        drawn = np.einsum("kij,kj->ki", root, rng.standard_normal(local.errors.shape))
        scores.append(likelihood.differentiate_by_errors(local._replace(errors=drawn), errors)[0][-1])
    second = -likelihood.differentiate_by_errors(local, errors)[1][-1, -1]
    assert np.mean(scores) == pytest.approx(0.0, abs=4.0 * np.std(scores) / np.sqrt(n))
    assert np.var(scores) == pytest.approx(second, rel=0.2)


def test_lengths_out_of_reach_are_taken_for_the_outermost(poses, free, start):
    posterior, y = start
    y = np.tile(y, (2, 1))
    y[:, -1] = REACH, REACH + 1.0
    beyond, prior = posterior.log_density(y), posterior.log_prior(y)
    assert np.diff(beyond - prior) == pytest.approx(0.0, abs=1e-9)
    assert posterior.gradient(y[1])[0][-1] == -y[1, -1]


def test_pose_information_is_that_of_the_nearest_length(poses, free, start):
    (_, likelihood), (posterior, y) = free, start
    known = build_posterior(poses, likelihood.nearest(posterior.errors.amplitudes(posterior.zeta(y))))
    np.testing.assert_allclose(posterior.row_information(y, 3), known.row_information(y[:-1], 3), rtol=1e-9)


# --- kernels ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kernel", [QuadraticKernel, SmoothKernel])
@pytest.mark.parametrize("length", [0.3, 2.0, 300.0])
def test_slope_by_the_length(kernel, length):
    inputs, step = np.random.default_rng(7).uniform(-1, 1, (9, 6)), 1e-4
    above, below = (kernel(length * np.exp(sign * step))(inputs, inputs) for sign in (1.0, -1.0))
    found = kernel(length).slope(inputs, inputs)
    assert np.abs(found - (above - below) / (2.0 * step)).max() < 1e-6 * np.abs(found).max() + 1e-8


@pytest.mark.parametrize("kernel", [QuadraticKernel, SmoothKernel])
def test_many_lengths_at_once(kernel):
    first, second = np.random.default_rng(7).uniform(-1, 1, (2, 5, 6))
    lengths = np.array([0.5, 3.0])
    both = kernel(lengths[:, None, None])(first, second)
    np.testing.assert_allclose(both, [kernel(one)(first, second) for one in lengths], rtol=1e-13)


def test_very_many_poses_have_fewer_nodes():
    assert count_nodes(40) == 901
    assert 91 <= count_nodes(300) < 300
