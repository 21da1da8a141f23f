"""Cameras, probes on planes and sockets beside machines that others made: simulated, found and recovered; refusals."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import calibrations
import numpy as np
import pandas as pd
import pytest
import studies

from bayescal.experiments.audit.design import draw_plan, load_audit, read_design, read_plans
from bayescal.experiments.audit.planned import PlannedPoses
from bayescal.experiments.audit.proposal import propose
from bayescal.experiments.audit.schema import PlannedPosesConfig, ScenarioConfig
from bayescal.experiments.runner.load import load, load_experiment
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.shared.calibrating import load_calibrated
from bayescal.experiments.shared.readings.inputs import read_inputs
from bayescal.experiments.simulation.compute import read_model
from bayescal.identifiability.reading_rows import see
from bayescal.inference.mode import find_modes
from bayescal.machines.readings.newton import touch

ARM, DELTA = studies.EXPERIMENTS / "ur10" / "machine.toml", studies.EXPERIMENTS.parent / "examples" / "own_machine"
COMMON = """name = "{kind}_of_it"
title = "An instrument beside a machine"
seed = 4
machine = "machine.toml"
"""
SIMULATION = """kind = "simulation"
provenance = {{ status = "simulated", text = "drawn within its tolerances" }}
n_poses = 24
fixed = [{fixed}]
{common}{stated}{sensors}
[parameters]
{own}{frames}"""
STUDY = """kind = "study"
provenance = {{ status = "simulated", text = "drawn within its tolerances" }}
data = [{{ file = "data/readings.csv" }}]
model_error = {{ terms = [] }}
variants = [{{ name = "all", title = "All", fixed = [{fixed}] }}]
{common}{found}{sensors}
[parameters]
{own}"""
ZEROS = 'offset = { prior = "normal", sd = 0.2 }\n'  # degrees
JOINTS = "joint = { noise_arcsec = 10.0 }\n"
CAMERA = """[instruments.eye]
kind = "camera"
mounted = "{}"
"""
LOOKING = """frame_mm = [700.0, 300.0, -50.0]
frame_deg = [80.0, -70.0, 60.0]
target_mm = [20.0, 65.0, 40.0]
target_deg = [-20.0, 100.0, 60.0]
"""  # both turned by more than a third of a turn
BED = """[instruments.bed]
kind = "plane"
normal = [0.0, 0.2, 1.0]
"""
CASES = {
    "eye to hand": (ARM, CAMERA.format("base"), LOOKING, '"offset[1]", "offset[6]"', "eye"),
    "eye in hand": (ARM, CAMERA.format("tool"), LOOKING, '"offset[1]", "offset[6]"', "eye"),
    "probe": (
        ARM,
        BED + 'target_mm = "found"\n',
        "tilt_deg = [70.0, -40.0]\noffset_mm = 210.0\ntarget_mm = [10.0, -20.0, 90.0]\n",
        '"offset[1]", "offset[6]"',
        "bed",
    ),
    "bed of a delta": (DELTA, BED, "tilt_deg = [9.0, 4.0]\noffset_mm = -3.0\n", "", "bed"),
}
OWN_DELTA = 's0 = { prior = "normal", sd = 0.3 }\nl = { prior = "normal", sd = 0.3 }\n'


def write(folder, case):
    """Write a machine with an instrument, what it reads, and a study that states no frame; return the study."""
    machine, section, stated, fixed, name = CASES[case]
    source = machine if machine.is_dir() else machine.parent
    for one in (*source.glob("*.py"), source / "machine.toml"):
        shutil.copy(one, folder)
    own, joints = (ZEROS, JOINTS) if machine == ARM else (OWN_DELTA, "s = { noise_um = 5.0 }\n")
    sensors = f"[sensors]\n{joints}" + (
        '"eye[x]" = { noise_um = 50.0 }\n"eye[y]" = { noise_um = 50.0 }\n"eye[z]" = { noise_um = 80.0 }\n'
        "eye_r = { noise_deg = 0.02 }\n"
        if name == "eye"
        else "bed = { noise_um = 10.0 }\n"
    )
    section_stated = "\n".join(line for line in section.splitlines() if "found" not in line) + "\n" + stated
    frames = 'eye_scale = { prior = "normal", sd = 0.002 }\n' if name == "eye" else ""
    common = COMMON.format(kind=name)
    texts = {"common": common, "sensors": sensors, "own": own + frames, "fixed": fixed}
    (folder / "simulate.toml").write_text(SIMULATION.format(stated=section_stated, frames="", **texts))
    (folder / "study.toml").write_text(STUDY.format(found=section, **texts))
    studies.write_texts(folder / "data", studies.simulate(folder / "simulate.toml").files)
    return folder / "study.toml"


def blank(path, some, every=5):
    """Leave out some columns of readings in a row out of a few, and one of them in another."""
    table = pd.read_csv(path, comment="#")
    columns = [one for one in table.columns if one.startswith(some)]
    table.loc[::every, columns] = np.nan
    table.loc[3, columns[0]] = np.nan
    table.to_csv(path, index=False)


@pytest.mark.parametrize("case", CASES)
def test_frames_that_nobody_states_are_recovered_with_the_machine(case, tmp_path):
    path = write(tmp_path, case)
    blank(path.parent / "data" / "readings.csv", CASES[case][-1])
    true = pd.read_csv(tmp_path / "data" / "true_parameters.csv", comment="#").set_index("parameter")["value"]
    posterior = read_inputs(load(path)[1], tmp_path).variants["all"].posterior().with_pose_guesses()
    best = find_modes(posterior)[0].y
    _, hessian = posterior.gradient(best)
    sd = posterior.prior_sd * np.sqrt(np.diagonal(np.linalg.inv(-hessian)))
    names = posterior.names
    z = (posterior.natural(best[None])[0] - true[list(names)]) / sd
    assert len(names) >= 8
    assert (np.abs(z) < 4.0).all()
    of_instrument = np.array([one.startswith(CASES[case][-1]) for one in names])
    assert (sd < 0.3 * posterior.prior_sd)[of_instrument].all()


# --- contact ---------------------------------------------------------------------------------------------------------


PLACES = {"ball": [-300.0, 500.0, 400.0], "bowl": [300.0, 500.0, 500.0]}
SOCKETS = "".join(f'[instruments.{name}]\nkind = "socket"\nplace_mm = {place}\n' for name, place in PLACES.items())
TOUCHED = """[instruments.bed]
kind = "plane"
tilt_deg = [3.0, -2.0]
offset_mm = 500.0
"""


def write_touching(folder):
    """Write a simulation of an arm whose tool comes into two sockets and onto a plane; return its config."""
    shutil.copy(ARM, folder)
    sensors = (
        f"[sensors]\n{JOINTS}ball = {{ noise_um = 30.0 }}\nbowl = {{ noise_um = 30.0 }}\nbed = {{ noise_um = 10.0 }}\n"
    )
    common = COMMON.format(kind="touch")
    path = folder / "simulate.toml"
    path.write_text(
        SIMULATION.format(common=common, stated=SOCKETS + TOUCHED, sensors=sensors, own=ZEROS, frames="", fixed="")
    )
    return path


@pytest.fixture
def touching(tmp_path):
    return write_touching(tmp_path)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Return the files that the simulation gives."""
    return studies.simulate(write_touching(tmp_path_factory.mktemp("touching"))).files


