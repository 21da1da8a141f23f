"""Whether a calibration by poses in an instrument's frame still holds: an arm of three joints, planned and judged."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import studies

from bayescal.calibrated.verify.plan import find_tracker
from bayescal.experiments.shared.calibrating import load_calibrated

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
[instrument]
kind = "poses"
position_um = 20.0
orientation_arcsec = 20.0
frames.base = [{{ position_mm = [100.0, -20.0, 3.0], rotation_deg = [0.0, 0.0, 30.0] }}]
"""
STUDY = f"""kind = "study"
name = "arm"
title = "An arm that an instrument sees"
{COMMON}
[[data]]
kind = "poses"
file = "data/poses.csv"
actuators = "data/actuators.csv"
frames.base = {{ position = 300.0, rotation = 60.0 }}
[model_error]
terms = []
[[variants]]
name = "all"
"""
SEEN = ["x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg"]
NOISE = np.array([0.02] * 3 + [np.radians(20.0 / 3600.0)] * 3)
FRAME = {"base_x": 100.0, "base_y": -20.0, "base_z": 3.0, "base_rx": 0.0, "base_ry": 0.0, "base_rz": np.radians(30.0)}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    found = tmp_path_factory.mktemp("arm")
    for name, text in {"machine": MACHINE, "simulate": SIMULATION, "study": STUDY}.items():
        (found / f"{name}.toml").write_text(text)
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


def measure(folder, plan, shift, rng, in_part):
    """Write what the instrument sees of the true arm at the poses of a plan, a parameter shifted."""
    machine = load_calibrated(folder / "out", with_instruments=True)
    true = pd.read_csv(folder / "data" / "true_parameters.csv", comment="#").set_index("parameter")["value"]
    theta = np.array([{**true, **FRAME}.get(name, 0.0) for name in machine.model.layout.names])
    for name, size in shift.items():
        theta[machine.model.layout.names.index(name)] += size
    table = pd.read_csv(plan, comment="#")
    commands = table[[f"joint_{k}_rad" for k in (1, 2, 3)]].to_numpy()
    pose, found = machine.model.locate(theta, commands)
    assert found.all()
    seen = machine.model.read(theta, pose)[:, machine.model.instrument_places[find_tracker(machine)]]
    seen = (seen + NOISE * rng.standard_normal(seen.shape)) * [1.0, 1.0, 1.0, *np.degrees([1.0, 1.0, 1.0])]
    written = pd.DataFrame(seen, columns=SEEN).iloc[:, : 3 if in_part else 6]
    path = plan.with_name("session.csv")
    pd.concat([table["pose"], written], axis=1).to_csv(path, index=False)
    return path


@pytest.mark.parametrize("in_part", [False, True], ids=["poses", "positions"])
def test_a_shifted_joint_is_found(results, folder, call, tmp_path, rng, in_part):
    plan, noise = tmp_path / "plan.csv", ["--position-um", 20, *([] if in_part else ["--orientation-arcsec", 20])]
    options = ["--parameters", "offset", "--shift-arcsec", 120]
    code, _, error = call("verify", results, *noise, *options, "--out", plan)
    assert code == 0, error
    rows = pd.read_csv(plan, comment="#")
    assert 1 <= len(rows) <= 10
    judged = ["--actuators", plan, *noise, "--parameters", "offset"]
    holds = measure(folder, plan, {}, rng, in_part)
    assert call("verify", results, "--measured", holds, *judged)[1].startswith("the calibration holds")
    moved = measure(folder, plan, {"offset[2]": np.radians(0.1)}, rng, in_part)
    assert call("verify", results, "--measured", moved, *judged)[1].startswith("offset[2] shifted by +3")


def test_the_noise_of_a_table_plans_as_the_same_stated(results, folder, call, tmp_path):
    options, stated = ["--parameters", "offset", "--out"], ["--position-um", 20, "--orientation-arcsec", 20]
    assert call("verify", results, "--noise-from", folder / "data" / "poses.csv", *options, tmp_path / "a.csv")[0] == 0
    assert call("verify", results, *stated, *options, tmp_path / "b.csv")[0] == 0
    one, other = (pd.read_csv(tmp_path / name, comment="#") for name in ("a.csv", "b.csv"))
    pd.testing.assert_frame_equal(one, other)


def test_noise_that_nobody_states_is_asked_for(results, call):
    code, _, error = call("verify", results)
    assert code == 2
    assert "--position-um" in error
