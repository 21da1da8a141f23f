"""Machines drawn from a number, as users write them: a class, a study, a table, of any coordinates, channels and units.

What is drawn: coordinates, channels with their units, own or external, what each reads (zero and gain, a distance, an
angle, a product), how many rows, which are held back or have gaps, terms of the model error, variants. Some machines
have what spoils a calibration: a parameter without influence, two that act as their sum alone, a coordinate that no
channel sees, a mirrored solution, two equal columns, a column of the wrong sign, a scale slip, exchanged cells.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from fuzz.hostile import dump_toml

UNITS = {"mm": 100.0, "rad": 0.8, "N": 50.0, "mV": 5.0, "1": 1.0, "degC": 20.0}
"""Units of channels, with how large a reading is about."""
DEGREES = float(np.degrees(1.0))
NOISE_KEYS = {
    "mm": {"noise_um": 1e3, "noise_mm": 1.0},
    "rad": {"noise_deg": DEGREES, "noise_rad": 1.0, "noise_arcsec": 3600.0 * DEGREES},
}
OTHER = {"noise": 1.0}
COLUMNS = {"mm": {"mm": 1.0, "um": 1e3}, "rad": {"deg": DEGREES, "rad": 1.0}}
EFFORT = {
    "sampler": {"walkers": 24, "burn_in": 10, "steps": 20},
    "evidence": {"draws": 1000, "max_draws": 1000},
    "next": {"candidates": 20},
}
SHAPES = ("plain", "scaled", "distance", "sine", "product")
TERMS: tuple[Any, ...] = (None, [], ["random"], ["random", "positioning"], ["random", "linear", "drift"])
"""Of the model error; None for the default."""
SPOILT = ("no influence", "a sum", "not seen", "equal columns", "wrong sign", "scale slip", "exchanged cells", "tight")
"""What may be wrong with a machine or its data."""
NAMES = ("x", "y", "z", "a", "b", "c")


def round_off(number: float, digits: int = 4) -> float:
    """Return a number as somebody types it."""
    return float(f"{number:.{digits}g}")


@dataclass(eq=False)
class Drawn:
    """A machine under construction."""

    rng: np.random.Generator
    coordinates: list[tuple[str, str, float, float]] = field(default_factory=list)  # name, unit, home, reach
    blocks: dict[str, tuple[float, str, float]] = field(default_factory=dict)  # nominal, unit, tolerance
    channels: list[tuple[str, str, bool]] = field(default_factory=list)  # name, unit, external
    formulas: list[str] = field(default_factory=list)
    spoilt: str = ""

    def chance(self, probability: float) -> bool:
        """Return True with a probability."""
        return bool(self.rng.random() < probability)

    def pick(self, *these: Any) -> Any:
        """Return one of several."""
        return these[self.rng.integers(len(these))]

    def add_parameter(self, nominal: float, unit: str, tolerance: float) -> str:
        """Add a parameter; return what `read` calls it."""
        name = f"p{len(self.blocks) + 1}"
        self.blocks[name] = (round_off(nominal), unit, round_off(tolerance))
        return f'p["{name}"]'

    def write_class(self) -> str:
        """Return the source of the machine's class."""
        flag = self.pick({False: "", True: ", external=True"}, {False: ", external=0", True: ", external=1"})
        flag = flag if self.chance(0.3) else {False: "", True: ", external=True"}
        parameters = [f'ParameterBlock("{n}", ({v!r},), "{u}", per_leg=False)' for n, (v, u, _) in self.blocks.items()]
        coordinates = [f'Coordinate("{n}", "{u}", {home!r}, {reach!r})' for n, u, home, reach in self.coordinates]
        channels = [f'Channel("{name}", "{unit}"{flag[external]})' for name, unit, external in self.channels]
        tool = [f'Channel("{n}", "{u}")' for n, u, *_ in self.coordinates] if self.coordinates else []
        lines = [
            '"""A machine that was drawn."""',
            "",
            "import numpy as np",
            "",
            "from bayescal import Channel, Coordinate, ParameterBlock, ReadingMachine",
            "",
            "",
            "class Machine(ReadingMachine):",
            f"    parameters = [{', '.join(parameters)}]",
            f"    coordinates = [{', '.join(coordinates)}]",
            *([f"    tool_channels = [{', '.join(tool)}]"] if tool and self.chance(0.7) else []),
            f"    channels = [{', '.join(channels)}]",
            "",
            "    def read(self, p, v, given):",
            *(f"        {name} = v[..., {k}]" for k, (name, *_) in enumerate(self.coordinates)),
            f"        read = [{', '.join(self.formulas)}]",
            "        return np.stack(np.broadcast_arrays(*read), axis=-1)",
        ]
        return "\n".join(lines) + "\n"


