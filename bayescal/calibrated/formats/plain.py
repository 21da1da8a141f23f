"""A calibrated machine as one table with a row per leg, and as one JSON object."""

from __future__ import annotations

import json

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.files.csv_tables import format_table

UNITS = {"1": "", "mm": "_mm", "rad": "_rad", "N": "_n", "N mm2": "_n_mm2"}


def list_csv_files(calibrated: CalibratedMachine) -> dict[str, bytes]:
    """Return ``legs.csv``: the parameters that legs have, a row a leg; all others are the same in each row."""
    layout, theta = calibrated.machine.layout, calibrated.theta
    columns, values = ["leg"], [[leg + 1 for leg in range(calibrated.n_legs)]]
    for block in layout.blocks:
        columns.append(f"{block.symbol}{UNITS.get(block.unit, '')}")
        own = [repr(float(value)) for value in layout.take(theta, block.symbol)]
        values.append(own if block.per_leg else own * calibrated.n_legs)  # type: ignore[arg-type]  # cells of any kind
    text = format_table(calibrated.source.describe(), columns, list(zip(*values, strict=True)))
    return {"legs.csv": text.encode()}


def list_json_files(calibrated: CalibratedMachine) -> dict[str, bytes]:
    """Return ``machine.json``: parameters by symbol in mm and radians, with their covariance."""
    machine, theta, source = calibrated.machine, calibrated.theta, calibrated.source
    mechanism, layout = machine.mechanism, machine.layout
    content = {
        "name": mechanism.name,
        "source": {
            "experiment": source.experiment,
            "variant": source.variant,
            "data": source.data,
            "converged": not source.problems,
            "problems": list(source.problems),
        },
        "model": machine.model.name,
        "deformation": machine.deformation.name,
        "drive": mechanism.drive,
        "base_points_mm": mechanism.base_points.tolist(),
        "platform_points_mm": mechanism.platform_points.tolist(),
        "directions": mechanism.directions.tolist() if mechanism.drive == "base" else None,
        "leg_lengths_mm": mechanism.leg_lengths.tolist(),
        "initial_actuator_positions_mm": mechanism.initial_actuator_positions.tolist(),
        "actuator_range_mm": mechanism.actuator_range,
        "parameters": {
            block.symbol: {"unit": block.unit, "mean": layout.take(theta, block.symbol).tolist()}
            for block in layout.blocks
        },
        "uncertain": list(calibrated.names),
        "covariance": None if calibrated.covariance is None else calibrated.covariance.tolist(),
    }
    return {"machine.json": (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode()}
