"""From config and files to the posteriors of a self-calibration's variants; every fault shows before any sampling."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path

import numpy as np

from bayescal.density.calibration.functions import FunctionErrors
from bayescal.density.calibration.likelihood import CalibrationLikelihood, CalibrationPosterior
from bayescal.density.calibration.measurements import Measurements
from bayescal.density.calibration.terms import Errors
from bayescal.density.model_error import INDEPENDENT
from bayescal.density.posterior import Posterior
from bayescal.density.priors import NormalPrior, Prior
from bayescal.errors import InputError
from bayescal.experiments.self_calibration.functions import build_functions
from bayescal.experiments.self_calibration.reading_table import ReadingTable, Truth, read_readings, read_truth
from bayescal.experiments.self_calibration.schema import ReadingVariantConfig, SelfCalibrationConfig
from bayescal.experiments.shared.reading_machine import (
    build_sensors,
    draw_poses,
    free_parameters,
    poses_about_home,
    tolerance_of,
    workspace_volume,
)
from bayescal.experiments.shared.search_memory import check_readings
from bayescal.experiments.shared.sensor_sets import FreeParameters, PoseFit, SensorSet, find_poses, null_basis
from bayescal.experiments.shared.slips import (
    BETTER,
    Columns,
    Weight,
    find_slip,
    fit_rows,
    list_reading_slips,
    weigh_rows,
)
from bayescal.machines.read import read_sliding_platform
from bayescal.machines.readings import SlidingPlatform
from bayescal.machines.readings.schema import PlanarPosesConfig
from bayescal.numerics.geometry import Array

EXPLAINED = 6.0
"""Root mean square of what no pose explains, in what tolerances and noise allow, beyond which readings are refused."""
STARTS = 0.6  # of the workspace's half widths, from where poses are looked for
SAME = 1e-6
SLACK = 4.0  # standard deviations by which the machine as expected may misplace a pose


@dataclass(frozen=True, eq=False)
class Variant:
    """Sensors and free parameters of one variant.

    Attributes
    ----------
    config : ReadingVariantConfig
    sensors : SensorSet
    free : FreeParameters
        All that may move.
    common : mapping of symbol to tuple of parameter names
        Those that deviate alike.
    pose : ndarray, shape (P, q)
        Where the machine as expected explains all readings best.
    functions : FunctionErrors or None
        Errors of the sensors that are functions of what they read.
    """

    config: ReadingVariantConfig
    sensors: SensorSet
    free: FreeParameters
    common: Mapping[str, tuple[str, ...]]
    pose: Array
    functions: FunctionErrors | None = None

    @property
    def name(self) -> str:
        """Its name."""
        return self.config.name

    @property
    def internal(self) -> SensorSet:
        """The sensors that the machine keeps after its calibration."""
        return self.sensors.select(self.kept)

    @property
    def kept(self) -> np.ndarray:
        """Where these stand among all of its sensors."""
        channels = self.sensors.model.channels
        return np.flatnonzero([not channels[k].external for k in self.sensors.chosen])

    @property
    def free_names(self) -> tuple[str, ...]:
        """Names of the free parameters, one by one."""
        return tuple(self.sensors.model.layout.names[k] for k in self.free.places)

    @property
    def together(self) -> Array:
        """Which free parameters are one coordinate, ones and zeros, shape (n, m)."""
        shared = {member: symbol for symbol, members in self.common.items() for member in members}
        owners = [shared.get(name, name) for name in self.free_names]
        return np.array([[owner == one for one in dict.fromkeys(owners)] for owner in owners], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class ReadingInputs:
    """Machine, readings and variants.

    Attributes
    ----------
    config : SelfCalibrationConfig
    model : SlidingPlatform
    table : ReadingTable
    truth : Truth or None
        Of simulated readings.
    variants : dict of name to Variant
    """

    config: SelfCalibrationConfig
    model: SlidingPlatform
    table: ReadingTable
    truth: Truth | None
    variants: dict[str, Variant]

    def measured(self, sensors: SensorSet, verification: bool) -> Array:
        """Return the readings of some sensors for one use, shape (P, K)."""
        return self.table.values[self.table.verification == verification][:, sensors.chosen]

    def data(self, variant: Variant, verification: bool = False) -> Measurements:
        """Return a variant's readings for one use."""
        rows = self.table.verification == verification
        values = self.measured(variant.sensors, verification)
        names = tuple(name for name, mine in zip(self.table.poses, rows, strict=True) if mine)
        return Measurements(names, values, np.broadcast_to(variant.sensors.noise, values.shape))

    def likelihood(self, variant: Variant, verification: bool = False) -> CalibrationLikelihood:
        """Return the density of a variant's readings for one use."""
        start = variant.pose[self.table.verification == verification]
        volume, model = workspace_volume(self.config.workspace), self.model.pick(variant.sensors.chosen)
        return CalibrationLikelihood(model, self.data(variant, verification), volume, start)

    def posterior(self, variant: Variant) -> CalibrationPosterior:
        """Return a variant's posterior."""
        names, free = self.model.layout.names, variant.free
        shared = {member: symbol for symbol, members in variant.common.items() for member in members}
        priors: dict[str, Prior] = {}
        for place, scale in zip(free.places, free.scale, strict=True):
            name = names[place]
            priors.setdefault(shared.get(name, name), NormalPrior(float(free.centre[place]), float(scale)))
        errors = Errors() if variant.functions is None else Errors((variant.functions,))
        return Posterior(self.likelihood(variant), priors, errors, common=variant.common)

    @cached_property
    def workspace(self) -> Array:
        """Poses over the workspace, shape (W, q)."""
        return draw_poses(self.model, self.config.workspace, np.random.default_rng([self.config.seed, 1]))


