"""What data can determine, to first order about the nominal machine: said before anything is computed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from bayescal.identifiability.directions import judge_parameters
from bayescal.identifiability.information import information_of_rows
from bayescal.limits import IDENTIFIABLE_CONTRACTION, UNIDENTIFIABLE_CONTRACTION
from bayescal.numerics.geometry import Array
from bayescal.report.numbers import format_count, join_words

NAMED = 6


def describe_determinacy(counted: str, rows: Array, names: Sequence[str]) -> str:
    """Return in a line how many combinations of parameters data determine, and how many stay at their tolerances.

    Parameters
    ----------
    counted : str
        How many readings there are for how many unknowns, in words.
    rows : ndarray, shape (..., m)
        Slope of the readings by the parameters in their tolerances, in units of the noise, poses eliminated.
    names : sequence of str
        Of the m parameters.
    """
    information = information_of_rows(rows, np.ones(len(names)))
    values, _ = information.spectrum()
    contraction = values / (1.0 + values)
    known, dead = (
        int(np.sum(contraction >= IDENTIFIABLE_CONTRACTION)),
        int(np.sum(contraction < UNIDENTIFIABLE_CONTRACTION)),
    )
    weak, m = len(names) - known - dead, len(names)
    if known == m:
        every = {1: "the one combination", 2: "both combinations"}.get(m, f"all {format_count(m)} combinations")
        return f"{counted}: {every} will be determined"
    parts = [f"{known} of {m} combinations will be determined"]
    parts += [f"{weak} hardly"] if weak else []
    parts += [f"{dead} {'stay at their tolerances' if dead > 1 else 'stays at its tolerance'}"] if dead else []
    verdicts = judge_parameters(information, np.empty((m, 0)))
    lost = [name for name, verdict in zip(names, verdicts, strict=True) if verdict == "not"]
    lost = lost or [name for name, verdict in zip(names, verdicts, strict=True) if verdict != "identifiable"]
    if len(lost) > NAMED:
        lost = list(dict.fromkeys(name.partition("[")[0] for name in lost))
    return f"{counted}: {join_words(parts)}{f'; least known: {_list(lost)}' if lost else ''}"


def join_outlooks(told: Mapping[str, str]) -> list[str]:
    """Return what is said of variants by name, those of which the same is said in one line."""
    groups: dict[str, list[str]] = {}
    for name, text in told.items():
        groups.setdefault(text, []).append(repr(name))
    return [f"variant{'s' * (len(names) > 1)} {_list(names)}: {text}" for text, names in groups.items()]


def _list(names: Sequence[str]) -> str:
    shown = list(names[:NAMED])
    return ", ".join([*shown, f"{len(names) - NAMED} more"] if len(names) > NAMED else shown)
