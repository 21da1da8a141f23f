"""Deltas of Klipper, Marlin and RepRapFirmware as projects: their numbers, what is refused, any text at all."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import studies
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bayescal.errors import InputError
from bayescal.importers import find_importer, import_file
from bayescal.machines.read import read_reading_model

STEP = 0.0125
HEAD = """# a comment
[printer]
kinematics: delta
print_radius: 147
#delta_radius: 160      ; set aside

[stepper_a]
microsteps: 16
rotation_distance: 40   # of a pulley
#position_endstop: 415.0
#arm_length = 345.0
[stepper_b]
microsteps: 32
gear_ratio: 2:4
rotation_distance: 40
[stepper_c]
step_distance: 0.0125

#*# <---- SAVE_CONFIG ---->
#*# [printer]
#*# delta_radius = 162.769280
#*# [stepper_a]
#*# angle = 210.128266
#*# arm_length = 345.511546
#*# position_endstop = 418.721720
"""


def write_printer(head: str = HEAD) -> str:
    """Return a printer's configuration with the readings of the shipped printer, steps as its firmware has them."""
    table = pd.read_csv(studies.EXPERIMENTS / "flsun_v400" / "data" / "readings.csv", comment="#").set_index("pose")
    steps = {p: table[[f"s_{k}{p}_mm" for k in (1, 2, 3)]] / STEP for p in "ab"}
    lines, heights = ["#*# [delta_calibrate]"], 0
    for pose, row in table.iterrows():
        at = {p: ",".join(f"{x:.3f}" for x in steps[p].loc[pose]) for p in "ab"}
        if pose.startswith("H"):
            for p in "ab":
                if np.isfinite(row[f"height_{p}_mm"]):
                    lines += [f"#*# height{heights} = 16.0", f"#*# height{heights}_pos = {at[p]}"]
                    heights += 1
        else:
            k = pose[1:]
            lines += [f"#*# distance{k} = {row['distance_mm']:g}", f"#*# distance{k}_pos1 = {at['a']}"]
            lines += [f"#*# distance{k}_pos2 = {at['b']}"]
    return head + "\n".join(lines) + "\n"


def convert(tmp_path: Path, text: str, name: str = "printer.cfg", options: dict | None = None) -> Path:
    """Return the folder of a file's project."""
    path = tmp_path / name
    path.write_text(text)
    project = import_file(path, options)
    for file, content in project.files.items():
        (tmp_path / "project" / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "project" / file).write_bytes(content)
    return tmp_path / "project"


def test_a_klipper_file_has_machine_and_readings(tmp_path):
    folder = convert(tmp_path, write_printer())
    machine = tomllib.loads((folder / "machine.toml").read_text())
    assert machine["places"] == 2
    assert machine["machine"]["radius_mm"] == 160.0  # nominal as set aside, not as the firmware found
    assert machine["machine"]["arm_mm"] == [345.0] * 3
    assert machine["machine"]["endstop_mm"] == [415.0] * 3
    read_reading_model(folder / "machine.toml")
    found = pd.read_csv(folder / "data" / "readings.csv", comment="#").set_index("pose")
    shipped = pd.read_csv(studies.EXPERIMENTS / "flsun_v400" / "data" / "readings.csv", comment="#").set_index("pose")
    assert len(found) == 7 + 12
    np.testing.assert_allclose(found.loc["D3"].dropna(), shipped.loc["D3"].dropna(), atol=1e-5)
    np.testing.assert_allclose(found.loc["H2"].dropna(), [*shipped.loc["H23"].to_numpy()[:3], 16.0], atol=1e-5)
    beside = pd.read_csv(folder / "data" / "klipper.csv", comment="#").set_index("quantity")["value"]
    assert dict(beside) == {"r": 162.76928, "angle[1]": 210.128266, "l[1]": 345.511546, "e[1]": 418.72172}


@pytest.mark.runs
def test_a_klipper_file_is_calibrated_as_it_is(call, tmp_path):
    path = tmp_path / "printer.cfg"
    path.write_text(write_printer())
    code, said, _ = call("init", tmp_path / "v400", "--from", path)
    assert code == 0
    assert "7 heights, 12 distances; a step is 0.0125 mm" in said
    assert "nominal: delta_radius 160, line 5, set aside in a comment" in said
    code, _, _ = call("run", tmp_path / "v400" / "study.toml", "--out", tmp_path / "out", "--workers", 1)
    assert code == 0
    table = pd.read_csv(tmp_path / "out" / "tables" / "parameters.csv").query("variant == 'arms_differ'")
    radius = table.set_index("parameter").loc["r"]
    assert radius["mean"] == pytest.approx(162.76, abs=0.05)
    assert radius["sd"] == pytest.approx(0.19, abs=0.03)
    form = "--variant", "arms_differ", "--format", "klipper"
    assert call("export", tmp_path / "out", *form, "--out", tmp_path / "calibrated")[0] == 0
    (written,) = (tmp_path / "calibrated").glob("*.cfg")
    assert f"delta_radius: {radius['mean']:.3f}" in written.read_text()


@pytest.mark.runs
def test_heights_alone_are_calibrated_with_known_arms(call, tmp_path):
    text = re.sub(r"#\*# distance.*\n", "", write_printer())
    folder = convert(tmp_path, text)
    code, said, _ = call("validate", folder / "study.toml")
    assert code == 0
    assert "all 6 combinations will be determined" in said