def read_inputs(config: SelfCalibrationConfig, folder: Path) -> ReadingInputs:
    """Return the inputs of a self-calibration; InputError names the file, the variant, the pose, the column."""
    model = read_sliding_platform(folder / config.machine)
    build_sensors(model, config.sensors)  # all of them, used or not
    wanted = {int(k) for one in config.variants for k in build_sensors(model, config.sensors, one.sensors).chosen}
    table = read_readings(folder / config.data.readings, model, wanted)
    truth = None
    if config.data.true_parameters is not None and config.data.true_poses is not None:
        true = (folder / config.data.true_parameters, folder / config.data.true_poses)
        truth = read_truth(*true, model, table.poses)
    variants = {one.name: _build_variant(config, one, model, table, folder) for one in config.variants}
    inputs = ReadingInputs(config, model, table, truth, variants)
    _ = inputs.workspace
    return inputs


def _build_variant(
    config: SelfCalibrationConfig,
    section: ReadingVariantConfig,
    model: SlidingPlatform,
    table: ReadingTable,
    folder: Path,
) -> Variant:
    try:
        sensors = build_sensors(model, config.sensors, section.sensors)
        plain = _plain_parameters(model, sensors, section, config)
        free, common = _restrict(plain, model, section)
        sensors.check(int((~table.verification).sum()), len(free.places))
        unfound = Variant(section, sensors, free, common, np.empty(0))
        if len(unfound.internal.chosen) < sensors.n_coordinates:
            raise InputError(
                f"found {len(unfound.internal.chosen)} sensors of the machine itself, expected at least "
                f"{sensors.n_coordinates} to locate its tool"
            )
    except InputError as error:
        raise InputError(f"variant {section.name!r}: {error}") from error
    check_readings(len(table.poses), len(sensors.chosen), len(free.places), sensors.n_coordinates)
    where = folder / config.data.readings
    starts = list_starts(model, config.workspace)
    pose = find_reading_poses(sensors, plain, table.values[:, sensors.chosen], starts, table.poses, where)
    model.check_poses(pose, lambda k: f"{where}: pose {table.poses[k]!r}")
    _check_workspace(config.workspace, unfound.internal, plain, pose, [f"{where}: pose {n!r}" for n in table.poses])
    functions = None
    if config.model_error.name_for(section) != INDEPENDENT:
        functions = build_functions(config, section, sensors, table.values[:, sensors.chosen])
    return Variant(section, sensors, free, common, pose, functions)


