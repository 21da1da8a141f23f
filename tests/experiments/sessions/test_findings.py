"""What is said to have moved: only what the data determine."""

from __future__ import annotations

import pandas as pd
import pytest

from bayescal.experiments.frame.results import Results
from bayescal.experiments.sessions.page import _list_statements

SUMMARY = {"log_evidence_drift": 5.0, "log_evidence_drift_se": 0.1, "shift_um": 20.0, "shift_arcsec": 20.0}
MODELS = pd.DataFrame({"pareto_k": [0.1], "exact_pareto_k": [0.1], "exact_efficiency": [0.9]})


def list_motions(learnt):
    rows = {"since": "M1", "session": "M2", "channel": ["s[1]", "s[2]"], "unit": "arcsec", "mean": [-1355.0, 3.0]}
    return pd.DataFrame(rows | {"sd": [8738.0, 2.0], "beyond": [0.99, 0.01], "learnt": learnt})


@pytest.mark.parametrize(
    ("learnt", "named", "unknown"), [([0.0, 0.9], "s[2]", ["s[1]"]), ([0.0, 0.1], None, []), ([0.8, 0.9], "s[1]", [])]
)
def test_a_posterior_as_wide_as_its_prior_is_no_finding(learnt, named, unknown):
    results = Results(SUMMARY, {"channels": list_motions(learnt), "models": MODELS})
    (said,) = (one for one in _list_statements(results, True) if one.lead == "Largest motion")
    assert (f"Channel {named} is off most" in said.text) == (named is not None)
    assert ("99" in said.text) == (named == "s[1]")
    assert [name for name in ("s[1]", "s[2]") if f"how much channel {name}" in said.text] == unknown


@pytest.mark.parametrize(("sd", "found"), [(2.9, False), (0.5, True)])
def test_an_expansion_that_is_not_determined_is_what_was_expected(sd, found):
    expansion = pd.DataFrame({"body": ["rods"], "prior_mean": [11.0], "prior_sd": [3.0], "mean": [11.2], "sd": [sd]})
    tables = {"channels": list_motions([0.9, 0.9]), "models": MODELS, "expansion": expansion}
    (said,) = (one for one in _list_statements(Results(SUMMARY, tables), True) if one.lead == "Temperature")
    assert ("expand by" in said.text) == found
