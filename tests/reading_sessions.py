"""Sessions of a linear delta on disk: readings of three months, one carriage's zero that moves, rods that expand."""

from __future__ import annotations

from pathlib import Path

import calibrations
import numpy as np

MOVED_UM = (0.0, 40.0, 90.0)
COLUMN = 2
WARM = (15.0, 20.0, 25.0)
PPM = 60.0
POSES = 16
NOISE = np.array([0.005, 0.005, 0.005, 0.02, 0.02, 0.01])

SESSIONS = """kind = "sessions"
name = "delta_sessions"
title = "A linear delta over three months"
seed = 3
study = "study.toml"
variant = "{variant}"
provenance = {{ status = "simulated", text = "for the tests" }}
draws = 500

[drift]
symbols = ["s0"]
scale_um = 30.0

[thermal]
reference_celsius = 20.0
bodies.rods = {{ symbols = ["l"], ppm = 40.0, sd_ppm = 30.0 }}
"""


def write_sessions(folder: Path, variant: str = "one_rod", moved: tuple[float, ...] = MOVED_UM) -> Path:
    """Write the example's calibration and three sessions to a folder; return the sessions' config."""
    from bayescal.machines.read import read_reading_model

    path = calibrations.write_delta(folder)
    model = read_reading_model(path.parent / "machine.toml")
    rng = np.random.default_rng(7)
    truth = model.layout.nominal.copy()
    truth[model.layout.index["x"]] += rng.normal(0.0, 0.3, 3)
    truth[model.layout.index["l"]] += 0.2
    truth[model.layout.index["s0"]] += rng.normal(0.0, 0.3, 3)
    text = SESSIONS.format(variant=variant)
    for k, (shift, warm) in enumerate(zip(moved, WARM, strict=True), start=1):
        theta = truth.copy()
        theta[model.layout.index["s0"][COLUMN - 1]] += 1e-3 * shift
        theta[model.layout.index["l"]] *= 1.0 + 1e-6 * PPM * (warm - 20.0)
        pose = np.column_stack([*rng.uniform(-75.0, 75.0, (2, POSES)), rng.uniform(2.0, 38.0, POSES)])
        values = model.read(theta, pose) + NOISE * rng.standard_normal((POSES, 6))
        lines = ["pose,s_1_mm,s_2_mm,s_3_mm,cam_x_mm,cam_y_mm,height_mm"]
        lines += [f"P{n},{','.join(f'{x:.6f}' for x in row)}" for n, row in enumerate(values, start=1)]
        (path.parent / f"month_{k}.csv").write_text("\n".join(lines) + "\n")
        text += f'\n[[sessions]]\nlabel = "M{k}"\ntime_days = {30.0 * k}\ndata = [{{ file = "month_{k}.csv" }}]\n'
        text += f"temperature_celsius = {warm}\n"
    (path.parent / "sessions.toml").write_text(text)
    return path.parent / "sessions.toml"
