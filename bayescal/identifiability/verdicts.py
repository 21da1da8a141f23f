"""The verdict on each parameter: whether measurements determine it."""

from __future__ import annotations

from typing import Literal

from bayescal.identifiability.information import Information, complement_of
from bayescal.limits import DEAD, INFORMED
from bayescal.numerics.geometry import Array

type Verdict = Literal["identifiable", "weak", "not"]


def judge_parameters(information: Information, null_space: Array) -> tuple[Verdict, ...]:
    """Return the verdict on each parameter.

    ``identifiable``: its tolerance is at least halved. ``not``: most of what is left unknown lies along directions of
    which nothing is learnt. ``weak``: it lies along directions of which too little is learnt.
    """
    values, vectors = information.spectrum(complement_of(null_space))
    remaining = vectors**2 / (1.0 + values)
    dead = (null_space**2).sum(axis=1) + remaining[:, values / (1.0 + values) < DEAD].sum(axis=1)
    verdicts: list[Verdict] = []
    for contraction, lost in zip(information.contraction, dead, strict=True):
        if contraction >= INFORMED:
            verdicts.append("identifiable")
        else:
            verdicts.append("not" if lost > 0.5 * (1.0 - contraction) else "weak")
    return tuple(verdicts)
