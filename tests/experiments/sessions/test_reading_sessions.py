"""Sessions of a calibration: what moved is found, expansion is told apart, and what is at fault is one line."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest
import reading_sessions
import session_studies
import studies

from bayescal.experiments.frame.load import load
from bayescal.experiments.frame.run import run_experiment
from bayescal.experiments.sessions.inputs import Session
from bayescal.experiments.shared.slips import FoundSlip
from bayescal.report.pictures import Picture

pytestmark = pytest.mark.runs


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    return reading_sessions.write_sessions(tmp_path_factory.mktemp("sessions"))


@pytest.fixture(scope="module")
def finished(written):
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("bayescal.report.page.render_picture", lambda draw, stacked=True: Picture(b"not drawn"))
        return run_experiment(load(written)[1], written.parent, written.parent / "out")


def test_the_zero_that_moved_is_found(finished):
    shifts = finished.results.table("shifts")
    whole = shifts[(shifts["since"] == "M1") & (shifts["session"] == "M3")].set_index("parameter")
    moved, sd = whole.loc[f"s0[{reading_sessions.COLUMN}]", ["mean", "sd"]]
    assert abs(moved - reading_sessions.MOVED_UM[2]) < 4.0 * sd < 80.0
    others = whole.drop(f"s0[{reading_sessions.COLUMN}]")
    assert (np.abs(others["mean"]) < 4.0 * others["sd"]).all()
    assert finished.summary["log_evidence_drift"] > 10.0
    assert "moved, odds of" in finished.summary["headline"]


def test_channels_move_as_their_zeros_do(finished):
    """A carriage reads less at the same pose by as much as its zero moves up."""
    shifts, channels = finished.results.table("shifts"), finished.results.table("channels")
    assert list(channels["channel"].unique()) == ["s[1]", "s[2]", "s[3]"]
    assert set(channels["unit"]) == {"µm"}
    np.testing.assert_allclose(channels["mean"], -shifts["mean"], atol=1e-6)


def test_expansion_is_told_apart_from_drift(finished):
    one = finished.results.table("expansion").iloc[0]
    assert one["body"] == "rods"
    assert abs(one["mean"] - reading_sessions.PPM) < 4.0 * one["sd"]
    assert one["sd"] < 0.5 * one["prior_sd"]


def test_the_page_speaks_of_channels(finished):
    assert (finished.results.table("models")["exact_efficiency"] > 0.9).all()
    page = (finished.results.folder / "report.html").read_text()
    assert "Motion of the channels" in page
    assert "Channel s[2] is off most between M1 and M3" in page


def edit(old, new):
    return lambda path: studies.edit(path, old, new)


def exchange(path):
    table = pd.read_csv(path.parent / "month_2.csv")
    table[["s_1_mm", "s_2_mm"]] = table[["s_2_mm", "s_1_mm"]].to_numpy()
    table.to_csv(path.parent / "month_2.csv", index=False)


def make_robust(path):
    studies.edit(path.parent / "study.toml", 'common = ["l"]', 'common = ["l"]\nrobust = 4.0')


def add_function(path):
    text = '[errors.motors]\nchannels = ["s"]\nkernel = "quadratic"\nscale_um = 20.0\nper = "channel"\n\n[sampler]'
    studies.edit(path.parent / "study.toml", "[sampler]", text)


def widen(path):
    study = path.parent / "study.toml"
    studies.edit(study, 's0 = { prior = "normal", sd = 0.5 }', 's0 = { prior = "uniform", half_width = 0.5 }')


FAULTS = {
    "missing": (edit("month_2.csv", "month_7.csv"), r"month_7\.csv: no such file"),
    "no readings": (edit('readings = ["month_2.csv"]\n', ""), "session 'M2': found 0 files of readings, expected 1"),
    "of legs": (
        edit('readings = ["month_2.csv"]', 'poses = "month_2.csv"'),
        "found poses, expected readings, as",
    ),
    "copied": (
        edit("month_2.csv", "month_1.csv"),
        "found the readings of session 'M1' to the last digit",
    ),
    "slipped": (exchange, r"session 'M2': .*readings of s\[1\] and s\[2\] seem to be exchanged"),
    "symbol": (edit('symbols = ["s0"]', 'symbols = ["q"]'), "drift.symbols: found 'q', expected one of x, y, l, s0"),
    "angle": (edit('symbols = ["s0"]', 'symbols = ["t_x"]'), "found 't_x' in rad without scale_arcsec"),
    "body": (edit('symbols = ["l"]', 'symbols = ["t_x"]'), "thermal.rods: found no length 't_x'"),
    "struts": (edit('bodies.rods = { symbols = ["l"],', "base = {"), "thermal.base: found no length 'a_x'"),
    "variant": (edit('variant = "one_rod"', 'variant = "rods"'), "variant 'rods': unknown here, expected one of all"),
    "robust": (make_robust, "found a robust variant, expected another"),
    "common": (add_function, "found errors common to all rows, expected a variant without"),
    "uniform": (widen, r"found a uniform prior of s0\[1\]"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_at_fault_is_one_line(fault, written, call, tmp_path):
    path = session_studies.copy_sessions(written, tmp_path / "here")
    change, expected = FAULTS[fault]
    change(path)
    code, said, complaint = call("run", path, "--out", tmp_path / "new", "--workers", "1")
    assert (code, said, complaint.count("\n")) == (2, "", 1), complaint
    assert re.search(expected, complaint), complaint
    assert not (tmp_path / "new").exists()


def test_a_denied_slip_is_said_and_not_refused(written, tmp_path, monkeypatch):
    found = FoundSlip("rows", "rows of s seem to be shifted by one", 50.0, 4.0)
    monkeypatch.setattr(Session, "find_slip", lambda self, denied=(): None if "rows" in denied else found)
    path = session_studies.copy_sessions(written, tmp_path)
    for k in (1, 2, 3):
        studies.edit(path, f'label = "M{k}"', f'label = "M{k}"\ndenied_slips = ["rows"]')
    kind, config = load(path)
    denied = kind.read(config, tmp_path).denied
    assert denied[1] == f"Session 'M2': {found.say()}"
