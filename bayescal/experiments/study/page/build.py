"""The page of a study, from its results alone."""

from __future__ import annotations

from bayescal.experiments.frame.results import Results
from bayescal.experiments.shared.judgement_page import tabulate_widths
from bayescal.experiments.study.page import illustrations as show
from bayescal.experiments.study.page.advice import state_headline
from bayescal.experiments.study.page.blunders import show_blunders
from bayescal.experiments.study.page.checks import list_failures, title_failures
from bayescal.experiments.study.page.claims import show_claims
from bayescal.experiments.study.page.coverage import tabulate_coverage
from bayescal.experiments.study.page.data import tabulate_data
from bayescal.experiments.study.page.deformation import tabulate_deformation
from bayescal.experiments.study.page.evidence import tabulate_diagnostics, tabulate_evidence
from bayescal.experiments.study.page.frames import show_frames
from bayescal.experiments.study.page.model_error import tabulate_model_error
from bayescal.experiments.study.page.notation import show_notation
from bayescal.experiments.study.page.parameter_tables import fold_parameters, state_agreement, tabulate_contraction
from bayescal.experiments.study.page.prediction import tabulate_stacking
from bayescal.experiments.study.page.predictive_checks import fold_checks
from bayescal.experiments.study.page.published import tabulate_published
from bayescal.experiments.study.page.ranking import tabulate_effects, tabulate_ranking
from bayescal.experiments.study.page.results import StudyResults
from bayescal.experiments.study.page.ridges import state_ridges, tabulate_ridges
from bayescal.experiments.study.page.soundness import has_doubts
from bayescal.experiments.study.page.structured import show_structured
from bayescal.experiments.study.page.tau_scale import show_tau_scale
from bayescal.experiments.study.page.variants import VARIANT, label_variant
from bayescal.experiments.study.page.verdict import state_verdict
from bayescal.report.blocks import Block, Fold, Heading, Page, Section

KIND = "Bayesian identification"
RANKING = (
    "Log-evidence in nats: a difference of 1 nat is odds of 2.7 to 1, 5 nats of 150 to 1. elpd is the log density the "
    "posterior gives to poses it has not seen. “From nominal” is how far the identified geometry moved: rms of all "
    "parameters in mm, and rms of all in units of their prior standard deviation."
)
MODEL_ERROR = (
    "τ is the standard deviation of what a model leaves unexplained along a leg, beyond the noise of {} and "
    "actuators. Where it is near zero the model suffices; where it is large the posterior widens all intervals "
    "accordingly instead of blaming the geometry."
)
PUBLISHED = (
    "Published values differ from the posteriors by construction: they come from least squares with all poses "
    "weighted alike, without tolerances and without model error, on the data of the publication. The posteriors "
    "weigh every pose by its covariance, use the tolerances as priors and leave room for a model error. These data: "
    "{origin}. A published value outside an interval contradicts nothing, unless the data were made from that very "
    "table."
)


def build_page(results: Results) -> Page:
    """Return what the page of a study says.

    Parameters
    ----------
    results : Results
        As they are read from their directory; the figures that need draws are left out without its posterior files.

    Raises
    ------
    InputError
        Where the results are not what a study writes.
    """
    study = StudyResults.of(results)
    sections = (
        _show_ranking(study),
        show_claims(study),
        _show_errors(study),
        show_blunders(study),
        _show_parameters(study),
        _show_joints(study),
        _show_flexure(study),
        _show_ridges(study),
        show_frames(study),
        _show_deformation(study),
        _show_model_error(study),
        show_structured(study),
        _show_evidence(study),
        _show_diagnostics(study),
        Section("Data", (tabulate_data(study),), anchor="data"),
        show_notation(study),
    )
    return Page(
        kind=KIND,
        name=study.summary["experiment"],
        title=study.summary["title"],
        origin=study.summary["data_origin"],
        headline=state_headline(study),
        verdict=tuple(state_verdict(study)),
        sections=tuple(section for section in sections if section is not None),
        failures=tuple(list_failures(study)),
        failures_title=title_failures(study),
        doubtful=has_doubts(study),
    )


