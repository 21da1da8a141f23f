"""How evidences hang on the widths of the priors: each variant's again, all priors wider or narrower by a factor.

Most evidences follow from the fit's own draws (`bayescal.inference.other_priors`); a posterior that these do not reach
is explored by itself. Only its evidence is wanted, to a few hundredths of a nat, or to a few tenths where a variant is
out of the question: a proposal need not be sharp. Narrower priors have no modes that wider ones about the same centres
lack, so that searches start where the study's own priors have theirs; with wider ones others are looked for.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from bayescal.errors import NumericalError
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.shared.estimate import Fit, shift_evidence
from bayescal.experiments.shared.headline import rank_evidence
from bayescal.experiments.shared.study_schema import stem_of
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.readings import ReadingSubject
from bayescal.experiments.study.rows import PriorWidthRow
from bayescal.inference.correction import KNOWN_ENOUGH, correct_evidence
from bayescal.inference.exploration import (
    ACCEPTABLE,
    CORRECTABLE,
    GOOD_ENOUGH,
    Exploration,
    explore,
    explore_near,
    weigh_proposal,
)
from bayescal.inference.importance import NO_PARETO, WORTH_ANOTHER, ImportanceEvidence
from bayescal.inference.mode import Mode, find_modes
from bayescal.inference.other_priors import SCATTER
from bayescal.inference.schema import EvidenceConfig
from bayescal.inference.target import LogPosterior
from bayescal.limits import OUT_OF_QUESTION
from bayescal.numerics.geometry import Array

DRAWS, FEW_DRAWS = 2000, 500
"""Draws of a proposal, a block; the latter for a variant that is out of the question."""
NOT_FOUND = ImportanceEvidence(math.nan, math.nan, math.nan, NO_PARETO, 0)
"""Of a width whose evidence could not be computed."""
ERROR, ROUGH_ERROR = 0.03, 0.3
"""Standard error in nats that is enough; the latter for a variant that is out of the question."""
PILOTS = 0
"""Pilots of a proposal: a width costs less than the study's own fit, and its evidence has the error that it has."""
ROUGHLY_ACCEPTABLE = 0.1
"""Efficiency of a proposal from which on it is not sharpened for such a variant."""


@dataclass(frozen=True, eq=False)
class WidthTask:
    """A unit of work: the evidence of a variant with all priors wider or narrower by a factor.

    ``modes`` (M, n) are those with the study's own priors, in sampling coordinates; ``behind`` is by how many nats of
    log-evidence the variant is behind the best then. ``is_hard`` is whether too few draws count for that evidence,
    or its error is not to be trusted.
    """

    variant: str
    factor: float
    modes: Array
    behind: float = 0.0
    is_hard: bool = False

    @property
    def key(self) -> str:
        """A name that is also a file name."""
        return f"{stem_of(self.variant)}-factor-{self.factor!r}"

    @property
    def is_rough(self) -> bool:
        """Whether the variant is out of the question, so that a rough evidence will do."""
        return self.behind > OUT_OF_QUESTION

    def list_efficiencies(self) -> tuple[float, ...]:
        """Return the efficiencies from which on a proposal is not sharpened, of one try after the other."""
        if self.is_hard:
            return (WORTH_ANOTHER,)
        return (ROUGHLY_ACCEPTABLE, ACCEPTABLE) if self.is_rough else (ACCEPTABLE, GOOD_ENOUGH)


def find_known(fits: Mapping[str, Fit], factors: Sequence[float]) -> dict[tuple[float, str], ImportanceEvidence]:
    """Return the evidences by factor and variant that the fits' own draws tell well enough."""
    best, known = _find_best(fits), {}
    for name, fit in fits.items():
        own, is_rough = fit.importance, best - rank_evidence(fit.importance.log_evidence) > OUT_OF_QUESTION
        enough = ROUGH_ERROR if is_rough else math.hypot(own.standard_error, SCATTER)
        for factor, found in fit.widths.items():
            if factor in factors and found.standard_error <= enough:
                known[factor, name] = found
    return known


def list_width_tasks(
    fits: Mapping[str, Fit], factors: Sequence[float], known: Collection[tuple[float, str]] = ()
) -> list[WidthTask]:
    """Return a task for every variant and every factor but one, of which the evidence is not known.

    The long ones, of many modes and wide priors, come first: a worker that begins one last keeps all others waiting.
    """
    best, tasks = _find_best(fits), []
    for factor in (factor for factor in factors if factor != 1.0):
        for name, fit in fits.items():
            if (factor, name) not in known:
                own, behind = fit.importance, best - rank_evidence(fit.importance.log_evidence)
                is_hard = own.is_doubtful or own.efficiency < ACCEPTABLE
                tasks.append(WidthTask(name, factor, fit.modes, behind, is_hard))
    return sorted(tasks, key=lambda task: (-len(task.modes), -task.factor))


