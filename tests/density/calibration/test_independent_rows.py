"""The fast form of rows by themselves: about its anchor it is the density that leaves nothing out, with its slopes.

At draws of the posterior both differ by a constant, which is no matter, and by what H turns, in nats as stated here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import guided_machines as guided
import hexapods
import numpy as np
import pytest
import studies
import telescope_machines as machines
from calibration_problems import climb

from bayescal.density.calibration.likelihood import CalibrationLikelihood
from bayescal.density.calibration.measurements import Measurements
from bayescal.density.calibration.terms import NO_ERRORS, CorrelatedNoise, ErrorModel, NoiseFactor
from bayescal.density.outliers import Contaminated, StudentT
from bayescal.density.posterior import Posterior
from bayescal.density.priors import NormalPrior, SharePrior
from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.inference.exploration import explore
from bayescal.inference.mode import find_modes
from bayescal.machines.kinematics import solve_forward_kinematics, solve_inverse_kinematics
from bayescal.machines.readings import BoundReadings, Legs, Tracker
from bayescal.machines.readings.placed import place

N_POSES = 24
FRAME = 0.1  # mm, of what is known of a frame and of struts: these move the platform, but for what it is seen at


def simulate(machine, symbols, rng, n_poses=N_POSES, tau=2e-3, reach=1.0, size=0.3):
    """Return poses of a machine of which some parameters are off by so many mm or 0.02 times as much."""
    layout, mechanism = machine.layout, machine.mechanism
    free = np.isin(np.arange(layout.size), np.concatenate([layout.index[symbol] for symbol in symbols]))
    theta = layout.nominal + size * free * machines.spread_of(layout) * rng.standard_normal(layout.size)
    actuators = mechanism.initial_actuator_positions + reach * rng.uniform(-1, 1, (n_poses, mechanism.n_legs))
    at = solve_forward_kinematics(machine, layout.nominal, actuators)
    actuators = solve_inverse_kinematics(machine, theta, at.position, at.rotation).actuators  # of legs that all close
    return machines.simulate_poses(machine, theta, actuators, np.full(mechanism.n_legs, tau), rng)


def of_legs(deformation, model, mechanism, symbols, errors, reach=1.0):
    """Return what builds the posterior of a machine on legs."""

    def build(rng):
        machine = machines.build_machine(deformation, mechanism() if mechanism else None, model)
        poses = simulate(machine, symbols, rng, reach=reach)
        return machines.build_posterior(deformation, poses, errors, symbols, machine)

    return build


def of_known_errors(rng):
    """Return what six errors common to all rows do, of which each row knows for itself."""
    posterior = of_legs("linear", "six_pus", None, ("l", "b_x", "kappa"), machines.let_err())(rng)
    design = 2e-3 * rng.standard_normal((N_POSES, 12, 6)) * (np.arange(12) < 6)[:, None]
    return replace(posterior, errors=ErrorModel((*posterior.errors.terms, CorrelatedNoise(design))))


def see(rng, points=False):
    """Return the posterior of a hexapod that one tracker saw, whose frames are free."""
    machine = machines.build_machine("none", hexapods.load_hexapod("m2"), "six_ups")
    poses, n = simulate(machine, ("l",), rng, reach=10.0, size=FRAME), 6
    places = [[200.0, 0.0, 0.0], [0.0, 200.0, 0.0], [-150.0, -150.0, 80.0]]
    seen = [(0, np.array(one)) for one in places] if points else [(0, None)]
    model = place(Legs(machine), {"": Tracker(("station",), seen)})
    pose = machines.list_coordinates(poses)
    theta = model.layout.nominal.copy()
    theta[-12:] = np.tile(np.repeat([FRAME, 4e-3 * FRAME], 3), 2) * rng.standard_normal(12)
    # the machine's own channels, then the pose seen by nobody, then what the tracker sees
    chosen = [k for k, one in enumerate(model.channels) if one.name not in ("x", "y", "z", "rx", "ry", "rz")]
    model = model.pick(np.array(chosen))
    read = model.read(theta, pose)
    sd = np.array([2e-3 if one.unit == "mm" else 1e-5 for one in model.channels[n:]])
    values = np.concatenate([poses.actuators, read[:, n:] + sd * rng.standard_normal((N_POSES, len(sd)))], axis=1)
    data = Measurements(
        poses.names,
        values,
        np.tile(np.append(np.full(n, machines.ACTUATOR_NOISE), sd), (N_POSES, 1)),
        commanded=np.tile(np.arange(n + len(sd)) < n, (N_POSES, 1)),
    )
    priors = {name: NormalPrior(one.mean, FRAME) for name, one in machines.list_priors(machine, ("l",)).items()}
    priors |= {name: NormalPrior(0.0, FRAME if unit == "mm" else 4e-3 * FRAME) for name, unit in free_frames(model)}
    return Posterior(CalibrationLikelihood(model, data, 1.0, pose), priors, NO_ERRORS if points else machines.let_err())


def free_frames(model):
    """Return the names of the frames' parameters, with their units."""
    layout = model.layout
    return [(name, unit) for name, unit in zip(layout.names, layout.units, strict=True) if name[:4] in ("base", "tool")]


