"""Exported machines as directories: ``calibrated.toml`` names the mechanism, the deformation and how sure they are."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from bayescal.calibrated.covariances import check_covariance
from bayescal.calibrated.machine import CalibratedMachine, IndependentErrors, Source
from bayescal.calibrated.mechanism_file import format_mechanism, format_value
from bayescal.calibrated.settle import find_hindrance
from bayescal.config.load import check_section, read_toml
from bayescal.config.sections import InputFile, NotNegative, Section
from bayescal.data.actuators import name_actuators
from bayescal.errors import InputError
from bayescal.files.csv_tables import format_table, read_matrix, read_table
from bayescal.files.netcdf import read_netcdf
from bayescal.machines.deformations import MatrixDeformation, NominalDeformation
from bayescal.machines.kinematics import check_home_pose
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.read import build_named_machine, load_mechanism
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import MICROMETRE

CALIBRATED, MECHANISM, MATRIX = "calibrated.toml", "mechanism.toml", "deformation_matrix.csv"
PARAMETERS, COVARIANCE, DRAWS, MEASURED = "parameters.csv", "covariance.csv", "draws.nc", "measured.csv"
MATRIX_COVARIANCE = "deformation_matrix_covariance.csv"
PER_MILLE = 1e-3  # of K in files


class SourceConfig(Section):
    """Where an exported machine comes from."""

    experiment: str
    variant: str
    data: str
    problems: list[str]


class ErrorsConfig(Section):
    """What moves its legs besides the geometry; of the model error the root of the posterior mean square."""

    actuator_um: NotNegative
    model_error_um: list[NotNegative]
    matrix_covariance: InputFile | None = None


class ExportedConfig(Section):
    """An exported machine."""

    kind: Literal["calibrated_machine"]
    mechanism: InputFile
    model: str
    deformation: Literal["none", "matrix"]
    matrix: InputFile | None = None
    covariance: InputFile | None = None
    draws: InputFile | None = None
    measured: InputFile | None = None
    source: SourceConfig
    errors: ErrorsConfig


def list_machine_files(calibrated: CalibratedMachine) -> dict[str, bytes]:
    """Return the files of a machine that every command takes, by name.

    Raises
    ------
    InputError
        Where no drawings hold the machine's kinematics, or it has no level home pose any more.
    """
    machine = calibrated.machine
    hindrance = find_hindrance(machine)
    if hindrance:
        raise InputError(f"variant {calibrated.source.variant!r}: found {hindrance}")
    check_home_pose(machine)
    texts = {
        CALIBRATED: _format_calibrated(calibrated),
        MECHANISM: format_mechanism(machine.mechanism, calibrated.source.describe()),
        **format_matrices(machine.deformation, calibrated.errors),
    }
    if calibrated.measured is not None:
        texts[MEASURED] = format_measured(calibrated.measured)
    return {name: text.encode() for name, text in texts.items()}


def format_measured(actuators: Array) -> str:
    """Return the actuator positions (P, N) in mm of the poses that calibrated a machine."""
    comments = ["Actuator positions of the poses that calibrated the machine: where it is known, not extrapolated"]
    return format_table(comments, name_actuators(actuators.shape[1]), [[f"{x:.6f}" for x in row] for row in actuators])


def read_measured(path: Path, n_legs: int) -> Array:
    """Return what `format_measured` wrote, shape (P, N)."""
    columns = name_actuators(n_legs)
    return read_table(path, columns).numbers(columns)


def format_matrices(deformation: object, errors: object) -> dict[str, str]:
    """Return the files of a deformation matrix and of its covariance, where there are any."""
    texts = {}
    if isinstance(deformation, MatrixDeformation):
        texts[MATRIX] = format_matrix(deformation.matrix)
    if isinstance(errors, IndependentErrors) and errors.matrix_covariance is not None:
        texts[MATRIX_COVARIANCE] = format_matrix_covariance(errors.matrix_covariance)
    return texts


def format_matrix(matrix: Array) -> str:
    """Return a deformation matrix (N, N) as a study takes it, in 1e-3."""
    columns = [f"drho_{leg}" for leg in range(1, len(matrix) + 1)]
    comments = ["Deformation matrix K in 1e-3: deflection of each leg's joint (rows) by each actuator (columns)"]
    return format_table(comments, columns, [[repr(float(k) / PER_MILLE) for k in row] for row in matrix])


def format_matrix_covariance(covariance: Array) -> str:
    """Return the covariance of each row of K, shape (N, N, N), a row of the table for each of K's elements."""
    n = len(covariance)
    columns = ["leg", "actuator", *(f"drho_{k}" for k in range(1, n + 1))]
    rows = [(i + 1, j + 1, *(repr(float(c)) for c in covariance[i, j])) for i in range(n) for j in range(n)]
    return format_table(["Covariance of the elements of each row of the deformation matrix K, 1"], columns, rows)


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


