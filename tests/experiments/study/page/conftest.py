"""Results directories for the tests of the study's page."""

from __future__ import annotations

from functools import partial

import pytest
from made_up_results import write_results


@pytest.fixture
def make_results(tmp_path):
    """Return `write_results` for this test's own directory."""
    return partial(write_results, tmp_path)
