"""The page of a study, from its results alone: a list of blocks, each of which shows something or nothing."""

from __future__ import annotations

from collections.abc import Callable

from bayescal.experiments.frame.results import Results
from bayescal.experiments.shared.origin import name_origin
from bayescal.experiments.study.page import readings
from bayescal.experiments.study.page.checks import list_failures, title_failures
from bayescal.experiments.study.page.claims import show_claims
from bayescal.experiments.study.page.data import show_data
from bayescal.experiments.study.page.deformation import show_deformation
from bayescal.experiments.study.page.errors import show_errors
from bayescal.experiments.study.page.evidence import show_diagnostics, show_evidence
from bayescal.experiments.study.page.frames import show_frames
from bayescal.experiments.study.page.machine import show_flexure, show_machine
from bayescal.experiments.study.page.model_error import show_model_error
from bayescal.experiments.study.page.notation import show_notation
from bayescal.experiments.study.page.outliers import show_outliers
from bayescal.experiments.study.page.parameters import show_parameters
from bayescal.experiments.study.page.ranking import show_ranking
from bayescal.experiments.study.page.results import StudyResults
from bayescal.experiments.study.page.ridges import show_ridges
from bayescal.experiments.study.page.soundness import has_doubts
from bayescal.experiments.study.page.structured import show_structured
from bayescal.experiments.study.page.verdict import state_headline, state_verdict
from bayescal.report.blocks import Page, Section

KIND = "Study"

type PageBlock = Callable[[StudyResults], Section | None]
"""A part of the page of any study; None where these results have nothing for it."""

BLOCKS: tuple[PageBlock, ...] = (
    show_ranking,
    show_claims,
    show_errors,
    readings.show_accuracy,
    readings.show_held_back,
    show_outliers,
    show_parameters,
    show_machine,
    show_flexure,
    readings.show_undetermined,
    show_ridges,
    show_frames,
    show_deformation,
    show_model_error,
    show_structured,
    readings.show_functions,
    readings.show_comparison,
    readings.show_next,
    show_evidence,
    show_diagnostics,
    show_data,
    show_notation,
)
"""All parts of the page, in their order."""


def build_page(results: Results, blocks: tuple[PageBlock, ...] = BLOCKS) -> Page:
    """Return what the page of a study says.

    Parameters
    ----------
    results : Results
        As they are read from their directory; figures that need draws are left out without its posterior files.
    blocks : tuple of callable
        Parts of the page in their order.

    Raises
    ------
    InputError
        Where the results are not what a study writes.
    """
    study = StudyResults.of(results)
    shown = (block(study) for block in blocks)
    chosen = study.fit(study.chosen)
    return Page(
        kind=KIND,
        name=study.summary["experiment"],
        title=study.summary["title"],
        origin=name_origin(study.summary["origin"]),
        headline=state_headline(study),
        verdict=tuple(state_verdict(study)),
        sections=tuple(section for section in shown if section is not None),
        facts=(("Machine", str(study.summary["machine"])), ("Data of the variant to use", str(chosen["data"]))),
        failures=tuple(list_failures(study)),
        failures_title=title_failures(study),
        doubtful=has_doubts(study),
    )
