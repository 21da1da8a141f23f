"""The hexapods of Rubin Observatory as shipped, and a small study of one with simulated data."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import studies

from bayescal.machines.mechanism import Mechanism
from bayescal.machines.read import load_mechanism
from bayescal.numerics.geometry import matrix_from_rotation_vector

AUDIT = studies.EXPERIMENTS / "audit"
LIMITS = {  # x, y, z about the pivot in mm, rotations about x, y, z in degrees
    "camera": (11.4, 11.4, 13.1, 0.36, 0.36, 0.1),
    "m2": (10.5, 10.5, 8.9, 0.175, 0.175, 0.05),
}

TRUE_OFFSETS = {"a_x": [0.3, -0.2, 0.5, 0.1, -0.4, 0.2], "l": [0.37, -0.45, 1.02, 0.25, 0.43, 0.58]}

SIMULATION = f"""
kind = "simulation"
name = "hexapod_twin"
title = "Hexapod twin"
seed = 3
machine = "mechanism.toml"
model = "six_ups"

[origin]
status = "simulated"
text = "Simulated for the tests, never measured"

[truth]
deformation_matrix = "deformation_matrix.csv"

[truth.offsets]
a_x = {TRUE_OFFSETS["a_x"]}
l = {TRUE_OFFSETS["l"]}

[poses]
calibration = "calibration_configurations.csv"
verification = "verification_configurations.csv"
unit_mm = 14.1

[noise]
target_um = 3.0
actuator_um = 1.0

[targets]
base = [{{ count = 5, radius_mm = 1800.0, height_mm = 0.0 }}, {{ count = 2, radius_mm = 1500.0, height_mm = 300.0 }}]
platform = [{{ count = 7, radius_mm = 1700.0, height_mm = 1000.0 }}]
per_pad = 2
pad_radius_mm = 12.0

[measurement_frame]
distance_mm = 1500.0
angle_deg = 60.0
"""


STUDY = f"""
kind = "study"
name = "hexapod"
title = "Tiny study of a hexapod"
seed = 11
{studies.DATA}
kappa = 0.01

[parameters]
a_x = {{ prior = "normal", sd = 1.0 }}
l = {{ prior = "normal", sd = 1.0 }}

[model_error]
terms = ["independent"]
per_leg = false

[[variants]]
model = "six_ups"
deformation = "none"
free = ["a_x", "l"]

[[variants]]
model = "six_ups"
deformation = "linear"
free = ["a_x", "l"]

[sampler]
walkers = 16
burn_in = 5
steps = 10

[evidence]
draws = 1000
max_draws = 1000

[sensitivity]
factor = [1.0]
"""


def load_hexapod(name: str) -> Mechanism:
    """Return a shipped hexapod, ``camera`` or ``m2``."""
    return load_mechanism(AUDIT / f"{name}_hexapod_mechanism.toml")


def poses_about_pivot(name: str, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return poses (P, 3) in mm and (P, 3, 3) at shares (P, 6) of a hexapod's limits."""
    change = share * np.array(LIMITS[name])
    pivot = np.array(load_hexapod(name).home_position)
    return pivot + change[:, :3], matrix_from_rotation_vector(np.radians(change[:, 3:]))


def write_hexapod_study(folder: Path, name: str) -> Path:
    """Write a tiny study of a hexapod's rigid twin with its data to a folder and return its config."""
    texts = {name: text for name, text in studies.tiny_texts().items() if name.endswith("configurations.csv")}
    texts["mechanism.toml"] = (AUDIT / f"{name}_hexapod_mechanism.toml").read_text()
    texts["deformation_matrix.csv"] = "# none\n1,2,3,4,5,6\n" + "0,0,0,0,0,0\n" * 6
    studies.write_texts(folder, texts | {"simulate.toml": SIMULATION, "study.toml": STUDY})
    studies.write_texts(folder / "data", studies.simulate(folder / "simulate.toml").files)
    return folder / "study.toml"
