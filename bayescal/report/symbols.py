"""Symbols and units of parameters as the report writes them, in tables, text and figures."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

from bayescal.report.numbers import MICROMETRES, PER_MILLE, format_fixed, format_significant

MODEL_ERROR = "tau"
PER_NOISE_UM = 10.0
"""What one standard deviation of the noise counts as a size of a model error where the tool has no lengths, µm."""
NAMES = {"1": "", "noise": "× noise"}
"""Units of results that are written otherwise."""
KERNEL_SCALE = "sigma_g"
KERNEL_LENGTH = "L_g"
OF_FUNCTIONS = (KERNEL_SCALE, KERNEL_LENGTH, "sigma_linear", "sigma_positioning", "sigma_smooth", "sigma_drift")
GREEK = {
    **{"alpha": "α", "beta": "β", "eta": "η", "kappa": "κ", "xi": "ξ"},
    **{"rho": "ρ", "tau": "τ", "phi": "φ", "psi": "ψ", "sigma": "σ"},
}
SYMBOL = re.compile(r"([A-Za-z]+)([0-9]{0,2})(?:_([A-Za-z0-9]+))?")
"""Letters, a number and a subscript."""
ACTUATOR_ZERO = "rho0"
"""The one symbol with a superscript, as papers on legs write it; ``s0`` of an own machine would be read as a power."""

INNER = {"mm": "length", "rad": "angle"}
SHOWN = {
    "um": (1e3, "µm"),
    "mm": (1.0, "mm"),
    "m": (1e-3, "m"),
    "arcsec": (3600.0 * math.degrees(1.0), "arcsec"),
    "mrad": (1e3, "mrad"),
    "deg": (math.degrees(1.0), "°"),
    "rad": (1.0, "rad"),
}
"""Factor and name of the units that a config may name, which inside are mm or rad."""
PLACES = {"mm": 0, "um": 0, "arcsec": 0, "deg": 1, "mrad": 1}
"""Decimals of coordinates that say where to measure."""

LONGEST_NAME, LONGEST_TEXT = 48, 160
"""Letters of a name beside others in a figure, at a tick or in a legend, and of any other text of it."""

type ChosenUnits = Mapping[str, str] | None
"""The units of a config, ``length`` and ``angle``; None for mm and degrees."""

USUAL = {"length": "mm", "angle": "deg"}


def split_name(name: str) -> tuple[str, int]:
    """Return symbol and leg of a parameter's name: ``a_x[3]`` is ``a_x`` of leg 3, ``k`` is ``k`` of leg 0."""
    found = re.fullmatch(r"(.+)\[(\d+)\]", name)
    return (found[1], int(found[2])) if found else (name, 0)


def is_model_error(symbol: str) -> bool:
    """Whether a symbol is a model error τ, or scale or length of one that repeats: no parameters of the machine."""
    return symbol in (MODEL_ERROR, *OF_FUNCTIONS)


def split_symbol(symbol: str) -> tuple[str, str, str]:
    """Return head, subscript and superscript of a parameter's symbol: ``rho0`` is ρ⁰, ``k1_d`` is k with 1d below."""
    if symbol == ACTUATOR_ZERO:
        return GREEK["rho"], "", "0"
    found = SYMBOL.fullmatch(symbol)
    if not found:
        return symbol, "", ""
    return GREEK.get(found[1], found[1]), f"{found[2]}{found[3] or ''}", ""


_AS_IT_IS = r"(?:[^$\\]|\\.)*"
OWN_MATHEMATICS = re.compile(rf"{_AS_IT_IS}(?:\$Δ?[^\W_]+(?:_\{{[\w,]+\}})?(?:\^\{{\w+\}})?\${_AS_IT_IS})*", re.DOTALL)
"""A text whose mathematics, if any, `set_mathematics` has written."""


def quote(text: str) -> str:
    """Return text that matplotlib sets as it stands."""
    return text.replace("\\", "").replace("$", r"\$")


