"""Classes as users write them, in one file beside a config: model, deformation, sensor, criterion, method."""

from __future__ import annotations

from pathlib import Path

import studies

OWN = '''
"""Built-in classes with a twist."""

from dataclasses import replace

import numpy as np

from bayescal.config.sections import Number, Positive, Section
from bayescal.machines.deformations import LinearDeformation
from bayescal.machines.models import SixPus
from bayescal.machines.sensors import PoseSensor, Sensor
from bayescal.pose_selection import SelectionMethod
from bayescal.pose_selection.criteria import DOptimality

MICROMETRE = 1e-3


class LongerOptions(Section):
    longer_mm: Positive = 1.0


class Longer(SixPus):
    name = "longer"
    title = "6-PUS with longer legs"
    Config = LongerOptions

    def __init__(self, config, mechanism):
        self.longer = config.longer_mm

    def blocks(self, mechanism):
        return tuple(
            replace(block, nominal=tuple(x + self.longer for x in block.nominal)) if block.symbol == "l" else block
            for block in super().blocks(mechanism)
        )


class Halved(LinearDeformation):
    name = "halved"

    def __init__(self, config, nominal):
        super().__init__(nominal.kappa / 2.0)


class TrackerOptions(Section):
    noise_um: Positive


class Tracker(Sensor):
    Config = TrackerOptions

    def __init__(self, config):
        self.sensor = PoseSensor(config.noise_um * MICROMETRE, None)

    def information(self, position, rotation):
        return self.sensor.information(position, rotation)


class Weight(Section):
    weight: Number


class Weighted(DOptimality):
    name = "weighted"
    title = "Information, weighted"
    source = "Nobody 2026"
    Config = Weight

    def __init__(self, config, purpose):
        object.__setattr__(self, "weight", config.weight)

    def from_log_det(self, log_det, n_poses, n_parameters):
        return self.weight * super().from_log_det(log_det, n_poses, n_parameters)


class First(Section):
    skip: int = 0


class Foremost(SelectionMethod):
    name = "foremost"
    title = "The first candidates"
    source = "Nobody 2025"
    Config = First

    def __init__(self, config):
        self.skip = config.skip

    def select(self, problem, rng):
        index = np.arange(self.skip, self.skip + problem.n)
        return self._from_candidates(problem, index, [0.0], 1, "there is nothing to search")


class Nameless(SixPus):
    title = "6-PUS under a name that is taken"


class Bare(Sensor):
    pass


class Failing(Longer):
    name = "failing"

    def blocks(self, mechanism):
        raise RuntimeError("no blocks\\nhere")


class Lying(Tracker):
    def information(self, position, rotation):
        return np.zeros(6)
'''

VARIANTS = """
[[variants]]
model = { class = "own.py:Longer", longer_mm = 0.5 }
deformation = "none"
free = ["l"]

[[variants]]
model = "six_pus"
deformation = "own.py:Halved"
free = ["l", "kappa"]
"""

ONE_VARIANT = """
[[variants]]
model = { class = "own.py:Longer", longer_mm = 0.5 }
deformation = "own.py:Halved"
free = ["l"]
"""

SELECTION = """
kind = "selection"
name = "own"
title = "Own criterion and method"
seed = 5
machine = "mechanism.toml"

[provenance]
status = "simulated"
text = "for the tests"

[variant]
model = "six_pus"
sensors = ["tracker"]

[parameters]
b_x = { prior = "normal", sd = 0.5 }
l = { prior = "normal", sd = 1.0 }

[noise]
actuator_um = 1.0

[sensors.tracker]
kind = "own.py:Tracker"
noise_um = 10.0

[domain]
kind = "actuators"

[candidates]
count = 30

[[selections]]
method = "own.py:Foremost"
skip = 2
criteria = ["D", { class = "own.py:Weighted", weight = 3.0 }]
n_poses = [8]

[[selections]]
method = "exchange"
criteria = [{ class = "own.py:Weighted", weight = 3.0 }]
n_poses = [8]
"""


def write_study(folder: Path, variants: str = VARIANTS) -> Path:
    """Write a tiny study whose variants are of own classes; return its config."""
    path = studies.write_tiny_study(folder)
    text = path.read_text()
    start, end = text.index("[[variants]]"), text.index("[sampler]")
    path.write_text(text[:start] + variants + text[end:])
    (folder / "own.py").write_text(OWN)
    return path


def write_selection(folder: Path) -> Path:
    """Write a tiny pose selection with an own criterion, method and sensor; return its config."""
    (folder / "mechanism.toml").write_text((studies.TELESCOPE / "mechanism.toml").read_text())
    (folder / "own.py").write_text(OWN)
    path = folder / "selection.toml"
    path.write_text(SELECTION)
    return path
