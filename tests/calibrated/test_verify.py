"""Reverifications: statistics against brute force, short plans that keep their promise, the command."""

from __future__ import annotations

import re
from dataclasses import replace

import calibrated_machines as made_up
import guided_machines
import numpy as np
import pytest
import telescope_machines as machines
from scipy.stats import norm

from bayescal.calibrated.formats import export_machine
from bayescal.calibrated.machine import CalibratedMachine
from bayescal.calibrated.verify.plan import (
    VerificationGoal,
    build_covariance,
    expect_pose,
    list_candidates,
    place_poses,
    plan_reverification,
)
from bayescal.calibrated.verify.statistics import (
    build_test,
    choose_suspects,
    judge_reverification,
    predict_knowledge,
)
from bayescal.data.actuators import name_actuators
from bayescal.data.measured_poses import MeasuredPoses
from bayescal.experiments.shared.pose_readings import find_reverification_slip
from bayescal.machines.deformations import NoDeformation
from bayescal.machines.kinematics import build_machine, solve_forward_kinematics
from bayescal.machines.models.six_pus import SixPus
from bayescal.machines.readings import Legs
from bayescal.numerics.geometry import matrix_from_rotation_vector, rotation_vector_from_matrix

NOISE = build_covariance(15.0, 15.0)


def demand(shift: float = 0.02, sessions: int = 2, n: int = 6) -> VerificationGoal:
    return VerificationGoal(np.full(n, shift), sessions=sessions)


def plan_legs(calibrated, candidates, wanted: VerificationGoal):
    """Return a plan for shifts of the legs' lengths, found by measured poses."""
    suspects = choose_suspects(calibrated, ())
    return plan_reverification(calibrated, suspects, candidates, {}, expect_pose(calibrated, NOISE), wanted)


def predict_legs(calibrated, actuators):
    suspects = choose_suspects(calibrated, ())
    return predict_knowledge(calibrated, suspects, actuators, {}, expect_pose(calibrated, NOISE))


def read_legs(session: MeasuredPoses):
    """Return a session's poses as readings of legs."""
    values = np.concatenate([session.position, rotation_vector_from_matrix(session.rotation)], axis=1)
    return place_poses(session.names, session.actuators, values, session.covariance)


def judge_legs(calibrated, sessions, false_alarm: float, n_looks: int):
    return judge_reverification(
        calibrated, choose_suspects(calibrated, ()), list(map(read_legs, sessions)), false_alarm, n_looks
    )


@pytest.fixture(scope="module")
def calibrated() -> CalibratedMachine:
    """Return the telescope calibrated to some micrometres, made up."""
    return made_up.build_made_up(machines.build_machine("none"), np.random.default_rng(4), scale=1e-3)


@pytest.fixture(scope="module")
def candidates(calibrated) -> np.ndarray:
    """Return some of all candidates, among which a plan is found in no time."""
    return list_candidates(calibrated, 0.8)[0][::20]


@pytest.fixture(scope="module")
def plan(calibrated, candidates):
    return plan_legs(calibrated, candidates, demand())


def measure(calibrated, actuators, rng, shift=0.0, leg=0) -> MeasuredPoses:
    """Return measured poses of a machine with one leg longer by a shift, mm."""
    theta = calibrated.theta.copy()
    theta[calibrated.legs.layout.index["l"][leg]] += shift
    found = solve_forward_kinematics(calibrated.legs, theta, actuators)
    here = calibrated.legs.linearise(theta, found.position, found.rotation, actuators)
    pose = np.concatenate([found.position, rotation_vector_from_matrix(found.rotation)], axis=1)
    spread = here.actuators @ calibrated.errors.covariance(pose, actuators) @ np.swapaxes(here.actuators, 1, 2)
    legs = np.einsum("pij,pj->pi", np.linalg.cholesky(spread), rng.standard_normal(actuators.shape))
    noise = rng.multivariate_normal(np.zeros(6), NOISE, len(actuators))
    noise += np.linalg.solve(here.pose, legs[..., None])[..., 0]
    rotation = matrix_from_rotation_vector(noise[:, 3:]) @ found.rotation
    names = tuple(f"R{k:02d}" for k in range(1, len(actuators) + 1))
    return MeasuredPoses(names, found.position + noise[:, :3], rotation, np.tile(NOISE, (len(noise), 1, 1)), actuators)