def _show_ranking(study: StudyResults) -> Section:
    blocks: list[Block] = [RANKING, show.illustrate_ranking(study), tabulate_ranking(study, "free")]
    blocks += [table for table in (tabulate_effects(study), tabulate_stacking(study)) if table is not None]
    blocks.append(Fold("The same ranking without model error (τ = 0)", (tabulate_ranking(study, "zero"),)))
    return Section("Ranking", tuple(blocks), anchor="ranking")


def _show_errors(study: StudyResults) -> Section:
    title = "Coverage: how many measurements lie inside their intervals, variant by variant"
    blocks: list[Block] = [*show.illustrate_errors(study), show.illustrate_bounds(study)]
    blocks.append(Fold(title, (tabulate_coverage(study),)))
    return Section("Pose errors", tuple(blocks), anchor="errors", short="Errors")


def _show_parameters(study: StudyResults) -> Section:
    title, blocks = "Parameters", list[Block]()
    published = tabulate_published(study)
    if published is not None:
        title += ", beside the published tables"
        blocks += [published, PUBLISHED.format(origin=study.summary["data_origin"].rstrip("."))]
    blocks += [show.illustrate_parameters(study), *state_agreement(study)]
    for heading, folds in fold_parameters(study):
        blocks += [Heading(heading), *folds]
    blocks.append(Fold("How much the measurements narrowed each parameter", (tabulate_contraction(study),)))
    return Section(title, tuple(blocks), anchor="parameters", short="Parameters")


def _show_joints(study: StudyResults) -> Section:
    title = "Joints: where the identified points lie"
    blocks: list[Block] = [*show.show_machine(study), show.illustrate_joints(study)]
    return Section(title, tuple(blocks), anchor="joints", short="Joints")


def _show_flexure(study: StudyResults) -> Section | None:
    if study.flexure is None:
        return None
    figure = show.illustrate_flexure(study, study.flexure)
    return Section("Flexure joint", (figure,), anchor="flexure", short="Flexure")


def _show_ridges(study: StudyResults) -> Section:
    blocks: list[Block] = [*state_ridges(study), show.illustrate_ridges(study)]
    table = tabulate_ridges(study)
    if table is not None:
        blocks.append(Fold("The most correlated pairs of every variant", (table,)))
    return Section("Ridges: what the measurements cannot tell apart", tuple(blocks), anchor="ridges", short="Ridges")


def _show_deformation(study: StudyResults) -> Section | None:
    """Return what targets at the joints show; None where there are none by design, on struts or of an instrument."""
    if study.ring is None and (study.has_struts or study.instrument is not None):
        return None
    tables, statements = tabulate_deformation(study)
    blocks: list[Block] = [*statements, show.illustrate_deflections(study), *tables]
    return Section("Deformation of the platform", tuple(blocks), anchor="deformation", short="Deformation")


def _show_model_error(study: StudyResults) -> Section:
    table, statements = tabulate_model_error(study)
    text = MODEL_ERROR.format("targets" if study.instrument is None else "the instrument")
    blocks: list[Block] = [text, *statements, show.illustrate_model_error(study)]
    if table is not None:
        blocks.append(Fold("τ of every leg, variant by variant", (table,)))
    return Section("Model error", tuple(blocks), anchor="model-error")


def _show_evidence(study: StudyResults) -> Section:
    both = Fold("Both estimators of every log-evidence", (tabulate_evidence(study),))
    labels = {name: label_variant(study, name) for name in study.ranking}
    caption = "Log-evidence with model error for wider and narrower priors."
    widths = tabulate_widths(study.sensitivity, labels, VARIANT, caption)
    blocks = (show.illustrate_sensitivity(study), widths, *show_tau_scale(study), both)
    return Section("Evidence", blocks, anchor="evidence")


def _show_diagnostics(study: StudyResults) -> Section:
    """Return the convergence of every posterior, open where something failed, and further checks."""
    fold = Fold("Convergence of every posterior", (tabulate_diagnostics(study),), bool(list_failures(study)))
    return Section("Diagnostics", (fold, *fold_checks(study)), anchor="diagnostics")