def _find_best(fits: Mapping[str, Fit]) -> float:
    return max(rank_evidence(fit.importance.log_evidence) for fit in fits.values())


def begin_widths(
    inputs: StudyInputs, fits: Mapping[str, Fit], run: Run
) -> Callable[[], dict[tuple[float, str], ImportanceEvidence]]:
    """Begin with every factor on the priors that is not one, and return what waits for all evidences.

    They are by factor and variant.
    """
    factors = inputs.config.sensitivity.prior_width_factors
    known = find_known(fits, factors)
    left = {task.key: task for task in list_width_tasks(fits, factors, known)}
    if not left or inputs.config.sampler.is_preliminary:
        return lambda: known
    wait = run.begin("prior widths", weigh_widths, inputs, left, (ImportanceEvidence,), spare=True)
    return lambda: known | {(left[key].factor, left[key].variant): found for key, found in wait().items()}


def weigh_widths(inputs: StudyInputs, task: WidthTask) -> ImportanceEvidence:
    """Compute one task; all numbers depend on inputs and task alone."""
    config, variant = inputs.config, inputs.variants[task.variant]
    seeds = np.random.SeedSequence([config.seed, zlib.crc32(task.key.encode())]).spawn(3)
    subject, known = ReadingSubject(variant.posterior(factor=task.factor).with_pose_guesses()), variant.posterior()
    others = find_modes(subject.posterior) if task.factor > 1.0 and not task.is_hard else []
    starts = subject.posterior.to_coordinates(known.theta(task.modes), task.modes[:, known.n_geometry :])
    draws = min(FEW_DRAWS if task.is_rough else DRAWS, config.evidence.draws)
    error = max(ROUGH_ERROR if task.is_rough else ERROR, config.evidence.tolerance_nat)
    effort = config.evidence.model_copy(update={"draws": draws, "tolerance_nat": error})
    exploration, importance = _weigh(task, subject.posterior, starts, others, seeds, config.sampler.walkers, effort)
    costly = subject.find_costly(exploration)
    enough = ROUGH_ERROR if task.is_rough else KNOWN_ENOUGH
    return shift_evidence(
        importance, None if costly is None else correct_evidence(costly, exploration, seeds[2], enough)
    )


def _weigh(
    task: WidthTask,
    posterior: LogPosterior,
    starts: Array,
    others: Sequence[Mode],
    seeds: Sequence[np.random.SeedSequence],
    walkers: int,
    effort: EvidenceConfig,
) -> tuple[Exploration, ImportanceEvidence]:
    """Return what a proposal that is good enough finds, or a better one if it is not and the variant is in question.

    Where the study's own priors have a poor proposal after all its effort no search of another follows: the evidence
    is stated with the error and the tail that it has.
    """
    found = list[tuple[Exploration, ImportanceEvidence]]()
    try:
        for enough in task.list_efficiencies():
            exploration = explore_near(
                posterior,
                starts,
                seeds[0],
                walkers,
                others,
                enough=enough,
                fine_enough=CORRECTABLE,
                max_pilots=PILOTS,
            )
            found.append((exploration, weigh_proposal(exploration, seeds[1], effort)))
            if task.is_hard or not found[-1][1].is_doubtful:
                return found[-1]
            if exploration.efficiency < enough:
                break  # it was sharpened as far as that goes
            starts, others = np.stack([mode.y for mode in exploration.modes]), ()
    except NumericalError:
        pass  # no start led to a mode: the search from the beginning finds one, or says why not
    if not (found and task.is_rough):
        exploration = explore(posterior, seeds[0], walkers, PILOTS, from_prior=True, fine_enough=CORRECTABLE)
        found.append((exploration, weigh_proposal(exploration, seeds[1], effort)))
    best = found.pop()
    for other in found:
        best = other if other[1].is_better_than(best[1]) else best
    return best


def tabulate_widths(
    fits: Mapping[str, Fit], widths: Mapping[tuple[float, str], ImportanceEvidence], factors: Sequence[float]
) -> pd.DataFrame:
    """Return the log-evidence of every variant for every factor on the widths of the priors."""
    rows = []
    for factor in factors:
        for name, fit in fits.items():
            found = widths.get((factor, name), NOT_FOUND) if factor != 1.0 else fit.importance
            rows.append(
                PriorWidthRow(
                    variant=name,
                    factor=factor,
                    log_evidence=found.log_evidence,
                    log_evidence_se=found.standard_error,
                    efficiency=found.efficiency,
                    pareto_k=found.pareto_k,
                )
            )
    table = PriorWidthRow.collect(rows)
    return table.sort_values(["factor", "log_evidence"], ascending=[True, False], ignore_index=True)
