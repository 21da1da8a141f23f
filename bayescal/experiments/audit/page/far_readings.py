"""The advice to put the actuators' zero where they read, where a ridge ties their places and directions."""

from __future__ import annotations

from bayescal.experiments.audit.page.results import AuditResults
from bayescal.report.blocks import Statement
from bayescal.report.numbers import format_fixed, format_significant, join_words


def state_far_readings(results: AuditResults) -> list[Statement]:
    """Say how far from zero the actuators read, and what a direction's tolerance comes to there."""
    found = results.summary.get("far_readings")
    if found is None:
        return []
    reading, turned = float(found["reading_mm"]), float(found["direction_sd"])
    legs = [str(leg) for leg in found["legs"]]
    moved = ""
    if turned > 0.0:
        mrad, mm = format_significant(1e3 * turned, 2), format_significant(abs(reading) * turned, 2)
        moved = f" (a tolerance of {mrad} mrad is {mm} mm there)"
    text = (
        f"Of leg{'s' if len(legs) > 1 else ''} {join_words(legs)} the joint's place and the actuator's direction are "
        f"hardly told apart: readings lie around {format_fixed(reading, 0)} mm from where the direction's tolerance "
        f"turns it{moved}; put the zero there, with base points and readings counted from it."
    )
    return [Statement(text, "plain", "Actuators' zero")]
