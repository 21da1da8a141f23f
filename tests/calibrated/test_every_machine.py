"""Every use of a calibrated machine on every kind of machine: it works, or is refused for its mathematics."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import calibrated_machines as made_up
import guided_machines
import numpy as np
import own_arm
import pytest
import studies
import telescope_machines as machines
from refusals import line_of

from bayescal.calibrated.accuracy import (
    GEOMETRY,
    check_standards,
    compute_budget,
    enclose_measured,
    sample_range,
    sample_region,
)
from bayescal.calibrated.drawn_machines import draw_poses
from bayescal.calibrated.exported import read_exported
from bayescal.calibrated.formats import export_machine
from bayescal.calibrated.machine import (
    CalibratedMachine,
    CommandErrors,
    build_calibrated,
)
from bayescal.calibrated.predict import bound_workspace, compensate_poses, is_pose, predict_poses
from bayescal.calibrated.tables import format_command, format_prediction, read_commanded, read_commands
from bayescal.errors import InputError
from bayescal.experiments.shared.certificate import CertificateOptions, build_certificate, certify, state_headline
from bayescal.machines.deformations import NoDeformation
from bayescal.machines.kinematics import build_machine
from bayescal.machines.models.six_pus import SixPus
from bayescal.machines.read import keep_machines, read_reading_model
from bayescal.machines.readings import Legs

ROOT = Path(__file__).parents[2]
OWN = ROOT / "examples" / "own_machine" / "machine.toml"
FILES = {
    "delta": OWN,
    "hangprinter": ROOT / "experiments" / "hangprinter" / "machine.toml",
    "sliding platform": ROOT / "experiments" / "sliding_star" / "machine.toml",
    "struts": ROOT / "experiments" / "m2_hexapod_table" / "machine.toml",
    "arm": None,
}
LEGS = ("telescope", "telescope that bends", "struts without load", "beam", "hexaglide", "eight legs")
GIVEN = {"elevation_deg": (20.0, 80.0), "temperature_c": (0.0, 20.0)}
N_DRAWS = 600


def build(name: str, folder: Path) -> CalibratedMachine:
    """Return a machine calibrated by made-up draws: 10 µm, 20 µrad or a millionth; noise of the same size."""
    rng = np.random.default_rng(5)
    if name in LEGS:
        return _build_legs(name, rng)
    path = FILES[name]
    if path is None:
        path = folder / "machine.toml"
        path.write_text(own_arm.MACHINE)
        shutil.copy(own_arm.__file__, folder)
    model = read_reading_model(path)
    sizes = {"mm": 0.01, "rad": 2e-5}
    scale = np.array(
        [sizes.get(unit, 1e-6 * abs(x)) for unit, x in zip(model.layout.units, model.layout.nominal, strict=True)]
    )
    draws = model.layout.nominal + scale * rng.standard_normal((N_DRAWS, len(scale)))
    commanded = [model.channels[k] for k in model.select(model.commanded)]
    sd = np.array([sizes[one.unit] for one in commanded])
    errors = CommandErrors(np.diag(sd**2), (0.5 * sd) ** 2)
    half = np.where([one.unit == "mm" for one in model.coordinates], 60.0, 0.1)
    reach = np.array([one.reach for one in model.coordinates])
    workspace = model.home_pose + np.outer([-1.0, 1.0], np.where(reach > 0.0, reach, half))
    given = {one: rng.uniform(*GIVEN[one], 40) for one in model.given}
    pose = workspace[0] + np.ptp(workspace, axis=0) * rng.uniform(0.1, 0.9, (40, len(half)))
    measured = model.read(draws.mean(axis=0), pose, given)[:, model.select(model.commanded)]
    files, names = keep_machines([path])
    place = (measured, given, workspace, names[path], files)
    return build_calibrated(model, draws.mean(axis=0), draws, errors, made_up.SOURCE, *place)


def _build_legs(name: str, rng: np.random.Generator) -> CalibratedMachine:
    machine = {
        "telescope": lambda: machines.build_machine("none"),
        "telescope that bends": lambda: machines.build_machine("matrix"),
        "struts without load": lambda: machines.build_machine("none", model="six_ups"),
        "beam": lambda: machines.build_machine("none", model="beam"),
        "hexaglide": lambda: build_machine(SixPus, guided_machines.build_hexaglide(), NoDeformation()),
        "eight legs": lambda: machines.build_machine("none", machines.build_random_mechanism(8, seed=8)),
    }[name]()
    mechanism, theta = machine.mechanism, machine.layout.nominal
    n_legs = mechanism.n_legs
    draws = theta + 1e-3 * machines.spread_of(machine.layout) * rng.standard_normal((N_DRAWS, len(theta)))
    errors = made_up.build_leg_errors(machine, theta, 1e-3, np.full(n_legs, 4e-6))
    made = build_calibrated(Legs(machine), draws.mean(axis=0), draws, errors, made_up.SOURCE)
    share = (0.1 if name == "hexaglide" else 0.3) * rng.uniform(-1, 1, (40, mechanism.n_legs))
    return replace(made, measured=mechanism.initial_actuator_positions + share * mechanism.actuator_range)


@pytest.fixture(scope="module", params=[*LEGS, *FILES])
def machine(request, tmp_path_factory) -> CalibratedMachine:
    return build(request.param, tmp_path_factory.mktemp("machine"))


def visit(machine: CalibratedMachine, n: int):
    """Return commands (n, C) that close, and what is given of each pose."""
    if len(machine.commanded) > 6:  # of redundant legs few combinations are those of one pose
        return sample_region(machine, enclose_measured(machine), 16, 3)[:n], {}
    return sample_range(machine, 32, 3)[:n], machine.typical(n)


def test_commands_of_predicted_poses_are_those_given(machine):
    commands, given = visit(machine, 12)
    found = predict_poses(machine, commands, given)
    assert found.found.all()
    again = compensate_poses(machine, found.pose, given, coordinates=True)
    assert again.reached.all()
    size = 1.0 + np.abs(commands)
    np.testing.assert_allclose(again.commands / size, commands / size, rtol=0, atol=2e-6)
    assert np.isfinite(again.covariance).all()
    if len(machine.model.tool_channels) >= len(machine.model.coordinates):
        by_tool = compensate_poses(machine, found.tool, given)
        np.testing.assert_allclose(by_tool.commands / size, commands / size, rtol=0, atol=2e-6)


@pytest.mark.parametrize("unit", ["own", "data's"])
def test_a_predicted_table_is_one_of_poses_to_command(machine, tmp_path, unit):
    """The table that predict writes leads back to the commands, in the units of the data's tables."""
    if unit != "own":
        shown = {"rad": "deg", "mm": "um"}
        machine = replace(machine, units={one.name: shown[one.unit] for one in machine.command_channels})
    commands, given = visit(machine, 6)
    names, found = [f"P{k}" for k in range(len(commands))], predict_poses(machine, commands, given)
    table, answer = tmp_path / "poses.csv", tmp_path / "commands.csv"
    table.write_text(format_prediction(machine, names, found, given))
    wanted = read_commanded(table, machine)
    again = compensate_poses(machine, wanted.poses, wanted.given, wanted.coordinates)
    answer.write_text(format_command(machine, wanted.names, again, wanted.given))
    ends = {"own": ("_mm", "_rad"), "data's": ("_um", "_deg")}[unit]
    for one in machine.command_channels:
        assert f"{one.stem}{ends[one.unit == 'rad']}" in answer.read_text().splitlines()[4].split(",")
    assert read_commands(answer, machine)[0] == tuple(names)
    size = 1.0 + np.abs(commands)
    np.testing.assert_allclose(read_commands(answer, machine)[1] / size, commands / size, rtol=0, atol=3e-6)


