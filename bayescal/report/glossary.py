"""What the words of statistics and of the field mean, for readers who have not read the papers."""

from __future__ import annotations

import re
from dataclasses import dataclass


@dataclass(frozen=True)
class Term:
    """A term in its spellings, the one it is listed by first, and what it means."""

    words: tuple[str, ...]
    meaning: str


MEANINGS = {
    "90 % interval, 90 % intervals, 90 % predictive intervals, credible interval": "Range that holds the true value "
    "with a probability of 90 %, if the assumptions are right.",
    "actuator, actuators": "Motor of a leg: it moves the joint at the leg's base, or changes its length.",
    "bulk ESS, tail ESS, ESS": "Effective sample size: how many independent draws would be as good.",
    "calibration poses": "Measured poses that the parameters were fitted to; errors on them are smaller than "
    "elsewhere.",
    "contraction": "Share of a tolerance's variance that the measurements remove: at 0 nothing is learnt, at 0.75 "
    "the tolerance is halved, at 1 the parameter is known.",
    "coverage, coverage of 90 % intervals": "How many measurements, or true values, lie inside their intervals: of "
    "90 % intervals it should be 90 %. Less: the intervals claim too much.",
    "deformation, deformations": "How the platform gives way under its legs: none; linear, each joint by κ times its "
    "own actuator's displacement; matrix, by the displacements of all actuators through a measured matrix K.",
    "draws, draw": "Parameters picked at random from the posterior: what remains uncertain, as examples.",
    "elpd, elpd LOO": "Expected log predictive density: how well poses that were not used are predicted. Larger is "
    "better; only differences count.",
    "free parameters, free": "Parameters that the calibration may change; all others have their nominal values.",
    "gauge": "Change of parameters that no measurement of this kind can ever reveal.",
    "identifiable": "Of a parameter: the measurements determine it clearly better than its tolerance does.",
    "importance sampling": "Weighing draws of an approximation so that they represent the exact posterior.",
    "leave-one-out, leave-one-out cross-validation, LOO, left out": "Each pose in turn is predicted from all the "
    "others: a test on poses that the fit has not seen.",
    "log-evidence, log-evidences, evidence": "How well a model with its tolerances predicted all measurements "
    "together, as a logarithm. Larger is better; freedom that is not needed costs. Only differences between variants "
    "count.",
    "model error, model errors": "What a model leaves unexplained along a leg or in a channel, beyond the noise: τ "
    "is the standard deviation of what differs from pose to pose; functions of the pose and of time repeat.",
    "nat, nats": "Unit of a difference of log-evidences: 1 nat is odds of 2.7 to 1, 3 nat of 20 to 1, 5 nat of 150 "
    "to 1.",
    "nominal, from nominal": "As the machine was designed; offsets are counted from there.",
    "observability index, observability indices, O1": "O1 to O5: single numbers for how well a set of poses shows "
    "all parameters together; larger is better.",
    "Pareto k": "Says whether an estimate by importance sampling can be trusted: below 0.7 it can.",
    "platform": "What the legs carry: its position and orientation are what a parallel machine is for.",
    "pose, poses": "Position and orientation of the platform together.",
    "posterior, posteriors": "What is known of the parameters by the measurements: not one number each but how "
    "probable each value is.",
    "prior, priors, tolerance, tolerances": "What is assumed of a parameter before the measurements: nominal, give "
    "or take its tolerance.",
    "R-hat": "Compares several runs of the sampler with each other: near 1 they agree; above the limit the numbers "
    "are not to be relied on.",
    "ridge, ridges": "Parameters that can change together while the measured poses stay the same: only their "
    "combination is known.",
    "rms": "Root mean square: a mean in which large values count more.",
    "sd, standard deviation, standard deviations": "A normal error lies within ± 1 sd with 68 %, ± 2 with 95 %.",
    "stacking": "Mixing the predictions of several variants, weighed so that poses left out are predicted best.",
    "twin": "Simulated machine whose true errors are known, so that results can be checked.",
    "variant, variants": "One way to describe the machine: a kinematic model, a deformation of the platform and the "
    "free parameters.",
    "verification poses, verification, held back": "Measured poses that were held back from the fit, to test it.",
}
"""By the spellings of a term, the one that it is listed by first."""

TERMS = tuple(Term(tuple(words.split(", ")), meaning) for words, meaning in MEANINGS.items())


def find_terms(markup: str) -> list[Term]:
    """Return the terms that a page's text uses, in the order of the alphabet."""
    text = re.sub(r"<svg.*?</svg>|<[^>]+>", " ", str(markup), flags=re.DOTALL).replace("\u00a0", " ").lower()
    used = [
        term
        for term in TERMS
        if any(w in text and re.search(rf"(?<![\w-]){re.escape(w)}(?![\w-])", text) for w in map(str.lower, term.words))
    ]
    return sorted(used, key=lambda term: term.words[0].lower())
