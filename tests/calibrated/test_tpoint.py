"""Model files of TPOINT, read by a reader of their own and held against the mount's encoders."""

from __future__ import annotations

import re

import calibrated_machines as calibrated
import hexapods
import numpy as np
import pytest

from bayescal.calibrated.formats import export_machine
from bayescal.calibrated.machine import CommandErrors, Source, build_calibrated
from bayescal.calibrated.tpoint import format_value
from bayescal.errors import InputError
from bayescal.machines.deformations import NoDeformation
from bayescal.machines.kinematics import build_machine
from bayescal.machines.models.six_ups import SixUps
from bayescal.machines.readings import FunctionModel
from bayescal.machines.readings.mount import Mount, MountConfig

ARCSECOND = np.pi / 648_000.0
SOURCE = Source("made_up", "eight", "Made up for the tests, never measured")
MOUNTS = {
    "north": MountConfig(),
    "south": MountConfig(azimuth_from="south", azimuth_deg=[-180.0, 180.0]),
    "equatorial": MountConfig(axes="equatorial", latitude_deg=31.7),
}


def calibrate(config, rng, n=400):
    """Return a mount calibrated by made-up draws, its last term known to be zero."""
    model = FunctionModel("mount", Mount(config))
    size = model.layout.size
    spread = ARCSECOND * np.array([900.0, 40.0, *[30.0] * (size - 2)])
    mixing = np.eye(size) - 0.9 * np.eye(size, k=4)
    draws = spread * (1.0 + 0.02 * rng.standard_normal((n, size)) @ mixing)
    draws[:, -1] = 0.0
    errors = CommandErrors(np.diag((ARCSECOND * np.array([1.5, 0.8])) ** 2), np.zeros(2))
    return build_calibrated(model, draws.mean(axis=0), draws, errors=errors, source=SOURCE, measured=np.zeros((42, 2)))


def read_model(text):
    """Return what a model file holds, by its columns: terms, values and standard errors in arcsec, rows of comments."""
    caption, head, *lines = text.splitlines()
    terms, errors = {}, {}
    end = lines.index("END")
    assert [line[0] for line in lines[:end]] == [" ", *"&" * (end - 1)]
    for line in lines[:end]:
        assert re.fullmatch(r"[& ][= ][A-Z]+ +[-+.\d ]{10}[-+.\d ]*", line)
        name, value, error = line[2:10].strip(), line[10:20], line[20:32]
        terms[name], errors[name] = float(value), float(error or "nan")
    return caption, head.split(), terms, errors, lines[end + 1 :]


def point(config, terms, one, other):
    """Return encoders of directions on the sky by the standard formulas, azimuths from north through east."""
    t = {name: value * ARCSECOND for name, value in terms.items()}
    if config.axes == "equatorial":
        c, s = np.cos(np.radians(config.latitude_deg)), np.sin(np.radians(config.latitude_deg))
        along = t["IH"] + t["NP"] * np.tan(other) + t["CH"] / np.cos(other)
        along += t["ME"] * np.sin(one) * np.tan(other) - t["MA"] * np.cos(one) * np.tan(other)
        along += t["TF"] * c * np.sin(one) / np.cos(other)
        across = t["ID"] + t["ME"] * np.cos(one) + t["MA"] * np.sin(one) + t["FO"] * np.cos(one)
        across += t["TF"] * (c * np.cos(one) * np.sin(other) - s * np.cos(other))
        return one - along, other - across
    along = -t["IA"] - t["AN"] * np.sin(one) * np.tan(other) - t["AW"] * np.cos(one) * np.tan(other)
    along -= t["NPAE"] * np.tan(other) + t["CA"] / np.cos(other)
    across = t["IE"] - t["AN"] * np.cos(one) + t["AW"] * np.sin(one) - t["TF"] * np.cos(other)
    return one - along, other - across


@pytest.mark.parametrize("name", MOUNTS)
def test_a_model_file_points_as_the_mount_does(tmp_path, rng, name):
    config = MOUNTS[name]
    found = calibrate(config, rng)
    assert tmp_path / "tpoint.mod" in export_machine(found, tmp_path, "tpoint")
    caption, head, terms, errors, rest = read_model((tmp_path / "tpoint.mod").read_text())
    assert caption.startswith("Calibrated machine: experiment made_up")
    assert head[:2] == ["T", "42"]
    names = [one for one in found.model.layout.names if one not in ("TX", "DAF")]
    assert list(terms) == names
    np.testing.assert_allclose([errors[one] for one in names], found.sd[:-1] / ARCSECOND, atol=1e-5)
    sky = found.model.home_pose + found.model.pose_scale * rng.uniform(-1.0, 1.0, (60, 2))
    encoders = found.model.read(found.theta, sky)[:, :2]
    seen = point(config, terms, np.pi - sky[:, 0] if name == "south" else sky[:, 0], sky[:, 1])
    read = np.stack([np.pi - seen[0] if name == "south" else seen[0], seen[1]], axis=-1)
    np.testing.assert_allclose(read, encoders, atol=1e-9)
    assert all(line.startswith("! ") for line in rest)
    assert any("Standard errors omit correlations" in line for line in rest)


def test_what_the_format_cannot_hold_is_stated_in_numbers(tmp_path, rng):
    found = calibrate(MountConfig(), rng)
    export_machine(found, tmp_path, "tpoint")
    *_, rest = read_model((tmp_path / "tpoint.mod").read_text())
    (said,) = [one for one in rest if "correlations" in one and "uncertainty" in one]
    apart, _, together, _ = map(float, re.findall(r"\d+\.?\d*(?:e-?\d+)?", said))
    low, high = found.model.home_pose - found.model.pose_scale, found.model.home_pose + found.model.pose_scale
    sky = low + (high - low) * rng.random((2000, 2))
    theta = np.repeat(found.theta[None], len(found.draws), axis=0)
    for expected, draws in ((together, found.draws), (apart, rng.permuted(found.draws, axis=0))):
        theta[:, found.free] = draws
        off = found.model.read(theta[:, None], sky)[..., 0] / ARCSECOND
        assert np.sqrt(np.mean(off.var(axis=0))) == pytest.approx(expected, rel=0.05)


def test_values_keep_to_their_column():
    for value in (0.0, -0.000004, 1210.36789, -1210.36789, -123456.789, 9_999_999.9):
        text = format_value(value)
        assert len(text) == 10
        assert float(text) == pytest.approx(value, abs=0.5 if abs(value) > 1e6 else 6e-3 if abs(value) > 1e5 else 1e-3)
    with pytest.raises(InputError, match="found a term of 1e"):
        format_value(1e11)


def test_other_machines_are_refused(tmp_path, rng):
    hexapod = calibrated.build_made_up(build_machine(SixUps, hexapods.load_hexapod("m2"), NoDeformation()), rng, 50)
    with pytest.raises(InputError, match=r"format tpoint: found machine .*, expected one of kind 'mount'"):
        export_machine(hexapod, tmp_path / "out", "tpoint")
    assert not (tmp_path / "out").exists()
