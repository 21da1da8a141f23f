"""Machines whose actuators do not point upwards: horizontal guides, hanging sliders, guides to several sides.

All are made up. Whatever is simulated with them is a twin, never a measurement.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import studies
import telescope_machines as machines

from bayescal.machines.mechanism import Mechanism
from bayescal.machines.read import load_mechanism

KINDS = ("along x", "along y", "down", "inclined", "star", "anyhow")
SYMBOLS = {
    "along x": ("u_y", "u_z"),
    "along y": ("u_x", "u_z"),
    "down": ("u_x", "u_y"),
    "inclined": ("u_x", "u_y"),
    "star": ("u_h", "u_v"),
    "anyhow": ("u_h", "u_v"),
}
HOME = np.array([3.0, -2.0, 400.0])
REGULAR = 15.0  # condition of the home pose's Jacobian, lengths by the platform's size
ALONG = 0.5  # least cosine between a leg and its actuator


def draw_directions(kind: str, n_legs: int, rng: np.random.Generator) -> np.ndarray:
    """Return unit directions (N, 3) of a kind, both ways along their axis."""
    forth = rng.permutation((-1.0) ** np.arange(n_legs))[:, None]
    turn = 2 * np.pi * (np.arange(n_legs) / n_legs + 0.04)
    level = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(n_legs)])
    raised = np.array([0.0, 0.0, 1.0])
    found = {
        "along x": forth * [1.0, 0.0, 0.0],
        "along y": forth * [0.0, 1.0, 0.0],
        "down": np.tile([0.0, 0.0, -1.0], (n_legs, 1)),
        "inclined": level + raised,
        "star": level,
        "anyhow": rng.standard_normal((n_legs, 3)),
    }[kind]
    if kind != "anyhow":
        found = found + 0.03 * rng.standard_normal((n_legs, 3)) * (kind != "star")
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def build_guided(kind: str, seed: int, n_legs: int = 6, below: bool = False) -> Mechanism:
    """Return a random machine of a kind that closes at home, 400 mm above or below the lower joints, level."""
    rng = np.random.default_rng(seed)
    home = HOME * ([1.0, 1.0, -1.0] if below else 1.0)
    while True:
        u = draw_directions(kind, n_legs, rng)
        azimuth = np.arange(n_legs) * 360.0 / n_legs + rng.uniform(-12, 12, n_legs)
        upper = machines._polar(130.0, list(azimuth)) + rng.normal(0, 25, (n_legs, 3))
        lean = rng.normal(0, 0.5, (n_legs, 3)) + 0.9 * rng.choice([-1.0, 1.0], n_legs)[:, None] * u
        legs = lean + np.array([0.0, 0.0, np.sign(home[2])])
        legs *= rng.uniform(450.0, 600.0, n_legs)[:, None] / np.linalg.norm(legs, axis=1, keepdims=True)
        if _is_regular(legs, upper, u):
            break
    initial = rng.uniform(5, 300, n_legs)
    return Mechanism(
        name=f"{kind} {seed}",
        base_points=home + upper - legs - initial[:, None] * u,
        platform_points=upper,
        directions=u,
        leg_lengths=np.linalg.norm(legs, axis=1),
        initial_actuator_positions=initial,
        actuator_range=150.0,
        flexures=machines.build_flexures(n_legs, diameter=1.5, leg_diameter=4.0),
        home_position=tuple(home.tolist()),
    )


def _is_regular(legs: np.ndarray, upper: np.ndarray, u: np.ndarray) -> bool:
    axis = legs / np.linalg.norm(legs, axis=1, keepdims=True)
    jacobian = np.concatenate([axis, np.cross(upper / 150.0, axis)], axis=1)
    return bool(np.linalg.cond(jacobian) < REGULAR and np.abs(np.sum(axis * u, axis=1)).min() > ALONG)


def build_hexaglide(**changes: object) -> Mechanism:
    """Return the shipped carriages on horizontal guides along x, three legs leaning forth and three back."""
    return replace(load_mechanism(studies.EXPERIMENTS / "hexaglide" / "mechanism.toml"), **changes)


def build_hanging(**changes: object) -> Mechanism:
    """Return the telescope's geometry upside down: sliders that move down, the platform below."""
    down = machines.build_telescope(directions=np.tile([0.0, 0.0, -1.0], (6, 1)), platform_below=True, name="hanging")
    return replace(down, **changes)