SHARE = Contaminated(SharePrior(0.05))
STRUTS = ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "l")
WITH_GAIN = machines.FREE_SYMBOLS["linear"]
DIRECTIONS = ("a_x", "a_y", "b_x", "l", "u_x")
CASES = {
    "struts": of_legs("none", "six_ups", lambda: hexapods.load_hexapod("m2"), STRUTS, machines.let_err(), 10.0),
    "struts, one τ": of_legs(
        "none", "six_ups", lambda: hexapods.load_hexapod("camera"), STRUTS, machines.let_err(shared=True), 10.0
    ),
    "directions": of_legs("none", "six_pus", None, DIRECTIONS, machines.let_err()),
    "directions, no τ": of_legs("none", "six_pus", None, DIRECTIONS, machines.let_err(None)),
    "horizontal guides": of_legs(
        "none", "six_pus", guided.build_hexaglide, ("l", "b_x", "u_y", "u_z"), machines.let_err(), 20.0
    ),
    "K": of_legs("matrix", "six_pus", None, WITH_GAIN, machines.let_err()),
    "K in equilibrium": of_legs("matrix", "stiffness", None, WITH_GAIN, machines.let_err(shared=True)),
    "contaminated": of_legs("linear", "beam", None, WITH_GAIN, machines.let_err(outliers=SHARE)),
    "t": of_legs("linear", "six_pus", None, WITH_GAIN, machines.let_err(None, outliers=StudentT(4.0))),
    "eight legs": of_legs(
        "none",
        "six_pus",
        lambda: machines.build_random_mechanism(8, 5),
        ("l", "b_x"),
        machines.let_err(None, n_legs=8),
        1.0,
    ),
    "known errors": of_known_errors,
    "a tracker of unknown frames": see,
    "points": lambda rng: see(rng, points=True),
}
NATS = dict.fromkeys(CASES, 0.1) | {"struts": 0.005, "struts, one τ": 0.005, "horizontal guides": 0.005}
NATS |= {"K in equilibrium": 0.25, "eight legs": 0.01}
"""By how much the two densities may differ, one standard deviation and at the best machine."""
FOLLOWED = "struts", "K in equilibrium", "contaminated", "eight legs", "points"  # with readings followed to the pose
FOLLOWED_TO, SLOPE = ", followed", (0.02, 0.03)  # and of the largest slope
NATS |= {name + FOLLOWED_TO: NATS[name] for name in FOLLOWED} | {"eight legs, followed": 0.03}  # rows turn no more
TYPICAL = 30.0  # nats below the mode, that draws of the posterior are within


def follow(posterior):
    """Return a posterior whose fast form follows readings to the pose."""
    return replace(posterior, likelihood=replace(posterior.likelihood, lone=posterior.likelihood.lone.followed))


@pytest.fixture(scope="module", params=[*CASES, *(name + FOLLOWED_TO for name in FOLLOWED)])
def case(request):
    """Return each case: its name, the anchored posterior, the mode near which it is and the root of the covariance."""
    name = request.param.removesuffix(FOLLOWED_TO)
    posterior = CASES[name](np.random.default_rng(8)).with_pose_guesses()
    assert posterior.likelihood.lone is not None
    posterior = posterior if name == request.param else follow(posterior)
    return request.param, posterior, *climb(posterior)


def test_it_is_the_density_that_leaves_nothing_out(case):
    name, posterior, y, root = case
    near = np.concatenate([y[None], y + np.random.default_rng(1).standard_normal((40, len(y))) @ root.T])
    theta, errors, zeta = posterior.at(near)
    whole, each = posterior.likelihood.whole, posterior.pointwise(near)
    if errors.has_columns:  # what rows have in common counts for each of them alone
        alone = [whole.pick(np.array([p])).density(theta, errors, zeta) for p in range(N_POSES)]
        expected = np.stack(alone, axis=1)
        assert np.abs(expected.sum(axis=1) - whole.density(theta, errors, zeta)).min() > 1.0
    else:
        expected = whole.density_by_row(theta, errors, zeta)
    total = expected.sum(axis=1)
    some = posterior.log_prior(near) + total
    typical = some > some[0] - TYPICAL
    assert typical.sum() > 10
    difference = (posterior.likelihood.density(theta, errors, zeta) - total)[typical]
    assert abs(difference[0]) < NATS[name]
    assert difference.std() < NATS[name]
    assert total[typical].std() > 2.0
    assert np.abs(each - expected)[typical].max() < NATS[name]


def test_slopes_are_those_of_differences(case):
    name, posterior, y, root = case
    y = y + root @ np.random.default_rng(2).standard_normal(len(y))
    sd = np.sqrt(1.0 / np.diag(np.linalg.inv(root @ root.T)))
    gradient, hessian = posterior.gradient(y)
    expected = machines.stencil_derivative(posterior.log_density, y, 0.01 * sd)
    size = np.abs(expected * sd).max()
    assert size > 0.3
    np.testing.assert_allclose(gradient * sd, expected * sd, rtol=0, atol=SLOPE[FOLLOWED_TO in name] * size)
    assert np.linalg.eigvalsh(hessian * np.outer(sd, sd)).max() < 0.0


