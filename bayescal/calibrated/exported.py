"""Exported machines as directories: ``calibrated.toml`` names the machine's file and how well it is known.

Results and exported machines keep the file that a machine is read from and, where its class stands in a file beside
it, that file with what it imports from beside itself. Loading them runs that code only where somebody has trusted it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from bayescal.calibrated.functions import KnownFunctions, read_known
from bayescal.calibrated.machine import CalibratedMachine, CommandErrors, LegErrors, Source, find_export_obstacle
from bayescal.calibrated.tables import read_given, read_quantities
from bayescal.config.classes import CLASS
from bayescal.config.load import check_section, read_toml
from bayescal.config.registry import list_references, list_sources
from bayescal.config.sections import InputFile, NotNegative, Number, Section
from bayescal.config.trust import check_same, hash_file
from bayescal.errors import InputError, name_faults
from bayescal.files.csv_tables import format_table, read_matrix, read_table
from bayescal.files.manifest import check_whole
from bayescal.files.netcdf import pack_netcdf, read_netcdf
from bayescal.files.toml import format_toml
from bayescal.machines.deformations import NominalDeformation
from bayescal.machines.kinematics import check_home_pose
from bayescal.machines.mechanism import ExternalLoad, Mechanism
from bayescal.machines.read import LEGS, build_named_machine, list_machine_sources, load_mechanism, read_reading_model
from bayescal.machines.readings import Legs, ReadingModel
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import units_like

CALIBRATED, MECHANISM, MATRIX = "calibrated.toml", "mechanism.toml", "deformation_matrix.csv"
PARAMETERS, COVARIANCE, DRAWS, MEASURED = "parameters.csv", "covariance.csv", "draws.nc", "measured.csv"
FUNCTIONS = "functions.nc"
MATRIX_COVARIANCE = "deformation_matrix_covariance.csv"
PER_MILLE = 1e-3  # of K in files
ASYMMETRY = 1e-6
"""Of the product of both standard deviations; files have all digits, those of others perhaps seven."""
LEAST_EIGENVALUE = -1e-6
"""Of the correlations: fewer draws than parameters leave eigenvalues that are zero but for rounding."""
STANDARD_GRAVITY = 9.80665  # m/s²


class SourceConfig(Section):
    """Where an exported machine comes from."""

    experiment: str
    variant: str
    data: str
    problems: list[str]
    solution: str = ""


class ErrorsConfig(Section):
    """By what its commands err besides the geometry, in their units; of the model error the root mean square."""

    noise: list[NotNegative]
    model_error: list[NotNegative]
    correlation: list[list[Number]] | None = None
    matrix_covariance: InputFile | None = None


class ExportedConfig(Section):
    """An exported machine: a mechanism on legs as calibrated, or a machine's file with parameters of its own."""

    kind: Literal["calibrated_machine"]
    mechanism: InputFile | None = None
    model: str = ""
    deformation: Literal["none", "matrix"] = "none"
    matrix: InputFile | None = None
    machine: InputFile | None = None
    sha256: list[str] = Field(default=[])
    parameters: InputFile | None = None
    workspace: dict[str, Annotated[list[Number], Field(min_length=2, max_length=2)]] = Field(default={})
    units: dict[str, str] = Field(default={})
    covariance: InputFile | None = None
    draws: InputFile | None = None
    functions: InputFile | None = None
    measured: InputFile | None = None
    accuracy_frame: Literal["aligned", "base"] = "aligned"
    source: SourceConfig
    errors: ErrorsConfig


# --- writing -------------------------------------------------------------------------------------------------------


