"""Levers: readings far from zero, where a direction's tolerance moves what a place's tolerance moves too.

A joint at a + ρ u moves with the direction u of its rail as with its place a, times the reading ρ (RR-8096 eq. 30): a
tolerance of u turns the rail about the point where ρ is zero. Readings of 731 mm with a tolerance of 0.5 mrad add
0.37 mm to the joint's, and of a and u the poses determine little more than the sum. With the zero in the middle of the
readings each is a dimension of its own. Whatever the machine, such a direction is known by its derivative: that of
places of the same member times the reading.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.identifiability.directions import Direction
from bayescal.numerics.geometry import Array

MIN_LEVER_HALF_RANGES = 2.0
"""How many half ranges of its readings a lever is long, from which on it is worth saying."""
SHARE = 0.05
"""Of a ridge, from which on a parameter takes part in it."""
EXACT = 1e-3  # of a derivative, that may be left of it where direction and place are not quite nominal


@dataclass(frozen=True)
class Lever:
    """A channel that reads far from zero."""

    channel: str
    reading: float  # the middle of what it reads, mm
    moved: float  # how far a tolerance of the direction moves the place there, mm


def find_levers(posterior: CalibrationPosterior, y: Array, directions: Sequence[Direction]) -> Iterator[Lever]:
    """Yield the levers by which directions, of n parameters, tie a place to a direction, at a machine y (n + k,)."""
    likelihood, names = posterior.likelihood, posterior.sampling.names
    model, data, theta = likelihood.model, likelihood.data, posterior.theta(y[None])[0]
    slope = model.linearise(theta, likelihood.start, True, data.given).by_parameters @ posterior.sampling.moved.T
    units, sd = np.array(posterior.units[: len(names)]), posterior.prior_sd
    members = [name.partition("[")[2] for name in names]
    strong = [one.vector**2 >= SHARE for one in directions]
    for k, channel in enumerate(model.channels):
        read, member = data.values[:, k], channel.name.partition("[")[2]
        middle, half = float(np.nanmean(read)), 0.5 * float(np.nanmax(read) - np.nanmin(read))
        if channel.external or channel.unit != "mm" or not member or abs(middle) <= MIN_LEVER_HALF_RANGES * half:
            continue
        own = np.array([one == member for one in members])
        places, turns = np.flatnonzero(own & (units == "mm")), np.flatnonzero(own & (units != "mm"))
        if not len(places):
            continue
        at_reading = (read[:, None, None] * slope[..., places]).reshape(-1, len(places))
        for turn in turns:
            wanted = slope[..., turn].ravel()
            share, *_ = np.linalg.lstsq(at_reading, wanted, rcond=None)
            size = np.linalg.norm(wanted)
            if not size > 0.0 or np.linalg.norm(wanted - at_reading @ share) > EXACT * size:
                continue
            tied = places[np.abs(share) > SHARE]
            if any(one[turn] and one[tied].any() for one in strong):
                yield Lever(channel.name, middle, abs(middle) * float(np.linalg.norm(share)) * float(sd[turn]))
