"""A turntable of which nothing but angles is read: two scales of τ are one where only rounding tells them apart."""

from __future__ import annotations

import numpy as np
import pytest
from studies import run_little

from bayescal.experiments.runner.results import read_results

pytestmark = [pytest.mark.runs, pytest.mark.usefixtures("no_pictures")]


def test_it_has_a_page_and_its_zero(case, call):
    code, complaint, out = run_little(call, case("angles_only_page_crash") / "study.toml")
    assert code in (0, 3), complaint
    results = read_results(out)
    assert "lost" not in results.summary
    assert (out / "report.html").is_file()
    found = results.table("parameters").set_index("parameter")
    for name, true, most in (("zero", 0.03, 0.002), ("ecc", 0.02, 0.003)):
        assert abs(np.degrees(found.loc[name, "mean"]) - true) < most
    assert (results.table("tau_scale")["scale"].diff().dropna() > 0.05).all()
