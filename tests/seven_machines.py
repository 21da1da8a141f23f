"""The machines of the table in docs/uses.md, each with all configs of a user on disk, tiny: one writer a machine."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import calibrations
import own_arm
import studies

from bayescal.files.csv_tables import read_table

EFFORT = {"ensembles": "4", "walkers": "24", "burn_in": "3", "steps": "40", "draws": "1000", "max_draws": "1000"}
OF_LEGS = {"walkers": "32", "burn_in": "5", "prior_width_factors": "[1.0]", "separate_by_leg": "false"}


@dataclass(frozen=True)
class Written:
    """A machine's folder with ``study.toml``, ``next_pose.toml``, ``sessions.toml`` and ``table.toml``.

    ``variant`` is the one that is used, ``together`` the study with all kinds of errors, ``commands`` the table of what
    actuators did, ``coordinates`` the columns that say where the machine is, ``verify`` the options that say what a
    pose is measured with, ``rigid`` the variant for formats of rigid platforms.
    """

    folder: Path
    variant: str
    together: Path
    commands: Path
    coordinates: tuple[str, ...]
    verify: tuple[object, ...] = ()
    rigid: str = ""


# --- sections ---------------------------------------------------------------------------------------------------------

HEAD = """kind = "{kind}"
name = "{kind}"
title = "Tiny"
seed = {seed}
"""
STUDY = """machine = "machine.toml"

[provenance]
status = "simulated"
text = "one machine drawn within its tolerances"

[[data]]
file = "data/readings.csv"
"""
SIMULATION = """machine = "machine.toml"
n_poses = {n_poses}
provenance = {{ status = "simulated", text = "Simulated for the tests, never measured" }}
"""
VARIANTS = """
[[variants]]
name = "whole"
title = "All parameters"

[[variants]]
name = "few"
title = "Some of them"
free = {few}
"""
SAMPLER = """
[sampler]
walkers = 24
burn_in = 3
steps = {steps}

[evidence]
draws = 1000
max_draws = 1000

[validation]
draws = 100
"""
TOGETHER = """
[[variants]]
name = "together"
title = "Noise by group, model error, functions and outliers"
free = {few}
student_t_dof = 4.0

[noise_factor_log_sd]
{own} = 0.5

[model_error]
{own} = {{ scale = {scale} }}

[error_terms.drives]
channels = ["{own}"]
kernel = "quadratic"
{function}
"""
NEXT = """study = "study.toml"
variants = ["{variant}"]
draws = 200
horizon = 3

[requirements]
{required} = {limit}
"""
SESSIONS = """study = "study.toml"
variant = "{variant}"
provenance = {{ status = "simulated", text = "for the tests" }}
draws = 1000

[drift]
{drift}
"""
TABLE = """study = "study.toml"
variant = "{variant}"

[axes]
temperature_c = [10.0, 20.0, 30.0]

[reference]
temperature_c = 20.0

[plan]
measurements = 2
poses = 4
"""


def _write(path: Path, kind: str, text: str, seed: int = 1) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(HEAD.format(kind=kind, seed=seed) + text)


def _write_questions(
    folder: Path, variant: str, next_pose: str, drift: str, tables: Sequence[Mapping[str, str]]
) -> None:
    """Write what is asked of a study: the next pose, two sessions of every second of its rows each, a table."""
    (folder / "next_pose.toml").write_text(f'name = "next_pose"\ntitle = "Tiny"\nseed = 1\n{next_pose}')
    text = SESSIONS.format(variant=variant, drift=drift)
    for half in (0, 1):
        text += f'\n[[sessions]]\nlabel = "{half + 1}"\ntime_days = {30.0 * half}\n'
        halves = [{key: _halve(folder / name, half) for key, name in one.items()} for one in tables]
        listed = ", ".join("{ " + ", ".join(f'{key} = "{name}"' for key, name in one.items()) + " }" for one in halves)
        text += f"data = [{listed}]\n"
    _write(folder / "sessions.toml", "sessions", text)
    _write(folder / "table.toml", "table", TABLE.format(variant=variant))


def _halve(path: Path, half: int) -> str:
    """Write every second pose of a table, from the first or the second on; return the file's name in the folder."""
    table = read_table(path, None)
    wanted = set(list(dict.fromkeys(table.text("pose")))[half::2])
    where = path.with_name(f"{path.stem}_{half + 1}.csv")
    rows = [",".join(row) for row, name in zip(table.rows, table.text("pose"), strict=True) if name in wanted]
    where.write_text("\n".join([",".join(table.columns), *rows]) + "\n")
    return str(where.relative_to(path.parents[1]))


