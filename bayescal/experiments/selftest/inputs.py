"""From a check's config to what is checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.calibration.prediction import draw_readings
from bayescal.density.calibration.terms import CommonDraws
from bayescal.errors import NumericalError
from bayescal.experiments.runner.load import load
from bayescal.experiments.selftest.schema import SelftestConfig
from bayescal.experiments.shared.measured import MeasuredReadings, measure_variants
from bayescal.experiments.shared.search_memory import list_readings
from bayescal.inference.exploration import Exploration, explore
from bayescal.inference.importance import resample
from bayescal.inference.sampling import sample_posterior
from bayescal.limits import PARETO_K_LIMIT
from bayescal.numerics.geometry import Array

TRIES = 100
KEPT = 1000
ENSEMBLES, WALKERS, BURN_IN, STEPS = 4, 64, 30, 30  # where importance resampling will not do


@dataclass(frozen=True, eq=False)
class SelftestInputs:
    """A check, read."""

    config: SelftestConfig
    origin: str  # of the data, in words
    subjects: dict[str, TestedVariant]  # the study's variants that may be checked, by their names


def read_selftest(config: SelftestConfig, folder: Path) -> SelftestInputs:
    """Return a check, read; InputError where the file calibrates no machine, or a variant is not there."""
    path = folder / config.study
    found = measure_variants(*load(path), path, config.variants)
    origin = next(iter(found.values())).origin.partition(": study ")[0]
    return SelftestInputs(config, origin, {name: TestedVariant(measured) for name, measured in found.items()})


@dataclass(frozen=True, eq=False)
class TestedVariant:
    """A variant as a check sees it, whatever its machine."""

    measured: MeasuredReadings

    @property
    def posterior(self) -> CalibrationPosterior:
        """The posterior of the measured data."""
        return self.measured.with_pose_guesses

    def list_arrays(self) -> list[Sequence[float]]:
        """Return the arrays of one data set's search; see `bayescal.experiments.runner.memory.estimate_arrays`."""
        likelihood = self.measured.posterior.likelihood
        n_poses, n_coordinates = likelihood.start.shape
        return list_readings(n_poses, len(likelihood.model.channels), self.posterior.n_geometry, n_coordinates)

    def draw_case(self, rng: np.random.Generator) -> tuple[Array, CalibrationPosterior]:
        """Return a truth drawn from the priors, natural units, (n,), and the posterior of what is measured of it."""
        y, values = self.draw_truth(rng)
        return self.posterior.natural(y[None])[0], self.measured.retake(values).with_pose_guesses

    def repeat(self, y: Array, rng: np.random.Generator) -> CalibrationPosterior:
        """Return the posterior of the measured data and those simulated of a true machine (n,) together.

        NumericalError where the machine cannot take the poses.
        """
        posterior = self.measured.with_pose_guesses
        with np.errstate(all="ignore"):
            drawn = posterior.likelihood.draw_common(*posterior.at(y[None]), rng)
        values = self.simulate(y, rng, drawn)
        if values is None:
            raise NumericalError("a posterior draw misses the poses")
        return self.measured.retake(
            np.concatenate([self.measured.posterior.likelihood.data.values, values])
        ).with_pose_guesses

    def draw_truth(self, rng: np.random.Generator) -> tuple[Array, Array]:
        """Return a machine of the priors (n,), with its errors, and its readings (P, K).

        NumericalError where hardly any draw of the priors is a machine that can take the poses.
        """
        for _ in range(TRIES):
            y = self.posterior.draw_prior(1, rng)[0]
            values = self.simulate(y, rng)
            if values is not None:
                return y, values
        raise NumericalError(f"simulation: found no machine for the poses in {TRIES} prior draws")

    def simulate(self, y: Array, rng: np.random.Generator, drawn: CommonDraws | None = None) -> Array | None:
        """Return readings (P, K) of a machine (n,) at the poses of the measured ones; None where it has none there.

        A machine that was sent to its poses by commands goes where these take it. Errors common to all rows are those
        drawn, or of their prior, by the sizes that belong to the machine.
        """
        posterior = self.measured.with_pose_guesses
        likelihood = posterior.likelihood
        theta, data, model = posterior.theta(y[None])[0], likelihood.data, likelihood.model
        if not model.layout.inside(theta[None])[0]:
            return None
        pose, places = likelihood.start, model.select(model.commanded)
        if data.commanded is not None and len(places) and data.commanded[:, places].all():
            pose, found = model.locate(theta, data.values[:, places], data.given, pose)
            if not found.all():
                return None
        common = None if drawn is None or not drawn.parts else drawn.at(data, likelihood.error_gain)[0]
        values = draw_readings(posterior, y, pose, rng, common)
        return values if (np.isfinite(values) == data.present).all() else None


def draw_posterior(
    posterior: CalibrationPosterior, n_draws: int, seed: np.random.SeedSequence
) -> tuple[Array, Array, Exploration, Array]:
    """Return draws (S, n), natural and in coordinates, the exploration, and their weights' efficiency and Pareto k.

    Draws of the proposal resampled by their weights; of an ensemble where their tail forbids it.
    """
    explore_seed, draw_seed, ensemble_seed = seed.spawn(3)
    found = explore(posterior, explore_seed)
    straight = found.straight
    made = resample(straight.log_density, found.proposal, np.random.default_rng(draw_seed), n_draws, KEPT)
    quality = np.array([made.efficiency, made.pareto_k])
    if made.pareto_k > PARETO_K_LIMIT:
        sample = sample_posterior(found, ensemble_seed, ENSEMBLES, WALKERS, BURN_IN, STEPS)
        n = posterior.n_parameters
        return sample.natural.reshape(-1, n), sample.y.reshape(-1, n), found, quality
    y = straight.y_from_x(made.draws)
    return posterior.natural(y), y, found, quality
