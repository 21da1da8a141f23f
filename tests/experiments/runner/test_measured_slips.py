"""Slips planted in what other kinds take from a study: the likely cause is said, and clean data are not suspected."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
import session_studies
import studies
import test_kind_contract as contract

from bayescal.errors import InputError
from bayescal.experiments.runner.load import load
from bayescal.experiments.shared.slips import CORRECTED, ROWS, FoundSlip, state_denied, state_slip


@pytest.mark.runs
def test_the_next_pose_of_exchanged_legs_is_doubted(tmp_path):
    path = contract.write_next(tmp_path)
    experiment, config = load(path)
    exchange = studies.change_actuators(lambda rho: rho[:, [0, 2, 1, 3, 4, 5]])
    with studies.changed_table(tmp_path / "data" / "actuators.csv", exchange):
        (doubt,) = experiment.list_warnings(experiment.read(config, tmp_path))
    assert re.search(r"rho\[2\] and rho\[3\] .*exchanged", doubt.partition(CORRECTED)[2])


def test_what_is_found_is_said_first():
    summary = {"suspected_data_error": vars(FoundSlip(ROWS, "rows seem to be shifted by one", 100.0, 41.0))}
    (said,) = state_slip(summary)
    assert (said.level, said.lead) == ("bad", "Data")
    assert said.value == 41.0
    assert state_slip({}) == []


@pytest.mark.parametrize(("denied", "refused"), [(["rows"], False), (["legs", "unit"], True)])
def test_a_slip_of_a_session_is_refused_unless_denied_and_then_said(tmp_path, denied, refused):
    path = session_studies.write_sessions(tmp_path)
    experiment, config = load(path)
    second = config.sessions[1].model_copy(update={"ignored_data_errors": denied})
    config = config.model_copy(update={"sessions": [config.sessions[0], second, *config.sessions[2:]]})
    shift = studies.change_actuators(lambda rho: np.roll(rho, 1, axis=0))
    with studies.changed_table(tmp_path / "data" / "2" / "actuators.csv", shift):
        if refused:
            said = "session 'S2': .* rows of rho .* ignored_data_errors of"
            with pytest.raises(InputError, match=said):
                experiment.read(config, tmp_path)
            return
        (said,) = experiment.read(config, tmp_path).denied
    (statement,) = state_denied({"ignored_data_errors": [said]})
    assert (statement.level, statement.lead) == ("warning", "Data")
    assert re.search(r"ows of rho\b.* shifted", statement.text)
    assert "ignored_data_errors" in statement.action


def test_a_slip_without_which_nothing_fits_is_written():
    """Its gain is infinite, which a summary cannot hold."""
    found = FoundSlip("unit", "readings of s in µm", np.inf, None).record()
    assert json.loads(json.dumps(found, allow_nan=False)) == {
        "fault": "unit",
        "text": "readings of s in µm",
        "gain": None,
        "factor": None,
    }
