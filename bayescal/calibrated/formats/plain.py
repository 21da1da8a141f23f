"""A calibrated machine as a TOML or a JSON file of its parameters with their covariance; legs as a table, too."""

from __future__ import annotations

import json
from typing import Any

from bayescal.calibrated.exported import list_function_files
from bayescal.calibrated.machine import CalibratedMachine
from bayescal.calibrated.mechanism_file import format_value
from bayescal.files.csv_tables import format_table
from bayescal.machines.kinematics import Machine
from bayescal.machines.readings import Legs

UNITS = {"1": "", "mm": "_mm", "rad": "_rad", "N": "_n", "N mm2": "_n_mm2"}


def list_parameter_files(calibrated: CalibratedMachine) -> dict[str, bytes]:
    """Return parameters with covariance as TOML and JSON; of a machine of functions what `read_exported` takes, too."""
    own = {} if isinstance(calibrated.model, Legs) else list_function_files(calibrated)
    return own | list_toml_files(calibrated) | list_json_files(calibrated)


def list_csv_files(calibrated: CalibratedMachine) -> dict[str, bytes]:
    """Return ``legs.csv`` of a machine on legs: the parameters that legs have, a row a leg; all others in each row.

    Of another machine nothing: its parameters and their covariance are in tables with every format.
    """
    model = calibrated.model
    if not isinstance(model, Legs):
        return {}
    layout, theta = model.layout, calibrated.theta
    columns, values = ["leg"], [[leg + 1 for leg in range(model.n_legs)]]
    for block in layout.blocks:
        columns.append(f"{block.symbol}{UNITS.get(block.unit, '')}")
        own = [repr(float(value)) for value in layout.take(theta, block.symbol)]
        values.append(own if block.per_leg else own * model.n_legs)  # type: ignore[arg-type]  # cells of any kind
    text = format_table(calibrated.source.describe(), columns, list(zip(*values, strict=True)))
    return {"legs.csv": text.encode()}


def list_json_files(calibrated: CalibratedMachine) -> dict[str, bytes]:
    """Return ``machine.json``: parameters by symbol in mm and radians, with their covariance."""
    content = json.dumps(_describe(calibrated), indent=1, ensure_ascii=False)
    return {"machine.json": (content + "\n").encode()}


def list_toml_files(calibrated: CalibratedMachine) -> dict[str, bytes]:
    """Return ``parameters.toml``: the same as TOML."""
    content = _describe(calibrated)
    lines = [f"# {comment}" for comment in calibrated.source.describe()]
    tables = {key: content.pop(key) for key in ("source", "parameters")}
    lines += [f"{key} = {format_value(value)}" for key, value in content.items() if value is not None]
    lines += ["", "[source]", *(f"{key} = {format_value(value)}" for key, value in tables["source"].items())]
    for symbol, one in tables["parameters"].items():
        lines += ["", f"[parameters.{format_value(symbol)}]"]
        lines += [f"{key} = {format_value(value)}" for key, value in one.items() if value is not None]
    return {"parameters.toml": ("\n".join(lines) + "\n").encode()}


def _describe(calibrated: CalibratedMachine) -> dict[str, Any]:
    model, theta, source = calibrated.model, calibrated.theta, calibrated.source
    of = {block.symbol: model.layout.index[block.symbol] for block in model.layout.blocks}
    return {
        "name": calibrated.name,
        "source": {
            "experiment": source.experiment,
            "variant": source.variant,
            "data": source.data,
            "converged": not source.problems,
            "problems": list(source.problems),
        },
        **(_describe_legs(model.machine) if isinstance(model, Legs) else {}),
        "commanded": list(model.commanded),
        "tool": [f"{one.name} [{one.unit}]" for one in model.tool_channels],
        "parameters": {
            block.symbol: {
                "unit": block.unit,
                "mean": theta[of[block.symbol]].tolist(),
                "sd": None if calibrated.covariance is None else calibrated.sd[of[block.symbol]].tolist(),
            }
            for block in model.layout.blocks
        },
        "uncertain": list(calibrated.names),
        "covariance": None if calibrated.covariance is None else calibrated.covariance.tolist(),
    }


def _describe_legs(machine: Machine) -> dict[str, Any]:
    mechanism = machine.mechanism
    return {
        "model": machine.model.name,
        "deformation": machine.deformation.name,
        "drive": mechanism.drive,
        "base_points_mm": mechanism.base_points.tolist(),
        "platform_points_mm": mechanism.platform_points.tolist(),
        "directions": mechanism.directions.tolist() if mechanism.drive == "base" else None,
        "leg_lengths_mm": mechanism.leg_lengths.tolist(),
        "initial_actuator_positions_mm": mechanism.initial_actuator_positions.tolist(),
        "actuator_range_mm": mechanism.actuator_range,
    }
