"""Files of calibrated arms, read by readers that know nothing of chains: URDF, and a UR's calibration file."""

from __future__ import annotations

import re
import tomllib
from xml.etree import ElementTree as Xml

import numpy as np
import pytest
from calibrated_readings import build_planned, calibrate
from refusals import line_of
from scipy.spatial.transform import Rotation
from serial_arms import JOINTS, PANDA, SMALL, place_links, write_small
from studies import EXPERIMENTS

from bayescal.calibrated.carried import describe_carried
from bayescal.calibrated.formats import export_machine
from bayescal.calibrated.machine import CommandErrors, Source, build_calibrated
from bayescal.machines.read import read_reading_model

NANOMETRE = 1e-6  # mm
SOURCE = Source("made_up", "all", "Simulated, never measured")
FRAMES = ("x", "y", "z", "rx", "ry", "offset", "tool", "tool_r")
UR10 = EXPERIMENTS / "ur10" / "machine.toml"
WRITTEN = re.compile(r"The file carries (\S+) of (\S+) mm of the tool's deviation, rms over the workspace(.*)")


def make_calibrated(path, rng, symbols=FRAMES, size=1.0):
    """Return an arm off nominal in some symbols, as a calibration might leave it, with its files."""
    model = read_reading_model(path)
    theta = model.layout.nominal.copy()
    free = np.concatenate([model.layout.index[one] for one in symbols])
    off = np.array([{"mm": 1.0, "rad": 0.005}.get(unit, 0.002) for unit in model.layout.units])
    theta[free] += size * (off * rng.standard_normal(len(off)))[free]
    n = len(model.commanded)
    errors = CommandErrors(np.zeros((n, n)), np.zeros(n))
    files = {one.name: one.read_bytes() for one in path.parent.iterdir() if one.is_file()}
    return build_calibrated(model, theta, None, errors, SOURCE, files=files, machine_file=path.name)


def write_machine(folder, text=SMALL, **keys):
    """Write a machine's file of the small arm and return its path."""
    write_small(folder, text)
    more = "".join(f'{key} = "{value}"\n' for key, value in keys.items())
    path = folder / "machine.toml"
    path.write_text(f'kind = "arm"\nname = "small"\ntitle = "Small"\n[machine]\nurdf = "small.urdf"\n{more}')
    return path


def draw_poses(model, rng, n=30):
    """Return poses (n, q) all over the workspace."""
    return model.home_pose + model.pose_scale * rng.uniform(-1.0, 1.0, (n, len(model.home_pose)))


def assert_tips(found, text, tip, names, rng, within=NANOMETRE):
    """Compare where a file's link stands with the tool of the calibrated machine, at what its commands read."""
    model, theta = found.model, found.theta
    pose = draw_poses(model, rng)
    commands = model.read(theta, pose)[:, model.select(model.commanded)]
    units = np.array([1e-3 if one.unit == "mm" else 1.0 for one in model.coordinates])
    tool, apart = model.tool_values(theta, pose), []
    for q, expected in zip(commands, tool, strict=True):
        there = place_links(text, dict(zip(names, q * units, strict=True)))[tip]
        apart.append(1e3 * there[:3, 3] - expected[:3])
        if within == NANOMETRE:
            np.testing.assert_allclose(there[:3, :3], Rotation.from_rotvec(expected[3:]).as_matrix(), atol=1e-9)
    assert np.sqrt((np.array(apart) ** 2).sum(axis=1).mean()) < within


def export_urdf(found, folder):
    """Return the text of a calibrated arm's URDF file, and what it says that it carries."""
    written = export_machine(found, folder, "urdf")
    return (folder / "machine.urdf").read_text(), describe_carried(written)[0]


def list_elements(text):
    """Return all that a file says but for origins of its joints: tags, attributes and texts, in order."""
    robot = Xml.fromstring(text)
    for one in robot.findall("joint"):
        for origin in one.findall("origin"):
            one.remove(origin)
    return [(one.tag, one.attrib, (one.text or "").strip()) for one in robot.iter()]


