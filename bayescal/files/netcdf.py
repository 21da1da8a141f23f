"""NetCDF files, read whole and written whole.

Damaged ones end in an exception and in nothing else. h5netcdf leaves a half-made file behind where it meets damage in
opening one, and that complains on standard error when it is collected. HDF5 itself is asked first whether all objects
and their attributes can be read.

Files are written through h5py: h5netcdf looks up in a file what it has just written there, which takes 5 ms a variable,
and a posterior has eighty. NetCDF-4 is HDF5 in which a data set, the scale, stands for each dimension; xarray says what
a variable is in a file [1]_.

.. [1] NetCDF-4 specification: https://docs.unidata.ucar.edu/netcdf-c/current/file_format_specifications.html
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import xarray as xr

NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable."  # its size follows, in ten characters


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


def pack_netcdf(tree: xr.DataTree) -> bytes:
    """Return a tree as the bytes of a netCDF file; the same for the same tree."""
    import h5py

    packed, n_dimensions = io.BytesIO(), 0
    with h5py.File(packed, "w", track_order=True) as file:
        file.attrs["_NCProperties"] = np.bytes_(f"version=2,hdf5={h5py.version.hdf5_version},h5py={h5py.__version__}")
        for node in tree.subtree:
            dataset = node.to_dataset(inherit=False)
            group = file if node is tree else file.create_group(node.path, track_order=True)
            _write_group(group, dataset, n_dimensions)
            n_dimensions += len(dataset.sizes)
    return packed.getvalue()


def _write_group(group: Any, dataset: xr.Dataset, first: int) -> None:
    """Write variables and dimensions; the latter are numbered within the file, those of this group from ``first``."""
    import h5py
    from xarray.conventions import cf_encoder, encode_dataset_coordinates

    variables, attributes = cf_encoder(*encode_dataset_coordinates(dataset))
    _write_attributes(group, attributes)
    numbers = {dim: np.int32(number) for number, dim in enumerate(dataset.sizes, start=first)}
    ends = {dim: size or None for dim, size in dataset.sizes.items()}  # in netCDF only one without an end has no length
    made: dict[Any, Any] = {}
    for dim in (one for one in numbers if one not in variables):
        made[dim] = group.create_dataset(dim, (dataset.sizes[dim],), ">f4", maxshape=(ends[dim],), track_order=True)
        made[dim].attrs["_Netcdf4Dimid"] = numbers[dim]
        made[dim].make_scale(f"{NO_VARIABLE}{dataset.sizes[dim]:10}")
    for name, one in variables.items():
        is_text = one.dtype.kind in "OU"
        made[name] = group.create_dataset(
            name,
            one.shape,
            h5py.string_dtype() if is_text else one.dtype,
            one.values.astype(object) if is_text else one.values,
            maxshape=None if all(one.shape) else tuple(ends[dim] for dim in one.dims),
            fillvalue=one.attrs.get("_FillValue"),
            track_order=True,
        )
        if one.dims:
            made[name].attrs["_Netcdf4Coordinates"] = np.array([numbers[dim] for dim in one.dims])
            made[name].attrs["_Netcdf4Dimid"] = numbers[one.dims[0]]
        if name in numbers:
            made[name].make_scale(name)
        _write_attributes(made[name], one.attrs)
    for name, one in variables.items():
        if name not in numbers:
            for axis, dim in enumerate(one.dims):
                made[name].dims[axis].attach_scale(made[dim])


def _write_attributes(place: Any, attributes: Mapping[Any, Any]) -> None:
    """Write attributes; a number is an array of one, as the C library has it."""
    for name, value in attributes.items():
        place.attrs[name] = np.atleast_1d(value) if np.isscalar(value) and not isinstance(value, str) else value
