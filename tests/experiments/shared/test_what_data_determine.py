"""What `validate` says of how much data can determine: by rank and contraction of linearised rows."""

from __future__ import annotations

import re

import numpy as np
import planar_rrr
import pytest

from bayescal.experiments.shared.outlook import describe_determinacy, join_outlooks


@pytest.mark.parametrize(
    ("size", "said"),
    [
        ([10.0, 10.0], "9 readings: both"),
        (
            [10.0, 0.0],
            "1 of 2 combinations will be determined and 1 ",
        ),
        ([10.0, 1.0], " and 1 hardly; least known: b"),
        ([0.0, 0.0], "0 of 2 combinations"),
    ],
)
def test_combinations_are_counted_by_their_contraction(size, said):
    text = describe_determinacy("9 readings", np.diag(size), ["a", "b"])
    assert said in text
    assert re.findall(r"\b(\w+) stays? at", text) == ["1"] * (size == [10.0, 0.0]) + ["2"] * (size == [0.0, 0.0])


def test_variants_of_which_the_same_is_said_share_a_line():
    assert join_outlooks({"a": "all", "b": "none", "c": "all"}) == ["variants 'a', 'c': all", "variant 'b': none"]


def test_three_rows_of_a_calibration_are_said_to_be_few(tmp_path, call):
    path = planar_rrr.write_project(tmp_path / "project", planar_rrr.simulate(3))
    code, out, complaint = call("validate", path)
    assert (code, complaint) == (0, "")
    assert re.search(r"'all': 18 readings in 3 rows .* 21 \+ 9 unknowns", out)
    found = int(out.partition("machine and poses: ")[2].split()[0])
    stay = int(out.partition(" stay at their tolerances")[0].split()[-1])
    assert 0 < found <= 9  # what 18 readings leave beside nine coordinates
    assert stay >= 12
    assert found + stay <= 21


def test_more_rows_determine_more(tmp_path, call):
    told = []
    for n in (3, 30):
        path = planar_rrr.write_project(tmp_path / str(n), planar_rrr.simulate(n))
        told.append(int(call("validate", path)[1].partition("machine and poses: ")[2].split()[0]))
    assert told[1] > told[0]
