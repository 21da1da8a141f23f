"""A certificate speaks of a position where the tool's lengths are one: along x, y and z, not of several targets."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from bayescal.experiments.shared.certificate import state_headline


@pytest.mark.parametrize(("n", "places", "what"), [(3, True, "Position"), (4, False, "Tool"), (0, False, "Tool")])
def test_lengths_that_are_no_position_are_not_called_one(n, places, what):
    units = ("µm",) * n or ("N",) * 2
    size = np.full(len(units), 3.0)
    model = SimpleNamespace(states_tool=True, places_tool=places)
    found = SimpleNamespace(
        **{"expanded": size, "expanded_unaligned": None, "summarise": lambda values: (values, values)},
        **{"units": units, "axis_names": tuple("abcd"[: len(units)]), "where": "over the workspace"},
        calibrated=SimpleNamespace(lengths=np.arange(n), model=model),
        wishes=SimpleNamespace(coverage=0.95),
    )
    assert state_headline(found).startswith(f"{what}: ")
