"""Whether a calibration by poses, points or targets still holds: an arm of three joints, planned and judged."""

from __future__ import annotations

import shutil

import numpy as np
import pandas as pd
import pytest
import studies

from bayescal.calibrated.verify.plan import list_trackers
from bayescal.experiments.shared.calibrating import load_calibrated
from bayescal.numerics.geometry import matrix_from_rotation_vector

pytestmark = pytest.mark.runs

MACHINE = """kind = "arm"
name = "small"
title = "A small arm"
[machine]
joints = [
  { d_mm = 300.0, alpha_deg = 90.0, range_deg = [-120.0, 120.0] },
  { a_mm = 250.0, range_deg = [10.0, 100.0] },
  { a_mm = 200.0, range_deg = [-110.0, -20.0] },
]
"""
COMMON = """seed = 3
machine = "machine.toml"
provenance = { status = "simulated", text = "for the tests" }
[sensors]
joint = { noise_arcsec = 5.0 }
[parameters]
offset = { prior = "normal", sd = 0.2 }
"""
SIMULATION = f"""kind = "simulation"
name = "arm_data"
title = "An arm that an instrument sees"
n_poses = 20
{COMMON}
"""
STUDY = f"""kind = "study"
name = "arm"
title = "An arm that an instrument sees"
{COMMON}
[model_error]
terms = []
[[variants]]
name = "all"
"""
FRAME_OF_BASE = "frames.base = [{ position_mm = [100.0, -20.0, 3.0], rotation_deg = [0.0, 0.0, 30.0] }]"
SEEN_BY = {
    "poses": f"""[instrument]
kind = "poses"
position_um = 20.0
orientation_arcsec = 20.0
{FRAME_OF_BASE}
""",
    "points": f"""[instrument]
kind = "points"
probe = "probe.csv"
range_um = 10.0
azimuth_arcsec = 2.0
elevation_arcsec = 2.0
{FRAME_OF_BASE}
""",
    "targets": """[noise]
target_um = 15.0
[targets]
base = [{ count = 6, radius_mm = 400.0, height_mm = 0.0 }]
platform = [{ count = 6, radius_mm = 60.0, height_mm = 30.0 }]
[measurement_frame]
distance_mm = 5.0
angle_deg = 0.1
""",
}
MEASURED = {
    "poses": """
[[data]]
kind = "poses"
file = "data/poses.csv"
actuators = "data/actuators.csv"
frames.base = { position = 300.0, rotation = 60.0 }
""",
    "points": """
[[data]]
kind = "points"
file = "data/points.csv"
probe = "probe.csv"
actuators = "data/actuators.csv"
range_um = 10.0
azimuth_arcsec = 2.0
elevation_arcsec = 2.0
frames.base = { position = 300.0, rotation = 60.0 }
""",
    "targets": """
[[data]]
kind = "targets"
file = "data/targets.csv"
reference = "data/target_reference.csv"
actuators = "data/actuators.csv"
target_noise_um = 15.0
""",
}
PROBE = "point,x_mm,y_mm,z_mm\nA,50,0,0\nB,-30,40,0\nC,0,-40,20\n"
COORDINATES = ["x_mm", "y_mm", "z_mm"]
SEEN = [*COORDINATES, "rx_deg", "ry_deg", "rz_deg"]
NOISE = np.array([0.02] * 3 + [np.radians(20.0 / 3600.0)] * 3)
FRAME = {"base_x": 100.0, "base_y": -20.0, "base_z": 3.0, "base_rx": 0.0, "base_ry": 0.0, "base_rz": np.radians(30.0)}
OPTIONS = {"poses": ["--position-um", 20, "--orientation-arcsec", 20]}


def see_targets(reference, names, position, rotation, rng):
    """Return a table of targets that cameras see, whose frame wanders from pose to pose."""
    parts = []
    for name, at, turned in zip(names, position, rotation, strict=True):
        camera = matrix_from_rotation_vector(0.01 * rng.standard_normal(3))
        places = reference[COORDINATES].to_numpy()
        places = np.where((reference["body"] == "base").to_numpy()[:, None], places, at + places @ turned.T)
        seen = places @ camera.T + 0.015 * rng.standard_normal(places.shape)
        parts.append(reference[["body", "target"]].assign(pose=name, **dict(zip(COORDINATES, seen.T, strict=True))))
    return pd.concat(parts)


@pytest.fixture(scope="module", params=["poses", "points", "targets"])
def kind(request):
    return request.param


