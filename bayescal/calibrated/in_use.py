"""How the tool of a calibrated machine errs in use: geometry and errors that were found with it, known together.

One computation for accuracy, requirements and the next pose. Errors that are functions of the pose go on in use; what a
calibration found of them is known jointly with the geometry (`KnownFunctions`), and only what is random, drifts or lies
outside of their columns is noise. In the coordinates (y, c) of the posterior's m numbers of the geometry and A
coefficients all is normal about the mean; without functions A is zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from bayescal.calibrated.functions import KnownFunctions
from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.density.calibration.measurements import Measurements
from bayescal.identifiability.reading_rows import (
    Jacobians,
    LinearisedPoses,
    typical_covariance,
    typical_noise,
    whiten,
)
from bayescal.identifiability.requirements import ErrorsInUse, ToolRemaining, WorkspaceErrorModel, forecast_tool
from bayescal.machines.readings import Given
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class MachineInUse:
    """A machine as a posterior knows it, y (n,) in the mean, its geometry with a covariance (m, m) in y."""

    posterior: CalibrationPosterior
    y: Array
    geometry: Array
    known: KnownFunctions | None

    @classmethod
    def find(cls, posterior: CalibrationPosterior, draws: Array, geometry: Array | None = None) -> Self:
        """Return what draws (T, n) of a posterior say, the covariance of its geometry theirs where none is given."""
        m = posterior.n_geometry
        found = np.atleast_2d(np.cov(draws[:, :m], rowvar=False)) if geometry is None else geometry
        return cls(posterior, draws.mean(axis=0), found, KnownFunctions.find(posterior, draws))

    @cached_property
    def theta(self) -> Array:
        """The mean machine, (D,)."""
        return np.asarray(self.posterior.theta(self.y[None])[0])

    @cached_property
    def given_geometry(self) -> tuple[Array, Array]:
        """How coefficients follow y's geometry, (A, m), and a root (A, r) of their covariance given it."""
        if self.known is None:
            return np.zeros((0, len(self.geometry))), np.zeros((0, 0))
        follow, left = self.known.given_geometry
        return follow @ self.posterior.around(self.y)[1][self.posterior.sampling.free], left

    @cached_property
    def covariance(self) -> Array:
        """Of geometry and coefficients together, (m + A, m + A)."""
        follow, left = self.given_geometry
        across = follow @ self.geometry
        return np.block([[self.geometry, across.T], [across, across @ follow.T + left @ left.T]])

    def draw(self, y: Array, rng: np.random.Generator) -> Array:
        """Return draws (T, m + A) of geometry and coefficients about their mean, by draws (T, n) of the posterior."""
        apart = (y - self.y)[:, : len(self.geometry)]
        follow, left = self.given_geometry
        coefficients = apart @ follow.T + rng.standard_normal((len(y), left.shape[1])) @ left.T
        return np.concatenate([apart, coefficients], axis=1)

    # --- at poses ----------------------------------------------------------------------------------------------------

    def err(self, pose: Array, given: Given) -> ErrorsInUse:
        """Return what channels err by at poses (W, q)."""
        own = np.nan_to_num(typical_noise(self.posterior, self.y[None], own=True)[0])
        if self.known is None:
            every = np.nan_to_num(typical_noise(self.posterior, self.y[None])[0])
            return ErrorsInUse(np.tile(every**2, (len(pose), 1)), None)
        known, model = self.known, self.posterior.likelihood.model
        read = model.read(self.theta, pose, given)
        nothing = Measurements(
            tuple(map(str, range(len(read)))), np.full(read.shape, np.nan), np.ones_like(read), given
        )
        shown, left = known.show(model, nothing, read)
        drifts = np.broadcast_to(known.place(model) * known.drift, (len(read), *known.place(model).shape))
        random = np.concatenate([np.sqrt(left)[..., None] * np.eye(left.shape[-1]), drifts], axis=-1)
        gain = model.error_gain(self.theta, pose, given)
        if gain is not None:
            shown, random = gain @ shown, gain @ random
        return ErrorsInUse(own**2 + (random**2).sum(axis=-1), shown)

    def predict_tool_errors(self, at: LinearisedPoses, internal: np.ndarray, given: Given) -> WorkspaceErrorModel:
        """Return how the tool errs at poses, located by the channels of a mask (K,), when these err as in use."""
        if self.known is None:
            return WorkspaceErrorModel(at.tool, at.located @ np.swapaxes(at.located, 1, 2))
        errors = self.err(at.pose, given)
        located = at.located @ whiten(typical_covariance(self.posterior, self.y), internal)
        return forecast_tool(at.whole, located, errors, at.alignment)

    def remain(
        self, internal: np.ndarray, pose: Array, given: Given, y: Array, seed: int, aligned: bool
    ) -> ToolRemaining:
        """Return errors at poses (W, q), located by read channels of a mask (K,), of draws (S, n) as true machines."""
        likelihood, shown = self.posterior.likelihood, None
        own = np.flatnonzero(internal & likelihood.data.present.any(axis=0))
        sd = typical_noise(self.posterior, y, own=self.known is not None)[:, own]
        if self.known is not None:  # beside the sensors' noise what is random and drifts, as it is on average
            errors = self.err(pose, given).of(own)
            beside = errors.variance - typical_noise(self.posterior, self.y[None], own=True)[0, own] ** 2
            sd, shown = np.sqrt(sd**2 + np.maximum(beside, 0.0)[:, None]), errors.shown
        theta = np.asarray(self.posterior.theta(y).mean(axis=0))
        return ToolRemaining(likelihood.model, own, theta, pose, given, sd, seed, shown, aligned)

    def see(self, slopes: Jacobians, given: Given, read: np.ndarray | None = None) -> Array:
        """Return what all channels say of geometry and coefficients at poses, these eliminated, (W, K, m + A).

        ``read`` (K,) says which channels are read, where not all are.
        """
        every = np.ones(slopes.by_pose.shape[1], dtype=bool) if read is None else read
        if self.known is None:
            return slopes.select_channels(every).rows
        errors = self.err(slopes.pose, given)
        assert errors.shown is not None
        stated = typical_covariance(self.posterior, self.y, own=True)
        noise = stated + (errors.variance - np.diagonal(stated))[..., None] * np.eye(len(stated))
        noise = np.where(np.diagonal(slopes.noise)[:, None] * np.diagonal(slopes.noise) > 0.0, noise, 0.0)
        white = whiten(noise, every)
        slope = white @ slopes.by_pose
        rows = np.concatenate([white @ slopes.seen, white @ errors.shown], axis=-1)
        return np.asarray(rows - slope @ (np.linalg.pinv(slope) @ rows))
