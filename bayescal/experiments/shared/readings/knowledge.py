"""What a calibration tells: of parameters, of where the machine stands, and what would tell more."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
import pandas as pd

from bayescal.calibrated.in_use import MachineInUse
from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.experiments.shared.readings.inputs import Variant
from bayescal.experiments.shared.readings.schema import NextConfig
from bayescal.experiments.shared.schema import UnitsConfig
from bayescal.identifiability.directions import find_directions, judge_parameters
from bayescal.identifiability.information import Information, information_of_rows, marginalise
from bayescal.identifiability.reading_rows import (
    Slopes,
    View,
    differentiate_poses,
    name_tool,
    see,
    typical_covariance,
    typical_given,
    whiten,
)
from bayescal.identifiability.requirements import ErrorsInUse, Forecast, forecast_tool
from bayescal.identifiability.ridges import describe_ridges
from bayescal.machines.readings import Given
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import Units
from bayescal.pose_selection.next_pose import compute_gains


@dataclass(frozen=True, eq=False)
class Knowledge:
    """What a variant's readings tell."""

    verdicts: tuple[str, ...]  # on each parameter of the machine
    ridges: list[tuple[str, float, str]]  # a parameter, the contraction, and a sentence
    coordinates: tuple[str, ...]  # with units: what has to be accurate, m of them
    units: tuple[str, ...]
    # with after and noise, (m,): root mean square error over the workspace by what is unknown of the parameters
    # beforehand, by what is unknown of them and of systematic errors now, and by the noise of one pose's own
    # readings; NaN where the machine's own sensors do not tell it
    before: Array
    after: Array
    noise: Array
    # with worst_pose, (m,) and (m, q): the largest standard uncertainty over the workspace by what is unknown of both
    # now, and where
    worst: Array
    worst_pose: Array
    # (m,): the same as after and worst where base and tool are not aligned
    unaligned: Array
    worst_unaligned: Array
    next_pose: Array  # (c, q): poses to measure next, the best first for each set of sensors
    next_sensors: tuple[str, ...]  # ``own`` or ``all``, of each
    next_gain: Array  # (c,): by what part the mean squared error over the workspace would fall


class Asked(Protocol):
    """What of a config says how what is known is told: the config of a calibration, or of its audit."""

    @property
    def seed(self) -> int:
        """Of the workspace's poses and of the candidates."""

    @property
    def units(self) -> UnitsConfig:
        """Units of the sentences."""

    @property
    def next(self) -> NextConfig:
        """How many poses are tried, how many shown."""


Learnt = Callable[[View], tuple[Forecast, Array]]
"""From poses of the workspace to how the tool errs there, and the covariance of what it errs by."""


def assess(asked: Asked, variant: Variant, posterior: CalibrationPosterior, y: Array, learn: Learnt) -> Knowledge:
    """Return what the readings of a variant tell, to first order about one machine.

    Parameters
    ----------
    y : ndarray, shape (n,)
        The machine, in the posterior's coordinates.
    learn : callable
        The covariance (m + q, m + q) is of what remains unknown of the parameters, in the same coordinates, and of q
        systematic errors.
    """
    rng, m = np.random.default_rng([asked.seed, 5]), posterior.n_geometry
    at = look_around(variant, posterior, y, rng)
    forecast, covariance = learn(at)
    unaligned, _ = learn(at.unalign())
    names, units = name_tool(variant.model)
    every = np.ones(len(variant.model.channels), dtype=bool)
    candidates, geometry = variant.workspace.draw(asked.next.candidates, rng), covariance[:m, :m]
    tried = [
        (label, *_rank(posterior, variant, y, candidates, at, geometry, some, asked.next.shown))
        for label, some in (("own", variant.internal), ("all", every))
        if label == "own" or (some != variant.internal).any()
    ]
    before, after, noise, base = (
        np.sqrt(np.diagonal(one, axis1=-2, axis2=-1))
        for one in (
            forecast.covariance(np.eye(m)),
            forecast.covariance(covariance),
            forecast.noise,
            unaligned.covariance(covariance),
        )
    )
    verdicts, ridges = _judge(asked.units, posterior, y)
    return Knowledge(
        verdicts,
        ridges,
        names,
        units,
        np.sqrt(np.mean(before**2, axis=0)),
        np.sqrt(np.mean(after**2, axis=0)),
        np.sqrt(np.mean(noise**2, axis=0)),
        after.max(axis=0),
        at.pose[after.argmax(axis=0)],
        np.sqrt(np.mean(base**2, axis=0)),
        base.max(axis=0),
        np.concatenate([pose for _, pose, _ in tried]),
        tuple(label for label, pose, _ in tried for _ in pose),
        np.concatenate([gain for *_, gain in tried]),
    )


