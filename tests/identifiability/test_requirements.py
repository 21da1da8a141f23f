"""What accuracy remains, to first order and by draws, what would help, and designs that cannot be."""

from __future__ import annotations

from dataclasses import replace

import audit_problems as problems
import numpy as np
import pytest
import telescope_machines as machines
from scipy.stats import norm

from bayescal.errors import NumericalError
from bayescal.experiments.audit.audit import analyse, evaluate_change, run_audit
from bayescal.experiments.audit.design import load_audit, read_plans
from bayescal.experiments.audit.machine import locate
from bayescal.experiments.audit.results import summarise, tabulate, tabulate_variants
from bayescal.experiments.audit.schema import ScenarioConfig
from bayescal.experiments.runner.parallel import Run
from bayescal.identifiability import requirements
from bayescal.identifiability.information import Information, information_of_rows
from bayescal.identifiability.pose_volume import PoseVolume, find_workspace_actuators
from bayescal.identifiability.requirements import (
    Requirement,
    RequirementSummary,
    ToolRemaining,
    WorkspaceErrorModel,
    move_draws,
)
from bayescal.machines.kinematics import check_home_pose, solve_forward_kinematics
from bayescal.machines.readings import Legs
from bayescal.numerics.geometry import compute_pose_error, matrix_from_rotation_vector


@pytest.fixture(scope="module")
def telescope():
    # what its report requires is relative to marks on the base
    return problems.read_shipped("telescope_six_pus_none", accuracy_frame="base", sweep=problems.SHORT_SWEEP)


@pytest.fixture(scope="module")
def audited(telescope):
    audit = run_audit(telescope, Run())
    return audit, summarise(audit)


# --- requirements ------------------------------------------------------------------------------------------------


def test_probability_of_one_pose_and_one_number_is_that_of_a_normal():
    """At a single pose |e_z| is half-normal."""
    knowledge, plan = problems.build_telescope_problem()
    plan = replace(plan, actuators=plan.actuators[:20])
    information = information_of_rows(problems.compute_rows(knowledge, plan), np.ones(len(knowledge.sd)))
    forecast = problems.foretell(knowledge, plan.actuators[:1], plan)
    for limit in (0.0003, 0.0006, 0.0012):
        (outlook,), _ = forecast.judge([Requirement("z", limit)], information, np.random.default_rng(1), ())
        expected = 2 * norm.cdf(limit / outlook.predicted_sd) - 1
        assert outlook.probability == pytest.approx(expected, abs=4 * np.sqrt(0.25 / 2000))


def test_predicted_sd_is_that_of_machines_drawn_from_the_prior(telescope):
    """Before the calibration: tools of machines with small tolerances where these come to stand, encoders erring."""
    model, posterior, around = telescope.variant.model, telescope.posterior, telescope.around
    own = np.flatnonzero(telescope.variant.internal)
    rng, pose = np.random.default_rng(0), around.pose[:4]
    small = 0.01 * rng.standard_normal((4000, len(telescope.names)))
    theta = posterior.sampling.theta_from_y(small)
    read = model.read(posterior.sampling.start, pose)[:, own] + 1e-5 * rng.standard_normal((4000, 4, len(own)))
    stands, found = model.locate(theta[:, None], read)
    assert found.all()
    error = compute_pose_error(
        *(pose[:, :3], matrix_from_rotation_vector(pose[:, 3:])),
        *(stands[..., :3], matrix_from_rotation_vector(stands[..., 3:])),
    )
    forecast = telescope.forecast()
    geometry = 0.01**2 * forecast.covariance(np.eye(len(telescope.names)))[:4]
    expected = np.sqrt(np.diagonal(geometry + 0.01**2 * forecast.noise[:4], axis1=1, axis2=2))  # of 1 µm
    assert error.std(axis=0) / expected == pytest.approx(np.ones((4, 6)), abs=0.05)


