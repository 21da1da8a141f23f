"""From config and files to the posteriors of a calibration's variants; every fault shows before any sampling."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from bayescal.density.calibration.likelihood import CalibrationLikelihood, CalibrationPosterior
from bayescal.density.calibration.measurements import Measurements, RowPositions
from bayescal.density.calibration.terms import ErrorModel, ErrorTerm
from bayescal.density.elimination import project_out
from bayescal.density.posterior import Posterior
from bayescal.density.priors import Prior
from bayescal.errors import InputError, NumericalError, name_faults, say_unknown
from bayescal.experiments.runner.results import Summary
from bayescal.experiments.shared.outlook import describe_determinacy, join_outlooks
from bayescal.experiments.shared.readings.columns import check_columns, doubt_columns
from bayescal.experiments.shared.readings.data_schema import ReadingsTable
from bayescal.experiments.shared.readings.errors import (
    build_terms,
    build_terms_of_model,
    find_own_channels,
    measure_ranges,
)
from bayescal.experiments.shared.readings.found_frames import find_frames, settle_unstated
from bayescal.experiments.shared.readings.instruments import keep_files, read_instruments, read_model
from bayescal.experiments.shared.readings.measurement import Measured, leave_pose, measure_tables, settle
from bayescal.experiments.shared.readings.noise import build_noise, stated_noise
from bayescal.experiments.shared.readings.pads import SeenPads, look_at_pads
from bayescal.experiments.shared.readings.priors import check_optional, choose_priors, widen
from bayescal.experiments.shared.readings.reading_tables import (
    PoseReadings,
    complete_readings,
    join_readings,
    read_tables,
)
from bayescal.experiments.shared.readings.reference_values import ReferenceValues, read_beside
from bayescal.experiments.shared.readings.workspace import Workspace, build_workspace, find_region, find_starts
from bayescal.experiments.shared.requirements import is_aligned, read_requirements
from bayescal.experiments.shared.search_memory import check_readings
from bayescal.experiments.shared.slip_rows import VariantReadings
from bayescal.experiments.shared.study_schema import StudyConfig, VariantConfig
from bayescal.experiments.shared.unreachable_rows import check_reach
from bayescal.files.csv_tables import WrittenColumn
from bayescal.machines.readings import Instrument, ReadingModel, place
from bayescal.numerics.geometry import Array

FEWEST_ROWS = 3  # fewer may be alike on purpose


@dataclass(frozen=True, eq=False)
class Variant:
    """A model of the readings."""

    config: VariantConfig
    whole: ReadingModel  # the machine with all its channels
    model: ReadingModel  # the machine with the channels that the variant takes in, K of them
    priors: Mapping[str, Prior]
    fixed: Mapping[str, float]
    common: Mapping[str, tuple[str, ...]]
    errors: ErrorModel
    data: Measurements  # of all poses that it takes in, without the readings of other channels
    verification: np.ndarray  # (P,)
    start: Array  # (P, q): where the machine as expected explains the readings best
    workspace: Workspace  # where the machine may stand
    # whether accuracy is the error that remains after base and tool were aligned over the workspace
    aligned: bool = False
    missing: str = ""
    begin: Mapping[str, float] = field(default_factory=dict)  # values, by name, from which searches begin
    measured: Workspace | None = None  # where its poses were measured; None where a workspace is stated

    @property
    def region(self) -> Workspace:
        """Where its accuracy counts."""
        return self.measured or self.workspace

    @property
    def name(self) -> str:
        """Its name."""
        return self.config.name

    def likelihood(self, which: np.ndarray) -> CalibrationLikelihood:
        """Return the density of the readings of some poses, by a mask (P,)."""
        found = CalibrationLikelihood(self.model, self.data.pick(which), self.workspace.volume, self.start[which])
        return replace(found, hidden=self.errors.has_columns and not self.errors.is_common_known)

    def posterior(self, which: np.ndarray | None = None, factor: float = 1.0) -> CalibrationPosterior:
        """Return the posterior of some poses, those for calibration by default; ``factor`` widens all priors."""
        likelihood = self.likelihood(~self.verification if which is None else which)
        priors = self.priors if factor == 1.0 else {k: widen(one, factor) for k, one in self.priors.items()}
        found: CalibrationPosterior = Posterior(likelihood, priors, self.errors, self.fixed, self.common)
        if not self.begin:
            return found
        theta, names = found.sampling.start.copy(), self.model.layout.names
        theta[[names.index(one) for one in self.begin]] = list(self.begin.values())
        return replace(found, likelihood=replace(likelihood, begin=theta))

    def plain(self, which: np.ndarray | None = None) -> CalibrationPosterior:
        """Return the same with each parameter by itself for a coordinate, standard normal under the prior."""
        posterior = self.posterior(which)
        return replace(posterior, likelihood=posterior.likelihood.plain)

    def list_readings(self, which: np.ndarray | None = None) -> VariantReadings:
        """Return the same for slips to be looked for in."""
        return VariantReadings(self.plain(which), self.workspace.low, self.workspace.high, self.internal)

    def describe_determinacy(self) -> str:
        """Return in a line what its readings can determine, to first order about the nominal machine."""
        posterior = self.plain()
        data, q, m = posterior.likelihood.data, len(self.model.coordinates), posterior.n_geometry
        y = posterior.begin
        with np.errstate(all="ignore"):
            white, at = posterior.likelihood.explain(*posterior.at(y[None]))
            _, slope, by_parameters = posterior.likelihood.rows(*posterior.around(y), white, at.pose)
        rows = np.nan_to_num(project_out(np.nan_to_num(slope)) @ by_parameters)
        counted = f"{int(data.present.sum())} readings in {data.n_poses} rows for {m} + {q * data.n_poses} unknowns"
        return describe_determinacy(f"{counted} of machine and poses", rows, posterior.sampling.names)

    @property
    def internal(self) -> np.ndarray:
        """Which channels the machine keeps after its calibration, shape (K,)."""
        return np.array([not one.external for one in self.model.channels])


@dataclass(frozen=True, eq=False)
class ReadingInputs:
    """Readings and variants."""

    config: StudyConfig
    machine: str  # its name
    variants: dict[str, Variant]
    beside: list[ReferenceValues]
    files: dict[str, bytes]  # those that the machines are read from, by names in one folder
    machine_folder: str  # where in that folder the config's own one is
    unused: str = ""  # which columns of the tables no variant takes in, in a line; empty where it takes in all
    # which terms of the model error there cannot be, by variant, in a line; empty where there are all
    missing: str = ""
    units: Mapping[str, str] = field(default_factory=dict)  # of columns, by channel, where they are not the channel's
    columns: Mapping[str, WrittenColumn] = field(default_factory=dict)  # by channel, where readings come from a table
    found: str = ""  # values of instruments that were found from the data, in a line
    measured: Sequence[Measured] = ()  # what tables of instruments tell
    pads: SeenPads | None = None  # targets on a mechanism

    @property
    def described(self) -> Summary:
        """Entries of the summary that say what instruments measured; of several of a kind the first counts."""
        return {key: value for one in reversed(self.measured) for key, value in one.described.items()}


def read_inputs(config: StudyConfig, folder: Path, only: Collection[str] | None = None) -> ReadingInputs:
    """Return the inputs of a calibration, of some of its variants or of all.

    Raises
    ------
    InputError
        It names the file, the variant, the pose, the column.
    """
    read = [one for one in config.data if isinstance(one, ReadingsTable)]
    measured, pads = list[Measured](), None
    if len(read) < len(config.data):
        looked_at = read_first_machine(config, folder)
        measured = measure_tables(config, folder, looked_at)
        config, pads = settle(config, measured), look_at_pads(config, measured, looked_at)
    bare, models = dict[str, ReadingModel](), dict[str, ReadingModel]()
    instruments = _name_instruments(measured) | read_instruments(config.instruments, folder)
    tracked = any(one.tracker is not None for one in measured)
    beside_them = {name: settle_unstated(one) for name, one in instruments.items()}
    for one in config.variants:
        file = folder / (one.machine or config.machine)
        with name_faults(f"variant {one.name!r}") if one.model else nullcontext():
            own = read_model(config, one, file, folder, None if pads is None else pads.matrix)
            bare[one.name] = leave_pose(own) if tracked else own
            models[one.name] = place(bare[one.name], beside_them)
        model = next(iter(models.values()))
        if models[one.name].names != model.names:
            first = config.variants[0].name
            raise InputError(f"{file}: found other channels than in {first!r}, expected the same")
    for it in measured:
        it.check(model)
    symbols = {symbol for one in models.values() for symbol in one.layout.symbols}
    given = list(dict.fromkeys(name for one in models.values() for name in one.given))
    blocks = [read_tables(read, folder, model.channels, given, alone=not measured)] if read else []
    blocks += [it.spread(model) for it in measured]
    readings = complete_readings(join_readings(blocks, model, folder / config.data[0].file), model)
    deviations = stated_noise(config.sensors, readings, model)
    found = find_frames(config, next(iter(bare.values())), instruments, readings, deviations, symbols)
    if found.wide:
        config, models = found.free(config), {name: place(own, found.instruments) for name, own in bare.items()}
        model = next(iter(models.values()))
    variants = {}
    for one in [one for one in config.variants if only is None or one.name in only]:
        with name_faults(f"variant {one.name!r}"):
            known = () if pads is None else pads.list_terms(models[one.name], readings.poses)
            taken = readings, deviations, folder, symbols, known, found.begin
            variants[one.name] = _build(config, one, models[one.name], *taken)
    compared = [read_beside(one, folder, model) for one in config.reference_values]
    unused = readings.tell_unused({name for one in variants.values() for name in one.model.names})
    missing = join_outlooks({name: one.missing for name, one in variants.items() if one.missing})
    name = getattr(model, "name", config.machine)
    units = readings.list_units(model.channels)
    kept, place_of_config = keep_files(config, folder)
    return ReadingInputs(
        config,
        name,
        variants,
        compared,
        kept,
        place_of_config,
        unused=unused,
        missing="; ".join(missing),
        units=units,
        columns=readings.list_columns(),
        found=found.told,
        measured=measured,
        pads=pads,
    )


def read_first_machine(config: StudyConfig, folder: Path) -> ReadingModel:
    """Return the machine of the first variant, undeformed, as tables of instruments are read for it."""
    first = config.variants[0].model_copy(update={"deformation": "none"})
    with name_faults(f"variant {first.name!r}") if first.model else nullcontext():
        return read_model(config, first, folder / config.machine, folder)


def _name_instruments(measured: Sequence[Measured]) -> dict[str, Instrument]:
    """Return the instruments that tables bring; InputError for two of one name."""
    found = dict[str, Instrument]()
    for it in measured:
        for name, beside in it.instruments.items():
            if name in found:
                raise InputError(f"data: found two tables with frames named {name!r}, expected a name each")
            found[name] = beside
    return found


def _build(
    config: StudyConfig,
    section: VariantConfig,
    model: ReadingModel,
    readings: PoseReadings,
    deviations: Array,
    folder: Path,
    symbols: Collection[str],
    known: Sequence[ErrorTerm],
    begin: Mapping[str, float],
) -> Variant:
    rows = _choose_poses(section, model, readings)
    chosen = model.select(section.sensors if section.sensors is not None else config.sensors)
    chosen = chosen[np.isfinite(readings.values[rows][:, chosen]).any(axis=0)]
    if not len(chosen):
        raise InputError("sensors: found no reading, expected some")
    whole, model = model, model.pick(chosen)
    priors, fixed, common = choose_priors(config, section, model.layout, symbols)
    data = Measurements(
        readings.poses,
        readings.values[:, chosen],
        deviations[:, chosen],
        {name: readings.given[name] for name in model.given},
        None if readings.correlation is None else readings.correlation[:, chosen][:, :, chosen],
        readings.commanded[:, chosen] if readings.commanded[rows].any() else None,
    ).pick(rows)
    _check_moves(data)
    _check_commanded(readings.commanded[rows], whole, model)
    _check_noise(data, model)
    columns = readings.list_columns()
    check_columns(data, model, columns)
    read_requirements(config.requirements, model, config.units)
    free = [one for name in priors for one in common.get(name, (name,))]
    check_optional(model, free)
    model.check_given(data.poses, data.given, free)
    workspace = build_workspace(model, config.workspace, config.units)
    noise = (*build_noise(config, section, whole, chosen), *known)
    unplaced = Variant(
        section,
        whole,
        model,
        priors,
        fixed,
        common,
        ErrorModel(noise, section.outliers),
        data,
        readings.verification[rows],
        np.zeros((data.n_poses, len(model.coordinates))),
        workspace,
        aligned=is_aligned(config.accuracy_frame, model, priors),
        begin=begin,
    )
    check_readings(data.n_poses, len(chosen), len(priors), len(model.coordinates))
    _check_machine(unplaced)
    with _say_copies(data, model, columns):
        start = find_starts(unplaced.posterior(np.ones(data.n_poses, dtype=bool)), workspace, config.seed)
    fitted, used = replace(unplaced, start=start), ~unplaced.verification
    home, reach = measure_ranges(model, data, workspace)
    positions = RowPositions.find(model.channels, data, _expect_readings(fitted), home)
    stated = build_terms(config, section, whole, chosen, data, reach, positions, folder)
    terms = (*noise[: len(noise) - len(known)], *stated, *known)
    error = config.leg_error.of(section.model_error)
    if error.terms and config.channel_errors:
        raise InputError(f"model_error: found terms {error.terms} and errors by channel, expected either")
    others = replace(unplaced.errors, terms=terms)
    own = find_own_channels(fitted.posterior(), data, start, used, reach, positions, workspace)
    found, missing = build_terms_of_model(error, model, data, own, priors, others)
    errors, region = (
        replace(others, terms=(*terms, *found)),
        find_region(workspace, config.workspace, model, start[used]),
    )
    placed = replace(fitted, errors=errors, missing=missing, measured=region)
    every = placed.list_readings(np.ones(data.n_poses, dtype=bool))
    with _say_copies(data, model, columns):
        check_reach(every, None if used.all() else placed.list_readings())
    return placed


@contextmanager
def _say_copies(data: Measurements, model: ReadingModel, columns: Mapping[str, WrittenColumn]) -> Iterator[None]:
    """Say first, in what is wrong with rows that no machine reaches, which columns repeat others."""
    try:
        yield
    except InputError as error:
        raise InputError("; ".join([*doubt_columns(data, model, columns), str(error)]), error.others) from error


def _expect_readings(variant: Variant) -> Array:
    """Return what the machine fitted to the calibration rows without model error reads at all rows, (P, K)."""
    posterior, given = variant.posterior(), variant.data.given
    with np.errstate(all="ignore"):
        try:
            y = posterior.least_squares_start()[None]
        except NumericalError:  # no start: the machine as expected
            return variant.model.read(posterior.first_machine, variant.start, given)
        theta, errors, zeta = posterior.at(y)
        pose = variant.likelihood(np.ones(variant.data.n_poses, dtype=bool)).explain(theta, errors, zeta)[1].pose[0]
        return variant.model.read(theta[0], pose, given)


def _choose_poses(section: VariantConfig, model: ReadingModel, readings: PoseReadings) -> np.ndarray:
    """Return which poses a variant takes in; InputError where one lacks what the machine has to know of it."""
    for name in section.require_columns:
        if name not in readings.given:
            raise InputError(say_unknown("require_columns", name, readings.given))
    known = {name: np.isfinite(value) for name, value in readings.given.items()}
    rows = np.ones(len(readings.poses), dtype=bool)
    for name in section.require_columns:
        rows &= known[name]
    for name in model.given:
        for k in np.flatnonzero(rows & ~known[name])[:1]:
            raise InputError(
                f"pose {readings.poses[k]!r}: found no {name}, expected it, or require_columns = [{name!r}]"
            )
    return rows


def _check_machine(variant: Variant) -> None:
    """Raise InputError where the priors' centres and what is fixed are no machine's parameters."""
    start = variant.posterior().sampling.start
    variant.model.layout.check(start)
    if (legs := variant.whole.legs) is None:
        return
    with np.errstate(all="ignore"):
        there = legs.read(start[: legs.layout.size], legs.home_pose[None])[:, legs.select(legs.commanded)]
    if not np.isfinite(there).all():
        raise InputError("found no machine at prior centres, expected unit directions and a home pose")


def _check_moves(data: Measurements) -> None:
    """Raise InputError where nothing that was read differs from row to row."""
    moved = np.fmax.reduce(data.values) > np.fmin.reduce(data.values)
    if data.n_poses >= FEWEST_ROWS and not moved.any():
        raise InputError(f"data: found equal readings in all {data.n_poses} rows, expected motion")


def _check_commanded(commanded: np.ndarray, whole: ReadingModel, model: ReadingModel) -> None:
    """Raise InputError for commanded channels (P, K of the whole machine) that cannot say where a machine stands."""
    for k in np.flatnonzero(commanded.any(axis=0)):
        if (name := whole.names[k]) not in whole.commanded:
            raise InputError(say_unknown("data.commanded_channels", name, whole.commanded))
        if name not in model.names:
            raise InputError(f"data.commanded_channels: found {name!r}, expected it in [sensors]")
    q = len(model.coordinates)
    for row in np.unique(commanded[commanded.any(axis=1)], axis=0):
        units = [whole.channels[k].unit for k in np.flatnonzero(row)]
        if len(units) < q:
            raise InputError(f"data.commanded_channels: found {len(units)} channels, expected at least {q}")
        if len(units) > q and len(set(units)) > 1:
            raise InputError(
                f"data.commanded_channels: found {' and '.join(dict.fromkeys(units))}, expected one "
                f"unit for {len(units)} channels and {q} coordinates"
            )


def _check_noise(data: Measurements, model: ReadingModel) -> None:
    missing = data.present & ~np.isfinite(data.sd)
    for k, channel in np.argwhere(missing)[:1]:
        raise InputError(
            f"pose {data.poses[k]!r}: found no noise of {model.channels[channel].name}, expected it "
            "in [sensors] or a column"
        )
