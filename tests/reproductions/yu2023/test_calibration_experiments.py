"""The shipped experiments, tiny; what they refuse; what does not change their results."""

from __future__ import annotations

import io
import json
import re

import pandas as pd
import pytest
from experiments.runner.test_kind_contract import leave_out_pictures, read_all
from hexapod_settings import SHIPPED, copy_tiny
from rich.console import Console

from bayescal.errors import BayescalError
from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.runner.run import run_experiment, write_report
from bayescal.report.pictures import Picture

pytestmark = pytest.mark.runs

TABLES = {
    "table4": {"table4", "best", "noise_draws", "workspaces"},
    "table8": {"table8", "ratios", "reductions", "repeats"},
    "figure10": {"figure10"},
}
FIGURES = {
    "table4": {"figure5", "figure5_noise", "best"},
    "table8": {"table8", "figure8", "figure9"},
    "figure10": {"figure10"},
}


@pytest.fixture(scope="module", params=SHIPPED)
def tiny(request, tmp_path_factory):
    """Return a tiny shipped experiment: its name, its config's path, its results without pictures, what it said."""
    folder = tmp_path_factory.mktemp(request.param)
    path, out = copy_tiny(request.param, folder), folder / "out"
    console = Console(file=io.StringIO(), width=120)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("bayescal.report.page.render_picture", lambda draw: Picture(b"not drawn"))
        run_experiment(load_experiment(path), path.parent, out, workers=1).show(console)
    return request.param, path, out, console.file.getvalue()


def refuse_constant(name: str):
    raise AssertionError(f"found {name}, which is no JSON")


def test_shipped_experiment_runs_tiny(tiny):
    name, _, out, text = tiny
    assert "report.html" in text
    assert {p.stem for p in out.glob("*.csv")} >= TABLES[name]
    assert {p.stem for p in (out / "figures").iterdir()} == FIGURES[name]
    summary = json.loads((out / "summary.json").read_text(), parse_constant=refuse_constant)
    assert summary["headline"] in text
    assert not re.search(r"\bnan\b", re.sub(r"base64,[^\"]*", "", (out / "report.html").read_text()))


def test_page_comes_from_the_files_alone(tiny, pictures):
    """With its pictures, which the first one has not."""
    out = tiny[2]
    before = leave_out_pictures(read_all(out))
    write_report(out, trust=True)
    assert leave_out_pictures(read_all(out)) == before
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in (out / "figures").iterdir())


@pytest.mark.parametrize("tiny", ["table4"], indirect=True)
def test_table4_has_published_errors_and_workspaces(tiny):
    out = tiny[2]
    table = pd.read_csv(out / "table4.csv").set_index(["condition", "index"])
    assert table.loc[("IV", "O5"), "published"] == 0.27659
    scales = pd.read_csv(out / "workspaces.csv")
    one, half = (scales.loc[scales["scale"] == scale, "deg"].to_numpy() for scale in (1.0, 0.5))
    assert one == pytest.approx(table["mean"].to_numpy())
    assert len(half) == len(one)
    assert (half != one).all()


@pytest.mark.parametrize("tiny", ["table8"], indirect=True)
def test_table8_sets_the_published_figures_beside(tiny):
    out = tiny[2]
    table = pd.read_csv(out / "table8.csv").set_index(["poses", "weighting", "figure"])
    assert table.loc[("optimal", "unweighted", "attitude_mean_deg"), "published"] == 0.000262
    assert table.loc[("random", "unweighted", "position_max_mm"), "published"] == 0.006933
    reductions = pd.read_csv(out / "reductions.csv").set_index("figure")["published"]
    assert reductions["position_max_mm"] == pytest.approx(0.784, abs=5e-4)
    assert reductions["attitude_max_deg"] == pytest.approx(0.706, abs=5e-4)
    parameters = pd.read_csv(out / "parameters.csv").set_index("parameter")
    assert parameters.loc["b_y[4]", "published_mm"] == 1.121
    assert parameters.loc["a_x[5]", "preset_mm"] == pytest.approx(-1.3)


def refuse(path, old, new, match):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(BayescalError, match=match) as caught:  # some show only when they are computed
        run_experiment(load_experiment(path), path.parent, path.parent / "out", workers=1)
    assert "\n" not in str(caught.value)
    assert not (path.parent / "out").exists()


FAULTS = [
    ("\nposes = 20", "\nposes = 6", "poses: found 6, expected at least 7 for 42 parameters"),
    ("candidates = 150", "candidates = 15", "candidates: found 15 distinct of 15 poses, expected at least 20"),
    ('of = "accuracy"', 'of = "speed"', "study: found 'speed', expected one of"),
    ("repeats = 4", "repeats = 1", "repeats: found 1, expected greater than or equal to 2"),
    ("table6.csv", "table9.csv", "table9.csv: no such file"),
    ("yu2023_mechanism", "m3_mechanism", "m3_mechanism.toml: no such file"),
    ("[100.0, 100.0, 100.0]", "[900.0, 900.0, 900.0]", "candidates: found|workspace: found"),
    ("attitude_deg = 0.0001", "attitude_deg = 0.0", "study.noise.attitude_deg: found 0.0, expected greater than"),
]


@pytest.mark.parametrize(("old", "new", "match"), FAULTS)
def test_faults_are_one_line(old, new, match, tmp_path):
    refuse(copy_tiny("table8", tmp_path), old, new, match)


def test_driven_base_joints_are_refused(tmp_path):
    path = copy_tiny("table8", tmp_path)
    mechanism = path.parent / "small_mechanism.toml"
    mechanism.write_text(mechanism.read_text().replace('actuated_joint = "strut"', 'actuated_joint = "base"'))
    refuse(path, "../audit/yu2023_mechanism.toml", "small_mechanism.toml", "six_ups")