def draw_machine(rng: np.random.Generator) -> Drawn:
    """Return a machine: coordinates, channels, and what they read."""
    drawn = Drawn(rng)
    drawn.spoilt = str(rng.choice(SPOILT)) if drawn.chance(0.4) else ""
    angles_alone = drawn.chance(0.12)
    for name in NAMES[: rng.choice(7, p=[0.1, 0.25, 0.2, 0.2, 0.1, 0.05, 0.1])]:
        unit = "rad" if angles_alone else str(rng.choice(["mm", "rad", "1", "N"], p=[0.5, 0.3, 0.1, 0.1]))
        size = UNITS[unit]
        home, reach = drawn.pick(0.0, 0.5 * size, -size), drawn.pick(size, 0.3 * size)
        drawn.coordinates.append((name, unit, float(home), float(reach)))
    q = len(drawn.coordinates)
    n = int(np.clip(rng.integers(max(1, q), q + 5), 1, 12)) if drawn.chance(0.8) else int(rng.integers(1, 13))
    for k in range(n):
        unit = "rad" if angles_alone else str(rng.choice(list(UNITS), p=[0.4, 0.25, 0.1, 0.1, 0.1, 0.05]))
        external = drawn.chance(0.4) if q else drawn.chance(0.7)
        drawn.channels.append((f"s{k + 1}", unit, external))
        drawn.formulas.append(draw_formula(drawn, k, unit))
    if not drawn.blocks or drawn.spoilt == "no influence":
        drawn.add_parameter(1.0, "1", 0.01)
    if drawn.spoilt == "a sum":
        unit = drawn.channels[0][1]
        both = [drawn.add_parameter(0.0, unit, 0.01 * UNITS[unit]) for _ in range(2)]
        drawn.formulas[0] += f" + {both[0]} + {both[1]}"
    if drawn.spoilt == "equal columns":
        name, unit, external = drawn.channels[0]
        drawn.channels.append((f"{name}b", unit, external))
        drawn.formulas.append(drawn.formulas[0])
    return drawn


def draw_formula(drawn: Drawn, k: int, unit: str) -> str:
    """Return what a channel reads, an expression of coordinates and parameters."""
    size, q = UNITS[unit], len(drawn.coordinates)
    seen = q - 1 if drawn.spoilt == "not seen" and q > 1 else q
    shape, free = str(drawn.rng.choice(SHAPES)), drawn.chance(0.75)
    if not q:
        one = drawn.add_parameter(size, unit, 0.01 * size)
        other = drawn.add_parameter(drawn.pick(0.0, 0.3), "1", 0.02)
        return drawn.pick(one, f"{one} * np.cos({other})", f"{one} * np.sqrt(1.0 + {other})")
    name, own, _, reach = drawn.coordinates[k % seen]
    here = name if own == unit and reach > 0.0 else f"{size / UNITS[own]!r} * {name}"
    zero = drawn.add_parameter(0.0, unit, drawn.pick(0.01, 0.001) * size) if free else "0.0"
    other = drawn.coordinates[(k + 1) % seen]
    there = f"{size / UNITS[other[1]]!r} * {other[0]}"
    if shape == "plain":
        return f"{here} - {zero}"
    if shape == "scaled":
        gain = drawn.add_parameter(1.0, "1", drawn.pick(0.02, 0.1))
        return f"{gain} * ({here} + {drawn.pick(0.0, 0.1)!r} * {there}) - {zero}"
    if shape == "distance":  # mirrored where the point's height may be zero
        height = drawn.add_parameter(drawn.pick(0.0, 0.05, 0.5) * size, unit, drawn.pick(0.02, 0.2) * size)
        return f"np.sqrt(({here} - {zero}) ** 2 + {height} ** 2 + {1e-3 * size!r} ** 2)"
    if shape == "sine":
        amplitude = drawn.add_parameter(drawn.pick(0.0, 0.1) * size, unit, 0.01 * size)
        return f"{here} + {amplitude} * np.sin({name} / {UNITS[own]!r}) - {zero}"
    gain = drawn.add_parameter(1.0, "1", 0.05)
    return f"{gain} * ({here}) * (2.0 + {there} / {size!r}) - {zero}"


