"""Importance sampling from the modes against tempering from the prior, which knows of no mode: a battery of posteriors.

Six to twelve poses of the telescope and a few free parameters each, so that both are precise.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
import telescope_machines as machines

from bayescal.density.calibration.terms import NO_ERRORS, ErrorModel
from bayescal.density.priors import NormalPrior, UniformPrior
from bayescal.inference.exploration import integrate_posterior
from bayescal.inference.importance import evaluate_in_batches
from bayescal.inference.schema import EvidenceConfig
from bayescal.inference.tempered import estimate_by_tempering

pytestmark = pytest.mark.slow

AGREED = 0.1  # nats
N_RUNS = 4
STANDARD_ERRORS = 4.5  # of a posterior sd: one false alarm in a thousand batteries of two hundred widths


@dataclass(frozen=True)
class Case:
    """Priors by symbol as a kind, a width and legs; what was measured, what errs, and the chains of tempering.

    Where two legs have modes of their own these have to meet: a few chains lose some of them.
    """

    priors: dict[str, tuple[str, float, tuple[int, ...]]]
    tau: ErrorModel = NO_ERRORS
    noise: float = 1.0
    offsets: dict[str, float] = field(default_factory=dict)
    deformation: str = "none"
    truth: str = "none"
    n_poses: int = 6
    n_chains: int = 192

    def measure(self):
        """Return simulated poses, their noise multiplied."""
        machine = machines.build_machine(self.truth)
        theta, actuators = machine.layout.nominal.copy(), machines.table_3_actuators()[: self.n_poses]
        for name, offset in self.offsets.items():
            theta[machine.layout.names.index(name)] += offset
        exact = machines.place_poses(machine, theta, actuators, np.zeros((self.n_poses, 6)))
        poses = machines.simulate_poses(machine, theta, actuators, np.zeros(6), np.random.default_rng(2))
        position = exact.position + self.noise * (poses.position - exact.position)
        return replace(poses, position=position, covariance=poses.covariance * self.noise**2)

    def posterior(self):
        """Return the posterior."""
        machine = machines.build_machine(self.deformation)
        layout, priors = machine.layout, {}
        for symbol, (kind, width, legs) in self.priors.items():
            for leg in legs:
                value = layout.nominal[layout.index[symbol][leg - 1]]
                narrow, bounded = NormalPrior(value, width), UniformPrior(value - width, value + width)
                priors[f"{symbol}[{leg}]"] = narrow if kind == "normal" else bounded
        found = machines.measure(machine, self.measure(), priors, self.tau, noise=machines.ACTUATOR_NOISE * self.noise)
        return found.with_pose_guesses()


ALL, ONE, TWO = (1, 2, 3, 4, 5, 6), (1,), (1, 2)


def normal(symbols, sd, legs):
    """Return normal priors of several symbols."""
    return dict.fromkeys(symbols, ("normal", sd, legs))


def uniform(symbols, half_width, legs):
    """Return uniform priors of several symbols."""
    return dict.fromkeys(symbols, ("uniform", half_width, legs))


LENGTHS, LEG = normal(["l"], 2.0, ALL), normal(["a_x", "a_y", "b_x", "l"], 2.0, ONE)
JOINTS = normal(["a_x", "a_y", "l"], 2.0, TWO)
SHARED = machines.let_err(shared=True)
CASES = {
    "lengths": Case(LENGTHS),
    "lengths between bounds": Case(uniform(["l"], 2.0, ALL)),
    "truth at a bound": Case(uniform(["l"], 0.5, ALL), offsets={"l[2]": 0.5}),
    "truth cut off": Case(uniform(["l"], 0.01, TWO), offsets={"l[2]": 0.05}),
    "lengths, model error": Case(LENGTHS, SHARED),
    "lengths between bounds, model error": Case(uniform(["l"], 2.0, ALL), SHARED),
    "a model error per leg": Case(normal(["l"], 2.0, TWO), machines.let_err(0.01)),
    "bad misfit": Case(normal(["l", "a_x"], 2.0, TWO), truth="matrix", n_poses=12),
    "bad misfit, model error": Case(normal(["l", "a_x"], 2.0, TWO), SHARED, truth="matrix", n_poses=12),
    "ridge of one leg": Case(normal(["a_x", "a_y", "a_z", "b_z", "l", "rho0"], 1.0, ONE)),
    "ridge of gain and direction": Case(
        LEG | normal(["u_x", "u_y"], 0.05, ONE) | normal(["kappa"], 0.01, ONE), deformation="linear", truth="linear"
    ),
    "ring, narrow": Case(LEG | normal(["u_x", "u_y"], 0.05, ONE)),
    "ring, wide": Case(LEG | normal(["u_x", "u_y"], 0.1, ONE)),
    "ring, wider": Case(LEG | normal(["u_x", "u_y"], 0.2, ONE)),
    "ring, wide, noise 5": Case(LEG | normal(["u_x", "u_y"], 0.1, ONE), noise=5.0),
    "ring between bounds": Case(LEG | uniform(["u_x", "u_y"], 0.1, ONE)),
    "ring between wide bounds": Case(LEG | uniform(["u_x", "u_y"], 0.3, ONE)),
    "ring between wide bounds, noise 5": Case(LEG | uniform(["u_x", "u_y"], 0.3, ONE), noise=5.0),
    "ring, one bounded": Case(LEG | normal(["u_x"], 0.1, ONE) | uniform(["u_y"], 0.2, ONE)),
    "mirror of u_y": Case(LEG | normal(["u_y"], 0.1, ONE)),
    "mirror of u_y, noise 5": Case(LEG | normal(["u_y"], 0.1, ONE), noise=5.0),
    "mirror of u_y, both about one": Case(LEG | normal(["u_y"], 0.1, ONE), noise=5.0, offsets={"u_y[1]": -0.05}),
    "mirror of u_y between bounds": Case(LEG | uniform(["u_y"], 0.3, ONE)),
    "mirror of u_x": Case(LEG | uniform(["u_x"], 0.6, ONE)),
    "mirrors of two legs": Case(JOINTS | uniform(["u_y"], 0.3, TWO), n_chains=1024),
    "mirrors of two legs, noise 5": Case(JOINTS | uniform(["u_y"], 0.3, TWO), noise=5.0, n_chains=1024),
}


def measure_widths(posterior, found, rng):
    """Return posterior sds by weighted draws of a proposal, and the standard errors of their logarithms."""
    x = found.proposal.draw(20_000, rng)
    log_weights = evaluate_in_batches(found.straight.log_density, x) - found.proposal.log_density(x)
    weights = np.where(np.isfinite(log_weights), np.exp(log_weights - log_weights.max()), 0.0)
    weights /= weights.sum()
    natural = posterior.natural(found.straight.y_from_x(np.where(weights[:, None] > 0, x, found.proposal.means[0])))
    square = (natural - weights @ natural) ** 2
    variance = weights @ square
    return np.sqrt(variance), 0.5 * np.sqrt(weights**2 @ (square / variance - 1.0) ** 2)


def compare_runs(natural):
    """Return the standard errors of the logarithms of the sds of all runs' draws, shape (S, n), from their scatter.

    Four runs tell little of a single scatter: none is taken to be smaller than that of all parameters together.
    """
    widths = natural.reshape(N_RUNS, -1, natural.shape[1]).std(axis=1)
    errors = np.log(widths).std(axis=0, ddof=1) / np.sqrt(N_RUNS)
    return np.maximum(errors, np.sqrt(np.mean(errors**2)))


@pytest.mark.parametrize("name", CASES)
def test_evidence_and_widths_are_those_of_tempering(name):
    """Rings close on themselves, which no proposal here follows well: there weights that are unreliable say so."""
    case = CASES[name]
    posterior = case.posterior()
    search_seed, weigh_seed = np.random.SeedSequence(3), np.random.SeedSequence(5)
    found, importance = integrate_posterior(posterior, search_seed, weigh_seed, 128, EvidenceConfig())
    if importance.is_doubtful and name.startswith("ring"):
        pytest.skip("a ring whose weights are reported as unreliable")
    assert not importance.is_doubtful
    sd, error = measure_widths(posterior, found, np.random.default_rng(6))
    check = estimate_by_tempering(posterior, np.random.SeedSequence(1), case.n_chains, N_RUNS)
    natural = posterior.natural(check.y)
    expected = np.sqrt(check.weights @ (natural - check.weights @ natural) ** 2)
    apart = np.log(sd / expected) / np.hypot(error, compare_runs(natural))
    gap = importance.log_evidence - check.log_evidence
    print(
        f"{gap:+.3f} ± {check.standard_error:.3f}, sds {(sd / expected).min():.3f} to {(sd / expected).max():.3f}, "
        f"{np.abs(apart).max():.1f} standard errors, "
        f"efficiency {importance.efficiency:.2f}, k {importance.pareto_k:.2f}, modes {len(found.modes)}"
    )
    assert abs(gap) < AGREED
    assert np.abs(apart).max() < STANDARD_ERRORS
