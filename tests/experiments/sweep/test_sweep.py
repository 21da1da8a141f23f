"""Sweeps: what varies, what is computed once, what is taken up again, and what they answer."""

from __future__ import annotations

import json
import math
import re
import tomllib

import numpy as np
import pandas as pd
import pytest
import sweeps
import tiny_experiments

from bayescal.experiments.runner.load import load
from bayescal.experiments.runner.run import compute_experiment, run_experiment
from bayescal.experiments.runner.store import Store
from bayescal.experiments.sweep.compute import find_answers
from bayescal.experiments.sweep.inputs import change, look_up
from bayescal.experiments.sweep.kind import Sweep
from bayescal.files.toml import write_toml

pytestmark = pytest.mark.runs

SHIPPED = tiny_experiments.SHIPPED / "audit" / "m2_hexapod_tracker.toml"


def run(path, out, **options):
    return run_experiment(load(path)[1], path.parent, out, **options)


def compute(path):
    return compute_experiment(load(path)[1], path.parent)


def count_computed(folder) -> int:
    log = folder / "count"
    return len(log.read_text()) if log.exists() else 0


@pytest.fixture(autouse=True)
def _unseen(no_pictures):
    """Leave pictures undrawn; the contract of kinds draws them."""


# --- what varies -------------------------------------------------------------------------------------------------


def test_every_combination_and_what_is_required(tmp_path):
    """The figure is noise · 2 / √poses: 20 µm are reached at 20 µm of noise with 4 poses, and at 40 with 16."""
    results = compute(sweeps.write(tmp_path))
    members = results.tables["members"]
    assert list(members) == ["noise.tracker_um", "poses", "sensors.tracker.a.sd", "state", "reason"]
    noise, poses = np.repeat([1.0, 3.16228, 10.0, 31.6228, 100.0], 2), np.tile([4.0, 16.0], 5)
    np.testing.assert_array_equal(members["noise.tracker_um"], noise)
    np.testing.assert_array_equal(members["poses"], poses)
    np.testing.assert_array_equal(members["sensors.tracker.a.sd"], noise * 2.0 / poses**0.5)
    assert set(members["state"]) == {"done"}
    answers = results.tables["answers"].set_index(["axis", "setting"])
    few, many = (answers.loc[("noise.tracker_um", f"poses {n}")] for n in (4, 16))
    assert (few["extent"], few["met_at"], few["failed_at"]) == ("up to", 10.0, 31.6228)
    assert few["bound"] == pytest.approx(20.0, rel=1e-8)
    assert many["bound"] == pytest.approx(40.0, rel=1e-8)
    along = answers.loc["poses"]["extent"]
    assert list(along) == ["everywhere", "everywhere", "everywhere", "from", "nowhere"]


def test_the_sweeps_seed_is_that_of_its_members(tmp_path):
    path = sweeps.write(tmp_path, '[[figures]]\nkey = "seed"\n')
    assert set(compute(path).tables["members"]["seed"]) == {5.0}
    repeated = sweeps.SWEEP.replace('key = "poses"\nvalues = [4, 16]', 'key = "seed"\nvalues = [8, 9]')
    path = sweeps.write(tmp_path, '[[figures]]\nkey = "poses"\n', repeated)
    results = compute(path)
    assert list(results.tables["members"]["seed"]) == [8.0, 9.0] * 5
    answers = results.tables["answers"]
    assert list(answers["axis"]) == ["noise.tracker_um"]  # seeds only repeat
    assert list(answers["extent"]) == ["up to"]


def test_of_repeats_the_worst_counts_and_several_bounds_are_said(tmp_path):
    config = load(sweeps.write(tmp_path))[1]
    axis, figure = config.axes[0], config.figures[0]
    columns = {axis.name: [1.0, 1.0, 2.0, 2.0, 3.0, 4.0], "poses": 4.0}

    def find(values):
        found = find_answers(config, pd.DataFrame({**columns, figure.key: values}))
        return next(one for one in found if one.axis == axis.name)

    assert find([1.0, 2.0, 30.0, 1.0, 40.0, 50.0]).failed_at == 2.0
    assert find([1.0, 2.0, 3.0, 1.0, 40.0, 5.0]).extent == "in places"
    assert find([1.0, math.nan, 3.0, 1.0, math.nan, 5.0]).extent == "everywhere"
    assert find([math.nan] * 6).extent == "nowhere"


