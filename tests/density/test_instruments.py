"""The density of an instrument's readings: against measured poses, marginals, exact kinematics and full coordinates."""

import guided_machines as guided
import numpy as np
import pytest
import telescope_machines as machines
from bayescal.density.errors import ModelError
from bayescal.density.instruments import InstrumentLikelihood
from bayescal.density.legs import build_leg_posterior
from bayescal.density.pose_likelihood import PoseLikelihood
from scipy.stats import multivariate_normal

from bayescal.data.instruments.readings import PointReadings, PoseReadings
from bayescal.density.priors import NormalPrior
from bayescal.machines.frames import measured_pose_slopes, move_frames
from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.numerics.geometry import (
    compute_pose_error,
    matrix_from_rotation_vector,
    rotation_vector_from_matrix,
    skew_matrix,
)

N_POSES = 9
NOISE = machines.ACTUATOR_NOISE
PROBE = np.array([[100.0, 0.0, 40.0], [-60.0, 80.0, 20.0], [-50.0, -90.0, 60.0], [10.0, 20.0, 150.0]])
FRAMES = np.array([0.7, -0.4, 0.2, 1e-3, -2e-3, 5e-4, -0.3, 0.5, 0.1, -1e-3, 2e-3, 1.5e-3])


def place(model="six_pus", seed=5):
    """Return a machine off nominal by its tolerances, its parameters and measured poses."""
    rng = np.random.default_rng(seed)
    machine = machines.build_machine("linear", None, model)
    layout = machine.layout
    spread = np.where(np.array(layout.units) == "mm", 0.5, 0.0)
    theta = layout.nominal + spread * rng.standard_normal(layout.size) * np.isin(np.arange(layout.size), range(36))
    start = machine.mechanism.initial_actuator_positions
    actuators = start + rng.uniform(-1.3, 1.3, (N_POSES, 6))
    poses = machines.simulate_poses(machine, theta, actuators, np.zeros(6), rng)
    return machine, theta, poses


def read_poses(poses, missing=()):
    values = np.concatenate([poses.position, rotation_vector_from_matrix(poses.rotation)], axis=1)
    values[:, list(missing)] = np.nan
    return PoseReadings(poses.names, poses.actuators, values, poses.covariance)


def with_frames(theta, n_stations=1, frames=None):
    frames = np.zeros(6 * n_stations + 6) if frames is None else frames
    return np.concatenate([theta, frames])[None]


def read_points(machine, theta, actuators, frames, rng, stations=("A",), drop=()):
    """Return points with noise of unlike axes; ``drop`` are (pose, station, point) not seen."""
    found = solve_forward_kinematics(machine, theta, actuators)
    blocks = frames.reshape(-1, 6)
    pairs = np.concatenate([blocks[:-1], np.broadcast_to(blocks[-1:], blocks[:-1].shape)], axis=1)
    position, rotation = move_frames(pairs, found.position[None], found.rotation[None])
    exact = position[:, :, None] + np.einsum("spij,qj->spqi", rotation, PROBE)
    values = np.swapaxes(exact, 0, 1).copy()
    root = np.array([[5e-3, 0, 0], [2e-3, 1e-2, 0], [-1e-3, 3e-3, 2e-2]])
    values += rng.standard_normal(values.shape) @ root.T
    covariance = np.broadcast_to(root @ root.T, (*values.shape, 3)).copy()
    for where in drop:
        values[where] = np.nan
    names = tuple(f"C{k}" for k in range(len(actuators)))
    points = tuple(f"P{k}" for k in range(len(PROBE)))
    return PointReadings(names, actuators, stations, points, PROBE, values, covariance)


@pytest.mark.parametrize("model", ["six_pus", "beam"])
@pytest.mark.parametrize("varying", [False, True])
def test_whole_poses_in_known_frames_have_the_density_of_measured_poses(model, varying, rng):
    """But for where the noise of the actuators is carried through the kinematics, a few parts in a thousand."""
    machine, theta, poses = place(model)
    many = theta + 1e-4 * rng.standard_normal((5, len(theta))) * (np.array(machine.layout.units) == "mm")
    tau = np.full((5, 6), 2e-3) * rng.uniform(0.5, 2.0, (5, 1)) if varying else np.full(6, 2e-3)
    instrument = InstrumentLikelihood(machine, read_poses(poses), NOISE)
    found = instrument(np.concatenate([many, np.zeros((5, 12))], axis=1), tau)
    np.testing.assert_allclose(found, PoseLikelihood(machine, poses, NOISE)(many, tau), atol=0.05)