@pytest.mark.parametrize("change", ["missing", "factor", "both"])
def test_rows_that_lack_a_reading_or_whose_noise_has_a_factor_are_seen_with_a_covariance_of_each_pose(rng, change):
    posterior = CASES["struts"](rng)
    likelihood = posterior.likelihood
    if change != "factor":
        values = likelihood.data.values.copy()
        values[0, 7] = values[3, 8] = np.nan
        likelihood = replace(likelihood, data=replace(likelihood.data, values=values))
    errors = () if change == "missing" else (NoiseFactor("rho", np.arange(12) < 6, 0.3),)
    posterior = replace(posterior, likelihood=likelihood, errors=ErrorModel(errors)).with_pose_guesses()
    likelihood = posterior.likelihood
    assert likelihood.lone is not None
    assert likelihood.frozen.is_single
    mode = posterior.least_squares_start()
    _, hessian = posterior.gradient(mode)
    moves = rng.standard_normal((len(mode), 20))
    at = posterior.at(mode + np.linalg.solve(np.linalg.cholesky(-hessian).T, moves).T)
    whole = likelihood.whole.density_by_row(*at)
    np.testing.assert_allclose(likelihood.density_by_row(*at), whole, atol=0.02)
    np.testing.assert_allclose(likelihood.density(*at), whole.sum(axis=1), atol=0.05)
    np.testing.assert_allclose(likelihood.density_of_row(*at, 3), whole[:, 3], atol=0.02)
    assert likelihood.pick(np.arange(4)).lone is None


def test_exploring_it_finds_what_the_whole_density_is():
    posterior = CASES["struts, one τ"](np.random.default_rng(8)).with_pose_guesses()
    whole = replace(posterior, likelihood=posterior.likelihood.whole)
    found = explore(posterior, np.random.SeedSequence(1))
    x = found.proposal.draw(400, np.random.default_rng(2))
    y = found.straight.y_from_x(x)
    apart = whole.log_density(y) - posterior.log_density(y)
    assert found.efficiency > 0.3
    assert np.nanstd(apart) < 0.05


@dataclass(frozen=True, eq=False)
class Scaled:
    """What a machine binds, with errors and slopes of another scale."""

    bound: BoundReadings
    scale: float
    values: np.ndarray

    @property
    def places(self):
        return self.bound.places

    def read(self, theta):
        return self.values + self.scale * (self.bound.read(theta) - self.values)

    def follow(self, step):
        return self.scale * self.bound.follow(step)


def test_followed_readings_do_not_hang_on_the_scale_of_their_slopes():
    """Closures of stiffness models are forces, which a stiffness that is free scales as a whole."""
    posterior = CASES["K in equilibrium"](np.random.default_rng(8)).with_pose_guesses()
    y = posterior.least_squares_start() + 1e-3 * np.random.default_rng(1).standard_normal((5, posterior.n_parameters))
    lone, off = posterior.likelihood.lone, []
    scaled = replace(lone, bound=Scaled(lone.bound, 1.5, lone.values))
    for pair in ((lone, scaled), (lone.followed, scaled.followed)):
        here, there = (
            replace(posterior, likelihood=replace(posterior.likelihood, lone=one)).log_density(y) for one in pair
        )
        off.append(float(np.abs(there - here).max()))
    assert off[0] > 1.0
    assert off[1] < 1e-9


@pytest.mark.parametrize("change", ["whole", "missing"])
def test_an_arm_seen_by_a_tracker_is_followed_to_where_its_commands_lead(change, rng):
    """A machine whose slopes turn, which binds nothing itself: near its best the density is the whole one."""
    inputs = StudyInputs.load(
        load_experiment(studies.EXPERIMENTS / "ur10" / "study.toml"), studies.EXPERIMENTS / "ur10"
    )
    posterior = inputs.variants["links"].posterior()
    if change == "missing":
        data = posterior.likelihood.data
        values = data.values.copy()
        values[4, -1] = values[9, -2] = np.nan
        posterior = replace(posterior, likelihood=replace(posterior.likelihood, data=replace(data, values=values)))
    posterior = posterior.with_pose_guesses()
    likelihood = posterior.likelihood
    assert not likelihood.lone.is_own
    assert likelihood.frozen.is_single
    mode = find_modes(posterior)[0].y
    _, hessian = posterior.gradient(mode)
    moves = rng.standard_normal((len(mode), 20))
    at = posterior.at(mode + np.linalg.solve(np.linalg.cholesky(-hessian).T, moves).T)
    whole = likelihood.whole.density(*at)
    assert np.ptp(whole) > 5.0
    np.testing.assert_allclose(likelihood.density(*at), whole, atol=0.1)
    far = posterior.at(mode + 0.3 * rng.standard_normal((3, len(mode))))  # where the fast form is not asked
    np.testing.assert_allclose(likelihood.density(*far), likelihood.whole.density(*far), rtol=1e-9)