KLIPPER_FAULTS = {
    "kinematics": ("kinematics: delta", "kinematics: corexy", "line 3: kinematics: found 'corexy', expected delta"),
    "no block": ("#*# [delta_calibrate]", "#*# [other]", "found no heights of [delta_calibrate], expected those"),
    "no steps": ("rotation_distance: 40   #", "#", "line 7: found no rotation_distance in [stepper_a], expected it"),
    "text": ("microsteps: 16", "microsteps: many", "line 8: microsteps: found 'many', expected a number from 1 to"),
    "short arm": ("#arm_length = 345.0", "#arm_length = 145.0", "line 11: arm_length: found 145, expected more than"),
    "gear": ("gear_ratio: 2:4", "gear_ratio: 2", "gear_ratio: found '2', expected pairs such as 80:20"),
    "position": ("32216.333,", "", "expected three step counts"),
}


@pytest.mark.parametrize("name", KLIPPER_FAULTS)
def test_other_printers_are_refused_in_a_line(tmp_path, name):
    old, new, said = KLIPPER_FAULTS[name]
    text = write_printer()
    assert old in text
    with pytest.raises(InputError) as error:
        convert(tmp_path, text.replace(old, new))
    assert said in str(error.value)
    assert re.search(r"printer\.cfg, line \d+", str(error.value))


MARLIN = """echo:  M665 L250.00 R124.00 H310.50 S100.00 X-0.20 Y0.10 Z0.00 A0.30 B-0.10 C0.00
echo:  M666 X-0.50 Y0.00 Z-1.20
"""
REPRAP = """M665 L450.1:450:449.9 R221.448 H400.459 B185.0 X-0.121 Y-0.228 Z0 ; delta
M666 X-0.069 Y-0.135 Z0.204 A0 B0
"""
SHAPES = {
    "marlin": (MARLIN, 124.0, [250.3, 249.9, 250.0], [311.0, 310.5, 311.7], [209.8, 330.1, 90.0]),
    "reprap": (REPRAP, 221.448, [450.1, 450.0, 449.9], [400.39, 400.324, 400.663], [209.879, 329.772, 90.0]),
}


@pytest.mark.parametrize("name", SHAPES)
def test_commands_are_a_machine_and_an_audit(call, tmp_path, name):
    text, radius, arms, endstops, angles = SHAPES[name]
    folder = convert(tmp_path, text, "settings.txt")
    machine = tomllib.loads((folder / "machine.toml").read_text())["machine"]
    for key, expected in (("radius_mm", radius), ("arm_mm", arms), ("endstop_mm", endstops), ("angle_deg", angles)):
        np.testing.assert_allclose(machine[key], expected, atol=1e-9)
    code, _, _ = call("validate", folder / "audit.toml")
    assert code == 0


MARLIN_FAULTS = {
    "no radius": ("M665 L250 H300 S100\n", "line 1: M665: found no R, expected it"),
    "firmware": ("M665 L250 R120 H300\n", "found nothing that tells the firmware, expected --option firmware=marlin"),
    "text": (";\nM665 L250 R1-2 H300 S100\n", "line 2: R: found '1-2', expected a number from 0.001 to"),
    "arms": ("M665 L250:251 R120 H300 B80\n", "line 1: L: found 2 lengths, expected 1 or 3"),
    "short": ("M665 L100 R120 H300 B80\n", "line 1: L: found an arm of 100, expected more than R, 120"),
}


@pytest.mark.parametrize("name", MARLIN_FAULTS)
def test_other_commands_are_refused_in_a_line(tmp_path, name):
    text, said = MARLIN_FAULTS[name]
    with pytest.raises(InputError) as error:
        convert(tmp_path, text, "settings.txt")
    assert said in str(error.value)


def test_the_firmware_may_be_stated(tmp_path):
    text = "M665 L250 R120 H300\nM666 X1\n"
    folder = convert(tmp_path, text, "settings.txt", {"firmware": "reprapfirmware"})
    assert tomllib.loads((folder / "machine.toml").read_text())["machine"]["endstop_mm"][0] == 301.0


# --- any text --------------------------------------------------------------------------------------------------------

JUNK = st.text(st.characters(codec="utf-8", exclude_characters="\r"), max_size=12)
NUMBERS = st.one_of(
    st.sampled_from(["", "nan", "inf", "-1", "0", "1e400", "1e-30", "16,17", "1,2,3,4", "[x]", "1:2", "0:0"]), JUNK
)


@given(data=st.data())
@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@pytest.mark.parametrize("text", [write_printer(), MARLIN, REPRAP], ids=["klipper", "marlin", "reprap"])
def test_any_file_is_a_project_or_one_line(tmp_path, text, data):
    numbers = [one.span() for one in re.finditer(r"-?[\d.,:]*\d", text)]
    for _ in range(data.draw(st.integers(1, 3))):
        start, end = data.draw(st.sampled_from(numbers))
        if end <= len(text):
            how = data.draw(st.sampled_from(["number", "cut", "insert"]))
            middle = "" if how == "cut" else data.draw(NUMBERS if how == "number" else JUNK)
            text = text[: start if how != "insert" else end] + middle + text[end:]
    path = tmp_path / "any.cfg"
    path.write_text(text, encoding="utf-8", newline="")
    try:
        importer, read = find_importer(path)
        project = importer.convert(path, read, {})
    except InputError as error:
        said = str(error)
        assert "\n" not in said
        assert "any.cfg" in said
        assert re.search(r"line \d+|found no known format", said)
        return
    (tmp_path / "machine.toml").write_bytes(project.files["machine.toml"])
    for name, content in project.files.items():
        if name.endswith(".toml"):
            tomllib.loads(content.decode())
    assert find_fault(tmp_path / "machine.toml") in ("", "at home")


def find_fault(path: Path) -> str:
    """Return the end of the line of a machine that is none: it may not stand in the middle of its workspace."""
    try:
        read_reading_model(path)
    except InputError as error:
        return "at home" if "at home" in str(error) else str(error)
    return ""
