"""NetCDF files, read whole: damaged ones end in an exception and in nothing else.

h5netcdf leaves a half-made file behind where it meets damage in opening one, and that complains on standard error when
it is collected. HDF5 itself is asked first whether all objects and their attributes can be read.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import xarray as xr


def read_netcdf(path: Path, group: str | None = None) -> xr.Dataset:
    """Return a file's data, or a group's; OSError, ValueError, KeyError where it is missing, damaged or without it."""
    import h5py
    import xarray as xr  # takes a second, for those who need it

    content = path.read_bytes()
    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            _visit(file)
    except (RuntimeError, TypeError) as error:  # h5py's of damage in the midst of a file
        raise OSError(str(error)) from error
    return xr.load_dataset(io.BytesIO(content), engine="h5netcdf", group=group)


def _visit(group: Any) -> None:
    """Read all attributes of a group and of everything in it, and open every data set."""
    dict(group.attrs)
    for name, one in group.items():
        if one is None:
            raise OSError(f"{name} cannot be read")
        if hasattr(one, "values"):
            _visit(one)
        else:
            dict(one.attrs)
