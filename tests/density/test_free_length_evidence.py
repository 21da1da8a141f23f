"""With the length free: the evidence against posteriors with fixed lengths, and twins whose length is found."""

import numpy as np
import pytest
import telescope_machines as machines
from scipy.special import logsumexp

from bayescal.density.errors import KernelLength, KernelScale, ModelError
from bayescal.density.legs import build_leg_posterior
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.priors import LogNormalPrior, NormalPrior, build_kernel
from bayescal.density.structured import StructuredLikelihood
from bayescal.inference.exploration import explore
from bayescal.inference.importance import estimate_by_importance, resample

pytestmark = pytest.mark.slow

LENGTHS = LogNormalPrior(1.5, 0.6)
SCALE, TAU = KernelScale(0.02, 0.3), 2e-3
QUADRATURE = np.linspace(-4.0, 4.0, 25)


def simulate(kernel, seed):
    """Return poses of a machine that errs by a function drawn from the kernel, and the function's length."""
    rng, machine = np.random.default_rng(seed), machines.build_machine("none")
    travel, length = rng.uniform(-1.0, 1.0, (24, 6)), float(LENGTHS.draw(1, rng)[0])
    values, vectors = np.linalg.eigh(build_kernel(kernel, length)(travel, travel))
    size = SCALE.scale * np.exp(SCALE.spread * rng.standard_normal())
    function = size * (vectors * np.sqrt(np.maximum(values, 0.0))) @ rng.standard_normal((24, 6))
    theta = machine.layout.nominal.copy()
    theta[machine.layout.index["l"]] += rng.standard_normal(6)
    actuators = machines.INITIAL_POSITION + machines.ACTUATOR_RANGE * travel
    seen = 2e-3 * rng.standard_normal((24, 6)) * [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]
    moved = machines.place_poses(machine, theta, actuators + function + TAU * rng.standard_normal((24, 6)), seen)
    told = type(moved)(moved.names, moved.position, moved.rotation, moved.covariance, actuators)
    return PoseLikelihood(machine, told, machines.ACTUATOR_NOISE), length


def build(poses, kernel, length=None):
    layout = poses.layout
    nominal = dict(zip(layout.names, layout.nominal, strict=True))
    priors = {name: NormalPrior(nominal[name], 2.0) for name in layout.names if name.startswith("l[")}
    error = ModelError(5e-3, shared=True)
    if length is None:
        likelihood = StructuredLikelihood(poses, build_kernel(kernel, LENGTHS.median), machines.ACTUATOR_RANGE, LENGTHS)
        return build_leg_posterior(likelihood, priors, error, terms=(SCALE, KernelLength(LENGTHS)))
    likelihood = StructuredLikelihood(poses, build_kernel(kernel, length), machines.ACTUATOR_RANGE)
    return build_leg_posterior(likelihood, priors, error, terms=(SCALE,))


def evaluate(posterior, n_draws):
    found = explore(posterior, np.random.SeedSequence(0), max_pilots=0)
    return estimate_by_importance(found.straight.log_density, found.proposal, np.random.default_rng(1), n_draws)


@pytest.mark.parametrize("kernel", ["quadratic", "smooth"])
def test_evidence_is_that_of_all_lengths_by_their_prior(kernel):
    poses, _ = simulate(kernel, 0)
    free = evaluate(build(poses, kernel), 8000)
    fixed = [evaluate(build(poses, kernel, float(LENGTHS.value(c))), 2000).log_evidence for c in QUADRATURE]
    weight = -0.5 * QUADRATURE**2 - 0.5 * np.log(2.0 * np.pi) + np.log(np.diff(QUADRATURE)[0])
    assert np.ptp(fixed) > 10.0
    assert free.log_evidence == pytest.approx(float(logsumexp(fixed + weight)), abs=0.05)


@pytest.mark.parametrize("kernel", ["quadratic", "smooth"])
def test_lengths_are_found(kernel):
    """Of 40 twins with lengths drawn from the prior: ranks like any other, z-scores of unit size, narrower."""
    ranks, scores, narrowed = [], [], []
    for seed in range(40):
        poses, length = simulate(kernel, seed)
        posterior = build(poses, kernel)
        found = explore(posterior, np.random.SeedSequence(seed), max_pilots=0)
        drawn = resample(found.straight.log_density, found.proposal, np.random.default_rng(seed), 3000, 1000)
        y = found.straight.y_from_x(drawn.draws)
        logs, truth = np.log(posterior.natural(y)[:, -1]), np.log(length)
        ranks.append(np.mean(logs < truth))
        scores.append((logs.mean() - truth) / logs.std())
        narrowed.append(logs.std() / LENGTHS.spread)
    inside = np.mean((np.array(ranks) > 0.05) & (np.array(ranks) < 0.95))
    assert inside == pytest.approx(0.9, abs=4.0 * np.sqrt(0.9 * 0.1 / 40))
    assert np.mean(ranks) == pytest.approx(0.5, abs=4.0 / np.sqrt(12.0 * 40))
    assert np.sqrt(np.mean(np.square(scores))) == pytest.approx(1.0, abs=4.0 / np.sqrt(2.0 * 40))
    assert np.mean(narrowed) < 0.6
