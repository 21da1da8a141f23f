"""The machine in space, with what the calibration moved."""

from __future__ import annotations

from dataclasses import replace

import pandas as pd

from bayescal.experiments.shared.joints import MOST_POSES
from bayescal.experiments.shared.machine_scene import AXES, build_line_scene, build_scene, read_joint_columns
from bayescal.experiments.study.page.illustrations import illustrate_flexure, illustrate_joints
from bayescal.experiments.study.page.results import StudyResults
from bayescal.experiments.study.page.variants import label_variant
from bayescal.report.blocks import Block, Section
from bayescal.report.scene import Scene, Triple


def show_machine(study: StudyResults) -> Section | None:
    """Return the machine's joints or anchors where the variant to use has found them; None of other machines."""
    blocks: list[Block] = [scene for scene in (_draw_joints(study), _draw_lines(study)) if scene is not None]
    if study.has("pose_errors"):
        blocks.append(illustrate_joints(study))
    return Section("The machine", tuple(blocks), anchor="joints", short="Machine") if blocks else None


def _draw_joints(study: StudyResults) -> Scene | None:
    """Return a machine on legs in space; None where its joints are not among the results."""
    if not study.has("joints"):
        return None
    frame = study.parameters
    chosen = frame[(frame["variant"] == study.chosen) & (frame["model_error"] == "free")]
    moved = chosen.assign(offset=chosen["mean"] - chosen["nominal"])
    offsets, spreads = read_joint_columns(moved, "offset"), read_joint_columns(moved, "sd")
    scene = build_scene(study.table("joints"), offsets, spreads)
    if scene is None:
        return None
    return replace(scene, caption=f"{scene.caption} Found by {label_variant(study, study.chosen)}.")


def _draw_lines(study: StudyResults) -> Scene | None:
    """Return a machine of lines in space, anchors where they were found; None of other machines."""
    rows = study.table("parameters", study.chosen).set_index("parameter")
    n_lines = sum(str(name).startswith("A_x[") for name in rows.index)
    wanted = [[f"A_{axis}[{k}]" for axis in AXES] for k in range(1, n_lines + 1)]
    if not n_lines or not {name for names in wanted for name in names} <= set(rows.index):
        return None
    moved = rows["mean"] - rows["nominal"]
    anchors, offsets, spreads = (
        [_take_triple(column, names) for names in wanted] for column in (rows["nominal"], moved, rows["sd"])
    )
    places = {"origin": (0.0, 0.0, 0.0)}
    for row in study.rows("poses", study.chosen)[:MOST_POSES]:
        places[f"pose {row['pose']}"] = (float(row["x_mm"]), float(row["y_mm"]), float(row["z_mm"]))
    return build_line_scene(anchors, offsets, spreads, places)


def _take_triple(column: pd.Series, names: list[str]) -> Triple:
    x, y, z = (float(column[name]) for name in names)
    return x, y, z


def show_flexure(study: StudyResults) -> Section | None:
    """Return how a flexure joint moves; None where no model has flexures."""
    if not study.has("flexure"):
        return None
    figure = illustrate_flexure(study, study.table("flexure"))
    return Section("Flexure joint", (figure,), anchor="flexure", short="Flexure")
