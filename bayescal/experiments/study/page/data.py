"""What was measured, as a table."""

from __future__ import annotations

from typing import Any

from bayescal.experiments.shared.origin import name_origin
from bayescal.experiments.study.page.results import StudyResults, get_number
from bayescal.report.blocks import Section, Statement, Table, make_pairs
from bayescal.report.numbers import format_fixed

SHOWN_TARGETS = 20
INSTRUMENTS = {"poses": "poses, whole or in part, as an instrument hands them out", "points": "tracked points"}
TARGETS = (
    "χ² per degree of freedom is 1 where the targets scatter about the fitted bodies as their stated noise says; "
    "well above 1 the bodies deform or the noise is larger, well below 1 the noise is smaller than stated."
)
POINTS = (
    "χ² per degree of freedom is 1 where the points of a station scatter about the rigid probe as their stated noise "
    "says; well above 1 the probe deforms or the noise is larger, well below 1 the noise is smaller than stated."
)


def show_data(study: StudyResults) -> Section | None:
    """Return what was measured; None where the facts below the heading say it all."""
    if "pose_extraction" not in study.summary and study.instrument is None:
        return None
    return Section("Data", (tabulate_data(study),), anchor="data")


def tabulate_data(results: StudyResults) -> Table:
    """Return what was measured and how it became poses."""
    summary = results.summary
    rows = [
        ["Origin", name_origin(summary["origin"])],
        ["Calibration poses", str(summary["n_poses"]["calibration"])],
        ["Verification poses", str(summary["n_poses"]["verification"]) if results.n_verification else "none"],
    ]
    if results.instrument is None:
        return make_pairs("Measurements.", rows + _list_targets(summary["pose_extraction"]), [Statement(TARGETS)])
    notes = [Statement(POINTS)] if "points" in results.instrument else []
    return make_pairs("Measurements.", rows + _list_readings(results.instrument, results), notes)


def _list_targets(extraction: dict[str, Any]) -> list[list[str]]:
    rejected = [str(target) for target in extraction["rejected_targets"]]
    return [
        ["Pose extraction", extraction["method"]],
        ["χ² per degree of freedom of the rigid fits", format_fixed(get_number(extraction, "chi2_per_dof"), 3)],
        ["Rejected targets", f"{len(rejected)}: {_shorten(rejected)}" if rejected else "none"],
    ]


def _list_readings(instrument: dict[str, Any], results: StudyResults) -> list[list[str]]:
    """Return what an instrument read: coordinates of poses, or points by stations."""
    kind = str(instrument.get("measurement"))
    rows = [["Instrument", INSTRUMENTS.get(kind, kind)]]
    free = ", ".join(str(frame) for frame in instrument.get("free_frames", []))
    rows.append(["Frames found with the machine", free or "none, all known"])
    if "points" in instrument:
        rows += [
            ["Stations", _shorten([str(name) for name in instrument["stations"]])],
            ["Points on the platform", f"{len(instrument['points'])}: {_shorten(instrument['points'])}"],
            ["Points seen, missed", f"{instrument['n_seen']}, {instrument['n_missed']}"],
            ["χ² per degree of freedom of the rigid fits", format_fixed(get_number(instrument, "chi2_per_dof"), 3)],
        ]
    elif "measured_coordinates" in instrument:
        total = sum(results.summary["n_poses"].values())
        counts = instrument["measured_coordinates"]
        words = [name if count == total else f"{name} ({count} of {total})" for name, count in counts.items() if count]
        rows.append(["Coordinates measured", ", ".join(words)])
    return rows


def _shorten(names: list[str]) -> str:
    return ", ".join(map(str, names[:SHOWN_TARGETS])) + (" …" if len(names) > SHOWN_TARGETS else "")
