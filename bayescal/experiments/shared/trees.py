"""Posteriors as ArviZ keeps them: a tree of named groups in which every variable has its unit.

``observed_data`` holds the readings as measured, rows by channels; what draws of prior and posterior predict stands
beside them. The log-likelihood is that of whole rows: a row is what is left out and compared. ArviZ's LOO-PIT, which
wants a log-likelihood of every number, takes one channel at a time: ``tree.sel(channel="x")``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayescal.calibrated.functions import KnownFunctions, read_known
from bayescal.errors import InputError
from bayescal.files.netcdf import read_netcdf
from bayescal.numerics.geometry import Array

if TYPE_CHECKING:
    import xarray as xr

NAME = "readings"
FUNCTIONS = "functions"
"""Group of what is known of errors that are functions of the pose."""
SAVED_DRAWS = 2000
PRIOR_DRAWS = 500
KEPT_NUMBERS = 2**23
"""Of all draws together that one array keeps: with thousands of poses fewer draws, never too few to say anything."""
LEAST_DRAWS = 200


@dataclass(frozen=True, eq=False)
class Readings:
    """Readings of P rows by K channels: as measured, and as draws say that they would be measured again.

    Attributes
    ----------
    rows, channels, units : sequence of str
        Names of the rows, names and units of the channels.
    observed : ndarray, shape (P, K)
        NaN where nothing was read.
    posterior : ndarray, shape (E, S, P, K)
    prior : ndarray, shape (T, P, K)
    log_likelihood : ndarray, shape (E, S, P)
        Of each row.
    """

    rows: Sequence[str]
    channels: Sequence[str]
    units: Sequence[str]
    observed: Array
    posterior: Array
    prior: Array
    log_likelihood: Array
    meaning: str

    @property
    def unit(self) -> str:
        """The units of all channels, each once."""
        return ", ".join(dict.fromkeys(self.units))

    @property
    def coords(self) -> dict[str, Sequence[Any]]:
        """Names of rows and channels."""
        return {"row": list(self.rows), "channel": list(self.channels)}


@dataclass(frozen=True, eq=False)
class Draws:
    """Draws of n parameters.

    Attributes
    ----------
    names, units : sequence of str
        Of the parameters; ``symbol[k]`` become entries of one variable.
    posterior : ndarray, shape (E, S, n)
        A chain is an ensemble.
    log_density : ndarray, shape (E, S)
    log_prior : ndarray, shape (E, S, n)
        Of each parameter in its own unit.
    prior : ndarray, shape (T, n)
    """

    names: Sequence[str]
    units: Sequence[str]
    posterior: Array
    log_density: Array
    log_prior: Array
    prior: Array


@dataclass(frozen=True, eq=False)
class Group:
    """Further variables: each its values with the names of its dimensions, its unit and what it is."""

    variables: Mapping[str, tuple[tuple[str, ...], Array, str, str]]
    coords: Mapping[str, Sequence[Any]] = field(default_factory=dict)


def name_file(variant: str) -> str:
    """Return the name of a variant's file in the results directory."""
    return f"posterior/{re.sub(r'[^\w.-]+', '_', variant)}.nc"


