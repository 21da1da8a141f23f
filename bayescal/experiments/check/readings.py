"""A variant of a calibration as a check sees it: readings of any channels, poses that nobody states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayescal.density.calibration.likelihood import CalibrationLikelihood, CalibrationPosterior
from bayescal.density.calibration.prediction import draw_readings
from bayescal.density.elimination import project_out
from bayescal.errors import NumericalError
from bayescal.experiments.check.faults.finding import Finding
from bayescal.experiments.check.faults.noise import CHECK, FAULT, describe_chance
from bayescal.experiments.check.subject import TRIES, Subject, list_names, state_slips
from bayescal.experiments.shared.chi_square import ChiSquare, format_chance
from bayescal.experiments.shared.measured import MeasuredReadings
from bayescal.experiments.shared.reading_slips import Suspicion
from bayescal.experiments.shared.search_memory import list_readings
from bayescal.experiments.shared.slips import BETTER, list_unnoticed
from bayescal.inference.mode import Mode
from bayescal.numerics.geometry import Array

DERIVATIVES = "Derivatives"
STEP = 1e-3  # prior sd, or a noise's worth of a pose
WRONG = 1e-3  # of the largest difference along a parameter
MACHINES, STARTS = 3, 4


@dataclass(frozen=True, eq=False)
class ReadingSubject(Subject):
    """A variant of a calibration.

    Attributes
    ----------
    measured : MeasuredReadings
    """

    measured: MeasuredReadings

    @cached_property
    def posterior(self) -> CalibrationPosterior:
        """The posterior of the measured readings."""
        return self.measured.posterior.anchored()

    @property
    def _likelihood(self) -> CalibrationLikelihood:
        return self.posterior.likelihood

    def list_arrays(self) -> list[Sequence[float]]:
        """Return those of a posterior of readings."""
        n_poses, n_coordinates = self._likelihood.start.shape
        return list_readings(n_poses, len(self._likelihood.model.channels), self.posterior.n_geometry, n_coordinates)

    # --- simulated data --------------------------------------------------------------------------------------------

    def _posterior_of(self, values: Array) -> CalibrationPosterior:
        """Return the posterior of other readings at the plan's poses, once or twice over, (P, K) or (2 P, K)."""
        n = self._likelihood.data.n_poses
        likelihood = self._likelihood.pick(np.tile(np.arange(n), len(values) // n))
        names = tuple(f"{name}{' again' * (k >= n)}" for k, name in enumerate(likelihood.data.poses))
        data = replace(likelihood.data, poses=names, values=values)
        return replace(self.posterior, likelihood=replace(likelihood, data=data, expansion=None)).anchored()

    def _draw(self, y: Array, rng: np.random.Generator) -> Array | None:
        """Return readings (P, K) of a machine (n,) at the poses of the measured ones; None where it has none there."""
        posterior = self.posterior
        if not self._likelihood.model.layout.inside(posterior.theta(y[None]))[0]:
            return None
        values = draw_readings(posterior, y, self._likelihood.start, rng)
        return values if (np.isfinite(values) == self._likelihood.data.present).all() else None

    def draw_values(self, rng: np.random.Generator) -> tuple[Array, Array]:
        """Return a machine of the priors (n,) and its readings (P, K)."""
        for _ in range(TRIES):
            y = self.posterior.draw_prior(1, rng)[0]
            values = self._draw(y, rng)
            if values is not None:
                return y, values
        raise NumericalError(f"simulation: found no machine that takes the poses in {TRIES} draws of the priors")

    def draw_case(self, rng: np.random.Generator) -> tuple[Array, CalibrationPosterior]:
        """Return a truth and the posterior of its readings, at the poses of the measured ones."""
        y, values = self.draw_values(rng)
        return self.posterior.natural(y[None])[0], self._posterior_of(values)

    def repeat(self, natural: Array, y: Array, rng: np.random.Generator) -> CalibrationPosterior:
        """Return the posterior of the measured readings and of simulated ones."""
        del natural
        values = self._draw(y, rng)
        if values is None:
            raise NumericalError("a draw of the posterior cannot take the poses")
        return self._posterior_of(np.concatenate([self._likelihood.data.values, values]))

    # --- measured data ---------------------------------------------------------------------------------------------

    def check_derivatives(self, rng: np.random.Generator) -> Finding:
        """Return whether readings' derivatives are those of differences, at machines of the priors."""
        worst: dict[str, float] = {}
        for _ in range(MACHINES):
            y, _ = self.draw_values(rng)
            for name, value in self._compare(y).items():
                worst[name] = max(worst.get(name, 0.0), value)
        wrong = {name: value for name, value in worst.items() if value > WRONG}
        if not wrong:
            most = max(worst.values(), default=0.0)
            text = f"the model's derivatives are those of differences, to {max(most, 1e-9):.0e} at worst."
            return Finding(DERIVATIVES, "", "good", text)
        text = (
            f"the model's derivatives by {list_names(wrong)} are wrong: off by up to {100 * max(wrong.values()):.3g} "
            "%. Correct what the machine's class returns for them; modes rest on it."
        )
        return Finding(DERIVATIVES, "derivative", "bad", text)

    def _compare(self, y: Array) -> dict[str, float]:
        """Return how far the derivative by each coordinate of posterior and pose is off, in its largest difference."""
        posterior, likelihood, m = self.posterior, self._likelihood, self.posterior.n_geometry
        model, given, pose = likelihood.model, likelihood.data.given, likelihood.start
        theta = posterior.theta(y[None])[0]
        here = model.linearise(theta, pose, True, given)
        known = [here.by_parameters @ move for move in posterior.around(y)[1].T] + list(
            np.moveaxis(here.by_pose, -1, 0)
        )
        names = [*posterior.sampling.names, *(one.name for one in model.coordinates)]
        half = 0.5 * (self.measured.high - self.measured.low)
        found = {}
        for k, (name, slope) in enumerate(zip(names, known, strict=True)):

            def read(size: float, k: int = k) -> Array:
                at, where = y.copy(), pose.copy()
                if k < m:
                    at[k] += size
                else:
                    where[:, k - m] += size * half[k - m]
                return np.asarray(model.read(posterior.theta(at[None])[0], where, given))

            rough, fine = ((read(step) - read(-step)) / (2.0 * step) for step in (STEP, STEP / 2.0))
            expected = (4.0 * fine - rough) / 3.0
            slope = slope if k < m else slope * half[k - m]
            good = np.isfinite(expected) & np.isfinite(slope)
            size = np.max(np.abs(expected), axis=0, initial=0.0, where=good)
            seen = size > 1e-9 * np.max(np.abs(np.nan_to_num(here.values)), axis=0, initial=1e-12)
            off = np.max(np.abs(slope - expected), axis=0, initial=0.0, where=good)
            found[name] = float(np.max(off[seen] / size[seen], initial=0.0))
        return found

    def check_slips(self) -> Finding:
        """Return whether another unit, sign or order of channels or rows explains the readings better."""
        measured = self.measured
        suspicion = Suspicion(measured.posterior, measured.low, measured.high)
        found = suspicion.find()
        planted: tuple[int, list[str]] = (0, [])
        if found is None:
            planted = list_unnoticed(suspicion.weigh, suspicion.list_slips(), BETTER)
        return state_slips(found, planted)

    def check_noise(self, mode: Mode) -> Finding:
        """Return whether the noise is as stated: what the best machine leaves of the readings, poses fitted along."""
        posterior, likelihood, m = self.posterior, self._likelihood, self.posterior.n_geometry
        known, y = np.zeros(posterior.n_parameters), mode.y.copy()
        with np.errstate(all="ignore"):
            stated = likelihood.whiten(
                likelihood.sd[None], 0.0 * posterior.likelihood.noise(posterior.errors, posterior.zeta(known[None]))[1]
            )
            at = likelihood.stand(posterior.theta(y[None]), stated)
            _, slope, by_parameters = posterior.likelihood.rows(*posterior.around(y), stated, at.pose)
        rows = (project_out(slope) @ by_parameters).reshape(-1, m)
        values = np.linalg.svd(rows, compute_uv=False) ** 2
        dof = float(likelihood.n_spare.sum() - np.sum(values / (1.0 + values)))
        found = ChiSquare(float(at.square.sum()), max(dof, 1.0))
        said = f"χ² of the readings is {found.value / found.dof:.2f} per degree of freedom ({found.dof:.0f}, "
        said += f"{format_chance(found.chance)}) at the stated noise"
        if posterior.errors.outliers.expected:
            return Finding(CHECK, "", "good", f"{said}; rows may be outliers, which count by how far off they are.")
        if posterior.errors.has_noise:
            natural = posterior.natural(y[None])[0, m:]
            free = zip(posterior.errors.names, natural, strict=True)
            words = ", ".join(f"{name} {value:.3g}" for name, value in free)
            return Finding(CHECK, "", "good", f"{said}; what is free of it is estimated: {words}.")
        if not found.is_off:
            return Finding(CHECK, "", "good", f"{said}, {describe_chance(found)}.")
        if found.factor < 1.0:
            text = f"{said}: less than noise of the stated size gives. It is stated too large, or rows are averages."
            return Finding(CHECK, FAULT, "warning", f"{text} Intervals are wider than they need be.")
        kinds = self._share(at.error[0])
        text = (
            f"{said}: {found.factor:.2g} times the stated noise, most of it in {kinds}. State the noise of it, leave "
            "it free in [unknown_noise], or look for what the model misses."
        )
        return Finding(CHECK, FAULT, "bad", text)

    def _share(self, white: Array) -> str:
        """Return the kind of channels with the largest white residuals, (P, K), rms."""
        kinds = np.array([one.kind for one in self._likelihood.model.channels])
        present = self._likelihood.data.present
        rms = {
            kind: float(np.sqrt(np.mean(white[:, kinds == kind][present[:, kinds == kind]] ** 2)))
            for kind in dict.fromkeys(kinds.tolist())
        }
        return max(rms, key=rms.__getitem__)

    def list_starts(self, best: Array, rng: np.random.Generator) -> list[Array]:
        """Return where the machine's jumps lead, and machines of the priors."""
        jumped = [there for _, there in self.posterior.jumps(best)]
        return jumped + list(rng.standard_normal((STARTS, self.posterior.n_parameters)))
