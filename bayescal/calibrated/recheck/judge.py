"""What readings after a calibration say: it holds, or a parameter has shifted, by how much, how probable."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import softmax
from scipy.stats import chi2

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.calibrated.recheck.statistics import Suspects, build_test, compute_knowledge, keep_seen, look_again
from bayescal.density.calibration.measurements import Measurements
from bayescal.numerics.geometry import Array

ODD = 1e-3
"""Probability of what a shift of one parameter leaves over, below which something else has happened."""


@dataclass(frozen=True, eq=False)
class Recheck:
    """What the sessions of a recheck say.

    Attributes
    ----------
    suspects : Suspects
        N parameters, one of which may have shifted.
    holds : bool
        Whether no statistic of any session passed the threshold.
    statistic : ndarray, shape (J, N)
        t of every parameter, the sessions pooled from the first.
    threshold : float
    false_alarm : float
    shift, sd : ndarray, shape (N,)
        Of every parameter as if it alone had shifted, all sessions together, in its unit.
    probability : ndarray, shape (N,)
        That it is this one, where one shifted.
    left_over : float
        With which probability as much is left over by chance, beside the shift of the most probable parameter, where
        the calibration does not hold.
    """

    suspects: Suspects
    holds: bool
    statistic: Array
    threshold: float
    false_alarm: float
    shift: Array
    sd: Array
    probability: Array
    left_over: float

    @property
    def worst(self) -> int:
        """The most probable parameter, counted from zero."""
        return int(np.argmax(self.probability))

    @property
    def is_odd(self) -> bool:
        """Whether what was measured fits neither the calibration nor one shift."""
        return self.left_over < ODD


def judge_recheck(
    calibrated: CalibratedMachine,
    suspects: Suspects,
    sessions: Sequence[Measurements],
    false_alarm: float,
    n_looks: int,
) -> Recheck:
    """Return what sessions say together, a look at each of them.

    Parameters
    ----------
    calibrated : CalibratedMachine
    suspects : Suspects
    sessions : sequence of Measurements
        Readings of all channels, in their order.
    false_alarm : float
        Of all looks together.
    n_looks : int
        Sessions that are planned; at least as many as there are.
    """
    suspects, parts = keep_seen(suspects, [compute_knowledge(calibrated, suspects, one) for one in sessions])
    grams = np.stack([one.gram.sum(axis=0) for one in parts])
    knowledge, pooled = parts[0], np.cumsum(grams, axis=0)
    test = build_test(look_again(knowledge, list(grams), max(n_looks, len(grams))), false_alarm)
    score, information = knowledge.score(pooled)
    own = np.diagonal(information, axis1=1, axis2=2)
    statistic = score / np.sqrt(own)
    holds = bool(np.abs(statistic).max() <= test.threshold)
    square = knowledge.left_over(pooled[-1])
    n_rows = sum(one.n_rows for one in parts)
    explained = 0.0 if holds else float((statistic[-1] ** 2).max())
    odd = chi2.sf(square - explained, n_rows - (not holds))
    return Recheck(
        suspects,
        holds,
        statistic,
        test.threshold,
        false_alarm,
        score[-1] / own[-1],
        1.0 / np.sqrt(own[-1]),
        softmax(0.5 * statistic[-1] ** 2 - 0.5 * np.log(own[-1])),
        float(odd),
    )
