"""Accuracy of sets of sensors against independent forms; symmetry; reasons; simulated calibrations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from placement_problems import FOLDER, read, shrink

from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.sensor_placement.alignment import alignment_basis, take_away
from bayescal.experiments.sensor_placement.inputs import displace, read_placement
from bayescal.experiments.sensor_placement.placement import (
    Accuracy,
    build_placement,
    compute_information,
    evaluate_set,
    evaluate_sets,
    is_external,
)
from bayescal.experiments.sensor_placement.simulate import simulate_set
from bayescal.experiments.shared.sensor_sets import compute_tool_sensitivity, eliminate_poses
from bayescal.numerics.geometry import matrix_from_rotation_vector, rotation_vector_from_matrix

MACHINES = ("sensors", "m2_hexapod_sensors")
FRAMES = ("aligned", "given", "instrument")


def members(inputs, *names: str) -> np.ndarray:
    return inputs.set_of(list(names)) @ inputs.members


# --- against independent forms ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", MACHINES)
def test_information_is_that_of_rows_without_poses(name):
    """Random sets: posterior covariances by sums of sensors and by orthogonal rows agree, whatever the condition."""
    inputs = read(name)
    placement, sets = build_placement(inputs), inputs.enumerate_sets()
    worst, n = 0.0, len(inputs.free)
    for k in np.random.default_rng(1).permutation(len(sets))[:60]:
        chosen = sets[k] @ inputs.members
        found = compute_information(placement, chosen)
        if found is None:
            continue
        here = inputs.sensors.select(np.flatnonzero(chosen)).linearise(inputs.model.layout.nominal, inputs.pose)
        rows = (eliminate_poses(here)[..., inputs.free] * inputs.tolerances).reshape(-1, n)
        one, other = (np.linalg.inv(np.eye(n) + info) for info in (found, rows.T @ rows))
        scale = np.sqrt(np.diag(other))
        worst = max(worst, float(np.abs((one - other) / scale / scale[:, None]).max()))
    assert 0.0 < worst < 1e-5


@pytest.mark.parametrize("frames", FRAMES)
@pytest.mark.parametrize("name", MACHINES)
def test_accuracy_is_that_of_the_tool_sensitivity(name, frames):
    """Explicit covariances at every pose of the workspace, from the functions that calibrations use."""
    inputs = read(name, frames=frames)
    placement = build_placement(inputs)
    chosen = np.ones(len(inputs.sensors.chosen), dtype=bool)
    found = evaluate_set(placement, chosen)
    information = compute_information(placement, chosen)
    covariance = np.linalg.inv(np.eye(len(information)) + information) * np.outer(inputs.tolerances, inputs.tolerances)
    in_use = inputs.sensors.select(np.flatnonzero(~is_external(inputs.sensors)))
    sensitivity = compute_tool_sensitivity(in_use, inputs.model.layout.nominal, inputs.workspace)
    slope = sensitivity.by_parameters[..., inputs.free]
    field = slope.reshape(-1, slope.shape[-1])
    if frames == "aligned":
        keep = np.eye(len(field)) - placement.aligned @ placement.aligned.T
        field = keep @ field
    calibration = np.diag(field @ covariance @ field.T).reshape(len(slope), -1).sum(axis=1)
    noise = np.trace(sensitivity.noise_covariance, axis1=1, axis2=2)
    assert found.calibration == pytest.approx(np.sqrt(calibration.mean()), rel=1e-6)
    assert found.noise == pytest.approx(np.sqrt(noise.mean()), rel=1e-9)
    assert found.rms == pytest.approx(np.sqrt((calibration + noise).mean()), rel=1e-6)
    assert found.largest == pytest.approx(np.sqrt((calibration + noise).max()), rel=1e-6)


# --- frames ----------------------------------------------------------------------------------------------------------


def test_setting_up_takes_away_motions_and_nothing_else():
    inputs = read("sensors")
    model, pose = inputs.model, inputs.workspace
    position, _, _ = model.tool(model.layout.nominal, pose)
    basis = alignment_basis(model, position, pose)
    turn = position @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    offset = model.rotation(pose) @ np.array([0.3, -0.7])
    for field in (np.tile([1.0, 2.0], len(pose)), turn.ravel(), offset.ravel()):
        assert np.abs(take_away(basis, field[:, None])).max() < 1e-9 * np.abs(field).max()
    stretched = position.ravel()[:, None]  # a wrong scale is no motion
    assert np.linalg.norm(take_away(basis, stretched)) > 0.5 * np.linalg.norm(stretched)


def test_a_machine_that_hardly_turns_has_no_tool_to_set_up():
    inputs = read("m2_hexapod_sensors")
    assert build_placement(inputs).aligned.shape[1] == 6


def test_which_leg_carries_the_frames_does_not_matter():
    """Poses that are the same from each side of the star: sets that a quarter turn maps onto each other are equal."""
    inputs = read("sensors")
    rng = np.random.default_rng(5)

    def orbit(n):
        some = rng.uniform(-1.0, 1.0, (n, 3)) * np.array([200.0, 200.0, np.radians(30.0)])
        turns = [some]
        for _ in range(3):
            x, y, angle = turns[-1].T
            turns.append(np.stack([-y, x, angle], axis=1))
        return displace(inputs.model, np.concatenate(turns))

    placement = build_placement(replace(inputs, pose=orbit(5), workspace=orbit(3)))
    sets = [
        [f"s[{leg}]" for leg in (1, 2, 3)] + ["psi[1]", "phi[3]"],
        ["s", "phi[1]", "psi[2]"],
        ["s[1]", "phi[1]", "s[2]", "phi[2]", "psi[2]"],
    ]
    for names in sets:
        errors = []
        for turn in range(4):
            turned = [_turn(name, turn) for name in names]
            errors.append(evaluate_set(placement, members(inputs, *turned)).rms)
        np.testing.assert_allclose(errors, errors[0], rtol=1e-5)


def _turn(name: str, turn: int) -> str:
    kind, _, leg = name.partition("[")
    return name if not leg else f"{kind}[{(int(leg[:-1]) - 1 + turn) % 4 + 1}]"


def test_given_frames_do_privilege_a_leg():
    """The negative control: without setting up, sets that miss the first legs leave the tool to the tolerances."""
    inputs = read("sensors", frames="given")
    placement = build_placement(inputs)
    first, last = (
        members(inputs, *(f"{kind}[{leg}]" for leg in legs for kind in ("s", "phi"))) for legs in ((1, 2), (3, 4))
    )
    assert evaluate_set(placement, first).reason == ""
    assert evaluate_set(placement, last).reason == "tolerances"
    assert evaluate_set(placement, last).rms > 5 * evaluate_set(placement, first).rms


def test_without_an_instrument_its_frame_is_not_known():
    inputs = read("m2_hexapod_sensors", frames="instrument")
    placement = build_placement(inputs)
    without = [f"tilt_{k}[{leg}]" for k in "ab" for leg in (1, 4)]
    assert evaluate_set(placement, members(inputs, *without)).rms > 0.1
    assert evaluate_set(placement, members(inputs, *without, "tracker_position")).rms < 0.03


# --- reasons ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("names", "reason"),
    [
        (["s[1]", "s[2]"], "pose"),
        (["phi[1]", "phi[3]", "s[1]"], "equations"),  # enough for a pose and nothing besides
        (["phi[1]", "psi[1]", "phi[3]"], "pose"),  # guides 1 and 3 are parallel: nothing tells where along them
        (["phi[1]", "psi[1]", "phi[3]", "psi[3]"], "pose"),
        (["s[1]", "s[2]", "s[3]"], "equations"),
        (["phi[1]", "psi[1]", "phi[2]", "psi[2]"], "tolerances"),  # angles alone have no scale
        (["s", "phi"], ""),
        (["s", "phi", "psi"], ""),
    ],
)
def test_reasons(names, reason):
    inputs = read("sensors")
    accuracy = evaluate_set(build_placement(inputs), members(inputs, *names))
    assert accuracy.reason == reason
    assert np.isnan(accuracy.rms) == (reason == "pose")


def test_encoders_alone_tell_nothing_of_a_hexapod():
    inputs = read("m2_hexapod_sensors")
    accuracy = evaluate_set(build_placement(inputs), members(inputs, "rho"))
    assert accuracy.reason == "equations"
    assert accuracy.calibration == pytest.approx(accuracy.beforehand, rel=1e-6)


def test_external_sensors_do_not_count_in_use():
    """An instrument beside the machine cannot locate the tool when it is gone."""
    config = shrink("sensors")
    sensors = {
        "s[1]": config.sensors["s"],
        "outside": config.sensors["s"].model_copy(update={"reads": ["x_V", "y_V"]}),
        "turned": config.sensors["phi"].model_copy(update={"reads": ["phi_V"]}),
        "s[2]": config.sensors["s"],
        "s[3]": config.sensors["s"],
    }
    inputs = read_placement(config.model_copy(update={"sensors": sensors, "named": {}}), FOLDER)
    placement = build_placement(inputs)
    assert evaluate_set(placement, members(inputs, "s[1]", "s[2]", "outside", "turned")).reason == "pose"
    assert evaluate_set(placement, members(inputs, "s", "outside", "turned")).reason == ""


def test_a_zero_is_unknown_only_where_its_sensor_is():
    config = shrink("sensors")
    worse = config.tolerances.model_copy(update={"zero_deg": 4.0})
    inputs, other = read("sensors"), read_placement(config.model_copy(update={"tolerances": worse}), FOLDER)
    chosen = members(inputs, "s")
    here, there = (evaluate_set(build_placement(one), chosen) for one in (inputs, other))
    assert here == there
    with_angles = members(inputs, "s", "phi")
    before = [evaluate_set(build_placement(one), with_angles).beforehand for one in (inputs, other)]
    assert before[1] > 1.5 * before[0]


def test_sets_evaluated_in_parts_are_those_evaluated_together():
    """As tasks divide them; that workers change nothing is in the contract of all kinds."""
    inputs = read("sensors")
    sets = (inputs.enumerate_sets() @ inputs.members)[1000:1060]
    placement = build_placement(inputs)
    parts = {f"{k}": part for k, part in enumerate(np.array_split(sets, 8))}
    found = Run().map("sets", evaluate_sets, placement, parts, (Accuracy,)).values()
    assert repr([accuracy for part in found for accuracy in part]) == repr(evaluate_sets(placement, sets))


# --- simulated -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "names", "frames"),
    [
        ("sensors", ["s", "phi"], "aligned"),
        ("sensors", ["s", "phi"], "given"),
        ("m2_hexapod_sensors", ["tracker_position"], "aligned"),
    ],
)
def test_predictions_come_true(name, names, frames):
    inputs = read(name, machines=60, workspace_poses=16, frames=frames)
    placement, chosen = build_placement(inputs), members(inputs, *names)
    predicted, found = evaluate_set(placement, chosen), simulate_set(inputs, placement, chosen, 1)
    assert (found.n_machines, found.n_failed) == (60, 0)
    assert abs(found.rms - predicted.rms) < 3.5 * found.error
    assert found.error < 0.15 * found.rms
    # negative controls: neither the noise alone nor the machine uncalibrated is what comes out
    assert abs(found.rms - predicted.noise) > 3.5 * found.error
    assert abs(found.rms - predicted.beforehand) > 3.5 * found.error


def test_displacements_of_a_spatial_machine_turn_about_home():
    inputs = read("m2_hexapod_sensors")
    moved = displace(inputs.model, np.array([[1.0, 2.0, 3.0, 0.01, -0.02, 0.03]]))[0]
    np.testing.assert_allclose(moved[:3] - inputs.model.home_pose[:3], [1.0, 2.0, 3.0], atol=1e-12)
    turned = matrix_from_rotation_vector(moved[3:]) @ inputs.model.rotation(inputs.model.home_pose).T
    np.testing.assert_allclose(rotation_vector_from_matrix(turned), [0.01, -0.02, 0.03], atol=1e-12)
