"""What the ranks of simulated truths say: uniform or not, how many the intervals hold, how far estimates are off."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bayescal.experiments.check.bands import find_band
from bayescal.experiments.check.faults.finding import Finding
from bayescal.experiments.check.ranks import PRIOR
from bayescal.limits import COVERAGE, PARETO_K_LIMIT
from bayescal.numerics.geometry import Array

FAULT = "calibration"
FALSE_ALARMS = 0.01  # of all parameters together
OFF = 3.5  # standard errors of a coverage
OFF_SHARE = 0.02


def judge_ranks(whence: str, names: tuple[str, ...], rank: Array, z: Array, quality: Array, n: int) -> Finding:
    """Return whether ranks (D, n) in shares of D out of so many data sets are uniform; z and quality likewise."""
    check = f"Simulated from the {whence}"
    if len(rank) < n / 2:
        return Finding(check, FAULT, "bad", f"only {len(rank)} of {n} data sets have a posterior that is found.")
    uneven = find_uneven(names, rank)
    held, error = measure_coverage(rank)
    rms = float(np.sqrt(np.mean(z**2)))
    poor = float(np.mean(quality[:, 1] > PARETO_K_LIMIT))
    said = f"90 % intervals hold {100 * held:.1f} ± {100 * error:.1f} % of the truth"
    said += f", estimates are off by {rms:.2f} sd (rms)"
    said += f", in {len(rank)} of {n} data sets" if len(rank) < n else f", in {n} data sets"
    said += f"; in {100 * poor:.0f} % of them ensembles took over from importance sampling" if poor else ""
    chance = np.sqrt(COVERAGE * (1.0 - COVERAGE) / rank.size)  # few data sets may all be held
    off = abs(held - COVERAGE) > max(OFF * max(error, chance), OFF_SHARE)
    if not off and not uneven:
        return Finding(check, "", "good", f"all ranks are uniform; {said}.")
    how = "too narrow" if held < COVERAGE else "too wide"
    which = f"ranks of {', '.join(uneven)} are not uniform; " if uneven else ""
    where = "the priors" if whence == PRIOR else "the measured machine"
    text = f"{which}{said}. Intervals about {where} are {how if off else 'biased'}: do not rely on them."
    return Finding(check, FAULT, "bad", text)


def find_uneven(names: tuple[str, ...], rank: Array) -> list[str]:
    """Return the parameters whose ranks, columns of (D, n), leave the band of uniform ones."""
    band = find_band(len(rank), FALSE_ALARMS / len(names))
    return [name for k, name in enumerate(names) if not band.holds(rank[:, k])]


def measure_coverage(rank: Array) -> tuple[float, float]:
    """Return the share of ranks (D, n) within the middle 90 %, and its standard error over data sets."""
    tail = 0.5 * (1.0 - COVERAGE)
    held = np.mean((rank > tail) & (rank < 1.0 - tail), axis=1)
    return float(held.mean()), float(held.std(ddof=1) / np.sqrt(len(held)))


def tabulate_parameters(whence: str, names: tuple[str, ...], rank: Array, z: Array) -> pd.DataFrame:
    """Return a row per parameter: uniform or not, coverage, and how far estimates are off."""
    uneven = set(find_uneven(names, rank))
    tail = 0.5 * (1.0 - COVERAGE)
    return pd.DataFrame(
        {
            "simulated_from": whence,
            "parameter": names,
            "uniform": [name not in uneven for name in names],
            "coverage_90": np.mean((rank > tail) & (rank < 1.0 - tail), axis=0),
            "rms_z": np.sqrt(np.mean(z**2, axis=0)),
        }
    )
