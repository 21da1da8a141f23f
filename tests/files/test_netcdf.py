"""NetCDF files that are written here: xarray reads them as what they were, and would have written the same."""

from __future__ import annotations

import io
from typing import Any

import h5py
import numpy as np
import pytest
import xarray as xr

from bayescal.files.netcdf import pack_netcdf

WRITER = "_NCProperties"  # which versions wrote a file
REFERENCES = ("DIMENSION_LIST", "REFERENCE_LIST")  # between a file's own objects, which are compared by `list_scales`


def make_tree(seed: int, unit: str = "mm", pose: str = "b", wide: bool = True) -> xr.DataTree:
    rng = np.random.default_rng(seed)
    kind = np.float64 if wide else np.float32
    draws = xr.Dataset(
        {
            "l": (("draw", "leg"), rng.normal(size=(5, 2)).astype(kind), {"units": unit, "sizes": [1, 2], "n": 3}),
            "few": (("draw",), rng.integers(0, 9, 5)),
            "sure": (("draw",), np.arange(5) > 2),
            "none": (("draw", "nothing"), np.empty((5, 0))),
            "some": (("draw", "unnamed"), rng.normal(size=(3, 5)).T),
            "weight": ("leg", [0.0, np.nan]),
        },
        {"leg": [1, 2], "draw": np.arange(5), "of": ("draw", list("aabbc"))},
    )
    data = xr.Dataset({"error": ("pose", rng.normal(size=2)), "name": ("pose", ["P", "Ä"])}, {"pose": ["a", pose]})
    tree = xr.DataTree.from_dict({"/": xr.Dataset({"n": seed}), "posterior": draws, "components/data": data})
    tree.attrs = {"variant": f"six_pus/{'ä' * seed}", "model_error": "free", "parts": ["a", "ö"], "seed": seed}
    return tree


def read(packed: bytes) -> xr.DataTree:
    return xr.open_datatree(io.BytesIO(packed), engine="h5netcdf").load()


def list_scales(one: h5py.Dataset) -> list[str]:
    return [scale.name for axis in one.dims for scale in axis.values()]


def list_contents(packed: bytes) -> dict[str, Any]:
    """Return what a file holds, object by object in the order in which they were made."""
    with h5py.File(io.BytesIO(packed)) as file:
        found: dict[str, Any] = {}

        def list_one(name: str, one: h5py.Group | h5py.Dataset) -> None:
            kept = {key: (np.asarray(value).dtype, np.asarray(value).tolist()) for key, value in one.attrs.items()}
            for key in (WRITER, *REFERENCES):
                kept.pop(key, None)
            if isinstance(one, h5py.Group):
                found[name] = repr((sorted(kept.items()), list(one)))
            else:
                scales = [] if one.is_scale else list_scales(one)
                form = (
                    one.dtype,
                    one.shape,
                    one.maxshape,
                    one.is_scale,
                    scales,
                    one.asstr()[:].tolist() if one.dtype.kind == "O" else one[()].tolist(),
                )
                found[name] = repr((sorted(kept.items()), form))

        list_one("/", file)
        file.visititems(list_one)
    return found


@pytest.mark.parametrize("other", [{}, {"unit": "µm"}, {"pose": "c"}, {"wide": False}], ids=str)
def test_trees_are_read_as_what_they_were(other):
    tree = make_tree(1, **other)
    found = read(pack_netcdf(tree))
    xr.testing.assert_identical(found, tree)
    assert [list(node.variables) for node in found.subtree] == [list(node.variables) for node in tree.subtree]


def test_files_hold_what_xarray_writes():
    tree = make_tree(2)
    assert list_contents(pack_netcdf(tree)) == list_contents(bytes(tree.to_netcdf(engine="h5netcdf")))


def test_the_same_tree_has_the_same_bytes():
    assert pack_netcdf(make_tree(2)) == pack_netcdf(make_tree(2)) != pack_netcdf(make_tree(3))
