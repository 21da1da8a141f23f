"""The question for the next pose, as the frame runs it."""

from __future__ import annotations

from pathlib import Path

from bayescal.config.load import check_section
from bayescal.errors import InputError
from bayescal.experiments.frame.load import load
from bayescal.experiments.frame.memory import Need, estimate_arrays
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.experiments.next.compute import MOST_ERRORS, compute_next
from bayescal.experiments.next.inputs import NextInputs, read_next
from bayescal.experiments.next.page import build_page
from bayescal.experiments.next.schema import NextConfig
from bayescal.experiments.shared.of_another import OfAnother

DRAWS = 8
"""Arrays of all draws by requirements at every pose of the workspace."""


class NextPose(OfAnother[NextConfig, NextInputs]):
    """After the poses measured so far: which pose to measure next, what it will bring, and whether to stop."""

    schema = NextConfig
    asked_again = True
    read = staticmethod(read_next)
    page = staticmethod(build_page)

    def estimate_memory(self, inputs: NextInputs) -> Need:
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

    def doubt(self, inputs: NextInputs, *, before_run: bool = False) -> list[str]:
        """Return what would explain the poses measured so far many times better than they are."""
        del before_run
        return [] if inputs.slip is None else [inputs.slip.say()]

    def compute(self, inputs: NextInputs, run: Run) -> Results:
        """Return what to do; it is over in seconds, and nothing is kept on the way."""
        del run
        return compute_next(inputs)


def configure_next(path: Path, variants: list[str], required: list[str], seed: int | None) -> NextConfig:
    """Return the question that a file asks, or one of the study in it: for its requirements, or between its variants.

    All variants where none is named, the file's own seed where none is given; requirements are ``NAME=VALUE``, the
    largest error allowed, mm and degrees. InputError for anything at fault in the file, and for what a question's file
    states itself.
    """
    found = load(path)[1]
    if isinstance(found, NextConfig):
        for option, given in (("--variant", variants), ("--require", required)):
            if given:
                raise InputError(f"{option}: found beside {path}, which asks a question itself, expected a study")
        return found if seed is None else found.model_copy(update={"seed": seed})
    limits = {}
    for one in required:
        name, _, value = one.partition("=")
        try:
            limits[name.strip()] = float(value)
        except ValueError as error:
            raise InputError(f"--require: found {one!r}, expected NAME=VALUE such as x=0.05") from error
    content = {
        "study": path.name,
        "name": f"{found.name}_next",
        "title": f"{found.title}: the pose to measure next",
        "seed": found.seed if seed is None else seed,
        "variants": variants,
        "requirements": limits,
        "aim": "requirements" if required else "variants",
    }
    return check_section(NextConfig, content, path, "")
