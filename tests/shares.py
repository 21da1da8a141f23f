"""Shares of many cases: a few of them in the quick suite, all others among the runs."""

from __future__ import annotations

from collections.abc import Iterable

import pytest


def run_rest(cases: Iterable[object], n_quick: int) -> list[object]:
    """Return cases of a parametrised test, of which all but the first so many are marked as runs."""
    return [pytest.param(case, marks=pytest.mark.runs) if k >= n_quick else case for k, case in enumerate(cases)]