def test_adding_a_pose_is_adding_its_matrix(calibrated, plan):
    knowledge = predict_legs(calibrated, plan.commands)
    gram = knowledge.gram[:2].sum(axis=0)
    expected = np.diagonal(knowledge.score(3 * (gram + knowledge.gram))[1], axis1=1, axis2=2)
    np.testing.assert_allclose(knowledge.add_each(gram, 3), expected, rtol=1e-8)


def test_the_threshold_of_independent_legs_is_sidaks():
    test = build_test(np.eye(5)[None] * np.arange(1.0, 6.0), 0.05)
    assert test.threshold == pytest.approx(norm.isf(0.5 * (1.0 - 0.95 ** (1 / 5))), abs=0.02)
    power = build_test(9.0 * np.eye(5)[None] * np.arange(1.0, 6.0), 0.05).find_power()
    assert (np.diff(power) > 0.0).all()  # the more is known of a leg
    own = norm.sf(test.threshold - 3.0 * np.sqrt(5.0))
    assert own < power[-1] < own + 0.05


def test_a_plan_keeps_its_promise_with_as_few_poses_as_any(calibrated, candidates):
    """Two poses do what no single one out of the same candidates does."""
    wanted = demand(0.03, sessions=1)
    plan = plan_legs(calibrated, candidates, wanted)
    assert plan.power.min() >= wanted.power
    assert len(set(plan.chosen)) == len(plan.chosen) == 2
    knowledge = predict_legs(calibrated, candidates)
    knowledge = knowledge.scale(wanted.shift)
    alone = [build_test(knowledge.score(one)[1][None], wanted.false_alarm) for one in knowledge.gram[:12]]
    assert max(test.find_power().min() for test in alone) < wanted.power


def test_more_sessions_take_fewer_poses(calibrated, candidates, plan):
    alone = plan_legs(calibrated, candidates, demand(sessions=1))
    assert len(alone.chosen) > len(plan.chosen) > 1
    assert plan.power_by_session[0] < plan.power_by_session[1] == plan.power.min()


def test_candidates_lie_within_the_share_of_the_range(calibrated):
    mechanism = calibrated.legs.mechanism
    moves = list_candidates(calibrated, 0.5)[0] - mechanism.initial_actuator_positions
    assert np.abs(moves).max() == pytest.approx(0.5 * mechanism.actuator_range)
    assert len(moves) > 700


def test_redundant_legs_close_at_the_candidates():
    """Actuators of eight legs cannot be combined at will: the platform is moved, and the legs follow."""
    mechanism = guided_machines.build_guided("star", 3, n_legs=8)
    machine = build_machine(SixPus, mechanism, NoDeformation())
    source, errors = made_up.SOURCE, made_up.build_leg_errors(machine, machine.layout.nominal, 1e-3, np.zeros(8))
    free = np.arange(machine.layout.size)
    covariance = 1e-6 * np.eye(len(free))
    calibrated = CalibratedMachine(Legs(machine), machine.layout.nominal, free, covariance, None, errors, source)
    actuators, _ = list_candidates(calibrated, 0.5)
    assert len(actuators) > 100
    moves = np.abs(actuators - mechanism.initial_actuator_positions)
    assert moves.max() <= mechanism.actuator_range
    found = solve_forward_kinematics(machine, calibrated.theta, actuators)
    here = machine.linearise(calibrated.theta, found.position, found.rotation, actuators)
    np.testing.assert_allclose(here.residual, 0.0, atol=1e-6)
    plan = plan_legs(calibrated, actuators[:40], demand(0.05, sessions=1, n=8))
    assert (len(plan.power), plan.power.min() >= 0.95) == (8, True)


