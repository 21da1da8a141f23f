"""Arms in URDF files as projects: an audit that runs, configurations that reach a socket, options, what is refused."""

from __future__ import annotations

import tomllib

import calibrations
import numpy as np
import pandas as pd
import pytest
from refusals import line_of
from serial_arms import JOINTS, PANDA, SMALL, place_links, write_small

import bayescal as bc
from bayescal import load_machine
from bayescal.experiments.audit.audit import analyse
from bayescal.experiments.audit.design import load_audit, read_plans
from bayescal.importers import import_file

BALL = {"tip": "ball_link"}
NEAR = 1e-3  # mm


def begin(path, folder, options=None):
    """Write a file's project and return its folder."""
    folder.mkdir()
    for name, content in import_file(path, options).files.items():
        (folder / name).write_bytes(content)
    return folder


def find_tips(text, tip, names, folder):
    """Return configurations (P, n) and where a file's own link stands in them, mm (P, 3)."""
    table = pd.read_csv(folder / "configurations.csv", comment="#").select_dtypes("number")
    units = np.array([1e-3 if one.endswith("_mm") else 1.0 for one in table.columns])
    q = table.to_numpy()
    places = [place_links(text, dict(zip(names, row * units, strict=True)))[tip][:3, 3] for row in q]
    return q, 1e3 * np.array(places)


def test_a_ball_comes_to_its_socket_within_the_limits(tmp_path, call):
    folder = begin(PANDA, tmp_path / "arm", BALL)
    assert (folder / "panda.urdf").read_bytes() == PANDA.read_bytes()
    machine = tomllib.loads((folder / "machine.toml").read_text())
    assert machine["machine"] == {"urdf": "panda.urdf", "tip": "ball_link"}
    audit = tomllib.loads((folder / "audit.toml").read_text())
    names = [f"panda_joint{k}" for k in range(1, 8)]
    q, tips = find_tips(PANDA.read_text(), "ball_link", names, folder)
    assert len(q) == 40
    np.testing.assert_allclose(tips, np.tile(audit["instruments"]["socket"]["place_mm"], (40, 1)), rtol=0, atol=NEAR)
    low = np.array([-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973])
    high = np.array([2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973])
    assert ((q >= low) & (q <= high)).all()
    assert (np.ptp(q, axis=0) > 1.0).all()  # rad: configurations that differ
    code, _, err = call("validate", folder / "audit.toml")
    assert (code, err) == (0, "")


def test_two_sockets_whose_distance_is_known_tell_the_scale(tmp_path):
    one, two = (begin(PANDA, tmp_path / n, BALL | {"sockets": n}) for n in ("1", "2"))
    audit = tomllib.loads((two / "audit.toml").read_text())
    _, tips = find_tips(PANDA.read_text(), "ball_link", [f"panda_joint{k}" for k in range(1, 8)], two)
    seated = pd.read_csv(two / "configurations.csv", comment="#")["instruments"]
    assert seated.value_counts().to_dict() == {"socket_1": 20, "socket_2": 20}
    expected = [audit["instruments"][name]["place_mm"] for name in seated]
    np.testing.assert_allclose(tips, expected, rtol=0, atol=NEAR)

    def judge(folder):
        (plan,) = read_plans(load_audit(folder / "audit.toml"), folder).values()
        return len(plan.names) - analyse(plan).structure.rank, plan

    (lost_by_one, _), (lost_by_two, plan) = judge(one), judge(two)
    assert (lost_by_one, lost_by_two) == (8, 7)
    present = plan.variant.data.present[:, [plan.variant.model.names.index(f"socket_{k}[x]") for k in (1, 2)]]
    np.testing.assert_array_equal(present, seated.to_numpy()[:, None] == ["socket_1", "socket_2"])
    assert {one.name for one in plan.list_changes()} == set()  # other poses are in no socket


def test_a_tracker_sees_configurations_all_over_the_limits(tmp_path, call):
    folder = begin(write_small(tmp_path), tmp_path / "arm", {"instrument": "tracker"})
    q, _ = find_tips(SMALL, "flange", JOINTS, folder)
    low, high = np.array([-1.2, -100.0, -np.pi]), np.array([2.0, 350.0, np.pi])
    assert ((q >= low) & (q <= high)).all()
    assert (np.ptp(q, axis=0) > 0.7 * (high - low)).all()
    code, _, err = call("validate", folder / "audit.toml")
    assert (code, err) == (0, "")


@pytest.mark.parametrize("name", ['my "arm".urdf', "Arm 2 (new).urdf", "arm.v2.urdf"])
def test_any_name_of_a_file_makes_a_project(tmp_path, call, name):
    path = tmp_path / name
    path.write_text(SMALL)
    folder = begin(path, tmp_path / "arm", {"instrument": "tracker"})
    code, _, err = call("validate", folder / "audit.toml")
    assert (code, err) == (0, "")
    assert load_machine(path).channels[1].name == "joint[2]"


