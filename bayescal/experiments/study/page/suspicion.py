"""While data are suspected nothing is advised of machine, noise and tolerances: data that are wrong look like these.

Nor is anything of the model error while noise or tolerances are: they are explained better without it.
"""

from __future__ import annotations

from typing import Final

from bayescal.experiments.shared.headline import say_data_first
from bayescal.experiments.shared.slips import EITHER, state_slip
from bayescal.experiments.study.page.errors import list_contradicting, state_outliers
from bayescal.experiments.study.page.model_error import LEAD
from bayescal.experiments.study.page.results import StudyResults
from bayescal.experiments.study.page.soundness import SIZES, say_misstated
from bayescal.report.blocks import Statement

SILENT: Final = (LEAD, SIZES, "Tolerances", "Noise", "Bounds", "Sensors' errors", "Next")
"""Leads of findings that take what is wrong with data for a property of machine, noise or tolerances."""
MISSTATED: Final = (EITHER, "noise", "tolerance")
RIVAL: Final = (LEAD, "Bounds", "Sensors' errors")
"""Leads of findings that take what is stated wrong for a property of the machine."""


def list_suspicions(study: StudyResults) -> list[Statement]:
    """Return what seems to be wrong with data: a slip, and poses that the others contradict where none was expected."""
    slip = state_slip(study.summary)
    if slip or study.fit(study.best_name).get("has_outliers") or not list_contradicting(study):
        return slip
    return state_outliers(study)


def say_suspicion(study: StudyResults) -> str:
    """Return what to look at before anything else; empty where nothing is suspected."""
    slip = study.summary.get("suspected_data_error")
    if isinstance(slip, dict):
        return say_data_first(str(slip["text"]))
    return next((one.action for one in list_suspicions(study)), "")


def silence(study: StudyResults, found: list[Statement]) -> list[Statement]:
    """Return statements without those that are no advice while data are suspected; what is suspected stays."""
    suspicions = list_suspicions(study)
    if suspicions:
        return [*suspicions, *(one for one in found if one.lead not in SILENT and one not in suspicions)]
    return [one for one in found if one.lead not in RIVAL] if say_misstated(study, MISSTATED) else found
