"""What accuracy remains: errors of the predicted pose over the workspace, and the probability to keep the limits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bayescal.identifiability.design import Plan
from bayescal.identifiability.information import Information
from bayescal.identifiability.sensitivity import Sensitivity, root_of
from bayescal.numerics.geometry import Array

DRAWS = 2000
CHUNK = 500  # a divisor of these
COMPONENTS = ("x", "y", "z", "rotation_x", "rotation_y", "rotation_z")
NORMS = {"position": slice(0, 3), "rotation": slice(3, 6)}


@dataclass(frozen=True)
class Requirement:
    """A limit on a component of an error, or on the length of its position or rotation part.

    Attributes
    ----------
    name : str
        One of the components or of `NORMS`.
    limit : float
        mm or rad.
    components : tuple of str
        Of the errors: those of a platform's pose, or what else has to be accurate, positions first.
    """

    name: str
    limit: float
    components: tuple[str, ...] = COMPONENTS

    @property
    def where(self) -> slice:
        """Which components are limited."""
        return NORMS.get(self.name) or slice(k := self.components.index(self.name), k + 1)

    def take(self, error: Array) -> Array:
        """Return the required quantity of errors (..., c), not negative, shape (...)."""
        part = error[..., self.where]
        return np.abs(part[..., 0]) if part.shape[-1] == 1 else np.asarray(np.linalg.norm(part, axis=-1))

    def variance(self, covariance: Array) -> Array:
        """Return the variance of the quantity from covariances (..., c, c), summed over a norm's parts."""
        return np.asarray(np.diagonal(covariance, axis1=-2, axis2=-1)[..., self.where].sum(axis=-1))


@dataclass(frozen=True)
class Outlook:
    """How a requirement stands.

    Attributes
    ----------
    requirement : Requirement
    prior_sd, predicted_sd : float
        Largest standard deviation in the workspace before and after the calibration, mm or rad; of a length the root
        mean square.
    prior_probability, probability : float
        That no pose of the workspace exceeds the limit.
    geometry_sd : float
        The part of ``predicted_sd`` that the geometry causes; the rest are actuators and model error.
    reduced_sd, reduced_probability : float
        The same where only the recommended parameters are calibrated and the others, though off by their tolerances,
        are taken for nominal.
    """

    requirement: Requirement
    prior_sd: float
    predicted_sd: float
    prior_probability: float
    probability: float
    geometry_sd: float
    reduced_sd: float
    reduced_probability: float


@dataclass(frozen=True, eq=False)
class Forecast:
    """The workspace's poses and how they move with the parameters.

    Attributes
    ----------
    sensitivity : Sensitivity
    sd : ndarray, shape (n,)
        Tolerances.
    """

    sensitivity: Sensitivity
    sd: Array

    @property
    def slope(self) -> Array:
        """Pose by parameters in units of the tolerances, shape (W, 6, n)."""
        return self.sensitivity.slope * self.sd

    def covariance(self, geometry: Array) -> Array:
        """Return pose covariances (W, 6, 6) of a covariance of the parameters in units of the tolerances."""
        result: Array = self.slope @ geometry @ np.swapaxes(self.slope, -1, -2)
        return result

    def effect(self, vector: Array) -> Array:
        """Return what a move along a direction (n,) does to the poses, shape (W, 6)."""
        return np.asarray(self.slope @ vector)

    def judge(
        self,
        requirements: list[Requirement],
        information: Information,
        plan: Plan,
        rng: np.random.Generator,
        free: tuple[int, ...],
    ) -> list[Outlook]:
        """Return how requirements stand before and after the calibration, to first order.

        Parameters
        ----------
        requirements : list of Requirement
        information : Information
        plan : Plan
        rng : Generator
        free : tuple of int
            The parameters that are recommended to be freed.
        """
        identity = np.eye(len(self.sd))
        noise = self.sensitivity.pose_noise(plan)
        prior, after = self.covariance(identity), self.covariance(information.covariance)
        before = self._probabilities(requirements, identity, noise, rng)
        later = self._probabilities(requirements, root_of(information.covariance).T, noise, rng)
        errors = information.errors_of_reduced(free)
        reduced = self.covariance(errors)
        chances = self._probabilities(requirements, root_of(errors).T, noise, rng)
        return [
            Outlook(
                requirement,
                _largest(requirement, prior + noise),
                _largest(requirement, after + noise),
                float(before[k]),
                float(later[k]),
                _largest(requirement, after),
                _largest(requirement, reduced + noise),
                float(chances[k]),
            )
            for k, requirement in enumerate(requirements)
        ]

    def _probabilities(
        self, requirements: list[Requirement], root: Array, noise: Array, rng: np.random.Generator
    ) -> Array:
        """Return the share of draws of which no pose exceeds the limit."""
        good = np.zeros(len(requirements))
        for error in draw_errors(self.slope @ root, np.swapaxes(root_of(noise), -1, -2), rng):
            good += [np.sum((r.take(error) <= r.limit).all(axis=1)) for r in requirements]
        return good / DRAWS

    def share_of_limit(self, vector: Array, requirements: list[Requirement]) -> tuple[float, str]:
        """Return the largest share of a limit that a move along a direction takes anywhere, and of which limit."""
        effect = self.effect(vector)
        shares = {r.name: float(r.take(effect).max()) / r.limit for r in requirements}
        worst = max(shares, key=lambda name: shares[name])
        return shares[worst], worst


def draw_errors(slope: Array, noise_root: Array, rng: np.random.Generator) -> Iterator[Array]:
    """Yield the errors of `DRAWS` machines at W poses, with noise, in parts of shape (`CHUNK`, W, t).

    Parameters
    ----------
    slope : ndarray, shape (W, t, n)
        What standard normal numbers, n for each machine, make of the errors at the poses.
    noise_root : ndarray, shape (W, t, k)
        The same of the noise at one pose, k for each machine and pose.
    """
    flat = slope.reshape(-1, slope.shape[-1])
    for _ in range(DRAWS // CHUNK):
        error = (flat @ rng.standard_normal((slope.shape[-1], CHUNK))).T.reshape(CHUNK, *slope.shape[:2])
        error += np.einsum("wij,bwj->bwi", noise_root, rng.standard_normal((*error.shape[:2], noise_root.shape[-1])))
        yield error


def _largest(requirement: Requirement, covariance: Array) -> float:
    return float(np.sqrt(requirement.variance(covariance).max()))


def find_limits(requirements: Sequence[Requirement], slope: Array) -> Array:
    """Return limits of the components of an error, mm and rad, shape (c,); infinite where nothing is required.

    A limit on a length holds for each of its components, where they have no smaller one. Without any requirement they
    are the root mean square errors over the workspace before any measurement, so that all count alike.

    Parameters
    ----------
    requirements : list of Requirement
    slope : ndarray, shape (W, c, L)
        What has to be accurate at the workspace's poses, by the parameters in units of the tolerances.
    """
    limits = np.full(slope.shape[1], np.inf)
    for requirement in requirements:
        limits[requirement.where] = np.minimum(limits[requirement.where], requirement.limit)
    if np.isfinite(limits).any():
        return limits
    before = np.sqrt(np.mean(np.sum(slope**2, axis=-1), axis=0))
    return np.where(before > 0.0, before, np.inf)
