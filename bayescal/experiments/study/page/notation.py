"""The page's symbols, each with its meaning for the machine at hand."""

from __future__ import annotations

from bayescal.experiments.study.page.results import StudyResults
from bayescal.experiments.study.page.variants import list_deformations
from bayescal.report.blocks import Column, Section, make_table
from bayescal.report.numbers import NOTHING

type Symbol = tuple[str, str]

KAPPA: Symbol = (
    "kappa",
    "deflection of a platform joint per displacement: of its own actuator (linear), the diagonal of K (matrix)",
)
MATRIX: Symbol = ("K", "deflection of all platform joints per displacement of all actuators")
ERROR = "model error: standard deviation of what the model leaves unexplained along a {}"
SYMBOLS: tuple[Symbol, ...] = (
    ("a", "joint of a leg's actuator on the base, base frame"),
    ("b", "joint of a leg on the platform, platform frame"),
    ("u", "direction of an actuator, a unit vector"),
    ("l", "length of a leg; of a strut, at the initial position of its actuator"),
    ("rho", "position of an actuator; Δρ its displacement from the initial position"),
    ("rho0", "initial position of an actuator"),
    KAPPA,
    MATRIX,
    ("tau", ERROR.format("leg")),
)
STRUTS: tuple[Symbol, ...] = (
    ("a", "joint of a strut on the base, base frame"),
    ("b", "joint of a strut on the platform, platform frame"),
    ("l", "length of a strut at the initial position of its actuator"),
    ("rho", "position of an actuator; Δρ, its displacement from the initial position, lengthens the strut"),
)
FRAMES: tuple[Symbol, ...] = (
    ("base_x … base_rz", "frame of the instrument against the base: displacement and rotation vector"),
    ("tool_x … tool_rz", "frame of the probe against the platform: displacement and rotation vector"),
)
CAPTION = "Notation; subscripts x, y, z are components, a leg's number stands in the column's heading."


def show_notation(results: StudyResults) -> Section | None:
    """Return the symbols of a machine on legs; of a publication, also where it defines them."""
    if not results.has("pose_errors"):
        return None
    publication = results.publication
    columns = [Column("Symbol", kind="symbol"), Column("Meaning", kind="text")]
    rows = [[symbol, meaning] for symbol, meaning in list_symbols(results)]
    if publication is not None:
        columns.append(Column(publication.source, kind="text"))
        rows = [[symbol, meaning, publication.notation.get(symbol, NOTHING)] for symbol, meaning in rows]
    sources = () if publication is None else (publication.citation,)
    return Section("Notation", (make_table(CAPTION, columns, rows), *sources), anchor="notation")


def list_symbols(results: StudyResults) -> tuple[Symbol, ...]:
    """Return symbol and meaning of what a study's machine has; of struts only what is theirs."""
    return (*_list_machine(results), *(FRAMES if len(results.frames) else ()))


def _list_machine(results: StudyResults) -> tuple[Symbol, ...]:
    if not results.has_struts:
        return SYMBOLS
    there = {*list_deformations(results), *([] if not results.has("ring") else ["matrix"])}
    deformed = [(KAPPA, {"linear", "matrix"}), (MATRIX, {"matrix"})]
    return (*STRUTS, *(symbol for symbol, kinds in deformed if kinds & there), ("tau", ERROR.format("strut")))
