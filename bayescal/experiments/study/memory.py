"""What a study will hold at once, from the numbers of its poses, legs, parameters and draws."""

from __future__ import annotations

from bayescal.density.batches import BATCH, POSES
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.posterior import Posterior
from bayescal.density.structured import StructuredLikelihood
from bayescal.experiments.frame.memory import Need
from bayescal.experiments.shared.trees import PRIOR_DRAWS, SAVED_DRAWS, limit_draws
from bayescal.experiments.study.fit import KEPT_DRAWS, POSE_NUMBERS, list_tasks
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.inference.exploration import count_walkers

DOUBLE, SINGLE = 8, 4  # bytes
COPIES = 3
"""Of what is kept: as it is computed, as a record, as it is written."""
ARRAYS = 40
"""Of the hot loop of an instrument's readings, components of vectors counted one by one."""
DERIVATIVES = 8
"""Arrays of all rows by all parameters in a mode search."""


def estimate_study(inputs: StudyInputs) -> Need:
    """Return what a study needs."""
    sampler, n_poses = inputs.config.sampler, len(inputs.verification)
    largest = max(
        (inputs.posterior(variant, with_model_error=True) for variant in inputs.config.variants),
        key=lambda posterior: posterior.n_parameters,
    )
    n = largest.n_parameters
    kept = sampler.ensembles * min(
        limit_draws(KEPT_DRAWS, sampler.ensembles * n_poses), sampler.steps * count_walkers(n, sampler.walkers)
    )
    numbers = POSE_NUMBERS * n_poses
    made = min(kept, limit_draws(SAVED_DRAWS, numbers)) * numbers
    prior = limit_draws(PRIOR_DRAWS, numbers) * numbers
    one = DOUBLE * n_poses * kept + SINGLE * (made + prior)
    n_fits = len(list_tasks(inputs))
    return Need(
        shared=float((n_fits + COPIES) * one),
        each=COPIES * one + estimate_search(largest),
        sizes=f"{n_poses} poses, {n} parameters and {n_fits} posteriors",
        remedy="fewer poses or variants",
    )


def estimate_search(posterior: Posterior) -> float:
    """Return the bytes of a posterior's derivatives and hot loop."""
    likelihood = posterior.likelihood
    rows = likelihood.n_poses * likelihood.n_legs
    total = float(DOUBLE * DERIVATIVES * rows * (posterior.n_parameters + likelihood.n_legs))
    if not isinstance(likelihood, PoseLikelihood | StructuredLikelihood):
        total += DOUBLE * ARRAYS * BATCH * min(rows, POSES * likelihood.n_legs)
    return total
