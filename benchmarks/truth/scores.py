"""Twins: drawn, measured, calibrated and judged."""

from __future__ import annotations

import argparse
import signal
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from bayescal.errors import NumericalError
from benchmarks.truth.errors import COUPLING, MATRIX, NONE, ROWS, Error, distort
from benchmarks.truth.machines import MACHINES, Carriages
from benchmarks.truth.projects import calibrate, write_project, write_tables
from benchmarks.truth.simulated import Array, Simulated, find_determined

INTERVAL = 0.05, 0.95
WITHIN = 1.6449  # standard deviations to either side that hold 90 %
KEYS = ["machine", "row", "size", "default", "seed"]
BEATEN = 3.0  # nats by which the default beats the right model


def begin_arguments(description: str, seed: int) -> argparse.ArgumentParser:
    """Return what rows of which twins are judged, as arguments of a command."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("rows", nargs="*", metavar="ROW", help=f"of {', '.join(ROWS)}")
    parser.add_argument("--machine", choices=list(MACHINES), default="hexapod")
    parser.add_argument("--sizes", type=float, nargs="+", default=[1.0])
    parser.add_argument("--twins", type=int, default=40)
    parser.add_argument("--seed", type=int, default=seed)
    parser.add_argument("--out", type=Path)
    return parser


@dataclass(frozen=True)
class Score:
    """What became of one twin: shares of true values inside their 90 % intervals, and how wide these are.

    ``sd_ratio`` is the posterior standard deviation over that by the right model, rms over the parameters.
    ``directions`` is NaN where no direction is well determined; everything is where the calibration failed. ``truth``
    is of the tool's true numbers at held-back poses, and ``tool_z`` their errors over the standard deviations that are
    stated, rms; ``gain`` how much log-evidence the default has over no model error, of the row without errors.
    """

    parameters: float
    directions: float
    held: float
    truth: float
    tool_z: float
    gain: float
    sd_ratio: float
    n_directions: int
    problems: int
    seconds: float


FAILED = Score(*[np.nan] * 7, 0, 1, np.nan)


@dataclass(frozen=True, eq=False)
class Twin:
    """A true machine (D,), the poses (P, q) where it was measured, which of them are held back, and the readings.

    ``error`` is what its actuators err by as a function of poses in measuring order, in their units.
    """

    theta: Array
    v: Array
    held: np.ndarray
    values: Array
    error: Error


def draw_twin(name: str, row: str, size: float, seed: int) -> tuple[Simulated, Twin]:
    """Return a machine and a twin of it; machine, poses and noise are the same whatever the row and its size."""
    machine = MACHINES[name]()
    rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
    theta = machine.nominal + machine.sd * rng.standard_normal(machine.nominal.size)
    machine.true = theta
    if row == MATRIX:
        if not isinstance(machine, Carriages):
            raise SystemExit(f"{row}: found machine {name!r}, expected one on carriages")
        machine.matrix = size * COUPLING
    v = machine.draw_poses(theta, sum(machine.counts), rng)
    held = np.isin(np.arange(len(v)), rng.choice(len(v), machine.counts[1], replace=False))
    exact = machine.read(theta, v)
    noise = machine.add_noise(np.zeros_like(exact), rng)
    own = np.random.default_rng([seed, zlib.crc32(row.encode())])
    values, error = distort(machine, row, size, exact, v, own)
    if machine.commanded:  # it stands where it reads the commands, by itself
        n = machine.n_actuators
        v = machine.solve(theta, exact[:, :n] - (values - exact + noise)[:, :n])
        values = np.hstack([exact[:, :n] - noise[:, :n], machine.read(theta, v)[:, n:]])
    return machine, Twin(theta, v, held, values + noise, error)


def judge(name: str, row: str, size: float, folder: Path, seed: int, limit: float = 0.0) -> Score:
    """Return the score of one twin, calibrated by the study of a folder in so many CPU seconds; zero for any number."""
    machine, twin = draw_twin(name, row, size, seed)
    write_tables(machine, twin.values, twin.held, folder)
    commands = twin.values[twin.held, : machine.n_actuators]
    try:
        with limited(limit):
            found = calibrate(machine, folder, seed, commands)
    except (NumericalError, OverTime) as error:
        print(f"{name} {row}, seed {seed}: {error}", flush=True)
        return FAILED
    truth = (twin.theta - machine.nominal) / machine.sd
    draws = (found.draws - machine.nominal) / machine.sd
    right = machine.right_posterior(twin.theta, twin.v[~twin.held])
    directions = find_determined(right)
    off = (found.tool - machine.tool(twin.theta, twin.v[twin.held])) / found.sd
    return Score(
        hold(draws, truth),
        hold(draws @ directions.T, directions @ truth) if len(directions) else np.nan,
        float(found.held.mean()),
        float(np.mean(np.abs(off) <= WITHIN)),
        float(np.sqrt(np.mean(off**2))),
        found.gain,
        float(np.sqrt(np.mean(draws.var(axis=0) / np.diagonal(right)))),
        len(directions),
        int(bool(found.problems)),
        found.seconds,
    )


class OverTime(BaseException):  # nothing on the way may take it for an error of its own
    """A calibration took longer than it may."""


@contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Raise OverTime after so many CPU seconds of this process; never where there are none."""

    def stop(*_: object) -> None:
        raise OverTime(f"unfinished after {seconds:g} CPU seconds")

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def hold(draws: Array, truth: Array) -> float:
    """Return the share of true values (K,) inside the 90 % intervals of draws (T, K)."""
    low, high = np.quantile(draws, INTERVAL, axis=0)
    return float(np.mean((low <= truth) & (truth <= high)))


