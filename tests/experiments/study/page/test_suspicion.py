"""While data are suspected, nothing is advised that takes what is wrong with them for the machine's."""

from __future__ import annotations

import numpy as np
import pytest
from made_up_results import read_study, set_fit, set_rows

from bayescal.experiments.study.page.suspicion import LEAD, SILENT, list_suspicions
from bayescal.experiments.study.page.verdict import state_headline, state_verdict

BEST = "pus/linear"
SLIP = {"fault": "rows", "text": "rows 3 and 4 seem to have each other's x", "gain": 60.0, "factor": 2.0}
LARGE = {"fault": "large errors", "text": "readings need 0.2 mm (less probable otherwise)", "factor": 9.0, "gain": 90.0}
OFF = set_fit(BEST, misfit_chi2=900.0, misfit_dof=100.0, prior_chi2=0.5, prior_dof=60.0)


def spoil(summary, slip=None):
    OFF(summary)
    summary |= {} if slip is None else {"suspected_data_error": slip}


def of_row(trust=1.0):
    return {"poses": set_rows({"variant": BEST, "pose": "C2"}, is_outlier=True, chi2=150.0, robust_weight=trust)}


def test_figures_are_explained_where_nothing_is_suspected(make_results):
    study = read_study(make_results(spoil))
    assert not list_suspicions(study)
    assert "Noise" in {one.lead for one in state_verdict(study)}


@pytest.mark.parametrize("what", ["slip", "row"])
def test_nothing_rivals_what_is_suspected(what, make_results):
    slip, edits = (SLIP, {}) if what == "slip" else (None, of_row())
    study = read_study(make_results(lambda summary: spoil(summary, slip), edits=edits))
    verdict = state_verdict(study)
    assert not {one.lead for one in verdict} & set(SILENT)
    assert verdict[0].lead == ("Data" if what == "slip" else "Outliers")
    assert (SLIP["text"] if what == "slip" else "C2") in state_headline(study)
    assert ("use pus" in state_headline(study).lower()) == (what == "row")


def test_a_variant_that_expects_outliers_has_dealt_with_them(make_results):
    def change(summary):
        spoil(summary)
        set_fit(BEST, has_outliers=True)(summary)

    study = read_study(make_results(change, edits=of_row(0.01)))
    assert not list_suspicions(study)
    assert np.any([one.lead in SILENT for one in state_verdict(study)])


@pytest.mark.parametrize("suspected", [False, True])
def test_errors_far_beyond_what_was_allowed_for_are_in_the_headline_unless_data_are_suspected(suspected, make_results):
    def change(summary):
        summary["misstated"] = LARGE

    headline = state_headline(read_study(make_results(change, edits=of_row() if suspected else {})))
    assert ("0.2 mm" in headline) == (not suspected)


@pytest.mark.parametrize(("fault", "silent"), [("tolerance", True), ("noise", True), ("wide tolerance", False)])
def test_what_is_stated_wrong_comes_first_and_is_no_model_error(fault, silent, make_results):
    stated = {"fault": fault, "text": "stated wrong (or: another one)", "factor": 10.0, "gain": 90.0}
    study = read_study(make_results(lambda summary: summary.update(misstated=stated)))
    assert ("tated wrong" in state_headline(study)) == silent
    assert (LEAD not in {one.lead for one in state_verdict(study)}) == silent
