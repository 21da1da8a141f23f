"""One leg's displacements times 0.94: the model error could take it up, and is not what it is."""

from __future__ import annotations

import pytest

NAMED = "readings of rho[1] seem to be 0.94"


@pytest.mark.runs
@pytest.mark.parametrize("study", ["study", "study_wide", "study_none"])
def test_the_channel_is_named_whatever_the_model_error(case, call, study):
    code, out, _ = call("validate", case("scale_slip_one_leg") / f"{study}.toml")
    assert code == 3
    assert NAMED in out
