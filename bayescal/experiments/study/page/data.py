"""What was measured and what symbols mean, and what others state of the same machine: claims, and values of others."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import pandas as pd

from bayescal.experiments.runner.results import Summary
from bayescal.experiments.shared.knowledge_page import NO_TOOL, TOOL_ACTION
from bayescal.experiments.shared.origin import name_origin
from bayescal.experiments.shared.soundness import LEARNT
from bayescal.experiments.study.page.model_error import LEAD
from bayescal.experiments.study.page.results import StudyResults, get_number
from bayescal.experiments.study.rows import CLAIM_VERDICTS, ClaimRow, ParameterRow, ReferenceRow
from bayescal.report.blocks import (
    Block,
    Cell,
    Column,
    Counts,
    Level,
    PageSection,
    Statement,
    Table,
    make_pairs,
    make_table,
)
from bayescal.report.numbers import NO_VALUE, capitalise, format_estimate, format_fixed, format_significant, join_words

SHOWN_TARGETS = 20
INSTRUMENTS = {"poses": "poses", "points": "tracked points"}
TARGETS = "χ² / dof: 1 if the target noise is right."
POINTS = "χ² / dof: 1 if the point noise is right."

type Symbol = tuple[str, str]

KAPPA: Symbol = (
    "kappa",
    "platform joint deflection / actuator displacement",
)
MATRIX: Symbol = ("K", "platform joint deflections by actuators")
ERROR = "random model error along a {}, sd"
SYMBOLS: tuple[Symbol, ...] = (
    ("a", "base joint, base frame"),
    ("b", "platform joint, platform frame"),
    ("u", "actuator direction, unit vector"),
    ("l", "leg length"),
    ("rho", "actuator position; Δρ: displacement"),
    ("rho0", "initial actuator position"),
    KAPPA,
    MATRIX,
    ("tau", ERROR.format("leg")),
)
GAIN: Symbol = ("gain", "true travel / reading")
STRUTS: tuple[Symbol, ...] = (
    ("a", "base joint, base frame"),
    ("b", "platform joint, platform frame"),
    ("l", "initial strut length"),
    ("rho", "actuator position; Δρ lengthens the strut"),
)
FRAMES: tuple[Symbol, ...] = (
    ("base_x … base_rz", "instrument frame: displacement, rotation vector"),
    ("tool_x … tool_rz", "probe frame: displacement, rotation vector"),
)
NOTATION = "Notation."
LEVELS: dict[str, Level] = dict(zip(CLAIM_VERDICTS, ("good", "bad", "plain"), strict=True))
PLURAL = {"holds": "hold", "does not hold": "do not hold", "not testable": "are not testable"}
OWN = "own"  # section of findings that the publication does not state
CLAIMS = "Open a claim for its test."


UNKNOWN = {"noise_factor": "Noise", "model_error": "Model error"}
"""What parameters of readings are called of which data may say nothing."""


def is_learnt(row: ParameterRow) -> bool:
    """Whether the data determine a parameter: its variance is at most half of that of its prior."""
    return not row.contraction < LEARNT


# --- what was measured -----------------------------------------------------------------------------------------------


def state_data(study: StudyResults) -> list[Statement]:
    """Return what is missing or not used of readings, machine and model error, and how noise was found."""
    found, summary = list[Statement](), study.summary
    if not summary.get("states_tool", True):
        found.append(Statement(NO_TOOL, "warning", "Tool", action=TOOL_ACTION))
    keys: dict[str, tuple[Level, str]] = {"found": ("plain", "Frames"), "unused": ("warning", "Data")}
    for key, (level, lead) in (keys | {"missing_terms": ("plain", LEAD)}).items():
        if key in summary:
            text, several = str(summary[key]), str(summary[key]).count("; ") + 1
            if key == "found" and several > 1:  # their values are what `validate` says, and the page's parameters
                text = f"what is not stated of {several} instruments is estimated with wide priors"
            found.append(Statement(f"{capitalise(text).rstrip('.')}.", level, lead))
    fit = study.fit(study.chosen)
    n, m = get_number(fit, "n_equations"), fit["n_parameters"]
    if n < m:
        text = f"{n:.0f} equations for {m} unknowns: prior-dominated."
        found.append(Statement(text, "warning", "Data", value=n, limit=m))
    for row in study.rows(ParameterRow, study.chosen):
        kind, _, what = row.parameter.rstrip(")").partition("(")
        factor, unit = study.shown_in(row.unit)
        amount, mean = format_estimate(factor * row.mean, factor * row.sd), factor * row.mean
        if kind in UNKNOWN and not is_learnt(row):
            found.append(Statement(f"{UNKNOWN[kind]} of {what}: not determined.", lead="Noise"))
        elif kind == "noise_factor":
            text = f"Noise of {what}: {amount} times the stated one."
            found.append(Statement(text, lead="Noise", value=mean, limit=1.0))
        elif kind == "model_error":
            found.append(Statement(f"Model error of {what}: {amount} {unit}.", lead=LEAD, value=mean, unit=unit))
    return found


def show_data(study: StudyResults) -> PageSection | None:
    """Return what was measured and how it became poses; None where the facts below the heading say it all."""
    summary, instrument = study.summary, study.instrument
    if "pose_extraction" not in summary and instrument is None:
        return None
    rows = [
        ["Origin", name_origin(summary["origin"])],
        ["Calibration poses", str(summary["n_poses"]["calibration"])],
        ["Verification poses", str(summary["n_poses"]["verification"]) if study.n_verification else "none"],
    ]
    notes = []
    if instrument is None:
        extraction = summary["pose_extraction"]
        rejected = [str(target) for target in extraction["rejected_targets"]]
        rows += [
            ["Pose extraction", extraction["method"]],
            ["Rigid fits, χ² / dof", format_fixed(get_number(extraction, "chi2_per_dof"), 3)],
            ["Rejected targets", f"{len(rejected)}: {_shorten(rejected)}" if rejected else "none"],
        ]
        notes.append(Statement(TARGETS))
    else:
        rows += _list_readings(instrument, sum(summary["n_poses"].values()))
        notes += [Statement(POINTS)] if "points" in instrument else []
    return PageSection("Data", (make_pairs("Measurements.", rows, notes),), anchor="data")


def _list_readings(instrument: Summary, n_poses: int) -> list[list[str]]:
    """Return what an instrument read: coordinates of poses, or points by stations."""
    kind = str(instrument.get("instrument"))
    free = ", ".join(str(frame) for frame in instrument.get("free_frames", []))
    rows = [["Instrument", INSTRUMENTS.get(kind, kind)], ["Estimated frames", free or "none, all known"]]
    if "points" in instrument:
        rows += [
            ["Stations", _shorten([str(name) for name in instrument["stations"]])],
            ["Platform points", f"{len(instrument['points'])}: {_shorten(instrument['points'])}"],
            ["Points seen, missed", f"{instrument['n_seen']}, {instrument['n_missed']}"],
            ["Rigid fits, χ² / dof", format_fixed(get_number(instrument, "chi2_per_dof"), 3)],
        ]
    elif "measured_coordinates" in instrument:
        counts = instrument["measured_coordinates"]
        words = [name if n == n_poses else f"{name} ({n} of {n_poses})" for name, n in counts.items() if n]
        rows.append(["Coordinates measured", ", ".join(words)])
    return rows


def _shorten(names: list[str]) -> str:
    return ", ".join(map(str, names[:SHOWN_TARGETS])) + (" …" if len(names) > SHOWN_TARGETS else "")


# --- symbols ---------------------------------------------------------------------------------------------------------


def show_notation(study: StudyResults) -> PageSection | None:
    """Return the symbols of models of legs; of a publication, also where it defines them."""
    if "drive" not in study.summary:
        return None
    publication = study.publication
    columns = [Column("Symbol", kind="symbol"), Column("Meaning", kind="text")]
    rows = [[symbol, meaning] for symbol, meaning in list_symbols(study)]
    if publication is not None:
        columns.append(Column(publication["source"], kind="text"))
        rows = [[symbol, meaning, publication["notation"].get(symbol, NO_VALUE)] for symbol, meaning in rows]
    sources = () if publication is None else (publication["citation"],)
    return PageSection("Notation", (make_table(NOTATION, columns, rows), *sources), anchor="notation")


def list_symbols(study: StudyResults) -> tuple[Symbol, ...]:
    """Return symbol and meaning of what a study's machine has; of struts only what is theirs."""
    frames = FRAMES if len(study.frames) else ()
    if GAIN[0] in set(study.parameters["symbol"]):
        frames = (GAIN, *frames)
    if not study.has_struts:
        return (*SYMBOLS, *frames)
    there = {*study.deformations, *(["matrix"] if study.has("joint_deflection") else [])}
    deformed = [(KAPPA, {"linear", "matrix"}), (MATRIX, {"matrix"})]
    own = (symbol for symbol, kinds in deformed if kinds & there)
    return (*STRUTS, *own, ("tau", ERROR.format("strut")), *frames)


