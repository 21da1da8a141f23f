"""What is said to have moved: only what the data determine."""

from __future__ import annotations

import pandas as pd
import pytest

from bayescal.experiments.runner.results import Results
from bayescal.experiments.sessions.page import _list_statements
from bayescal.experiments.sessions.rows import ChannelMotionRow, ExpansionRow

SUMMARY = {
    "log_evidence_drift": 5.0,
    "log_evidence_drift_se": 0.1,
    "motion_limit_um": 20.0,
    "motion_limit_arcsec": 20.0,
}
MODELS = pd.DataFrame({"pareto_k": [0.1], "exact_pareto_k": [0.1], "exact_efficiency": [0.9]})


def list_motions(reduction):
    return ChannelMotionRow.tabulate(
        since="M1",
        session="M2",
        channel=["s[1]", "s[2]"],
        unit="arcsec",
        mean=[-1355.0, 3.0],
        sd=[8738.0, 2.0],
        q05=0.0,
        q95=0.0,
        p_exceeds_limit=[0.99, 0.01],
        interval_reduction=reduction,
    )


@pytest.mark.parametrize(
    ("reduction", "named", "unknown"),
    [([0.0, 0.9], "s[2]", 1), ([0.0, 0.1], None, 2), ([0.8, 0.9], "s[1]", 0)],
)
def test_a_posterior_as_wide_as_its_prior_is_no_finding(reduction, named, unknown):
    results = Results(SUMMARY, {"channels": list_motions(reduction), "models": MODELS})
    found = _list_statements(results, True)
    largest = [one.value for one in found if one.lead == "Largest motion"]
    assert largest == ([] if named is None else [{"s[1]": -1355.0, "s[2]": 3.0}[named]])
    assert [one.value for one in found if one.lead == "Motion"] == ([unknown] if unknown else [])


@pytest.mark.parametrize(("sd", "found"), [(2.9, False), (0.5, True)])
def test_an_expansion_that_is_not_determined_is_what_was_expected(sd, found):
    row = ExpansionRow(body="rods", prior_mean=11.0, prior_sd=3.0, mean=11.2, sd=sd, q05=0.0, q95=0.0)
    expansion = ExpansionRow.collect([row])
    tables = {"channels": list_motions([0.9, 0.9]), "models": MODELS, "expansion": expansion}
    (said,) = (one for one in _list_statements(Results(SUMMARY, tables), True) if one.lead == "Temperature")
    assert ("not determined" not in said.text) == found
