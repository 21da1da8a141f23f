"""How evidences hang on the widths of the priors: each variant's again, all priors wider or narrower by a factor.

Only evidences are wanted, to a few hundredths of a nat: a proposal need not be sharp. Narrower priors have no modes
that wider ones about the same centres lack, so that these start where the study's own priors have theirs.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from bayescal.density.legs import LegPosterior
from bayescal.errors import NumericalError
from bayescal.experiments.study.correct import correct_evidence, list_corrected
from bayescal.experiments.study.fit import Arrays, Task, get_explored, list_importance
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.schema import stem_of
from bayescal.inference.exploration import ACCEPTABLE, GOOD_ENOUGH, Exploration, explore, explore_near
from bayescal.inference.importance import ImportanceEvidence, estimate_by_importance
from bayescal.limits import OUT_OF_QUESTION
from bayescal.numerics.geometry import Array

DRAWS = 2000
"""Draws of a proposal, a block."""
ERROR = 0.03
"""Standard error in nats that is enough."""
EDGE = 1e-3
"""How near to a bound, by the width of a uniform prior, a mode of a wider one may begin to be looked for."""


@dataclass(frozen=True, eq=False)
class WidthTask:
    """A unit of work: the evidence of a variant with all priors wider or narrower by a factor.

    Attributes
    ----------
    variant : str
    factor : float
    modes : ndarray, shape (M, n)
        Those with the study's own priors, in sampling coordinates.
    behind : float
        Nats of log-evidence, with the study's own priors, behind the best variant.
    """

    variant: str
    factor: float
    modes: Array
    behind: float = 0.0

    @property
    def key(self) -> str:
        """A name that is also a file name."""
        return f"{stem_of(self.variant)}-factor-{self.factor!r}"


def list_width_tasks(inputs: StudyInputs, posteriors: Mapping[Task, Arrays]) -> list[WidthTask]:
    """Return a task for every variant and every factor that is not one, whose evidence the posterior has.

    The long ones, of many modes and wide priors, come first: a worker that begins one last keeps all others waiting.
    """
    found = {variant.name: posteriors[Task(variant.name, True)] for variant in inputs.config.variants}
    best = max(float(arrays["importance"][0]) for arrays in found.values())
    tasks = [
        WidthTask(name, factor, arrays["modes"], best - float(arrays["importance"][0]))
        for factor in inputs.config.sensitivity.factor
        for name, arrays in found.items()
        if factor != 1.0
    ]
    return sorted(tasks, key=lambda task: (-len(task.modes), -task.factor))


def weigh_widths(inputs: StudyInputs, task: WidthTask) -> Arrays:
    """Compute one task; all numbers depend on the inputs, the config's seed and the task alone."""
    variant = inputs.variant(task.variant)
    posterior = inputs.posterior(variant, True, task.factor)
    seed = np.random.SeedSequence([inputs.config.seed, zlib.crc32(task.key.encode())])
    explore_seed, importance_seed, correct_seed = seed.spawn(3)
    starts = move_modes(task.modes, inputs.posterior(variant, True), posterior)
    exploration, importance = _weigh(inputs, task, posterior, starts, explore_seed, importance_seed)
    exact = inputs.exact_density(variant, get_explored(exploration))
    correction = None if exact is None else correct_evidence(exact, exploration, correct_seed)
    arrays = list_importance(importance)
    return arrays | list_corrected(arrays, correction)


def _weigh(
    inputs: StudyInputs,
    task: WidthTask,
    posterior: LegPosterior,
    starts: Array,
    explore_seed: np.random.SeedSequence,
    importance_seed: np.random.SeedSequence,
) -> tuple[Exploration, ImportanceEvidence]:
    """Return what a proposal that is good enough finds, or a better one if it is not and the variant is in question."""
    walkers, search = inputs.config.sampler.walkers, task.factor > 1.0
    try:
        for enough in (ACCEPTABLE, GOOD_ENOUGH):
            exploration = explore_near(posterior, starts, explore_seed, walkers, search=search, enough=enough)
            importance = _estimate(inputs, exploration, importance_seed)
            if not importance.is_doubtful or task.behind > OUT_OF_QUESTION:
                return exploration, importance
            starts, search = np.stack([mode.y for mode in exploration.modes]), False
    except NumericalError:
        pass  # no start led to a mode: the search from the beginning finds one, or says why not
    exploration = explore(posterior, explore_seed, walkers, anew=True)
    return exploration, _estimate(inputs, exploration, importance_seed)


def _estimate(inputs: StudyInputs, exploration: Exploration, seed: np.random.SeedSequence) -> ImportanceEvidence:
    effort = inputs.config.evidence
    return estimate_by_importance(
        exploration.straight.log_density,
        exploration.proposal,
        np.random.default_rng(seed),
        min(DRAWS, effort.draws),
        max(ERROR, effort.target_error),
        effort.max_draws,
    )


def move_modes(modes: Array, known: LegPosterior, posterior: LegPosterior) -> Array:
    """Return the coordinates (M, n) of the same machines under other priors, within their bounds."""
    coordinates, theta = posterior.sampling.coordinates, known.theta(modes)
    bounded = coordinates.bounded
    lower, upper = coordinates.lower[bounded], coordinates.upper[bounded]
    margin, places = EDGE * (upper - lower), coordinates.free[bounded]
    theta[:, places] = np.clip(theta[:, places], lower + margin, upper - margin)
    return np.concatenate([coordinates.y_from_theta(theta), modes[:, posterior.n_geometry :]], axis=1)


def tabulate_sensitivity(
    inputs: StudyInputs, posteriors: Mapping[Task, Arrays], widths: Mapping[tuple[float, str], Arrays]
) -> pd.DataFrame:
    """Return the log-evidence of every variant for every factor on the widths of the priors."""
    rows = []
    for factor in inputs.config.sensitivity.factor:
        for variant in inputs.config.variants:
            arrays = widths[factor, variant.name] if factor != 1.0 else posteriors[Task(variant.name, True)]
            rows.append(
                {
                    "variant": variant.name,
                    "factor": factor,
                    "log_evidence": arrays["importance"][0],
                    "log_evidence_se": arrays["importance"][1],
                    "efficiency": arrays["importance_quality"][0],
                    "pareto_k": arrays["importance_quality"][1],
                }
            )
    return pd.DataFrame(rows).sort_values(["factor", "log_evidence"], ascending=[True, False], ignore_index=True)