LIST = """
[[axes]]
key = ["noise.tracker_um", "noise.level_um"]
factors = [1.0, 0.5]

[[axes]]
key = "machine.toml:legs.length_mm"
values = [2.0, 6.0]
"""


def write_list(folder):
    """Write a sweep of rows: noise by factors, the length of the legs in the machine's own file."""
    begin, _, end = sweeps.SWEEP.partition("[[axes]]")
    figures = end[end.index("[[figures]]") :]
    text = begin.replace(
        '"tiny.toml"\n', '"tiny.toml"\nmode = "zip"\noverrides = { noise = { tracker_um = 8.0, level_um = 1.0 } }\n'
    )
    return sweeps.write(folder, sweep=text + LIST + figures)


def test_factors_files_and_rows(tmp_path):
    path = write_list(tmp_path)
    before = (tmp_path / "machine.toml").read_text()
    members = compute(path).tables["members"]
    np.testing.assert_array_equal(members["machine.toml:legs.length_mm"], [2.0, 6.0])
    np.testing.assert_allclose(members["sensors.tracker.a.sd"], [8.0 * 2.0 / 12.0**0.5, 4.0 * 6.0 / 12.0**0.5])
    assert (tmp_path / "machine.toml").read_text() == before


def test_changed_toml_reads_as_what_was_changed():
    content = tomllib.loads(sweeps.MACHINE)
    changed = change(content, [("legs.ends.0.1", -2.5), ("legs.new.text", 'a "b"\\\n'), ("empty", {})])
    assert tomllib.loads(write_toml(changed)) == changed
    assert changed["legs"]["ends"] == [[0.0, -2.5], [True, "x\n"]]
    assert content == tomllib.loads(sweeps.MACHINE)


@pytest.mark.parametrize(
    ("key", "found"),
    [("a.b", 1), ("a.c.d", 2), ("a.c", {"d": 2}), ("list.1.x", 3), ("list.5", None), ("a.z", None), ("a.b.c", None)],
)
def test_keys_of_a_summary(key, found):
    assert look_up({"a": {"b": 1}, "a.c": {"d": 2}, "list": [0, {"x": 3}]}, key) == found


# --- computed once, and taken up again ---------------------------------------------------------------------------


def test_members_are_computed_once_across_sweeps(tmp_path):
    path = sweeps.write(tmp_path, counted=True)
    first = run(path, tmp_path / "results" / "first")
    assert (first.summary["n_distinct"], count_computed(tmp_path)) == (10, 10)
    wider = sweeps.SWEEP.replace("values = [4, 16]", "values = [16, 36, 16]").replace("tiny_sweep", "wider")
    path = sweeps.write(tmp_path, '[[figures]]\nkey = "poses"\n', wider.replace('"poses"', '"poses"', 1), counted=True)
    path.write_text(
        path.read_text().replace('[[figures]]\nkey = "poses"\n', '[[figures]]\nkey = "sensors.names.1.b"\n')
    )
    second = run(path, tmp_path / "results" / "second")
    assert (second.summary["n_members"], second.summary["n_distinct"]) == (15, 10)
    assert count_computed(tmp_path) == 15  # those of 36 poses alone
    assert set(second.results.table("members")["sensors.names.1.b"]) == {3.0}
    (tmp_path / "machine.toml").write_text(sweeps.MACHINE.replace("2.0", "3.0"))
    run(path, tmp_path / "results" / "third")
    assert count_computed(tmp_path) == 25  # of another machine


def test_a_damaged_member_and_one_of_other_versions_are_computed_anew(tmp_path, monkeypatch):
    path = sweeps.write(tmp_path, counted=True)
    run(path, tmp_path / "results" / "first")
    kept = sorted((tmp_path / "results" / ".bayescal_members").rglob("*.npz"))
    assert len(kept) == 10
    kept[0].write_bytes(kept[0].read_bytes()[:-40])
    run(path, tmp_path / "results" / "second")
    assert count_computed(tmp_path) == 11
    monkeypatch.setattr("bayescal.experiments.runner.store.list_versions", lambda: {"numpy": "another"})
    run(path, tmp_path / "results" / "third")
    assert count_computed(tmp_path) == 21


