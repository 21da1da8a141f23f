"""Shares of many cases: a few of them in the quick suite, more among the runs, the rest, if any, among the slow."""

from __future__ import annotations

import math
from collections.abc import Iterable

import pytest


def run_rest(cases: Iterable[object], n_quick: int, n_runs: int | None = None) -> list[object]:
    """Return cases of a parametrised test: after the first so many come runs, as many as are said, then slow ones."""
    last = math.inf if n_runs is None else n_quick + n_runs
    marks = {False: pytest.mark.runs, True: pytest.mark.slow}
    return [pytest.param(case, marks=marks[k >= last]) if k >= n_quick else case for k, case in enumerate(cases)]
