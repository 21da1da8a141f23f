"""Intervals and predictions of a wrong model, with and without a structured model error, over many twins.

    python benchmarks/model_error.py --speed
    python benchmarks/model_error.py [--first 0] [--twins 40] [--kernels independent linear] [--variants six_pus/none]
                                     [--scale 20] [--spread 0.05] [--length 5] [--length-spread 1] [--drawn]
                                     [--blunders 2]

Twins of the telescope are drawn from the priors of the telescope's study, deformed by eq. 4's matrix, or with --drawn
by a matrix that is itself drawn from the kernel's prior (a scale from the log-normal, then normal entries), and
surveyed; the variants `none`, which leaves the deformation out, and `matrix`, which is right, are fitted with τ alone
and with a kernel beside it; kernel ``explicit`` is that of the free matrix, whose entries are parameters. With
--length-spread the length is free; with --blunders so many poses are ones whose actuators read 0.2 mm off, and every
pose may be one. Draws are those of the proposal of the mode search, weighted. Printed for every twin and at
the end: share of a, b and l inside their 90 % intervals, rms of their z-scores, mean sd, mean position error of the
verification poses, Laplace's log-evidence, the efficiency of the weights, and of the kernel's scale: its median, the
posterior sd of its logarithm over the prior's, and with --drawn its z-score. With --speed: time of the posterior
density with a kernel over that with τ per leg alone, 60 parameters and 40 poses, the two taking turns.
"""

# ruff: noqa: I001 - telescope_problem comes before NumPy: it sets the number of threads

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

from telescope_problem import MODEL_ERROR_SCALE, simulate, time_interleaved  # first: threads

import numpy as np

from bayescal.data.photogrammetry.poses import extract_poses
from bayescal.experiments.simulation.twin import Twin, build_twin, simulate_survey
from bayescal.density.legs import BATCH
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.errors import KernelScale
from bayescal.density.priors import SCALE, LinearKernel, SmoothKernel
from bayescal.density.errors import ModelError
from bayescal.density.legs import LegPosterior, build_leg_posterior
from bayescal.density.prediction import replicate
from bayescal.density.schema import BlundersConfig, NormalConfig
from bayescal.density.structured import StructuredLikelihood
from bayescal.density.prediction import predict_structured
from bayescal.experiments.frame.load import load_experiment
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.measurement import TargetMeasurement
from bayescal.experiments.shared.study_schema import StudyConfig, VariantConfig
from bayescal.inference.exploration import MAX_PILOTS, explore
from bayescal.inference.importance import resample
from bayescal.machines.deformations import MatrixDeformation
from bayescal.numerics.geometry import Array

TELESCOPE = Path(__file__).parents[1] / "experiments" / "telescope"
JUDGED = ("a_x", "a_y", "b_x", "b_y", "l")
DRAWS, KEPT, PREDICTIVE = 6000, 2000, 300
EXPLICIT = "explicit"
BLUNDER = 0.2  # mm
VARIANTS = ("six_pus/none", "six_pus/matrix")


def draw_truth(twin: Twin, config: StudyConfig, seed: int, symbols: tuple[str, ...] = (*JUDGED, "kappa")) -> Array:
    """Return a machine whose parameters of some symbols are drawn from the study's priors, shape (D,)."""
    rng, layout, theta = np.random.default_rng([seed, 2]), twin.machine.layout, twin.machine.layout.nominal.copy()
    for symbol in symbols:
        theta[layout.index[symbol]] += rng.normal(0.0, config.parameters[symbol].sd, twin.mechanism.n_legs)
    return theta


def draw_deformation(twin: Twin, scale: float, spread: float, seed: int) -> tuple[Twin, float]:
    """Return the twin with a matrix drawn from the linear kernel's prior, and the scale drawn for it, mm."""
    rng, n = np.random.default_rng([seed, 3]), twin.mechanism.n_legs
    drawn = scale * np.exp(spread * rng.standard_normal())
    matrix = drawn / twin.mechanism.actuator_range * rng.standard_normal((n, n))
    return replace(twin, machine=replace(twin.machine, deformation=MatrixDeformation(matrix))), float(drawn)


def survey(twin: Twin, config: StudyConfig, theta: Array, seed: int, n_blunders: int = 0) -> StudyInputs:
    """Return a study of a survey of a machine, some of its calibration poses blunders."""
    measured = simulate_survey(twin, np.random.default_rng(seed), theta)
    rng = np.random.default_rng([seed, 5])
    spoilt = rng.choice(np.flatnonzero(~measured.verification), n_blunders, replace=False)
    actuators = measured.actuators.copy()
    actuators[spoilt] += BLUNDER * rng.standard_normal((n_blunders, twin.mechanism.n_legs))
    measured = replace(measured, actuators=actuators)
    poses = extract_poses(measured, 1e-3 * config.data.target_noise_um)
    return StudyInputs(config, TELESCOPE, twin.mechanism, TargetMeasurement(measured, poses, "robust"))


def choose(inputs: StudyInputs, name: str, kernel: str) -> tuple[StudyInputs, VariantConfig]:
    """Return a variant with a kernel; in place of an explicit one, its deformation with all entries of K free."""
    variant = inputs.variant(name)
    if kernel != EXPLICIT:
        return inputs, variant.model_copy(update={"model_error": kernel})
    symbols = [f"K_{k + 1}" for k in range(inputs.mechanism.n_legs)]
    sd = 1e-3 * inputs.config.model_error.kernel_scale_um / inputs.mechanism.actuator_range
    entries = dict.fromkeys(symbols, NormalConfig(prior="normal", sd=sd))
    config = inputs.config.model_copy(update={"parameters": {**inputs.config.parameters, **entries}})
    variant = variant.model_copy(update={"deformation": "free_matrix", "free": [*variant.free, *symbols]})
    return replace(inputs, config=config), variant


