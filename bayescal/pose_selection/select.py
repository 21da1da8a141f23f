"""One door to all methods: a name in, poses out."""

from __future__ import annotations

import numpy as np
from threadpoolctl import threadpool_limits

from bayescal.errors import InputError
from bayescal.pose_selection.methods import METHODS, Selection, SelectionMethod
from bayescal.pose_selection.problem import SelectionProblem


def select(problem: SelectionProblem, method: str | SelectionMethod, rng: np.random.Generator) -> Selection:
    """Return the poses that a method selects.

    Parameters
    ----------
    problem : SelectionProblem
    method : str or SelectionMethod
        A name of `METHODS`, with its usual options, or a method with its own.
    rng : Generator
        The only source of chance.

    Raises
    ------
    InputError
        For an unknown name, or where the method cannot work on the problem.
    """
    if isinstance(method, str):
        if method not in METHODS:
            raise InputError(f"method: found {method!r}, expected one of {', '.join(METHODS)}")
        method = METHODS[method]()
    with threadpool_limits(1):  # many small matrices: more threads only wait for each other
        return method.select(problem, rng)
