"""Readings of a platform on sliding legs: its loops close, derivatives are those of differences, faults are named."""

from __future__ import annotations

import numpy as np
import pytest
from sliding_platforms import SETS, STAR, build, make_content, poses_about_home, sliding_star

from bayescal.errors import InputError
from bayescal.machines.read import read_reading_model
from bayescal.machines.readings.sliding_platform import segments_cross

CASES = [(n, points) for n in (3, 4, 6) for points in ("along", "against")]
LISTED = {
    4: "l1 xP2 yP2 beta2 l2 xiB2 xP3 yP3 beta3 l3 xiB3 etaB3 xP4 yP4 beta4 l4 xiB4 etaB4",
    8: "l1 phi1 xP2 yP2 beta2 l2 xiB2 phi2 xP3 yP3 beta3 l3 xiB3 etaB3 phi3 xP4 yP4 beta4 l4 xiB4 etaB4 phi4",
    12: "l1 phi1 psi1 xP2 yP2 beta2 l2 xiB2 phi2 psi2 xP3 yP3 beta3 l3 xiB3 etaB3 phi3 psi3 "
    "xP4 yP4 beta4 l4 xiB4 etaB4 phi4 psi4",
}
"""Calibrated parameters of three sets as section 5 of Šika et al. (2008) lists them, subscripts of zeros left out."""


def draw(model, rng, n_machines=4, n_poses=5):
    """Return machines (n, 1, D) with every parameter off, and poses (1, P, 3)."""
    units = np.where(np.array(model.layout.units) == "mm", 5.0, 0.02)
    theta = model.layout.nominal + units * rng.standard_normal((n_machines, 1, model.layout.size))
    moves = rng.uniform(-1.0, 1.0, (n_poses, 3)) * [120.0, 120.0, 0.3]
    return theta, poses_about_home(model, moves)[None]


@pytest.mark.parametrize(("n", "points"), CASES)
def test_loops_close_in_the_complex_plane(rng, n, points):
    """From carriage and leg angle to the platform's joint, by a way that solves nothing."""
    model = build(make_content(n, points))
    theta, pose = draw(model, rng)
    take = {symbol: model.layout.take(theta, symbol) for symbol in model.layout.symbols}
    s, phi, psi = (model.read(theta, pose)[..., k * n : (k + 1) * n] for k in range(3))
    guide = np.exp(1j * take["beta"])
    leg = take["l"] * guide * np.exp(1j * (phi + take["phi0"]))
    reached = take["x_P"] + 1j * take["y_P"] + s * guide + leg
    joint = pose[..., :1] + 1j * pose[..., 1:2] + np.exp(1j * pose[..., 2:]) * (take["xi_B"] + 1j * take["eta_B"])
    np.testing.assert_allclose(reached, joint, atol=1e-9)
    seen_from_platform = leg * np.exp(-1j * pose[..., 2:])
    np.testing.assert_allclose(take["l"] * np.exp(1j * (psi + take["psi0"])), seen_from_platform, atol=1e-9)
    along = (leg / guide).real
    assert (along > 0).all() if points == "along" else (along < 0).all()


def test_the_platform_turns_by_its_angle(rng):
    model = build(make_content(4))
    _, pose = draw(model, rng)
    x_axis = model.rotation(pose)[..., 0]
    np.testing.assert_allclose(x_axis[..., 0] + 1j * x_axis[..., 1], np.exp(1j * pose[..., 2]), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(model.rotation_in_space(pose)), 1.0, atol=1e-12)


def test_the_tool_is_carried_by_the_platform(rng):
    model = build(make_content(4))
    theta, pose = draw(model, rng)
    offset = model.layout.take(theta, "xi_V") + 1j * model.layout.take(theta, "eta_V")
    there = pose[..., :1] + 1j * pose[..., 1:2] + np.exp(1j * pose[..., 2:]) * offset
    position = model.tool_values(theta, pose)
    np.testing.assert_allclose(position[..., 0] + 1j * position[..., 1], there[..., 0], atol=1e-10)
    np.testing.assert_array_equal(model.read(theta, pose)[..., -3:-1], position)


