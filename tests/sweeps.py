"""Sweeps over an experiment that is over in an instant: a machine of two numbers, one of them in a file of its own."""

from __future__ import annotations

from pathlib import Path

KIND = '''
"""A figure that falls with its noise's fourth power below one, fails at a factor of 13, and is unsure at 7 poses."""

import tomllib
from pathlib import Path

from pydantic import Field

from bayescal.config.sections import ExperimentConfig, InputFile, Positive, Section
from bayescal.errors import InputError, NumericalError
from bayescal.experiments.runner.experiment import Experiment
from bayescal.experiments.runner.results import Results
from bayescal.report.blocks import Page, make_section


class Noise(Section):
    tracker_um: Positive = 10.0
    level_um: Positive = 1.0


class TinyConfig(ExperimentConfig):
    machine: InputFile
    count: str = ""
    poses: int = Field(default=12, ge=1)
    noise: Noise = Noise()


class Tiny(Experiment):
    schema = TinyConfig

    def read(self, config, folder):
        try:
            return config, tomllib.loads((folder / config.machine).read_text())["legs"]["length_mm"]
        except (OSError, KeyError, RecursionError, TypeError, ValueError) as error:
            raise InputError(f"{config.machine}: found no length of legs, expected one") from error

    def compute(self, inputs, run):
        config, length = inputs
        if config.count:
            with Path(config.count).open("a") as log:
                log.write("x")
        if config.noise.level_um == 13.0:
            raise NumericalError("no machine has\\nsuch a level")
        if config.noise.level_um == 17.0:
            raise KeyError("a slip in the code")
        value = config.noise.tracker_um * length / config.poses**0.5
        sensors = {"tracker.a": {"sd": value, "seen": True}, "names": ["a", {"b": 3}], "none": None}
        return Results({"sensors": sensors, "seed": config.seed, "poses": config.poses})

    def list_failures(self, results):
        return ["seven is unlucky"] if results.summary["poses"] == 7 else []

    def page(self, results):
        return Page("Tiny", "tiny", "Tiny", "Made up", "Done.", (), (make_section("Text"),))
'''

BASE = """
kind = "tiny_kind.py:Tiny"
name = "tiny"
title = "Tiny"
seed = 1
machine = "machine.toml"
"""

MACHINE = 'name = "two numbers"\n[legs]\nlength_mm = 2.0  # of all legs\nends = [[0.0, 1.0], [true, "x\\n"]]\n'

SWEEP = """
kind = "sweep"
name = "tiny_sweep"
title = "How good the tracker must be"
seed = 5
experiment = "tiny.toml"

[[axes]]
key = "noise.tracker_um"
label = "tracker's noise"
unit = "µm"
range = [1.0, 100.0]
count = 5
scale = "log"

[[axes]]
key = "poses"
values = [4, 16]

[[figures]]
key = "sensors.tracker.a.sd"
label = "deviation"
unit = "µm"
scale = "log"
at_most = 20.0
"""


def write(folder: Path, more: str = "", sweep: str = SWEEP, counted: bool = False) -> Path:
    """Write a sweep with its experiment to a folder; return its config. Members may be counted by a file's letters."""
    (folder / "tiny_kind.py").write_text(KIND)
    (folder / "machine.toml").write_text(MACHINE)
    (folder / "tiny.toml").write_text(BASE + (f'count = "{folder / "count"}"\n' if counted else ""))
    path = folder / "sweep.toml"
    path.write_text(sweep + more)
    return path


def write_apart(folder: Path) -> Path:
    """Write a sweep that keeps its members for itself."""
    return write(folder, sweep=SWEEP.replace("[[axes]]", 'cache_dir = ""\n\n[[axes]]', 1))