def test_simulated_tools_touch_one_instrument_each_and_it_reads_zero(touching, files, rng):
    studies.write_texts(touching.parent / "data", files)
    table, pose, true = (
        pd.read_csv(touching.parent / "data" / f"{name}.csv", comment="#")
        for name in ("readings", "true_poses", "true_parameters")
    )
    parts = [table.filter(regex=f"^{name}_") for name in ("ball", "bowl", "bed")]
    there = np.stack([one.notna().all(axis=1) for one in parts], axis=1)
    np.testing.assert_array_equal(there, np.arange(3) == np.arange(len(table))[:, None] % 3)
    assert all((one.dropna().to_numpy() == 0.0).all() for one in parts)
    assert "-0.000000" not in files["readings.csv"]
    machine = read_model(load_experiment(touching), touching.parent)
    read = machine.read(true["value"].to_numpy(), pose.filter(regex="^q").to_numpy())
    for name, one in zip(("ball", "bowl", "bed"), parts, strict=True):  # off by no more than the readings' noise
        off = np.linalg.norm(read[:, machine.select([name])], axis=1)[one.notna().all(axis=1)]
        assert 1e-3 < off.max() < 0.2


def test_what_the_tool_cannot_touch_is_said(touching, refuse):
    calibrations.change(touching, "[-300.0, 500.0, 400.0]", "[-3000.0, 500.0, 400.0]")
    said = "instruments.ball: found few poses of the workspace that touch it, expected it within reach"
    refuse(said, touching.parent / "out", "simulate", touching)


