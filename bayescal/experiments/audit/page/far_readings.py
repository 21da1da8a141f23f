"""The advice to put the actuators' zero where they read, where a ridge ties their places and directions."""

from __future__ import annotations

from bayescal.experiments.audit.page.results import AuditResults
from bayescal.report.blocks import Statement
from bayescal.report.numbers import join_words
from bayescal.report.symbols import format_amount, format_place, name_unit


def state_far_readings(results: AuditResults) -> list[Statement]:
    """Say how far from zero the actuators read, and what a direction's tolerance comes to there."""
    found = results.summary.get("far_readings")
    if found is None:
        return []
    reading, turned = float(found["reading_mm"]), float(found["direction_sd"])
    legs = [str(leg) for leg in found["legs"]]
    moved, asked = "", results.summary["units"]
    place = f"{format_place('x_mm', reading, asked)} {name_unit('x_mm', asked)}"
    if turned > 0.0:
        angle, length = format_amount(turned, "rad", 2, asked), format_amount(abs(reading) * turned, "mm", 2, asked)
        moved = f" (a tolerance of {angle} is {length} there)"
    text = (
        f"Of leg{'s' if len(legs) > 1 else ''} {join_words(legs)} the joint's place and the actuator's direction are "
        f"hardly distinguishable: readings lie around {place} from where the direction's tolerance "
        f"turns it{moved}; put the zero there, with base points and readings counted from it."
    )
    return [Statement(text, "plain", "Actuators' zero")]
