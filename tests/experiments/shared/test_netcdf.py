"""Trees as netCDF files against xarray's own writer."""

from __future__ import annotations

import h5py
import numpy as np
import pytest
import xarray as xr

from bayescal.experiments.shared.netcdf import pack_netcdf


@pytest.fixture
def tree(rng) -> xr.DataTree:
    """Return groups within groups, with numbers, whole numbers, texts, missing ones and dimensions of no variable."""
    mm = {"units": "mm", "long_name": "Länge θ"}
    draws = xr.Dataset(
        {
            "l": (("chain", "draw", "leg"), rng.standard_normal((2, 3, 6)), mm),
            "tau": (("chain", "draw"), rng.standard_normal((2, 3)).astype(np.float32), mm),
            "scale": ((), np.float64(3.0), {"units": "1"}),
        },
        {"chain": np.arange(2), "draw": np.arange(3), "leg": [1, 2, 3, 4, 5, 6]},
    )
    gap = np.where(np.arange(12.0) > 5, np.nan, 1.0).reshape(2, 6)
    data = xr.Dataset(
        {"position": (("pose", "component"), gap, mm), "square": (("component", "other"), np.eye(6), mm)},
        {"pose": ["p 1", "π"]},
    )
    made = xr.DataTree.from_dict({"posterior": draws, "components/observed": data, "components/empty": xr.Dataset()})
    made.attrs = {"variant": "beam/linear", "length_unit": "mm"}
    return made


def _read(content: bytes, path) -> xr.DataTree:
    path.write_bytes(content)
    with xr.open_datatree(path, engine="h5netcdf") as found:
        return found.load()


def test_reads_as_what_xarray_writes(tree, tmp_path):
    found = _read(pack_netcdf(tree), tmp_path / "own.nc")
    written = _read(bytes(tree.to_netcdf(engine="h5netcdf")), tmp_path / "xarray.nc")
    xr.testing.assert_identical(found, written)
    for own, other in zip(found.subtree, written.subtree, strict=True):
        assert list(own.variables) == list(other.variables)
        assert own.sizes == other.sizes
        for name in own.variables:
            assert (own[name].dtype, own[name].attrs) == (other[name].dtype, other[name].attrs)


def test_scales_are_attached_as_netcdf_has_them(tree, tmp_path):
    def list_dimensions(content: bytes, path) -> dict[str, list[list[str]]]:
        path.write_bytes(content)
        found = {}
        with h5py.File(path) as file:
            file.visititems(
                lambda name, one: (
                    found.update({name: [sorted(scale.name for scale in dim.values()) for dim in one.dims]})
                    if isinstance(one, h5py.Dataset) and not one.is_scale
                    else None
                )
            )
        return found

    own = list_dimensions(pack_netcdf(tree), tmp_path / "own.nc")
    assert own == list_dimensions(bytes(tree.to_netcdf(engine="h5netcdf")), tmp_path / "xarray.nc")
    assert own["components/observed/square"] == [["/components/observed/component"], ["/components/observed/other"]]


def test_the_same_tree_gives_the_same_bytes(tree):
    assert pack_netcdf(tree) == pack_netcdf(tree.copy(deep=True))