PANDA_JOINTS = tuple(f"panda_joint{k}" for k in range(1, 8))


def test_a_shipped_file_is_corrected(tmp_path, rng):
    found = make_calibrated(EXPERIMENTS / "panda_socket" / "machine.toml", rng)
    text, said = export_urdf(found, tmp_path)
    assert_tips(found, text, "ball_link", PANDA_JOINTS, rng)
    assert list_elements(text) == list_elements(PANDA.read_text())
    carried, of, rest = WRITTEN.match(said).groups()
    assert carried == of
    assert rest == ""


@pytest.mark.parametrize("tip", ["", "flange", "hand"])
def test_axes_slides_and_fixed_joints_are_corrected(tmp_path, rng, tip):
    """Beside a transmission, whose elements bear the joints' names; behind a tip that a joint moves is another link."""
    keys = {"tip": tip} if tip else {}
    found = make_calibrated(write_machine(tmp_path, **keys), rng)
    text, _ = export_urdf(found, tmp_path / "out")
    link = "hand_calibrated" if tip == "hand" else "flange"
    assert_tips(found, text, link, JOINTS, rng)
    if tip != "hand":
        assert list_elements(text) == list_elements(SMALL)
    assert 'mesh filename="package://small/column.stl" scale="1 1 1"' in text


def test_comments_and_missing_origins(tmp_path, rng):
    text = SMALL.replace('<origin xyz="0.4 0 0" rpy="1.5 0 -0.2"/>', "<!-- as drawn -->")
    found = make_calibrated(write_machine(tmp_path, text), rng)
    written, _ = export_urdf(found, tmp_path / "out")
    assert_tips(found, written, "flange", JOINTS, rng)
    assert "<!-- as drawn -->" in written


def test_a_chain_of_rows_is_a_robot(tmp_path, rng):
    found = make_calibrated(UR10, rng)
    text, _ = export_urdf(found, tmp_path)
    names = [one.name for one in found.model.machine.chain.joints]
    assert_tips(found, text, "tip", names, rng)
    limits = [
        (one.find("limit").get("lower"), one.find("limit").get("upper"))
        for one in list(Xml.fromstring(text).iter("joint"))[:6]
    ]
    assert all(float(low) == -np.pi and float(high) == np.pi for low, high in limits)


def test_it_is_read_again(tmp_path, rng):
    found = make_calibrated(EXPERIMENTS / "panda_socket" / "machine.toml", rng)
    export_urdf(found, tmp_path)
    path = tmp_path / "machine.toml"
    path.write_text(
        'kind = "arm"\nname = "again"\ntitle = "Again"\n[machine]\nurdf = "machine.urdf"\ntip = "ball_link"\n'
    )
    again = read_reading_model(path)
    pose = draw_poses(found.model, rng)
    there = again.tool_values(again.layout.nominal, pose)
    np.testing.assert_allclose(there, found.model.tool_values(found.theta, pose), rtol=0.0, atol=NANOMETRE)


@pytest.mark.parametrize("symbols", [("s1", "c1", "s2", "c2"), ("gain", "x", "offset"), ("k", "offset")])
def test_what_frames_do_not_hold_is_said(tmp_path, rng, symbols):
    found = make_calibrated(UR10, rng, symbols, 1.0 if "k" not in symbols else 5.0)
    if "k" in symbols:  # 1e-6 rad/(N m)
        found.theta[found.model.layout.index["k"]] = rng.uniform(10.0, 40.0, 6)
    text, said = export_urdf(found, tmp_path)
    carried, of, rest = WRITTEN.match(said).groups()
    left = float(re.match(r"; (\S+) mm are left", rest)[1])
    assert 0.0 < left < float(of)
    assert float(carried) == pytest.approx(float(of) - left, rel=0.1, abs=0.02)
    names = [one.name for one in found.model.machine.chain.joints]
    assert_tips(found, text, "tip", names, rng, within=1.6 * left)
    with pytest.raises(AssertionError):
        assert_tips(found, text, "tip", names, rng, within=0.6 * left)


