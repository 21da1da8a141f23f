"""Whether predicted accuracies come true: machines within the tolerances, calibrated from simulated readings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayescal.density.calibration.likelihood import CalibrationLikelihood, CalibrationPosterior
from bayescal.density.calibration.measurements import Measurements
from bayescal.density.calibration.terms import NO_ERRORS
from bayescal.density.posterior import Posterior
from bayescal.density.priors import NormalPrior
from bayescal.errors import NumericalError
from bayescal.experiments.sensor_placement.alignment import alignment_basis, take_away
from bayescal.experiments.sensor_placement.inputs import PlacementInputs
from bayescal.experiments.sensor_placement.placement import Placement, is_external
from bayescal.experiments.shared.sensor_sets import FreeParameters, SensorSet, locate_tool
from bayescal.numerics.geometry import Array


@dataclass(frozen=True)
class Simulated:
    """Errors of the tool's centre of simulated calibrations, mm.

    Attributes
    ----------
    rms : float
        Over machines and workspace.
    error : float
        Standard error of it, from the scatter over machines.
    n_machines, n_failed : int
        Calibrations that count, and those that did not converge, which do not.
    """

    rms: float
    error: float
    n_machines: int
    n_failed: int


def simulate_set(inputs: PlacementInputs, placement: Placement, chosen: np.ndarray, seed: int) -> Simulated:
    """Return how calibrations with chosen sensors (K,) turn out.

    True machines differ from the expected one in every free parameter. Each is calibrated with the tolerances as
    priors; then its tool's centre is located from noisy readings of its internal sensors. What setting up takes away
    is taken from the part without noise, for it happens once and not at every pose.
    """
    rng = np.random.default_rng([inputs.config.seed, 1, seed])
    sensors, n = inputs.sensors.select(np.flatnonzero(chosen)), inputs.config.machines
    every = FreeParameters(inputs.free, inputs.model.layout.nominal, inputs.tolerances)
    truth = every.draw(rng, n)
    seen = placement.seen[chosen].any(axis=0)
    free = FreeParameters(every.places[seen], every.centre, every.scale[seen])
    measured = sensors.read(truth[:, None], inputs.pose)
    measured = measured + sensors.noise * rng.standard_normal(measured.shape)
    found = np.array([_calibrate(sensors, free, one, inputs.pose) for one in measured])
    error, located = _locate(
        inputs, placement, sensors.select(np.flatnonzero(~is_external(sensors))), truth, found, rng
    )
    good = np.isfinite(found).all(axis=1) & located
    square = np.sum(error[good] ** 2, axis=-1).mean(axis=-1)
    rms = float(np.sqrt(square.mean())) if good.any() else float("nan")
    spread = float(square.std(ddof=1) / np.sqrt(good.sum()) / (2 * rms)) if good.sum() > 1 else float("nan")
    return Simulated(rms, spread, int(good.sum()), int((~good).sum()))


def _calibrate(sensors: SensorSet, free: FreeParameters, measured: Array, pose: Array) -> Array:
    """Return the best machine (D,) for readings (P, K), NaN where there is none."""
    layout = sensors.model.layout
    names = tuple(map(str, range(len(measured))))
    data = Measurements(names, measured, np.broadcast_to(sensors.noise, measured.shape))
    likelihood = CalibrationLikelihood(sensors.model.pick(sensors.chosen), data, 1.0, pose)
    priors = {
        layout.names[k]: NormalPrior(float(free.centre[k]), float(scale))
        for k, scale in zip(free.places, free.scale, strict=True)
    }
    posterior: CalibrationPosterior = Posterior(likelihood, priors, NO_ERRORS)
    try:
        return posterior.theta(posterior.approach()[None])[0]
    except NumericalError:
        return np.full(layout.size, np.nan)


def _locate(
    inputs: PlacementInputs,
    placement: Placement,
    in_use: SensorSet,
    truth: Array,
    theta: Array,
    rng: np.random.Generator,
) -> tuple[Array, np.ndarray]:
    """Return errors of the tool's centre, shape (C, W, m), and which machines could be located everywhere."""
    pose, model = inputs.workspace, inputs.model
    position, _, _ = model.tool(truth[:, None], pose)
    clean = in_use.read(truth[:, None], pose)
    noisy = clean + in_use.noise * rng.standard_normal(clean.shape)
    exact, located = (locate_tool(in_use, theta, readings, pose) for readings in (clean, noisy))
    off = exact.position - position
    basis = alignment_basis(model, position, pose, placement.aligned.shape[-1])
    aligned = take_away(basis, off.reshape(len(off), -1, 1)).reshape(off.shape)
    return aligned + located.position - exact.position, (exact.converged & located.converged).all(axis=1)
