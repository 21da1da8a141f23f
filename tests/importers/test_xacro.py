"""Arms in xacro: expanded where the library is there and the files are trusted, else one line."""

from __future__ import annotations

import pytest
from refusals import line_of
from serial_arms import SMALL

from bayescal import load_machine
from bayescal.config import trust
from bayescal.importers import import_file

XACRO = SMALL.replace("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ', 1).replace(
    '<link name="floor"/>', '<xacro:arg name="reach" default="1"/>\n<xacro:include filename="part.xacro"/>', 1
)
PART = "<robot xmlns:xacro=\"http://www.ros.org/wiki/xacro\"><link name=\"${'fl' + 'oor'}\"/></robot>"


def write(folder):
    (folder / "part.xacro").write_text(PART)
    (folder / "arm.urdf.xacro").write_text(XACRO)
    return folder / "arm.urdf.xacro"


def test_without_the_library_a_line_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "xacro", None)
    for call in (load_machine, import_file):
        said = line_of(call, write(tmp_path))
        assert "expected xacrodoc to expand it (pip install 'bayescal[xacro]'), or URDF: xacro arm.urdf.xacro" in said


def test_a_config_asks_for_urdf(tmp_path):
    path = write(tmp_path)
    (tmp_path / "machine.toml").write_text(f"kind = 'arm'\nname = 'a'\ntitle = 'a'\n[machine]\nurdf = '{path.name}'\n")
    said = line_of(load_machine, tmp_path / "machine.toml")
    assert f"{path.name}, line 3: found <xacro:arg>, expected URDF: bayescal init expands it" in said


def test_each_file_is_trusted_before_it_is_read(tmp_path, monkeypatch):
    pytest.importorskip("xacrodoc")
    monkeypatch.setenv(trust.TRUST, "0")
    monkeypatch.setattr(trust, "_store", lambda: tmp_path / "trusted.json")
    path = write(tmp_path)
    assert f"code (arm.urdf.xacro in {tmp_path}) that nobody has trusted" in line_of(load_machine, path)
    trust.remember([path])
    assert f"code (part.xacro in {tmp_path}) that nobody has trusted" in line_of(load_machine, path)
    assert {one.name for one in trust.trust(tmp_path)} == {"arm.urdf.xacro", "part.xacro"}
    plain = tmp_path / "plain.urdf"
    plain.write_text(SMALL)
    own, known = load_machine(path, arguments={"reach": "2"}), load_machine(plain)
    assert (own.read([0.3, 20.0, 0.2]) == known.read([0.3, 20.0, 0.2])).all(axis=None)
    assert set(own.files) == {"arm.urdf", "machine.toml"}
    assert "arguments, expected them with a xacro file" in line_of(lambda: load_machine(plain, arguments={"a": "b"}))


@pytest.mark.parametrize(("old", "new"), [("'fl' + 'oor'", "1 / 0"), ("<link", "<lin"), ("'fl' +", "unknown +")])
def test_what_cannot_be_expanded_is_refused_in_a_line(tmp_path, old, new):
    pytest.importorskip("xacrodoc")
    path = write(tmp_path)
    (tmp_path / "part.xacro").write_text(PART.replace(old, new))
    line_of(load_machine, path)
