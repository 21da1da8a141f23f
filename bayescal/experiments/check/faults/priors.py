"""Tolerances that are too tight: how far the measured machine lies from nominal, in what the priors let expect.

In units of the tolerances a posterior mean has the prior covariance 1 - C, with C that of the posterior. Along the
directions that the data inform, its squared length is χ²; a tolerance stated three times too small makes it nine times
as large.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from bayescal.experiments.check.faults.finding import Finding
from bayescal.experiments.shared.measured import Found
from bayescal.limits import INFORMED
from bayescal.numerics.geometry import Array
from bayescal.report.numbers import join_words

CHECK, FAULT = "Tolerances", "prior"
IMPROBABLE = 1e-3  # of all groups together


def check_priors(posterior: Found, draws: Array) -> Finding:
    """Return whether the machine lies within its tolerances; draws of the posterior in natural units, (S, n)."""
    names = posterior.names[: posterior.n_geometry]
    priors = [posterior.priors[name] for name in names]
    values = (draws[:, : len(names)] - [p.mean for p in priors]) / [p.sd for p in priors]
    mean, expected = values.mean(axis=0), np.eye(len(names)) - np.atleast_2d(np.cov(values, rowvar=False))
    symbols = np.array([name.partition("[")[0] for name in names])
    groups = {symbol: np.flatnonzero(symbols == symbol) for symbol in dict.fromkeys(symbols.tolist())}
    found = {"all together": _measure(mean, expected, np.arange(len(names)))}
    found |= {symbol: _measure(mean, expected, places) for symbol, places in groups.items()}
    level = IMPROBABLE / len(found)
    off = {name: one for name, one in found.items() if one[1] and chi2.sf(*one) < level}
    if not off:
        square, n = found["all together"]
        said = f"{np.sqrt(square / n):.2g} times as far from nominal as expected" if n else "not determined by the data"
        return Finding(CHECK, "", "good", f"the machine is {said} (rms along {n} informed directions).")
    worst = min(groups, key=lambda name: chi2.sf(*found[name]) if found[name][1] else 1.0)
    named = [name for name in groups if name in off] or [worst]
    times = join_words([f"{name} {np.sqrt(found[name][0] / found[name][1]):.2g} times" for name in named])
    text = (
        f"the machine lies further from nominal than its tolerances allow: in {times} as far as expected. Widen these "
        "priors, or look for what bends the estimates."
    )
    return Finding(CHECK, FAULT, "bad", text)


def _measure(mean: Array, expected: Array, places: np.ndarray) -> tuple[float, int]:
    """Return the squared length of a part of the mean in what is expected of it, and in how many directions."""
    values, vectors = np.linalg.eigh(expected[np.ix_(places, places)])
    informed = values >= INFORMED
    along = mean[places] @ vectors[:, informed]
    return float(np.sum(along**2 / values[informed])), int(informed.sum())
