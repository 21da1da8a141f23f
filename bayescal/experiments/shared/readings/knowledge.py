"""What a calibration tells: of parameters, of where the machine stands, and what would tell more."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np

from bayescal.calibrated.in_use import MachineInUse
from bayescal.density.calibration.likelihood import CalibrationPosterior
from bayescal.experiments.shared.readings.inputs import Variant
from bayescal.experiments.shared.readings.schema import NextReadingsConfig
from bayescal.experiments.shared.rows import CandidatePoseRow, CombinationRow, ToolUncertaintyRow
from bayescal.experiments.shared.schema import UnitsConfig
from bayescal.identifiability.directions import find_directions, judge_parameters
from bayescal.identifiability.information import Information, information_of_rows, marginalise
from bayescal.identifiability.reading_rows import (
    Jacobians,
    LinearisedPoses,
    differentiate_poses,
    name_tool,
    see,
    typical_covariance,
    typical_given,
    whiten,
)
from bayescal.identifiability.requirements import ErrorsInUse, WorkspaceErrorModel, forecast_tool
from bayescal.identifiability.ridges import describe_ridges
from bayescal.machines.readings import Given
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import Units
from bayescal.pose_selection.next_pose import compute_gains

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class IdentifiabilityResult:
    """What a variant's readings determine."""

    verdicts: tuple[str, ...]  # on each parameter of the machine
    accuracy: list[ToolUncertaintyRow]  # of each coordinate of the tool
    combinations: list[CombinationRow]  # of parameters that are determined too little
    candidates: list[CandidatePoseRow]  # for the next measurement, the best first for each set of sensors

    def tabulate(self) -> dict[str, pd.DataFrame]:
        """Return all rows as tables by name."""
        return {
            ToolUncertaintyRow.table: ToolUncertaintyRow.collect(self.accuracy),
            CombinationRow.table: CombinationRow.collect(self.combinations),
            CandidatePoseRow.table: CandidatePoseRow.collect(self.candidates),
        }


class HasUnitsAndWorkspace(Protocol):
    """What of a config says how what is known is told: the config of a calibration, or of its audit."""

    @property
    def seed(self) -> int:
        """Of the workspace's poses and of the candidates."""

    @property
    def units(self) -> UnitsConfig:
        """Units of the sentences."""

    @property
    def next(self) -> NextReadingsConfig:
        """How many poses are tried, how many shown."""


Learnt = Callable[[LinearisedPoses], tuple[WorkspaceErrorModel, Array]]
"""From poses of the workspace to how the tool errs there, and the covariance of what it errs by."""


