"""Held-back readings: none is dropped in silence, and the tool is judged where an instrument sees it."""

from __future__ import annotations

from dataclasses import replace

import calibrations
import numpy as np
import pandas as pd
import pytest

from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.page.errors import state_held_back
from bayescal.experiments.study.page.results import StudyResults
from bayescal.experiments.study.readings import split_verification, tabulate_lost, tabulate_predictions

HEADER = "pose,use,s_1_mm,s_2_mm,s_3_mm,cam_x_mm,cam_y_mm,height_mm"


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """The linear delta; three readings are left at the held-back pose V01, for three unknowns."""
    path = calibrations.write_delta(tmp_path_factory.mktemp("held"))
    table = path.parent / "data" / "readings.csv"
    lines = table.read_text().splitlines()
    assert HEADER in lines
    place = next(k for k, line in enumerate(lines) if line.startswith("V01,"))
    cells = lines[place].split(",")
    cells[3] = cells[4] = cells[5] = ""
    lines[place] = ",".join(cells)
    table.write_text("\n".join(lines) + "\n")
    return StudyInputs.load(load_experiment(path), path.parent)


@pytest.fixture(scope="module")
def held(inputs):
    """Its first variant and what is said of its held-back poses."""
    return predict(inputs)


def predict(inputs):
    """Return the first variant and its held-back poses by draws of machines near nominal."""
    variant = inputs.variants["all"]
    known = 0.2 * np.random.default_rng(1).standard_normal((40, variant.posterior().n_parameters))
    return variant, split_verification(inputs, ("all", 0), (variant.posterior(), known))


def make_study(lost, predictions, tool):
    """Return results as far as statements about held-back readings read them."""
    tables = {"not_predicted": lost, "predictions": predictions, "tool_predictions": tool}
    summary = {
        "variants": {"all": {"title": "all", "log_evidence": 0.0, "log_evidence_se": 0.0, "converged": True}},
        "rankings": [["all"]],
    }
    summary["variants"]["all"] |= {"n_parameters": 3}
    return StudyResults(summary, {}, {name: table for name, table in tables.items() if len(table)})


def tabulate(variant, held):
    predictions, of_tool = (tabulate_predictions(variant, [held], only) for only in (False, True))
    return tabulate_lost(variant, [held]), predictions, of_tool


def test_every_held_back_reading_has_a_prediction_or_a_reason(held):
    variant, found = held
    lost, predictions, _ = tabulate(variant, found)
    taken = variant.data.pick(variant.verification).present
    assert len(lost) + len(predictions) == taken.sum()
    assert list(zip(lost["pose"], lost["channel"], lost["reason"], strict=True)) == [
        ("V01", channel, "2 other readings for 3 coordinates") for channel in ("s[1]", "cam_y", "height")
    ]


def test_the_page_says_which_have_none_and_over_how_many_its_figures_are(held):
    found = state_held_back(make_study(*tabulate(*held)))
    (lost,) = (one for one in found if one.value == 3.0)
    assert all(f"{name} of V01" in lost.text for name in ("s[1]", "cam_y", "height"))
    assert any(" of 12 " in one.text for one in found)


def test_the_tool_is_predicted_by_the_machines_own_readings_alone(inputs, held):
    """What is read along other axes makes no difference to it; to predictions from all other readings it does."""
    _, by_all, tool = tabulate(*held)
    assert set(tool["channel"]) == {"cam_x", "cam_y", "height"}
    assert set(tool["pose"]) == {"V02", "V03", "V04", "V05"}  # of V01 the machine itself has one reading
    variant = inputs.variants["all"]
    height = variant.data.values.copy()
    height[:, variant.model.names.index("height")] += 1.0
    moved = replace(variant, data=replace(variant.data, values=height))
    _, other, other_tool = tabulate(*predict(replace(inputs, variants={"all": moved})))
    for one, two, same in ((tool, other_tool, True), (by_all, other, False)):
        first, second = (table[table["channel"] == "cam_x"]["mean"].to_numpy() for table in (one, two))
        assert np.allclose(first, second, atol=1e-6) == same


@pytest.mark.parametrize(
    ("inside", "n_poses", "level"),
    [(1.0, 10, "good"), (1.0, 60, "warning"), (0.7, 10, "good"), (0.5, 10, "warning"), (0.75, 60, "warning")],
)
def test_readings_of_a_pose_count_as_one_trial(inside, n_poses, level):
    """Six of each: 60 of 60 at ten poses are as rare as ten of ten, one time in three."""
    poses = np.repeat([f"V{k}" for k in range(n_poses)], 6)
    right = np.arange(6 * n_poses) < 6 * n_poses * inside
    rows = pd.DataFrame({"variant": "all", "pose": poses, "channel": "s", "in_interval_90": right, "external": False})
    (said,) = state_held_back(make_study(pd.DataFrame(), rows, pd.DataFrame()))
    assert said.level == level


@pytest.mark.parametrize(("inside", "level"), [(0.9, "good"), (0.7, "warning"), (1.0, "warning")])
def test_coverage_at_the_tool_has_its_binomial_range(inside, level):
    poses = [f"V{k // 2}" for k in range(100)]
    right = np.arange(100) < 100 * inside
    tool = pd.DataFrame({"variant": "all", "pose": poses, "channel": "x", "in_interval_90": right})
    (said,) = state_held_back(make_study(pd.DataFrame(), pd.DataFrame(), tool))
    assert (said.level, said.value) == (level, inside)