@pytest.mark.runs
def test_a_file_is_audited_as_it_is(tmp_path, call):
    code, said, _ = call("init", tmp_path / "arm", "--from", PANDA, "--option", "tip=ball_link")
    assert code == 0
    assert "7 joints from base to tip: panda_joint1, panda_joint2" in said
    assert "no readings in such a file: audit.toml says what they would determine" in said
    design = tmp_path / "arm" / "audit.toml"
    design.write_text(design.read_text() + calibrations.SHORT_SWEEP)
    code, said, _ = call("audit", design, "--out", tmp_path / "out", "--workers", 1)
    assert code == 0
    assert "determine 21 of 35 parameters; combinations: 8 structurally unidentifiable" in " ".join(said.split())


@pytest.mark.runs
@pytest.mark.usefixtures("no_pictures")
def test_a_file_becomes_a_calibrated_file_without_a_class(tmp_path):
    """What a user's script does, from the arm's file to the report and to the corrected file."""
    machine = load_machine(write_small(tmp_path))
    noise, tolerances = {"joint[1]": 1e-4, "joint[2]": 0.02, "joint[3]": 1e-4, "tracker": 0.02}, {"offset": 0.2}
    tracker = {"kind": "point", "target_mm": [30.0, 0.0, 40.0]}
    there = {"tracker": tracker | {"frame_mm": [2000.0, 0.0, 500.0], "frame_deg": [0.0, 0.0, 120.0]}}
    data = bc.simulate(machine, noise, tolerances, 15, instruments=there)
    options = {"instruments": {"tracker": tracker}, "model_error": {"terms": []}, "quiet": True}
    bc.calibrate(machine, data, tolerances, effort="quick", out=tmp_path / "results", **options)
    study = bc.load_results(tmp_path / "results", allow_unconverged=True)
    study.page(tmp_path / "report.html")
    study.best.export(tmp_path / "arm", "urdf")
    found, own = study.best.parameters.set_index("parameter")["mean"], machine.model.layout
    theta = np.array([found.get(name, nominal) for name, nominal in zip(own.names, own.nominal, strict=True)])
    corrected, q = load_machine(tmp_path / "arm" / "machine.urdf").model, np.array([[0.3, 50.0, -0.5]])
    (tool, there), (expected, _) = (
        (model.tool_values(at, model.locate(at, q)[0]), model.locate(at, q)[1])
        for model, at in ((corrected, corrected.layout.nominal), (machine.model, theta))
    )
    assert there.all()
    np.testing.assert_allclose(tool, expected, atol=1e-5)
    assert (tmp_path / "report.html").stat().st_size > 10_000


FAULTS = {
    "option": ({"tool": "x"}, "--option tool: found it, expected one of base, tip, instrument, sockets"),
    "sockets": ({"sockets": "3"}, "--option sockets: found '3' with socket, expected 1 or 2 with socket"),
    "sockets of a tracker": ({"instrument": "tracker", "sockets": "2"}, "found '2' with tracker, expected 1 or 2"),
    "instrument": ({"instrument": "camera"}, "--option instrument: found 'camera', expected socket or tracker"),
    "tip": ({"tip": "thumb"}, "tip: found no link 'thumb', expected one of floor"),
    "base": ({"base": "cellar"}, "base: found no link 'cellar', expected one of floor"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_other_options_are_refused_in_a_line(tmp_path, name):
    options, said = FAULTS[name]
    assert said in line_of(import_file, write_small(tmp_path), options)


FILES = {
    "leaves": (PANDA.read_text(), "tip: missing, expected one of "),
    "far": (
        SMALL.replace('xyz="0.4 0 0"', 'xyz="99 0 0"').replace("0.05 -0.1 0.4", "9 99 0"),
        "expected lengths in metres",
    ),
    "xacro": (SMALL.replace('<link name="floor"/>', "<xacro:arm/>"), "line 3: found <xacro:arm>, expected URDF"),
    "three joints": (SMALL, "configurations that reach it, expected 40, or --option instrument=tracker"),
    "text": ("<robot", "line 1: unclosed token, expected XML"),
}


@pytest.mark.parametrize("name", FILES)
def test_files_without_an_arm_are_refused_in_a_line(tmp_path, name):
    text, said = FILES[name]
    line = line_of(import_file, write_small(tmp_path, text))
    assert said in line


def test_nothing_is_written_of_a_file_that_is_refused(tmp_path, refuse_here):
    path = write_small(tmp_path, "<robot")
    assert "line 1: unclosed token" in refuse_here("init", tmp_path / "arm", "--from", path)