# --- claims of a publication -----------------------------------------------------------------------------------------


def list_counts(study: StudyResults) -> list[tuple[str, tuple[Cell, ...]]]:
    """Return how many claims have each verdict, as marks: those of the publication, and findings of the project."""
    if not study.has("claims"):
        return []
    claims = study.table("claims")
    own = claims["section"] == OWN
    counted = [("Publication", claims[~own]), ("Beyond it", claims[own])]
    return [(title, tuple(_count(rows))) for title, rows in counted if len(rows)]


def _count(claims: pd.DataFrame) -> list[Cell]:
    counts = {verdict: int((claims["verdict"] == verdict).sum()) for verdict in LEVELS}
    return [
        Cell(f"{n} {verdict if n == 1 else PLURAL[verdict]}", LEVELS[verdict], badge=True)
        for verdict, n in counts.items()
        if n
    ]


def state_claims(study: StudyResults) -> list[Statement]:
    """Return how the publication's claims fared."""
    claims = study.table("claims")[study.table("claims")["section"] != OWN]
    if claims.empty:
        return []
    n = int((claims["verdict"] == "holds").sum())
    text = f"Claims of the publication: {join_words([cell.text for cell in _count(claims)])}."
    return [Statement(text, lead="Publication", value=n, limit=len(claims))]


