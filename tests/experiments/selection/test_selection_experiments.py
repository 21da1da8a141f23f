"""Experiments on pose selection: shipped ones run tiny, what is written is right and repeats, faults are named."""

from __future__ import annotations

import re
import shutil
import tomllib

import numpy as np
import pandas as pd
import pytest
import studies

from bayescal.errors import InputError
from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.runner.results import read_results
from bayescal.experiments.runner.run import find_results_kind, run_experiment
from bayescal.experiments.selection.inputs import read_selection
from bayescal.experiments.selection.schema import label_of
from bayescal.experiments.selection.verdict import Tables

pytestmark = pytest.mark.runs

FOLDER = studies.EXPERIMENTS / "pose_selection"
SHIPPED = ("yu2023/table1", "pose_selection/rr8096_figure14", "pose_selection/hexapod_i_optimal")


def shrink(name: str):
    """Return a shipped experiment with one number of poses, two repeats, few candidates and machines."""
    config = load_experiment(studies.EXPERIMENTS / f"{name}.toml")
    few = {"repeats": 2, "iterations": 5, "n_sets": 20, "max_iterations": 5, "list_length": 10}
    choices = []
    for choice in config.selections:
        at = {k: v for k, v in few.items() if getattr(choice, k, 0) > v}
        choices.append(choice.model_copy(update=at | {"n_poses": choice.n_poses[:1], "repeats": 2}))
    update = {"selections": choices, "candidates": config.candidates.model_copy(update={"count": 150})}
    if config.calibrations is not None:
        update["calibrations"] = config.calibrations.model_copy(update={"machines": 4})
        update["workspace"] = config.workspace.model_copy(update={"poses": 14})
    return config.model_copy(update=update)


@pytest.fixture(scope="module", params=SHIPPED)
def result(request, tmp_path_factory):
    config, path = shrink(request.param), studies.EXPERIMENTS / request.param
    folder = tmp_path_factory.mktemp(path.name) / "out"
    run_experiment(config, path.parent, folder)
    return config, folder


def read(folder, name: str) -> pd.DataFrame:
    return pd.read_csv(folder / f"{name}.csv")


def test_shipped_experiment_writes_everything(result):
    config, folder = result
    selections = read(folder, "selections")
    chosen = sum(len(c.criteria) * len(c.n_poses) * c.repeats for c in config.selections)
    given = selections["criterion"] == "given"
    assert (~given).sum() == chosen
    assert given.sum() == 2 * len(config.designs)
    poses = read(folder, "poses")
    assert len(poses) == selections["n_poses"].sum()
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert config.title in page
    findings = read(folder, "findings")
    assert len(findings) > 0
    assert all(subject in page for subject in findings["subject"])
    assert (folder / "errors.csv").is_file() is (config.calibrations is not None)


def test_config_is_read_back_whole(result):
    """Whatever the config leaves out, what is read back of it is the same: rankings are by the same errors."""
    config, folder = result
    results = read_results(folder)
    found = find_results_kind(folder, results).config_of(results)
    assert found.model_dump() == config.model_dump()
    required = config.name == "pose_selection_i_optimal"
    assert Tables(found, results).metric == ("simulated_over_limits" if required else "mean_position_um")


def test_written_values_are_those_of_the_poses(result):
    config, folder = result
    inputs = read_selection(config, FOLDER)  # `../audit` is the same folder for all
    start = inputs.design.machine.mechanism.initial_actuator_positions
    poses, selections = read(folder, "poses"), read(folder, "selections")
    keys = ["label", "criterion", "n_poses", "repeat"]
    for key, rows in poses.groupby(keys, sort=False):
        found = inputs.indices(start + rows[[f"drho_{k}_mm" for k in range(1, 7)]].to_numpy())
        row = selections.set_index(keys).sort_index().loc[key]
        for name, value in found.items():
            assert row[name] == pytest.approx(value, rel=1e-6, abs=1e-15)
        if key[1] in found:
            assert row["value"] == pytest.approx(found[key[1]], rel=1e-6)