# --- machines of readings ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Readings:
    """A machine whose readings are simulated: sections of its files, and what the whole variant leaves free.

    ``errors`` is what its study says of the model error, nothing for the default one.
    """

    machine: str
    sensors: str
    parameters: str
    own: str
    few: str
    errors: str = ""
    required: str = "x"
    drift: str = ""
    more: str = ""
    given: str = ""
    beside: Callable[[Path], object] = lambda folder: None
    coordinates: tuple[str, ...] = ("x_mm", "y_mm", "z_mm")
    n_poses: int = 16
    turns: bool = False
    verify: tuple[object, ...] = ()

    def write(self, folder: Path) -> Written:
        """Write the machine, its readings and all configs."""
        self.prepare(folder)
        drift = self.drift + ("\nscale_arcsec = 20.0" if self.turns else "\nscale_um = 20.0")
        asked = NEXT.format(variant="whole", required=self.required, limit=1.0) + "\n[candidates]\ncount = 20\n"
        _write_questions(folder, "whole", asked, drift, [{"file": "data/readings.csv"}])
        commands = folder / "results" / "machine" / "commands_whole.csv"
        return Written(folder, "whole", folder / "together.toml", commands, self.coordinates, self.verify)

    def prepare(self, folder: Path) -> None:
        """Write the machine, its readings, the study and that of all errors together."""
        folder.mkdir(parents=True, exist_ok=True)
        self.beside(folder)
        (folder / "machine.toml").write_text(self.machine)
        known = f"\n[sensors]\n{self.sensors}\n\n[parameters]\n{self.parameters}\n{self.more}"
        _write(
            folder / "simulate.toml",
            "simulation",
            SIMULATION.format(n_poses=self.n_poses) + self.given + known,
            seed=3,
        )
        studies.write_texts(folder / "data", studies.simulate(folder / "simulate.toml").files)
        _write(
            folder / "study.toml",
            "study",
            STUDY + known + self.errors + VARIANTS.format(few=self.few) + SAMPLER.format(steps=40),
        )
        keys = {"scale": 1e-4, "function": "scale_arcsec = 5.0"} if self.turns else {}
        together = TOGETHER.format(
            **{"own": self.own, "few": self.few, "scale": 0.01, "function": "scale_um = 5.0"} | keys
        )
        _write(folder / "together.toml", "study", STUDY + known + together + SAMPLER.format(steps=6))


FIVE_BAR = '''"""A five-bar that grows with its temperature: two cranks turn, their couplers meet at the tool."""

import numpy as np

from bayescal import Channel, Coordinate, ParameterBlock, ReadingMachine
from bayescal.numerics.analytic import atan2


class FiveBar(ReadingMachine):
    """Two encoders, and a camera that sees the tool."""

    member = "crank"
    given = ("temperature_c",)
    tool_channels = (Channel("x", "mm"), Channel("y", "mm"))

    def __init__(self, config):
        super().__init__(config)
        self.parameters = [
            ParameterBlock("x", (-100.0, 100.0)),
            ParameterBlock("l", (200.0, 200.0), lower=0.0),
            ParameterBlock("m", (250.0, 250.0), lower=0.0),
            ParameterBlock("o", (0.0, 0.0), "rad"),
            ParameterBlock("e", (12.0,), "1e-6/K", per_leg=False),
        ]
        self.coordinates = [Coordinate("x", "mm", 0.0, 60.0), Coordinate("y", "mm", 300.0, 50.0)]
        self.channels = [
            *(Channel(f"motor[{k}]", "rad") for k in (1, 2)),
            *(Channel(f"cam_{axis}", "mm", external=True) for axis in "xy"),
        ]

    def read(self, parameters, v, given):
        l, m = parameters["l"], parameters["m"]
        grown = (1.0 + 1e-6 * parameters["e"] * (given["temperature_c"] - 20.0))[..., None]
        away, up = v[..., 0, None] - grown * parameters["x"], v[..., 1, None]
        square = away**2 + up**2
        elbow = np.arccos((l**2 + square - m**2) / (2 * l * np.sqrt(square)))
        motor = atan2(up, away) + elbow * np.array([1.0, -1.0]) - parameters["o"]
        return np.concatenate([motor, np.broadcast_to(v, motor.shape)], axis=-1)

    def tool(self, parameters, v):
        return v
'''


