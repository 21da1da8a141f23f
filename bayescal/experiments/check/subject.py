"""What is checked: a variant of a machine that was measured, with other data of the same plan where simulated."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from bayescal.density.calibration.prediction import draw_readings
from bayescal.errors import NumericalError
from bayescal.experiments.check.faults.finding import Finding
from bayescal.experiments.shared.measured import Found, MeasuredReadings
from bayescal.experiments.shared.search_memory import list_readings, list_search
from bayescal.experiments.shared.slips import FoundSlip
from bayescal.numerics.geometry import Array

SLIPS = "Units and order"
TRIES = 100
NAMED = 3


@dataclass(frozen=True, eq=False)
class Subject:
    """A variant as a check sees it, whatever its machine.

    Attributes
    ----------
    measured : MeasuredReadings
    """

    measured: MeasuredReadings

    @property
    def posterior(self) -> Found:
        """The posterior of the measured data."""
        return self.measured.found

    def list_arrays(self) -> list[Sequence[float]]:
        """Return the arrays of one data set's search; see `bayescal.experiments.frame.memory.estimate_arrays`."""
        if self.measured.legs is not None:
            return list_search(self.measured.legs.posterior)
        likelihood = self.measured.posterior.likelihood
        n_poses, n_coordinates = likelihood.start.shape
        return list_readings(n_poses, len(likelihood.model.channels), self.posterior.n_geometry, n_coordinates)

    def draw_case(self, rng: np.random.Generator) -> tuple[Array, Found]:
        """Return a truth drawn from the priors, natural units, (n,), and the posterior of what is measured of it."""
        y, values = self.draw_truth(rng)
        return self.posterior.natural(y[None])[0], self.measured.retake(values).found

    def repeat(self, y: Array, rng: np.random.Generator) -> Found:
        """Return the posterior of the measured data and those simulated of a true machine (n,) together.

        Raises
        ------
        NumericalError
            Where the machine cannot take the poses.
        """
        values = self.simulate(y, rng)
        if values is None:
            raise NumericalError("a draw of the posterior cannot take the poses")
        return self.measured.retake(np.concatenate([self.measured.posterior.likelihood.data.values, values])).found

    def draw_truth(self, rng: np.random.Generator) -> tuple[Array, Array]:
        """Return a machine of the priors (n,), with its errors, and its readings (P, K).

        Raises
        ------
        NumericalError
            Where hardly any draw of the priors is a machine that can take the poses.
        """
        for _ in range(TRIES):
            y = self.posterior.draw_prior(1, rng)[0]
            values = self.simulate(y, rng)
            if values is not None:
                return y, values
        raise NumericalError(f"simulation: found no machine that takes the poses in {TRIES} draws of the priors")

    def simulate(self, y: Array, rng: np.random.Generator) -> Array | None:
        """Return readings (P, K) of a machine (n,) at the poses of the measured ones; None where it has none there.

        A machine that was sent to its poses by commands goes where these take it.
        """
        posterior = self.measured.anchored
        own, likelihood = self.measured.adopt(y[None])[0], posterior.likelihood
        theta, data, model = posterior.theta(own[None])[0], likelihood.data, likelihood.model
        if not model.layout.inside(theta[None])[0]:
            return None
        pose, places = likelihood.start, model.select(model.commanded)
        if data.commanded is not None and len(places) and data.commanded[:, places].all():
            pose, found = model.locate(theta, data.values[:, places], data.given, pose)
            if not found.all():
                return None
        values = draw_readings(posterior, own, pose, rng)
        return values if (np.isfinite(values) == data.present).all() else None


def state_slips(found: FoundSlip | None, planted: tuple[int, list[str]]) -> Finding:
    """Return what the search for slips found, or which of those planted would pass unnoticed."""
    if found is not None:
        gain = f"better by {found.gain:.0f} nats" if np.isfinite(found.gain) else "they fit then"
        text = f"{found.text} ({gain}). Correct the table; all other findings rest on it."
        return Finding(SLIPS, found.fault, "bad", text)
    count, unnoticed = planted
    text = f"no other unit, sign or order of channels or rows explains the data better; of {count} planted slips "
    if not unnoticed:
        return Finding(SLIPS, "", "good", f"{text}none would pass unnoticed.")
    shown = [one.partition(":")[0] for one in unnoticed[:NAMED]]
    named = "; ".join(one.replace(" seem to be", "").replace(" seems to be", "") for one in shown)
    more = f"; {len(unnoticed) - NAMED} more" if len(unnoticed) > NAMED else ""
    return Finding(
        SLIPS, "", "good", f"{text}{len(unnoticed)} would pass unnoticed within the tolerances: {named}{more}."
    )


def list_names(names: Iterable[str]) -> str:
    """Return symbols of parameters, each once."""
    return ", ".join(dict.fromkeys(name.partition("[")[0] for name in names))