def test_nothing_learnt_leaves_everything_as_it_was(telescope):
    n = len(telescope.names)
    forecast = telescope.forecast()
    nothing = Information(np.zeros((1, n)))
    for outlook in forecast.judge(telescope.requirements, nothing, np.random.default_rng(0), ())[0]:
        assert outlook.predicted_sd == pytest.approx(outlook.prior_sd, rel=1e-9)
        assert outlook.probability == pytest.approx(outlook.prior_probability, abs=0.03)


def test_what_fixing_the_rest_costs(telescope):
    """Errors of least squares that takes some parameters for nominal, simulated to first order."""
    information, rng = analyse(telescope).information, np.random.default_rng(4)
    free = analyse(telescope).selection.free
    root, chosen = information.root, np.array(free)
    truth = rng.standard_normal((20_000, root.shape[1]))
    measured = truth @ root.T + rng.standard_normal((20_000, len(root)))
    fitted = np.zeros_like(truth)
    part = root[:, chosen]
    fitted[:, chosen] = measured @ part @ np.linalg.inv(part.T @ part + np.eye(len(free)))
    errors = truth - fitted
    expected = information.errors_of_reduced(free)
    forecast = telescope.forecast()
    found = np.einsum("wji,bi->bwj", forecast.slope[:5], errors).std(axis=0)
    predicted = np.sqrt(np.diagonal(forecast.covariance(expected)[:5], axis1=1, axis2=2))
    assert found / predicted == pytest.approx(np.ones((5, 6)), abs=0.03)


def test_a_limit_on_the_rms_is_kept_where_single_poses_exceed_it():
    """Noise alone: closed forms of 40 poses; what own sensors do not determine has no probability."""
    noise = np.broadcast_to(0.01 * np.eye(2), (40, 2, 2))
    wanted = [Requirement("a", 0.2, ("a", "b"), of) for of in ("rms", "all_poses")]
    nothing = Information(np.zeros((1, 3)))
    forecast = WorkspaceErrorModel(np.zeros((40, 2, 3)), noise)
    (rms, every), together = forecast.judge(wanted, nothing, np.random.default_rng(2), ())
    share = (2.0 * norm.cdf(2.0) - 1.0) ** 40
    assert (rms.probability, rms.everywhere) == (1.0, every.probability)
    assert abs(every.probability - share) < 4.0 * np.sqrt(share * (1.0 - share) / 2000)
    assert together == every.probability
    assert rms.predicted_sd == pytest.approx(0.1)
    (lost, _), none = replace(forecast, slope=np.full((40, 2, 3), np.nan)).judge(
        wanted, nothing, np.random.default_rng(2), ()
    )
    assert (lost.probability, none) == (0.0, 0.0)
    assert np.isnan(lost.predicted_sd)


def test_the_worst_pose_is_where_the_tool_errs_most():
    slope = np.linspace(0.1, 0.3, 7)[:, None, None] * [[[1.0, 0.0], [0.0, -1.0]]]
    wanted = [Requirement(name, 1.0, ("a", "b")) for name in "ab"]
    outlooks, _ = WorkspaceErrorModel(slope, np.zeros((7, 2, 2))).judge(
        wanted, Information(np.zeros((1, 2))), np.random.default_rng(3), ()
    )
    assert [one.worst for one in outlooks] == [6, 6]
    assert [one.worst_sd for one in outlooks] == pytest.approx([0.3, 0.3])


def test_norms_are_stricter_than_their_parts(telescope):
    forecast = telescope.forecast()
    information = analyse(telescope).information
    x, *_ = telescope.requirements
    wanted = [replace(x, limit=0.011), replace(x, name="position", limit=0.011)]
    (x, length), _ = forecast.judge(wanted, information, np.random.default_rng(0), ())
    assert 0.0 < length.probability < x.probability < 1.0
    assert length.predicted_sd > x.predicted_sd


