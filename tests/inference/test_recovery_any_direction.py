"""Truths found again for actuators that do not point upwards, and the audit's forecast of how well."""

from __future__ import annotations

from dataclasses import dataclass, replace

import audit_problems as problems
import guided_machines as guided
import numpy as np
import pytest
import telescope_machines as machines

from bayescal.density.priors import NormalPrior
from bayescal.identifiability.information import information_of_rows
from bayescal.inference.exploration import explore
from bayescal.inference.importance import resample
from bayescal.machines.kinematics import Machine, check_home_pose, solve_inverse_kinematics
from bayescal.machines.sensors import PoseSensor
from bayescal.numerics.geometry import matrix_from_rotation_vector
from bayescal.pose_selection import Design

N_POSES = 30
N_DRAWS = 4000
SENSOR = PoseSensor(2e-3, 1.7e-5)
SD = {"mm": 0.2, "1": 1e-3}
SPREAD = {
    "hexaglide": ((150.0, 30.0, 30.0), 0.03),
    "hanging": ((0.5, 0.5, 0.5), 0.003),
    "star": ((15.0, 15.0, 15.0), 0.03),
}


@dataclass(frozen=True, eq=False)
class Fit:
    """A machine, where it was measured, its truth and draws of its posterior, both in natural units."""

    machine: Machine
    actuators: np.ndarray
    sd: dict[str, float]
    truth: np.ndarray
    draws: np.ndarray
    efficiency: float


def build(name):
    """Return a mechanism that is not the telescope standing."""
    if name == "star":
        return guided.build_guided("star", seed=2)
    return guided.build_hexaglide() if name == "hexaglide" else guided.build_hanging()


def draw_truth(machine, sd, rng):
    theta = machine.layout.nominal.copy()
    for k, parameter in enumerate(machine.layout.names):
        theta[k] += sd.get(parameter, 0.0) * rng.standard_normal()
    return theta


def measure(machine, theta, actuators, rng):
    """Return poses of the true machine with the noise of the instrument and of the actuators."""
    noisy = actuators + machines.ACTUATOR_NOISE * rng.standard_normal(actuators.shape)
    variance = np.array([SENSOR.position_noise] * 3 + [SENSOR.rotation_noise] * 3) ** 2
    error = np.sqrt(variance) * rng.standard_normal((len(actuators), 6))
    poses = machines.place_poses(machine, theta, noisy, error)
    return replace(poses, covariance=np.tile(np.diag(variance), (len(actuators), 1, 1)), actuators=actuators)


@pytest.fixture(scope="module", params=list(SPREAD))
def fit(request):
    """Return the fit of a machine: directions, lengths and joints free."""
    rng = np.random.default_rng(8)
    machine = machines.build_machine("none", build(request.param))
    layout, home = machine.layout, check_home_pose(machine)
    far, turned = SPREAD[request.param]
    position = home.position + np.array(far) * rng.uniform(-1, 1, (N_POSES, 3))
    rotation = matrix_from_rotation_vector(turned * rng.uniform(-1, 1, (N_POSES, 3)))
    actuators = solve_inverse_kinematics(machine, layout.nominal, position, rotation).actuators
    chosen = ("a_x", "a_y", "b_z", "l", *layout.direction_symbols)
    sd = {name: SD[block.unit] for block in layout.blocks if block.symbol in chosen for name in block.names}
    theta = draw_truth(machine, sd, rng)
    poses = measure(machine, theta, actuators, rng)
    nominal = dict(zip(layout.names, layout.nominal.tolist(), strict=True))
    priors = {name: NormalPrior(nominal[name], one) for name, one in sd.items()}
    posterior = machines.measure(machine, poses, priors).with_pose_guesses()
    found = explore(posterior, np.random.SeedSequence(5))
    drawn = resample(found.straight.log_density, found.proposal, rng, N_DRAWS, N_DRAWS)
    draws = posterior.natural(found.straight.y_from_x(drawn.draws))
    return Fit(machine, actuators, sd, theta[posterior.sampling.free], draws, drawn.efficiency)


def test_posterior_covers_the_truth(fit):
    z = (fit.truth - fit.draws.mean(axis=0)) / fit.draws.std(axis=0)
    assert fit.efficiency > 0.2
    assert np.abs(z).max() < 4.0
    assert 0.5 < np.std(z) < 1.5


def test_forecast_of_the_audit_is_the_posterior(fit):
    nominal = dict(zip(fit.machine.layout.names, fit.machine.layout.nominal, strict=True))
    design = Design(fit.machine, {name: NormalPrior(nominal[name], sd) for name, sd in fit.sd.items()})
    plan = problems.Plan(fit.actuators, sensors=(SENSOR,), actuator_noise=machines.ACTUATOR_NOISE)
    rows = problems.compute_rows(design, plan)
    forecast = np.sqrt(np.diag(information_of_rows(rows, np.ones(len(design.sd))).covariance))
    sd = fit.draws.std(axis=0) / design.sd
    np.testing.assert_allclose(sd, forecast, rtol=0.15)
    assert forecast.min() < 0.9  # something was learnt