def test_plans_are_read_by_audits(result):
    config, folder = result
    legs = len(read_selection(config, FOLDER).design.machine.mechanism.leg_lengths)
    plans = sorted((folder / "plans").glob("*.csv"))
    ways = {(label_of(c), name, n) for c in config.selections for name in c.criteria for n in c.n_poses}
    assert {path.stem for path in plans} == {f"{label}_{criterion}_{n}" for label, criterion, n in ways}
    for path in plans:
        moves = pd.read_csv(path, comment="#").to_numpy()
        assert moves.shape == (int(path.stem.rpartition("_")[2]), legs)


def test_published_columns(result):
    config, folder = result
    if not hasattr(config, "published"):
        assert not (folder / "published.csv").exists()
        return
    table = read(folder, "published").set_index(["label", "criterion", "n_poses"])
    every = {(m, f"O{k}", 20) for m in ("detmax", "tabu") for k in range(1, 6)}
    assert set(table.index) == every | {("tabu", "O2", 40)}  # which is tried more often than the others
    assert table.loc[("tabu", "O1", 20), "published"] == 0.0357
    assert table.loc[("detmax", "O4", 20), "published"] == 3.337e-7
    np.testing.assert_allclose(table["ratio"], table["best"] / table["published"], rtol=1e-9)


def test_i_needs_a_workspace(tmp_path):
    text = (FOLDER / "hexapod_i_optimal.toml").read_text(encoding="utf-8")
    path = tmp_path / "x.toml"
    path.write_text(re.sub(r"\[workspace\].*?(?=\[requirements\])", "", text, flags=re.S), encoding="utf-8")
    with pytest.raises(InputError, match=r"without \[workspace\],"):
        load_experiment(path)


def test_measured_poses_count(tmp_path):
    """Poses beside those measured already: the criterion is that of both together."""
    config = shrink("pose_selection/rr8096_figure14")
    table = {"configurations": "../telescope/calibration_configurations.csv", "unit_mm": 1.3}
    section = type(config.designs[0]).__mro__[1](**table)
    choice = next(c for c in config.selections if c.method == "exchange").model_copy(update={"n_poses": [1]})
    config = config.model_copy(
        update={"measured": section, "selections": [choice], "calibrations": None, "designs": []}
    )
    run_experiment(config, FOLDER, tmp_path / "out")
    inputs = read_selection(config, FOLDER)
    poses, selections = read(tmp_path / "out", "poses"), read(tmp_path / "out", "selections")
    start = inputs.design.machine.mechanism.initial_actuator_positions
    own = start + poses[poses["repeat"] == 1][[f"drho_{k}_mm" for k in range(1, 7)]].to_numpy()
    assert own.shape == (1, 6)
    together = inputs.indices(np.concatenate([inputs.measured, own]))["O1"]
    assert selections["value"].iloc[0] == pytest.approx(together, rel=1e-6)