def _format_calibrated(calibrated: CalibratedMachine) -> str:
    machine, source, errors = calibrated.machine, calibrated.source, calibrated.errors
    if not isinstance(errors, IndependentErrors):
        raise InputError(f"variant {source.variant!r}: found a structured model error, expected independent ones")
    bends = isinstance(machine.deformation, MatrixDeformation)
    lines = [f"# {comment}" for comment in source.describe()]
    lines += ['kind = "calibrated_machine"', f'mechanism = "{MECHANISM}"', f'model = "{machine.model.name}"']
    lines += [f'deformation = "{"matrix" if bends else "none"}"', *([f'matrix = "{MATRIX}"'] if bends else [])]
    if calibrated.covariance is not None:
        lines += [f'covariance = "{COVARIANCE}"']
    if calibrated.draws is not None:
        lines += [f'draws = "{DRAWS}"']
    if calibrated.measured is not None:
        lines += [f'measured = "{MEASURED}"']
    lines += ["", "[source]", *(f"{key} = {format_value(value)}" for key, value in vars(source).items())]
    model_error = np.sqrt(errors.model_variance) / MICROMETRE
    lines += ["", "[errors]", f"actuator_um = {format_value(errors.actuator_noise / MICROMETRE)}"]
    lines += [f"model_error_um = {format_value(model_error)}"]
    lines += [f'matrix_covariance = "{MATRIX_COVARIANCE}"'] if errors.matrix_covariance is not None else []
    return "\n".join(lines) + "\n"


def list_posterior_files(calibrated: CalibratedMachine) -> dict[str, bytes]:
    """Return the files beside a machine's: its parameters, and covariance and draws where they are known."""
    texts = {PARAMETERS: _format_parameters(calibrated)}
    files: dict[str, bytes] = {}
    if calibrated.covariance is not None:
        texts[COVARIANCE] = _format_covariance(calibrated)
    if calibrated.draws is not None:
        files[DRAWS] = _encode_draws(calibrated)
    return {name: text.encode() for name, text in texts.items()} | files


def _format_parameters(calibrated: CalibratedMachine) -> str:
    layout, known = calibrated.machine.layout, calibrated.covariance is not None
    sd = np.zeros(layout.size)
    if calibrated.covariance is not None:
        sd[calibrated.free] = np.sqrt(np.diagonal(calibrated.covariance))
    columns = zip(layout.names, layout.units, calibrated.theta, sd, strict=True)
    rows = [(name, unit, repr(float(value)), repr(float(s)) if known else "") for name, unit, value, s in columns]
    return format_table(calibrated.source.describe(), ["parameter", "unit", "mean", "sd"], rows)


def _format_covariance(calibrated: CalibratedMachine) -> str:
    assert calibrated.covariance is not None
    comments = [*calibrated.source.describe(), "Covariance of the uncertain parameters; lengths in mm, all else in 1"]
    rows = [
        (name, *(repr(float(c)) for c in row))
        for name, row in zip(calibrated.names, calibrated.covariance, strict=True)
    ]
    return format_table(comments, ["parameter", *calibrated.names], rows)


