"""Variants of a machine's model in words."""

from __future__ import annotations


def describe_deformation(deformation: str) -> str:
    """Return a deformation after the name of a model: ``with the matrix deformation``."""
    return "without deformation" if deformation == "none" else f"with the {deformation} deformation"
