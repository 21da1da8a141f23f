"""Everything the report shows, computed from the results; the template only sets it on the page."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass

from bayescal.report import parameter_tables, sections
from bayescal.report.blocks import Column, FigureBlock, Statement, Table, make_table
from bayescal.report.numbers import NOTHING, format_fixed
from bayescal.report.results import Results, get_number
from bayescal.report.verdict import list_failures, state_headline, state_verdict

NOTATION = (
    ("a", "joint of a leg's actuator on the base, base frame", "section 2.2"),
    ("b", "joint of a leg on the platform, platform frame", "section 2.2"),
    ("u", "direction of an actuator, a unit vector", "eq. 5"),
    ("l", "length of a leg", "eqs. 5, 7, 30"),
    ("rho", "position of an actuator; Δρ its displacement from the initial position", "eqs. 5, 7"),
    ("rho0", "initial position of an actuator", "eq. 9"),
    (
        "kappa",
        "deflection of a platform joint per displacement: of its own actuator (linear), the diagonal of K (matrix)",
        "eq. 1",
    ),
    ("K", "deflection of all platform joints per displacement of all actuators", "eqs. 2 to 4"),
    ("tau", "model error: standard deviation of what the model leaves unexplained along a leg; not in RR-8096", ""),
)
PUBLISHED_REMARK = (
    "Published values differ from the posteriors by construction: they come from least squares with all poses "
    "weighted alike, without tolerances and without model error, on the data of the publication. The posteriors "
    "weigh every pose by its covariance, use the tolerances as priors and leave room for a model error. These data: "
    "{origin}. A published value outside an interval contradicts nothing, unless the data were made from that very "
    "table."
)


@dataclass(frozen=True)
class ReportContext:
    """What the template needs, all of it text."""

    title: str
    experiment: str
    data_origin: str
    headline: str
    failures: tuple[Statement, ...]
    verdict: tuple[Statement, ...]
    rankings: tuple[Table, ...]
    coverage: Table
    contraction: Table
    parameter_tables: tuple[Table, ...]
    published_remark: str
    ridges: Table | None
    ridge_statements: tuple[Statement, ...]
    deformation: tuple[Table, ...]
    deformation_statements: tuple[Statement, ...]
    model_error: Table | None
    model_error_statements: tuple[Statement, ...]
    evidence: Table
    sensitivity: Table
    diagnostics: Table
    data: Table
    notation: Table
    provenance: Table
    versions: Table
    files: Table
    config: str
    figures: dict[str, FigureBlock]


def build_context(results: Results, figures: Mapping[str, FigureBlock]) -> ReportContext:
    """Compute what the report shows.

    Parameters
    ----------
    results : Results
    figures : mapping of str to FigureBlock
        The figures drawn, and those left out with the reason.
    """
    summary = results.summary
    deformation, deformation_statements = sections.tabulate_deformation(results)
    model_error, model_error_statements = sections.tabulate_model_error(results)
    has_published = bool(results.least_squares["published_offset"].notna().any())
    return ReportContext(
        title=summary["title"],
        experiment=summary["experiment"],
        data_origin=summary["data_origin"],
        headline=state_headline(results),
        failures=tuple(list_failures(results)),
        verdict=tuple(state_verdict(results)),
        rankings=tuple(sections.tabulate_ranking(results, setting) for setting in ("free", "zero")),
        coverage=sections.tabulate_coverage(results),
        contraction=parameter_tables.tabulate_contraction(results),
        parameter_tables=tuple(parameter_tables.tabulate_parameters(results, name) for name in results.ranking),
        published_remark=PUBLISHED_REMARK.format(origin=summary["data_origin"].rstrip(".")) if has_published else "",
        ridges=parameter_tables.tabulate_ridges(results),
        ridge_statements=tuple(parameter_tables.state_ridges(results)),
        deformation=tuple(deformation),
        deformation_statements=tuple(deformation_statements),
        model_error=model_error,
        model_error_statements=tuple(model_error_statements),
        evidence=sections.tabulate_evidence(results),
        sensitivity=sections.tabulate_sensitivity(results),
        diagnostics=sections.tabulate_diagnostics(results),
        data=tabulate_data(results),
        notation=tabulate_notation(),
        provenance=tabulate_provenance(results),
        versions=_tabulate_mapping(results.provenance.get("versions"), "Versions.", "Package", "Version"),
        files=_tabulate_mapping(results.provenance.get("files"), "Input files.", "File", "SHA-256"),
        config=json.dumps(results.provenance.get("config", {}), indent=2, ensure_ascii=False),
        figures=dict(figures),
    )


def tabulate_data(results: Results) -> Table:
    """Return what was measured and how the poses were extracted."""
    summary = results.summary
    extraction = summary["pose_extraction"]
    rejected = [str(target) for target in extraction["rejected_targets"]]
    listed = ", ".join(rejected[:20]) + (" …" if len(rejected) > 20 else "")
    rows = [
        ["Origin", summary["data_origin"]],
        ["Calibration poses", str(summary["n_poses"]["calibration"])],
        ["Verification poses", str(summary["n_poses"]["verification"]) if results.n_verification else "none"],
        ["Pose extraction", extraction["method"]],
        ["χ² per degree of freedom of the rigid fits", format_fixed(get_number(extraction, "chi2_per_dof"), 3)],
        ["Rejected targets", f"{len(rejected)}: {listed}" if rejected else "none"],
    ]
    note = (
        "χ² per degree of freedom is 1 where the targets scatter about the fitted bodies as their stated noise says; "
        "well above 1 the bodies deform or the noise is larger, well below 1 the noise is smaller than stated."
    )
    columns = [Column("", kind="text"), Column("", kind="text")]
    return make_table("Measurements.", columns, rows, [Statement(note)])


def tabulate_notation() -> Table:
    """Return the symbols and where RR-8096 defines them."""
    columns = [Column("Symbol", kind="symbol"), Column("Meaning", kind="text"), Column("RR-8096", kind="text")]
    rows = [[symbol, meaning, where or NOTHING] for symbol, meaning, where in NOTATION]
    return make_table(
        "Notation; subscripts x, y, z are components, a leg's number stands in the column's heading.", columns, rows
    )


def tabulate_provenance(results: Results) -> Table:
    """Return what identifies the run."""
    provenance = results.provenance
    rows = [
        ["Experiment", results.summary["experiment"]],
        ["SHA-256 of config and inputs", results.summary["config_sha256"]],
        ["Seed", str(results.summary["seed"])],
        ["Python", str(provenance.get("python", NOTHING))],
        ["Platform", str(provenance.get("platform", NOTHING))],
    ]
    return make_table("Run.", [Column("", kind="text"), Column("", kind="text")], rows)


def _tabulate_mapping(content: object, caption: str, key: str, value: str) -> Table:
    rows = [[str(k), str(v)] for k, v in content.items()] if isinstance(content, dict) else []
    return make_table(caption, [Column(key, kind="name"), Column(value, kind="name")], rows)