def make_label(text: str, most: int) -> str:
    """Return a text of a figure, cut at so many letters, without mathematics that is not our own."""
    text = cut(text, most)
    return text if OWN_MATHEMATICS.fullmatch(text) else quote(text)


def cut(text: str, most: int) -> str:
    """Return a text of at most so many letters."""
    return text if len(text) <= most else f"{text[: most - 1]}…"


def set_mathematics(symbol: str, before: str = "", leg: int = 0) -> str:
    """Return a symbol as mathematical text for figures, ``before`` put in front of it and a leg, if one, below."""
    head, below, above = split_symbol(symbol)
    if not re.fullmatch(r"[^\W_]+", head):
        return f"{before}{quote(symbol)}{f'[{leg}]' if leg else ''}"
    marks = ",".join(part for part in (below, str(leg) if leg else "") if part)
    return f"${before}{head}{f'_{{{marks}}}' if marks else ''}{f'^{{{above}}}' if above else ''}$"


def set_parameter(name: str) -> str:
    """Return a parameter as mathematical text for figures."""
    symbol, leg = split_name(name)
    return set_mathematics(symbol, leg=leg)


def write_symbol(symbol: str) -> str:
    """Return a symbol in running text: as it was written, Greek letters as such."""
    found = SYMBOL.fullmatch(symbol)
    return symbol if found is None else GREEK.get(found[1], found[1]) + symbol[found.end(1) :]


def name_parameter(name: str, member: str = "leg") -> str:
    """Return a parameter's name in words, ``a_x of leg 3``, or of what else its index counts."""
    symbol, leg = split_name(name)
    written = write_symbol(symbol)
    return f"{written} of {member} {leg}" if leg else written


def scale_of(symbol: str, unit: str, asked: ChosenUnits = None) -> tuple[float, str]:
    """Return the factor and the unit in which a parameter's offsets are shown, with the units of a config."""
    if is_model_error(symbol) and symbol != KERNEL_LENGTH:
        return (1.0, write_unit(unit)) if unit == "noise" else (MICROMETRES, "µm")
    return (PER_MILLE, "10⁻³") if unit == "1" else shown_in(unit, asked)


def choose_error_unit(of: object) -> tuple[float, str]:
    """Return factor and name of the unit of a model error's sizes in µm, by what results say that they are of.

    Where the tool has no lengths they are multiples of the noise.
    """
    return (1.0 / PER_NOISE_UM, write_unit("noise")) if of == "noise" else (1.0, "µm")


def describe_deformation(deformation: str) -> str:
    """Return a deformation after the name of a model: ``with the matrix deformation``."""
    return "without deformation" if deformation == "none" else f"with the {deformation} deformation"


def shown_in(unit: str, asked: ChosenUnits = None) -> tuple[float, str]:
    """Return factor and name of the unit that values of an inner unit are shown in."""
    if unit in INNER:
        return SHOWN[(asked or USUAL)[INNER[unit]]]
    return 1.0, write_unit(unit)


def write_unit(unit: str) -> str:
    """Return a unit as results write it beside a number; empty for none."""
    return NAMES.get(unit, unit)


def format_amount(value: float, unit: str, digits: int = 2, asked: ChosenUnits = None) -> str:
    """Return a value of an inner unit with the unit it is shown in."""
    factor, name = shown_in(unit, asked)
    return f"{format_significant(factor * value, digits)} {name}".rstrip().replace(" °", "°")


def format_place(column: str, value: float, asked: ChosenUnits = None) -> str:
    """Return a coordinate of a column such as ``x_mm`` in the unit that places are shown in."""
    unit = column.rpartition("_")[2]
    if unit not in INNER:
        return format_fixed(value, 3)
    return format_fixed(shown_in(unit, asked)[0] * value, PLACES.get((asked or USUAL)[INNER[unit]], 3))


def name_unit(column: str, asked: ChosenUnits = None) -> str:
    """Return the unit of a column such as ``x_mm`` as places are shown."""
    unit = column.rpartition("_")[2]
    return shown_in(unit, asked)[1] if unit in INNER else unit