def judge_twins(
    name: str, row: str, size: float, default: str, twins: int, seed: int, limit: float = 0.0, keep: Path | None = None
) -> Iterator[Score]:
    """Yield the scores of twins one by one; those that a table keeps are taken from there, others written into it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "twin"
        write_project(name, MACHINES[name](), default, path, beside=row == NONE and default == "init")
        for k in range(twins):
            key = (name, row, size, default, 1000 * seed + k)
            score = find_score(key, keep)
            if score is None:
                score = judge(name, row, size, path, key[-1], limit)
                if keep is not None:
                    line = pd.DataFrame([dict(zip(KEYS, key, strict=True)) | vars(score)])
                    line.to_csv(keep, mode="a", header=not keep.exists(), index=False)
            yield score


def find_score(key: tuple[str, str, float, str, int], keep: Path | None) -> Score | None:
    """Return the score of a twin that a table has; None where it has none."""
    if keep is None or not keep.exists():
        return None
    known = pd.read_csv(keep).set_index(KEYS)
    return Score(**known.loc[[key]].iloc[-1]) if key in known.index else None


def summarise(scores: list[Score]) -> dict[str, float]:
    """Return percentages with standard errors from the scatter between twins, since entries of one err together."""
    found: dict[str, float] = {"twins": len(scores)}
    for what in ("parameters", "directions", "held", "truth"):
        values = np.array([getattr(one, what) for one in scores])
        values = 100.0 * values[np.isfinite(values)]
        error = values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else np.nan
        found |= {what: round(float(values.mean()), 1) if len(values) else np.nan, f"{what}_se": round(float(error), 1)}
    ratios = [one.sd_ratio for one in scores if np.isfinite(one.sd_ratio)]
    found["sd_ratio"] = round(float(np.mean(ratios)), 2) if ratios else np.nan
    off = [one.tool_z**2 for one in scores if np.isfinite(one.tool_z)]
    found["tool_z"] = round(float(np.sqrt(np.mean(off))), 2) if off else np.nan
    gains = np.array([one.gain for one in scores if np.isfinite(one.gain)])
    found["beaten"] = round(100.0 * float(np.mean(gains > BEATEN)), 1) if len(gains) else np.nan
    found["gain"] = round(float(np.median(gains)), 2) if len(gains) else np.nan
    found["n_directions"] = round(float(np.mean([one.n_directions for one in scores])), 1)
    found["unconverged"] = int(sum(one.problems for one in scores))
    seconds = [one.seconds for one in scores if np.isfinite(one.seconds)]
    found["cpu_s"] = round(float(np.mean(seconds)), 2) if seconds else np.nan
    return found