# --- Denavit and Hartenberg's rows -----------------------------------------------------------------------------------

SCARA = EXPERIMENTS.parent / "examples" / "machines" / "scara.toml"


def place_rows(machine, q):
    """Return where the tip of a file's rows stands, mm (4, 4), at joints q, rad and mm."""

    def step(axis, angle=0.0, way=0.0):
        found = np.eye(4)
        found[:3, :3] = Rotation.from_euler(axis, angle, degrees=True).as_matrix()
        found["xyz".index(axis), 3] = way
        return found

    def frame(name):
        found = np.eye(4)
        found[:3, 3] = machine[f"{name}_mm"]
        found[:3, :3] = Rotation.from_rotvec(machine[f"{name}_deg"], degrees=True).as_matrix()
        return found

    here = frame("base")
    for row, value in zip(machine["joints"], q, strict=True):
        turn, slide = (0.0, value) if "range_mm" in row else (np.degrees(value), 0.0)
        along = step("z", row["theta_deg"] + turn, row["d_mm"] + slide)
        across = step("x", row["alpha_deg"], row["a_mm"])
        here = here @ (across @ along if machine["convention"] == "modified" else along @ across)
    return here @ frame("tip")


def export_rows(found, folder):
    """Return a calibrated arm's rows, and what their file says."""
    written = export_machine(found, folder, "dh")
    text = (folder / "dh.toml").read_text()
    return tomllib.loads(text)["machine"], describe_carried(written), text


def make_rows(name, rng, **how):
    """Return a calibrated arm of classical rows, of a URDF file, or one that slides."""
    paths = {"ur10": UR10, "panda": EXPERIMENTS / "panda_socket" / "machine.toml", "scara": SCARA}
    return make_calibrated(paths[name], rng, **how)


@pytest.mark.parametrize("name", ["ur10", "panda", "scara"])
def test_rows_place_the_tip(tmp_path, rng, name):
    found = make_rows(name, rng)
    machine, said, text = export_rows(found, tmp_path / "out")
    assert machine["convention"] == ("modified" if name == "panda" else "classical")
    pose = draw_poses(found.model, rng)
    again = read_reading_model(tmp_path / "out" / "dh.toml")
    there = again.tool_values(again.layout.nominal, pose)
    for q, tool, other in zip(pose, found.model.tool_values(found.theta, pose), there, strict=True):
        for position, rotation in (
            ((place := place_rows(machine, q))[:3, 3], place[:3, :3]),
            (other[:3], Rotation.from_rotvec(other[3:]).as_matrix()),
        ):
            np.testing.assert_allclose(position, tool[:3], rtol=0.0, atol=NANOMETRE)
            np.testing.assert_allclose(rotation, Rotation.from_rotvec(tool[3:]).as_matrix(), atol=1e-9)
    assert WRITTEN.match(said[0])[3] == ""
    assert "mm are left" in said[1]  # without the base
    assert ("are parallel to" in text) == (name != "panda")


@pytest.mark.parametrize("name", ["ur10", "scara"])
def test_rows_that_nothing_changed_are_those_stated(tmp_path, rng, name):
    found = make_rows(name, rng, size=0.0)
    machine, said, _ = export_rows(found, tmp_path / "out")
    stated = found.model.machine.config
    for row, one in zip(machine["joints"], stated.joints, strict=True):
        keys = ("d_mm", "a_mm", "alpha_deg", "theta_deg")
        np.testing.assert_allclose([row[key] for key in keys], [getattr(one, key) for key in keys], atol=1e-9)
    assert not np.any([machine[f"base_{unit}"] for unit in ("mm", "deg")])
    np.testing.assert_allclose([machine["tip_mm"], machine["tip_deg"]], [stated.tip_mm, stated.tip_deg], atol=1e-9)
    assert len(said) == 1


def test_rows_do_not_hold_gains(tmp_path, rng):
    found = make_rows("ur10", rng, symbols=("gain",))
    _, said, _ = export_rows(found, tmp_path / "out")
    assert float(re.match(r"; (\S+) mm are left", WRITTEN.match(said[0])[3])[1]) > 0.01