def list_mechanism_files(calibrated: CalibratedMachine) -> dict[str, bytes]:
    """Return the files of a machine on legs that every command takes, by name.

    InputError where no drawings hold the machine's kinematics, or it has no level home pose any more.
    """
    machine = calibrated.legs
    hindrance = find_export_obstacle(machine)
    if hindrance:
        raise InputError(f"variant {calibrated.source.variant!r}: found {hindrance}")
    check_home_pose(machine)
    bends = machine.deformation.uses_matrix
    own = {"mechanism": MECHANISM, "model": machine.model.name, "deformation": "matrix" if bends else "none"}
    texts = _format_calibrated(calibrated, own | ({"matrix": MATRIX} if bends else {}))
    texts[MECHANISM] = format_mechanism(machine.mechanism, calibrated.source.describe())
    if bends:
        texts[MATRIX] = format_matrix(machine.deformation.coupling(machine.mechanism.n_legs))
    if isinstance(calibrated.errors, LegErrors) and calibrated.errors.matrix_covariance is not None:
        texts[MATRIX_COVARIANCE] = format_matrix_covariance(calibrated.errors.matrix_covariance)
    return {name: text.encode() for name, text in texts.items()}


def list_function_files(calibrated: CalibratedMachine) -> dict[str, bytes]:
    """Return the files of a machine of functions that `read_exported` takes, its class's own among them, by name."""
    if not calibrated.machine_file:
        raise InputError(f"machine {calibrated.name!r}: found no machine file, expected one")
    hashes = [hash_file(content) for content in calibrated.files.values()]
    own: dict[str, object] = {"machine": calibrated.machine_file, "sha256": hashes, "parameters": PARAMETERS}
    if calibrated.workspace is not None:
        names = [one.name for one in calibrated.model.coordinates]
        own["workspace"] = dict(zip(names, calibrated.workspace.T, strict=True))
    texts = {name: text.encode() for name, text in _format_calibrated(calibrated, own).items()}
    return texts | dict(calibrated.files)


def _format_calibrated(calibrated: CalibratedMachine, machine: Mapping[str, object]) -> dict[str, str]:
    """Return the file that names all others, and the table of the poses that calibrated a machine."""
    source, errors = calibrated.source, calibrated.errors
    beside = {"covariance": COVARIANCE, "draws": DRAWS, "functions": FUNCTIONS, "measured": MEASURED}
    there = {key for key in beside if getattr(calibrated, key) is not None} | (
        {"measured"} if calibrated.given else set()
    )
    sd = np.sqrt(np.diagonal(errors.noise))
    scale = np.where(sd > 0.0, sd, 1.0)
    correlated = np.any(errors.noise != np.diag(np.diagonal(errors.noise)))
    content = {
        "kind": "calibrated_machine",
        **machine,
        **({"units": dict(calibrated.units)} if calibrated.units else {}),
        **{key: name for key, name in beside.items() if key in there},
        "accuracy_frame": "aligned" if calibrated.aligned else "base",
        "source": {key: value for key, value in vars(source).items() if value != ""},
        "errors": {
            "noise": sd,
            "model_error": np.sqrt(errors.model_variance),
            "correlation": errors.noise / np.outer(scale, scale) if correlated else None,
            "matrix_covariance": MATRIX_COVARIANCE if getattr(errors, "matrix_covariance", None) is not None else None,
        },
    }
    texts = {CALIBRATED: format_toml(source.describe(), content)}
    if "measured" in there:
        texts[MEASURED] = format_measured(calibrated.model, calibrated.measured, calibrated.given)
    return texts


def format_measured(model: ReadingModel, commands: Array | None, given: Mapping[str, Array]) -> str:
    """Return the commands (P, C) of the poses that calibrated a machine, and what was known of these besides.

    Commands are None where they are not known of any pose, or there are none.
    """
    comments = ["Commands of the calibration poses; elsewhere extrapolated"]
    channels = [] if commands is None else [model.channels[k] for k in model.select(model.commanded)]
    values = np.column_stack([*([] if commands is None else [commands]), *given.values()])
    digits = [6 if one.unit == "mm" else 9 for one in channels] + [9] * len(given)
    rows = [[f"{x:.{n}f}" for x, n in zip(row, digits, strict=True)] for row in values]
    return format_table(comments, [*(f"{one.stem}_{one.unit}" for one in channels), *given], rows)


