"""Trees as files: those that share a structure are filled in, and read as what they were, whichever came first."""

from __future__ import annotations

import io

import numpy as np
import pytest
import xarray as xr

from bayescal.experiments.shared import array_store
from bayescal.experiments.shared.array_store import pack_tree


def make_tree(seed: int, unit: str = "mm", pose: str = "b", wide: bool = True) -> xr.DataTree:
    rng = np.random.default_rng(seed)
    kind = np.float64 if wide else np.float32
    draws = xr.Dataset(
        {
            "l": (("draw", "leg"), rng.normal(size=(5, 2)).astype(kind), {"units": unit}),
            "few": (("draw",), rng.integers(0, 9, 5)),
            "sure": (("draw",), np.arange(5) > 2),
            "none": (("draw", "nothing"), np.empty((5, 0))),
        },
        {"leg": [1, 2], "draw": np.arange(5)},
    )
    data = xr.Dataset({"error": ("pose", rng.normal(size=2)), "name": ("pose", ["P", "Ä"])}, {"pose": ["a", pose]})
    tree = xr.DataTree.from_dict({"/": xr.Dataset({"n": seed}), "posterior": draws, "components/data": data})
    tree.attrs = {"variant": f"six_pus/{'ä' * seed}", "model_error": "free"}
    return tree


def read(packed: np.ndarray) -> xr.DataTree:
    return xr.open_datatree(io.BytesIO(packed.tobytes()), engine="h5netcdf").load()


@pytest.fixture(autouse=True)
def nothing_known(monkeypatch):
    monkeypatch.setattr(array_store, "_structures", {})


def test_trees_are_read_as_what_they_were():
    for seed in (1, 3, 2):
        tree = make_tree(seed)
        xr.testing.assert_identical(read(pack_tree(tree)), tree)
    assert len(array_store._structures) == 1


@pytest.mark.parametrize("other", [{"unit": "µm"}, {"pose": "c"}, {"wide": False}], ids=str)
def test_other_structures_are_written_anew(other):
    pack_tree(make_tree(1))
    tree = make_tree(1, **other)
    xr.testing.assert_identical(read(pack_tree(tree)), tree)
    assert len(array_store._structures) == 2


def test_bytes_do_not_depend_on_what_was_packed_before():
    first = pack_tree(make_tree(2))
    array_store._structures.clear()
    pack_tree(make_tree(1))
    assert np.array_equal(pack_tree(make_tree(2)), first)
    assert not np.array_equal(pack_tree(make_tree(3)), first)


def test_few_structures_are_kept():
    for k in range(array_store.KEPT + 1):
        pack_tree(make_tree(1, unit=f"unit {k}"))
    assert len(array_store._structures) <= array_store.KEPT
