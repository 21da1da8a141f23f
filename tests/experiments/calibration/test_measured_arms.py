"""Two arms, really measured: what their shipped studies find, on readings that were held back."""

from __future__ import annotations

import shutil

import numpy as np
import pandas as pd
import pytest
import studies

from bayescal.machines.read import read_reading_model

UR10, PANDA = (studies.EXPERIMENTS / name for name in ("ur10", "panda_socket"))
PLACES = {"front": 0.70, "right": 0.80, "back": 1.12}
"""Sockets' places, and what the ball scatters by at most, mm rms, as predicted from the other two.

Least squares of all rows by independent code leave 0.70, 0.80 and 1.04 mm: they weigh positions alike, not joints.
"""


def read_tables(folder):
    """Return tables of results by name."""
    return {path.stem: pd.read_csv(path) for path in (folder / "tables").glob("*.csv")}


def measure_tool(tables):
    """Return by variant the rms distance, mm, of held-back tools from where commands lead, and the intervals' share."""
    own = tables["tool_predictions"]
    square = ((own["measured"] - own["mean"]) ** 2).groupby([own["variant"], own["pose"]]).sum()
    return np.sqrt(square.groupby("variant").mean()), own.groupby("variant")["in_interval_90"].mean()


@pytest.mark.runs
def test_an_arm_seen_by_a_tracker(call, tmp_path):
    code, said, _ = call("run", UR10 / "study.toml", "--out", tmp_path / "out", "--workers", 2)
    assert code == 0
    assert said.startswith("Use ")
    tables = read_tables(tmp_path / "out")
    variants = tables["variants"].set_index("variant")
    assert variants["converged"].all()
    assert variants.loc["harmonics", "log_evidence"] > variants.loc["links", "log_evidence"] + 5.0
    apart, inside = measure_tool(tables)
    assert apart["harmonics"] < 0.45
    assert apart["harmonics"] < apart["links"] < 0.5
    assert inside.between(0.85, 0.93).all()


@pytest.mark.slow
def test_five_times_the_rows_tell_compliance(call, tmp_path):
    code, *_ = call("run", UR10 / "study_300.toml", "--out", tmp_path / "out", "--workers", 2)
    assert code == 0
    tables = read_tables(tmp_path / "out")
    variants = tables["variants"].set_index("variant")
    assert variants["converged"].all()
    assert variants.loc["compliance", "log_evidence"] > variants.loc["links", "log_evidence"] + 50.0
    apart, inside = measure_tool(tables)
    assert apart["compliance"] < 0.39 < apart["links"] < 0.5
    assert inside.between(0.85, 0.96).all()


@pytest.mark.runs
def test_an_arm_whose_ball_sat_in_sockets(call, tmp_path):
    code, *_ = call("run", PANDA / "study.toml", "--out", tmp_path / "out", "--workers", 2)
    assert code == 0
    tables = read_tables(tmp_path / "out")
    variants = tables["variants"].set_index("variant")
    assert variants["converged"].all()
    assert variants.loc["links", "log_evidence"] > variants.loc["zeros", "log_evidence"] + 100.0
    apart, inside = measure_tool(tables)
    assert apart["links"] < 0.7
    assert inside.between(0.85, 0.96).all()


def leave_out(place, folder):
    """Write the shipped study without the sockets of a place, in one variant that frees the links."""
    shutil.copytree(PANDA, folder)
    text = (folder / "study.toml").read_text()
    head, _, variants = text.partition("[[variants]]")
    lines = [line for line in head.splitlines() if not line.lstrip(" {").startswith((place, f'file = "data/{place}'))]
    links = variants.partition("[[variants]]")[2]
    (folder / "study.toml").write_text("\n".join(lines) + "\n[[variants]]" + links)


@pytest.mark.slow
@pytest.mark.parametrize("place", PLACES)
def test_sockets_at_two_places_predict_those_at_the_third(place, call, tmp_path):
    leave_out(place, tmp_path / "panda")
    study = tmp_path / "panda" / "study.toml"
    assert call("run", study, "--out", tmp_path / "out", "--workers", 1, "--effort", "quick")[0] in (0, 3)
    found = read_tables(tmp_path / "out")["parameters"].set_index("parameter")["mean"]
    model = read_reading_model(PANDA / "machine.toml")
    theta = model.layout.nominal.copy()
    for k, name in enumerate(model.layout.names):
        theta[k] = found.get(name, theta[k])
    means, scatter = [], []
    for socket in (1, 2):
        table = pd.read_csv(PANDA / "data" / f"{place}_{socket}.csv", comment="#")
        ball = model.tool_values(theta, table[[f"joint_{k}_rad" for k in range(1, 8)]].to_numpy())[:, :3]
        means.append(ball.mean(axis=0))
        scatter.append(((ball - means[-1]) ** 2).sum(axis=1))
    rms, apart = float(np.sqrt(np.concatenate(scatter).mean())), float(np.linalg.norm(means[0] - means[1]))
    assert rms <= PLACES[place]
    assert apart == pytest.approx(50.0, abs=1.3)