@pytest.mark.parametrize("missing", [(3, 4, 5), (2, 3, 4, 5), (0,), (0, 1, 2)])
def test_coordinates_not_measured_are_marginalised_exactly(missing):
    machine, theta, poses = place()
    tau = np.full(6, 3e-3)
    whole = InstrumentLikelihood(machine, read_poses(poses), NOISE)
    error, covariance = whole.pose_errors(with_frames(theta))[0], whole.pose_covariance(tau)
    kept = [k for k in range(6) if k not in missing]
    expected = [
        multivariate_normal.logpdf(e[kept], cov=c[np.ix_(kept, kept)]) for e, c in zip(error, covariance, strict=True)
    ]
    part = InstrumentLikelihood(machine, read_poses(poses, missing), NOISE)
    np.testing.assert_allclose(part.pointwise(with_frames(theta), tau)[0], expected, rtol=1e-9, atol=1e-7)
    assert np.isnan(part.pose_errors(with_frames(theta))[..., list(missing)]).all()


def test_part_of_a_rotation_is_compared_as_it_stands():
    """Coordinates of the rotation vector itself, with derivatives to match."""
    machine, theta, poses = place()
    likelihood = InstrumentLikelihood(machine, read_poses(poses, (5,)), NOISE)
    full = with_frames(theta, frames=FRAMES)
    exact = solve_forward_kinematics(machine, theta, poses.actuators)
    _, rotation = move_frames(FRAMES, exact.position, exact.rotation)
    expected = (rotation_vector_from_matrix(poses.rotation) - rotation_vector_from_matrix(rotation))[:, :2]
    np.testing.assert_allclose(likelihood.errors(full)[0][:, 3:5], expected, atol=1e-9)
    check_jacobian(likelihood, full[0])


def check_jacobian(likelihood, theta, tolerance=2e-6):
    _, slope = likelihood.error_jacobian(theta)
    units = np.array(likelihood.layout.units)
    steps = np.where(units == "mm", 1e-3, 1e-6)
    expected = machines.central_difference(lambda x: likelihood.errors(x[None])[0], theta, steps)
    scale = np.abs(expected).max(axis=(0, 1))
    chosen = scale > 1e-9 * scale.max()
    worst = np.abs(slope - expected).max(axis=(0, 1))[chosen] / scale[chosen]
    assert worst.max() < tolerance


@pytest.mark.parametrize("model", ["six_pus", "beam", "jacobian"])
def test_errors_are_those_of_exact_kinematics_far_from_nominal(model):
    """Half a millimetre and two milliradians off in machine and frames: to 10 pm and 1 nrad, where one step is off."""
    machine, theta, poses = place(model)
    exact = solve_forward_kinematics(machine, theta, poses.actuators)
    position, rotation = move_frames(FRAMES, exact.position, exact.rotation)
    expected = compute_pose_error(poses.position, poses.rotation, position, rotation)
    likelihood = InstrumentLikelihood(machine, read_poses(poses), NOISE)
    found = likelihood.pose_errors(with_frames(theta, frames=FRAMES))[0]
    np.testing.assert_allclose(found[:, :3], expected[:, :3], atol=1e-8)
    np.testing.assert_allclose(found[:, 3:], expected[:, 3:], atol=1e-9)
    rough = likelihood._legs.pose_errors(theta[None])[0] - compute_pose_error(
        likelihood._legs.poses.position, likelihood._legs.poses.rotation, exact.position, exact.rotation
    )
    assert np.abs(rough).max() > 1e-7  # so that the step of the whole closure is needed


@pytest.mark.parametrize("missing", [(), (3, 4, 5), (2,)])
def test_derivatives_by_machine_and_frames(missing):
    machine, theta, poses = place()
    likelihood = InstrumentLikelihood(machine, read_poses(poses, missing), NOISE)
    check_jacobian(likelihood, with_frames(theta, frames=FRAMES)[0])


