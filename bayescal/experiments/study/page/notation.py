"""The report's symbols, each with its meaning for the machine at hand and where it is defined."""

from __future__ import annotations

from bayescal.experiments.study.page.results import Results
from bayescal.experiments.study.page.variants import is_on_struts, list_deformations
from bayescal.report.blocks import Column, Table, make_table
from bayescal.report.numbers import NOTHING

type Row = tuple[str, str, str]

KAPPA: Row = (
    "kappa",
    "deflection of a platform joint per displacement: of its own actuator (linear), the diagonal of K (matrix)",
    "eq. 1",
)
MATRIX: Row = ("K", "deflection of all platform joints per displacement of all actuators", "eqs. 2 to 4")
TAU: Row = (
    "tau",
    "model error: standard deviation of what the model leaves unexplained along a leg; not in RR-8096",
    "",
)
NOTATION: tuple[Row, ...] = (
    ("a", "joint of a leg's actuator on the base, base frame", "section 2.2"),
    ("b", "joint of a leg on the platform, platform frame", "section 2.2"),
    ("u", "direction of an actuator, a unit vector", "eq. 5"),
    ("l", "length of a leg; of a strut, at the initial position of its actuator", "eqs. 5, 7, 30"),
    ("rho", "position of an actuator; Δρ its displacement from the initial position", "eqs. 5, 7"),
    ("rho0", "initial position of an actuator", "eq. 9"),
    KAPPA,
    MATRIX,
    TAU,
)
STRUTS: tuple[Row, ...] = (
    ("a", "joint of a strut on the base, base frame", "Yu 2023 eq. 1, there b"),
    ("b", "joint of a strut on the platform, platform frame", "Yu 2023 eq. 1, there a"),
    ("l", "length of a strut at the initial position of its actuator", "Yu 2023 eq. 3, there h"),
    ("rho", "position of an actuator; Δρ, its displacement from the initial position, lengthens the strut", ""),
)
RR_8096 = "Equations and sections are those of the INRIA research report RR-8096 (Gayral and Daney, 2012)."
YU_2023 = (
    "Yu 2023: Z. Yu, X. Wu and F. Wang, Kinematic Calibration Method for Six-Hardpoint Positioning Mechanisms Using "
    "Optimal Measurement Pose, Appl. Sci. 13 (2023) 4824."
)
RR_8096_DEFORMATION = " RR-8096: the INRIA research report of Gayral and Daney (2012)."


def list_symbols(results: Results) -> tuple[Row, ...]:
    """Return symbol, meaning and source of what a study's machine has; of struts only what is theirs."""
    if not is_on_struts(results):
        return NOTATION
    deformed = [(KAPPA, {"linear", "matrix"}), (MATRIX, {"matrix"})]
    there = set(list_deformations(results)) | ({"matrix"} if results.ring is not None else set())
    rows = tuple((row[0], row[1], f"RR-8096 {row[2]}") for row, kinds in deformed if kinds & there)
    tau = (TAU[0], TAU[1].replace("a leg; not in RR-8096", "a strut"), "")
    return (*STRUTS, *rows, tau)


def tabulate_notation(results: Results) -> Table:
    """Return the symbols and where they are defined."""
    source = "Defined in" if is_on_struts(results) else "RR-8096"
    columns = [Column("Symbol", kind="symbol"), Column("Meaning", kind="text"), Column(source, kind="text")]
    rows = [[symbol, meaning, where or NOTHING] for symbol, meaning, where in list_symbols(results)]
    return make_table(
        "Notation; subscripts x, y, z are components, a leg's number stands in the column's heading.", columns, rows
    )


def name_sources(results: Results) -> str:
    """Return in words what the table of symbols refers to."""
    if not is_on_struts(results):
        return RR_8096
    cited = any(where.startswith("RR-8096") for _, _, where in list_symbols(results))
    return YU_2023 + RR_8096_DEFORMATION * cited