def _plain_parameters(
    model: SlidingPlatform, sensors: SensorSet, section: ReadingVariantConfig, config: SelfCalibrationConfig
) -> FreeParameters:
    """Return what is free by default, and what defines the frames and is freed all the same."""
    free = free_parameters(model, sensors.names, config.tolerances)
    if not section.also_free:
        return free
    names, seen = model.layout.names, model.seen_parameters(sensors.names)
    for name in section.also_free:
        if name not in model.frame_parameters() or name not in seen:
            raise InputError(
                f"also_free: found {name!r}, expected some of {', '.join(model.frame_parameters())} that sensors see"
            )
    places = np.union1d(free.places, [names.index(name) for name in section.also_free])
    scale = [tolerance_of(names[k], model.layout.units[k], config.tolerances) for k in places]
    return FreeParameters(places, free.centre, np.array(scale))


def _restrict(
    plain: FreeParameters, model: SlidingPlatform, section: ReadingVariantConfig
) -> tuple[FreeParameters, dict[str, tuple[str, ...]]]:
    """Return what is left free, and what of it deviates alike."""
    names = [model.layout.names[k] for k in plain.places]
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(name, []).append(name)
        symbol = name.partition("[")[0]
        if symbol != name:
            groups.setdefault(symbol, []).append(name)
    fixed = {name for one in section.fixed for name in _look_up(groups, one, "fixed")}
    kept = np.array([name not in fixed for name in names])
    if not kept.any():
        raise InputError("fixed: found no parameter left free, expected at least one")
    common = {}
    for symbol in section.common:
        members = tuple(name for name in _look_up(groups, symbol, "common") if name not in fixed)
        if len(members) < 2:
            raise InputError(f"common: found {symbol!r} with {len(members)} free parameters, expected at least two")
        common[symbol] = members
    return FreeParameters(plain.places[kept], plain.centre, plain.scale[kept]), common


def _look_up(groups: Mapping[str, list[str]], name: str, what: str) -> list[str]:
    """Return the parameters of a symbol, or the one of that name."""
    if name not in groups:
        close = difflib.get_close_matches(name, groups, n=1)
        hint = f", did you mean {close[0]!r}?" if close else ""
        symbols = dict.fromkeys(one.partition("[")[0] for one in groups)
        raise InputError(f"{what}: found {name!r}{hint}, expected some of {', '.join(symbols)}, free with its sensors")
    return groups[name]


# --- poses -------------------------------------------------------------------------------------------------------


def list_starts(model: SlidingPlatform, workspace: PlanarPosesConfig) -> Array:
    """Return poses from which to look for others, home and a grid about it, shape (S, 3)."""
    half = STARTS * np.array([workspace.position_mm, workspace.position_mm, np.radians(workspace.angle_deg)])
    return poses_about_home(model, half * np.array([(0, 0, 0), *product((-1, 0, 1), repeat=3)], dtype=np.float64))


def find_reading_poses(
    sensors: SensorSet, free: FreeParameters, measured: Array, starts: Array, names: Sequence[str], where: Path
) -> Array:
    """Return the poses (P, q) at which the machine as expected explains readings (P, K) best, from any start (S, q).

    Raises
    ------
    InputError
        Where there is no pose, or where the readings lie farther from any pose than tolerances and noise allow.
    """
    fit = _try_starts(sensors, free, measured, starts)
    for k in np.flatnonzero(~fit.converged)[:1]:
        raise InputError(
            f"{where}: pose {names[k]!r}: found readings of {', '.join(sensors.names)} that no pose has, "
            f"expected readings of this machine{find_cause(sensors, free, measured, starts)}"
        )
    off = measure_misfit(sensors, free, fit)
    for k in np.flatnonzero(~(off <= EXPLAINED))[:1]:
        raise InputError(
            f"{where}: pose {names[k]!r}: found readings {off[k]:.3g} times as far from any pose as tolerances and "
            f"noise allow, expected at most {EXPLAINED:g}{find_cause(sensors, free, measured, starts)}"
        )
    return fit.pose


def _try_starts(sensors: SensorSet, free: FreeParameters, measured: Array, starts: Array) -> PoseFit:
    """Return where readings (P, K) are explained best, from the first start of all that do as well."""
    tried = find_poses(sensors, free.centre, measured, starts[:, None], check=False)
    square = np.where(tried.converged, np.einsum("spk,spk->sp", tried.error, tried.error), np.inf)
    # the first start that does as well as any, home before all: readings of few sensors may have several poses
    best = np.argmax(square <= (1.0 + SAME) * square.min(axis=0) + SAME, axis=0), np.arange(len(measured))
    return PoseFit(tried.pose[best], tried.error[best], tried.converged[best], tried.n_iterations)