def test_the_telescope_meets_table_1_of_the_report(audited):
    _, summary = audited
    assert set(summary["requirements"]) == {"x", "y", "z", "rx", "ry"}
    limits = {name: outlook["limit"] for name, outlook in summary["requirements"].items()}
    assert limits == pytest.approx({"x": 0.1, "y": 0.1, "z": 0.01, "rx": 0.05, "ry": 0.05})
    for outlook in summary["requirements"].values():
        assert outlook["prior_probability"] < 0.1
        assert outlook["probability"] > 0.99
        assert outlook["predicted_sd"] < outlook["limit"] / 3


# --- workspace ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", ["ellipsoid", "box", "axes"])
def test_workspace_keeps_its_shape(shape):
    half = np.array([2.0, 1.0, 0.0, 0.01, 0.0, 0.02])
    moves = PoseVolume(half, shape, 300).sample(300, 0)
    share = np.divide(moves, half, out=np.zeros_like(moves), where=half > 0)
    assert len(moves) == 300
    assert np.abs(share).max() <= 1.0
    assert np.all(moves[:, half == 0] == 0)
    radius = np.linalg.norm(share, axis=1)
    inside = share[9:]
    if shape == "ellipsoid":
        assert radius.max() <= 1.0 + 1e-12
        assert np.mean(np.linalg.norm(inside, axis=1) ** 4) == pytest.approx(0.5, abs=0.03)  # uniform in a 4-ball
    elif shape == "box":
        assert radius.max() > 1.5
    else:
        assert np.all((inside != 0).sum(axis=1) <= 1)


def test_workspace_actuators_lead_back_to_its_poses():
    machine, workspace = problems.read_machine("camera_hexapod"), PoseVolume(np.full(6, 5e-3), "ellipsoid", 60)
    theta = machine.layout.nominal
    actuators = find_workspace_actuators(machine, theta, workspace, 60, 3)
    home = check_home_pose(machine)
    moves = workspace.sample(60, 3)
    found = solve_forward_kinematics(machine, theta, actuators)
    assert np.abs(found.position - home.position - moves[:, :3]).max() < 1e-8
    assert np.abs(found.rotation - matrix_from_rotation_vector(moves[:, 3:]) @ home.rotation).max() < 1e-11


@pytest.mark.parametrize("shape", ["ellipsoid", "box", "axes"])
def test_poses_of_an_audits_workspace_keep_its_shape(shape):
    """About home, a coordinate without a width staying there."""
    path = problems.DESIGNS / "telescope_six_pus_none.toml"
    config = load_audit(path)
    half = {"position_mm": [0.5, 0.4, 0.0], "rotation_deg": [0.1, 0.2, 0.0], "shape": shape, "poses": 2000}
    section = type(config.workspace).model_validate(half)
    (plan,) = read_plans(config.model_copy(update={"workspace": section}), path.parent).values()
    width = np.concatenate([half["position_mm"], np.radians(half["rotation_deg"])])
    moves = plan.around.pose - plan.variant.model.home_pose
    share = moves[:, width > 0] / width[width > 0]
    assert len(moves) == 2000
    assert not moves[:, width == 0].any()
    assert np.abs(share).max() <= 1.0
    radius = np.linalg.norm(share, axis=1)
    if shape == "ellipsoid":
        assert radius.max() <= 1.0 + 1e-12
        assert np.mean(radius**4) == pytest.approx(0.5, abs=0.03)  # uniform in a 4-ball
    elif shape == "box":
        assert np.mean(share**2) == pytest.approx(1.0 / 3.0, abs=0.02)
    else:
        assert np.all((np.abs(share) > 1e-9).sum(axis=1) == 1)


# --- what would help ---------------------------------------------------------------------------------------------


def test_twice_the_same_poses_are_half_the_variance_of_noise(telescope):
    """Doubling the poses of a table and dividing both noises by the root of two tell the same."""
    twice = evaluate_change(telescope, ScenarioConfig(name="", poses_factor=2.0), None)
    less = ScenarioConfig(name="", noise_factor=0.5**0.5, actuator_noise_factor=0.5**0.5)
    finer = evaluate_change(telescope, less, None)
    assert twice.n_poses == 80
    assert twice.information.contraction == pytest.approx(finer.information.contraction, abs=1e-9)