def draw_project(number: int) -> tuple[dict[str, str], str]:
    """Return the files of a drawn project by their names, and what is special of it in words."""
    rng = np.random.default_rng([46, number])
    drawn = draw_machine(rng)
    source = drawn.write_class()
    noise = {name: round_off(10.0 ** rng.uniform(-4.5, -2.5) * UNITS[unit]) for name, unit, _ in drawn.channels}
    n_rows = int(drawn.pick(1, 2, 3, 5, 8, 12, 20, 30, 60)) if drawn.coordinates else int(rng.integers(1, 6))
    values = simulate(drawn, source, noise, n_rows)
    values = spoil_data(drawn, values)
    table, study = write_table(drawn, values), draw_study(drawn, noise, n_rows, bool(np.isnan(values).any()))
    machine = {"kind": "machine.py:Machine", "name": "drawn", "title": "A machine that was drawn"}
    files = {"machine.py": source, "machine.toml": dump_toml(machine), "study.toml": dump_toml(study)}
    units = " ".join(unit for _, unit, _ in drawn.channels)
    said = f"{len(drawn.coordinates)} coordinates, {units}, {n_rows} rows, {drawn.spoilt or 'nothing spoilt'}"
    return files | {"readings.csv": table}, said


def simulate(drawn: Drawn, source: str, noise: dict[str, float], n_rows: int) -> np.ndarray:
    """Return readings (P, K) of a machine within its tolerances, with noise; two equal columns are equal."""
    space: dict[str, Any] = {}
    exec(compile(source, "machine.py", "exec"), space)  # drawn above
    rng, spread = drawn.rng, 5.0 if drawn.spoilt == "tight" else 1.0
    truth = {name: value + spread * sd * rng.standard_normal() for name, (value, _, sd) in drawn.blocks.items()}
    places = [(home, reach) for *_, home, reach in drawn.coordinates]
    home, reach = np.array(places, dtype=float).reshape(-1, 2).T
    pose = home + reach * rng.uniform(-1.0, 1.0, (n_rows, len(home)))
    with np.errstate(all="ignore"):
        read = space["Machine"]().read(truth, pose, {})
    read = np.broadcast_to(read, (n_rows, len(drawn.channels)))
    found = read + np.array(list(noise.values())) * rng.standard_normal((n_rows, len(noise)))
    if drawn.spoilt == "equal columns":
        found[:, -1] = found[:, 0]
    return np.nan_to_num(np.asarray(found))


def spoil_data(drawn: Drawn, values: np.ndarray) -> np.ndarray:
    """Return readings with what slips and faults make of them."""
    rng, found = drawn.rng, values.copy()
    k = int(rng.integers(found.shape[1]))
    if drawn.spoilt == "wrong sign":
        found[:, k] *= -1.0
    elif drawn.spoilt == "scale slip":
        found[:, k] *= drawn.pick(0.94, 1.1, 25.4)
    elif drawn.spoilt == "exchanged cells":
        first, second = rng.integers(len(found), size=2)
        found[[first, second], k] = found[[second, first], k]
    spare = found.shape[1] - len(drawn.coordinates)
    if spare > 0 and drawn.chance(0.3):
        for row in range(1, len(found)):
            gone = rng.permutation(found.shape[1])[: rng.integers(min(spare, 2) + 1)]
            found[row, gone if drawn.chance(0.3) else []] = np.nan
    return found


