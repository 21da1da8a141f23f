"""A posterior that is as wide as its prior is no finding, whatever it is of."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from made_up_results import read_study

from bayescal.experiments.study.page.data import state_comparison, state_data
from bayescal.experiments.study.page.functions import state_functions

BEST = "pus/linear"


def list_noise(make_results, contraction):
    def add(table):
        one = table[(table["variant"] == BEST) & (table["parameter"] == "tau[1]")]
        own = [
            one.assign(parameter=f"{kind}(rho)", contraction=contraction) for kind in ("noise_factor", "model_error")
        ]
        return pd.concat([table, *own], ignore_index=True)

    study = read_study(make_results(edits={"parameters": add}, draws=False))
    return [one.value for one in state_data(study) if "rho" in one.text]


@pytest.mark.parametrize(("contraction", "found"), [(0.02, False), (0.8, True)])
def test_a_noise_is_found_where_data_determine_it(make_results, contraction, found):
    assert np.isfinite(list_noise(make_results, contraction)).tolist() == [found, found]


@pytest.mark.parametrize(("contraction", "counted"), [(0.02, False), (0.8, True)])
def test_values_of_others_are_compared_with_what_is_known(make_results, contraction, counted):
    def change(table):
        return table.assign(contraction=contraction)

    row = {"variant": BEST, "reference": "A drawing", "source": "", "quantity": "a_x[1]", "unit": "mm"}
    beside = pd.DataFrame([row | {"mean": 0.0, "sd": 1.0, "value": 0.1, "value_sd": float("nan")}])
    study = read_study(make_results(edits={"parameters": change}, more={"reference_values": beside}, draws=False))
    assert "a_x[1]" in set(study.table("parameters", study.chosen)["parameter"])
    (said,) = state_comparison(study)
    assert np.isfinite(said.value) == counted


@pytest.mark.parametrize(("present", "level"), [(0.02, "good"), (0.45, "plain"), (0.6, "plain"), (0.98, "warning")])
def test_whether_a_sensor_errs_is_open_where_the_odds_are_even(make_results, present, level):
    row = {"variant": BEST, "sensor": "rho[1]", "input": "reading", "unit": "um", "kernel": "quadratic"}
    functions = pd.DataFrame([row | {"probability_present": present, "rms": 3.0}])
    (said,) = state_functions(read_study(make_results(more={"functions": functions}, draws=False)))
    assert said.level == level