# --- plans that say who reads ----------------------------------------------------------------------------------------


AUDIT = """kind = "audit"
poses = {{ {poses} }}
model_error = {{ terms = [] }}
variants = [{{ sensors = ["joint", "ball", "bowl", "bed"], fixed = ["offset[1]", "offset[6]"] }}]
{common}{stated}
[sensors]
{joints}ball = {{ noise_um = 30.0 }}
bowl = {{ noise_um = 30.0 }}
bed = {{ noise_um = 10.0 }}
[parameters]
{own}ball_place = {{ prior = "normal", sd = 5.0 }}
bowl_place = {{ prior = "normal", sd = 5.0 }}
"""


@pytest.fixture
def planned(touching, files):
    """Return an audit of the same at poses of a file, which says who reads in a row, and the file."""
    studies.write_texts(touching.parent / "data", files)
    table = pd.read_csv(touching.parent / "data" / "true_poses.csv", comment="#")
    table["instruments"] = ["ball", "bowl", "bed"] * 8
    table.to_csv(touching.parent / "poses.csv", index=False)
    path = touching.parent / "audit.toml"
    path.write_text(
        AUDIT.format(
            poses='file = "poses.csv"',
            common=COMMON.format(kind="plan"),
            stated=SOCKETS + TOUCHED,
            joints=JOINTS,
            own=ZEROS,
        )
    )
    return path


def test_an_audit_takes_each_row_of_who_reads_there(planned, rng):
    (plan,) = read_plans(load_audit(planned), planned.parent).values()
    data, model = plan.variant.data, plan.variant.model
    there = np.stack([data.present[:, model.select([one])].all(axis=1) for one in ("ball", "bowl", "bed")], axis=1)
    np.testing.assert_array_equal(there, np.arange(3) == np.arange(24)[:, None] % 3)
    assert data.present[:, model.select(["joint"])].all()
    more = plan.change(ScenarioConfig(name="twice", poses_factor=2.0))
    np.testing.assert_array_equal(more.variant.data.present, np.tile(data.present, (2, 1)))
    assert plan.list_changes() == []  # other poses do not touch
    assert propose(plan) is None
    # what independent rows tell adds up: those of each instrument, planned by itself
    parts = [
        plan.replan(
            PlannedPoses(data.poses[k::3], plan.planned.pose[k::3], {}),
            plan.section.model_copy(update={"sensors": ["joint", name]}),
        )
        for k, name in enumerate(("ball", "bowl", "bed"))
    ]
    whole, *some = (see(one.posterior, one.expected).reshape(-1, len(plan.names)) for one in (plan, *parts))
    np.testing.assert_allclose(whole.T @ whole, sum(one.T @ one for one in some), rtol=1e-9, atol=1e-6)
    simulated, _ = plan.simulate(4, rng, range(len(plan.names)))  # by no reading that is not planned
    claimed = np.sqrt(np.diagonal(plan.inform().covariance))
    np.testing.assert_allclose(simulated.claimed.mean(axis=0), claimed, rtol=0.1)