def test_thousands_are_planned_run_in_part_and_taken_up(tmp_path, monkeypatch):
    sweep = sweeps.SWEEP.replace("count = 5", "count = 40").replace("values = [4, 16]", "values = [4, 9, 16]")
    path, save, kept = sweeps.write(tmp_path, sweep=sweep, counted=True), Store.save_task, []

    def stop(store, key, arrays):
        if len(kept) == 25:
            raise KeyboardInterrupt
        kept.append(key)
        save(store, key, arrays)

    monkeypatch.setattr(Store, "save_task", stop)
    with pytest.raises(KeyboardInterrupt):
        run(path, tmp_path / "results" / "out")
    monkeypatch.setattr(Store, "save_task", save)
    assert count_computed(tmp_path) == 26
    finished = run(path, tmp_path / "results" / "out", resume=True)
    assert (finished.summary["n_members"], count_computed(tmp_path)) == (120, 121)  # the one that was not kept
    assert not list((tmp_path / "results").glob("out.*"))


# --- members that fail -------------------------------------------------------------------------------------------


def test_members_that_fail_are_listed_and_stop_nothing(call, tmp_path):
    sweep = sweeps.SWEEP.replace("values = [4, 16]", "values = [7, 16]")
    more = '[[axes]]\nkey = "noise.level_um"\nvalues = [1.0, 13.0]\n'
    path, out = sweeps.write(tmp_path, more, sweep), tmp_path / "out"
    code, _, complaint = call("sweep", path, "--out", out, "--workers", 1, "--quiet")
    assert (code, complaint) == (0, "")
    members = pd.read_csv(out / "members.csv", keep_default_na=False)
    failed = members[members["noise.level_um"] == 13.0]
    assert set(failed["state"]) == {"failed"}
    (reason,) = set(failed["reason"])
    assert reason.endswith("such a level")  # what its class raises, in one line
    assert set(failed["sensors.tracker.a.sd"]) == {""}
    rest = members[members["noise.level_um"] == 1.0]
    assert set(rest.loc[rest["poses"] == 7, "state"]) == {"not converged"}
    assert set(rest.loc[rest["poses"] == 16, "state"]) == {"done"}
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["n_members"], summary["n_failed"], summary["n_not_converged"]) == (20, 10, 5)
    assert reason in (out / "report.html").read_text()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('key = "noise.tracker_um"', 'key = "noise.trakcer_um"', "did you mean 'tracker_um'"),
        ('key = "noise.tracker_um"', 'key = "nosie.tracker_um"', "did you mean 'noise'"),
        ("values = [4, 16]", 'values = [4, "many"]', 'with poses = "many"'),
        ("values = [4, 16]", "values = [4, 0]", "axes.1: with poses = 0: "),
        ("values = [4, 16]", "values = []", "axes.1.values"),
        ("values = [4, 16]", "factors = [1.0]", "poses: found no 'poses'"),
        ("values = [4, 16]", "", "found none, expected one of values, factors and range"),
        ("range = [1.0, 100.0]", "range = [-1.0, 100.0]", "on a log scale, expected positive numbers"),
        ("count = 5", "count = 60000", "combinations, expected at most 100000"),
        ("count = 5", "", "axes.0: expected range with count"),
        ('experiment = "tiny.toml"', 'experiment = "none.toml"', "none.toml"),
        ('experiment = "tiny.toml"', 'experiment = "sweep.toml"', "kind: found 'sweep'"),
        ('experiment = "tiny.toml"', 'experiment = "tiny.toml"\nmode = "zip"', "found axes of [5, 2] entries"),
        ('key = "poses"', 'key = "other.toml:poses"', "other.toml"),
        ("at_most = 20.0", "at_most = 20.0\nat_least = 3.0", "expected at_most or at_least"),
        ('key = "sensors.tracker.a.sd"', 'key = "poses"', "found 'poses' twice"),
        ('experiment = "tiny.toml"', 'experiment = "tiny.toml"\ncache_dir = ".."', "cache_dir: found '..'"),
        ('experiment = "tiny.toml"', 'experiment = "tiny.toml"\ncache_dir = "."', "cache_dir: found '.'"),
    ],
)
def test_faults_are_one_line_and_leave_nothing(refuse, tmp_path, old, new, message):
    assert old in sweeps.SWEEP
    path = sweeps.write(tmp_path, sweep=sweeps.SWEEP.replace(old, new))
    refuse(re.escape(message), tmp_path / "out", "sweep", path)


