"""Intervals and predictions of a wrong model, with and without a structured model error, over many twins.

    python benchmarks/model_error.py --speed
    python benchmarks/model_error.py [--first 0] [--twins 40] [--kernel linear] [--scale 20] [--spread 0.05]

Twins of the telescope are drawn from the priors of the telescope's study, deformed by eq. 4's matrix and surveyed; the
variants `none`, which leaves the deformation out, and `matrix`, which is right, are fitted with τ alone and with a
kernel beside it. Draws are those of the proposal of the mode search, weighted. Printed for every twin and at the end:
share of a, b and l inside their 90 % intervals, rms of their z-scores, mean sd, mean position error of the verification
poses, Laplace's log-evidence and the efficiency of the weights. With --speed: time of the posterior density with a
kernel over that with τ per leg alone, 60 parameters and 40 poses, the two taking turns.
"""

# ruff: noqa: I001 - telescope_problem comes before NumPy: it sets the number of threads

from __future__ import annotations

import argparse
import json
from pathlib import Path

from telescope_problem import MODEL_ERROR_SCALE, simulate, time_interleaved  # first: threads

import numpy as np

from bayescal.data.photogrammetry.poses import extract_poses
from bayescal.data.simulation import Twin, build_twin, simulate_survey
from bayescal.density.likelihood import BATCH, PoseLikelihood
from bayescal.density.model_error import KernelScale, LinearKernel, SmoothKernel
from bayescal.density.posterior import ModelError, Posterior
from bayescal.density.prediction import predict
from bayescal.density.structured import StructuredLikelihood
from bayescal.density.structured_posterior import StructuredPosterior
from bayescal.density.structured_prediction import predict_structured
from bayescal.experiments.frame.load import load_experiment
from bayescal.experiments.simulation.load import load_simulation
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.measurement import TargetMeasurement
from bayescal.experiments.study.schema import StudyConfig
from bayescal.inference.exploration import explore
from bayescal.inference.importance import resample
from bayescal.numerics.geometry import Array

TELESCOPE = Path(__file__).parents[1] / "experiments" / "telescope"
JUDGED = ("a_x", "a_y", "b_x", "b_y", "l")
DRAWS, KEPT, PREDICTIVE = 6000, 2000, 300
VARIANTS = ("six_pus/none", "six_pus/matrix")


def draw_truth(twin: Twin, config: StudyConfig, seed: int) -> Array:
    """Return a machine drawn from the study's priors, shape (D,)."""
    rng, layout, theta = np.random.default_rng([seed, 2]), twin.machine.layout, twin.machine.layout.nominal.copy()
    for symbol in (*JUDGED, "kappa"):
        theta[layout.index[symbol]] += rng.normal(0.0, config.parameters[symbol].sd, twin.mechanism.n_legs)
    return theta


def survey(twin: Twin, config: StudyConfig, theta: Array, seed: int) -> StudyInputs:
    """Return a study of a survey of a machine."""
    measured = simulate_survey(twin, np.random.default_rng(seed), theta)
    poses = extract_poses(measured, 1e-3 * config.data.target_noise_um)
    return StudyInputs(config, TELESCOPE, twin.mechanism, TargetMeasurement(measured, poses, "robust"))


def judge(inputs: StudyInputs, twin: Twin, theta: Array, name: str, kernel: str, seed: int) -> dict[str, float]:
    """Return the figures of one variant."""
    variant = inputs.variant(name).model_copy(update={"model_error": kernel})
    posterior = inputs.posterior(variant, with_model_error=True)
    found = explore(posterior, np.random.SeedSequence(seed), max_pilots=0)
    drawn = resample(found.straight.log_density, found.proposal, np.random.default_rng(seed), DRAWS, KEPT)
    y = found.straight.y_from_x(drawn.draws)
    names, truth = posterior.names[: posterior.n_geometry], dict(zip(twin.machine.layout.names, theta, strict=True))
    judged = [k for k, one in enumerate(names) if one.split("[")[0] in JUDGED]
    draws, expected = posterior.natural(y)[:, judged], np.array([truth[names[k]] for k in judged])
    rank, sd = np.mean(draws < expected, axis=0), draws.std(axis=0)
    return {
        "coverage": float(np.mean((rank > 0.05) & (rank < 0.95))),
        "rms_z": float(np.sqrt(np.mean(((draws.mean(axis=0) - expected) / sd) ** 2))),
        "sd_mm": float(sd.mean()),
        "pose_error_um": 1e3 * measure_poses(inputs, posterior, variant, y[:PREDICTIVE]),
        "log_evidence": found.modes[0].log_evidence,
        "efficiency": drawn.efficiency,
    }