def test_redundant_legs_keep_their_conditions(rng):
    """Eight legs, poses whole: the density of measured poses, which holds the closure of the redundant legs too."""
    machine = machines.build_machine("none", machines.build_random_mechanism(8, 3))
    start = machine.mechanism.initial_actuator_positions
    actuators = np.broadcast_to(start, (3, 8)).copy()
    theta = machine.layout.nominal
    poses = machines.simulate_poses(machine, theta, actuators, np.zeros(8), rng)
    theta = theta + 2e-3 * rng.standard_normal(len(theta)) * (np.array(machine.layout.units) == "mm")
    expected = PoseLikelihood(machine, poses, 0.02).pointwise(theta[None], np.full(8, 0.01))
    likelihood = InstrumentLikelihood(machine, read_poses(poses), 0.02)
    np.testing.assert_allclose(likelihood.pointwise(with_frames(theta), np.full(8, 0.01)), expected, atol=0.02)
    assert likelihood.errors(with_frames(theta)).shape == (1, 3, 8)


# --- points ------------------------------------------------------------------------------------------------------


def expected_density(machine, readings, theta, tau):
    """Return the density of all coordinates seen, without any reduction, frames as they should be."""
    exact = InstrumentLikelihood(
        machine, read_poses(machines.place_poses(machine, theta, readings.actuators, np.zeros((N_POSES, 6)))), NOISE
    )
    legs = exact.pose_covariance(tau) - exact.instrument.rows.covariance
    found = solve_forward_kinematics(machine, theta, readings.actuators)
    nominal = solve_forward_kinematics(machine, machine.layout.nominal, readings.actuators)
    result = []
    for p in range(N_POSES):
        station, point = np.nonzero(readings.seen[p])
        arms = PROBE[point] @ found.rotation[p].T
        misfit = (readings.values[p, station, point] - found.position[p] - arms).ravel()
        arms = PROBE[point] @ nominal.rotation[p].T
        jacobian = np.concatenate([np.hstack([np.eye(3), -skew_matrix(a)]) for a in arms])
        covariance = jacobian @ legs[p] @ jacobian.T
        for k, (s, q) in enumerate(zip(station, point, strict=True)):
            covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] += readings.covariance[p, s, q]
        result.append(multivariate_normal.logpdf(misfit, cov=0.5 * (covariance + covariance.T)))
    return np.array(result)


@pytest.mark.parametrize(
    ("stations", "drop"),
    [
        (("A",), ()),
        (("A",), [(0, 0, 0), (1, 0, slice(1, 4)), (2, 0, slice(2, 4))]),
        (("A", "B"), [(0, 0), (1, 1, 2), (2, 1, slice(1, 4))]),
    ],
)
def test_points_have_the_density_of_all_their_coordinates(stations, drop, rng):
    """Four points reduced to six rows, two points, one point, some stations blind: as without any reduction."""
    machine, theta, poses = place()
    frames = np.zeros(6 * len(stations) + 6)
    readings = read_points(machine, theta, poses.actuators, frames, rng, stations, drop)
    tau = np.full(6, 2e-3)
    found = InstrumentLikelihood(machine, readings, NOISE).pointwise(with_frames(theta, len(stations)), tau)[0]
    np.testing.assert_allclose(found, expected_density(machine, readings, theta, tau), atol=0.02)


def test_points_derivatives_by_the_frames_of_every_station(rng):
    machine, theta, poses = place()
    frames = np.concatenate([FRAMES[:6], -FRAMES[:6], FRAMES[6:]])
    drop = [(0, 0), (1, 1, slice(1, 4))]
    readings = read_points(machine, theta, poses.actuators, frames, rng, ("A", "B"), drop)
    likelihood = InstrumentLikelihood(machine, readings, NOISE)
    assert likelihood.layout.symbols[-18:][::6] == ("base1_x", "base2_x", "tool_x")
    check_jacobian(likelihood, np.concatenate([theta, frames]))


@pytest.mark.parametrize("shared", [False, True])
def test_gradient_of_the_posterior_with_frames_and_model_error(rng, shared):
    """Free frames tie the legs: with one model error everything is one group, with one a leg nothing is stretched."""
    machine, theta, poses = place()
    readings = read_points(machine, theta, poses.actuators, FRAMES, rng, drop=[(0, 0, slice(1, 4))])
    likelihood = InstrumentLikelihood(machine, readings, NOISE)
    layout = likelihood.layout
    free = [name for name in layout.names if name.startswith(("l[", "a_x[", "base", "tool"))]
    nominal = dict(zip(layout.names, layout.nominal, strict=True))
    sd = {name: 2e-3 if name[5:6] == "r" else 1.0 for name in free}
    priors = {name: NormalPrior(float(nominal[name]), sd[name]) for name in free}
    posterior = build_leg_posterior(likelihood, priors, ModelError(0.01, shared))
    y = posterior.polish(posterior.approach()) + 0.02 * rng.standard_normal(posterior.n_parameters)
    gradient, _ = posterior.gradient(y)
    steps = np.full(posterior.n_parameters, 1e-4)
    expected = machines.central_difference(lambda x: posterior.log_density(x[None])[0], y, steps)
    np.testing.assert_allclose(gradient, expected, rtol=1e-4, atol=1e-3 * np.abs(expected).max())
    assert (posterior.funnel(y) is not None) == shared
    assert [len(group) for group in posterior.groups()] == ([len(free)] if shared else [2] * 6)


