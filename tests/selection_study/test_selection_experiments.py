"""Experiments on pose selection: shipped ones run tiny, what is written is right and repeats, faults are named."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
import studies

from bayescal.config import load_audit, load_experiment
from bayescal.errors import InputError
from bayescal.selection_study.inputs import read_selection
from bayescal.selection_study.run import run_pose_selection

FOLDER = studies.EXPERIMENTS / "pose_selection"
SHIPPED = ("yu2023_table1", "rr8096_figure14", "hexapod_i_optimal")
DETERMINISTIC = ("selections", "selection_summary", "poses", "traces", "random_sets", "published", "errors")


def shrink(name: str):
    """Return a shipped experiment with one number of poses, two repeats, few candidates and machines."""
    config = load_experiment(FOLDER / f"{name}.toml")
    few = {"repeats": 2, "iterations": 5, "n_sets": 20, "max_iterations": 5, "list_length": 10}
    choices = []
    for choice in config.selections:
        at = {k: v for k, v in few.items() if k in type(choice).model_fields and getattr(choice, k) > v}
        choices.append(choice.model_copy(update=at | {"n_poses": choice.n_poses[:1], "repeats": 2}))
    update = {"selections": choices, "candidates": config.candidates.model_copy(update={"count": 150})}
    if config.calibrations is not None:
        update["calibrations"] = config.calibrations.model_copy(update={"machines": 4})
        update["workspace"] = config.workspace.model_copy(update={"poses": 14})
    return config.model_copy(update=update)


@pytest.fixture(scope="module", params=SHIPPED)
def result(request, tmp_path_factory):
    config = shrink(request.param)
    folder = tmp_path_factory.mktemp(request.param) / "out"
    run_pose_selection(config, FOLDER, folder)
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
    verdict = json.loads((folder / "summary.json").read_text(encoding="utf-8"))["verdict"]
    assert verdict
    assert all(statement["lead"] in page for statement in verdict)
    assert (folder / "errors.csv").is_file() is (config.calibrations is not None)


def test_written_values_are_those_of_the_poses(result):
    config, folder = result
    inputs = read_selection(config, FOLDER)
    start = inputs.audit.knowledge.machine.mechanism.initial_actuator_positions
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
    legs = len(read_selection(config, FOLDER).audit.knowledge.machine.mechanism.leg_lengths)
    plans = sorted((folder / "plans").glob("*.csv"))
    ways = {(c.label or c.method, name, n) for c in config.selections for name in c.criteria for n in c.n_poses}
    assert {path.stem for path in plans} == {f"{label}_{criterion}_{n}" for label, criterion, n in ways}
    for path in plans:
        moves = pd.read_csv(path, comment="#").to_numpy()
        assert moves.shape == (int(path.stem.rpartition("_")[2]), legs)


def test_same_seed_gives_same_bytes_whatever_the_workers(tmp_path):
    config = shrink("rr8096_figure14")
    for name, workers in (("one", 1), ("two", 2)):
        run_pose_selection(config, FOLDER, tmp_path / name, workers)
    for name in DETERMINISTIC:
        paths = [tmp_path / run / f"{name}.csv" for run in ("one", "two")]
        assert paths[0].is_file() == paths[1].is_file()
        if paths[0].is_file():
            assert paths[0].read_bytes() == paths[1].read_bytes()
    run_pose_selection(config.model_copy(update={"seed": 1}), FOLDER, tmp_path / "other")
    assert (tmp_path / "one/poses.csv").read_bytes() != (tmp_path / "other/poses.csv").read_bytes()


def test_published_columns(result):
    config, folder = result
    if config.published is None or config.published.table is None:
        assert not (folder / "published.csv").exists()
        return
    table = read(folder, "published").set_index(["label", "criterion", "n_poses"])
    assert set(table.index) == {(m, f"O{k}", 20) for m in ("detmax", "tabu") for k in range(1, 6)}
    assert table.loc[("tabu", "O1", 20), "published"] == 0.0357
    assert table.loc[("detmax", "O4", 20), "published"] == 3.337e-7
    np.testing.assert_allclose(table["ratio"], table["best"] / table["published"], rtol=1e-9)


def test_random_sets_are_those_of_the_source():
    """Mean and maximum of O1 of 1,000 random sets of 20: 0.0171 and 0.0220 within 3 %."""
    config = load_experiment(FOLDER / "yu2023_table1.toml")
    choices = [c.model_copy(update={"repeats": 2}) for c in config.selections if c.method == "random"]
    from bayescal.selection_study.tables import tabulate_random_sets
    from bayescal.selection_study.tasks import run_tasks

    inputs = read_selection(config.model_copy(update={"selections": choices}), FOLDER)
    values = tabulate_random_sets(run_tasks(inputs)).groupby("repeat")["value"]
    assert len(values) == 2
    np.testing.assert_allclose(values.mean(), 0.01713, rtol=0.03)
    assert abs(values.max().iloc[0] / 0.02199 - 1.0) < 0.03


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('within = "actuators"', 'within = "nowhere"', r"found 'nowhere', expected one of 'workspace', 'actuators'"),
        ("count = 1000", "count = 0", r"candidates\.count: found 0"),
        ("count = 1000", "cuont = 1000", r"unknown key, did you mean 'count'\?"),
        ("n_poses = [10, 20, 40]", "n_poses = [3]", r"poses: found 3, expected at least 7 for 42 parameters"),
        ('criteria = ["O1", "D", "A", "I"]', 'criteria = ["O6"]', r"found 'O6', expected"),
        ('method = "exchange"', 'method = "random"', r"found 'random' twice for criterion O1 and 10 poses"),
        ('measured_by = ["laser_tracker"]', 'measured_by = ["eye"]', r"found sensor 'eye', expected one of"),
        ("camera_hexapod_mechanism", "camera", r"camera\.toml"),
    ],
)
def test_faults_are_one_line(tmp_path, old, new, message):
    text = (FOLDER / "hexapod_i_optimal.toml").read_text(encoding="utf-8")
    assert old in text
    audit = tmp_path / "audit"
    audit.mkdir()
    shutil.copy(studies.EXPERIMENTS / "audit/camera_hexapod_mechanism.toml", audit)
    path = tmp_path / "selection" / "x.toml"
    path.parent.mkdir()
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=message) as error:
        run_pose_selection(load_experiment(path), path.parent, tmp_path / "out")
    assert "\n" not in str(error.value)
    assert not (tmp_path / "out").exists()


def test_i_needs_a_workspace(tmp_path):
    text = (FOLDER / "hexapod_i_optimal.toml").read_text(encoding="utf-8")
    path = tmp_path / "x.toml"
    path.write_text(re.sub(r"\[workspace\].*?(?=\[requirements\])", "", text, flags=re.S), encoding="utf-8")
    with pytest.raises(InputError, match=r"without \[workspace\], expected both"):
        load_experiment(path)


def test_measured_poses_count(tmp_path):
    """Poses beside those measured already: the criterion is that of both together."""
    config = shrink("rr8096_figure14")
    table = {"configurations": "../telescope/calibration_configurations.csv", "unit_mm": 1.3}
    section = type(config.designs[0]).__mro__[1](**table)
    choice = next(c for c in config.selections if c.method == "exchange").model_copy(update={"n_poses": [1]})
    config = config.model_copy(
        update={"measured": section, "selections": [choice], "calibrations": None, "designs": []}
    )
    run_pose_selection(config, FOLDER, tmp_path / "out")
    inputs = read_selection(config, FOLDER)
    poses, selections = read(tmp_path / "out", "poses"), read(tmp_path / "out", "selections")
    start = inputs.audit.knowledge.machine.mechanism.initial_actuator_positions
    own = start + poses[poses["repeat"] == 1][[f"drho_{k}_mm" for k in range(1, 7)]].to_numpy()
    assert own.shape == (1, 6)
    together = inputs.indices(np.concatenate([inputs.measured, own]))["O1"]
    assert selections["value"].iloc[0] == pytest.approx(together, rel=1e-6)


def test_command_ends_with_two_and_one_line(tmp_path):
    path = tmp_path / "x.toml"
    path.write_text('kind = "pose_selection"\n', encoding="utf-8")
    command = [sys.executable, "-m", "bayescal.cli", "run", str(path)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    assert len(ended.stderr.strip().splitlines()) == 1
    assert str(path) in ended.stderr


@pytest.mark.parametrize("design", ["telescope_six_pus_none", "camera_hexapod"])
def test_audit_gains_by_i_optimal_poses(design):
    from bayescal.audit.inputs import read_inputs
    from bayescal.audit.sensitivity import compute_sensitivity
    from bayescal.selection_study.accuracy import judge_poses
    from bayescal.selection_study.for_audit import plan_i_optimal, select_i_optimal
    from bayescal.selection_study.limits import find_limits

    folder = studies.EXPERIMENTS / "audit"
    inputs = read_inputs(load_audit(folder / f"{design}.toml"), folder)
    plan = plan_i_optimal(inputs)
    assert plan.actuators.shape == inputs.plan.actuators.shape
    assert plan.sensors == inputs.plan.sensors
    mechanism = inputs.knowledge.machine.mechanism
    moved = np.abs(plan.actuators - mechanism.initial_actuator_positions)
    assert moved.max() <= mechanism.actuator_range * (1 + 1e-9)
    workspace = compute_sensitivity(inputs.knowledge, inputs.workspace_actuators)
    limits = find_limits(inputs.requirements, workspace, inputs.knowledge.sd)
    before, after = (
        judge_poses(inputs, workspace, limits, actuators, 20, np.random.default_rng(3))
        for actuators in (inputs.plan.actuators, plan.actuators)
    )
    assert after.predicted[2] < 0.9 * before.predicted[2]
    assert after.predicted[2] ** 2 == pytest.approx(-select_i_optimal(inputs).value, rel=1e-6)
    assert np.mean(after.simulated[:, 2] ** 2) < np.mean(before.simulated[:, 2] ** 2)