def _normal(**sd: float) -> str:
    return "\n".join(f'{symbol} = {{ prior = "normal", sd = {value} }}' for symbol, value in sd.items())


def _noise(um: Mapping[str, float] | None = None, arcsec: Mapping[str, float] | None = None) -> str:
    lines = [f"{name} = {{ noise_um = {value} }}" for name, value in (um or {}).items()]
    return "\n".join([*lines, *(f"{name} = {{ noise_arcsec = {value} }}" for name, value in (arcsec or {}).items())])


INDEPENDENT = '\n[model_error]\nterms = ["random"]\n'  # functions of the pose take most of the time
READINGS = {
    "sliding platform": Readings(
        (studies.EXPERIMENTS / "sliding_star" / "machine.toml").read_text(),
        _noise({"s": 1.0, "x_V": 10.0, "y_V": 10.0}, {"phi_V": 2.0}),
        _normal(l=0.3, y_P=0.005),
        own="s",
        few='["l"]',
        errors=INDEPENDENT,
        required="x_V",
        drift='symbols = ["l"]\nseparate_by_leg = false',
        more="\n[workspace]\nx = [-50.0, 250.0]\ny = [-150.0, 150.0]\nphi = [120.0, 150.0]\n",
        coordinates=("x_mm", "y_mm", "phi_rad"),
    ),
    "linear delta": Readings(
        (calibrations.OWN_MACHINE / "machine.toml").read_text(),
        _noise({"s": 5.0, "cam_x": 20.0, "cam_y": 20.0, "height": 10.0}),
        _normal(l=0.01, s0=0.5),
        own="s",
        few='["s0"]',
        drift='symbols = ["s0"]\nseparate_by_leg = false',
        beside=lambda folder: shutil.copy(calibrations.OWN_MACHINE / "linear_delta.py", folder),
    ),
    "arm": Readings(
        own_arm.MACHINE,
        _noise({f"tracker_{axis}": 10.0 for axis in "xyz"}, {"encoder": 5.0}),
        _normal(h=0.005, o=0.1),
        own="encoder",
        few='["o"]',
        errors=INDEPENDENT,
        drift='symbols = ["o"]\nseparate_by_leg = false',
        beside=lambda folder: shutil.copy(own_arm.__file__, folder),
        coordinates=("q1_rad", "q2_rad", "q3_rad"),
        turns=True,
    ),
    "own class": Readings(
        'kind = "five_bar.py:FiveBar"\nname = "five_bar"\ntitle = "A five-bar"\n',
        _noise({"cam_x": 10.0, "cam_y": 10.0}, {"motor": 5.0}),
        _normal(l=0.3, o=0.1, e=0.5),
        own="motor",
        few='["l", "o"]',
        errors=INDEPENDENT,
        drift='symbols = ["o"]\nseparate_by_leg = false',
        given="\n[conditions]\ntemperature_c = [10.0, 30.0]\n",
        beside=lambda folder: (folder / "five_bar.py").write_text(FIVE_BAR),
        coordinates=("x_mm", "y_mm"),
        turns=True,
        verify=("--parameters", "o", "--shift-arcsec", 60),
    ),
}


PRINTER = """
[[variants]]
name = "rigid"
title = "One radius"
free = ["A_x", "A_y", "A_z", "R"]
tied = [["R[1]", "R[2]", "R[3]"]]

[[variants]]
name = "few"
title = "Anchors alone"
free = ["A_x", "A_y", "A_z"]
"""


UNFORCED = 'channels = ["motor"]\nignore = ["force_1", "force_2", "force_3", "force_4"]'


