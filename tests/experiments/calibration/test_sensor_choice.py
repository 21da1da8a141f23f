"""Sensors to choose from: sets agree with audits of the same sensors, searches with each other; counts of poses."""

from functools import cache

import calibrations
import numpy as np
import pandas as pd
import pytest

from bayescal.errors import InputError
from bayescal.experiments.audit.accuracy import select_poses
from bayescal.experiments.audit.audit import judge
from bayescal.experiments.audit.design import read_design
from bayescal.experiments.audit.sensor_sets import find_infeasible, search_sensors
from bayescal.experiments.runner.load import load
from bayescal.experiments.runner.run import run_experiment

ALL = 'candidates = ["s", "cam_x", "cam_y", "height"]'


@pytest.fixture
def folder(tmp_path):
    return calibrations.write_audit(tmp_path).parent


@pytest.fixture(scope="module")
def read(tmp_path_factory):
    """Return a function that reads the audit with sensors to choose from, and other changes."""
    folder = calibrations.write_audit(tmp_path_factory.mktemp("audit")).parent
    path = folder / "audit.toml"
    original = path.read_text()

    @cache
    def read_changed(choice, *changes):
        path.write_text(f"{original}\n[sensor_selection]\n{choice}\n")
        calibrations.change(path, "seed = 4", 'seed = 4\naccuracy_frame = "base"')  # no best fit takes anything away
        for old, new in changes:
            calibrations.change(path, old, new)
        return read_design(load(path)[1], folder)

    return read_changed


@pytest.fixture(scope="module")
def every(read):
    """Return all sets of the sensors."""
    return search_sensors(read(ALL).sensors)


def names_of(inputs, found, place):
    return [one.name for one, there in zip(inputs.sensors.choices, found.sets[place], strict=True) if there]


SETS = {"both": "s[1], s[2], s[3], cam_x, cam_y, height", "probe": "s[1], s[2], s[3], height"}
ALONE = '[model_error]\nterms = ["random"]\n'


@pytest.mark.runs
@pytest.mark.parametrize(
    ("aligned", "error", "alike"),
    [(False, ALONE, SETS), (True, ALONE, SETS), (False, "", ["both"])],  # fewer sensors find errors of other sizes
)
def test_a_set_is_as_good_as_an_audit_of_the_same_sensors_says(aligned, error, alike, folder, no_pictures):
    path = folder / "audit.toml"
    path.write_text(f"{path.read_text()}\n{error}[sensor_selection]\n{ALL}\n")
    calibrations.change(path, "seed = 4", f'seed = 4\naccuracy_frame = "{"aligned" if aligned else "base"}"')
    done = run_experiment(load(path)[1], folder, folder / "out", quiet=True).results
    sets, accuracy = done.table("sensor_sets").set_index("sensors"), done.table("requirements")
    compared = list[bool]()  # probabilities are of some sets alone
    for variant in alike:
        sensors = SETS[variant]
        wanted = accuracy[accuracy["variant"] == variant]["rms_sd"]
        np.testing.assert_allclose(sets.loc[sensors, ["error_x_mm", "error_y_mm", "error_z_mm"]], wanted, rtol=1e-6)
        chance = done.summary["variants"][variant]["probability"]
        own = sets["probability"][sensors]
        compared += [own == pytest.approx(chance, abs=0.04)] * bool(np.isfinite(own))
    assert compared
    assert all(compared)
    told = done.table("parameters")
    told = told[told["variant"] == "both"].set_index("parameter")["posterior_sd"]
    best = done.table("best_set_parameters")
    best = best[best["n_sensors"] == 6].set_index("parameter")["sd"]
    np.testing.assert_allclose(best, told[best.index], rtol=1e-6)
    if not error:
        return
    assert sets["probability"][SETS["both"]] > 0.8
    found = pd.read_csv(folder / "out" / "tables" / "findings.csv").set_index("subject").loc["Sensors"]
    assert found["status"] == ("good" if aligned else "warning")


def test_sets_are_judged_at_every_pose_or_by_the_rms_as_is_required(read, every):
    goals = []
    poses = read(ALL, ('requirement_applies_to = "rms"', 'requirement_applies_to = "all_poses"'))
    for inputs, found in ((read(ALL), every), (poses, search_sensors(poses.sensors))):
        best = found.best_of(6)
        goals.append(found.accuracy[best].goal)
        outlooks = judge(inputs.plans["both"]).outlooks
        assert goals[-1] == pytest.approx(max(one.predicted_sd / one.requirement.limit for one in outlooks), rel=1e-6)
    assert goals[1] > 1.2 * goals[0]