def test_directions_of_horizontal_guides_are_free_beside_the_frames(rng):
    """The chart of the directions stays with the layout that the frames extend."""
    machine = machines.build_machine("none", guided.build_hexaglide())
    layout, start = machine.layout, machine.mechanism.initial_actuator_positions
    actuators = start + rng.uniform(-20.0, 20.0, (N_POSES, 6))
    poses = machines.simulate_poses(machine, layout.nominal, actuators, np.zeros(6), rng)
    likelihood = InstrumentLikelihood(machine, read_poses(poses), NOISE)
    free = [name for name in likelihood.layout.names if name.startswith(("l[", "u_", "base", "tool"))]
    nominal = dict(zip(likelihood.layout.names, likelihood.layout.nominal.tolist(), strict=True))
    sd = {name: 1.0 if name.startswith("l[") or name[-2] == "_" else 2e-3 for name in free}
    posterior = build_leg_posterior(likelihood, {n: NormalPrior(nominal[n], sd[n]) for n in free}, ModelError(None))
    y = posterior.polish(posterior.approach()) + 0.02 * rng.standard_normal(posterior.n_parameters)
    expected = machines.central_difference(lambda x: posterior.log_density(x[None])[0], y, np.full(len(y), 1e-4))
    np.testing.assert_allclose(posterior.gradient(y)[0], expected, rtol=1e-4, atol=1e-3 * np.abs(expected).max())
    assert [len(rest) for _, rest in posterior.curved_ridges()] == [1] * 12  # of each leg l, for u_y and u_z


def test_points_of_a_wrong_probe_show_in_their_misfit(rng):
    machine, theta, poses = place()
    readings = read_points(machine, theta, poses.actuators, np.zeros(12), rng)
    assert 0.6 < readings.describe()["chi2_per_dof"] < 1.5
    bent = PointReadings(
        readings.names, readings.actuators, readings.stations, readings.points,
        readings.probe * [1.0, 1.0, 1.002], readings.values, readings.covariance,
    )  # fmt: skip
    assert bent.describe()["chi2_per_dof"] > 3.0


def test_rotation_errors_wrap_nowhere():
    """A pose error stays small where rotation vectors jump, near half a turn."""
    _, _, poses = place()
    turn = matrix_from_rotation_vector(np.array([0.0, 0.0, np.pi - 1e-9]))
    values = np.concatenate([poses.position, rotation_vector_from_matrix(turn @ poses.rotation)], axis=1)
    readings = PoseReadings(poses.names, poses.actuators, values, poses.covariance)
    found = readings.residuals(poses.position[None], (turn @ poses.rotation)[None])
    np.testing.assert_allclose(found, 0.0, atol=1e-7)


def test_slopes_of_frames_anywhere_against_differences():
    rng = np.random.default_rng(0)
    frames = rng.normal(size=12) * np.tile([5.0] * 3 + [0.4] * 3, 2)
    position, rotation = rng.normal(0, 200, (3, 3)), matrix_from_rotation_vector(rng.normal(0, 0.5, (3, 3)))
    by_pose, by_frames = measured_pose_slopes(frames, position, rotation)

    def seen(x):  # machines (K, 18): frames, then a change of the pose
        turned = matrix_from_rotation_vector(x[:, None, 15:]) @ rotation
        moved = move_frames(x[:, :12], position + x[:, None, 12:15], turned)
        here = move_frames(frames, position, rotation)
        return compute_pose_error(*moved, *here)

    start = np.concatenate([frames, np.zeros(6)])
    step = np.tile([1e-2] * 3 + [1e-3] * 3, 3)
    slope = machines.stencil_derivative(seen, start, step)
    expected = np.concatenate([by_frames, by_pose], axis=-1)
    assert np.abs(slope - expected).max() < 1e-8 * np.abs(expected).max()
    none, _ = measured_pose_slopes(np.zeros(12), position, rotation)
    assert np.array_equal(none, np.broadcast_to(np.eye(6), none.shape))