def foresee(variant: Variant, posterior: CalibrationPosterior, y: Array, at: View, errors: ErrorsInUse) -> Forecast:
    """Return how the tool of a machine (n,) errs at poses, located by its own sensors, when these err as in use."""
    located = at.located @ whiten(typical_covariance(posterior, y), variant.internal)
    return _mask(forecast_tool(at.whole, located, errors, at.alignment), at)


def _mask(found: Forecast, at: View) -> Forecast:
    """Return a forecast whose noise is unknown where the machine's own sensors do not determine the tool."""
    return replace(found, noise=np.where(np.isfinite(at.noise)[..., None], found.noise, np.nan))


def learn_posterior(variant: Variant, machine: MachineInUse) -> Learnt:
    """Return what a posterior says of the tool.

    Systematic errors that were found are known together with the geometry; what is left of errors is noise.
    """

    def learn(at: View) -> tuple[Forecast, Array]:
        given = typical_given(variant.data.given, len(at.pose))
        return _mask(machine.foresee(at, variant.internal, given), at), machine.covariance

    return learn


def look_around(variant: Variant, posterior: CalibrationPosterior, y: Array, rng: np.random.Generator) -> View:
    """Return random poses of the workspace seen by the machine's own sensors."""
    return look(posterior, variant, y, variant.region.draw(variant.region.n_poses, rng), variant.internal)


def look(
    posterior: CalibrationPosterior,
    variant: Variant,
    y: Array,
    pose: Array,
    some: np.ndarray,
    given: Given | None = None,
) -> View:
    """Return poses (W, q) seen by the channels of a mask (K,), with the noise stated for the first reading of each."""
    return differentiate(posterior, variant, y, pose, given).seen_by(some)


def differentiate(
    posterior: CalibrationPosterior, variant: Variant, y: Array, pose: Array, given: Given | None = None
) -> Slopes:
    """Return what moves readings and tool at poses (W, q) of one machine, of which any channels make a `View`.

    What the machine has to know of each pose is the median of the data's where nothing is given.
    """
    given = typical_given(variant.data.given, len(pose)) if given is None else given
    return differentiate_poses(posterior, variant.workspace.half, y, pose, given, variant.aligned)


def _rank(
    posterior: CalibrationPosterior,
    variant: Variant,
    y: Array,
    candidates: Array,
    at: View,
    covariance: Array,
    some: np.ndarray,
    shown: int,
) -> tuple[Array, Array]:
    """Return the poses that lower the mean squared error of the tool over the workspace most, and by what part."""
    weight = weigh(variant, at)
    if not len(candidates) or not some.any() or not np.isfinite(weight).all():
        return np.empty((0, candidates.shape[1])), np.empty(0)
    tried = look(posterior, variant, y, candidates, some)
    gain = compute_gains(tried.rows, covariance, weight)
    best = np.argsort(-gain, kind="stable")[:shown]
    return tried.pose[best], gain[best]


def weigh(variant: Variant, at: View) -> Array:
    """Return W (m, m) such that tr(W C) is the sum over poses of the tool's squared error, of lengths if it has any."""
    units = [one.unit for one in variant.model.tool_channels]
    lengths = at.tool[:, [unit == ("mm" if "mm" in units else units[0]) for unit in units]]
    return np.asarray(np.einsum("wti,wtj->ij", lengths, lengths))


