"""A kind of experiment that stands outside the package, as a user would write it: one file beside its config."""

from __future__ import annotations

from pathlib import Path

KIND = '''
"""Squares of random numbers, each a task of its own that runs tasks itself."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from pydantic import Field

from bayescal.config.sections import ExperimentConfig, InputFile
from bayescal.errors import InputError
from bayescal.experiments.runner.experiment import Experiment
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.runner.results import Results
from bayescal.report.blocks import Page, make_section


class ToyConfig(ExperimentConfig):
    numbers: InputFile
    count: int = Field(default=4, ge=1)
    pause: float = 0.0


@dataclass(frozen=True)
class Factor:
    value: float


@dataclass(frozen=True)
class Factors:
    both: tuple[Factor, Factor]


class Toy(Experiment):
    schema = ToyConfig

    def read(self, config, folder):
        text = (folder / config.numbers).read_text()
        if "nonsense" in text:
            raise InputError(f"{config.numbers}: found nonsense, expected a number")
        return config, float(text)

    def compute(self, inputs, run):
        config, factor = inputs
        tasks = {f"number {k}": k for k in range(config.count)}
        found = run.map("squares", square, (config, factor), tasks)
        table = pd.DataFrame({"number": list(found), "square": list(found.values())})
        return Results({"total": float(table["square"].sum())}, {"squares": table}, {"notes/plain.txt": "squares"})

    def page(self, results):
        total = results.summary["total"]
        return Page("Toy", "toy", "Toy", "Made up", f"Squares add up to {total:.3f}.", (), (make_section("Text"),))


def square(shared, k):
    config, factor = shared
    time.sleep(config.pause)
    one, other = Run().once("factors", draw, [config.seed, k], (Factors,)).both
    return factor * one.value * other.value


def draw(seed):
    drawn = Factor(float(np.random.default_rng(seed).normal()))
    return Factors((drawn, drawn))
'''

CONFIG = """
kind = "toy_kind.py:Toy"
name = "toy"
title = "A toy"
seed = 3
numbers = "numbers.txt"
"""


def write_toy(folder: Path, more: str = "") -> Path:
    """Write the kind, its input file and a config to a folder; return the config."""
    (folder / "toy_kind.py").write_text(KIND)
    (folder / "numbers.txt").write_text("2.0\n")
    path = folder / "toy.toml"
    path.write_text(CONFIG + more)
    return path