def judge(
    inputs: StudyInputs, twin: Twin, theta: Array, name: str, kernel: str, seed: int, scale: float | None
) -> dict[str, float]:
    """Return the figures of one variant; the true scale, if there is one, in mm."""
    inputs, variant = choose(inputs, name, kernel)
    posterior = inputs.posterior(variant, with_model_error=True)
    # slopes that are parameters are more than Laplace's approximation is good for
    found = explore(posterior, np.random.SeedSequence(seed), max_pilots=MAX_PILOTS if kernel == EXPLICIT else 0)
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
        **judge_scale(inputs, posterior, y, scale),
    }


def judge_scale(inputs: StudyInputs, posterior: LegPosterior, y: Array, truth: float | None) -> dict[str, float]:
    """Return what draws tell of the kernel's scale where there is an error, and how far that is from the truth."""
    places = [k for k, name in enumerate(posterior.names) if name.startswith(SCALE)]
    if not places:
        return {}
    scale = posterior.natural(y)[:, places[0]]
    there = scale > 0.0
    if there.mean() < 0.5:
        return {"present": float(there.mean())}
    size = np.log(scale[there])
    found = {"scale_um": 1e3 * float(np.exp(np.median(size))), "present": float(there.mean())}
    found["scale_narrowed"] = float(size.std() / inputs.config.model_error.kernel_spread)
    if truth is not None:
        found["scale_z"] = float((size.mean() - np.log(truth)) / size.std())
    return found


def measure_poses(inputs: StudyInputs, posterior: LegPosterior, variant: object, y: Array) -> float:
    """Return the mean position error of the verification poses, mm."""
    held, rng = inputs.likelihood(variant, verification=True), np.random.default_rng(0)
    likelihood, theta, errors = posterior.likelihood, posterior.theta(y), posterior.errors.amplitudes(posterior.zeta(y))
    if isinstance(likelihood, StructuredLikelihood):
        assert isinstance(held, PoseLikelihood)
        return float(predict_structured(likelihood, held, theta, errors, rng)[0].summarise().position_error.mean())
    return float(replicate(held, theta, errors, rng).summarise().position_error.mean())


def time_density(repeats: int) -> None:
    """Print the time of the posterior density with kernels over that with τ per leg alone."""
    problem, rng = simulate(), np.random.default_rng(0)
    plain = problem.posterior(model_error=True)
    y = 1e-3 * rng.normal(size=(BATCH, plain.n_parameters + 1))
    contestants = {"independent": lambda: plain.log_density(y[:, :-1])}
    for kernel in (LinearKernel(), SmoothKernel(5.0)):
        likelihood = StructuredLikelihood(plain.likelihood, kernel, problem.machine.mechanism.actuator_range)
        scale = KernelScale(0.02, 0.05)
        one = build_leg_posterior(likelihood, plain.priors, ModelError(MODEL_ERROR_SCALE), terms=(scale,))
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
    parser.add_argument("--kernels", nargs="+", default=("independent", "linear"))
    parser.add_argument("--scale", type=float, default=20.0)
    parser.add_argument("--spread", type=float, default=0.05)
    parser.add_argument("--length", type=float, default=5.0)
    parser.add_argument("--length-spread", type=float)
    parser.add_argument("--blunders", type=int, default=0)
    parser.add_argument("--drawn", action="store_true")
    parser.add_argument("--variants", nargs="+", default=VARIANTS)
    parser.add_argument("--speed", action="store_true")
    arguments = parser.parse_args()
    if arguments.speed:
        time_density(40)
        return
    twin, config = (
        build_twin(load_experiment(TELESCOPE / "simulate.toml"), TELESCOPE),
        load_experiment(TELESCOPE / "study.toml"),
    )
    prior = {"kernel_scale_um": arguments.scale, "kernel_spread": arguments.spread}
    prior |= {"kernel_length": arguments.length, "kernel_length_spread": arguments.length_spread}
    config = config.model_copy(update={"model_error": config.model_error.model_copy(update=prior)})
    if arguments.blunders:
        config = config.model_copy(update={"blunders": BlundersConfig()})
    figures: dict[tuple[str, str], list[dict[str, float]]] = {}
    for seed in range(arguments.first, arguments.first + arguments.twins):
        one_twin, scale = twin, None
        if arguments.drawn:
            one_twin, scale = draw_deformation(twin, 1e-3 * arguments.scale, arguments.spread, seed)
        theta = draw_truth(one_twin, config, seed, JUDGED if arguments.drawn else (*JUDGED, "kappa"))
        inputs = survey(one_twin, config, theta, seed, arguments.blunders)
        for name in arguments.variants:
            for kernel in arguments.kernels:
                one = judge(inputs, one_twin, theta, name, kernel, seed, scale)
                figures.setdefault((name, kernel), []).append(one)
                print(json.dumps({"twin": seed, "variant": name, "kernel": kernel, **one}), flush=True)
    for (name, kernel), several in figures.items():
        means = {key: float(np.mean([one[key] for one in several if key in one])) for key in several[0]}
        for key in ("rms_z", "scale_z"):
            if key in several[0]:
                means[key] = float(np.sqrt(np.mean([one[key] ** 2 for one in several if key in one])))
        print(name, kernel, {key: round(value, 3) for key, value in means.items()})


if __name__ == "__main__":
    main()