def test_readings_of_one_pose_by_hand():
    """The shipped machine at home: by symmetry sqrt(800² - 500²) from guide to joint, angle sensors at zero."""
    model = sliding_star()
    found = model.read(model.layout.nominal, model.home_pose)
    np.testing.assert_allclose(found[:4], -np.sqrt(800.0**2 - 500.0**2), rtol=1e-12)
    np.testing.assert_allclose(found[4:12], 0.0, atol=1e-12)
    np.testing.assert_allclose(found[12:], [0.0, 0.0, model.home_pose[2]], atol=1e-12)


@pytest.mark.parametrize("points", ["along", "against"])
def test_angles_are_continuous_where_a_leg_passes_its_guide(points):
    """A platform that crosses a guide's line; against its guide the plain arc tangent would jump there."""
    model = build(make_content(3, points))
    first = model.machine.guide_points[0]
    across = np.array(
        [np.cos(model.machine.guide_angles[0] - np.pi / 2), np.sin(model.machine.guide_angles[0] - np.pi / 2)]
    )
    origin = first + np.linspace(-60.0, 60.0, 241)[:, None] * across
    pose = np.column_stack([origin, np.full(241, model.home_pose[2])])  # B_1 is the origin of the platform's frame
    theta = model.layout.nominal
    readings = model.read(theta, pose)
    angle, seen = readings[:, 3] + model.layout.take(theta, "phi0")[0], readings[:, 6]
    assert np.abs(np.diff(angle)).max() < 1e-3
    assert np.abs(np.diff(seen)).max() < 1e-3
    plain = np.arctan2(np.sin(angle), np.cos(angle))
    assert (np.abs(np.diff(plain)).max() > 6.0) == (points == "against")


@pytest.mark.parametrize("n", SETS)
def test_calibrated_parameters_are_those_listed(n):
    model = sliding_star()
    names = [model.names[k] for k in model.select(SETS[n])]
    assert len(names) == n
    free = [name for name in model.seen_parameters(names) if name not in model.machine.frame_parameters()]
    ours = {name.replace("_", "").replace("0[", "[").replace("[", "").replace("]", "") for name in free}
    listed = LISTED[n].split()
    assert ours == set(listed)
    assert len(free) == len(listed) == {4: 18, 8: 22, 12: 26}[n]


def test_sensors_of_one_leg_see_that_leg():
    model = build(make_content(6))
    assert model.seen_parameters(["phi[5]"]) == tuple(
        f"{symbol}[5]" for symbol in ("x_P", "y_P", "beta", "l", "xi_B", "eta_B", "phi0")
    )
    assert model.seen_parameters(["y_V"]) == ("xi_V", "eta_V")
    assert model.seen_parameters(["phi_V"]) == ()


def test_select_takes_kinds_and_names_in_the_machines_order():
    model = sliding_star()
    assert [model.names[k] for k in model.select(["phi[2]", "s", "phi[2]"])] == [
        *(f"s[{k}]" for k in (1, 2, 3, 4)),
        "phi[2]",
    ]
    for name in ("s[5]", "phi0", "S"):
        with pytest.raises(InputError, match=r"one of s\[1\]"):
            model.select(["s", name])