def inform(posterior: CalibrationPosterior, y: Array, rows: Array) -> Information:
    """Return the information of white rows (P, K, m), beside errors common to all rows of their stated scales."""
    if not posterior.errors.has_columns:
        return information_of_rows(rows, np.ones(posterior.n_geometry))
    y = y.copy()
    y[[posterior.n_geometry + k for k in posterior.errors.switches]] = 0.0
    white, stand = posterior.likelihood.explain(*posterior.at(y[None]))
    others = posterior.likelihood.columns(posterior.errors, posterior.zeta(y[None]), white, stand.slope)[0]
    signs = posterior.errors.signs(posterior.likelihood.data)
    return marginalise(rows.reshape(-1, rows.shape[-1]), others.reshape(-1, others.shape[-1]), signs)


def _judge(
    section: UnitsConfig, posterior: CalibrationPosterior, y: Array
) -> tuple[tuple[str, ...], list[tuple[str, float, str]]]:
    """Return the verdict on each parameter, and directions that contract too little, in words."""
    rows = see(posterior, y)
    information = inform(posterior, y, rows)
    nothing = np.empty((posterior.n_geometry, 0))
    names, n = posterior.sampling.names, posterior.n_geometry
    found = describe_ridges(
        find_directions(information, nothing, ()),
        rows,
        names,
        posterior.units[:n],
        posterior.prior_sd[:n],
        Units(section.length, section.angle),
        posterior.likelihood.model.member,
    )
    ridges = [(names[direction.pivot or 0], direction.contraction, sentence) for direction, _, sentence in found]
    return judge_parameters(information, nothing), ridges


# --- as rows of tables ------------------------------------------------------------------------------------------------


def name_data(variant: Variant) -> str:
    """Return which readings a variant takes in, in words that are the same for the same ones."""
    kinds = dict.fromkeys(one.kind for one in variant.model.channels)
    return f"{' '.join(kinds)}, {variant.data.n_poses} poses, {int(variant.data.present.sum())} readings"


def tabulate_accuracy(variant: Variant, known: Knowledge, units: UnitsConfig) -> pd.DataFrame:
    """Return the standard uncertainty of a variant's tool, a coordinate a row; places in the config's units."""
    return pd.DataFrame(
        {
            "variant": variant.name,
            "coordinate": known.coordinates,
            "unit": known.units,
            "before": known.before,
            "after": known.after,
            "noise": known.noise,
            "worst": known.worst,
            "worst_at": [name_place(variant, pose, units) for pose in known.worst_pose],
            "frame": "aligned" if variant.aligned else "base",
            "unaligned": known.unaligned,
            "worst_unaligned": known.worst_unaligned,
        }
    )


def name_place(variant: Variant, pose: Array, asked: UnitsConfig) -> str:
    """Return where a pose is, coordinate by coordinate, in the units of a config."""
    units = Units(asked.length, asked.angle)
    return ", ".join(
        f"{one.name} = {value / units.factor(one.unit):.4g} {units.name(one.unit)}"
        for one, value in zip(variant.model.coordinates, pose, strict=True)
    )


def list_ridges(variant: Variant, known: Knowledge) -> Iterator[dict[str, Any]]:
    """Return the combinations that a variant does not tell."""
    for name, share, text in known.ridges:
        yield {"variant": variant.name, "parameter": name, "contraction": share, "sentence": text}


def list_next(variant: Variant, known: Knowledge) -> Iterator[dict[str, Any]]:
    """Return where to measure next, by what part the mean squared error would fall."""
    for pose, sensors, gain in zip(known.next_pose, known.next_sensors, known.next_gain, strict=True):
        coordinates = {f"{c.name}_{c.unit}": pose[k] for k, c in enumerate(variant.model.coordinates)}
        yield {"variant": variant.name, "sensors": sensors, **coordinates, "gain": gain}


def plain(row: dict[Any, Any]) -> dict[str, Any]:
    """Return a row with None for what is no number."""
    return {str(k): None if isinstance(v, float) and not np.isfinite(v) else v for k, v in row.items()}