def test_a_table_of_two_poses_at_once_is_refused(machine, tmp_path):
    if is_pose(machine):
        pytest.skip("its tool is its coordinates")
    commands, given = visit(machine, 3)
    found = predict_poses(machine, commands, given)
    tool = found.tool.copy()
    tool[1, 0] += 0.2 * np.ptp(tool[:, 0]) + 20.0
    table = tmp_path / "poses.csv"
    table.write_text(format_prediction(machine, ["A", "B", "C"], replace(found, tool=tool), given))
    with pytest.raises(InputError, match=r"line \d+: tool_"):
        read_commanded(table, machine)


def test_covariances_are_those_of_drawn_machines(machine):
    """Simulated machines, each with errors of its own: 600 draws tell a standard deviation to 2.9 %."""
    commands, given = visit(machine, 3)
    found = predict_poses(machine, commands, given)
    drawn = draw_poses(machine, commands, N_DRAWS, np.random.default_rng(1), given)
    apart = machine.comparison.subtract(drawn, found.tool)
    np.testing.assert_allclose(apart.std(axis=0) / found.sd, 1.0, atol=0.12)
    assert np.abs(apart.mean(axis=0) / found.sd).max() < 0.18
    white = np.linalg.solve(np.linalg.cholesky(found.covariance), apart[..., None])[..., 0]
    correlation = np.einsum("spi,spj->pij", white, white) / N_DRAWS
    np.testing.assert_allclose(correlation, np.broadcast_to(np.eye(white.shape[-1]), correlation.shape), atol=0.2)
    budget = compute_budget(machine, commands, given)
    np.testing.assert_allclose(budget.combined, found.covariance, rtol=1e-6, atol=1e-18)
    assert (budget.sd(GEOMETRY) < found.sd).all()


