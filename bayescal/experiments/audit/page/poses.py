"""Which poses an audit rests on: planned ones, or those that were measured to calibrate with."""

from __future__ import annotations

from bayescal.experiments.audit.page.results import AuditResults
from bayescal.experiments.audit.page.wording import count
from bayescal.report.blocks import Statement


def count_poses(results: AuditResults) -> str:
    """Return how many poses there are, and how many measured ones are left out."""
    if not results.is_measured:
        return count(results.n_poses, "planned pose")
    held = results.summary["plan"].get("n_held_back", 0)
    left_out = f"; {held} held back {'is' if held == 1 else 'are'} left out" if held else ""
    return f"{count(results.n_poses, 'calibration pose')}{left_out}"


def state_poses(results: AuditResults) -> list[Statement]:
    """Say that measured poses are left out, where some are."""
    held = results.is_measured and results.summary["plan"].get("n_held_back", 0)
    return [Statement(f"{count_poses(results)}.", lead="Poses")] if held else []
