"""Machines of readings as a calibration leaves them: posteriors by Laplace of simulated readings, and sessions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from calibration_problems import fit_jointly
from function_machines import point_on_lines
from sliding_platforms import sliding_star

from bayescal.calibrated.machine import CalibratedMachine, CommandErrors, Source, build_calibrated
from bayescal.density.calibration.likelihood import CalibrationLikelihood
from bayescal.density.calibration.measurements import Measurements
from bayescal.density.calibration.terms import NO_ERRORS
from bayescal.density.posterior import Posterior
from bayescal.density.priors import NormalPrior
from bayescal.machines.read import read_reading_model
from bayescal.machines.readings import ReadingModel

ROOT = Path(__file__).parents[1]
SOURCE = Source("made_up", "all", "Simulated, never measured")


@dataclass(frozen=True, eq=False)
class Planned:
    """A machine, the tolerances (mm, rad) of its free symbols, noise of its channels by kind, and its workspace."""

    model: ReadingModel
    tolerances: dict[str, float]
    noise: dict[str, float]
    low: np.ndarray
    high: np.ndarray
    given: dict[str, float]

    @property
    def sd(self) -> np.ndarray:
        return np.array([self.noise.get(one.kind, np.nan) for one in self.model.channels])


def build_planned(name: str) -> Planned:
    """Return a delta with a camera, a printer on four lines by its own motors, a point on lines, a sliding star."""
    degree, arcsec = np.pi / 180.0, np.pi / 180.0 / 3600.0
    if name == "delta":
        model = read_reading_model(ROOT / "examples" / "own_machine" / "machine.toml")
        tolerances = {"x": 0.5, "y": 0.5, "l": 0.3, "s0": 0.5, "t_x": 0.1 * degree, "t_y": 0.1 * degree}
        noise = {"s": 5e-3, "cam_x": 0.02, "cam_y": 0.02, "height": 0.01}
    elif name == "hangprinter":
        model = read_reading_model(ROOT / "experiments" / "hangprinter" / "machine.toml")
        tolerances, noise = (
            {"A_x": 5.0, "A_y": 5.0, "A_z": 5.0},
            {"motor": 0.2 * degree, "x": 0.2, "y": 0.2, "z": 0.2},
        )
    elif name == "lines":
        model = point_on_lines(4)
        tolerances, noise = {"a_x": 1.0, "a_y": 1.0, "zero": 1.0}, {"l": 0.05}
    else:
        model = sliding_star()
        tolerances = {"x_P": 0.3, "y_P": 0.3, "l": 0.3, "xi_B": 0.3, "eta_B": 0.3}
        noise = {"s": 5e-3, "x_V": 0.02, "y_V": 0.02, "phi_V": 20.0 * arcsec}
    home = np.array([one.home for one in model.coordinates])
    reach = np.array([one.reach for one in model.coordinates])
    reach = np.where(reach > 0.0, reach, 1.0)
    if name == "star":
        reach = np.array([120.0, 120.0, 15.0 * degree])
    if name == "hangprinter":
        home, reach = np.array([0.0, 0.0, 700.0]), np.array([400.0, 400.0, 500.0])
    given = dict.fromkeys(model.given, 0.0)
    return Planned(model, tolerances, noise, home - reach, home + reach, given)


def calibrate(planned: Planned, n_poses: int, rng: np.random.Generator, n_draws: int = 400) -> CalibratedMachine:
    """Return a machine of the tolerances, calibrated by simulated readings, its posterior by Laplace."""
    model, sd = planned.model, planned.sd
    layout = model.layout
    frame = sliding_star().machine.frame_parameters()  # symbols that no other of the machines has
    priors = {
        name: NormalPrior(value, planned.tolerances[name.partition("[")[0]])
        for name, value in zip(layout.names, layout.nominal, strict=True)
        if name.partition("[")[0] in planned.tolerances and name not in frame
    }
    pose = rng.uniform(planned.low, planned.high, (n_poses, len(planned.low)))
    given = {name: np.full(n_poses, value) for name, value in planned.given.items()}
    k = len(model.channels)
    names, every = tuple(f"C{i}" for i in range(n_poses)), np.tile(np.where(np.isfinite(sd), sd, 1.0), (n_poses, 1))
    data = Measurements(names, np.zeros((n_poses, k)), every, given)

    blank = Posterior(CalibrationLikelihood(model, data, 1.0, pose), priors, NO_ERRORS)
    theta = blank.theta(rng.standard_normal((1, blank.n_parameters)))[0]
    values = model.read(theta, pose, given) + every * rng.standard_normal((n_poses, k))
    values[:, ~np.isfinite(sd)] = np.nan
    data = Measurements(names, values, every, given)
    posterior = Posterior(CalibrationLikelihood(model, data, 1.0, pose), priors, NO_ERRORS)
    y, _ = fit_jointly(posterior, np.zeros(posterior.n_parameters), pose)
    covariance = np.linalg.inv(-posterior.gradient(y)[1])
    draws = posterior.theta(rng.multivariate_normal(y, covariance, n_draws, method="cholesky"))
    own = model.select(model.commanded)
    errors = CommandErrors(np.diag(every[0, own] ** 2), np.zeros(len(own)))
    bounds = np.stack([planned.low, planned.high])
    return build_calibrated(model, draws.mean(axis=0), draws, errors, SOURCE, values[:, own], given, bounds)


def draw_truth(calibrated: CalibratedMachine, rng: np.random.Generator) -> np.ndarray:
    """Return a draw of the posterior, (D,)."""
    theta = calibrated.theta.copy()
    theta[calibrated.free] = calibrated.draws[int(rng.integers(len(calibrated.draws)))]
    return theta


def read_again(
    calibrated: CalibratedMachine,
    theta: np.ndarray,
    commands: np.ndarray,
    given: dict[str, np.ndarray],
    sd: np.ndarray,
    rng: np.random.Generator,
) -> Measurements:
    """Return what a true machine (D,) reads at commands, channels of noise NaN unread."""
    pose, found = calibrated.model.locate(theta, commands, given, weights=calibrated.weights)
    assert found.all()
    normal, own = rng.standard_normal((len(commands), len(sd))), calibrated.commanded
    noise = sd * normal
    root = np.linalg.cholesky(calibrated.errors.covariance(pose, commands))
    noise[:, own] = np.where(np.isnan(sd[own]), np.nan, np.einsum("pij,pj->pi", root, normal[:, own]))
    values = calibrated.model.read(theta, pose, given) + noise
    names = tuple(f"R{k:02d}" for k in range(1, len(commands) + 1))
    return Measurements(names, values, np.tile(np.nan_to_num(sd, nan=1.0), (len(commands), 1)), given)


def only(sd: np.ndarray, model: ReadingModel, names: Sequence[str]) -> np.ndarray:
    """Return the noise of some channels, NaN for all others."""
    return np.where(np.isin(np.arange(len(sd)), model.select(names)), sd, np.nan)