def test_commands_vary_as_those_of_drawn_machines(machine):
    commands, given = visit(machine, 3)
    pose = machine.model.locate(machine.theta, commands, given)[0]
    found = compensate_poses(replace(machine, errors=machine.errors.without_noise()), pose, given, coordinates=True)
    rows = {name: value[None] for name, value in given.items()}
    read = machine.model.read(machine.thin(N_DRAWS)[:, None], pose, rows)[..., machine.commanded]
    variance = (
        read.var(axis=0)
        + np.diagonal(found.covariance, axis1=1, axis2=2)
        - np.diagonal(compensate_poses(_exact(machine), pose, given, coordinates=True).covariance, axis1=1, axis2=2)
    )
    np.testing.assert_allclose(np.sqrt(variance) / found.sd, 1.0, atol=0.12)


def _exact(machine: CalibratedMachine) -> CalibratedMachine:
    n = len(machine.commanded)
    return replace(machine, errors=CommandErrors(np.zeros((n, n)), np.zeros(n)))


def test_exported_and_read_again_predicts_alike(machine, tmp_path):
    machine = replace(
        machine,
        units=dict.fromkeys(machine.model.commanded, "um" if machine.command_channels[0].unit == "mm" else "deg"),
    )
    written = export_machine(machine, tmp_path / "out")
    again = read_exported(tmp_path / "out")
    assert again.units == machine.units
    assert {path.suffix for path in written} >= {".toml", ".csv", ".nc"}
    assert (again.source, again.names) == (machine.source, machine.names)
    np.testing.assert_array_equal(again.draws, machine.draws)
    commands, given = visit(machine, 4)
    one, other = predict_poses(machine, commands, given), predict_poses(again, commands, given)
    np.testing.assert_allclose(other.tool, one.tool, rtol=0, atol=1e-9)
    np.testing.assert_allclose(other.covariance, one.covariance, rtol=1e-6, atol=1e-18)
    np.testing.assert_allclose(again.measured, machine.measured, rtol=0, atol=1e-6)
    np.testing.assert_allclose(bound_workspace(again), bound_workspace(machine), rtol=1e-12)


def test_a_certificate_or_the_reason_why_not(machine, tmp_path):
    found = certify(machine, tmp_path, CertificateOptions(n_poses=16, n_draws=100))
    figures = found.list_figures()
    names = [one.name for one in machine.model.tool_channels]
    assert list(figures["standard_uncertainty"]["combined"]) == names
    assert "40" in figures["workspace"].split()
    page, why = build_certificate(found), check_standards(machine)
    assert page.headline == state_headline(found)
    shown = {section.anchor: section.blocks for section in page.sections}["figures"]
    if why:
        assert f"Not meaningful: {why}." == shown[0].text
        with pytest.raises(InputError, match="cube: "):
            certify(machine, tmp_path, CertificateOptions(n_poses=16, n_draws=20, cube_mm=1.0))
    else:
        assert found.poses.accuracy.shape == (100, 5)
        assert len(found.axes) == len(machine.lengths)


@pytest.mark.parametrize("name", ["delta", "arm", "hangprinter"])
def test_what_is_out_of_reach_says_why(name, tmp_path):
    machine = build(name, tmp_path)
    far = np.repeat(machine.model.home_pose[None], 2, axis=0)
    far[1] += 4.0 if name == "arm" else 900.0
    found = compensate_poses(machine, far, coordinates=True)
    assert found.reached.tolist() == [True, name != "delta"]
    if name == "delta":
        assert "s[1]" in found.faults[1]
    away = machine.model.tool_values(machine.theta, machine.model.home_pose[None]) + 2e3
    if name != "hangprinter":
        assert not compensate_poses(machine, away).reached[0]


