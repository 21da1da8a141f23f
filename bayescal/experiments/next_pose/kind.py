"""The question for the next pose, as the frame runs it."""

from __future__ import annotations

from pathlib import Path

from bayescal.config.load import check_section
from bayescal.errors import InputError
from bayescal.experiments.next_pose.inputs import MOST_ERRORS, NextPoseInputs, read_next_pose
from bayescal.experiments.next_pose.rows import ROWS
from bayescal.experiments.next_pose.schema import NextPoseConfig
from bayescal.experiments.runner.load import load
from bayescal.experiments.runner.memory import MemoryEstimate, estimate_arrays
from bayescal.experiments.runner.parallel import Run
from bayescal.experiments.runner.results import Results
from bayescal.experiments.shared.derived import DerivedExperiment
from bayescal.report.blocks import Page

DRAWS = 8
"""Arrays of all draws by requirements at every pose of the workspace."""


class NextPose(DerivedExperiment[NextPoseConfig, NextPoseInputs]):
    """After the poses measured so far: which pose to measure next, what it will bring, and whether to stop."""

    schema = NextPoseConfig
    rows = ROWS
    asked_again = True
    read = staticmethod(read_next_pose)

    def page(self, results: Results) -> Page:
        """Return the page."""
        from bayescal.experiments.next_pose.page import build_page  # with matplotlib, for those who make pages

        return build_page(results)

    def estimate_memory(self, inputs: NextPoseInputs) -> MemoryEstimate:
        """Return what candidates take, seen by every variant, and draws over the workspace."""
        first, n_draws = next(iter(inputs.subjects.values())), inputs.config.draws
        return estimate_arrays(
            {"poses": first.n_poses, "candidates": inputs.n_candidates, "draws": n_draws},
            [
                *(one for subject in inputs.subjects.values() for one in subject.list_arrays(n_draws)),
                (DRAWS, min(n_draws * len(first.workspace.values), MOST_ERRORS)),
            ],
            "fewer candidates or draws",
        )

    def list_warnings(self, inputs: NextPoseInputs, *, before_run: bool = False) -> list[str]:
        """Return what would explain the poses measured so far many times better than they are."""
        del before_run
        return [] if inputs.slip is None else [inputs.slip.say()]

    def compute(self, inputs: NextPoseInputs, run: Run) -> Results:
        """Return what to do; it is over in seconds, and nothing is kept on the way."""
        from bayescal.experiments.next_pose.compute import compute_next_pose  # with pandas, for those who compute

        del run
        return compute_next_pose(inputs)


def configure_next_pose(path: Path, variants: list[str], required: list[str], seed: int | None) -> NextPoseConfig:
    """Return the question that a file asks, or one of the study in it: for its requirements, or between its variants.

    All variants where none is named, the file's own seed where none is given; requirements are ``NAME=VALUE``, the
    largest error allowed, mm and degrees. InputError for anything at fault in the file, and for what a question's file
    states itself.
    """
    found = load(path)[1]
    if isinstance(found, NextPoseConfig):
        for option, given in (("--variant", variants), ("--require", required)):
            if given:
                raise InputError(f"{option}: found with {path}, expected a study")
        return found if seed is None else found.model_copy(update={"seed": seed})
    limits = {}
    for one in required:
        name, _, value = one.partition("=")
        try:
            limits[name.strip()] = float(value)
        except ValueError as error:
            raise InputError(f"--require: found {one!r}, expected NAME=VALUE") from error
    content = {
        "study": path.name,
        "name": f"{found.name}_next_pose",
        "title": f"{found.title}: the pose to measure next",
        "seed": found.seed if seed is None else seed,
        "variants": variants,
        "requirements": limits,
        "goal": "requirements" if required else "variants",
    }
    return check_section(NextPoseConfig, content, path, "")