@pytest.mark.parametrize("n_legs", [3, 4, 6])
def test_platform_frame_has_its_origin_in_b1_and_its_axis_through_b2(n_legs):
    content = make_content(n_legs)
    model = build(content)
    np.testing.assert_allclose(model.machine.platform_points[0], 0.0, atol=1e-12)
    assert model.machine.platform_points[1, 1] == pytest.approx(0.0, abs=1e-12)
    assert model.machine.platform_points[1, 0] > 0.0
    home = model.home_pose
    position, _, _ = model.tool(model.layout.nominal, home)
    np.testing.assert_allclose(position, content["home"]["tool_mm"], atol=1e-12)
    # joints in the base frame as the config has them: about the tool, turned by the angle at home
    given = np.array([leg["platform_point_mm"] for leg in content["legs"]]) - content["tool"]["point_mm"]
    turn = np.radians(content["home"]["angle_deg"])
    wanted = np.exp(1j * turn) * (given[:, 0] + 1j * given[:, 1]) + 3.0 - 2.0j
    own = model.machine.platform_points
    found = home[0] + 1j * home[1] + np.exp(1j * home[2]) * (own[:, 0] + 1j * own[:, 1])
    np.testing.assert_allclose(found, wanted, atol=1e-10)


# --- faults ----------------------------------------------------------------------------------------------------------


def test_unreachable_pose_and_leg_are_named():
    model = sliding_star()
    moves = np.array([[0.0, 0.0, 0.0], [50.0, 0.0, 0.0], [0.0, 320.0, 0.0]])
    with pytest.raises(InputError, match=r"'sliding_star': pose 3: leg 4: .*\b820 mm"):
        model.machine.check_poses(poses_about_home(model, moves))
    assert np.isnan(model.read(model.layout.nominal, poses_about_home(model, moves))[2, 3])
    model.machine.check_poses(poses_about_home(model, moves[:2]))


def test_crossed_legs_are_named():
    model = sliding_star()
    turned = poses_about_home(model, np.array([[0.0, 0.0, 0.1], [0.0, 0.0, np.pi]]))
    with pytest.raises(InputError, match=r"2: legs \d and \d"):
        model.machine.check_poses(turned, lambda k: f"path {k + 1}")


def test_segments_cross_as_their_equations_say(rng):
    a, b, c, d = rng.uniform(-1.0, 1.0, (4, 500, 2))
    shares = np.linalg.solve(np.stack([b - a, c - d], axis=-1), (c - a)[..., None])[..., 0]
    crossing = ((shares > 0.0) & (shares < 1.0)).all(axis=1)
    assert 50 < crossing.sum() < 450
    np.testing.assert_array_equal(segments_cross(a, b, c, d), crossing)


def spoil(n_legs=4, home=None, leg=None, **changes):
    """Return the content of a star with so many legs, its home or one leg or all of them changed."""
    content = make_content(4)
    content["home"] |= home or {}
    for one in content["legs"] if leg is None else content["legs"][leg - 1 : leg]:
        one |= changes
    return content | {"legs": content["legs"][:n_legs]}


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (
            spoil(leg=2, length_mm=300.0),
            "home: leg 2: found .* mm from its guide, expected at most 3",
        ),
        (spoil(home={"angle_deg": 180.0}), r"home: legs \d and \d cross"),
        (spoil(n_legs=2), "found 2 legs, expected at least 3"),
        (spoil(platform_point_mm=[1.0, 2.0]), "machine 'star': found B_1 and B_2"),
    ],
)
def test_faults_of_machines_are_named(content, match):
    with pytest.raises(InputError, match=match):
        build(content)


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        (
            "guide_angle_deg = 90.0",
            "guide_angle_deg = 5400.0",
            "legs.0.guide_angle_deg: found 5400.0, expected less than",
        ),
        (
            "guide_angle_deg = 90.0",
            "guide_angle_rad = 1.57",
            "guide_angle_rad: unknown key, did you mean 'guide_angle_deg'",
        ),
        ("length_mm = 800.0", "length_mm = -8.0", "legs.0.length_mm: found -8.0"),
        ("point_mm = [0.0, 0.0]", "point_mm = [0.0]", "tool.point_mm"),
        ('kind = "sliding_platform"', 'kind = "hexapod"', "kind: found 'hexapod'"),
    ],
)
def test_faults_of_machine_files_name_file_and_field(tmp_path, old, new, match):
    path, text = tmp_path / "machine.toml", (STAR / "machine.toml").read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=match) as caught:
        read_reading_model(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)
