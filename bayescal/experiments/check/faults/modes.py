"""Missed modes: searches from mirrored actuators, of one leg and of two, and from machines of the priors."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from bayescal.density.legs import LegPosterior
from bayescal.errors import NumericalError
from bayescal.experiments.check.faults.finding import Finding
from bayescal.inference.mode import Mode, find_mode
from bayescal.inference.target import Target
from bayescal.machines.coordinates import mirror_direction
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


def list_starts(posterior: LegPosterior, best: Array, rng: np.random.Generator) -> list[Array]:
    """Return coordinates of mirrored machines and of draws of the priors, shape (n,) each."""
    single = mirror(posterior, best)
    starts = list(single.values())
    for one, other in list(combinations(single, 2))[:PAIRS]:
        again = mirror(posterior, single[one]).get(other)
        if again is not None:
            starts.append(again)
    return starts + list(rng.standard_normal((STARTS, posterior.n_parameters)))


def mirror(posterior: LegPosterior, y: Array) -> dict[int, Array]:
    """Return y, shape (n,), with one leg's actuator turned to the other direction of its gain, by leg.

    Only legs of which one component of u is free; where both are a ridge joins the two.
    """
    coordinates, layout = posterior.sampling.coordinates, posterior.likelihood.machine.layout
    if not layout.direction_symbols or "rho0" not in layout.index:
        return {}
    theta = coordinates.theta_from_y(y[None, : posterior.n_geometry])[0]
    free = np.stack([np.isin(layout.index[symbol], coordinates.free) for symbol in layout.direction_symbols])
    images = {}
    for leg in np.flatnonzero(free.sum(axis=0) == 1):
        turned = mirror_direction(
            layout, theta, int(leg), int(np.argmax(free[:, leg])), coordinates.legs[leg], coordinates.free
        )
        if turned is not None:
            image = y.copy()
            image[: posterior.n_geometry] = coordinates.y_from_theta(turned)
            images[int(leg)] = image
    return images


def _is_same(one: Mode, other: Mode) -> bool:
    """Whether two climbs ended at the same mode: not far in the posterior sds of either."""
    step = one.y - other.y
    lengths = [float(step @ np.linalg.solve(mode.covariance, step)) for mode in (one, other)]
    return min(lengths) < FAR**2
