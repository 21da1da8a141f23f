"""Model files of TPOINT: the terms of a mount in arcsec with their standard errors.

A caption; a record of how the terms were found (method, number of stars, their root mean square on the sky in arcsec);
then a term a line, in columns as wide as its readers take them: one that chains terms, one that marks a fixed term by
``=``, eight of its name, ten of its value, twelve of its standard error; then ``END``. ``&`` chains a term to the one
before it: all are evaluated where the star stands, none where others have moved it. Azimuths of its formulas are from
north through east, whatever the machine's own are. Below ``END``, where no reader looks, stands what the format cannot
hold.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.stats import qmc

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.errors import InputError
from bayescal.machines.readings.base import ReadingModel
from bayescal.machines.readings.mount import ALTAZIMUTH, DIRECTIONS, MIRRORED, Mount
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import ARCSECOND

ABOVE: Final = 2
"""Lines above the terms."""
VALUE, ERROR = 10, 12
"""Widths of columns."""
MOST_DIGITS: Final = 6
N_DIRECTIONS: Final = 256
LONGEST: Final = 80
"""Characters of the caption."""


def list_tpoint_files(calibrated: CalibratedMachine) -> dict[str, bytes]:
    """Return ``tpoint.mod``, the terms of a mount; InputError for another machine."""
    model = calibrated.model.bare
    machine = getattr(model, "machine", None)
    if not isinstance(machine, Mount):
        raise InputError(f"format tpoint: found machine {calibrated.name!r}, expected one of kind 'mount'")
    names, n = model.layout.names, model.layout.size
    terms, errors = calibrated.theta[:n] / ARCSECOND, calibrated.sd[:n] / ARCSECOND
    if machine.from_south:
        terms = np.where(np.isin(names, MIRRORED), -terms, terms)
    free = np.isin(np.arange(n), calibrated.free)
    directions = _draw_directions(calibrated, model)
    scatter = np.sqrt(np.diagonal(calibrated.errors.covariance(directions[:1], directions[:1])[0])) / ARCSECOND
    sky = np.hypot(scatter[0] * np.cos(directions[:, 1]), scatter[1])
    stars = 0 if calibrated.measured is None else len(calibrated.measured)
    caption = " ".join(calibrated.source.describe()[0].split())[:LONGEST]
    lines = [caption, f"T{stars:5d}{np.sqrt(np.mean(sky**2)):10.4f}"]
    for k, name in enumerate(names):
        if free[k] or terms[k]:
            error = f"{errors[k]:{ERROR}.5f}" if calibrated.covariance is not None and free[k] else ""
            chain = " " if len(lines) == ABOVE else "&"
            lines.append(f"{chain}{' ' if free[k] else '='}{name:8s}{format_value(terms[k])}{error}")
    lines += ["END", *(f"! {one}" for one in _describe_rest(calibrated, model, scatter, directions))]
    return {"tpoint.mod": ("\n".join(lines) + "\n").encode()}


def format_value(value: float) -> str:
    """Return a number in as many characters as a value has, with as many digits as go there."""
    for digits in range(MOST_DIGITS, -1, -1):
        text = f"{value:{VALUE}.{digits}f}"
        if len(text) <= VALUE:
            return text
    raise InputError(f"format tpoint: found a term of {value:g} arcsec, expected at most {VALUE} characters")


def _draw_directions(calibrated: CalibratedMachine, model: ReadingModel) -> Array:
    """Return directions (P, 2) evenly where accuracy counts, rad."""
    low, high = calibrated.workspace if calibrated.workspace is not None else _list_ends(model)
    return np.asarray(low + (high - low) * qmc.Halton(2, rng=1).random(N_DIRECTIONS))


def _list_ends(model: ReadingModel) -> tuple[Array, Array]:
    return model.home_pose - model.pose_scale, model.home_pose + model.pose_scale


def _describe_rest(calibrated: CalibratedMachine, model: ReadingModel, scatter: Array, directions: Array) -> list[str]:
    """Return what the format cannot hold, in numbers."""
    axes = getattr(model, "machine").axes  # noqa: B009  # of a mount
    first, second = (name.replace("_", " ") for name in DIRECTIONS[axes])
    lines = [*calibrated.source.describe()]
    if axes == ALTAZIMUTH:
        lines.append("Terms for azimuths from north through east.")
    lines.append(f"Scatter of a pointing beside the terms: {first} {scatter[0]:.3g}, {second} {scatter[1]:.3g} arcsec.")
    covariance = calibrated.covariance
    if covariance is None:
        return [*lines, "Standard errors are not known."]
    own = calibrated.free < model.layout.size
    covariance, places = covariance[np.ix_(own, own)], calibrated.free[own]
    given = {name: np.zeros(len(directions)) for name in model.given}
    slopes = model.linearise(calibrated.theta[: model.layout.size], directions, True, given).by_parameters[
        :, :2, places
    ]
    together = np.sqrt(np.einsum("pki,ij,pkj->pk", slopes, covariance, slopes)) / ARCSECOND
    apart = np.sqrt(slopes**2 @ np.diagonal(covariance)) / ARCSECOND
    one, other = (np.sqrt(np.mean(values**2, axis=0)) for values in (together, apart))
    lines.append(
        f"Standard errors omit correlations: as independent they give an uncertainty of {other[0]:.3g} arcsec "
        f"in {first} and {other[1]:.3g} in {second}, rms over the workspace; it is {one[0]:.3g} and {one[1]:.3g}."
    )
    sd = np.sqrt(np.diagonal(covariance))
    alike = np.tril(covariance / np.outer(sd, sd), -1)
    i, j = np.unravel_index(np.argmax(np.abs(alike)), alike.shape)
    names = model.layout.names
    lines.append(f"The largest correlation is {alike[i, j]:.4f}, of {names[places[i]]} and {names[places[j]]}.")
    return [*lines, "covariance.csv has all of them."]