@pytest.fixture(scope="module")
def folder(tmp_path_factory, kind):
    found = tmp_path_factory.mktemp("arm")
    configs = {"machine": MACHINE, "simulate": SIMULATION + SEEN_BY[kind], "study": STUDY + MEASURED[kind]}
    for name, text in configs.items():
        (found / f"{name}.toml").write_text(text)
    (found / "probe.csv").write_text(PROBE)
    (found / "data").mkdir()
    for name, text in studies.simulate(found / "simulate.toml").files.items():
        (found / "data" / name).write_text(text)
    return found


@pytest.fixture
def results(folder, call):
    if not (folder / "out").is_dir():
        code, *said = call("run", folder / "study.toml", "--out", folder / "out", "--workers", 1)
        assert code == 0, said
    return folder / "out"


def measure(folder, kind, plan, shift, rng, in_part=False):
    """Write what the instrument sees of the true arm at the poses of a plan, a parameter shifted."""
    calibrated = load_calibrated(folder / "out", with_instruments=True)
    model, (tracker,) = calibrated.model, list_trackers(calibrated)
    true = pd.read_csv(folder / "data" / "true_parameters.csv", comment="#").set_index("parameter")["value"]
    frame = {} if kind == "targets" else FRAME
    theta = np.array([{**true, **frame}.get(name, 0.0) for name in model.layout.names])
    for name, size in shift.items():
        theta[model.layout.names.index(name)] += size
    table = pd.read_csv(plan, comment="#")
    commands = table[[f"joint_{k}_rad" for k in (1, 2, 3)]].to_numpy()
    pose, found = model.locate(theta, commands)
    assert found.all()
    seen = model.read(theta, pose)[:, model.instrument_places[tracker]]
    if kind == "points":
        seen = (seen + 0.01 * rng.standard_normal(seen.shape)).reshape(-1, 3, 3)
        rows = [
            (name, point, *at)
            for name, one in zip(table["pose"], seen, strict=True)
            for point, at in zip("ABC", one, strict=True)
        ]
        written = pd.DataFrame(rows, columns=["pose", "point", *COORDINATES]).assign(sd_um=10.0)
    elif kind == "targets":
        reference = pd.read_csv(folder / "data" / "target_reference.csv", comment="#")
        written = see_targets(reference, table["pose"], seen[:, :3], matrix_from_rotation_vector(seen[:, 3:]), rng)
    else:
        seen = (seen + NOISE * rng.standard_normal(seen.shape)) * [1.0, 1.0, 1.0, *np.degrees([1.0, 1.0, 1.0])]
        written = pd.DataFrame(seen, columns=SEEN).iloc[:, : 3 if in_part else 6]
        written.insert(0, "pose", table["pose"])
    path = plan.with_name("session.csv")
    written.to_csv(path, index=False)
    return path


@pytest.mark.parametrize("in_part", [False, True], ids=["whole", "positions"])
def test_a_shifted_joint_is_found(results, folder, kind, call, tmp_path, rng, in_part):
    if in_part and kind != "poses":
        pytest.skip("only a table of poses may have positions alone")
    noise = OPTIONS.get(kind, [])[: 2 if in_part else None]
    plan, options = tmp_path / "plan.csv", ["--parameters", "offset", "--shift-arcsec", 120]
    code, _, error = call("verify", results, *noise, *options, "--out", plan)
    assert code == 0, error
    rows = pd.read_csv(plan, comment="#")
    assert 1 <= len(rows) <= 10
    judged = ["--actuators", plan, *noise, "--parameters", "offset"]
    holds = measure(folder, kind, plan, {}, rng, in_part)
    assert call("verify", results, "--measured", holds, *judged)[1].startswith("the calibration holds")
    moved = measure(folder, kind, plan, {"offset[2]": np.radians(0.1)}, rng, in_part)
    assert call("verify", results, "--measured", moved, *judged)[1].startswith("offset[2] shifted by +3")


def test_a_plan_says_what_is_measured(results, kind, call, tmp_path):
    assert (
        call("verify", results, *OPTIONS.get(kind, []), "--parameters", "offset", "--out", tmp_path / "plan.csv")[0]
        == 0
    )
    said = {"poses": "tool pose, instrument frame", "points": "pose, station, point", "targets": "pose, body, target"}
    assert said[kind] in (tmp_path / "plan.csv").read_text()


