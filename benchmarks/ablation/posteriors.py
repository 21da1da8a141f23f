"""Posteriors of shipped studies, of twins of `benchmarks/truth` and of the tests, and densities with planted trouble.

What is planted has coordinates of its own, a standard normal prior where one is asked for, and slopes by differences.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats
from test_adaptation import tell_little
from test_chain_checks import banana, long_tail, minor_mode, skewed, two_modes
from test_evidence import funnel
from test_loose import Arc, bend
from test_mirrored import Posts
from test_ridges import Bent, Tailed
from test_stands import heavy_tail
from test_tempered_battery import CASES, SHARED, TWO, Case, uniform

from bayescal.experiments.runner.load import load
from bayescal.experiments.study.readings import ReadingSubject
from bayescal.inference.importance import difference_twice
from bayescal.numerics.geometry import Array
from benchmarks.truth.projects import write_project, write_tables
from benchmarks.truth.scores import draw_twin

ROOT = Path(__file__).parents[2]
STUDIES = {
    "own_machine": ("examples/own_machine", ("all", "one_rod")),
    "two_modes": ("tests/cases/two_modes", ("all",)),
    "integer": ("tests/cases/external_as_integer", ("all",)),
    "posts": ("tests/cases/posts_on_either_side", ("all",)),
    "printer": ("tests/cases/delta_default_not_converged", ("arms_differ", "arms_alike")),
    "force_cell": ("tests/cases/own_term_shrinks_gains", ("full",)),
    "m2_hexapod": ("experiments/m2_hexapod", ("six_ups/none",)),
    "telescope": (
        "experiments/telescope",
        tuple(f"{m}/{d}" for m in ("six_pus", "jacobian", "beam", "stiffness") for d in ("none", "linear", "matrix")),
    ),
    "hangprinter": ("experiments/hangprinter", ("buildup", "camera")),
    "hexaglide": ("experiments/hexaglide", ("six_pus/none",)),
}
"""Folders of shipped studies and of the tests' cases, with variants."""
TWINS = ("cell", "mount", "scara", "probed_delta", "arm", "five_bar")
BATTERY = (
    "lengths between bounds, model error",
    "a model error per leg",
    "truth at a bound",
    "bad misfit, model error",
    "ridge of gain and direction",
    "mirror of u_y, noise 5",
    "mirrors of two legs",
    "ring, narrow",
    "ring between bounds",
)
BOUNDED = uniform(["l", "a_x", "a_y", "b_x", "b_y"], 2.0, TWO) | uniform(["u_x"], 0.05, TWO)
FEW = {f"{n} poses, between bounds": Case(BOUNDED, SHARED, noise=100.0, n_poses=n) for n in (3, 4, 6)}
"""Rows that tell little of two legs with even tolerances."""
FIRST_SEED, STEP = 1000, 1e-3


@dataclass(frozen=True, eq=False)
class Planted(Arc):
    """A log-density of n coordinates, (B, n) to (B,), from a start; ridges as a posterior declares them."""

    density: Callable[[Array], Array] = None  # type: ignore[assignment]  # what it extends has a field
    n: int = 0
    start: Array | None = None
    ridges: tuple[tuple[int, Array], ...] = ()

    @property
    def n_parameters(self) -> int:
        """Number n of coordinates."""
        return self.n

    def log_density(self, y: Array) -> Array:
        """Return the log-density (B,)."""
        return np.atleast_1d(self.density(y))  # SciPy squeezes what is one

    def log_prior(self, y: Array) -> Array:
        """Return the standard normal log-density (B,)."""
        return stats.norm.logpdf(y).sum(axis=1)

    def gradient(self, y: Array) -> tuple[Array, Array]:
        """Return gradient and Hessian at y (n,), by differences."""
        return difference_twice(self.log_density, y, np.eye(self.n), STEP)

    def least_squares_start(self) -> Array:
        """Return the start."""
        return np.zeros(self.n) if self.start is None else self.start

    def curved_ridges(self) -> list[tuple[int, Array]]:
        """Return those declared."""
        return list(self.ridges)


def plant(density: Callable[[Array], Array], n: int, **options: Any) -> Planted:
    """Return a planted density."""
    return Planted(np.empty(0), density, n, **options)


RIDGE = ((0, np.array([1])),)
PLANTED: dict[str, Callable[[], Arc]] = {
    "loose turns": lambda: bend(4, 3),
    "two posts, mirrored": lambda: Posts(np.empty(0)),
    "bent ridge with a tail": lambda: plant(Bent(Tailed()).log_density, 2, start=np.array([0.0, 0.3]), ridges=RIDGE),
    "bend nobody declares": lambda: plant(banana, 6),
    "exponential tail": lambda: plant(long_tail, 6),
    "Student's tail": lambda: plant(heavy_tail, 6),
    "minor mode": lambda: plant(minor_mode, 6),
    "two modes": lambda: plant(two_modes, 6),
    "skewed": lambda: plant(skewed, 6),
    "funnel": lambda: plant(funnel, 3),
    "rows that tell little": lambda: plant(tell_little, 8),
}


@dataclass(frozen=True)
class Subject:
    """What is fitted: the readings of a machine, or a density alone."""

    readings: ReadingSubject | None
    density: Any
    tempered: bool = False
    """Whether tempering from the prior takes seconds, and so tells its evidence, too."""


def read_variant(folder: str, name: str) -> Subject:
    """Return a variant of a study."""
    path = ROOT / folder / "study.toml"
    experiment, config = load(path)
    found = experiment.read(config, path.parent).variants[name].posterior().with_pose_guesses()
    return Subject(ReadingSubject(found), found)


def measure_twin(name: str) -> Subject:
    """Return a twin of `benchmarks/truth` as `bayescal init` states its errors."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "twin"
        machine, twin = draw_twin(name, "none", 0.0, FIRST_SEED)
        write_project(name, machine, "init", folder)
        write_tables(machine, twin.values, twin.held, folder)
        experiment, config = load(folder / "study.toml")
        variants = experiment.read(config, folder).variants
        found = next(iter(variants.values())).posterior().with_pose_guesses()
    return Subject(ReadingSubject(found), found)


def simulate_case(name: str) -> Subject:
    """Return a posterior of the tests' battery."""
    found = (CASES | FEW)[name].posterior()
    return Subject(ReadingSubject(found), found, tempered=True)


def list_posteriors() -> Mapping[str, Callable[[], Subject]]:
    """Return by name how each posterior is made, the quickest first."""
    found: dict[str, Callable[[], Subject]] = {}
    for name, make in PLANTED.items():
        found[f"planted: {name}"] = lambda make=make: Subject(None, make())
    for name in (*BATTERY, *FEW):
        found[f"battery: {name}"] = partial(simulate_case, name)
    for name in TWINS:
        found[f"twin: {name}"] = partial(measure_twin, name)
    for study, (folder, variants) in STUDIES.items():
        for name in variants:
            found[f"{study}: {name}"] = partial(read_variant, folder, name)
    return found
