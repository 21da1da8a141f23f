"""A kernel's free length: agreement with the dense kernel, speed, evidence against brute force, recovery over twins.

    python benchmarks/kernel_length.py --density
    python benchmarks/kernel_length.py --speed
    python benchmarks/kernel_length.py [--kernel smooth] [--median 2] [--spread 0.5] [--first 0] [--twins 1]
                                       [--evidence]

The telescope without deformation, 40 poses drawn from the actuators' ranges; a function drawn from the kernel's own
prior, its length from the log-normal, added to what the actuators say. --density: largest difference of the log-density
from that with the dense kernel at each length, over draws of the length's prior. --speed: time of the posterior density
over that of τ per leg, in turns. Otherwise, twin by twin, z-score and rank of the true length's logarithm in its
posterior, the posterior sd over the prior's, the share of geometry inside 90 % intervals; with --evidence the
log-evidence with the length free, and the same integrated over posteriors with fixed lengths.
"""

# ruff: noqa: I001 - telescope_problem comes before NumPy: it sets the number of threads

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass

from telescope_problem import ACTUATOR_NOISE, LENGTH_SD, MODEL_ERROR_SCALE, POSE_NOISE, PRIOR_SD, TELESCOPE  # first
from telescope_problem import time_interleaved

import numpy as np
from scipy.special import logsumexp

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.density.legs import BATCH
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.errors import KernelLength, KernelScale
from bayescal.density.priors import build_kernel
from bayescal.density.errors import ModelError
from bayescal.density.legs import LegPosterior, build_leg_posterior
from bayescal.density.priors import LogNormalPrior, NormalPrior
from bayescal.density.structured import StructuredLikelihood
from bayescal.inference.exploration import explore
from bayescal.inference.importance import estimate_by_importance, resample
from bayescal.machines.deformations import NoDeformation
from bayescal.machines.kinematics import Machine, solve_forward_kinematics
from bayescal.machines.models.six_pus import SixPus
from bayescal.machines.read import load_mechanism
from bayescal.numerics.geometry import Array, matrix_from_rotation_vector

N_POSES = 40
FREE = ("a_x", "a_y", "b_x", "b_y", "u_x", "l")
SCALE = KernelScale(0.02, 0.3)
DRAWS, KEPT = 6000, 2000
QUADRATURE = np.linspace(-4.0, 4.0, 21)


@dataclass(frozen=True, eq=False)
class Twin:
    """A machine, what was measured of it, and the truth: parameters, and the length of the kernel."""

    likelihood: PoseLikelihood
    theta: Array
    length: float

    def priors(self) -> dict[str, NormalPrior]:
        """Return normal priors about the nominal values."""
        blocks = [block for block in self.likelihood.layout.blocks if block.symbol in FREE]
        return {
            name: NormalPrior(value, PRIOR_SD.get(block.symbol, LENGTH_SD))
            for block in blocks
            for name, value in zip(block.names, block.nominal, strict=True)
        }

    def fixed(self, kernel: str, length: float) -> LegPosterior:
        """Return the posterior with a length that is known."""
        travel = self.likelihood.machine.mechanism.actuator_range
        likelihood = StructuredLikelihood(self.likelihood, build_kernel(kernel, length), travel)
        return build_leg_posterior(likelihood, self.priors(), ModelError(MODEL_ERROR_SCALE), terms=(SCALE,))

    def free(self, kernel: str, lengths: LogNormalPrior) -> LegPosterior:
        """Return the posterior with a length that is not."""
        travel, median = self.likelihood.machine.mechanism.actuator_range, build_kernel(kernel, lengths.median)
        likelihood = StructuredLikelihood(self.likelihood, median, travel, lengths)
        error = ModelError(MODEL_ERROR_SCALE)
        return build_leg_posterior(likelihood, self.priors(), error, terms=(SCALE, KernelLength(lengths)))


