"""The question for the next pose as a kind of experiment."""

from __future__ import annotations

from pathlib import Path

from bayescal.experiments.frame.memory import Need, estimate_arrays
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.experiments.next_pose.compute import MOST_ERRORS, compute_next
from bayescal.experiments.next_pose.inputs import NextInputs, read_next
from bayescal.experiments.next_pose.page import build_page
from bayescal.experiments.next_pose.schema import NextConfig
from bayescal.experiments.shared.of_another import OfAnother
from bayescal.report.blocks import Page

DRAWS = 8
"""Arrays of all draws by requirements at every pose of the workspace."""


class NextPose(OfAnother[NextConfig, NextInputs]):
    """After the poses measured so far: which pose to measure next, what it will bring, and whether to stop."""

    schema = NextConfig

    def read(self, config: NextConfig, folder: Path) -> NextInputs:
        """Return the study's variants with the poses measured so far."""
        return read_next(config, folder)

    def estimate_memory(self, inputs: NextInputs) -> Need:
        """Return what candidates take, seen by every variant, and draws over the workspace."""
        first, n_draws = next(iter(inputs.subjects.values())), inputs.config.draws
        return estimate_arrays(
            {"poses": first.n_poses, "candidates": inputs.n_candidates, "draws": n_draws},
            [
                *(one for subject in inputs.subjects.values() for one in subject.list_arrays(n_draws)),
                (DRAWS, min(n_draws * first.n_workspace, MOST_ERRORS)),
            ],
            "fewer candidates or draws",
        )

    def doubt(self, inputs: NextInputs) -> list[str]:
        """Return what would explain the poses measured so far many times better than they are."""
        return [] if inputs.slip is None else [inputs.slip.say()]

    def compute(self, inputs: NextInputs, run: Run) -> Results:
        """Return what to do; it is over in seconds, and nothing is kept on the way."""
        del run
        return compute_next(inputs)

    def page(self, results: Results) -> Page:
        """Return the page."""
        return build_page(results)
