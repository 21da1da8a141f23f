"""A small look-up table: a simulated hexapod whose lengths, common compliance and expansion are free."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import studies
from calibrations import change

SHIPPED = Path(__file__).parents[1] / "experiments" / "m2_hexapod_table"
LITTLE = {"walkers": "24", "burn_in": "4", "steps": "10", "ensembles": "4", "draws": "1000", "max_draws": "1000"}
RAIL = """from typing import Any

import numpy as np

from bayescal.machines.parameters import ParameterBlock
from bayescal.machines.readings import Channel, Coordinate, ReadingMachine


class Rail(ReadingMachine):
    given = ("elevation_deg", "temperature_c")
    parameters = [ParameterBlock(name, (0.0,), per_leg=False) for name in ("zero", "sag", "growth")]
    coordinates = [Coordinate("x", "mm", 0.0, 50.0)]
    channels = [Channel("q", "mm"), Channel("x", "mm", external=True)]

    def read(self, parameters: Any, v: Any, given: Any) -> Any:
        moved = parameters["sag"] * np.cos(np.deg2rad(given["elevation_deg"]))
        q = v[..., 0] + parameters["zero"] + moved + parameters["growth"] * given["temperature_c"]
        return np.stack(np.broadcast_arrays(q, v[..., 0]), axis=-1)
"""
RAIL_STUDY = """kind = "study"
name = "rail"
title = "A carriage on a rail"
seed = 1
machine = "machine.toml"
data = [{ file = "data.csv" }]
sensors = { q = { noise_um = 1.0 }, x = { noise_um = 5.0 } }
parameters.zero = { prior = "normal", sd = 1.0 }
parameters.sag = { prior = "normal", sd = 0.1 }
parameters.growth = { prior = "normal", sd = 0.01 }
provenance = { status = "simulated", text = "a carriage that nobody has" }
variants = [{ name = "all", title = "All" }]
sampler = { ensembles = 4, walkers = 16, burn_in = 10, steps = 20 }
evidence = { draws = 1000, max_draws = 1000 }
"""
RAIL_TABLE = """kind = "table"
name = "rail_table"
title = "A carriage on a rail by elevation and temperature"
seed = 3
study = "study.toml"
axes = { elevation_deg = [0.0, 45.0, 90.0], temperature_c = [0.0, 20.0] }
reference = { elevation_deg = 90.0, temperature_c = 10.0 }
plan = { measurements = 3, poses = 2 }
allow_unconverged = true
"""
AXES = "elevation_deg = [0.0, 45.0, 90.0]\ntemperature_c = [0.0, 20.0]\n"


def write_small(folder: Path, n_poses: int = 6) -> Path:
    """Write machine, data, calibration and table to a folder; return the table's config, which takes what is found."""
    shutil.copy(SHIPPED / "machine.toml", folder)
    for name in ("simulate", "study"):
        text = re.sub(r"(?m)^b_[xyz] = .*\n", "", (SHIPPED / f"{name}.toml").read_text())
        (folder / f"{name}.toml").write_text(text)
    change(folder / "simulate.toml", "n_poses = 30\nn_verification_poses = 10", f'n_poses = {n_poses}\ntied = ["c"]')
    study = folder / "study.toml"
    text = re.sub(r'(?s)\[\[variants\]\]\nname = "weight"\n.*?\n\n', "", study.read_text())
    for key, value in LITTLE.items():
        text = re.sub(rf"(?m)^{key} = .*$", f"{key} = {value}", text)
    study.write_text(text.replace('expansion"\n', 'expansion"\ntied = ["c"]\n'))
    write_data(folder)
    table = re.sub(r"(?s)\[axes\].*?\n\n", f"[axes]\n{AXES}\n", (SHIPPED / "table.toml").read_text())
    table = table.replace("measurements = 10\nposes = 10", "measurements = 3\nposes = 2")
    path = folder / "table.toml"
    path.write_text(table.replace('variant = "weight_temperature"\n', "allow_unconverged = true\n"))
    return path


def write_rail(folder: Path) -> Path:
    """Write the table of a carriage of one coordinate, a user-defined machine; return its config."""
    (folder / "rail.py").write_text(RAIL)
    (folder / "machine.toml").write_text('kind = "rail.py:Rail"\nname = "rail"\n')
    (folder / "study.toml").write_text(RAIL_STUDY)
    rng = np.random.default_rng(2)
    x, elevation, temperature = rng.uniform([-40.0, 0.0, 0.0], [40.0, 90.0, 20.0], (8, 3)).T
    q = x + 0.7 + 0.05 * np.cos(np.deg2rad(elevation)) + 0.004 * temperature + 1e-3 * rng.standard_normal(8)
    seen = x + 5e-3 * rng.standard_normal(8)
    rows = [
        f"P{k},{','.join(map(str, row))}" for k, row in enumerate(zip(q, seen, elevation, temperature, strict=True))
    ]
    (folder / "data.csv").write_text("\n".join(["pose,q_mm,x_mm,elevation_deg,temperature_c", *rows]) + "\n")
    path = folder / "table.toml"
    path.write_text(RAIL_TABLE)
    return path


def write_data(folder: Path) -> None:
    """Simulate the data of a folder."""
    studies.write_texts(folder / "data", studies.simulate(folder / "simulate.toml", seed=5).files)
