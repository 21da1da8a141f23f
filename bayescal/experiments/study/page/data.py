"""What was measured, as a table."""

from __future__ import annotations

from bayescal.experiments.study.page.results import StudyResults, get_number
from bayescal.report.blocks import Statement, Table, make_pairs
from bayescal.report.numbers import format_fixed

SHOWN_TARGETS = 20


def tabulate_data(results: StudyResults) -> Table:
    """Return what was measured and how the poses were extracted."""
    summary = results.summary
    extraction = summary["pose_extraction"]
    rejected = [str(target) for target in extraction["rejected_targets"]]
    listed = ", ".join(rejected[:SHOWN_TARGETS]) + (" …" if len(rejected) > SHOWN_TARGETS else "")
    rows = [
        ["Origin", summary["data_origin"]],
        ["Calibration poses", str(summary["n_poses"]["calibration"])],
        ["Verification poses", str(summary["n_poses"]["verification"]) if results.n_verification else "none"],
        ["Pose extraction", extraction["method"]],
        ["χ² per degree of freedom of the rigid fits", format_fixed(get_number(extraction, "chi2_per_dof"), 3)],
        ["Rejected targets", f"{len(rejected)}: {listed}" if rejected else "none"],
    ]
    note = (
        "χ² per degree of freedom is 1 where the targets scatter about the fitted bodies as their stated noise says; "
        "well above 1 the bodies deform or the noise is larger, well below 1 the noise is smaller than stated."
    )
    return make_pairs("Measurements.", rows, [Statement(note)])
