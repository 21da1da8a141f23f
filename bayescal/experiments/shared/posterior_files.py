"""Posteriors as ArviZ keeps them: a tree of named groups in which every variable has its unit.

``observed_data`` holds the readings as measured, rows by channels; what draws of prior and posterior predict stands
beside them. Where some were not read, all that were stand in one dimension. The log-likelihood is that of whole rows: a
row is what is left out and compared, and its only variable. ArviZ's LOO-PIT, which wants a log-likelihood of every
number, finds that of the number's row in a coordinate of the readings' name.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayescal.errors import InputError
from bayescal.files.netcdf import read_netcdf
from bayescal.numerics.geometry import Array

if TYPE_CHECKING:
    import xarray as xr

    from bayescal.calibrated.functions import KnownFunctions

NAME, ROWS = "readings", "rows"
PREDICTED = "readings measured again"
FUNCTIONS = "functions"
"""Group of what is known of errors that are functions of the pose."""
MODE = "mode"
"""Variable of ``sample_stats``: to which of several solutions a draw belongs, from 1."""
SAVED_DRAWS = 2000
KEPT_NUMBERS = 2**23
"""Of all draws together that one array keeps: with thousands of poses fewer draws, never too few to say anything."""
LEAST_DRAWS = 200

type Variables = Mapping[str, tuple[tuple[str, ...], Array, str, str]]
"""By name: dimensions, values, unit, and what it is."""


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


def name_functions(mode: int) -> str:
    """Return the group of what is known of such errors in a solution, from 1."""
    return FUNCTIONS if mode == 1 else f"{FUNCTIONS}_{mode}"


def read_functions(path: Path, mode: int = 1) -> tuple[KnownFunctions, list[str]] | None:
    """Return what is known of such errors, and names of the parameters beside, of a tree's file; None without any."""
    from bayescal.calibrated.functions import read_known

    try:
        return read_known(path, name_functions(mode))
    except (OSError, ValueError, KeyError):  # none is there
        return None


def write_packed(packed: np.ndarray, path: Path) -> None:
    """Write a packed tree: a disk that is full is an error of writing then, not one within HDF5."""
    path.write_bytes(packed.tobytes())


def split_parameters(names: Sequence[str], values: Array, units: Sequence[str]) -> xr.Dataset:
    """Return values (E, S, n) of parameters as variables by symbol: ``symbol[k]`` are entries of one variable.

    Their dimension is ``leg`` for all with the entries of the first that are numbered, and has a name of its own
    otherwise. Entries are numbers, unless some deviate alike as in ``R[1,2,3]``, or axes of a vector as in ``tool[x]``.
    """
    places: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        places.setdefault(name.partition("[")[0].replace("/", "_"), []).append(k)
    variables: dict[str, tuple[tuple[str, ...], Array, str, str]] = {}
    coords: dict[str, Sequence[Any]] = {}
    first: list[str] = []
    for symbol, own in places.items():
        texts = [names[k].partition("[")[2].rstrip("]") for k in own]
        if texts == [""]:
            variables[symbol] = ((), values[..., own[0]], units[own[0]], "")
            continue
        first = first or ([] if texts[0].isalpha() else texts)
        dimension = "leg" if texts == first else f"{symbol}_entry"
        coords[dimension] = [int(text) for text in texts] if all(text.isdigit() for text in texts) else texts
        variables[symbol] = ((dimension,), values[..., own], units[own[0]], "")
    return make_dataset(variables, coords, drawn=True)


def make_dataset(
    variables: Variables, coords: Mapping[str, Sequence[object]] | None = None, drawn: bool = False
) -> xr.Dataset:
    """Return variables as a group of a tree; those that are ``drawn`` have chains and draws before all else."""
    import xarray as xr

    over = ("chain", "draw") if drawn else ()
    made = {
        name: xr.Variable((*over, *dims), values, {"units": unit, **({"long_name": meaning} if meaning else {})})
        for name, (dims, values, unit, meaning) in variables.items()
    }
    sizes = {dim: n for one in made.values() for dim, n in zip(one.dims, one.shape, strict=True)}
    counted = {dim: np.arange(sizes[dim]) for dim in ("chain", "draw") if dim in sizes}
    return xr.Dataset(made, {**counted, **(coords or {})})


@dataclass(frozen=True, eq=False)
class ReadingLayout:
    """How readings (..., P, K) of rows and channels stand in a tree: as they are, or those alone that were read."""

    rows: tuple[str, ...]
    channels: tuple[str, ...]
    units: tuple[str, ...]
    present: np.ndarray  # (P, K)

    def arrange(self, observed: Array, replicated: Array, prior_replicated: Array, density: Array) -> dict[str, Any]:
        """Return the groups of readings.

        Parameters
        ----------
        observed : ndarray, shape (P, K)
            As measured.
        replicated, prior_replicated : ndarray, shape (E, S, P, K)
            As posterior and prior predict them.
        density : ndarray, shape (E, S, P)
            Log-density of all readings of a row.
        """
        of_rows = make_dataset({ROWS: (("row",), density, "nat", "log-density by row")}, drawn=True)
        own = self._pick(np.repeat(density[..., None], len(self.channels), axis=-1).astype(np.float32))
        of_readings = self._keep(own, "nat", "log-density of the whole row", True)[NAME]
        unit = ", ".join(dict.fromkeys(self.units))
        return {
            "log_likelihood": of_rows.assign_coords(row=list(self.rows)).assign_coords({NAME: of_readings}),
            "observed_data": self._keep(self._pick(observed), unit, "readings as measured", False),
            "posterior_predictive": self._keep(self._pick(replicated), unit, PREDICTED, True),
            "prior_predictive": self._keep(self._pick(prior_replicated), unit, PREDICTED, True),
        }

    def _pick(self, values: Array) -> Array:
        return values if self.present.all() else values[..., self.present]

    def _keep(self, values: Array, unit: str, meaning: str, drawn: bool) -> xr.Dataset:
        """Return values as a group's variable of readings, with row, channel and unit of each."""
        row, channel = np.nonzero(self.present)
        dims: tuple[str, ...] = ("reading",)
        of = {"row_of": np.array(self.rows)[row], "channel": np.array(self.channels)[channel]}
        labels: dict[str, Any] = {name: ("reading", one) for name, one in of.items()}
        labels |= {"unit": ("reading", np.array(self.units)[channel]), "reading": np.arange(len(channel))}
        if self.present.all():
            dims = ("row", "channel")
            labels = {"row": list(self.rows), "channel": list(self.channels), "unit": ("channel", list(self.units))}
        return make_dataset({NAME: (dims, values, unit, meaning)}, drawn=drawn).assign_coords(labels)


def read_draws(path: Path, mode: int | None = None) -> dict[str, Array]:
    """Return the draws of each parameter of a tree's file by its name, shapes (S,), chains laid end to end.

    Those of one of its solutions, counted from 1, where one is named.
    """
    values: dict[str, Array] = {}
    try:
        for symbol, found in read_netcdf(path, "posterior").data_vars.items():
            flat = found.to_numpy().reshape(found.sizes["chain"] * found.sizes["draw"], -1)
            own = [str(dim) for dim in found.dims if dim not in ("chain", "draw")]
            names = [f"{symbol}[{one}]" for one in found[own[0]].values] if own else [str(symbol)]
            values |= dict(zip(names, flat.T, strict=True))
        if mode is not None:
            label = read_netcdf(path, "sample_stats")[MODE].to_numpy().ravel()
            values = {name: x[label == mode] for name, x in values.items()}
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{path}: not a posterior ({' '.join(str(error).split())})") from error
    return values
