"""How an audit was computed, in words, and what was audited."""

from __future__ import annotations

from bayescal.experiments.audit.page.results import AuditResults
from bayescal.experiments.audit.page.wording import count, format_sd, name_unit
from bayescal.report.blocks import Table, make_pairs
from bayescal.report.numbers import format_fixed, format_plain


def describe_method(results: AuditResults) -> tuple[tuple[str, str], ...]:
    """Return questions with the answers that the computation gives to them."""
    kind = "calibration" if results.is_measured else "planned"
    return (
        (
            "Can it be determined at all?",
            "The rank of the noise-free identification Jacobian J over a workspace far wider than the machine's, its "
            "columns in units of the tolerances, is counted at the gap of its singular values beside the level to "
            "which rounding moves them (computed again at machines that differ in the last digits).",
        ),
        (
            "Do these measurements determine it?",
            f"With the noise of sensors and actuators the {kind} poses carry the information Λ = Jᵀ Σ⁻¹ J; in units of "
            "the tolerances the posterior covariance is (1 + Λ)⁻¹ to first order, the contraction of a direction v is "
            "1 − vᵀ (1 + Λ)⁻¹ v, and −½ log(1 − contraction) nats are learnt of it.",
        ),
        (
            "Does it matter, and does it hold beyond first order?",
            "Ridges are followed with the machine itself, not with its derivatives; requirements are judged by draws "
            "of the remaining uncertainty over the workspace; and where they were asked for, profile likelihoods, "
            "draws of the posterior and simulated calibrations check the linear picture.",
        ),
    )


def tabulate_audit(results: AuditResults) -> Table:
    """Return what was audited: units, rank, what is learnt, directions, workspace."""
    summary, units = results.summary, results.summary["units"]
    gap = summary.get("structural_gap")
    rank = f"{summary['structural_rank']} of {summary['n_parameters']}"
    clear = "clear" if summary["structural_rank_is_clear"] else "NOT clear"
    rows = [
        ["Audit", summary["name"]],
        ["Units of tolerances, results and requirements", f"{name_unit(units['length'])}, {name_unit(units['angle'])}"],
        ["Structural rank", f"{rank}, {clear}{f', gap {format_sd(gap)}' if gap is not None else ''}"],
        ["Learnt in all", f"{format_fixed(summary['total_nats'], 1)} nat"],
        ["Directions", _describe_directions(results)],
        ["Workspace", _describe_workspace(results)],
    ]
    return make_pairs("The audit.", rows)


def _describe_directions(results: AuditResults) -> str:
    counts = [(results.summary[f"n_{kind}"], kind) for kind in ("structural", "practical", "informed")]
    return ", ".join(f"{number} {kind}" for number, kind in counts)


def _describe_workspace(results: AuditResults) -> str:
    workspace = results.summary["plan"].get("workspace")
    if not isinstance(workspace, dict):
        return "none stated"
    position, rotation = (
        " × ".join(f"±{format_plain(float(value))}" for value in workspace.get(key, []))
        for key in ("position_mm", "rotation_deg")
    )
    return (
        f"{position} mm, {rotation} deg, {workspace.get('shape', '')}, {count(int(workspace.get('poses', 0)), 'pose')}"
    )