def compute_tool_uncertainty(
    asked: HasUnitsAndWorkspace, variant: Variant, posterior: CalibrationPosterior, y: Array, learn: Learnt
) -> IdentifiabilityResult:
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
    at = linearise_workspace(variant, posterior, y, rng)
    forecast, covariance = learn(at)
    unaligned, _ = learn(at.unalign())
    names, units = name_tool(variant.model)
    every = np.ones(len(variant.model.channels), dtype=bool)
    for name in variant.model.contacts:  # of which random poses touch none
        every[variant.model.instrument_places[name]] = False
    candidates, geometry = variant.workspace.draw(asked.next.candidates, rng), covariance[:m, :m]
    sets: list[tuple[Literal["own", "all"], np.ndarray]] = [("own", variant.internal), ("all", every)]
    tried = [
        (label, *_rank(posterior, variant, y, candidates, at, geometry, some, asked.next.n_listed))
        for label, some in sets
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
    verdicts, combinations = _judge(asked.units, posterior, y)
    rms = [np.sqrt(np.mean(one**2, axis=0)) for one in (before, after, noise, base)]
    accuracy = [
        ToolUncertaintyRow(
            variant=variant.name,
            coordinate=name,
            unit=units[k],
            prior_sd=float(rms[0][k]),
            posterior_sd=float(rms[1][k]),
            noise=float(rms[2][k]),
            max_sd=float(after[:, k].max()),
            max_sd_pose=name_place(variant, at.pose[after[:, k].argmax()], asked.units),
            frame="aligned" if variant.aligned else "base",
            unaligned_sd=float(rms[3][k]),
            max_unaligned_sd=float(base[:, k].max()),
        )
        for k, name in enumerate(names)
    ]
    places = [f"{one.name}_{one.unit}" for one in variant.model.coordinates]
    found = [
        CandidatePoseRow(
            variant=variant.name,
            sensors=label,
            variance_reduction=float(gain),
            others=dict(zip(places, pose.tolist(), strict=True)),
        )
        for label, poses, gains in tried
        for pose, gain in zip(poses, gains, strict=True)
    ]
    ridges = [
        CombinationRow(variant=variant.name, parameter=name, contraction=share, text=text)
        for name, share, text in combinations
    ]
    return IdentifiabilityResult(verdicts, accuracy, ridges, found)


def predict_tool_errors(
    variant: Variant, posterior: CalibrationPosterior, y: Array, at: LinearisedPoses, errors: ErrorsInUse
) -> WorkspaceErrorModel:
    """Return how the tool of a machine (n,) errs at poses, located by its own sensors, when these err as in use."""
    located = at.located @ whiten(typical_covariance(posterior, y), variant.internal)
    return _mask(forecast_tool(at.whole, located, errors, at.alignment), at)


def _mask(found: WorkspaceErrorModel, at: LinearisedPoses) -> WorkspaceErrorModel:
    """Return a forecast whose noise is unknown where the machine's own sensors do not determine the tool."""
    return replace(found, noise=np.where(np.isfinite(at.noise)[..., None], found.noise, np.nan))


def forecast_accuracy(
    variant: Variant, posterior: CalibrationPosterior, machine: MachineInUse, seed: int
) -> list[tuple[str, str, float]]:
    """Return names and units of the tool's numbers with their standard uncertainties, rms over the workspace."""
    at = linearise_workspace(variant, posterior, machine.y, np.random.default_rng([seed, 5]))
    forecast, covariance = learn_posterior(variant, machine)(at)
    variances = np.diagonal(forecast.covariance(covariance), axis1=-2, axis2=-1)
    return list(zip(*name_tool(variant.model), np.sqrt(variances.mean(axis=0)).tolist(), strict=True))


def learn_posterior(variant: Variant, machine: MachineInUse) -> Learnt:
    """Return what a posterior says of the tool.

    Systematic errors that were found are known together with the geometry; what is left of errors is noise.
    """

    def learn(at: LinearisedPoses) -> tuple[WorkspaceErrorModel, Array]:
        given = typical_given(variant.data.given, len(at.pose))
        return _mask(machine.predict_tool_errors(at, variant.internal, given), at), machine.covariance

    return learn


def linearise_workspace(
    variant: Variant, posterior: CalibrationPosterior, y: Array, rng: np.random.Generator
) -> LinearisedPoses:
    """Return random poses of the workspace seen by the machine's own sensors."""
    return look(posterior, variant, y, variant.region.draw(variant.region.n_poses, rng), variant.internal)


def look(
    posterior: CalibrationPosterior,
    variant: Variant,
    y: Array,
    pose: Array,
    some: np.ndarray,
    given: Given | None = None,
) -> LinearisedPoses:
    """Return poses (W, q) seen by the channels of a mask (K,), with the noise stated for the first reading of each."""
    return differentiate(posterior, variant, y, pose, given).select_channels(some)


def differentiate(
    posterior: CalibrationPosterior, variant: Variant, y: Array, pose: Array, given: Given | None = None
) -> Jacobians:
    """Return the Jacobians at poses (W, q) of one machine, of which any channels make `LinearisedPoses`.

    What the machine has to know of each pose is the median of the data's where nothing is given.
    """
    given = typical_given(variant.data.given, len(pose)) if given is None else given
    return differentiate_poses(posterior, variant.workspace.half, y, pose, given, variant.aligned)


def _rank(
    posterior: CalibrationPosterior,
    variant: Variant,
    y: Array,
    candidates: Array,
    at: LinearisedPoses,
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


def weigh(variant: Variant, at: LinearisedPoses) -> Array:
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


def name_place(variant: Variant, pose: Array, asked: UnitsConfig) -> str:
    """Return where a pose is, coordinate by coordinate, in the units of a config."""
    units = Units(asked.length, asked.angle)
    return ", ".join(
        f"{one.name} = {value / units.factor(one.unit):.4g} {units.name(one.unit)}"
        for one, value in zip(variant.model.coordinates, pose, strict=True)
    )


def plain(row: dict[Any, Any]) -> dict[str, Any]:
    """Return a row with None for what is no number."""
    return {str(k): None if isinstance(v, float) and not np.isfinite(v) else v for k, v in row.items()}
