"""Trees of arrays as netCDF-4 files, group by group in one pass.

A general writer opens, asks and closes HDF5 objects again for every variable and dimension; a posterior's tree of many
small groups is then mostly bookkeeping. Here every object is made once. The layout is netCDF-4's: a dimension is an
HDF5 dimension scale of its group, a coordinate's own values where it has any, and each variable has the scales of its
dimensions attached (netCDF documentation, file format specification, "NetCDF-4").
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import h5py
import numpy as np

if TYPE_CHECKING:
    import xarray as xr

NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable.{:10d}"
TEXT = h5py.string_dtype()


def pack_netcdf(tree: xr.DataTree) -> bytes:
    """Return a netCDF-4 file of a tree; the same bytes for the same tree.

    The tree's coordinates are those of dimensions; values are numbers or texts.
    """
    with h5py.File("tree.nc", "w", driver="core", backing_store=False, track_order=True) as file:
        version = f"version=2,hdf5={h5py.version.hdf5_version},h5py={h5py.version.version}"
        file.attrs.create("_NCProperties", np.bytes_(version))
        n_dimensions = 0
        for node in tree.subtree:
            group = file if node.path == "/" else file.create_group(node.path, track_order=True)
            dataset = node.to_dataset(inherit=False)
            for name, value in dataset.attrs.items():
                group.attrs[str(name)] = value
            n_dimensions += _write_group(group, dataset, n_dimensions)
        file.flush()
        return bytes(file.id.get_file_image())


def _write_group(group: h5py.Group, dataset: xr.Dataset, first: int) -> int:
    """Write a group's variables and dimensions, numbered in the file from the first one on; return how many."""
    written = {str(name): _write_variable(group, str(name), one) for name, one in dataset.variables.items()}
    names = [str(name) for name in dataset.sizes]
    numbers = {name: np.int32(first + k) for k, name in enumerate(names)}
    scales = {}
    for name in names:
        size = dataset.sizes[name]
        found = written.get(name)
        scales[name] = group.create_dataset(name, (size,), ">f4", track_order=True) if found is None else found
        title = NO_VARIABLE.format(size) if found is None else name
        h5py.h5ds.set_scale(scales[name].id, title.encode())
        scales[name].attrs["_Netcdf4Dimid"] = numbers[name]
    for variable in written:
        dims = [str(dim) for dim in dataset[variable].dims]
        if dims == [variable]:
            continue
        for axis, dim in enumerate(dims):
            h5py.h5ds.attach_scale(written[variable].id, scales[dim].id, axis)
        if dims:
            written[variable].attrs["_Netcdf4Coordinates"] = np.array([numbers[dim] for dim in dims], dtype=np.int32)
    return len(names)


def _write_variable(group: h5py.Group, name: str, variable: xr.Variable) -> h5py.Dataset:
    """Write values with their attributes; a number that is missing is NaN."""
    values = np.asarray(variable.values)
    if values.dtype.kind in "OUT":
        made = group.create_dataset(name, data=values.astype(object), dtype=TEXT, track_order=True)
    elif values.dtype.kind == "f":
        made = group.create_dataset(name, data=values, fillvalue=np.nan, track_order=True)
        made.attrs["_FillValue"] = np.full(1, np.nan, dtype=values.dtype)
    else:
        made = group.create_dataset(name, data=values, track_order=True)
    for attribute, value in variable.attrs.items():
        made.attrs[str(attribute)] = value
    return made
