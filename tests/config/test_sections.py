"""What a section's fields are described by, for editors and the reference."""

from __future__ import annotations

import subprocess
import sys

from pydantic import Field

from bayescal.config.sections import Section, describe_fields

UNREAD = """
from bayescal.config.sections import Section, describe_fields
exec("class Made(Section):\\n    length_mm: float\\n    'Of the rod.'")
assert describe_fields(Made) == {}
assert Made.model_json_schema()["properties"]["length_mm"] == {"title": "Length Mm", "type": "number"}
"""


class Rod(Section):
    """A rod."""

    length_mm: float
    """Between the centres
    of its joints.
    """
    mass_kg: float = Field(default=1.0, description="Of the rod alone.")
    """Not this."""
    free: bool = False


class Arm(Rod):
    """A rod that turns."""

    length_mm: float = 3.0
    turns_deg: float
    """How far."""


class Robot(Section):
    """Holds arms."""

    first: Arm
    """Nearest the base."""
    others: list[Arm]


def test_fields_are_described_by_the_docstring_below_or_their_own_description():
    assert describe_fields(Rod) == {
        "length_mm": "Between the centres\nof its joints.",
        "mass_kg": "Of the rod alone.",
    }


def test_a_base_describes_what_a_section_does_not():
    assert describe_fields(Arm) == {**describe_fields(Rod), "turns_deg": "How far."}


def test_classes_of_one_name_are_told_apart():
    def make():
        class Rod(Section):
            length_mm: float
            """Of another rod."""

        return Rod

    assert describe_fields(make()) == {"length_mm": "Of another rod."}


def test_editors_are_told_the_descriptions_of_sections_within_sections():
    schema = Robot.model_json_schema()
    assert schema["properties"]["first"] == {"$ref": "#/$defs/Arm", "description": "Nearest the base."}
    assert "description" not in schema["properties"]["others"]
    assert schema["$defs"]["Arm"]["properties"]["turns_deg"]["description"] == "How far."
    assert schema["$defs"]["Arm"]["description"] == "A rod that turns."


def test_a_section_without_source_has_none():
    subprocess.run([sys.executable, "-c", UNREAD], check=True)