def test_the_noise_of_a_table_plans_as_the_study_that_read_it(results, folder, kind, call, tmp_path):
    options, own = ["--parameters", "offset", "--out"], folder / "data" / f"{kind}.csv"
    assert call("verify", results, "--noise-from", own, *options, tmp_path / "a.csv")[0] == 0
    assert call("verify", results, *options, tmp_path / "b.csv")[0] == 0
    one, other = (pd.read_csv(tmp_path / name, comment="#") for name in ("a.csv", "b.csv"))
    pd.testing.assert_frame_equal(one, other)


def test_tables_of_another_kind_are_refused(results, folder, kind, call, tmp_path):
    other = {"poses": "points", "points": "poses", "targets": "points"}[kind]
    columns = {
        "points": "pose,point,x_mm,y_mm,z_mm,sd_um\nC001,A,1,2,3,10",
        "poses": "pose,x_mm,y_mm,z_mm,sd_x_um,sd_y_um,sd_z_um\nC001,1,2,3,9,9,9",
    }
    path = tmp_path / "today.csv"
    path.write_text(f"{columns[other]}\n")
    (tmp_path / "plan.csv").write_text("pose,use,joint_1_rad,joint_2_rad,joint_3_rad\nC001,calibration,0.1,0.7,-1.5\n")
    code, _, error = call("verify", results, "--measured", path, "--actuators", tmp_path / "plan.csv")
    assert code == 2
    assert f"found {other}, expected" in error
    assert "as in the calibration" in error


def test_noise_of_poses_is_no_noise_of_points(results, kind, call, tmp_path):
    if kind != "points":
        pytest.skip("poses have noise of poses, and targets tell poses")
    path = tmp_path / "like.csv"
    path.write_text(
        "pose,joint_1_rad,joint_2_rad,joint_3_rad,x_mm,y_mm,z_mm,sd_x_um,sd_y_um,sd_z_um\nC001,0,1,-1,1,2,3,9,9,9\n"
    )
    code, _, error = call("verify", results, "--noise-from", path)
    assert code == 2
    assert "found poses, expected points as in the calibration" in error


def test_an_instrument_of_another_name_is_refused(results, call):
    code, _, error = call("verify", results, "--instrument", "left")
    assert code == 2
    assert "--instrument: found 'left'" in error


def test_noise_that_nobody_states_is_asked_for(results, kind, call, tmp_path):
    shutil.copytree(results, tmp_path / "out")
    shutil.rmtree(tmp_path / "out" / "inputs")
    code, _, error = call("verify", tmp_path / "out", "--allow-changed-files")
    assert code == 2
    assert ("found no inputs" if kind == "points" else "--position-um") in error  # where points are is in the inputs


def test_of_several_instruments_one_is_named(folder, kind, call, tmp_path):
    """Two tables of poses whose actuators are in a table of readings, one of which is verified by."""
    if kind != "poses":
        pytest.skip("two tables of poses")
    for name in ("machine.toml", "data"):
        copy = shutil.copytree if (folder / name).is_dir() else shutil.copy
        copy(folder / name, tmp_path / name)
    table = MEASURED["poses"].replace('actuators = "data/actuators.csv"\n', "")
    tables = [table.replace('kind = "poses"', f'kind = "poses"\nname = "{name}"') for name in ("left", "right")]
    tables[1] = tables[1].replace("poses.csv", "right.csv")
    other = pd.read_csv(tmp_path / "data" / "poses.csv", comment="#")
    noise = NOISE * np.random.default_rng(1).standard_normal((len(other), 6))
    other[SEEN] += noise * [1.0, 1.0, 1.0, *np.degrees([1.0, 1.0, 1.0])]
    other.to_csv(tmp_path / "data" / "right.csv", index=False)
    readings = '\n[[data]]\nfile = "data/actuators.csv"\n'
    (tmp_path / "study.toml").write_text(STUDY + readings + "".join(tables))
    ran = call("run", tmp_path / "study.toml", "--out", tmp_path / "out", "--workers", 1, "--effort", "quick")
    assert ran[0] == 0, ran
    code, _, error = call("verify", tmp_path / "out", "--allow-unconverged")
    assert code == 2
    assert "found instruments left and right, expected one: --instrument NAME" in error
    chosen = ["--allow-unconverged", "--instrument", "right"]
    code, said, error = call("verify", tmp_path / "out", *chosen, "--parameters", "offset", "--shift-arcsec", 300)
    assert (code, "\nR01," in said) == (0, True), error
    session = ["--measured", tmp_path / "data" / "right.csv", "--actuators", tmp_path / "data" / "actuators.csv"]
    assert call("verify", tmp_path / "out", *chosen, *session)[1].startswith("the calibration holds")
