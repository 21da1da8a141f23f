"""Everything the report shows, computed from the results; the template only sets it on the page."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass

from bayescal.experiments.study.page import claims, notation, parameter_tables, published, sections
from bayescal.experiments.study.page.checks import list_failures, title_failures
from bayescal.experiments.study.page.results import Results, get_number
from bayescal.experiments.study.page.variants import is_on_struts
from bayescal.experiments.study.page.verdict import state_headline, state_verdict
from bayescal.report.blocks import Cell, Column, FigureBlock, Fold, Statement, Table, make_table
from bayescal.report.numbers import NOTHING, format_fixed


@dataclass(frozen=True)
class ReportContext:
    """What the template needs, all of it text."""

    title: str
    experiment: str
    data_origin: str
    headline: str
    failures: tuple[Statement, ...]
    failures_title: str
    verdict: tuple[Statement, ...]
    claim_counts: tuple[tuple[str, tuple[Cell, ...]], ...]
    claims: tuple[Table, ...]
    rankings: tuple[Table, ...]
    effects: Table | None
    error_figures: tuple[str, ...]
    coverage: Table
    contraction: Table
    published: Table | None
    published_remark: str
    agreement: tuple[Statement, ...]
    parameter_groups: tuple[tuple[str, tuple[Fold, ...]], ...]
    ridges: Table | None
    ridge_statements: tuple[Statement, ...]
    has_deformation: bool
    deformation: tuple[Table, ...]
    deformation_statements: tuple[Statement, ...]
    model_error: Table | None
    model_error_statements: tuple[Statement, ...]
    evidence: Table
    sensitivity: Table
    diagnostics: Table
    data: Table
    notation: Table
    notation_sources: str
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
    remark = published.REMARK.format(origin=summary["data_origin"].rstrip("."))
    return ReportContext(
        title=summary["title"],
        experiment=summary["experiment"],
        data_origin=summary["data_origin"],
        headline=state_headline(results),
        failures=tuple(list_failures(results)),
        failures_title=title_failures(results),
        verdict=tuple(state_verdict(results)),
        claim_counts=tuple(claims.list_counts(results)),
        claims=tuple(claims.tabulate_claims(results)),
        rankings=tuple(sections.tabulate_ranking(results, setting) for setting in ("free", "zero")),
        effects=sections.tabulate_effects(results),
        error_figures=tuple(name for name, block in figures.items() if block.section == "errors"),
        coverage=sections.tabulate_coverage(results),
        contraction=parameter_tables.tabulate_contraction(results),
        published=published.tabulate_published(results),
        published_remark=remark if published.has_published(results) else "",
        agreement=tuple(parameter_tables.state_agreement(results)),
        parameter_groups=tuple((title, tuple(folds)) for title, folds in parameter_tables.fold_parameters(results)),
        ridges=parameter_tables.tabulate_ridges(results),
        ridge_statements=tuple(parameter_tables.state_ridges(results)),
        has_deformation=results.ring is not None or not is_on_struts(results),
        deformation=tuple(deformation),
        deformation_statements=tuple(deformation_statements),
        model_error=model_error,
        model_error_statements=tuple(model_error_statements),
        evidence=sections.tabulate_evidence(results),
        sensitivity=sections.tabulate_sensitivity(results),
        diagnostics=sections.tabulate_diagnostics(results),
        data=tabulate_data(results),
        notation=notation.tabulate_notation(results),
        notation_sources=notation.name_sources(results),
        provenance=tabulate_provenance(results),
        versions=_tabulate_mapping(results.provenance.get("versions"), "Versions.", "Package", "Version"),
        files=_tabulate_mapping(results.provenance.get("files"), "Input files.", "File", "SHA-256"),
        config=format_config(results.provenance.get("config", {})),
        figures=dict(figures),
    )


def format_config(value: object, indent: str = "") -> str:
    """Return JSON, indented; what holds no lists or objects stands on one line."""
    inner = f"{indent}  "
    if isinstance(value, dict) and any(isinstance(one, dict | list) for one in value.values()):
        lines = [f"{inner}{json.dumps(key)}: {format_config(one, inner)}" for key, one in value.items()]
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if isinstance(value, list) and any(isinstance(one, dict | list) for one in value):
        lines = [f"{inner}{format_config(one, inner)}" for one in value]
        return "[\n" + ",\n".join(lines) + f"\n{indent}]"
    return json.dumps(value, ensure_ascii=False)


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
