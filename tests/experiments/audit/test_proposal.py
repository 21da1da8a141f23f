"""Poses that an audit proposes: better than the planned ones, and aware of errors that are functions of the pose."""

from __future__ import annotations

from dataclasses import replace

import audit_problems as problems
import numpy as np
import pytest
import tiny_experiments

from bayescal.experiments.audit import audit as audit_module
from bayescal.experiments.audit.audit import evaluate_plan, list_changes, run_audit
from bayescal.experiments.audit.design import load_audit, read_plans
from bayescal.experiments.audit.proposal import propose
from bayescal.experiments.audit.results import summarise
from bayescal.experiments.runner.parallel import Run

pytestmark = pytest.mark.runs
DELTA = tiny_experiments.SHIPPED.parent / "examples" / "own_machine" / "audit.toml"


@pytest.fixture(scope="module")
def camera():
    return problems.read_shipped("camera_hexapod", sweep=problems.SHORT_SWEEP).without_systematic_errors()


def judge(plan):
    """Return the largest predicted deviation as a share of its limit."""
    found = evaluate_plan("", plan, plan.forecast()).required_sd
    return max(found[one.name] / one.limit for one in plan.requirements)


@pytest.mark.parametrize("name", ["telescope_six_pus_none", "camera_hexapod"])
def test_proposed_poses_are_better_where_nothing_errs_but_by_noise(name):
    plan = problems.read_shipped(name).without_systematic_errors()
    said, proposed = propose(plan)
    _, again = propose(plan)
    assert said.startswith("40 poses")
    assert np.array_equal(again.variant.start, proposed.variant.start)
    assert proposed.n_poses == plan.n_poses
    assert not proposed.is_beyond_range
    assert judge(proposed) < 0.95 * judge(plan)


def test_any_machine_has_proposed_poses():
    config = load_audit(DELTA).model_copy(update={"accuracy_frame": "base"})
    plan = read_plans(config, DELTA.parent)["both"]
    _, proposed = propose(plan)
    assert judge(proposed) < 0.9 * judge(plan)


def test_proposed_poses_tell_of_systematic_errors():
    """Those that noise alone asks for make the tool worse, when legs err by functions of the pose."""
    plan = problems.read_shipped("m2_hexapod", accuracy_frame="base")
    assert plan.sizes
    (_, better), (_, blind) = propose(plan), propose(plan.without_systematic_errors())
    chosen = problems.take_poses(blind)
    assert judge(better) < min(judge(plan), judge(plan.replan(chosen)))


def test_a_tool_that_own_sensors_do_not_determine_has_no_proposal():
    plan = read_plans(load_audit(DELTA), DELTA.parent)["both"]
    section = plan.section.model_copy(update={"sensors": ["cam_x", "cam_y", "height"]})
    assert propose(plan.replan(problems.take_poses(plan), section)) is None


def test_audits_list_proposed_poses_last(camera, monkeypatch):
    """Everything else stays as it is without them."""
    proposed = run_audit(camera, Run())
    monkeypatch.setattr(audit_module, "propose", lambda plan: None)
    plain = run_audit(camera, Run())
    change = proposed.scenarios[-1]
    assert [one.name for one in proposed.scenarios[:-1]] == [one.name for one in plain.scenarios]
    assert [one.name for one in plain.scenarios] == [one.name for one in list_changes(camera)]
    assert (change.n_poses, change.beyond_range) == (40, False)
    said, before = summarise(proposed), summarise(plain)
    for one in (*said["directions"], *before["directions"]):  # the proposal may be what helps a direction most
        one.pop("best_scenario", None)
    assert {**said, "scenarios": said["scenarios"][:-1]} == before


def test_without_requirements_all_components_count(camera):
    _, proposed = propose(replace(camera, requirements=()))
    assert judge(replace(proposed, requirements=camera.requirements)) < judge(camera)