def simulate(kernel: str, lengths: LogNormalPrior, seed: int) -> Twin:
    """Return a machine drawn from the priors that errs by a function drawn from its own, and by τ at every pose."""
    rng = np.random.default_rng([seed, 4])
    machine = Machine(load_mechanism(TELESCOPE / "mechanism.toml"), SixPus(), NoDeformation())
    layout, n_legs = machine.layout, machine.mechanism.n_legs
    theta = layout.nominal.copy()
    for symbol in FREE:
        theta[layout.index[symbol]] += rng.normal(size=n_legs) * PRIOR_SD.get(symbol, LENGTH_SD)
    travel = rng.uniform(-1.0, 1.0, (N_POSES, n_legs))
    length = float(lengths.draw(1, rng)[0])
    values, vectors = np.linalg.eigh(build_kernel(kernel, length)(travel, travel))
    size = SCALE.scale * np.exp(SCALE.spread * rng.standard_normal())
    function = size * (vectors * np.sqrt(np.maximum(values, 0.0))) @ rng.standard_normal((N_POSES, n_legs))
    tau = MODEL_ERROR_SCALE * np.abs(rng.standard_normal(n_legs))
    noise = np.hypot(ACTUATOR_NOISE, tau) * rng.standard_normal((N_POSES, n_legs))
    actuators = machine.mechanism.initial_actuator_positions + machine.mechanism.actuator_range * travel
    reached = solve_forward_kinematics(machine, theta, actuators + function + noise)
    seen = POSE_NOISE * rng.standard_normal((N_POSES, 6))
    poses = MeasuredPoses(
        names=tuple(f"pose {k + 1}" for k in range(N_POSES)),
        position=reached.position + seen[:, :3],
        rotation=matrix_from_rotation_vector(seen[:, 3:]) @ reached.rotation,
        covariance=np.tile(np.diag(POSE_NOISE**2), (N_POSES, 1, 1)),
        actuators=actuators,
    )
    return Twin(PoseLikelihood(machine, poses, ACTUATOR_NOISE), theta, length)


def judge(twin: Twin, kernel: str, lengths: LogNormalPrior, seed: int) -> dict[str, float]:
    """Return what the posterior of a twin says of its length and of its geometry."""
    posterior = twin.free(kernel, lengths)
    found = explore(posterior, np.random.SeedSequence(seed), max_pilots=0)
    drawn = resample(found.straight.log_density, found.proposal, np.random.default_rng(seed), DRAWS, KEPT)
    draws = posterior.natural(found.straight.y_from_x(drawn.draws))
    there = draws[:, -2] > 0.0
    log_length, truth = np.log(draws[there, -1]), np.log(twin.length)
    names = twin.likelihood.layout.names
    expected = np.array([twin.theta[names.index(name)] for name in posterior.names[: posterior.n_geometry]])
    rank = np.mean(draws[:, : posterior.n_geometry] < expected, axis=0)
    return {
        "length": twin.length,
        "z": float((log_length.mean() - truth) / log_length.std()),
        "rank": float(np.mean(log_length < truth)),
        "narrowed": float(log_length.std() / lengths.spread),
        "coverage": float(np.mean((rank > 0.05) & (rank < 0.95))),
        "present": float(there.mean()),
        "efficiency": drawn.efficiency,
    }


def compare_evidences(twin: Twin, kernel: str, lengths: LogNormalPrior, seed: int) -> dict[str, float]:
    """Return the log-evidence with the length free, and integrated over posteriors with the length fixed."""
    free = evaluate_evidence(twin.free(kernel, lengths), seed, 20000)
    fixed = [evaluate_evidence(twin.fixed(kernel, float(lengths.value(c))), seed, 3000) for c in QUADRATURE]
    weight = -0.5 * QUADRATURE**2 - 0.5 * np.log(2.0 * np.pi) + np.log(QUADRATURE[1] - QUADRATURE[0])
    parts = np.array([value for value, _ in fixed]) + weight
    total = float(logsumexp(parts))
    error = float(np.sqrt(np.sum((np.exp(parts - total) * np.array([one for _, one in fixed])) ** 2)))
    return {"free": free[0], "free_se": free[1], "integrated": total, "integrated_se": error, "off": free[0] - total}