# --- the command -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def exported(calibrated, tmp_path_factory):
    folder = tmp_path_factory.mktemp("exported") / "machine"
    export_machine(calibrated, folder, "mechanism")
    return folder


@pytest.fixture(scope="module")
def listed(candidates, tmp_path_factory):
    """Return a file of the candidates."""
    path = tmp_path_factory.mktemp("candidates") / "candidates.csv"
    rows = [",".join([f"C{k}", *(repr(float(x)) for x in one)]) for k, one in enumerate(candidates)]
    path.write_text("\n".join([",".join(["pose", *name_actuators(6)]), *rows]) + "\n")
    return path


def write_measured(path, session: MeasuredPoses, with_actuators: bool = False) -> None:
    angles = np.degrees(rotation_vector_from_matrix(session.rotation))
    columns = ["pose", "x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg"]
    rows = np.concatenate([session.position, angles], axis=1)
    if with_actuators:
        columns += ["use", *name_actuators(6)]
    lines = [",".join(columns)]
    for name, row, rho in zip(session.names, rows, session.actuators, strict=True):
        more = ["calibration", *(f"{x:.6f}" for x in rho)] if with_actuators else []
        lines.append(",".join([name, *(f"{x:.9f}" for x in row), *more]))
    path.write_text("\n".join(lines) + "\n")


NOISE_OPTIONS = ("--position-um", "15", "--orientation-arcsec", "15")


def test_an_operator_takes_the_plan_and_brings_poses_back(calibrated, exported, listed, plan, call, tmp_path, rng):
    table = tmp_path / "plan.csv"
    code, said, complaint = call("verify", exported, *NOISE_OPTIONS, "--candidates", listed, "--out", table)
    assert (code, complaint) == (0, "")
    assert re.search(rf"^{len(plan.chosen)} poses: .*\b20 µm", said, re.MULTILINE)
    rows = [line for line in table.read_text().splitlines() if not line.startswith("#")]
    assert rows[0] == "pose,use," + ",".join(name_actuators(6))
    np.testing.assert_allclose(np.array([row.split(",")[2:] for row in rows[1:]], dtype=float), plan.commands)
    for shift, expected in ((0.0, r"the calibration holds"), (0.08, r"leg 4 .* \+\d")):
        write_measured(tmp_path / "poses.csv", measure(calibrated, plan.commands, rng, shift, 3))
        judged = ("--measured", tmp_path / "poses.csv", "--actuators", table)
        code, said, complaint = call("verify", exported, *NOISE_OPTIONS, *judged)
        assert (code, complaint) == (0, "")
        assert re.match(expected, said), said
    write_measured(tmp_path / "whole.csv", measure(calibrated, plan.commands, rng, 0.08, 3), True)
    both = ("--measured", tmp_path / "poses.csv", "--measured", tmp_path / "whole.csv")
    write_measured(tmp_path / "poses.csv", measure(calibrated, plan.commands, rng, 0.08, 3), True)
    assert re.match(r"leg 4 .* \+\d", call("verify", exported, *NOISE_OPTIONS, *both)[1])


@pytest.mark.parametrize(
    ("mend", "said"),
    [
        (lambda rho: np.roll(rho, 1, axis=0), "rows of rho seem shifted"),
        (lambda rho: rho[:, [0, 2, 1, 3, 4, 5]], "readings of rho[2] and rho[3] seem to be exchanged"),
    ],
)
def test_a_slip_is_said_before_any_leg_is_accused(mend, said, calibrated, candidates):
    rng = np.random.default_rng(3)
    session = measure(calibrated, candidates[rng.choice(len(candidates), 5, replace=False)], rng, 0.3, 3)
    assert find_reverification_slip(calibrated, session) is None
    found = find_reverification_slip(calibrated, replace(session, actuators=mend(session.actuators)))
    assert said in found.say()


COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")
SD = np.array([15.0, 15.0, 15.0, *(np.sqrt(np.diag(NOISE))[3:] * 1e6)])  # µm and µrad
LIKE = {
    "covariances": {
        f"cov_{one}_{other}": SD[i] ** 2 if one == other else 0.0
        for i, one in enumerate(COMPONENTS)
        for other in COMPONENTS[i:]
    },
    "standard deviations": {  # as ``bayescal init`` writes poses
        **{"x_mm": 1.0, "y_mm": 2.0, "z_mm": 3.0},
        **{f"sd_{one}_{'um' if i < 3 else 'urad'}": SD[i] for i, one in enumerate(COMPONENTS)},
    },
    "none": {"x_mm": 1.0, "y_mm": 2.0, "z_mm": 3.0},
}


@pytest.mark.parametrize("noise", LIKE)
def test_the_noise_may_come_from_a_table_of_poses(noise, exported, listed, plan, call, tmp_path):
    path, cells = tmp_path / "like.csv", LIKE[noise]
    path.write_text(f"pose,{','.join(cells)}\nC01,{','.join(f'{one:.9g}' for one in cells.values())}\n")
    code, said, complaint = call("verify", exported, "--noise-from", path, "--candidates", listed)
    if noise == "none":
        assert "expected cov_x_x ... cov_rz_rz or sd_x_um ... sd_rz_urad" in complaint
    else:
        assert (code, complaint) == (0, "")
        assert said.count("\nR") == len(plan.chosen)


def test_positions_alone_may_be_measured(calibrated, plan, rng):
    """Three readings more than coordinates of the pose: a large shift is seen, less surely than with rotations."""
    session = measure(calibrated, plan.commands, rng, 0.3, 2)
    values = np.concatenate([session.position, np.full_like(session.position, np.nan)], axis=1)
    positions = place_poses(session.names, session.actuators, values, session.covariance)
    suspects = choose_suspects(calibrated, ())
    alone = judge_reverification(calibrated, suspects, [positions], 0.01, 1)
    assert not alone.holds
    assert (alone.sd > judge_legs(calibrated, [session], 0.01, 1).sd).all()


def spoil(tmp_path, session):
    write_measured(tmp_path / "poses.csv", session)
    return ("--measured", tmp_path / "poses.csv")


FAULTS = {
    "no noise": (lambda folder, session: (), "found no pose noise"),
    "half of it": (
        lambda folder, session: ("--position-um", "4"),
        "expected both --position-um and --orientation-arcsec",
    ),
    "no positions": (
        lambda folder, session: (*NOISE_OPTIONS, *spoil(folder, session)),
        "found no columns rho_1_mm to rho_6_mm",
    ),
    "no file": (lambda folder, session: (*NOISE_OPTIONS, "--measured", folder / "none.csv"), "no such file"),
    "too little": (
        lambda folder, session: (*NOISE_OPTIONS, "--shift-um", "0.5", "--range-fraction", "0.2"),
        "larger shift, more sessions",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_at_fault_is_one_line(fault, calibrated, exported, plan, refuse, tmp_path, rng):
    make, expected = FAULTS[fault]
    arguments = make(tmp_path, measure(calibrated, plan.commands, rng))
    refuse(expected, tmp_path / "new.csv", "verify", exported, *arguments)


def test_a_posterior_that_did_not_converge_is_refused(calibrated, listed, call, tmp_path):
    unreliable = replace(calibrated, source=replace(calibrated.source, problems=("R-hat 1.2",)))
    export_machine(unreliable, tmp_path / "machine", "mechanism")
    options = (*NOISE_OPTIONS, "--candidates", listed)
    code, said, complaint = call("verify", tmp_path / "machine", *options)
    assert (code, said, complaint.count("\n")) == (2, "", 1)
    assert "(R-hat 1.2)" in complaint
    assert call("verify", tmp_path / "machine", *options, "--allow-unconverged")[0] == 0
