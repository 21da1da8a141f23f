"""An integer for a flag is the flag that it means, and what means none is refused when the class is read."""

from __future__ import annotations

import numpy as np
import pytest
from studies import edit, run_little

from bayescal.errors import InputError
from bayescal.experiments.runner.results import read_results
from bayescal.machines.readings import Channel


@pytest.mark.parametrize("flag", [0, 1, np.True_, np.False_, False, True])
def test_what_means_a_flag_is_one(flag):
    assert Channel("s", "mm", external=flag).external is bool(flag)


@pytest.mark.parametrize("flag", ["no", 2, None, 0.5])
def test_what_means_none_is_refused(flag):
    with pytest.raises(InputError, match="'s': external: found"):
        Channel("s", "mm", external=flag)


def test_the_class_is_named(case, call):
    folder = case("external_as_integer")
    edit(folder / "intbool.py", "external=0", "external='no'")
    code, _, complaint = call("validate", folder / "study.toml")
    assert (code, complaint.count("\n")) == (2, 1)
    assert "machine_int.toml: channel 's'" in complaint
    assert "found 'no'" in complaint


@pytest.mark.runs
@pytest.mark.usefixtures("no_pictures")
def test_held_back_rows_are_predicted(case, call):
    code, complaint, out = run_little(call, case("external_as_integer") / "study.toml")
    assert code in (0, 3), complaint
    predicted = read_results(out).table("predictions")
    external = predicted.set_index("channel")["external"]
    assert predicted["external"].dtype == bool
    assert not external["s"].any()
    assert external[["d", "e"]].all()
