"""Sessions as a kind of experiment."""

from __future__ import annotations

import numpy as np

from bayescal.experiments.runner.memory import MemoryEstimate, estimate_arrays
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.runner.results import Results
from bayescal.experiments.sessions.inputs import SessionsInputs, count_kept, read_sessions
from bayescal.experiments.sessions.rows import ROWS
from bayescal.experiments.sessions.schema import SessionsConfig
from bayescal.experiments.shared.derived import DerivedExperiment
from bayescal.report.blocks import Page

JOINT, JACOBIANS, DRAWS, SCRATCH = 12, 8, 6, 24
"""Arrays of all unknowns by each other, of all rows by one session's, of draws by all unknowns, and of each session's
hot loop, which keeps what it works in.
"""

BATCH, POSES = 256, 128  # machines, and their poses, at a time


class Sessions(DerivedExperiment[SessionsConfig, SessionsInputs]):
    """One machine measured again and again, or machines of one design: what moved, by how much, how sure."""

    schema = SessionsConfig
    rows = ROWS
    tables_in = "tables"
    read = staticmethod(read_sessions)

    def compute(self, inputs: SessionsInputs, run: Run) -> Results:
        """Return what moved between sessions."""
        from bayescal.experiments.sessions.compute import compute_sessions  # with pandas, for those who compute

        return compute_sessions(inputs, run)

    def page(self, results: Results) -> Page:
        """Return the page."""
        from bayescal.experiments.sessions.page import build_page  # with matplotlib, for those who make pages

        return build_page(results)

    def list_warnings(self, inputs: SessionsInputs, *, before_run: bool = False) -> list[str]:
        """Return whether temperatures are stated that nothing is made of."""
        del before_run
        if inputs.config.thermal is not None or not np.isfinite(inputs.temperature).any():
            return []
        return ["temperatures without [thermal]: their effect counts as drift"]

    def estimate_memory(self, inputs: SessionsInputs) -> MemoryEstimate:
        """Return what the joint model of all sessions takes."""
        model, draws = inputs.model, inputs.config.draws
        n_parameters, n_poses = len(model.mean), int(inputs.n_poses.sum())
        n_legs = model.parts[0].rows.width
        at_once = int(np.minimum(inputs.n_poses, POSES).sum())
        return estimate_arrays(
            {"sessions": model.n_sessions, "poses": n_poses, "parameters": n_parameters, "draws": draws},
            [
                (JOINT, model.size, model.size),
                (JACOBIANS, n_poses, n_legs, n_parameters + n_legs),
                (DRAWS, count_kept(draws), model.size),
                (SCRATCH, BATCH, at_once, n_legs),
            ],
            "fewer sessions, poses or draws",
        )

    def list_failures(self, results: Results) -> list[str]:
        """Return which models have weights that cannot be relied on."""
        poor = [name for name, reliable in results.summary["reliable"].items() if not reliable]
        return [f"Pareto k too large: {', '.join(poor)}"] if poor else []
