"""Little effort for runs in this process, for tests of what runs write and not of what they find."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

LITTLE = {
    "inference.exploration.MAX_PILOTS": 0,
    "inference.exploration.MAX_ROUNDS": 0,
    "inference.exploration.TRIAL_DRAWS": 100,
    "inference.exploration.PILOT_BURN_IN": 10,  # of chains whose clusters stand beside a proposal with heavy tails
    "inference.exploration.PILOT_STEPS": 20,
    "inference.mode.N_SCATTERED": 1,
    "inference.chain_checks.N_DRAWS": 500,  # draws from farther out, which look for what the proposal lacks
    "inference.leave_one_out.MAX_REFITS": 0,  # unreliable rows keep what their weights say
    "experiments.study.readings.POSE_DRAWS": 50,
    "experiments.shared.slip_search.FINAL": 3,  # few of what may have happened to readings are fitted
    "experiments.shared.slip_search.EACH": 1,
}


@contextmanager
def searching_little() -> Iterator[None]:
    """Let runs sample from Laplace's approximation as it is, and look for nothing beyond it."""
    with pytest.MonkeyPatch.context() as patched:
        for name, value in LITTLE.items():
            patched.setattr(f"bayescal.{name}", value)
        yield
