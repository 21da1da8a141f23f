"""A planar 3-RRR as somebody writes it: one class, whose arccos has no value out of reach; and a study of it.

The file stands beside a config as a user-defined machine, and tests import it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayescal import Channel, Coordinate, ParameterBlock, ReadingMachine

STUDY = """kind = "study"
name = "planar_rrr"
title = "A planar 3-RRR seen by a camera"
seed = 1
machine = "machine.toml"

[provenance]
status = "simulated"
text = "one machine drawn within its tolerances"

[[data]]
file = "readings.csv"

[sensors]
theta = { noise_rad = 1e-4 }
cam_x = { noise_um = 20.0 }
cam_y = { noise_um = 20.0 }
cam_phi = { noise_rad = 2e-4 }

[parameters]
x = { prior = "normal", sd = 0.5 }
y = { prior = "normal", sd = 0.5 }
l = { prior = "normal", sd = 0.3 }
m = { prior = "normal", sd = 0.3 }
xi = { prior = "normal", sd = 0.3 }
eta = { prior = "normal", sd = 0.3 }
theta0 = { prior = "normal", sd = 0.3 }     # degrees

[model_error]
terms = []

[[variants]]
name = "all"
title = "Everything free"

[validation]
draws = 100

[next]
candidates = 0

[sampler]
walkers = 96
burn_in = 10
steps = 40

[evidence]
draws = 1000
max_draws = 1000
"""
HEADER = (
    "pose",
    "theta_1_rad",
    "theta_2_rad",
    "theta_3_rad",
    "cam_x_mm",
    "cam_y_mm",
    "cam_phi_rad",
)
TOLERANCES = {"x": 0.5, "y": 0.5, "l": 0.3, "m": 0.3, "xi": 0.3, "eta": 0.3, "theta0": float(np.radians(0.3))}
NOISE = np.array([1e-4, 1e-4, 1e-4, 0.02, 0.02, 2e-4])
REACH = np.array([45.0, 45.0, 0.35])


class PlanarRRR(ReadingMachine):
    """Three motors at the base turn cranks l, couplers m join these to a platform that a camera sees."""

    def __init__(self, config: object) -> None:
        super().__init__(config)
        angle = np.radians([90.0, 210.0, 330.0])
        self.parameters = [
            ParameterBlock("x", tuple(250.0 * np.cos(angle))),
            ParameterBlock("y", tuple(250.0 * np.sin(angle))),
            ParameterBlock("l", (130.0,) * 3, lower=0.0),
            ParameterBlock("m", (140.0,) * 3, lower=0.0),
            ParameterBlock("xi", tuple(60.0 * np.cos(angle))),
            ParameterBlock("eta", tuple(60.0 * np.sin(angle))),
            ParameterBlock("theta0", (0.0,) * 3, "rad"),
        ]
        self.coordinates = [
            Coordinate("x", "mm", 0.0, REACH[0]),
            Coordinate("y", "mm", 0.0, REACH[1]),
            Coordinate("phi", "rad", 0.0, REACH[2]),
        ]
        self.channels = [
            *(Channel(f"theta[{k}]", "rad") for k in (1, 2, 3)),
            Channel("cam_x", "mm", external=True),
            Channel("cam_y", "mm", external=True),
            Channel("cam_phi", "rad", external=True),
        ]

    def read(self, p, v, given):
        from bayescal.numerics.analytic import atan2

        cosine, sine = np.cos(v[..., 2, None]), np.sin(v[..., 2, None])
        to_x = v[..., 0, None] + cosine * p["xi"] - sine * p["eta"] - p["x"]
        to_y = v[..., 1, None] + sine * p["xi"] + cosine * p["eta"] - p["y"]
        square = to_x**2 + to_y**2
        elbow = np.arccos((p["l"] ** 2 + square - p["m"] ** 2) / (2.0 * p["l"] * np.sqrt(square)))
        theta = atan2(to_y, to_x) + elbow - p["theta0"]
        seen = np.broadcast_to(v, theta.shape)
        return np.concatenate([theta, seen], axis=-1)


def simulate(n: int = 20, seed: int = 1) -> np.ndarray:
    """Return readings (n, 6) of a machine drawn within its tolerances, at poses of the workspace."""
    from bayescal.machines.readings import FunctionModel

    rng = np.random.default_rng(seed)
    model = FunctionModel("planar", PlanarRRR(None))
    layout = model.layout
    sd = np.array([TOLERANCES[name.partition("[")[0]] for name in layout.names])
    theta = layout.nominal + sd * rng.standard_normal(layout.size)
    exact = model.read(theta, rng.uniform(-REACH, REACH, (n, 3)))
    assert np.isfinite(exact).all()
    return np.asarray(exact + NOISE * rng.standard_normal(exact.shape))


def write_project(folder: Path, values: np.ndarray, header: tuple[str, ...] = HEADER, study: str = STUDY) -> Path:
    """Write machine, study and readings; return the study's config."""
    folder.mkdir(exist_ok=True)
    (folder / "planar_rrr.py").write_text(Path(__file__).read_text())
    (folder / "machine.toml").write_text('kind = "planar_rrr.py:PlanarRRR"\nname = "planar"\ntitle = "A 3-RRR"\n')
    rows = [f"R{k + 1:02d}," + ",".join(f"{x:.9g}" for x in row) for k, row in enumerate(values)]
    (folder / "readings.csv").write_text("\n".join([",".join(header), *rows]) + "\n")
    (folder / "study.toml").write_text(study)
    return folder / "study.toml"