def choose_draws(n_chains: int, n_draws: int, n_wanted: int = SAVED_DRAWS) -> Array:
    """Return which draws to keep of chains laid end to end, shape (E, S): about n_wanted, as many of each chain."""
    chosen = spread(n_chains * n_draws, n_wanted)
    own = [chosen[chosen // n_draws == chain] for chain in range(n_chains)]
    shortest = min(len(one) for one in own)
    return np.stack([one[:shortest] for one in own])


def limit_draws(n_wanted: int, n_numbers: int) -> int:
    """Return how many draws to keep of which each has so many numbers: all that are wanted, where these are few."""
    return min(n_wanted, max(LEAST_DRAWS, KEPT_NUMBERS // max(n_numbers, 1)))


def spread(n: int, n_wanted: int) -> Array:
    """Return the places of at most n_wanted evenly spread ones among n."""
    return np.linspace(0, n - 1, min(n_wanted, n)).astype(int)


def build_tree(
    draws: Draws, readings: Readings, groups: Mapping[str, Group] | None = None, **attributes: str
) -> xr.DataTree:
    """Return a posterior as an ArviZ DataTree.

    Parameters
    ----------
    groups : mapping of str to Group, optional
        Further groups by their paths.
    **attributes : str
        Of the tree.
    """
    import xarray as xr

    over, both, unit = ("chain", "draw"), ("row", "channel"), readings.unit
    density = {NAME: ((*over, "row"), readings.log_likelihood, "nat", "log-density of all readings of a row")}
    predicted = "readings that would be measured again"
    found = {
        "posterior": _split(draws, draws.posterior, draws.units),
        "sample_stats": _over({"lp": ((), draws.log_density, "nat", "log-density in the proposal's coordinates")}),
        "log_likelihood": _make(Group(density, {"row": list(readings.rows)})),
        "log_prior": _split(draws, draws.log_prior, ["nat"] * len(draws.names)),
        "prior": _split(draws, draws.prior[None], draws.units),
        "observed_data": _make(Group({NAME: (both, readings.observed, unit, readings.meaning)}, readings.coords)),
        "posterior_predictive": _over({NAME: (both, readings.posterior, unit, predicted)}, readings.coords),
        "prior_predictive": _over({NAME: (both, readings.prior[None], unit, predicted)}, readings.coords),
        **{path: _make(group) for path, group in (groups or {}).items()},
    }
    for name in ("observed_data", "posterior_predictive", "prior_predictive"):
        found[name] = found[name].assign_coords(unit=("channel", list(readings.units)))
    tree = xr.DataTree.from_dict(found)
    tree.attrs = attributes
    return tree


def group_functions(functions: KnownFunctions | None, names: Sequence[str]) -> dict[str, Group]:
    """Return what is known of errors that are functions of the pose, beside parameters of these names, as a group."""
    if functions is None:
        return {}
    known = {"channel": list(functions.names), "sort": list(functions.sorts), "parameter": list(names)}
    return {FUNCTIONS: Group(functions.list_arrays(), known)}


def read_functions(path: Path) -> tuple[KnownFunctions, list[str]] | None:
    """Return what is known of such errors, and names of the parameters beside, of a tree's file; None without any."""
    try:
        return read_known(path, FUNCTIONS)
    except (OSError, ValueError, KeyError):  # none is there
        return None


def write_packed(packed: np.ndarray, path: Path) -> None:
    """Write a packed tree: a disk that is full is an error of writing then, not one within HDF5."""
    path.write_bytes(packed.tobytes())


def _split(draws: Draws, values: Array, units: Sequence[str]) -> xr.Dataset:
    """Return values (E, S, n) of the parameters as variables by symbol."""
    places: dict[str, list[int]] = {}
    for k, name in enumerate(draws.names):
        places.setdefault(_symbol(name), []).append(k)
    entries = {s: _list_entries([draws.names[k] for k in own]) for s, own in places.items()}
    shared = _share_dimensions(entries)
    variables: dict[str, tuple[tuple[str, ...], Array, str, str]] = {}
    for s, own in places.items():
        chosen = values[..., own] if shared[s] else values[..., own[0]]
        variables[s] = ((shared[s],) if shared[s] else (), chosen, units[own[0]], "")
    coords = {dim: entries[s] for s, dim in shared.items() if dim}
    return _over(variables, coords)


def _share_dimensions(entries: Mapping[str, Sequence[int | str]]) -> dict[str, str]:
    """Return each symbol's dimension: ``leg`` for all with the entries of the first, a name of its own otherwise."""
    lists = {s: own for s, own in entries.items() if own != [""]}
    first = next(iter(lists.values()), [])
    return {s: "" if s not in lists else "leg" if own == first else f"{s}_entry" for s, own in entries.items()}


def read_draws(path: Path) -> dict[str, Array]:
    """Return the draws of each parameter of a tree's file by its name, shapes (S,), chains laid end to end."""
    values: dict[str, Array] = {}
    try:
        for symbol, found in read_netcdf(path, "posterior").data_vars.items():
            flat = found.to_numpy().reshape(found.sizes["chain"] * found.sizes["draw"], -1)
            own = [str(dim) for dim in found.dims if dim not in ("chain", "draw")]
            names = [f"{symbol}[{one}]" for one in found[own[0]].values] if own else [str(symbol)]
            values |= dict(zip(names, flat.T, strict=True))
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{path}: cannot be read as a posterior ({' '.join(str(error).split())})") from error
    return values


def _symbol(name: str) -> str:
    return name.partition("[")[0].replace("/", "_")


def _list_entries(names: Sequence[str]) -> Sequence[int | str]:
    """Return what stands in the brackets: numbers, unless some deviate alike as in ``R[1,2,3]``."""
    texts = [name.partition("[")[2].rstrip("]") for name in names]
    return [int(text) for text in texts] if all(text.isdigit() for text in texts) else texts


def _over(
    variables: Mapping[str, tuple[tuple[str, ...], Array, str, str]], coords: Mapping[str, Sequence[Any]] | None = None
) -> xr.Dataset:
    """Return variables of every chain and draw."""
    return _make(Group({k: (("chain", "draw", *v[0]), *v[1:]) for k, v in variables.items()}, coords or {}))


def _make(group: Group) -> xr.Dataset:
    import xarray as xr

    made = {
        name: xr.Variable(dims, values, {"units": unit, **({"long_name": meaning} if meaning else {})})
        for name, (dims, values, unit, meaning) in group.variables.items()
    }
    sizes = {dim: n for one in made.values() for dim, n in zip(one.dims, one.shape, strict=True)}
    counted = {dim: np.arange(sizes[dim]) for dim in ("chain", "draw") if dim in sizes}
    return xr.Dataset(made, {**counted, **group.coords})
