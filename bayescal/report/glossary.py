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
    "90 % interval, 90 % intervals, 90 % predictive intervals, credible interval": "Holds the true value with "
    "90 % probability.",
    "actuator, actuators": "Motor that moves a leg's base joint or changes its length.",
    "bulk ESS, tail ESS, ESS": "Effective sample size: equivalent number of independent draws.",
    "calibration poses": "Measured poses used in the fit.",
    "contraction": "1 − (posterior sd / prior sd)²: 0 nothing learnt, 0.75 uncertainty halved.",
    "coverage, coverage of 90 % intervals": "Share of true values inside their intervals.",
    "deformation, deformations": "Bending of the platform: none, linear (κ), or matrix (K).",
    "draws, draw": "Random samples of the posterior.",
    "elpd, elpd LOO": "Expected log predictive density of unused poses; larger is better.",
    "free parameters, free": "Parameters that are estimated; all others stay nominal.",
    "gauge": "Parameter change that no such measurement can reveal.",
    "identifiable": "Determined clearly better than its tolerance.",
    "importance sampling": "Weights draws of an approximation to represent the posterior.",
    "leave-one-out, leave-one-out cross-validation, LOO, left out": "Each pose is predicted from all others.",
    "log-evidence, log-evidences, evidence": "Log marginal likelihood of a variant; larger is better, "
    "only differences count.",
    "model error, model errors": "Error beyond the noise: random (τ) or systematic.",
    "nat, nats": "Log unit: 1 nat is odds of 2.7 to 1, 5 nat of 150 to 1.",
    "nominal, from nominal": "As designed.",
    "observability index, observability indices, O1": "Single numbers for how well poses show all parameters; "
    "larger is better.",
    "Pareto k": "Reliability of importance sampling: below 0.7 is good.",
    "platform": "Body that the legs carry.",
    "pose, poses": "Position and orientation.",
    "posterior, posteriors": "Probability distribution of the parameters given the data.",
    "prior, priors, tolerance, tolerances": "Assumed before measuring: nominal ± tolerance.",
    "R-hat": "Agreement of chains: near 1 is good.",
    "ridge, ridges": "Parameters of which only a combination is known.",
    "rms": "Root mean square.",
    "sd, standard deviation, standard deviations": "68 % lie within ± 1 sd, 95 % within ± 2.",
    "stacking": "Mixing variants to predict left-out poses best.",
    "twin": "Simulated machine with known true errors.",
    "variant, variants": "Kinematic model, deformation and free parameters.",
    "verification poses, verification, held back": "Measured poses kept out of the fit.",
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