def test_poses_that_are_drawn_touch_in_turn(planned):
    calibrations.change(planned, 'file = "poses.csv"', "count = 30")
    (plan,) = read_plans(load_audit(planned), planned.parent).values()
    data, model = plan.variant.data, plan.variant.model
    assert [int(data.present[:, model.select([one])[0]].sum()) for one in ("ball", "bowl", "bed")] == [10, 10, 10]
    touched = data.values[:, len(model.whole.channels) :]
    assert np.nanmax(np.abs(touched)) < 1e-6
    assert plan.change(ScenarioConfig(name="twice", poses_factor=2.0)).n_poses == 60


def test_a_measured_machine_touches_where_it_is_planned_to(tmp_path):
    path = write(tmp_path, "bed of a delta")
    audit = tmp_path / "audit.toml"
    audit.write_text(
        'kind = "audit"\nname = "a"\ntitle = "a"\nseed = 1\n'
        'data = { study = "study.toml" }\nposterior = { draws = 0 }\n'
    )
    plan, _ = draw_plan(read_design(load_audit(audit), path.parent), Run())
    again = plan.replan(plan.maker.plan(PlannedPosesConfig(count=9)))
    assert np.abs(again.variant.data.values[:, -1]).max() < 1e-6  # of the machine as it was found


PLANS = {
    "unknown": ("bowl\n", "cup\n", "poses.csv, line 3: instruments: found 'cup', expected some of ball, bowl, bed"),
    "both": ("bowl\n", "ball bowl\n", "poses: pose 'C002': found contact with ball and bowl, expected one, named in"),
    "far": ("bowl\n", "ball\n", "poses: pose 'C002': found it 608.6 mm off ball, expected contact"),
    "no column": (
        ",instruments\n",
        ",instrument\n",
        "poses.csv: found column 'instrument', did you mean 'instruments'?",
    ),
}


@pytest.mark.parametrize("case", PLANS)
def test_plans_that_no_tool_can_keep_are_refused(case, planned, refuse):
    old, new, said = PLANS[case]
    path = planned.parent / "poses.csv"
    path.write_text(path.read_text().replace(old, new, 1))
    refuse(said.replace("?", "\\?"), planned.parent / "out", "run", planned, "--quiet")


def test_poses_are_not_chosen_where_instruments_touch(planned, refuse):
    planned.write_text(planned.read_text() + "[selection]\ncount = 5\n")
    said = "selection: found instruments at some poses alone, expected all at each"
    refuse(said, planned.parent / "out", "run", planned, "--quiet")


@pytest.mark.runs
def test_what_to_measure_next_is_where_tools_touch(tmp_path, call):
    path, out = write(tmp_path, "bed of a delta"), tmp_path / "out"
    code, _, err = call("next-pose", path, "--out", out, "--require", "x=0.1", "--trust-code", "--quiet")
    assert code == 0, err
    table = pd.read_csv(out / "next_poses.csv")
    assert (table["touching"] == "bed").all()
    variant = read_inputs(load(path)[1], tmp_path).variants["all"]
    posterior = variant.posterior().with_pose_guesses()
    theta = posterior.theta(find_modes(posterior)[0].y[None])[0]
    height = variant.model.read(theta, table[["x_mm", "y_mm", "z_mm"]].to_numpy())[:, variant.model.names.index("bed")]
    np.testing.assert_allclose(height, height.mean(), atol=1e-3)  # mm, of the mode's machine; theirs is the mean's
    assert abs(height.mean()) < 0.03
    assert "bed is touched" in (out / "report.html").read_text()