def write_printer(folder: Path) -> Written:
    """Write the Hangprinter as it was measured, with two of its variants."""
    shutil.copytree(studies.EXPERIMENTS / "hangprinter", folder)
    known = (folder / "study.toml").read_text().partition("[[variants]]")[0]
    known = known.replace('channels = ["motor"]', UNFORCED)
    plain = "\n[model_error]\nterms = []\n\n"  # 44 poses and few steps do not do for the default one
    (folder / "study.toml").write_text(known + plain + PRINTER + SAMPLER.format(steps=40))
    together = TOGETHER.format(own="motor", few='["A_x", "A_y", "A_z"]', scale=0.1, function="scale_deg = 5.0")
    known = re.sub(r"(?ms)^\[(noise_factor_log_sd|model_error)\].*?(?=^\[|\Z)", "", known)
    (folder / "together.toml").write_text(known + together + SAMPLER.format(steps=6))
    asked = NEXT.format(variant="rigid", required="x", limit=50.0) + "\n[candidates]\ncount = 20\n"
    tables = ["data/encoders.csv", "data/positions.csv"]
    _write_questions(folder, "rigid", asked, 'symbols = ["R"]\nscale_um = 20.0', [{"file": one} for one in tables])
    commands = folder / "results" / "machine" / "commands_rigid.csv"
    return Written(folder, "rigid", folder / "together.toml", commands, ("x_mm", "y_mm", "z_mm"))


# --- legs -------------------------------------------------------------------------------------------------------------

ASKED_OF_LEGS = """
[workspace]
position_mm = [{half}, {half}, {half}]
rotation_deg = [0.1, 0.1, 0.1]
poses = 15

[candidates]
count = 16
range_mm = {reach}
"""
INSTRUMENT = ("--position-um", 5, "--orientation-arcsec", 2, "--shift-um", 200)
POSE = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")


def _write_legs(folder: Path, variant: str, half: float, reach: float) -> Written:
    """Write what is asked of a study of legs that is there, and the same with all errors together."""
    asked = NEXT.format(variant=variant, required="z", limit=1.0) + ASKED_OF_LEGS.format(half=half, reach=reach)
    tables = [{"file": "data/targets.csv", "actuators": "data/actuators.csv"}]
    _write_questions(folder, variant, asked, 'symbols = ["l"]\nscale_um = 20.0\nseparate_by_leg = false', tables)
    text = (folder / "study.toml").read_text()
    text = re.sub(r"(?ms)^\[(model_error|sampler|evidence|validation|sensitivity)\].*?(?=^\[|\Z)", "", text)
    known = re.sub(r"(?m)^kappa = \{.*\n", "", text.partition("[[variants]]")[0])
    errors = TOGETHER.format(own="rho", few='["l"]', scale=0.01, function="scale_um = 5.0")
    seen = 'name = "together"\nmodel = "six_pus"\ndeformation = "none"'
    together = folder / "together.toml"
    together.write_text(known + errors.replace('name = "together"', seen) + SAMPLER.format(steps=6))
    return Written(folder, variant, together, folder / "data" / "actuators.csv", POSE, INSTRUMENT, "six_pus/none")


def write_telescope(folder: Path) -> Written:
    """Write the telescope's tiny study."""
    path = studies.write_tiny_study(folder)
    _shrink(path)
    return _write_legs(folder, "six_pus/matrix", 0.3, 1.2)


def write_hexaglide(folder: Path) -> Written:
    """Write the shipped hexaglide with few of its parameters, surveyed again with these alone off nominal."""
    shutil.copytree(studies.EXPERIMENTS / "hexaglide", folder)
    twin = folder / "simulate.toml"
    twin.write_text(re.sub(r"(?m)^(a_y|a_z|b_x|u_z) = .*\n", "", twin.read_text()))
    studies.write_texts(folder / "data", studies.simulate(twin).files)
    path = folder / "study.toml"
    text = path.read_text().replace('free = ["a_y", "a_z", "b_x", "l", "u_y", "u_z"]', 'free = ["l", "u_y"]')
    path.write_text(
        text.replace('free = ["a_y", "a_z", "b_x", "l", "u_y", "u_z", "kappa"]', 'free = ["l", "u_y", "kappa"]')
    )
    _shrink(path)
    return _write_legs(folder, "six_pus/none", 20.0, 100.0)


def _shrink(path: Path) -> None:
    text = path.read_text()
    for key, value in (EFFORT | OF_LEGS).items():
        text = re.sub(rf"(?m)^{key} = .*$", f"{key} = {value}", text)
    path.write_text(text)


MACHINES: dict[str, Callable[[Path], Written]] = {
    "telescope's legs": write_telescope,
    "hexaglide": write_hexaglide,
    "cable printer (Hangprinter)": write_printer,
    **{name: one.write for name, one in READINGS.items()},
}
"""By the columns of the table."""
