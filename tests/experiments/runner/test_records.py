"""Records of tasks: what comes back is what went in, and nothing is made that the reader did not name."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest

from bayescal.experiments.runner.records import decode, encode
from bayescal.experiments.runner.store import Store


@dataclass(frozen=True, eq=False)
class Inner:
    values: np.ndarray
    name: str | None


@dataclass(frozen=True, eq=False)
class Outer:
    inner: Inner
    several: tuple[Inner, ...]
    table: pd.DataFrame


def make() -> Outer:
    table = pd.DataFrame({"k": [1, 2], "x": [0.1, np.nan], "text": ["a", None], "flag": [True, False]})
    one, other = Inner(np.arange(6.0).reshape(2, 3).T, None), Inner(np.array(["ä", "b"]), "ß")
    return Outer(one, (one, other), table)


def test_values_come_back_with_their_types(tmp_path):
    value = {"outer": make(), (1, "a"): [None, 1.5, 2, True, np.float64(0.1), float("nan"), float("inf")]}
    store = Store(tmp_path / "out")
    store.begin({}, resume=False)
    store.save_task("task", encode(value))
    back = decode(store.load_task("task"), (Outer,))
    outer = back["outer"]
    assert outer.inner.values.flags.f_contiguous
    np.testing.assert_array_equal(outer.inner.values, make().inner.values)
    assert outer.several[1].values.tolist() == ["ä", "b"]
    assert (outer.inner.name, outer.several[1].name) == (None, "ß")
    pd.testing.assert_frame_equal(outer.table, make().table)
    plain = back[1, "a"]
    assert plain[:4] == [None, 1.5, 2, True]
    assert [type(one) for one in plain[:4]] == [type(None), float, int, bool]
    assert type(plain[4]) is np.float64
    assert np.isnan(plain[5])
    assert plain[6] == np.inf


def test_only_named_dataclasses_are_made():
    with pytest.raises(KeyError):
        decode(encode(make()), (Inner,))


@pytest.mark.parametrize("value", [object(), {1, 2}, np.array([object()])])
def test_other_values_are_refused(value):
    with pytest.raises(TypeError, match="found a"):
        encode(value)