def write_table(drawn: Drawn, values: np.ndarray) -> str:
    """Return the CSV text; some rows are held back in some tables."""
    n_rows, names, columns = len(values), ["pose"], []
    held = np.zeros(n_rows, dtype=bool)
    if n_rows > 2 and drawn.chance(0.4):
        held = drawn.rng.random(n_rows) < 0.3
        held[0] = False
        names.append("use")
    for k, (name, unit, _) in enumerate(drawn.channels):
        units = COLUMNS.get(unit, {unit: 1.0})
        one = drawn.pick(*units)
        names.append(f"{name}_{one}")
        columns.append(values[:, k] * units[one])
    lines = [",".join(names)]
    for row in range(n_rows):
        use = [["calibration", "verification"][int(held[row])]] if "use" in names else []
        cells = ["" if np.isnan(one[row]) else f"{one[row]:.9g}" for one in columns]
        lines.append(",".join([f"P{row + 1}", *use, *cells]))
    return "\n".join(lines) + "\n"


def draw_study(drawn: Drawn, noise: dict[str, float], n_rows: int, has_gaps: bool) -> dict[str, Any]:
    """Return a study of little effort: sensors, tolerances, model error, one to three variants."""
    sensors, data = {}, {"file": "readings.csv"}
    for name, unit, external in drawn.channels:
        keys = NOISE_KEYS.get(unit, OTHER)
        key = drawn.pick(*keys)
        zero = drawn.chance(0.02) and not external
        sensors[name] = {key: 0.0 if zero else round_off(noise[name] * keys[key], 1)}
    own = [name for name, _, external in drawn.channels if not external]
    if len(own) == len(drawn.coordinates) > 0 and not has_gaps and drawn.chance(0.3):
        data["commanded_channels"] = own
    parameters = {}
    for name, (_, unit, sd) in drawn.blocks.items():
        width = round_off(DEGREES * sd if unit == "rad" else sd)
        parameters[name] = drawn.pick({"prior": "normal", "sd": width}, {"prior": "uniform", "half_width": 3.0 * width})
    variants: list[dict[str, Any]] = [{"name": "all"}]
    if len(parameters) > 1 and drawn.chance(0.4):
        variants.append({"name": "fewer", "free": list(parameters)[: len(parameters) // 2]})
    if drawn.chance(0.2):
        variants.append({"name": "wrong_rows", **drawn.pick({"student_t_dof": 4.0}, {"outlier_fraction": 0.1})})
    if drawn.chance(0.2):
        variants.append({"name": "right", "model_error": []})
    study = {
        "kind": "study",
        "name": "drawn",
        "title": "A machine that was drawn",
        "seed": 1,
        "machine": "machine.toml",
        "provenance": {"status": "simulated", "text": "drawn"},
        "data": [data],
        "sensors": sensors,
        "parameters": parameters,
        "variants": variants,
        **EFFORT,
    }
    terms = drawn.pick(*TERMS) if own and drawn.coordinates and n_rows > 5 else drawn.pick(None, [])
    if terms is not None:
        study["model_error"] = {"terms": terms}
    if n_rows > 3 and drawn.chance(0.2):
        study["validation"] = {"folds": 2, "draws": 100}
    if drawn.chance(0.2):
        study["sensitivity"] = {"prior_width_factors": [0.5, 1.0, 2.0]}
    return study


def write_project(number: int, folder: Path) -> str:
    """Write the files of a drawn project to a folder; return what is special of it."""
    files, said = draw_project(number)
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    return said