def test_another_kind_is_no_sweep(refuse, tmp_path):
    sweeps.write(tmp_path)
    refuse("expected 'sweep'", tmp_path / "out", "sweep", tmp_path / "tiny.toml")


def test_a_sweep_none_of_whose_figures_is_there_ends_with_its_first_member(call, tmp_path):
    path = sweeps.write(tmp_path, sweep=sweeps.SWEEP.replace("tracker.a.sd", "tracker.sd"), counted=True)
    code, _, complaint = call("run", path, "--out", tmp_path / "out", "--workers", 1, "--quiet")
    assert (code, complaint.count("\n")) == (3, 1)
    assert "none of sensors.tracker.sd" in complaint
    assert "such as 'sensors.tracker.a.sd'" in complaint
    assert not (tmp_path / "out").exists()
    assert count_computed(tmp_path) == 1


def test_figures_that_nobody_has_are_said(tmp_path):
    path = sweeps.write(tmp_path, '[[figures]]\nkey = "seed"\n[[figures]]\nkey = "nothing.of.the.sort"\n')
    finished = run(path, tmp_path / "out")
    assert any("nothing.of.the.sort" in one.text for one in finished.page.verdict)
    assert math.isnan(finished.results.table("members")["nothing.of.the.sort"][0])
    (failure,) = Sweep().list_failures(finished.results)
    assert "nothing.of.the.sort" in failure


# --- the shipped one ---------------------------------------------------------------------------------------------


def test_the_shipped_sweep_of_audits(tmp_path):
    """Two of its members, by two workers: more poses leave less; the first is the audit as it stands in its file."""
    folder = tiny_experiments.copy_tiny(tmp_path, "audit") / "audit"
    base = folder / "m2_hexapod.toml"
    little = 'seed = 2026\nprofiles = ["l[1]"]\nmodel_error = { terms = ["random"] }\n'
    base.write_text(base.read_text().replace("seed = 2026\n", little))
    path = folder / SHIPPED.name
    text = path.read_text()
    text = text.replace(text[text.index("factors =") : text.index("]", text.index("factors ="))], "factors = [1.0")
    path.write_text(
        text.replace(text[text.index("values =") : text.index("]", text.index("values ="))], "values = [12, 40")
    )
    finished = run(path, tmp_path / "out", workers=2)
    members = finished.results.table("members")
    assert list(members["state"]) == ["done", "done"]
    few, many = members["requirements.z.predicted_sd"]
    assert 0.0 < many < few
    alone = compute_experiment(load(folder / "m2_hexapod.toml")[1], folder).summary["requirements"]["z"]["predicted_sd"]
    assert few == pytest.approx(alone, rel=1e-8)


def test_a_sweep_checks_what_it_is_given_before_it_computes(refuse, tmp_path):
    path = sweeps.write(tmp_path)
    (tmp_path / "machine.toml").write_text("[legs]\n")
    refuse("machine.toml: found no length of legs", tmp_path / "out", "sweep", path)


def test_members_that_fail_in_files_of_their_own_say_so_without_folders(tmp_path):
    """A machine without length, and a slip in the code of the kind: both listed, neither stops the others."""
    path = sweeps.write(tmp_path)
    text = path.read_text().replace('key = "poses"\nvalues = [4, 16]', 'key = "noise.level_um"\nvalues = [1.0, 17.0]')
    path.write_text(text)
    members = compute(path).tables["members"].set_index("noise.level_um")
    assert set(members.loc[1.0, "state"]) == {"done"}
    assert set(members.loc[17.0, "reason"]) == {"KeyError: 'a slip in the code'"}
    path.write_text(
        text.replace(
            '"noise.level_um"\nvalues = [1.0, 17.0]', '"machine.toml:legs"\nvalues = [{}, { length_mm = 1.0 }]'
        )
    )
    members = compute(path).tables["members"]
    assert set(members["reason"]) == {"machine.toml: found no length of legs, expected one", ""}
    assert (members["state"] == "failed").sum() == 5