def test_more_of_anything_never_tells_less(telescope):
    base = analyse(telescope).information.nats
    for change in (
        ScenarioConfig(name="", poses_factor=1.5),
        ScenarioConfig(name="", noise_factor=0.9),
        ScenarioConfig(name="", actuator_noise_factor=0.9),
        ScenarioConfig(name="", sensors=["rho", "photogrammetry", "laser_tracker"]),
    ):
        assert evaluate_change(telescope, change, None).information.nats > base


def test_a_wider_workspace_says_that_the_actuators_do_not_reach(telescope):
    wide = evaluate_change(telescope, ScenarioConfig(name="", workspace_factor=2.0), None)
    assert wide.beyond_range
    assert not evaluate_change(telescope, ScenarioConfig(name=""), None).beyond_range
    impossible = evaluate_change(telescope, ScenarioConfig(name="", workspace_factor=400.0), None)
    assert impossible.information is None


def test_other_poses_replace_the_planned_ones(telescope):
    change = ScenarioConfig.model_validate({"name": "", "poses": {"sampling": "extremes", "count": 7}})
    moves = telescope.change(change).variant.data.values[:, :6] - 10.0
    assert moves.shape == (7, 6)
    assert set(np.unique(np.round(np.abs(moves), 9))) <= {0.0, 1.3}


def test_tables_and_summary_agree(audited):
    audit, summary = audited
    tables = tabulate(summary, audit) | tabulate_variants({"all": audit})
    assert list(tables["parameters"]["parameter"]) == list(summary["parameters"])
    assert tables["directions"]["direction"].max() == summary["n_parameters"] == len(summary["directions"])
    assert summary["n_structural"] + summary["structural_rank"] == summary["n_parameters"]
    names = {name for d in summary["directions"] for name in d["loadings"]}
    assert names <= set(summary["parameters"])
    for values in summary["parameters"].values():
        left = values["posterior_sd"] / values["prior_sd"]
        assert values["contraction"] == pytest.approx(1 - left**2, abs=1e-9)
        assert values["nats"] == pytest.approx(-np.log(left), rel=1e-6, abs=1e-9)
    symbols = {name.partition("[")[0] for name in summary["reduced_set"]["free"]}
    assert symbols == {"a_x", "a_y", "b_x", "b_y", "u_x", "l"}
    for direction in summary["directions"]:
        if direction["kind"] != "informed":
            assert direction["effect_on_pose"] == "harmless"


@pytest.mark.runs
def test_stricter_limits_make_the_unknown_harmful(telescope):
    """With stricter limits what is not known is no longer harmless, whatever else could be planned."""
    less = {"scenarios": [ScenarioConfig(name="twice the poses", poses_factor=2.0)]}
    plan = replace(telescope, config=telescope.config.model_copy(update=less))
    for share, word in ((1.0, "harmless"), (0.01, "noticeable"), (1e-3, "harmful")):
        strict = replace(plan, requirements=[replace(r, limit=share * r.limit) for r in plan.requirements])
        audit = run_audit(strict, Run())
        assert audit.harm(max((r.direction for r in audit.ridges), key=lambda d: d.contraction))[0] == word
    unjudged = run_audit(replace(plan, requirements=[]), Run())
    assert unjudged.harm(unjudged.ridges[0].direction)[0] == "unknown"


# --- units in the design -----------------------------------------------------------------------------------------

SCALES = {"um": 1e3, "mm": 1.0, "m": 1e-3, "arcsec": 3600.0, "mrad": np.pi / 0.18, "deg": 1.0, "rad": np.pi / 180}


@pytest.fixture(scope="module")
def hexapod():
    """Return the design of a hexapod with frames, next to nothing swept, and what its audit says."""
    config = load_audit(problems.DESIGNS / "camera_hexapod_frames.toml")
    config = config.model_copy(update={"sweep": problems.SHORT_SWEEP})
    return config, audit_design(config)