def test_adding_and_exchanging_finds_the_best_of_all_sets(read, every):
    inputs = read(f"{ALL}\nmax_exhaustive_sets = 0")
    some = search_sensors(inputs.sensors)
    assert every.exhaustive
    assert not some.exhaustive
    for number in range(3, 7):
        first, second = (found.best_of(number) for found in (every, some))
        assert every.accuracy[first].goal == some.accuracy[second].goal
    assert names_of(inputs, some, some.best_of(4)) == ["s[1]", "s[2]", "s[3]", "height"]


def test_what_is_no_good_is_named_by_its_largest_sets(read, every):
    inputs, found = read(ALL), every
    infeasible = [names_of(inputs, found, k) for k in find_infeasible(found)]
    assert [sorted({"s[1]", "s[2]", "s[3]"} - set(one)) for one in infeasible] == [["s[3]"], ["s[2]"], ["s[1]"]]
    assert all(len(one) == 5 for one in infeasible)
    bad = {tuple(row) for row, one in zip(found.sets, found.accuracy, strict=True) if one.reason}
    parts = {tuple(row) for row in found.sets if any((row <= found.sets[k]).all() for k in find_infeasible(found))}
    assert bad == parts


def test_an_instrument_is_bought_whole_and_what_is_always_there_does_not_count(read):
    inputs = read('candidates = [["cam_x", "cam_y"], "height"]\nrequired_sensors = ["s"]')
    found = search_sensors(inputs.sensors)
    assert [one.name for one in inputs.sensors.choices] == ["cam_x + cam_y", "height"]
    assert found.sets.tolist() == [[False, False], [True, False], [False, True], [True, True]]
    assert [one.n_readings for one in found.accuracy] == [3, 5, 4, 6]
    assert not any(one.reason for one in found.accuracy)


def test_a_set_cannot_be_better_than_one_that_holds_it(every):
    goals = np.array([one.goal for one in every.accuracy])
    for row, goal in zip(every.sets, goals, strict=True):
        larger = (row <= every.sets).all(axis=1)
        assert (goals[larger] <= goal * (1.0 + 1e-9)).all()


REFUSED = {
    "unknown": ('candidates = ["s", "cam_z"]', "sensor_selection: sensor 'cam_z':"),
    "twice": (
        'candidates = ["s", "height"]\nrequired_sensors = ["s"]',
        "found s\\[1\\] twice in candidates and required_sensors",
    ),
    "not told by all of them": ('candidates = ["cam_x", "cam_y"]', "found 2 readings, expected at least 3"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_faulty_choices_are_one_line(case, read):
    choice, message = REFUSED[case]
    with pytest.raises(InputError, match=message):
        read(choice)


def test_a_machine_without_a_tool_is_not_aligned(folder, refuse):
    source = folder / "linear_delta.py"
    lines = source.read_text().splitlines()
    source.write_text("\n".join(line for line in lines if "self.tool_channels" not in line))
    calibrations.change(folder / "audit.toml", "seed = 4", 'seed = 4\naccuracy_frame = "base"')
    said = "accuracy_frame: found 'base' with tool"
    refuse(said, folder / "out", "run", folder / "audit.toml", "--quiet")


def test_exchanged_poses_tell_more_and_curves_fall(read):
    size = {}
    for method in ("greedy", "exchange"):
        inputs = read(ALL, ("candidates = 30", f'candidates = 30\nmethod = "{method}"'))
        plan = inputs.plans["both"]
        found = select_poses(inputs.config, plan.variant, plan.posterior, plan.expected)
        size[method] = np.linalg.norm(found.curve, axis=1)
        np.testing.assert_allclose(found.after[-1], found.curve[-1], rtol=1e-9)
        assert (np.diff(size[method]) < 0.0).all()
        assert (np.linalg.norm(found.random, axis=1) > size[method]).all()
        assert len(np.unique(found.pose, axis=0)) == 4
    assert (size["exchange"] <= size["greedy"] * (1.0 + 1e-9)).all()
    assert size["exchange"][-1] < 0.8 * size["greedy"][-1]