def evaluate_evidence(posterior: LegPosterior, seed: int, n_draws: int) -> tuple[float, float]:
    """Return a log-evidence and its standard error."""
    found = explore(posterior, np.random.SeedSequence(seed), max_pilots=0)
    rng = np.random.default_rng(seed)
    evidence = estimate_by_importance(found.straight.log_density, found.proposal, rng, n_draws)
    return evidence.log_evidence, evidence.standard_error


def compare_densities(kernel: str, lengths: LogNormalPrior, n_draws: int = 400) -> None:
    """Print by how much the log-density differs from that of the dense kernel at each length."""
    twin, rng = simulate(kernel, lengths, 0), np.random.default_rng(1)
    posterior = twin.free(kernel, lengths)
    theta = np.tile(twin.theta, (n_draws, 1))
    theta[:, posterior.sampling.free] += 1e-3 * rng.standard_normal((n_draws, posterior.n_geometry))
    scales = [MODEL_ERROR_SCALE * np.abs(rng.standard_normal((n_draws, 6))), 0.02 * rng.uniform(0.5, 1.5, (n_draws, 6))]
    length = lengths.draw(n_draws, rng)
    errors = np.column_stack([*scales, length])
    found = posterior.likelihood(theta, errors)
    dense = [
        twin.fixed(kernel, float(one)).likelihood(theta[k : k + 1], errors[k : k + 1, :-1])[0]
        for k, one in enumerate(length)
    ]
    off = np.abs(found - np.array(dense))
    print(f"{kernel}: largest difference {off.max():.1e}, rms {np.sqrt(np.mean(off**2)):.1e}, of {np.ptp(dense):.0f}")


def time_density(kernel: str, lengths: LogNormalPrior, repeats: int = 40) -> None:
    """Print the time of the posterior density over that with τ per leg alone."""
    twin, rng = simulate(kernel, lengths, 0), np.random.default_rng(0)
    plain, fixed = (
        build_leg_posterior(twin.likelihood, twin.priors(), ModelError(MODEL_ERROR_SCALE)),
        twin.fixed(kernel, 2.0),
    )
    free = twin.free(kernel, lengths)
    y = 1e-3 * rng.normal(size=(BATCH, free.n_parameters))
    y[:, -1] = rng.normal(size=BATCH)
    contestants = {
        "independent": lambda: plain.log_density(y[:, :-2]),
        "length fixed": lambda: fixed.log_density(y[:, :-1]),
        "length free": lambda: free.log_density(y),
    }
    seconds = time_interleaved(contestants, repeats)
    for name, times in seconds.items():
        ratio = np.median(np.array(times) / np.array(seconds["independent"]))
        print(f"{name:12} {1e6 * np.median(times) / BATCH:8.1f} µs, {ratio:.2f} times τ per leg")


def main() -> None:
    """Print what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kernel", default="smooth")
    parser.add_argument("--median", type=float, default=2.0)
    parser.add_argument("--spread", type=float, default=0.5)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--twins", type=int, default=1)
    for flag in ("--density", "--speed", "--evidence"):
        parser.add_argument(flag, action="store_true")
    arguments = parser.parse_args()
    kernel, lengths = arguments.kernel, LogNormalPrior(arguments.median, arguments.spread)
    if arguments.density:
        compare_densities(kernel, lengths)
    if arguments.speed:
        time_density(kernel, lengths)
    if arguments.density or arguments.speed:
        return
    for seed in range(arguments.first, arguments.first + arguments.twins):
        twin = simulate(kernel, lengths, seed)
        action = compare_evidences if arguments.evidence else judge
        print(json.dumps({"twin": seed, **action(twin, kernel, lengths, seed)}), flush=True)


if __name__ == "__main__":
    main()
