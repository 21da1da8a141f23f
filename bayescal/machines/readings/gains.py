"""Which parameter is the gain of a channel, whatever the machine: pages name what they advise to free."""

from __future__ import annotations

import numpy as np

from bayescal.machines.readings.base import ReadingModel, draw_points

FEWEST = 5  # readings, of which two make a line
STRAIGHT = 1e-6  # of a derivative, by which it may be off the line
INCLINED = 1e-3  # of a derivative, by which it has to change


def find_gains(model: ReadingModel) -> dict[str, str]:
    """Return by the machine's own channels the parameter that is a gain of each, optional ones among them.

    A gain moves one channel alone, by an amount that is linear in what this reads at all poses: ∂s/∂γ = a + b s. A zero
    (b = 0) is none. Of the nominal machine; instruments beside it are left out.
    """
    own: ReadingModel = getattr(model, "whole", model)
    own = own.with_optional(own.offered)
    _, pose, given = draw_points(own)
    with np.errstate(all="ignore"):
        here = own.linearise(own.layout.nominal, pose, True, given)
    internal = np.flatnonzero([not one.external for one in own.channels])
    slopes = np.abs(np.nan_to_num(here.by_parameters[:, internal])).max(axis=0)
    found: dict[str, str] = {}
    for k, row in zip(internal, slopes, strict=True):
        alone = (row > 0.0) & ((slopes > 0.0).sum(axis=0) == 1)
        read = here.values[:, k]
        good = np.isfinite(read)
        if good.sum() < FEWEST:
            continue
        line = np.stack([np.ones(int(good.sum())), read[good] - read[good].mean()], axis=1)
        for j in np.flatnonzero(alone):
            column = here.by_parameters[good, k, j]
            fit = np.linalg.lstsq(line, column)[0]
            size = float(np.abs(column).max())
            if np.abs(column - line @ fit).max() < STRAIGHT * size and np.ptp(line @ fit) > INCLINED * size:
                found.setdefault(own.channels[k].name, own.layout.names[j])
    return found
