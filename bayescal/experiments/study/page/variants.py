"""Variants by name and by model and deformation, and which of them the evidence tells apart."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

from bayescal.experiments.shared.headline import Candidate, group_candidates, label_title
from bayescal.experiments.study.page.results import StudyResults
from bayescal.report.blocks import Column
from bayescal.report.numbers import join_words
from bayescal.report.symbols import describe_deformation

VARIANT = Column("Variant", kind="name")


def split_variant(results: StudyResults, name: str) -> tuple[str, str]:
    """Return a variant's model and deformation; its name says them unless it has one of its own."""
    if name in results.own_names:
        return results.own_names[name]
    model, _, deformation = name.rpartition("/") if "models" in results.summary else ("", "", "")
    return model, deformation


def label_model(results: StudyResults, model: str) -> str:
    """Return a kinematic model's title; its name where the study gives none."""
    return str(results.summary.get("models", {}).get(model, model))


def label_variant(results: StudyResults, name: str) -> str:
    """Return what the page calls a variant."""
    return label_title(str(results.fit(name)["title"]))


def name_variants(results: StudyResults, names: Sequence[str], between: str = "and") -> str:
    """Return variants as words; those of one deformation as its models, unless some have names of their own."""
    models, deformations = zip(*(split_variant(results, name) for name in names), strict=True)
    own = any(name in results.own_names for name in names)
    if len(set(deformations)) == 1 and len(names) > 1 and all(models) and not own:
        words = [label_model(results, model) for model in models]
        return f"{join_words(words, between)} {describe_deformation(deformations[0])}"
    return join_words([label_variant(results, name) for name in names], between)


def list_models(results: StudyResults) -> list[str]:
    """Return the kinematic models in the order of the study."""
    return list(dict.fromkeys(split_variant(results, name)[0] for name in results.summary["variants"]))


def list_deformations(results: StudyResults) -> list[str]:
    """Return the deformations in the order of the study."""
    return list(dict.fromkeys(split_variant(results, name)[1] for name in results.summary["variants"]))


def find_variants(results: StudyResults, model: str | None = None, deformation: str | None = None) -> list[str]:
    """Return the variants of a model, of a deformation or of both, in the order of the study."""
    return [
        name
        for name in results.summary["variants"]
        if model in (None, split_variant(results, name)[0]) and deformation in (None, split_variant(results, name)[1])
    ]


def find_best(results: StudyResults, model: str, deformation: str) -> str | None:
    """Return the variant of a model and deformation with the largest log-evidence; None where there is none."""
    return max(find_variants(results, model, deformation), key=lambda name: read_evidence(results, name), default=None)


def list_best(results: StudyResults, deformation: str) -> list[str]:
    """Return the best variant of every model that has a deformation, in the order of the study."""
    found = (find_best(results, model, deformation) for model in list_models(results))
    return [name for name in found if name is not None]


def find_free_sets(results: StudyResults) -> dict[tuple[str, str], list[str]]:
    """Return the variants of each model and deformation that has several, in the order of the study."""
    if "models" not in results.summary:
        return {}
    pairs = dict.fromkeys(split_variant(results, name) for name in results.summary["variants"])
    alike = {pair: find_variants(results, *pair) for pair in pairs}
    return {pair: names for pair, names in alike.items() if len(names) > 1}


def read_evidence(results: StudyResults, name: str, setting: str = "free") -> float:
    """Return a variant's log-evidence, nats."""
    return float(results.fit(name, setting)["log_evidence"])


def choose_candidates(results: StudyResults, names: Sequence[str], setting: str = "free") -> list[Candidate]:
    """Return some variants as the headline compares them, in the order of the study."""
    return [one for one in results.candidates(setting) if one.name in names]


def is_told_apart(results: StudyResults, one: str, other: str, setting: str = "free") -> bool:
    """Whether the evidence distinguishes two variants."""
    first, second = choose_candidates(results, (one, other), setting)
    return first.is_distinguishable(second)


def group_variants(results: StudyResults, names: Sequence[str], setting: str = "free") -> list[list[str]]:
    """Return variants in groups by evidence, the best group first; within a group in the order of the study."""
    groups = group_candidates(choose_candidates(results, names, setting))
    return [[one.name for one in group] for group in groups]


def find_leaders(results: StudyResults, setting: str = "free") -> list[str]:
    """Return the variants that are not told apart from the best one, in the order of the study."""
    return group_variants(results, results.ranking, setting)[0]


def choose_model(results: StudyResults) -> str:
    """Return the model to show where one must do: that of the variant to use."""
    return split_variant(results, results.chosen)[0]


def measure_spread(results: StudyResults, names: Sequence[str], setting: str = "free") -> float:
    """Return the largest difference of log-evidence among variants, nats."""
    values = [read_evidence(results, name, setting) for name in names]
    return max(values) - min(values)


def split_pairs(results: StudyResults) -> tuple[list[float], list[float]]:
    """Return the differences of log-evidence of all pairs: those told apart, and those not."""
    apart: list[float] = []
    tied: list[float] = []
    for one, other in combinations(results.ranking, 2):
        gap = measure_spread(results, (one, other))
        (apart if is_told_apart(results, one, other) else tied).append(gap)
    return apart, tied
