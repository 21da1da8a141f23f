"""Experiments on sensor placement: shipped ones run tiny, what is written is right and repeats, faults are named."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import studies
from placement_problems import FOLDER, SHIPPED, shrink
from rich.console import Console

from bayescal.errors import InputError, NumericalError
from bayescal.experiments.frame.identity import hash_identity, identify
from bayescal.experiments.frame.load import load
from bayescal.experiments.frame.results import read_results
from bayescal.experiments.frame.run import find_results_kind, run_experiment, write_report
from bayescal.experiments.sensor_placement.inputs import Choice, read_placement
from bayescal.experiments.sensor_placement.page.figures import write_sensors
from bayescal.experiments.sensor_placement.tables import describe_kinds, describe_pattern, find_front

pytestmark = pytest.mark.runs

RESULTS = Path(__file__).parents[3] / "results"
TIMED = ("timing.csv", "report.html")


@pytest.fixture(scope="module", params=SHIPPED)
def result(request, tmp_path_factory):
    config = shrink(request.param)
    out = tmp_path_factory.mktemp(request.param) / "out"
    console = Console(file=io.StringIO(), width=120)
    run_experiment(config, FOLDER, out).show(console)
    return config, out, console.file.getvalue()


def read(out: Path, name: str) -> pd.DataFrame:
    return pd.read_csv(out / f"{name}.csv", keep_default_na=False, na_values={"rms_um": [""], "best_um": [""]})


# --- what is written -------------------------------------------------------------------------------------------------


def test_every_set_is_there_once(result):
    config, out, _ = result
    sets, inputs = read(out, "sets"), read_placement(config, FOLDER)
    n = len(inputs.optional)
    assert len(sets) == 2**n - (n == len(inputs.choices))
    assert not sets["sensors"].duplicated().any()
    prices = {choice.name: choice.price for choice in inputs.choices}
    for _, row in sets.sample(20, random_state=1).iterrows():
        names = [name for name in row["sensors"].split(" ") if name]
        assert row["price"] == pytest.approx(sum(prices[name] for name in names))
        assert row["n_sensors"] == len(names) + sum(choice.always for choice in inputs.choices)


@pytest.mark.parametrize(("front", "against"), [("front", "price"), ("front_by_number", "n_sensors")])
def test_fronts_hold_exactly_what_nothing_beats(result, front, against):
    _, out, _ = result
    sets, found = read(out, "sets"), read(out, front)
    good = sets[sets["reason"] == ""]
    error, price = good["rms_um"].to_numpy(), good[against].to_numpy()
    on_front = good["sensors"].isin(found["sensors"])
    for name, mine, paid, shown in zip(good["sensors"], error, price, on_front, strict=True):
        beaten = (price <= paid) & (error <= mine) & ((price < paid) | (error < mine))
        assert shown == (not beaten.any()), name
    assert (found["reason"] == "").all()


def test_counts_add_up(result):
    _, out, _ = result
    sets, reasons, kinds = (read(out, name) for name in ("sets", "reasons", "kinds"))
    assert reasons[["feasible", "pose", "equations", "tolerances"]].to_numpy().sum() == len(sets)
    assert kinds["n_sets"].sum() == len(sets)
    assert kinds["n_feasible"].sum() == (sets["reason"] == "").sum() == reasons["feasible"].sum()
    assert (sets["rms_um"].isna() == (sets["reason"] == "pose")).all()


def test_errors_add_up(result):
    _, out, _ = result
    rows = read(out, "sets").query("reason == ''").astype({"calibration_um": float, "noise_um": float})
    np.testing.assert_allclose(rows["rms_um"], np.hypot(rows["calibration_um"], rows["noise_um"]), rtol=1e-4)
    assert (rows["largest_um"].astype(float) >= rows["rms_um"] * (1 - 1e-5)).all()


def test_the_page_says_what_was_found(result):
    config, out, printed = result
    summary = json.loads((out / "summary.json").read_text())
    page = (out / "report.html").read_text()
    assert summary["headline"] in printed
    enough = summary["enough"]
    sets = read(out, "sets")
    good = sets[(sets["reason"] == "") & (sets["rms_um"] <= (1.0 + config.within) * summary["best"]["rms_um"])]
    assert enough["price"] == pytest.approx(good["price"].min())
    assert f"{enough['rms_um']:.3g}"[:4] in page
    assert all(name[1:] in page for name in config.named)
    assert "Assumed, in units" in page
    assert {p.name for p in (out / "figures").iterdir()} == {"front.png", "numbers.png", "simulated.png"}


def test_page_comes_from_the_files_alone(result):
    config, out, _ = result
    before = studies.snapshot(out)
    assert find_results_kind(out).config_of(read_results(out)).model_dump() == config.model_dump()
    write_report(out)
    assert studies.snapshot(out) == before


@pytest.mark.slow  # the contract of all kinds has the same of small ones
def test_results_repeat_whatever_the_number_of_workers(tmp_path):
    config = shrink("sensors", workspace_poses=6, simulated_sets=2)
    for name, workers in (("one", 1), ("two", 2)):
        run_experiment(config, FOLDER, tmp_path / name, workers)
    one, two = (
        {p.name: p.read_bytes() for p in (tmp_path / name).glob("*.*") if p.name not in TIMED}
        for name in ("one", "two")
    )
    assert one == two


def test_another_config_does_not_replace_results(result):
    config, out, _ = result
    with pytest.raises(InputError, match="holds results of another config"):
        run_experiment(config.model_copy(update={"seed": 99}), FOLDER, out)


def test_no_good_set_is_a_failure_and_writes_nothing(tmp_path):
    config = shrink("sensors")
    few = config.model_copy(update={"sensors": {"s[1]": config.sensors["s"]}, "named": {}})
    with pytest.raises(NumericalError, match="found no set of 1 that calibrates"):
        run_experiment(few, FOLDER, tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["out.partial"]  # what is kept for --resume


# --- words -----------------------------------------------------------------------------------------------------------


def test_patterns_do_not_know_which_leg_is_which():
    def choose(*names):
        return [Choice(name, np.array([0]), 1.0, False) for name in names]

    one, other = choose("s[1]", "s[3]", "phi[3]"), choose("s[2]", "s[1]", "phi[1]")
    assert describe_pattern(one) == describe_pattern(other) == "1 leg s+phi, 1 leg s"
    assert describe_pattern(choose("s[1]", "phi[2]", "tracker")) == "1 leg phi, 1 leg s, tracker"
    assert describe_kinds(choose("s[1]", "s[3]", "phi[3]", "tracker")) == "2 s + 1 phi + tracker"


def test_sensors_are_written_as_the_page_has_them():
    assert write_sensors("s[1] phi[2] psi[12] tilt_a[3] rho tracker_position") == "s1 φ2 ψ12 tilt-a3 ρ tracker position"
    assert write_sensors("1 leg s+phi") == "1 leg s+φ"


def test_front_of_a_made_up_table():
    table = pd.DataFrame(
        {
            "price": [3.0, 1.0, 2.0, 2.0, 4.0, 1.0],
            "rms_um": [1.0, 3.0, 2.0, 2.5, 1.0, 0.1],
            "reason": ["", "", "", "", "", "tolerances"],
            "pattern": ["a", "b", "c", "c", "a", "d"],
        }
    )
    front = find_front(table, "price")
    assert front.index.tolist() == [1, 2, 0]
    assert front["n_of_pattern"].tolist() == [1, 2, 2]
    assert front["n_alike"].tolist() == [1, 1, 2]


# --- faults ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "old", "new", "expected"),
    [
        ("sensors", "phi = {", "phy = {", "sensor 'phy': unknown here, expected some of s[1], s[2]"),
        ("sensors", '["s", "phi"]\n', '["s", "phx"]\n', "sensor 'phx': unknown here, expected some of s[1]"),
        ("sensors", "noise_um = 1.0, ", "", "expected either noise_um or noise_arcsec"),
        ("sensors", "noise_um = 1.0", "noise_um = 0.0", "found 0.0, expected greater than or equal to"),
        ("sensors", "s = { noise_um", "s = { noise_arcsec", "sensors.s[1]: found noise_arcsec, expected noise_um"),
        ("sensors", "position_mm = 200.0", "position_mm = 900.0", "cannot reach it, found"),
        ("sensors", "angle_deg = 30.0", "angle_deg = 100.0", "cross, expected legs that do not"),
        ("sensors", "angle_deg = 30.0", "rotation_deg = [1.0, 1.0, 1.0]", "expected position_mm with angle_deg, or"),
        ("sensors", 'file = "machine.toml"', 'file = "nothing.toml"', "nothing.toml: no such file"),
        ("sensors", "[machine]\n", "[machine]\ntool_mm = [0.0, 0.0, 1.0]\n", "found deformation or tool_mm without"),
        ("m2_hexapod_sensors", ", always = true", "", ""),
        ("m2_hexapod_sensors", 'reads = ["x", "y", "z"]', 'reads = ["x", "y", "w"]', "sensor 'w': unknown here"),
        ("m2_hexapod_sensors", 'reads = ["rx", "ry", "rz"]', 'reads = ["rx", "x"]', "found x twice"),
        ("m2_hexapod_sensors", "position_mm = [7.0,", "position_mm = [70.0,", "cannot reach it, found"),
        ("m2_hexapod_sensors", 'model = "six_ups"', 'model = "six_usp"', "did you mean 'six_ups'?"),
        ("m2_hexapod_sensors", 'model = "six_ups"', "", "m2_hexapod_mechanism.toml"),
    ],
)  # fmt: skip
def test_bad_input_is_one_line_and_nothing_written(call, tmp_path, name, old, new, expected):
    folder = tmp_path / "sliding_star"
    folder.mkdir()
    (tmp_path / "audit").mkdir()
    for source in (f"sliding_star/{name}.toml", "sliding_star/machine.toml", "audit/m2_hexapod_mechanism.toml"):
        (tmp_path / source).write_text((studies.EXPERIMENTS / source).read_text())
    path = folder / f"{name}.toml"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    if name == "m2_hexapod_sensors" and old == ", always = true":
        path.write_text(text.replace(old, new).replace('reads = ["x", "y", "z"]', 'reads = ["x"]'))
        expected = "sensors: found 20 to choose from, which makes 1.0e+06 sets, expected at most 16"
    code, out, err = call("run", path, "--out", tmp_path / "out", "--workers", 1)
    assert (code, out) == (2, "")
    assert err.startswith("bayescal: ")
    assert err.count("\n") == 1
    assert expected in err
    assert not (tmp_path / "out").exists()


# --- reference results -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SHIPPED)
def test_reference_results_are_those_of_the_shipped_config(name):
    kind, config = load(FOLDER / f"{name}.toml")
    results = RESULTS / config.name
    provenance = json.loads((results / "provenance.json").read_text())
    assert provenance["config_sha256"] == hash_identity(identify(config, FOLDER, kind.files(config, FOLDER)))
    summary = json.loads((results / "summary.json").read_text())
    simulated = pd.read_csv(results / "simulated.csv")
    z = (simulated["simulated_um"] - simulated["predicted_um"]) / simulated["simulated_error_um"]
    assert (np.abs(z) < 3.5).all()
    assert len(simulated) == config.simulated_sets
    assert summary["enough"]["rms_um"] <= (1.0 + config.within) * summary["best"]["rms_um"]