def read_measured(path: Path, model: ReadingModel) -> tuple[Array | None, dict[str, Array]]:
    """Return what `format_measured` wrote."""
    channels = [model.channels[k] for k in model.select(model.commanded)]
    table = read_table(path, model.given, [f"{one.stem}_{one.unit}" for one in channels])
    commands = read_quantities(table, channels) if set(table.columns) - set(model.given) else None
    return commands, read_given(table, model.given)


def format_matrix(matrix: Array) -> str:
    """Return a deformation matrix (N, N) as a study takes it, in 1e-3."""
    columns = [f"drho_{leg}" for leg in range(1, len(matrix) + 1)]
    comments = ["Deformation matrix K in 1e-3: joints (rows) by actuators (columns)"]
    return format_table(comments, columns, [[repr(float(k) / PER_MILLE) for k in row] for row in matrix])


def format_matrix_covariance(covariance: Array) -> str:
    """Return the covariance of each row of K, shape (N, N, N), a row of the table for each of K's elements."""
    n = len(covariance)
    columns = ["leg", "actuator", *(f"drho_{k}" for k in range(1, n + 1))]
    rows = [(i + 1, j + 1, *(repr(float(c)) for c in covariance[i, j])) for i in range(n) for j in range(n)]
    return format_table(["Covariance of each row of K, 1"], columns, rows)


def read_matrix_covariance(path: Path, n_legs: int) -> Array:
    """Return what `format_matrix_covariance` wrote, shape (N, N, N)."""
    columns = [f"drho_{k}" for k in range(1, n_legs + 1)]
    values = read_table(path, ("leg", "actuator", *columns)).numbers(columns)
    if len(values) != n_legs**2:
        raise InputError(f"{path}: found {len(values)} rows, expected {n_legs**2}")
    covariance = values.reshape(n_legs, n_legs, n_legs)
    for leg, rows in enumerate(covariance, start=1):
        check_covariance(path, [f"leg {leg}, {name}" for name in columns], rows)
    return covariance


def list_posterior_files(calibrated: CalibratedMachine) -> dict[str, bytes]:
    """Return the files beside a machine's: its parameters, and covariance and draws where they are known."""
    layout, covariance, comments = calibrated.model.layout, calibrated.covariance, calibrated.source.describe()
    columns = zip(layout.names, layout.units, calibrated.theta, calibrated.sd, strict=True)
    known = covariance is not None
    rows = [(name, unit, repr(float(value)), repr(float(s)) if known else "") for name, unit, value, s in columns]
    files = {PARAMETERS: format_table(comments, ["parameter", "unit", "mean", "sd"], rows).encode()}
    if covariance is not None:
        about = [*comments, "Covariance of the parameters; lengths in mm, else 1"]
        cells = [(name, *map(repr, row.tolist())) for name, row in zip(calibrated.names, covariance, strict=True)]
        files[COVARIANCE] = format_table(about, ["parameter", *calibrated.names], cells).encode()
    if calibrated.draws is not None:
        files[DRAWS] = _encode_draws(calibrated)
    if calibrated.functions is not None:
        files[FUNCTIONS] = _encode_functions(calibrated.functions, calibrated)
    return files


def _encode_draws(calibrated: CalibratedMachine) -> bytes:
    import xarray as xr  # takes a second, for those who need it

    layout = calibrated.model.layout
    content = xr.Dataset(
        {"draws": (("draw", "parameter"), calibrated.draws)},
        {"parameter": list(calibrated.names), "unit": ("parameter", [layout.units[k] for k in calibrated.free])},
        {"title": "; ".join(calibrated.source.describe())},
    )
    return pack_netcdf(xr.DataTree(content))


def _encode_functions(known: KnownFunctions, calibrated: CalibratedMachine) -> bytes:
    import xarray as xr  # takes a second, for those who need it

    variables = {
        name: (dims, one, {"units": unit, "long_name": said})
        for name, (dims, one, unit, said) in known.list_arrays().items()
    }
    names = {"channel": list(known.names), "sort": list(known.sorts), "parameter": list(calibrated.names)}
    return pack_netcdf(xr.DataTree(xr.Dataset(variables, names)))


