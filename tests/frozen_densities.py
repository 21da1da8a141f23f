"""Densities of shipped variants of readings as they were before posteriors were merged, at 20 points each.

``tests/frozen/densities.json`` has a line for each posterior: its mode and the conditional standard deviations there,
in sampling coordinates, and what it was at 20 points: the mode, 13 points about it and 6 of the prior. Points are drawn
from a seed by the posterior's name. `measure` gets at a posterior by the public construction alone, config, inputs,
posterior, one function per kind of experiment: where these change, the frozen numbers stay.

The file is made again, by code whose numbers are trusted, with

    PYTHONPATH=tests python -m frozen_densities
"""

from __future__ import annotations

import json
import zlib
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

from bayescal.density.calibration.functions import FunctionErrors, Travel
from bayescal.density.calibration.terms import ErrorModel
from bayescal.experiments.runner.load import load
from bayescal.experiments.shared.readings.inputs import read_inputs
from bayescal.inference.mode import find_modes
from bayescal.numerics.units import ARCSECOND, MICROMETRE

ROOT = Path(__file__).parents[1]
FILE = Path(__file__).parent / "frozen" / "densities.json"
N_POINTS, N_NEAR = 20, 13
NEAR = (0.3, 1.0, 2.0)  # conditional standard deviations about the mode
PRIOR = 0.5  # prior standard deviations about the machine as expected
DIGITS = 13

SHIPPED = (
    "experiments/hangprinter/study.toml",
    "experiments/m2_hexapod_table/study.toml",
    "examples/own_machine/study.toml",
    "experiments/sliding_star/study.toml",
)


def list_posteriors():
    """Return posteriors by name: shipped variants, and some with what no shipped variant has."""
    found = {}
    for path in SHIPPED:
        config = load(ROOT / path)[1].model_copy(update={"model_error": {}})  # frozen before there was a default one
        for name, variant in read_inputs(config, (ROOT / path).parent).variants.items():
            found[f"{path}: {name}"] = lambda variant=variant: variant.posterior().with_pose_guesses()
    path = ROOT / "experiments/sliding_star/study.toml"
    variant = read_inputs(load(path)[1], path.parent).variants["s8"]
    for kernel in ("linear", "smooth"):
        found[f"{kernel}: s8"] = lambda kernel=kernel: build_with_functions(variant, kernel)
    return found


def build_with_functions(variant, kernel):
    """Return the posterior of Sliding Star whose sensors err by functions of what they read, 20 µm and 20 arcsec large.

    Travels are those of the tool's centre within 200 mm and 30 degrees of home.
    """
    model, places = variant.model, np.arange(len(variant.model.channels))
    machine, origin = variant.whole, np.array(variant.whole.home_pose)
    half = np.array([200.0, 200.0, np.radians(30.0)])
    ends = half * np.array(list(product([-1.0, 0.0, 1.0], repeat=3)))
    angle, tool = origin[2] + ends[:, 2], machine.tool(machine.layout.nominal, origin[None])[0]
    arm = np.stack([np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)], axis=1).reshape(-1, 2, 2)
    pose = np.concatenate([tool + ends[:, :2] - arm @ machine.machine.tool_point, angle[:, None]], axis=1)
    home = model.read(model.layout.nominal, origin)
    travel = np.nanmax(np.abs(model.read(model.layout.nominal, pose) - home), axis=0)
    reach = 1.05 * max(1.0, float(np.abs((variant.data.values - home) / travel).max()))
    length = np.array([channel.unit == "mm" for channel in model.channels])
    scale, units = np.array([20.0 * MICROMETRE, 20.0 * ARCSECOND]), ("mm", "rad")
    functions = FunctionErrors(
        kernel, 5.0, None, places, Travel("reading", places, home, travel), reach, 1 - length.astype(int), scale, 0.05,
        ("s", "phi"), units,
    )  # fmt: skip
    return replace(variant.posterior(), errors=ErrorModel((functions,)))


def draw_points(name, mode, scale):
    """Return the points of a posterior, shape (20, n): the mode, points about it, points of the prior."""
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    z = rng.standard_normal((N_POINTS, len(mode)))
    near = mode + np.resize(NEAR, N_NEAR)[:, None] * scale * z[1 : 1 + N_NEAR]
    return np.concatenate([mode[None], near, PRIOR * z[1 + N_NEAR :]])


def measure(name, posterior, y, scale):
    """Return what a posterior is at points (B, n): density, the poses' share, their gradient per standard deviation.

    A pose's share is weighted by a number of its own, a gradient's entry by another: no two may trade places.
    """
    rng = np.random.default_rng(zlib.crc32(name.encode()) + 1)
    likelihood = posterior.likelihood
    if likelihood.lone is not None and not likelihood.lone.is_own:  # what it leaves out is another test's
        exact = replace(likelihood, lone=None, frozen=None if likelihood.frozen.is_single else likelihood.frozen)
        posterior = replace(posterior, likelihood=exact)
    density = posterior.log_density(y)
    there = np.isfinite(density)
    pointwise = np.full((len(y), 2), np.nan)
    gradient = np.full((len(y), 3), np.nan)
    if there.any():
        each = posterior.pointwise(y[there])
        weights = rng.uniform(0.5, 1.5, each.shape[1])
        pointwise[there] = np.stack([each.sum(axis=1), each @ weights], axis=1)
    across = rng.standard_normal((posterior.n_parameters, 2))
    for k in np.flatnonzero(there):
        slope = posterior.gradient(y[k])[0] * scale
        gradient[k] = [np.linalg.norm(slope), *(slope @ across)]
    return {"density": density, "pointwise": pointwise, "gradient": gradient}


def find_mode(posterior):
    """Return the best mode (n,) and the conditional standard deviations there (n,)."""
    mode = find_modes(posterior)[0].y
    return mode, 1.0 / np.sqrt(-np.diag(posterior.gradient(mode)[1]))


def round_off(values, digits=DIGITS):
    """Return numbers as they are written: None where there is none."""
    values = np.asarray(values)
    if values.ndim:
        return [round_off(one, digits) for one in values]
    return float(f"{values:.{digits - 1}e}") if np.isfinite(values) else None


def read_frozen():
    """Return what is frozen, by the posteriors' names; numbers that there are none of are NaN."""
    entries = json.loads(FILE.read_text())
    return {
        name: {key: np.array(values, dtype=np.float64) for key, values in entry.items()}
        for name, entry in entries.items()
    }


def write_frozen():
    """Make the file again."""
    lines = []
    for name, build in list_posteriors().items():
        posterior = build()
        mode, scale = (np.array(round_off(one, n)) for one, n in zip(find_mode(posterior), (9, 3), strict=True))
        found = measure(name, posterior, draw_points(name, mode, scale), scale)
        digits = {"gradient": 7}
        entry = {"mode": mode.tolist(), "scale": scale.tolist()}
        entry |= {key: round_off(values, digits.get(key, DIGITS)) for key, values in found.items()}
        lines.append(f"{json.dumps(name)}: {json.dumps(entry, separators=(',', ':'))}")
        print(name, found["density"][0], flush=True)
    FILE.parent.mkdir(exist_ok=True)
    FILE.write_text("{\n" + ",\n".join(lines) + "\n}\n")


if __name__ == "__main__":
    write_frozen()
