"""Missed modes: searches from where one jump leads or two, mirrored legs among them, and from draws of the priors."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from bayescal.errors import NumericalError
from bayescal.experiments.check.faults.finding import Finding
from bayescal.inference.mode import Mode, find_mode
from bayescal.inference.target import Target
from bayescal.numerics.geometry import Array

CHECK, FAULT = "Modes", "mode"
MATTERS = 4.0  # nats that a missed mode's mass may lie below the best
FAR = 5.0  # posterior sds from a known mode
STARTS = 4
PAIRS = 15


def check_modes(posterior: Target, known: list[Mode], starts: list[Array]) -> Finding:
    """Return whether searches from starts, (n,) each, find a mode with mass besides the known ones, the best first."""
    missed: list[Mode] = []
    for start in starts:
        try:
            found = find_mode(posterior, start)
        except (NumericalError, np.linalg.LinAlgError):
            continue
        matters = found.converged and found.log_evidence > known[0].log_evidence - MATTERS
        if matters and not any(_is_same(found, one) for one in (*known, *missed)):
            missed.append(found)
    if not missed:
        return Finding(
            CHECK, "", "good", f"{len(starts)} searches from elsewhere found no mode but the {len(known)} known."
        )
    gain = max(one.log_evidence for one in missed) - known[0].log_evidence
    text = (
        f"{len(missed)} mode{'s' if len(missed) > 1 else ''} with mass that the search does not find, the best "
        f"{gain:+.1f} nats against the one it starts from. Intervals and evidence leave it out: narrow the priors, of "
        "directions above all, or free both components of a direction."
    )
    return Finding(CHECK, FAULT, "bad", text)


def list_starts(posterior: Target, best: Array, rng: np.random.Generator) -> list[Array]:
    """Return where jumps lead, one and two of them, and draws of the priors, coordinates (n,) each."""
    single = dict(posterior.jumps(best))
    pairs = [dict(posterior.jumps(single[one])).get(other) for one, other in list(combinations(single, 2))[:PAIRS]]
    drawn = rng.standard_normal((STARTS, posterior.n_parameters))
    return [*single.values(), *(one for one in pairs if one is not None), *drawn]


def _is_same(one: Mode, other: Mode) -> bool:
    """Whether two climbs ended at the same mode: not far in the posterior sds of either."""
    step = one.y - other.y
    lengths = [float(step @ np.linalg.solve(mode.covariance, step)) for mode in (one, other)]
    return min(lengths) < FAR**2