# --- reading -------------------------------------------------------------------------------------------------------


def read_exported(folder: Path) -> CalibratedMachine:
    """Return the machine of an exported directory; InputError for anything at fault in its files."""
    path = folder / CALIBRATED
    check_whole(folder, expected=False, additions=True)
    content, text = read_toml(path)
    config = check_section(ExportedConfig, content, path, text)
    if (config.mechanism is None) == (config.machine is None):
        raise InputError(f"{path}: expected either mechanism or machine")
    model = _read_legs(config, folder) if config.machine is None else read_kept(folder / config.machine, config.sha256)
    theta = model.layout.nominal if config.parameters is None else _read_parameters(folder / config.parameters, model)
    names, covariance = _read_covariance(folder, config.covariance)
    for name in names:
        if name not in model.layout.names:
            path = folder / (config.covariance or CALIBRATED)
            raise InputError(f"{path}: found parameter {name!r}, expected those of the machine")
    free = np.array([model.layout.names.index(name) for name in names], dtype=int)
    draws = None if config.draws is None else _read_draws(folder / config.draws, names)
    source = config.source
    measured, given = None, dict[str, Array]()
    if config.measured is not None:
        measured, given = read_measured(folder / config.measured, model)
    kept = [] if config.machine is None else [config.machine, *list_machine_sources(folder / config.machine)]
    return CalibratedMachine(
        model,
        theta,
        free,
        covariance,
        draws,
        _read_errors(config.errors, folder, model, theta),
        Source(source.experiment, source.variant, source.data, tuple(source.problems), source.solution),
        measured,
        given,
        _read_workspace(config, path, model),
        config.machine or "",
        {name: (folder / name).read_bytes() for name in kept},
        functions=None if config.functions is None else _read_functions(folder / config.functions, names),
        units=_read_units(config.units, path, model),
        aligned=config.accuracy_frame == "aligned",
        drawn=None if config.machine is None else model,
    )


def _read_units(units: Mapping[str, str], path: Path, model: ReadingModel) -> Mapping[str, str]:
    known = {one.name: units_like(one.unit) for one in model.channels}
    for name, unit in units.items():
        if unit not in known.get(name, ()):
            raise InputError(f"{path}: units: found {unit!r} of {name!r}, expected one of {', '.join(known)}")
    return units


def _read_legs(config: ExportedConfig, folder: Path) -> Legs:
    path = folder / CALIBRATED
    assert config.mechanism is not None
    mechanism = load_mechanism(folder / config.mechanism)
    n_legs = mechanism.n_legs
    matrix = None if config.matrix is None else PER_MILLE * read_matrix(folder / config.matrix, n_legs)
    if (matrix is None) == (config.deformation == "matrix"):
        raise InputError(f"{path}: matrix: found deformation {config.deformation!r}, expected no matrix")
    nominal = NominalDeformation(0.0, lambda: np.zeros((n_legs, n_legs)) if matrix is None else matrix)
    with name_faults(path):
        return Legs(
            build_named_machine(
                mechanism, folder / config.mechanism, config.model, config.deformation, nominal, "model", folder
            )
        )


def _read_workspace(config: ExportedConfig, path: Path, model: ReadingModel) -> Array | None:
    if not config.workspace:
        return None
    names = [one.name for one in model.coordinates]
    if sorted(config.workspace) != sorted(names):
        raise InputError(f"{path}: workspace: found {', '.join(config.workspace)}, expected {', '.join(names)}")
    return np.array([config.workspace[name] for name in names]).T


def _read_parameters(path: Path, model: ReadingModel) -> Array:
    table = read_table(path, ("parameter", "unit", "mean", "sd"))
    names = table.text("parameter")
    if tuple(names) != model.layout.names:
        raise InputError(f"{path}: found other parameters, expected the machine's, in order")
    return _read_large(path, [row[table.columns.index("mean")] for row in table.rows])