def _fit_together(sensors: SensorSet, free: FreeParameters, fit: PoseFit) -> Array:
    """Return the rms of what no pose explains beside the best machine to first order, in the noise's, shape (P,).

    Infinite for poses that are not found.
    """
    found = np.where(fit.converged)[0]
    here = sensors.linearise(free.centre, fit.pose[found])
    basis = null_basis(here.by_pose)
    rest = np.einsum("pzk,pk->pz", basis, fit.error[found])
    slope = basis @ here.by_parameters[..., free.places] * free.scale
    result = np.full(len(fit.pose), np.inf)
    result[found] = fit_rows(rest, slope, np.full(len(rest), sensors.redundancy))
    return result


def find_cause(
    sensors: SensorSet, free: FreeParameters, measured: Array, starts: Array, denied: Sequence[str] = ()
) -> str:
    """Return the end of a sentence: the slip that explains readings that the machine cannot have, if there is one.

    Arguments are those of `find_reading_poses`; poses are looked for from the first start alone. They are judged
    together: tolerances are those of one machine. Slips that are ``denied`` are not tried.
    """
    if sensors.redundancy < 1:
        return ""

    def judge(values: Array) -> tuple[Array, int]:
        off = _fit_together(sensors, free, _try_starts(sensors, free, values, starts[:1]))
        return off, len(off) * sensors.redundancy

    def weigh(data: Columns, chosen: np.ndarray | None) -> Weight:
        whole = chosen is None or len(chosen) == len(data.values)
        return weigh_rows(lambda: judge(data.values if whole else data.values[chosen]))

    units = [sensors.model.channels[k].unit for k in sensors.chosen]
    slips = (one for one in list_reading_slips(sensors.names, units, measured) if not one.data.circular)
    found = find_slip(weigh, Columns(measured), slips, BETTER, denied)
    return "" if found is None else f"; {found.say()}"


def measure_misfit(sensors: SensorSet, free: FreeParameters, fit: PoseFit) -> Array:
    """Return the rms of what no pose explains, by its standard deviation beforehand, shape (P,); zero without rest."""
    if sensors.redundancy < 1:
        return np.zeros(len(fit.pose))
    here = sensors.linearise(free.centre, fit.pose)
    basis = null_basis(here.by_pose)
    rest = np.einsum("pzk,pk->pz", basis, fit.error)
    slope = basis @ here.by_parameters[..., free.places] * free.scale
    covariance = slope @ np.swapaxes(slope, -1, -2) + np.eye(sensors.redundancy)
    square = np.einsum("pz,pz->p", rest, np.linalg.solve(covariance, rest[..., None])[..., 0])
    return np.sqrt(square / sensors.redundancy)


def _check_workspace(
    workspace: PlanarPosesConfig, sensors: SensorSet, free: FreeParameters, pose: Array, names: Sequence[str]
) -> None:
    """Raise InputError for a pose outside the workspace, over which poses are taken to lie."""
    model = sensors.model
    assert isinstance(model, SlidingPlatform)
    here = sensors.linearise(free.centre, pose)
    by_pose = model.tool(free.centre, pose)[1]
    moved = np.concatenate([by_pose, np.broadcast_to([[0.0, 0.0, 1.0]], (len(pose), 1, 3))], axis=1)
    spread = moved @ np.linalg.pinv(here.by_pose) @ (here.by_parameters[..., free.places] * free.scale)
    off = model.tool(free.centre, pose)[0] - model.tool(free.centre, model.home)[0]
    found = np.concatenate([off, pose[:, 2:] - model.home[2]], axis=1)
    half = np.array([workspace.position_mm, workspace.position_mm, np.radians(workspace.angle_deg)])
    outside = np.abs(found) > half + SLACK * np.linalg.norm(spread, axis=2)
    for k, coordinate in np.argwhere(outside)[:1]:
        what, unit, size = ("tool's centre", "mm", 1.0) if coordinate < 2 else ("platform", "deg", np.degrees(1.0))
        raise InputError(
            f"{names[k]}: found its {what} {size * found[k, coordinate]:.4g} {unit} from home, expected within the "
            f"workspace of ±{size * half[coordinate]:g} {unit}"
        )