def audit_design(config):
    """Return what the audit of the only plan of a design says."""
    (plan,) = read_plans(config, problems.DESIGNS).values()
    return summarise(run_audit(plan, Run()))


@pytest.mark.runs
@pytest.mark.parametrize(("length", "angle"), [("m", "rad"), ("um", "arcsec"), ("m", "mrad")])
def test_a_design_in_other_units_says_the_same(length, angle, hexapod):
    config, one = hexapod
    dumped = config.model_dump(mode="json", exclude_none=True)
    dumped["units"] = {"length": length, "angle": angle}
    for name, prior in dumped["parameters"].items():
        prior["sd"] *= SCALES[angle if name.endswith("_r") else length]
    for name in dumped["requirements"]:
        dumped["requirements"][name] *= SCALES[angle if name.startswith("r") else length]
    other = audit_design(type(config).model_validate(dumped))
    assert other["structural_rank"] == one["structural_rank"] == 42
    assert other["reduced_set"]["free"] == one["reduced_set"]["free"]
    for name, values in one["parameters"].items():
        factor = SCALES[length if values["unit"] == "mm" else angle]
        assert other["parameters"][name]["verdict"] == values["verdict"]
        assert other["parameters"][name]["contraction"] == pytest.approx(values["contraction"], abs=1e-7)
        assert other["parameters"][name]["posterior_sd"] == pytest.approx(values["posterior_sd"] * factor, rel=1e-6)
    assert [d["kind"] for d in other["directions"]] == [d["kind"] for d in one["directions"]]
    assert sorted(d["nats"] for d in other["directions"]) == pytest.approx(
        sorted(d["nats"] for d in one["directions"]), abs=1e-5
    )
    for name, outlook in one["requirements"].items():
        assert other["requirements"][name]["probability"] == pytest.approx(outlook["probability"], abs=0.01)


def test_plans_of_redundant_legs_close():
    """Eight legs cannot stand anywhere: the closure vanishes at every pose of a plan."""
    machine = machines.build_machine("linear", machines.build_random_mechanism(8, 2))
    model, theta = Legs(machine), machine.layout.nominal
    middle = machine.mechanism.initial_actuator_positions
    moves = problems.build_plan(machine, 10).actuators - middle

    def gap(actuators):
        found = solve_forward_kinematics(machine, theta, actuators)
        return np.abs(machine.linearise(theta, found.position, found.rotation, actuators).residual).max()

    assert gap(middle + moves) > 0.1
    assert gap(model.read(theta, locate(model, theta, middle, moves, {}).pose)[:, :8]) < 1e-9


# --- errors by draws of the posterior ---------------------------------------------------------------------------------


N_DRAWS, N_POSES = 60, 15
QUIET = 1e-9  # mm
REQUIREMENTS = [Requirement("z", 0.02), Requirement("position", 0.05), Requirement("rotation_x", 1e-4)]


@pytest.fixture(scope="module")
def place():
    """Return where a machine is to be accurate, without any noise, and true machines."""
    machine, rng = machines.build_machine("none"), np.random.default_rng(2)
    theta = machine.layout.nominal
    start = machine.mechanism.initial_actuator_positions
    actuators = start + 5.0 * rng.uniform(-1.0, 1.0, (N_POSES, 6))
    true = np.tile(theta, (N_DRAWS, 1))
    true[:, machine.layout.index["l"]] += 0.02 * rng.standard_normal((N_DRAWS, 6))
    pose, _ = Legs(machine).locate(theta, actuators)
    return ToolRemaining(Legs(machine), np.arange(6), theta, pose, {}, np.full((N_DRAWS, 6), QUIET), 1), true