def _read_large(path: Path, cells: list[str]) -> Array:
    """Return numbers that may be larger than a table's: stiffnesses, variances of these."""
    try:
        found = np.array(cells, dtype=np.float64)
    except ValueError as error:
        raise InputError(f"{path}: not numeric ({error})") from error
    if not np.isfinite(found).all():
        raise InputError(f"{path}: found non-finite numbers, expected finite ones")
    return found


def _read_errors(config: ErrorsConfig, folder: Path, model: ReadingModel, theta: Array) -> CommandErrors:
    n = len(model.commanded)
    for key, values in (("noise", config.noise), ("model_error", config.model_error)):
        if len(values) != n:
            raise InputError(f"{folder / CALIBRATED}: errors.{key}: found {len(values)} values, expected {n}")
    sd, variance = np.array(config.noise), np.array(config.model_error) ** 2
    noise = np.diag(sd**2)
    if config.correlation is not None:
        correlation = np.array([row for row in config.correlation if len(row) == n])
        if correlation.shape != (n, n):
            raise InputError(f"{folder / CALIBRATED}: errors.correlation: expected shape {n} by {n}")
        noise = correlation * np.outer(sd, sd)
        check_covariance(folder / CALIBRATED, model.commanded, noise)
    if (legs := model.legs) is None:
        return CommandErrors(noise, variance)
    covariance = None
    if config.matrix_covariance is not None:
        covariance = read_matrix_covariance(folder / config.matrix_covariance, legs.n_legs)
    return LegErrors(noise, variance, legs, theta, covariance)


def _read_covariance(folder: Path, name: str | None) -> tuple[tuple[str, ...], Array | None]:
    if name is None:
        return (), None
    table = read_table(folder / name, None)
    names = table.columns[1:]
    if table.columns[0] != "parameter" or tuple(table.text("parameter")) != names:
        raise InputError(f"{folder / name}: found rows that differ from columns, expected equal ones")
    covariance = _read_large(folder / name, [cell for row in table.rows for cell in row[1:]])
    covariance = covariance.reshape(len(names), len(names))
    check_covariance(folder / name, names, covariance)
    return names, covariance


def _read_netcdf[Result](path: Path, what: str, read: Callable[[], Result]) -> Result:
    """Return what is read of a file; InputError where it is none of what."""
    if not path.is_file():
        raise InputError(f"{path}: no such file, expected {what} as netCDF")
    try:
        return read()
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{path}: cannot be read as {what} ({' '.join(str(error).split())})") from error


def _read_draws(path: Path, names: tuple[str, ...]) -> Array:
    def read() -> Array:
        draws = read_netcdf(path)["draws"].sel(parameter=list(names)).transpose("draw", "parameter")
        return np.asarray(draws.to_numpy(), dtype=np.float64)

    return _read_netcdf(path, "draws", read)


def _read_functions(path: Path, names: tuple[str, ...]) -> KnownFunctions:
    known, beside = _read_netcdf(path, "systematic errors", lambda: read_known(path))
    if tuple(beside) != names or known.n_geometry != len(names):
        raise InputError(f"{path}: found other parameters, expected the covariance's, in order")
    return known


