"""Deltas and a five-bar: arms against trilateration, what is refused, a measured printer against its firmware's fit."""

from __future__ import annotations

import shutil
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import studies
from deltas import build_delta, build_five_bar, build_rotary_delta, trilaterate

from bayescal.machines.readings import FunctionModel, Parameters
from bayescal.machines.readings.delta import DeltaMachine, DeltaMachineConfig

FLSUN = studies.EXPERIMENTS / "flsun_v400"


def test_carriages_lead_back_to_the_tool(rng):
    machine = build_delta()
    known = {one.symbol: np.array(one.nominal) for one in machine.parameters}
    for point in rng.uniform([-60.0, -60.0, 0.0], [60.0, 60.0, 150.0], (20, 3)):
        read = machine.read(known, point, {})
        top = known["e"] + np.sqrt(known["l"] ** 2 - known["r"] ** 2)
        aside = known["r"] * np.array([np.cos(known["angle"]), np.sin(known["angle"])])
        np.testing.assert_allclose(trilaterate(np.array([*aside, top - read[:3]]).T, known["l"]), point, atol=1e-9)
        assert read[3] == point[2]


def test_elbows_lead_back_to_the_tool(rng):
    machine = build_rotary_delta()
    known = {one.symbol: np.array(one.nominal if one.per_leg else one.nominal[0]) for one in machine.parameters}
    known["o"] = np.array([0.1, -0.2, 0.3])
    for point in rng.uniform([-80.0, -80.0, 0.0], [80.0, 80.0, 80.0], (20, 3)):
        read = machine.read(known, point, {})
        turned = read[:3] + known["o"]
        out, up = known["r"] + known["L"] * np.cos(turned), known["h"] + known["L"] * np.sin(turned)
        assert (out > known["r"]).all()  # elbows outwards
        elbows = np.stack([out * np.cos(known["angle"]), out * np.sin(known["angle"]), up], axis=-1)
        np.testing.assert_allclose(trilaterate(elbows, known["l"]), point, atol=1e-9)
        assert read[3] == point[2]


@pytest.mark.parametrize("elbows", list(product(("left", "right"), repeat=2)))
def test_cranks_lead_back_to_the_tool(rng, elbows):
    machine = build_five_bar(elbows=list(elbows))
    model = FunctionModel("five_bar", machine)
    theta = model.layout.nominal
    known = {one.symbol: np.array(one.nominal) for one in machine.parameters}
    point = rng.uniform([-80.0, 190.0], [80.0, 310.0], (20, 2))
    read = model.read(theta, point)
    turned = read + known["o"]
    elbow = np.stack([known["x"] + known["L"] * np.cos(turned), known["y"] + known["L"] * np.sin(turned)], axis=-1)
    way = point[:, None] - elbow
    np.testing.assert_allclose(np.linalg.norm(way, axis=-1), np.broadcast_to(known["l"], read.shape), rtol=1e-12)
    motors = np.stack([known["x"], known["y"]], axis=-1)
    side = np.linalg.det(
        np.stack(np.broadcast_arrays(point[:, None] - motors, elbow - motors), axis=-1).swapaxes(-1, -2)
    )
    assert (np.sign(side) == [1.0 if one == "left" else -1.0 for one in elbows]).all()
    there, found = model.locate(theta, read)
    assert found.all()
    np.testing.assert_allclose(there, point, atol=1e-9)


@pytest.mark.parametrize("build", [build_delta, build_rotary_delta, build_five_bar])
def test_outlines_have_the_lengths_of_the_arms(build, rng):
    machine = build()
    model = FunctionModel("drawn", machine)
    pose = model.home_pose + 0.5 * model.pose_scale * rng.uniform(-1.0, 1.0, (5, len(model.home_pose)))
    points, lines = machine.outline(Parameters(model.layout, model.layout.nominal), pose)
    lengths = [np.linalg.norm(points[:, one] - points[:, other], axis=-1) for one, other in lines]
    arms = model.layout.take(model.layout.nominal, "l")
    for length, arm in zip(lengths, arms, strict=False):
        np.testing.assert_allclose(length, arm, rtol=1e-9)


def test_an_arm_within_its_radius_is_refused():
    with pytest.raises(ValueError, match="arm_mm: found 100 of tower 2, expected more than its radius, 150"):
        DeltaMachine(
            DeltaMachineConfig(
                radius_mm=150.0,
                arm_mm=[200.0, 100.0, 200.0],
                endstop_mm=300.0,
                workspace_radius_mm=100.0,
                workspace_height_mm=50.0,
            )
        )


@pytest.mark.runs
def test_a_measured_printer_is_calibrated_as_its_firmware_did(call, tmp_path):
    code, _, _ = call("run", FLSUN / "study.toml", "--out", tmp_path / "out", "--workers", 1)
    assert code == 0
    tables = tmp_path / "out" / "tables"
    assert pd.read_csv(tables / "variants.csv")["converged"].all()
    beside = pd.read_csv(tables / "reference_values.csv").query("variant == 'arms_differ'").set_index("quantity")
    assert len(beside) == 9
    assert (np.abs(beside["mean"] - beside["value"]) < 0.1 * beside["sd"]).all()
    assert beside.loc["r", "mean"] == pytest.approx(162.76, abs=0.05)
    assert beside.loc["r", "sd"] == pytest.approx(0.19, abs=0.03)
    page = (tmp_path / "out" / "report.html").read_text()
    assert "r with l[1,2,3] (+0.99)" in page  # the ridge of radius and arms, in words
    assert len(pd.read_csv(tables / "variants.csv")) == 3
    assert sum(len((FLSUN / one).read_text().splitlines()) for one in ("machine.toml", "study.toml")) <= 60


@pytest.mark.runs
@pytest.mark.parametrize(("name", "determined"), [("heights", 5), ("distances", 9)])
def test_distances_determine_what_heights_do_not(call, tmp_path, name, determined):
    """Where the posterior's mean is; of fewer draws than as shipped, which take most of the time."""
    design = Path(shutil.copytree(FLSUN, tmp_path / "flsun")) / f"audit_{name}.toml"
    design.write_text(f"{design.read_text()}\n[posterior]\ndraws = 2000\n")
    code, said, _ = call("audit", design, "--out", tmp_path / "out", "--workers", 1)
    assert code == 0
    assert f"determine {determined} of 9 parameters" in " ".join(said.split())
