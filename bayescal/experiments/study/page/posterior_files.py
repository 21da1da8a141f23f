"""What a study's page takes from the files of its posteriors, where these are there."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import h5py
import numpy as np

from bayescal.errors import InputError
from bayescal.experiments.shared.study_schema import stem_of
from bayescal.experiments.shared.trees import name_file
from bayescal.numerics.geometry import matrix_from_rotation_vector, rotation_vector_of_turn
from bayescal.report.symbols import OF_KERNELS

if TYPE_CHECKING:
    from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class Replicates:
    """Of one variant, calibration poses, model error free.

    Attributes
    ----------
    misfit : ndarray, shape (S, P, 6)
        Measured minus replicated poses, mm and rad.
    """

    misfit: Array


def read_posteriors(folder: Path, variants: list[str]) -> dict[str, dict[str, Array]]:
    """Return the draws of each variant whose file is there, by parameter, (E, S) each."""
    paths = {variant: _find_file(folder, variant) for variant in variants}
    return {variant: _read_draws(path) for variant, path in paths.items() if path.is_file()}


def _find_file(folder: Path, variant: str) -> Path:
    """Return the posterior's file of a variant; a name's letters that no file may have stand there as others."""
    own = folder / f"{stem_of(variant)}.nc"
    return own if own.is_file() else folder.parent / name_file(variant)


def _read_draws(path: Path) -> dict[str, Array]:
    """Return the draws of each parameter by chains, from the posterior group of an ArviZ file."""
    draws: dict[str, Array] = {}
    try:
        with h5py.File(path, "r") as file:
            for symbol, values in file["posterior"].items():
                if values.ndim < 2 or symbol in OF_KERNELS:
                    continue  # coordinates; scale and length of an error, not of the machine
                every = np.asarray(values, dtype=np.float64).reshape(*values.shape[:2], -1)
                names = [symbol] if values.ndim == 2 else [f"{symbol}[{one}]" for one in _list_entries(values)]
                draws |= {name: every[..., k] for k, name in enumerate(names)}
    except (OSError, KeyError) as error:
        raise InputError(f"{path}: cannot be read as a posterior ({error})") from error
    return draws


def _list_entries(values: h5py.Dataset) -> list[str]:
    """Return what stands in the brackets of parameters' names: as the file has it, else numbers from one."""
    if not len(values.dims[2]):
        return [str(k + 1) for k in range(values.shape[2])]
    return [one.decode() if isinstance(one, bytes) else str(one) for one in values.dims[2][0][()]]


def read_replicates(folder: Path, variant: str) -> Replicates | None:
    """Return what a variant's file says that would be measured again; None where it does not."""
    path = _find_file(folder, variant)
    if not path.is_file():
        return None
    try:
        with h5py.File(path, "r") as file:
            if "observed_data/readings" not in file:
                return None  # of an earlier version
            measured, made = (file[f"{group}/readings"][()] for group in ("observed_data", "posterior_predictive"))
    except (OSError, KeyError) as error:
        raise InputError(f"{path}: cannot be read as a posterior ({error})") from error
    measured, known = np.broadcast_to(measured, made.shape), np.isfinite(measured[..., 3:]).all(axis=-1)
    turned, seen = (matrix_from_rotation_vector(np.nan_to_num(one[..., 3:])) for one in (made, measured))
    turn = rotation_vector_of_turn(seen @ np.swapaxes(turned, -1, -2))
    misfit = np.concatenate([measured[..., :3] - made[..., :3], np.where(known[..., None], turn, np.nan)], axis=-1)
    return Replicates(misfit.reshape(-1, *misfit.shape[2:]))