# --- the calibration file of a UR ------------------------------------------------------------------------------------

LINKS = ["shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"]


def read_kinematics(text):
    """Return where frames stand in those before, m (6, 4, 4), of a file's lines."""
    lines = [one for one in text.splitlines() if not one.startswith("#")]
    assert lines[0] == "kinematics:"
    assert [one.strip(" :") for one in lines[1::7]] == LINKS
    found = []
    for start in range(1, len(lines), 7):
        pairs = [one.split(": ") for one in lines[start + 1 : start + 7]]
        assert [one.strip() for one, _ in pairs] == ["x", "y", "z", "roll", "pitch", "yaw"]
        x, y, z, roll, pitch, yaw = (float(one) for _, one in pairs)
        place = np.eye(4)
        place[:3, :3] = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
        place[:3, 3] = x, y, z
        found.append(place)
    return found


def test_a_ur_is_calibrated_by_its_file(tmp_path, rng):
    found = make_calibrated(UR10, rng, FRAMES[:6])
    written = export_machine(found, tmp_path, "ur_kinematics")
    places = read_kinematics((tmp_path / "kinematics.yaml").read_text())
    pose = draw_poses(found.model, rng)
    commands = found.model.read(found.theta, pose)[:, :6]
    for q, tool in zip(commands, found.model.tool_values(found.theta, pose), strict=True):
        here = np.eye(4)
        for place, value in zip(places, q, strict=True):
            turn = np.eye(4)
            turn[:3, :3] = Rotation.from_euler("z", value).as_matrix()
            here = here @ place @ turn
        # the last row of a UR has no length behind its joint: the flange is where the sixth joint's frame is
        np.testing.assert_allclose(1e3 * here[:3, 3], tool[:3], rtol=0.0, atol=NANOMETRE)
        np.testing.assert_allclose(here[:3, :3], Rotation.from_rotvec(tool[3:]).as_matrix(), atol=1e-9)
    carried, of, rest = WRITTEN.match(describe_carried(written)[0]).groups()
    assert (carried, rest) == (of, "")


def test_a_tool_that_is_off_does_not_go_into_a_urs_file(tmp_path, rng):
    found = make_calibrated(UR10, rng, ("offset", "tool_r"))
    assert "mm are left" in describe_carried(export_machine(found, tmp_path, "ur_kinematics"))[0]


def test_other_arms_have_no_urs_file(tmp_path, rng):
    panda = make_calibrated(EXPERIMENTS / "panda_socket" / "machine.toml", rng)
    said = "format ur_kinematics: found 7 joints, expected six that turn"
    assert said in line_of(lambda: export_machine(panda, tmp_path / "out", "ur_kinematics"))
    rows = UR10.read_text().replace("workspace_deg", "tip_mm = [0.0, 0.0, 50.0]\nworkspace_deg")
    (tmp_path / "machine.toml").write_text(rows)
    tipped = make_calibrated(tmp_path / "machine.toml", rng)
    said = "found a tip beyond the flange, expected tip_mm and tip_deg of zero"
    assert said in line_of(lambda: export_machine(tipped, tmp_path / "out", "ur_kinematics"))
    assert not (tmp_path / "out").exists()


def test_other_machines_are_refused(tmp_path, rng):
    found = calibrate(build_planned("star"), 20, rng)
    assert 'expected kind = "arm"' in line_of(lambda: export_machine(found, tmp_path, "ur_kinematics"))
    line_of(lambda: export_machine(found, tmp_path, "urdf"))
    assert not list(tmp_path.iterdir())


def test_names_that_a_file_does_not_declare_are_said(tmp_path, rng):
    text = SMALL.replace("</robot>", "<controller:camera/></robot>")
    found = make_calibrated(write_machine(tmp_path, text), rng)
    assert "unbound prefix" in line_of(lambda: export_machine(found, tmp_path / "out", "urdf"))