@pytest.mark.runs
def test_a_calibration_by_touch_is_verified_where_tools_touch(tmp_path, call, rng):
    path = write(tmp_path, "bed of a delta")
    out = tmp_path / "out"
    code, _, err = call("run", path, "--out", out, "--workers", 1, "--quiet", "--trust-code")
    assert code == 0, err
    plan, options = tmp_path / "plan.csv", ("--trust-code", "--parameters", "s0", "--shift-um", 500)
    code, _, err = call("verify", out, *options, "--out", plan)
    assert code == 0, err
    machine = load_calibrated(out, with_instruments=True, trust=True)
    model, table = machine.model, pd.read_csv(plan, comment="#")
    commands, bed = table.filter(regex="^s_").to_numpy(), model.instrument_places["bed"]
    assert (table["instruments"] == "bed").all()
    pose, _ = model.locate(machine.theta, commands)
    np.testing.assert_allclose(model.read(machine.theta, pose)[:, bed], 0.0, atol=1e-5)  # digits of the plan
    for shift in (0.0, 1.0):
        theta = machine.theta + shift * (np.array(model.layout.names) == "s0[2]")
        pose, found = touch(
            model,
            theta,
            pose,
            np.ones((len(pose), len(model.channels)), dtype=bool),
            np.zeros((len(pose), len(model.channels))),
            {},
        )
        assert found.all()
        read = model.read(theta, pose)[:, machine.commanded] + 0.005 * rng.standard_normal(commands.shape)
        session = pd.DataFrame(read, columns=["s_1_mm", "s_2_mm", "s_3_mm"]).assign(bed_mm=0.0)
        session.assign(pose=table["pose"]).to_csv(tmp_path / "session.csv", index=False)
        code, judged, err = call("verify", out, *options, "--measured", tmp_path / "session.csv")
        assert code == 0, err
        assert judged.startswith("the calibration holds") == (not shift)
        found_shift, sd = map(float, re.search(r"s0\[2\]: (.+?) ± (.+?) µm", judged).groups())
        assert abs(found_shift - 1e3 * shift) < 5.0 * sd < 500.0  # few poses do not tell which one it is
    (tmp_path / "data" / "readings.csv").rename(tmp_path / "all.csv")
    pd.read_csv(tmp_path / "all.csv", comment="#").filter(regex="^(pose|s_)").to_csv(tmp_path / "c.csv", index=False)
    code, said, err = call("verify", out, "--trust-code", "--candidates", tmp_path / "c.csv", "--power", 0.5)
    assert (code, "use" in said) == (0, True), err


# --- what is refused -------------------------------------------------------------------------------------------------


def change_readings(change):
    """Return a function that changes a study's table of readings."""

    def act(path):
        table = pd.read_csv(path.parent / "data" / "readings.csv", comment="#")
        change(table)
        table.to_csv(path.parent / "data" / "readings.csv", index=False)

    return act


def mirror(table):
    table["eye_y_mm"] *= -1.0


def forget(table):
    table[[f"eye_r_{axis}_rad" for axis in "xyz"]] = np.nan


REFUSED = {
    "left-handed": (
        change_readings(mirror),
        "instruments.eye: readings are left-handed: check signs and order of x, y, z",
    ),
    "no orientation": (
        change_readings(forget),
        "instruments.eye: found 0 rows with position and rotation of the board, expected 3",
    ),
}


@pytest.fixture(scope="module")
def cameras(tmp_path_factory):
    """Return the study of an arm with a camera, on it and beside it."""
    return {name: write(tmp_path_factory.mktemp("camera"), name) for name in ("eye to hand", "eye in hand")}


@pytest.mark.parametrize("where", ["eye to hand", "eye in hand"])
@pytest.mark.parametrize("case", REFUSED)
def test_what_no_camera_sees_is_refused(case, where, cameras, tmp_path, refuse):
    path = Path(shutil.copytree(cameras[where].parent, tmp_path / "study")) / "study.toml"
    change, said = REFUSED[case]
    change(path)
    refuse(said, tmp_path / "out", "run", path, "--quiet")


def test_a_plane_faces_some_way(touching, refuse):
    calibrations.change(touching, "tilt_deg = [3.0", "normal = [0.0, 0.0, 0.0]\ntilt_deg = [3.0")
    refuse("instruments.bed: normal: found no direction", touching.parent / "out", "simulate", touching)