def _encode_draws(calibrated: CalibratedMachine) -> bytes:
    import xarray as xr  # takes a second, for those who need it

    layout = calibrated.machine.layout
    content = xr.Dataset(
        {"draws": (("draw", "parameter"), calibrated.draws)},
        {"parameter": list(calibrated.names), "unit": ("parameter", [layout.units[k] for k in calibrated.free])},
        {"title": "; ".join(calibrated.source.describe())},
    )
    return bytes(content.to_netcdf(engine="h5netcdf"))


def read_exported(folder: Path) -> CalibratedMachine:
    """Return the machine of an exported directory.

    Raises
    ------
    InputError
        For anything at fault in its files.
    """
    path = folder / CALIBRATED
    config = check_section(ExportedConfig, *_with_path(path))
    mechanism = load_mechanism(folder / config.mechanism)
    n_legs = mechanism.n_legs
    matrix = None if config.matrix is None else PER_MILLE * read_matrix(folder / config.matrix, n_legs)
    if (matrix is None) == (config.deformation == "matrix"):
        raise InputError(f"{path}: matrix: found deformation {config.deformation!r}, expected a matrix with it alone")
    nominal = NominalDeformation(0.0, lambda: np.zeros((n_legs, n_legs)) if matrix is None else matrix)
    machine = build_named_machine(
        mechanism, folder / config.mechanism, config.model, config.deformation, nominal, "model", folder
    )
    names, covariance = _read_covariance(folder, config.covariance)
    free = _find_names(machine.layout.names, names, folder / (config.covariance or CALIBRATED))
    draws = None if config.draws is None else _read_draws(folder / config.draws, names)
    source = config.source
    return CalibratedMachine(
        machine,
        machine.layout.nominal,
        free,
        covariance,
        draws,
        _read_errors(config.errors, folder, mechanism),
        Source(source.experiment, source.variant, source.data, tuple(source.problems)),
        None if config.measured is None else read_measured(folder / config.measured, n_legs),
    )


def _with_path(path: Path) -> tuple[dict[str, object], Path, str]:
    content, text = read_toml(path)
    return content, path, text


def _read_errors(config: ErrorsConfig, folder: Path, mechanism: Mechanism) -> IndependentErrors:
    n_legs, covariance = mechanism.n_legs, None
    if len(config.model_error_um) != n_legs:
        found = len(config.model_error_um)
        raise InputError(f"{folder / CALIBRATED}: errors.model_error_um: found {found} values, expected {n_legs}")
    if config.matrix_covariance is not None:
        covariance = read_matrix_covariance(folder / config.matrix_covariance, n_legs)
    variance = (MICROMETRE * np.array(config.model_error_um)) ** 2
    return IndependentErrors(MICROMETRE * config.actuator_um, variance, covariance)


def _read_covariance(folder: Path, name: str | None) -> tuple[tuple[str, ...], Array | None]:
    if name is None:
        return (), None
    table = read_table(folder / name, None)
    names = table.columns[1:]
    if table.columns[0] != "parameter" or tuple(table.text("parameter")) != names:
        raise InputError(f"{folder / name}: found other rows than columns, expected the same parameters in both")
    try:  # variances of stiffnesses are larger than what a table's numbers may be
        covariance = np.array([row[1:] for row in table.rows], dtype=np.float64)
    except ValueError as error:
        raise InputError(f"{folder / name}: cannot be read as numbers ({error})") from error
    check_covariance(folder / name, names, covariance)
    return names, covariance


def _find_names(known: tuple[str, ...], names: tuple[str, ...], path: Path) -> np.ndarray:
    for name in names:
        if name not in known:
            raise InputError(f"{path}: found parameter {name!r}, expected those of the machine")
    return np.array([known.index(name) for name in names], dtype=int)


def _read_draws(path: Path, names: tuple[str, ...]) -> Array:
    if not path.is_file():
        raise InputError(f"{path}: no such file, expected draws as netCDF")
    try:
        draws = read_netcdf(path)["draws"].sel(parameter=list(names)).transpose("draw", "parameter")
        return np.asarray(draws.to_numpy(), dtype=np.float64)
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{path}: cannot be read as draws ({' '.join(str(error).split())})") from error