def compute_directly(place: ToolRemaining, true: np.ndarray) -> np.ndarray:
    """Return the largest errors in shares of the limits by forward kinematics of both machines."""
    machine, actuators = place.model.machine, place.model.read(place.theta, place.pose)[:, :6]
    predicted = solve_forward_kinematics(machine, place.theta, actuators)
    stood = solve_forward_kinematics(machine, true[:, None], actuators)
    error = compute_pose_error(stood.position, stood.rotation, predicted.position, predicted.rotation)
    return np.stack([(r.take(error) / r.limit).max(axis=1) for r in REQUIREMENTS], axis=1)


def test_errors_are_those_of_forward_kinematics(place):
    found, true = place
    np.testing.assert_allclose(
        found.find_largest(REQUIREMENTS, true), compute_directly(found, true), rtol=0.0, atol=2e-3
    )


def test_bent_machines_are_followed_by_their_closures(place, monkeypatch):
    """Joints off by a tenth of a leg's length: the tangent misses more than the closure does."""
    found, true = place
    far, a_x = np.tile(found.theta, (N_DRAWS, 1)), found.model.layout.index["a_x"]
    far[:, a_x] += 15.0 * np.random.default_rng(7).standard_normal((N_DRAWS, 6))
    assert found._leaves_tangent(far)
    assert not found._leaves_tangent(true)
    followed = found.find_largest(REQUIREMENTS, far)
    monkeypatch.setattr(requirements, "BENT", np.inf)
    expected, tangent = compute_directly(found, far), found.find_largest(REQUIREMENTS, far)
    off = [np.median(np.abs(one / expected - 1.0)) for one in (followed, tangent)]
    assert off[0] < 0.9 * off[1], off


def test_noise_has_the_spread_that_is_stated(place):
    """A single pose: actuators with σ of each draw move it as those with the root mean square of all would."""
    one = replace(place[0], pose=place[0].pose[:1])
    exact, limits = np.tile(one.theta, (4000, 1)), [Requirement("z", 1.0)]
    each = 0.005 * np.sqrt(np.tile([0.5, 1.5], 2000))[:, None] * np.ones(6)
    both = replace(one, sd=each).find_largest(limits, exact)
    alone = replace(one, sd=np.full((4000, 6), 0.005), seed=8).find_largest(limits, exact)
    assert np.mean(both**2) / np.mean(alone**2) == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 * 2.0 / 4000))
    gain = np.linalg.inv(one.model.linearise(one.theta, one.pose[0]).by_pose[:6])
    assert np.sqrt(np.mean(alone**2)) == pytest.approx(0.005 * np.linalg.norm(gain[2]), rel=0.05)


def test_a_workspace_out_of_reach_is_told(place):
    with pytest.raises(NumericalError, match="out of the calibrated machine's reach"):
        replace(place[0], pose=place[0].pose + 1e5).find_largest(REQUIREMENTS, place[1])


def test_a_machine_that_cannot_be_there_exceeds_every_limit(place):
    found, true = place
    broken = true.copy()
    broken[3] = np.nan
    largest = found.find_largest(REQUIREMENTS, broken)
    assert np.isinf(largest[3]).all()
    assert np.isfinite(np.delete(largest, 3, axis=0)).all()


def test_requirements_hold_together_where_each_does():
    standing = RequirementSummary(np.array([[0.5, 0.5], [0.9, 1.1], [1.2, 0.8], [1.0, 0.2]]))
    assert standing.probability == 0.5
    np.testing.assert_allclose(standing.probabilities, [0.75, 0.75])
    assert list(standing.bound(0.75)) == [1.2, 1.1]
    assert standing.standard_error == pytest.approx(0.25)


def test_moved_draws_have_the_other_covariance():
    rng = np.random.default_rng(4)
    before, after = (a @ a.T for a in rng.standard_normal((2, 5, 5)))
    draws = np.linalg.cholesky(before) @ rng.standard_normal((5, 50))
    moved = move_draws(draws.T, before, after)
    whitened = [np.linalg.solve(np.linalg.cholesky(c), d) for c, d in ((before, draws), (after, moved.T))]
    np.testing.assert_allclose(*whitened)