FLAT = """
name = "struts that can lie flat"

[base]
points_mm = [[64, 77, 0], [34, 94, 0], [-98, 17, 0], [-98, -17, 0], [34, -94, 0], [64, -77, 0]]

[platform]
points_mm = [[79, 14, 0], [-27, 75, 0], [-51, 61, 0], [-51, -61, 0], [-27, -75, 0], [79, -14, 0]]

[home]
position_mm = [0.0, 0.0, 100.0]

[legs]
actuated_joint = "strut"
actuator_range_mm = 118.0
"""
HEADER = "drho_1_mm,drho_2_mm,drho_3_mm,drho_4_mm,drho_5_mm,drho_6_mm"
FLAT_BOX = 'kind = "workspace"\nposition_mm = [50.0, 50.0, 100.0]\nrotation_deg = [1.0, 1.0, 1.0]'
NARROW_BOX = 'kind = "workspace"\nposition_mm = [5.0, 0.0, 0.0]\nrotation_deg = [0.0, 0.0, 0.0]'
EVEN = 'layout = "even"\nlevels = 3'
MEASURED = '[measured]\nconfigurations = "table.csv"\n\n[domain]'
GIVEN = '[[designs]]\nname = "theirs"\nconfigurations = "table.csv"\n\n[domain]'
BAD = {
    "unknown domain": (
        {'kind = "actuators"': 'kind = "nowhere"'},
        r"found 'nowhere', expected one of 'workspace', 'actuators'",
    ),
    "unknown criterion": ({'criteria = ["O1"]': 'criteria = ["O6"]'}, r"found 'O6', expected"),
    "one label twice": (
        {'method = "exchange"': 'method = "random"'},
        r"found 'random' twice for criterion O1, 10 poses",
    ),
    "unknown sensor": ({'sensors = ["laser_tracker"]': 'sensors = ["eye"]'}, r"found sensor 'eye', expected one of"),
    "no such machine": ({"../audit/camera_hexapod_mechanism": "camera"}, r"camera\.toml"),
    "too few poses": (
        {"n_poses = [10, 20, 40]": "n_poses = [10, 5]"},
        r"poses: found 5, expected at least 7 for 42 parameters",
    ),
    "fewer candidates than poses": (
        {"count = 1000": "count = 8"},
        r"candidates: found 8 distinct of 8 poses, expected at least 40",
    ),
    "measured pose not finite": (
        {"[domain]": MEASURED, "table.csv": "0,0,0,0,0,0\n0,nan,0,0,0,0"},
        r"table\.csv, line 3: drho_2_mm: found nan, expected a finite number",
    ),
    "given pose not finite": (
        {"[domain]": GIVEN, "table.csv": "0,0,0,0,0,inf"},
        r"table\.csv, line 2: drho_6_mm: found inf, expected a finite number",
    ),
    "bounds not finite": (
        {'kind = "actuators"': NARROW_BOX.replace("5.0", "nan")},
        r"domain\.workspace\.position_mm\.0: found nan, expected a finite number",
    ),
    "singular candidate": (
        {'kind = "actuators"': FLAT_BOX, 'layout = "random"': EVEN, "mechanism": FLAT},
        r"candidate \d+ \([^)]*z -100 mm[^)]*\): singular pose",
    ),
    "given pose that is singular": (
        {"[domain]": GIVEN, "mechanism": FLAT, "table.csv": "0,0,0,0,0,0\n{flat}"},
        r"designs: theirs: pose 2: found no pose",
    ),
}


def lie_flat() -> str:
    """Return the displacements of the struts from home to where all joints lie in one plane, where J_1 is singular."""
    points = tomllib.loads(FLAT)
    base, platform = (np.array(points[body]["points_mm"], dtype=float) for body in ("base", "platform"))
    home = np.linalg.norm(platform + np.array([0.0, 0.0, 100.0]) - base, axis=1)
    return ",".join(f"{x:.9f}" for x in np.linalg.norm(platform - base, axis=1) - home)


@pytest.mark.parametrize("fault", BAD)
def test_bad_input_on_the_command_line(tmp_path, refuse, fault):
    changes, message = BAD[fault]
    text = (FOLDER / "hexapod_i_optimal.toml").read_text(encoding="utf-8")
    text = re.sub(r"\[calibrations\].*", "", text, flags=re.S).replace('["O1", "D", "A", "I"]', '["O1"]')
    for old, new in changes.items():
        if old == "table.csv":
            rows = new.replace("{flat}", lie_flat())
            (tmp_path / old).write_text(f"{HEADER}\n{rows}\n", encoding="utf-8")
        elif old == "mechanism":
            (tmp_path / "mechanism.toml").write_text(new, encoding="utf-8")
        else:
            assert old in text
            text = text.replace(old, new)
    if "mechanism" not in changes:
        shutil.copy(studies.EXPERIMENTS / "audit/camera_hexapod_mechanism.toml", tmp_path / "mechanism.toml")
    path = tmp_path / "x.toml"
    path.write_text(text.replace("../audit/camera_hexapod_mechanism", "mechanism"), encoding="utf-8")
    refuse(f"^bayescal: {re.escape(str(path))}.*{message}", tmp_path / "out", "run", path, "--workers", 1)