def check_covariance(path: Path, names: Sequence[str], covariance: Array) -> None:
    """Check a covariance (n, n) of quantities of any units.

    InputError where an entry is not finite, a variance is negative, two entries across the diagonal differ, or no data
    can have such correlations.
    """
    for i, j in np.argwhere(~np.isfinite(covariance))[:1]:
        raise InputError(f"{_where(path, names, i, j)}: found {covariance[i, j]:g}, expected a finite number")
    variance = np.diagonal(covariance)
    for i in np.flatnonzero(variance < 0.0)[:1]:
        raise InputError(f"{_where(path, names, i, i)}: found {variance[i]:g}, expected a variance ≥ 0")
    sd = np.sqrt(variance)
    product = sd[:, None] * sd
    unlike = np.abs(covariance - covariance.T) > ASYMMETRY * product
    for i, j in np.argwhere(unlike)[:1]:
        raise InputError(
            f"{_where(path, names, i, j)}: found {covariance[i, j]:g} and {covariance[j, i]:g}, expected symmetry"
        )
    for i, j in np.argwhere(np.abs(covariance) > (1.0 - LEAST_EIGENVALUE) * product)[:1]:
        raise InputError(
            f"{_where(path, names, i, j)}: found {covariance[i, j]:g}, expected at most "
            f"{product[i, j]:g} (product of sds)"
        )
    known = np.flatnonzero(product.diagonal() > 0.0)
    correlation = covariance[np.ix_(known, known)] / product[np.ix_(known, known)]
    if len(known) and np.linalg.eigvalsh(correlation)[0] < LEAST_EIGENVALUE * len(known):
        raise InputError(f"{path}: found an indefinite matrix, expected a covariance")


def _where(path: Path, names: Sequence[str], row: int, column: int) -> str:
    return f"{path}: {names[row]}, {names[column]}"


def read_kept(path: Path, known: Collection[str] | None = None) -> ReadingModel:
    """Return the machine of a kept TOML file; ``known``: SHA-256 of files, of which any code has to be one.

    InputError for code that nobody has trusted, or that is another than the results'.
    """
    check_same(path.parent, [path.name], known)
    for what, name in _list_own_classes(path):  # before any of it is run
        check_same(path.parent, list_sources(what, name, path.parent), known)
    check_same(path.parent, list_machine_sources(path), known)
    return read_reading_model(path)


def _list_own_classes(path: Path) -> list[tuple[str, str]]:
    """Return the classes in a machine's file that are neither built in nor an installed package's, with their sort."""
    content = read_toml(path)[0]
    named = [("MACHINES", content.get("kind"))]
    if content.get("kind") == LEGS:
        named = [("MODELS", content.get("model")), ("DEFORMATIONS", content.get("deformation"))]
    found = [(what, one.get(CLASS) if isinstance(one, dict) else one) for what, one in named]
    return [(what, one) for what, one in found if isinstance(one, str) and one not in list_references(what)]


def format_mechanism(mechanism: Mechanism, comments: Sequence[str] = ()) -> str:
    """Return the text of a mechanism's file that `bayescal.machines.read` takes, comment lines above."""
    flexures, load = mechanism.flexures, mechanism.load
    side = "below" if mechanism.platform_below else "above"
    content: dict[str, object] = {
        "name": mechanism.name,
        "base": {"points_mm": mechanism.base_points},
        "platform": {"points_mm": mechanism.platform_points},
        "home": {"platform": side}
        if mechanism.home_position is None
        else {"initial_guess_mm": mechanism.home_position},
        "legs": {
            "actuated_joint": mechanism.drive,
            "length_mm": mechanism.leg_lengths,
            "direction": mechanism.directions if mechanism.drive == "base" else None,
            "initial_actuator_position_mm": mechanism.initial_actuator_positions,
            "actuator_range_mm": mechanism.actuator_range,
            "actuator_gain": mechanism.actuator_gains,
        },
    }
    if flexures is not None:
        content["flexures"] = {"length_mm": flexures.lengths, "beta": flexures.beta}
        if flexures.section is not None and flexures.leg_section is not None:
            content["stiffness"] = {
                key: {"k1_n_mm2": one.k1, "k2_n": one.k2, "k3_n_mm2": one.k3}
                for key, one in (("flexure", flexures.section), ("leg", flexures.leg_section))
            }
    if load != ExternalLoad():
        mass = float(np.linalg.norm(load.weight)) / STANDARD_GRAVITY
        content["load"] = {
            "force_n": load.force,
            "moment_n_mm": load.moment,
            "mass_kg": mass or None,
            "gravity_m_s2": [w / mass for w in load.weight] if mass else None,
            "centre_of_mass_mm": load.centre_of_mass,
        }
    return format_toml(comments, content)
