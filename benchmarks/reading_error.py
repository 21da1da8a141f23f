"""Intervals of self-calibrations whose sensors err by functions of what they read, with and without a model of that.

    python benchmarks/reading_error.py [--first 0] [--twins 24] [--right] [--kernels independent linear smooth]
                                       [--poses 40] [--um 10] [--arcsec 10] [--length 2] [--length-spread 0.3]
                                       [--sensors phi] [--seconds 240]

Twins of the Sliding Star, 8 sensors, drawn within their tolerances. Each carriage's scale is off, by --um at the end of
its range (one standard deviation over carriages), and each encoder sits askew: its readings err by A sin(φ + α), α
anywhere and A as large that it is off by --arcsec at the end of its range, one standard deviation; either but for what
it is at home, which is an offset of the geometry. With --right there are no such errors. Each is calibrated with noise
alone (`independent`) and with kernels of these scales. Draws are those of the proposal of the mode search, weighted.
Printed for every twin and at the end with standard errors from the scatter between twins: share of the machine's
parameters and of the tool's coordinates at the verification poses inside their 90 % intervals, rms of the parameters'
z-scores, their mean sd in tolerances, rms error of the tool, Laplace's log-evidence, the efficiency of the weights, and
how probable either error is.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from bayescal.errors import InputError
from bayescal.experiments.frame.load import load_experiment
from bayescal.experiments.self_calibration.fit import VariantFit
from bayescal.experiments.self_calibration.functions import find_functions
from bayescal.experiments.self_calibration.inputs import ReadingInputs, read_inputs
from bayescal.experiments.self_calibration.schema import (
    ReadingErrorConfig,
    ReadingSimulationConfig,
    ReadingVariantConfig,
    SelfCalibrationConfig,
)
from bayescal.experiments.self_calibration.simulate import simulate_readings
from bayescal.experiments.self_calibration.tool import predict_tool
from bayescal.inference.exploration import explore
from bayescal.inference.importance import resample
from bayescal.machines.read import read_sliding_platform
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import ARCSECOND, MICROMETRE

STAR = Path(__file__).parents[1] / "experiments" / "sliding_star"
RANGES = {"s": 512.0, "phi": 0.426}  # mm and rad
DRAWS, KEPT = 1200, 1000
VERIFICATION = 12
RMS = ("rms_z",)


def write_twin(folder: Path, seed: int, n_poses: int, um: float, arcsec: float) -> None:
    """Write readings and truth of a machine whose sensors err by functions."""
    config = load_experiment(STAR / "simulate.toml")
    assert isinstance(config, ReadingSimulationConfig)
    poses = config.poses.model_copy(update={"n_poses": n_poses})
    config = config.model_copy(update={"poses": poses, "verification_poses": VERIFICATION, "common": []})
    model = read_sliding_platform(STAR / config.machine)
    for name, text in simulate_readings(config, model, np.random.default_rng(seed)).files.items():
        (folder / name).write_text(text if name != "readings.csv" else spoil(text, seed, um, arcsec))


def spoil(text: str, seed: int, um: float, arcsec: float) -> str:
    """Return a table of readings with errors that are functions of them."""
    lines, rng, model = (
        text.splitlines(),
        np.random.default_rng([seed, 7]),
        read_sliding_platform(STAR / "machine.toml"),
    )
    home = dict(zip(model.names, model.read(model.layout.nominal, np.array(model.home)), strict=True))
    start = next(k for k, line in enumerate(lines) if line.startswith("pose,"))
    columns, cells = lines[start].split(","), [line.split(",") for line in lines[start + 1 :]]
    for k, column in enumerate(columns):
        kind = column.partition("_")[0]
        if kind in RANGES and column.split("_")[1].isdigit():
            size = um * MICROMETRE if kind == "s" else arcsec * ARCSECOND
            change, zero = draw_function(kind, size, rng), home[f"{kind}[{column.split('_')[1]}]"]
            for row in cells:
                row[k] = f"{float(row[k]) + change(float(row[k])) - change(zero):.9f}"
    return "\n".join([*lines[: start + 1], *(",".join(row) for row in cells)]) + "\n"


def draw_function(kind: str, size: float, rng: np.random.Generator) -> Any:
    """Return what a sensor errs by as a function of its reading, mm or rad; ``size`` at the end of its range."""
    if kind == "s":
        slope = size * rng.standard_normal() / RANGES[kind]
        return lambda x: slope * x
    turn = rng.uniform(0.0, 2.0 * np.pi)
    ends = RANGES[kind] * np.array([-1.0, 1.0])
    angles = np.linspace(0.0, 2.0 * np.pi, 360, endpoint=False)[:, None]
    height = size / np.sqrt(np.mean((np.sin(ends + angles) - np.sin(angles)) ** 2))
    return lambda x: height * np.sin(x + turn)


def load_twin(folder: Path, kernels: list[str], error: ReadingErrorConfig) -> ReadingInputs:
    """Return the inputs of a self-calibration with a variant for each kernel."""
    config = load_experiment(STAR / "study.toml")
    assert isinstance(config, SelfCalibrationConfig)
    data = {"readings": "readings.csv", "true_parameters": "true_parameters.csv", "true_poses": "true_poses.csv"}
    variants = [
        ReadingVariantConfig(name=kernel, title=kernel, sensors=["s", "phi"], model_error=cast(Any, kernel))
        for kernel in kernels
    ]
    update = {"data": config.data.model_copy(update=data), "variants": variants, "model_error": error}
    config = config.model_copy(update={**update, "machine": str(STAR / config.machine)})
    return read_inputs(config, folder)


def judge(inputs: ReadingInputs, name: str, seed: int) -> dict[str, float]:
    """Return the figures of one variant."""
    variant, truth = inputs.variants[name], inputs.truth
    assert truth is not None
    posterior = inputs.posterior(variant)
    found = explore(posterior, np.random.SeedSequence(seed))
    drawn = resample(found.straight.log_density, found.proposal, np.random.default_rng(seed), DRAWS, KEPT)
    y = found.straight.y_from_x(drawn.draws)
    m = posterior.n_geometry
    draws, expected = posterior.natural(y)[:, :m], truth.theta[posterior.free]
    rank, sd = np.mean(draws < expected, axis=0), draws.std(axis=0)
    functions = find_functions(inputs, variant, posterior, y)
    fit = cast(VariantFit, SimpleNamespace(theta=posterior.theta(y), functions=functions))
    tool = predict_tool(inputs, variant, fit, np.random.default_rng([seed, 1]))
    present = {} if functions is None else {row["sensor"]: row["present"] for row in functions.rows}
    return {
        "coverage": float(np.mean((rank > 0.05) & (rank < 0.95))),
        "rms_z": float(np.sqrt(np.mean(((draws.mean(axis=0) - expected) / sd) ** 2))),
        "sd": float(np.mean(sd / posterior.scale)),
        "tool_coverage": float(tool.inside.mean()),
        "tool_error_um": 1e3 * float(np.sqrt(np.mean(tool.error**2))),
        "log_evidence": float(np.logaddexp.reduce([mode.log_evidence for mode in found.modes])),
        "efficiency": drawn.efficiency,
        **{f"present_{sensor.partition('[')[0]}": share for sensor, share in present.items()},
    }


def summarise(several: list[dict[str, float]]) -> dict[str, str]:
    """Return means with standard errors over twins; rms of what is an rms."""
    result = {}
    for key in several[0]:
        values: Array = np.array([one[key] for one in several])
        mean = float(np.sqrt(np.mean(values**2))) if key in RMS else float(values.mean())
        result[key] = (
            f"{mean:.4g} ± {values.std(ddof=1) / np.sqrt(len(values)):.2g}" if len(values) > 1 else f"{mean:.4g}"
        )
    return result


def main() -> None:
    """Print the figures of every twin, then the means."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--twins", type=int, default=24)
    parser.add_argument("--poses", type=int, default=40)
    parser.add_argument("--kernels", nargs="+", default=["independent", "linear", "smooth"])
    parser.add_argument("--um", type=float, default=10.0)
    parser.add_argument("--arcsec", type=float, default=10.0)
    parser.add_argument("--length", type=float, default=2.0)
    parser.add_argument("--length-spread", type=float)
    parser.add_argument("--spread", type=float, default=0.05)
    parser.add_argument("--sensors", nargs="+", help="which may err so, by the model; both kinds by default")
    parser.add_argument("--right", action="store_true")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="after which no other twin is begun")
    arguments = parser.parse_args()
    error = ReadingErrorConfig(
        kernel_scale_um=arguments.um,
        kernel_scale_arcsec=arguments.arcsec,
        kernel_length=arguments.length,
        kernel_length_spread=arguments.length_spread,
        kernel_spread=arguments.spread,
        kernel_sensors=arguments.sensors,
    )
    size = (0.0, 0.0) if arguments.right else (arguments.um, arguments.arcsec)
    figures: dict[str, list[dict[str, float]]] = {}
    begun = time.monotonic()
    for seed in range(arguments.first, arguments.first + arguments.twins):
        if time.monotonic() - begun > arguments.seconds:
            break
        with tempfile.TemporaryDirectory() as folder:
            write_twin(Path(folder), seed, arguments.poses, *size)
            try:
                inputs = load_twin(Path(folder), arguments.kernels, error)
            except InputError as refused:  # a machine whose poses are not found from the one expected
                print(json.dumps({"refused": seed, "why": str(refused)}), flush=True)
                continue
        for kernel in arguments.kernels:
            one = judge(inputs, kernel, seed)
            figures.setdefault(kernel, []).append(one)
            print(json.dumps({"twin": seed, "kernel": kernel, **one}), flush=True)
    for kernel, several in figures.items():
        print(kernel, summarise(several))


if __name__ == "__main__":
    main()
