"""What of a calibrated machine a file holds that has fewer parameters than it, or others."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import qmc

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.errors import InputError
from bayescal.machines.readings import FunctionModel, ReadingMachine
from bayescal.numerics.geometry import Array

SAMPLES = 256  # poses of the workspace
NOTHING_MM = 1e-6
CARRIES = "carries"
SUFFIXES = (".cfg", ".csv", ".g", ".gcode", ".hal", ".toml", ".urdf", ".yaml")


@dataclass(frozen=True, eq=False)
class BareMachine[M: ReadingMachine]:
    """A machine of one place without instruments, and its parameters (D,) as calibrated."""

    machine: M
    model: FunctionModel  # of the machine
    theta: Array
    given: Mapping[str, Array]

    def take(self, symbol: str) -> Array:
        """Return a symbol's values, (n,)."""
        return self.theta[self.model.layout.index[symbol]]

    def change(self, **values: float | Array) -> Array:
        """Return the parameters with other values of some symbols."""
        changed = self.theta.copy()
        for symbol, value in values.items():
            changed[self.model.layout.index[symbol]] = value
        return changed

    def sample(self) -> tuple[Array, Array, Mapping[str, Array]]:
        """Return poses (P, q) all over the workspace, commands (P, C) that lead there, and what is given (P,)."""
        home, model = self.model.home_pose, self.model
        pose = home + model.pose_scale * qmc.scale(qmc.Sobol(len(home), rng=1).random(SAMPLES), -1.0, 1.0)
        given = {name: np.resize(value, SAMPLES) for name, value in self.given.items()}
        return pose, model.read(self.theta, pose, given)[:, model.select(model.commanded)], given

    def measure(self, other: Array) -> float:
        """Return how far the tool is from that of other parameters at the same commands, mm rms over the workspace."""
        model, (pose, commands, given) = self.model, self.sample()
        there, found = model.locate(other, np.nan_to_num(commands), given)
        apart = model.tool_values(self.theta, pose) - model.tool_values(other, there)
        apart = apart[found & np.isfinite(commands).all(axis=1)]
        return float(np.sqrt((apart**2).sum(axis=1).mean())) if len(apart) else float("nan")

    def describe(self, held: Array, file: str = "The file") -> str:
        """Return in words what a file that holds some parameters carries."""
        return describe_share(self.measure(self.model.layout.nominal), self.measure(held), file)


def describe_share(whole: float, left: float, file: str = "The file", unit: str = "mm") -> str:
    """Return in words how much of what the tool is off nominal a file carries, both rms over the workspace."""
    carried = f"{file} {CARRIES} {max(0.0, whole - left):.2g} of {whole:.2g} {unit}"
    said = f"{carried} of the tool's deviation, rms over the workspace"
    return said if left < NOTHING_MM else f"{said}; {left:.2g} {unit} are left"


def take_machine[M: ReadingMachine](
    calibrated: CalibratedMachine, what: str, kinds: Mapping[str, type[M]]
) -> BareMachine[M]:
    """Return a calibrated machine of one of some kinds; InputError for another."""
    whole = calibrated.model.bare.of_function
    machine = None if whole is None else whole.at_one_place
    for kind in kinds.values():
        if isinstance(machine, kind):
            one = FunctionModel(calibrated.name, machine)
            given = {name: calibrated.given[name] for name in one.given if name in calibrated.given}
            return BareMachine(machine, one, calibrated.theta[: one.layout.size], given)
    expected = " or ".join(f'kind = "{name}"' for name in kinds)
    raise InputError(f"format {what}: found machine {calibrated.name!r}, expected {expected}")


def describe_carried(paths: Iterable[Path]) -> list[str]:
    """Return what written files of a firmware say of how much they carry."""
    files = [path for path in paths if path.suffix in SUFFIXES]
    lines = [line for path in files for line in path.read_text(encoding="utf-8").splitlines()]
    said = [line.strip(" <!->#;") for line in lines if line.lstrip().startswith(("#", ";", "<!--"))]
    return [line for line in said if f" file {CARRIES} " in line]
