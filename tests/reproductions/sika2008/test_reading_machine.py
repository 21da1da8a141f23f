"""From configs to sensors, tolerances and poses; every fault is one line."""

from __future__ import annotations

import numpy as np
import pytest
from sika_problems import NOISE, TOLERANCES
from sliding_platforms import STAR, build, make_content, sliding_star

from bayescal.errors import InputError
from bayescal.machines.read import read_reading_model
from sika2008.schema import PosesConfig, SensorConfig
from sika2008.setup import ARCSECOND, build_sensors, draw_poses, free_parameters, poses_about_home


def test_noise_of_single_sensors_goes_before_that_of_their_kind():
    model = sliding_star()
    sensors = build_sensors(model, NOISE | {"phi[2]": SensorConfig(noise_arcsec=3.0)}, ["s[1]", "phi"])
    assert sensors.names == ("s[1]", "phi[1]", "phi[2]", "phi[3]", "phi[4]")
    np.testing.assert_allclose(sensors.noise, [1e-3, *(np.array([0.5, 3.0, 0.5, 0.5]) * ARCSECOND)])
    assert pytest.approx(np.radians(1.0 / 3600.0)) == ARCSECOND
    assert len(build_sensors(model, NOISE).chosen) == 12


def test_tolerances_by_what_a_parameter_is():
    model = sliding_star()
    free = free_parameters(model, ("s[1]", "s[2]", "s[3]", "s[4]", "phi[3]"), TOLERANCES)
    known = dict(zip((model.layout.names[k] for k in free.places), free.scale, strict=True))
    assert known["l[1]"] == known["eta_B[3]"] == 0.3
    assert known["beta[2]"] == pytest.approx(np.radians(0.05))
    assert known["phi0[3]"] == pytest.approx(np.radians(2.0))
    assert not set(model.machine.frame_parameters()) & set(known)
    assert "phi0[1]" not in known
    rng = np.random.default_rng(0)
    drawn = free.draw(rng, 4000)
    np.testing.assert_allclose(drawn[:, free.places].std(axis=0) / free.scale, 1.0, atol=0.06)
    assert np.ptp(drawn[:, model.layout.names.index("x_P[1]")]) == 0.0


def test_poses_lie_within_half_widths_of_home():
    model = build(make_content(4))
    config = PosesConfig(n_poses=400, position_mm=150.0, angle_deg=20.0)
    pose = draw_poses(model, config, np.random.default_rng(3))
    tool, _, _ = model.tool(model.layout.nominal, pose)
    off = np.abs(tool - [3.0, -2.0])
    turned = np.abs(np.degrees(pose[:, 2] - model.home_pose[2]))
    assert off.max() < 150.0
    assert turned.max() < 20.0
    assert (off.max(axis=0) > 145.0).all()
    assert turned.max() > 19.0
    np.testing.assert_allclose(poses_about_home(model, np.zeros((1, 3)))[0], model.home_pose, atol=1e-12)


def test_guide_angles_in_radians_are_found_out(tmp_path):
    """Degrees are expected; what was a quarter turn in radians lets legs cross where the machine is to be measured."""
    path, text = tmp_path / "machine.toml", (STAR / "machine.toml").read_text()
    for degrees, radians in ((90, 1.5708), (180, 3.1416), (270, 4.7124), (360, 6.2832)):
        text = text.replace(f"guide_angle_deg = {degrees}.0", f"guide_angle_deg = {radians}")
    path.write_text(text)
    config = PosesConfig(n_poses=50, position_mm=200.0, angle_deg=30.0)
    with pytest.raises(InputError, match=r"'sliding_star': pose \d+: legs \d .*\d cross"):
        draw_poses(read_reading_model(path), config, np.random.default_rng(1))
