"""What a study will hold at once, from the numbers of its poses, legs, parameters and draws."""

from __future__ import annotations

from bayescal.experiments.frame.memory import Need, estimate_arrays
from bayescal.experiments.shared.search_memory import list_sampling, list_search
from bayescal.experiments.shared.trees import PRIOR_DRAWS, SAVED_DRAWS, limit_draws
from bayescal.experiments.study.fit import KEPT_DRAWS, POSE_NUMBERS, list_tasks
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.inference.exploration import count_walkers

SINGLE = 0.5  # numbers of four bytes, in doubles
COPIES = 3
"""Of what is kept: as it is computed, as a record, as it is written."""


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
    sampling = list_sampling(sampler, inputs.config.evidence, n)
    n_fits, one = len(list_tasks(inputs)), [(n_poses, kept), (SINGLE, made + prior)]
    return estimate_arrays(
        {"poses": n_poses, "parameters": n, "posteriors": n_fits},
        [*((COPIES, *size) for size in one), *list_search(largest), *sampling],
        "fewer poses or variants",
        kept=[(n_fits + COPIES, *size) for size in one],
    )