def show_claims(study: StudyResults) -> PageSection | None:
    """Return the section of the claims, counted and one by one; None where the study tests none."""
    if not study.has("claims") or study.publication is None:
        return None
    blocks: list[Block] = [Counts(title, marks) for title, marks in list_counts(study)]
    blocks += [CLAIMS, tabulate_claims(study.table("claims"))]
    return PageSection(f"Claims of {study.publication['source']}", tuple(blocks), anchor="claims", short="Claims")


def tabulate_claims(claims: pd.DataFrame) -> Table:
    """Return the claims by the publication's sections in their order; other findings come last."""
    columns = [Column(title, kind="text") for title in ("Verdict", "Claim", "Expected", "Found")]
    rows: list[list[str | Cell]] = []
    headings = {}
    for section in sorted(dict.fromkeys(claims["section"]), key=_order):
        headings[len(rows)] = _title(section)
        rows += [_describe_claim(claim) for claim in ClaimRow.read(claims) if claim.section == section]
    return replace(make_table("Claims.", columns, rows, style="claims"), headings=headings)


def _order(section: str) -> tuple[bool, list[int], str]:
    return not section[:1].isdigit(), [int(number) for number in re.findall(r"\d+", section)], section


def _title(section: str) -> str:
    if section == OWN:
        return "Project findings"
    if not section[:1].isdigit():
        return section or "Without section"
    return f"{'Sections' if ',' in section else 'Section'} {section}"


def _describe_claim(claim: ClaimRow) -> list[str | Cell]:
    found = claim.found
    if not found and claim.value == claim.value:  # NaN where there is no number
        found = f"{format_significant(claim.value)} {'' if claim.unit == '1' else claim.unit}".strip()
    return [
        Cell(claim.verdict, LEVELS[claim.verdict], badge=True),
        Cell(claim.statement, more=f"{claim.reason} ({claim.claim})".strip()),
        claim.expected or NO_VALUE,
        found or NO_VALUE,
    ]


# --- values of others ------------------------------------------------------------------------------------------------


def _list_others(study: StudyResults) -> dict[str, list[ReferenceRow]]:
    """Return the rows of each source of values that stay out of the fit, by its title."""
    found: dict[str, list[ReferenceRow]] = {}
    for row in study.rows(ReferenceRow, study.chosen):
        found.setdefault(row.reference, []).append(row)
    return found


def _measure_distance(row: ReferenceRow) -> float:
    """Return how far a value lies from the posterior mean, in standard deviations of both; 0 where neither has any."""
    value_sd = row.value_sd if row.value_sd == row.value_sd else 0.0
    spread = math.hypot(row.sd, value_sd)
    return float((row.value - row.mean) / spread) if spread > 0.0 else 0.0


def state_comparison(study: StudyResults) -> list[Statement]:
    """Return how values of others, which stay out of the fit, compare with the posterior."""
    found = []
    for title, every in _list_others(study).items():
        unknown = {row.parameter for row in study.rows(ParameterRow, study.chosen) if not is_learnt(row)}
        rows = [row for row in every if row.quantity not in unknown]
        if not rows:
            found.append(Statement(f"“{title}”: none of these quantities is determined.", lead="Comparison"))
            continue
        worst = max(rows, key=lambda row: abs(_measure_distance(row)))
        near = sum(abs(_measure_distance(row)) <= 2.0 for row in rows)
        far = _measure_distance(worst)
        text = f"“{title}”: {near} of {len(rows)} values within 2 sd; farthest {worst.quantity} by "
        text += f"{format_fixed(far, 1, sign=True)} sd."
        found.append(Statement(text, lead="Comparison", value=far, limit=2.0, unit="sd"))
    return found


def show_comparison(study: StudyResults) -> PageSection | None:
    """Return the values of others with the posterior; None without any."""
    columns = [Column("Quantity", kind="text"), Column("Unit", kind="text"), Column("calibrated"), Column("other")]
    columns += [Column("Difference"), Column("in sd")]
    blocks: list[Block] = []
    for title, rows in _list_others(study).items():
        source = f" ({rows[0].source})" if rows[0].source else ""
        lines = [_compare(study, row) for row in rows]
        blocks.append(make_table(f"{title}{source}. Not part of the fit.", columns, lines))
    title = "Comparison"
    return PageSection(title, tuple(blocks), anchor="comparison", short="Comparison") if blocks else None


def _compare(study: StudyResults, row: ReferenceRow) -> list[str | Cell]:
    factor, unit = study.shown_in(row.unit)
    return [
        row.quantity,
        unit,
        format_estimate(factor * row.mean, factor * row.sd),
        format_significant(factor * row.value, 6),
        format_significant(factor * (row.value - row.mean)),
        format_fixed(_measure_distance(row), 1, sign=True),
    ]
