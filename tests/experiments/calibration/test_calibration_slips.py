"""Slips planted in the readings of a calibration are named before any sampling, clean readings are not suspected."""

from __future__ import annotations

import re

import calibrations
import numpy as np
import pandas as pd
import pytest
from shares import run_rest

from bayescal.errors import InputError
from bayescal.experiments.runner.load import load
from bayescal.experiments.runner.run import read_results
from bayescal.experiments.shared.slips import CORRECTED, FoundSlip

CARRIAGES, CAMERA = ["s_1_mm", "s_2_mm", "s_3_mm"], ["cam_x_mm", "cam_y_mm"]
SLIPS = {
    "none": (CARRIAGES, lambda x: x, None),
    "metres": (CARRIAGES, lambda x: 1e-3 * x, "readings of s seem to be in metres, 1000 times too small"),
    "centimetres": (CARRIAGES, lambda x: 0.1 * x, "readings of s seem to be 10 times too small (mm for cm)"),
    "inches": (CAMERA[:1], lambda x: x / 25.4, "readings of cam_x seem to be in inches"),
    "sign": (CAMERA[1:], lambda x: -x, "readings of cam_y seem to be of the other sign"),
    "mirrored": (
        CAMERA[:1],
        lambda x: -x,
        "readings of s[2] and s[3] seem to be exchanged (or: readings of cam_x seem to",
    ),
    "exchanged": (CARRIAGES[:2], lambda x: x[:, ::-1], "readings of s[1] and s[2] seem to be exchanged"),
    "the other way round": (CARRIAGES[::2], lambda x: x[:, ::-1], "legs of s seem to be numbered the other way"),
    "counted": (CARRIAGES, lambda x: np.roll(x, 1, axis=1), "legs of s seem to be counted from leg 2"),
    "shifted": (CARRIAGES, lambda x: np.roll(x, 1, axis=0), "rows of s seem shifted by one"),
    "one shifted": (CAMERA[:1], lambda x: np.roll(x, -1, axis=0), "rows of cam_x seem shifted by one"),
}


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """Return a small calibration of 25 poses, simulated."""
    return calibrations.write_delta(tmp_path_factory.mktemp("slips"))


def plant(path, slip):
    """Plant a slip in the readings; return what has to be said, and what puts them right."""
    columns, mend, said = SLIPS[slip]
    data = path.parent / "data" / "readings.csv"
    original = data.read_text()
    table = pd.read_csv(data, comment="#")
    table[columns] = mend(table[columns].to_numpy())
    table.to_csv(data, index=False)
    return said, lambda: data.write_text(original)


def say(path):
    """Return what is said of the readings, as a doubt or in a refusal."""
    kind, config = load(path)
    try:
        return kind.suspect(kind.read(config, path.parent))
    except InputError as error:
        return [str(error)]


@pytest.mark.parametrize("slip", run_rest(SLIPS, 4))
def test_the_likely_cause_of_readings_far_off_is_said(drawn, slip):
    said, restore = plant(drawn, slip)
    try:
        doubts = say(drawn)
    finally:
        restore()
    assert len(doubts) == (said is not None)
    assert said is None or doubts[0].partition(CORRECTED)[2].startswith(said)


@pytest.mark.runs
def test_a_run_that_would_find_no_machine_is_refused_with_the_likely_cause(tmp_path, refuse):
    path = calibrations.write_delta(tmp_path)
    said, _ = plant(path, "exchanged")
    refuse(re.escape(f"{CORRECTED}{said}"), tmp_path / "out", "run", path, "--quiet", "--workers", 1)


@pytest.mark.runs
def test_page_summary_and_terminal_begin_with_it(tmp_path, call, no_pictures, monkeypatch):
    said = FoundSlip("rows", "rows of s seem shifted", 100.0, 41.0)
    path = calibrations.write_delta(tmp_path)
    monkeypatch.setattr("bayescal.experiments.study.inputs.find_suspects", lambda variants, denied: (said, []))
    calibrations.change(path, '[[variants]]\nname = "one_rod"\ntitle = "Rods of one length"\ntied = ["l"]\n', "")
    code, out, _ = call("run", path, "--out", tmp_path / "out", "--workers", 1)
    assert code == 3
    assert said.text in " ".join(out.split())
    results = read_results(tmp_path / "out")
    assert results.summary["suspected_data_error"] == vars(said)
    page = load(path)[0].page(results)
    assert (page.verdict[0].level, page.verdict[0].lead) == ("bad", "Data")
    assert said.text in page.headline