def measure_poses(inputs: StudyInputs, posterior: Posterior, variant: object, y: Array) -> float:
    """Return the mean position error of the verification poses, mm."""
    held, rng = inputs.likelihood(variant, verification=True), np.random.default_rng(0)
    likelihood, theta, errors = posterior.likelihood, posterior.theta(y), posterior.model_errors(y)
    if isinstance(likelihood, StructuredLikelihood):
        assert isinstance(held, PoseLikelihood)
        return float(predict_structured(likelihood, held, theta, errors, rng)[0].position_error.mean())
    return float(predict(held, theta, errors, rng).position_error.mean())


def time_density(repeats: int) -> None:
    """Print the time of the posterior density with kernels over that with τ per leg alone."""
    problem, rng = simulate(), np.random.default_rng(0)
    plain = problem.posterior(model_error=True)
    y = 1e-3 * rng.normal(size=(BATCH, plain.n_parameters + 1))
    contestants = {"independent": lambda: plain.log_density(y[:, :-1])}
    for kernel in (LinearKernel(), SmoothKernel(5.0)):
        likelihood = StructuredLikelihood(plain.likelihood, kernel, problem.machine.mechanism.actuator_range)
        scale = KernelScale(0.02, 0.05)
        one = StructuredPosterior(likelihood, plain.priors, ModelError(MODEL_ERROR_SCALE), kernel_scale=scale)
        contestants[kernel.name] = lambda one=one: one.log_density(y)
    seconds = time_interleaved(contestants, repeats)
    for name, times in seconds.items():
        ratio = np.median(np.array(times) / np.array(seconds["independent"]))
        print(f"{name:12} {1e6 * np.median(times) / BATCH:8.1f} µs, {ratio:.2f} times τ per leg")


def main() -> None:
    """Print the figures of every twin, then the means."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--twins", type=int, default=40)
    parser.add_argument("--kernel", default="linear")
    parser.add_argument("--scale", type=float, default=20.0)
    parser.add_argument("--spread", type=float, default=0.05)
    parser.add_argument("--speed", action="store_true")
    arguments = parser.parse_args()
    if arguments.speed:
        time_density(40)
        return
    twin, config = (
        build_twin(load_simulation(TELESCOPE / "simulate.toml"), TELESCOPE),
        load_experiment(TELESCOPE / "study.toml"),
    )
    prior = {"kernel_scale_um": arguments.scale, "kernel_spread": arguments.spread}
    config = config.model_copy(update={"model_error": config.model_error.model_copy(update=prior)})
    figures: dict[tuple[str, str], list[dict[str, float]]] = {}
    for seed in range(arguments.first, arguments.first + arguments.twins):
        theta = draw_truth(twin, config, seed)
        inputs = survey(twin, config, theta, seed)
        for name in VARIANTS:
            for kernel in ("independent", arguments.kernel):
                one = judge(inputs, twin, theta, name, kernel, seed)
                figures.setdefault((name, kernel), []).append(one)
                print(json.dumps({"twin": seed, "variant": name, "kernel": kernel, **one}), flush=True)
    for (name, kernel), several in figures.items():
        means = {key: float(np.mean([one[key] for one in several])) for key in several[0]}
        print(name, kernel, {key: round(value, 3) for key, value in means.items()})


if __name__ == "__main__":
    main()