def test_redundant_commands_are_weighed_by_their_noise(tmp_path):
    """Four lines to a point: a command that contradicts the others moves it less, the noisier it is."""
    machine = build("hangprinter", tmp_path)
    commands = machine.model.read(machine.theta, machine.model.home_pose[None])[:, machine.commanded]
    wrong = commands + np.array([0.01, 0.0, 0.0, 0.0])
    noise = machine.errors.noise.copy()
    noise[0, 0] *= 1e4
    deaf = replace(machine, errors=replace(machine.errors, noise=noise))
    true, moved, still = (
        predict_poses(one, told).tool for one, told in ((machine, commands), (machine, wrong), (deaf, wrong))
    )
    assert np.linalg.norm(still - true) < 1e-3 * np.linalg.norm(moved - true)
    assert np.linalg.norm(moved - true) > 1e-3


# --- what is refused -------------------------------------------------------------------------------------------------


def test_the_code_of_a_strangers_class_is_not_run_unasked(tmp_path, refuse_line, request):
    machine = build("arm", tmp_path)
    export_machine(machine, tmp_path / "out")
    source = tmp_path / "out" / "own_arm.py"
    request.getfixturevalue("distrust")
    with pytest.raises(InputError, match=r"machine\.toml: kind: .* \(own_arm\.py in .*bayescal trust"):
        read_exported(tmp_path / "out")
    source.write_text(source.read_text() + "\nraise SystemExit\n")
    refuse_line(lambda: read_exported(tmp_path / "out"), "own_arm.py: differs")


@pytest.fixture
def refuse_line(tmp_path):
    """Return a function that checks that a call is refused in one line and leaves the folder as it was."""

    def check(call, expected: str) -> None:
        before = studies.snapshot(tmp_path)
        assert expected in line_of(call)
        assert studies.snapshot(tmp_path) == before

    return check


@pytest.mark.parametrize(
    ("name", "what", "expected"),
    [
        ("delta", "urdf", "found no legs"),
        ("arm", "genhexkins", "format genhexkins: machine 'arm': found no legs"),
        ("hangprinter", "mechanism", "found no legs"),
    ],
)
def test_formats_of_legs_are_refused(name, what, expected, tmp_path, refuse_line):
    machine = build(name, tmp_path)
    refuse_line(lambda: export_machine(machine, tmp_path / "out", what), expected)


def test_commands_that_do_not_determine_a_pose_are_not_meaningful(tmp_path, refuse_line):
    machine = build("delta", tmp_path)
    few = replace(machine, model=machine.model.pick(np.array([0, 1, 3])), errors=CommandErrors(np.eye(2), np.zeros(2)))
    reason = "not meaningful: 2 commanded channels (s[1], s[2]) do not determine its 3 coordinates (x, y, z)"
    refuse_line(lambda: predict_poses(few, np.zeros((1, 2))), reason)
    refuse_line(lambda: compute_budget(few, np.zeros((1, 2))), reason)
    assert np.isfinite(compensate_poses(few, few.model.home_pose[None], coordinates=True).commands).all()


def test_a_tool_of_fewer_numbers_than_coordinates_commands_nothing(tmp_path, refuse_line):
    machine = build("sliding platform", tmp_path)
    assert not is_pose(machine)
    reason = "2 tool numbers for 3 coordinates, expected x, y, phi"
    refuse_line(lambda: compensate_poses(machine, np.zeros((1, 2))), reason)


def test_what_is_given_has_to_be_there(tmp_path, refuse_line):
    machine = build("struts", tmp_path)
    commands, _ = visit(machine, 2)
    refuse_line(lambda: predict_poses(machine, commands), "found no elevation_deg for 2 poses")


def test_parameters_are_exported_with_their_covariance(tmp_path):
    machine = build("delta", tmp_path)
    for name in ("parameters", "toml", "json", "csv"):
        assert export_machine(machine, tmp_path / name, name)
    content = json.loads((tmp_path / "json" / "machine.json").read_text())
    np.testing.assert_array_equal(content["covariance"], machine.covariance)
    assert content["parameters"]["l"]["mean"] == machine.model.layout.take(machine.theta, "l").tolist()
    assert content["tool"] == ["x [mm]", "y [mm]", "z [mm]"]
