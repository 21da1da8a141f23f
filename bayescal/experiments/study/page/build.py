"""The page of a study, from its results alone: a list of blocks, each of which shows something or nothing."""

from __future__ import annotations

from collections.abc import Callable

from bayescal.experiments.runner.blocks import show_sections
from bayescal.experiments.runner.losses import attempt
from bayescal.experiments.runner.results import Results
from bayescal.experiments.shared import knowledge_page
from bayescal.experiments.shared.origin import name_origin
from bayescal.experiments.study.page.before_after import show_before_after
from bayescal.experiments.study.page.data import show_claims, show_comparison, show_data, show_notation
from bayescal.experiments.study.page.errors import show_errors, show_held_back, show_outliers
from bayescal.experiments.study.page.evidence import show_diagnostics, show_evidence
from bayescal.experiments.study.page.functions import show_functions
from bayescal.experiments.study.page.machine import show_deformation, show_flexure, show_machine
from bayescal.experiments.study.page.model_error import show_model_error
from bayescal.experiments.study.page.parameters import show_frames, show_parameters
from bayescal.experiments.study.page.ranking import show_ranking
from bayescal.experiments.study.page.results import StudyResults
from bayescal.experiments.study.page.ridges import show_ridges
from bayescal.experiments.study.page.solutions import show_solutions
from bayescal.experiments.study.page.soundness import has_warnings, list_failures
from bayescal.experiments.study.page.verdict import list_key_figures, state_headline, state_verdict
from bayescal.report.blocks import Page, PageSection

NO_HEADLINE = "Results were computed; part of the page failed."

type PageBlock = Callable[[StudyResults], PageSection | None]
"""A part of the page of any study; None where these results have nothing for it."""


def show_accuracy(study: StudyResults) -> PageSection | None:
    """Return how accurate the tool is; None where that was not computed."""
    return knowledge_page.show_accuracy(study.tables, study.chosen, study.units)


def show_next(study: StudyResults) -> PageSection | None:
    """Return the candidate poses that reduce the error most."""
    return next(iter(knowledge_page.show_next(study.tables, study.chosen, study.units)), None)


BLOCKS: tuple[PageBlock, ...] = (
    show_before_after,
    show_ranking,
    show_claims,
    show_errors,
    show_accuracy,
    show_held_back,
    show_outliers,
    show_solutions,
    show_parameters,
    show_machine,
    show_flexure,
    show_ridges,
    show_frames,
    show_deformation,
    show_model_error,
    show_functions,
    show_comparison,
    show_next,
    show_evidence,
    show_diagnostics,
    show_data,
    show_notation,
)
"""All parts of the page, in their order."""


def build_page(results: Results) -> Page:
    """Return what the page of a study says; figures that need draws are left out without its posterior files.

    Raises
    ------
    InputError
        Where the results are not what a study writes.
    """
    study = StudyResults.of(results)
    summary = study.summary
    return Page(
        kind="Study",
        name=summary["experiment"],
        title=summary["title"],
        origin=name_origin(summary["origin"]),
        headline=attempt("the headline", lambda: state_headline(study), NO_HEADLINE),
        verdict=attempt("the verdict", lambda: tuple(state_verdict(study)), ()),
        sections=show_sections(BLOCKS, study),
        facts=(
            ("Machine", str(summary["machine"])),
            ("Data of the leading variant", str(study.fit(study.chosen)["data_set"])),
        ),
        failures=tuple(list_failures(study)),
        key_figures=attempt("the first figures", lambda: tuple(list_key_figures(study)), ()),
        unreliable=attempt("the verdict", lambda: has_warnings(study), True),
    )
