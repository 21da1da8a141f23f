"""The machine in space, what the calibration moved, and how its flexures and its platform deform."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import cycle
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure as Drawing
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter

from bayescal.experiments.shared.joints import MOST_POSES
from bayescal.experiments.shared.machine_scene import AXES, build_line_scene, build_scene, read_joint_columns
from bayescal.experiments.study.page.results import StudyResults
from bayescal.experiments.study.page.styles import DEFORMATION_COLOURS, Styles, assign_styles
from bayescal.experiments.study.rows import PoseRow
from bayescal.report.blocks import Block, Column, Figure, PageSection, Statement, Table, make_table
from bayescal.report.numbers import format_estimate, format_plain, format_significant
from bayescal.report.scene import Scene, Triple
from bayescal.report.style import GREY, INK, PALE, leg_colour

HARDPOINTS = (("a_x", "a_y", "a"), ("b_x", "b_y", "b"))
DEFORMATION_MARKERS = {"none": "o", "linear": "x", "matrix": "^"}
OTHER_MARKERS = ("s", "D", "v", "P")
SMALL_COLUMNS = 3
ONE_DIRECTION = math.radians(8.0)  # between points whose names would overlap
SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")  # ten times faster than mathematical text
ORANGE, BLUE, _ = DEFORMATION_COLOURS.values()
NANOMETRES = 1e3  # in a micrometre
MIN_SHOWN_ERROR_NM = 1e-4  # nm: below, an error is that of the numbers themselves


def show_machine(study: StudyResults) -> PageSection | None:
    """Return the machine's joints or anchors where the variant to use has found them; None of other machines."""
    blocks: list[Block] = [scene for scene in (_build_joints(study), _build_lines(study)) if scene is not None]
    frame = study.geometry[study.geometry["leg"] > 0]
    if {symbol for *symbols, _ in HARDPOINTS for symbol in symbols} <= set(frame["symbol"]):
        blocks.append(_illustrate_joints(study))
    return PageSection("The machine", tuple(blocks), anchor="joints", short="Machine") if blocks else None


def _build_joints(study: StudyResults) -> Scene | None:
    """Return a machine on legs in space; None where its joints are not among the results."""
    if not study.has("joints"):
        return None
    chosen = study.geometry[study.geometry["variant"] == study.chosen]
    moved = chosen.assign(offset=chosen["mean"] - chosen["nominal"])
    offsets, spreads = read_joint_columns(moved, "offset"), read_joint_columns(moved, "sd")
    scene = build_scene(study.table("joints"), offsets, spreads)
    return scene and replace(scene, caption=f"{scene.caption} Found by {study.label(study.chosen)}.")


def _build_lines(study: StudyResults) -> Scene | None:
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
    for row in study.rows(PoseRow, study.chosen)[:MOST_POSES]:
        places[f"pose {row.pose}"] = (row.others["x_mm"], row.others["y_mm"], row.others["z_mm"])
    return build_line_scene(anchors, offsets, spreads, places)


def _take_triple(column: pd.Series, names: list[str]) -> Triple:
    x, y, z = (float(column[name]) for name in names)
    return x, y, z


# --- the joints from above -------------------------------------------------------------------------------------------


def _illustrate_joints(study: StudyResults) -> Figure:
    """Return the joints from above, of the chosen model large."""
    joints, name = locate_joints(study.geometry), "hardpoints"
    first = study.split(study.chosen)[0]
    models = sorted(study.models, key=lambda model: model != first)
    several = " The first model is drawn large." * (len(models) > 1)
    keys = " (circle: none, cross: linear, triangle: matrix)" if "models" in study.summary else ""
    caption = (
        f"Joints from above{study.cite('figures', name)}: black: nominal; markers: posterior{keys}, "
        f"{format_plain(find_magnification(joints))}-fold.{several}"
    )
    variants = {study.label_model(model): study.find(model) for model in models}
    return Figure(name, caption, partial(_draw_joints, joints, variants, assign_styles(study)))


def locate_joints(parameters: pd.DataFrame) -> pd.DataFrame:
    """Return one row per variant, point (a or b) and leg: nominal place x, y, move dx, dy, and sd sx, sy, all mm.

    Parameters
    ----------
    parameters : DataFrame
        Posterior summaries with columns variant, symbol, leg, nominal, mean and sd; a in the base frame, b in the
        platform frame.
    """
    index = ["variant", "leg"]
    frames = []
    for *symbols, point in HARDPOINTS:
        found = []
        for symbol, axis in zip(symbols, "xy", strict=True):
            one = parameters[parameters["symbol"] == symbol].set_index(index)
            moved = one["mean"] - one["nominal"]
            found.append(pd.DataFrame({axis: one["nominal"], f"d{axis}": moved, f"s{axis}": one["sd"]}))
        frames.append(found[0].join(found[1], how="inner").reset_index().assign(point=point))
    return pd.concat(frames, ignore_index=True)


def measure_moves(joints: pd.DataFrame) -> dict[str, float]:
    """Return the rms distance (mm) of each variant's joints from nominal, over all points a and b."""
    square = joints["dx"] ** 2 + joints["dy"] ** 2
    return {str(name): math.sqrt(mean) for name, mean in square.groupby(joints["variant"]).mean().items()}


def find_magnification(joints: pd.DataFrame) -> float:
    """Return a round factor (1, 2 or 5 times a power of ten) that shows the largest move as a third of the radius."""
    radius = float(np.median(np.hypot(joints["x"].to_numpy(), joints["y"].to_numpy())))
    largest = float(np.hypot(joints["dx"], joints["dy"]).max())
    if not (radius > 0 and largest > 0):
        return 1.0
    wanted = 0.35 * radius / largest
    power = 10.0 ** math.floor(math.log10(wanted))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= wanted)


def _draw_joints(joints: pd.DataFrame, models: Mapping[str, Sequence[str]], styles: Styles) -> Drawing:
    """Return the top view of the joints: the first model large, base and platform apart, the others small.

    ``joints`` are those of `locate_joints`, ``models`` the variants of each model by its name (RR-8096 figure 18).
    """
    (first, names), *others = models.items()
    n_rows = math.ceil(len(others) / SMALL_COLUMNS)
    figure = Drawing(figsize=(9.4, 4.9 + 2.9 * n_rows))
    grid = figure.add_gridspec(1 + n_rows, 6, height_ratios=[4.9, *[2.9] * n_rows])
    factor, moves = find_magnification(joints), measure_moves(joints)
    deformations = list(dict.fromkeys(style.deformation for style in styles.values()))
    spare = cycle(OTHER_MARKERS)
    shapes = {deformation: DEFORMATION_MARKERS.get(deformation) or next(spare) for deformation in deformations}
    marks: dict[str, dict[str, Any]] = {}
    for name, style in styles.items():
        marker = style.marker if style.has_own_name else shapes[style.deformation]
        fill = "none" if marker == "o" else style.colour
        marks[name] = {"color": style.colour, "marker": marker, "markerfacecolor": fill, "markeredgewidth": 1.4}

    def list_keys(names: Sequence[str], moves: Mapping[str, float], with_name: bool) -> list[Line2D]:
        handles = []
        for name in (name for name in names if name in moves):
            style = styles[name]
            word = f"{style.label}: " if style.has_own_name else f"{style.deformation}: " if with_name else ""
            label = f"{word}{format_significant(moves[name], 2)} mm"
            handles.append(Line2D([], [], markersize=6, label=label, linestyle="none", **marks[name]))
        return handles

    rows = joints[joints["variant"].isin(list(names))]
    for k, (point, where) in enumerate((("a", "base"), ("b", "platform"))):
        axes = figure.add_subplot(grid[0, 3 * k : 3 * k + 3])
        own = rows[rows["point"] == point]
        _draw_plan(axes, own, {name: marks[name] for name in names}, factor, True)
        model = f"{first}: points" if first else "Points"
        axes.set_title(f"{model} {point} of the {where}, moves magnified {format_plain(factor)} times")
        axes.set_xlabel("x (mm)")
        axes.set_ylabel("y (mm)")
        keys = list_keys(names, measure_moves(own), True)
        axes.legend(handles=keys, loc="center", title="rms move")
    for k, (model, names) in enumerate(others):
        axes = figure.add_subplot(grid[1 + k // SMALL_COLUMNS, 2 * (k % SMALL_COLUMNS) : 2 * (k % SMALL_COLUMNS) + 2])
        own = joints[joints["variant"].isin(list(names))]
        _draw_plan(axes, own, {name: marks[name] for name in names}, factor, False)
        axes.set_title(f"{model}: a and b")
        axes.legend(handles=list_keys(names, moves, False), loc="center", handletextpad=0.2)
    return figure


def _draw_plan(axes: Axes, rows: pd.DataFrame, marks: Mapping[str, dict[str, Any]], factor: float, large: bool) -> None:
    x, y = rows["x"] + factor * rows["dx"], rows["y"] + factor * rows["dy"]
    reach = 1.08 * float(max(np.hypot(x, y).max(), np.hypot(rows["x"], rows["y"]).max()))
    for point, of_point in rows.groupby("point"):
        _draw_nominal(axes, of_point.drop_duplicates("leg"), str(point), reach if large else 0.0)
    for name, mark in marks.items():
        one, colour = rows[rows["variant"] == name], mark["color"]
        ends = one["x"] + factor * one["dx"], one["y"] + factor * one["dy"]
        moves = np.stack([one[["x", "y"]], np.column_stack(ends)], axis=1)
        axes.add_collection(
            LineCollection(list(moves), colors=colour, linewidths=0.9, alpha=0.8, capstyle="projecting")
        )
        if large:
            wide, high = factor * one["sx"], factor * one["sy"]
            axes.hlines(ends[1], ends[0] - wide, ends[0] + wide, color=colour, linewidth=0.8, alpha=0.7)
            axes.vlines(ends[0], ends[1] - high, ends[1] + high, color=colour, linewidth=0.8, alpha=0.7)
        axes.plot(*ends, markersize=7 if large else 4.5, linestyle="none", **mark)
    axes.set_aspect("equal")
    limit = 1.08 * reach if large else reach
    axes.set_xlim(-limit, limit)
    axes.set_ylim(-limit, limit)
    if large:
        axes.grid()
    else:
        axes.set_xticks([])
        axes.set_yticks([])
        axes.spines[:].set_visible(False)


def _draw_nominal(axes: Axes, nominal: pd.DataFrame, point: str, reach: float) -> None:
    """Draw the nominal points, joined in order around the centre, with their names at a reach, if any."""
    outline = nominal.iloc[np.argsort(np.arctan2(nominal["y"], nominal["x"]))]
    line = "-" if point == "a" else "--"
    axes.fill(outline["x"], outline["y"], facecolor="none", edgecolor=PALE if reach else GREY, linewidth=0.8, ls=line)
    axes.plot(nominal["x"], nominal["y"], linestyle="none", marker=".", markersize=5, color=INK)
    for legs, azimuth in _group_by_azimuth(outline) if reach else ():
        words = ", ".join(f"{point}{str(leg).translate(SUBSCRIPTS)}" for leg in sorted(legs))
        x, y = reach * math.cos(azimuth), reach * math.sin(azimuth)
        side = "left" if x > 0 else "right"  # several names are wide and go outwards, off the marks
        align = side if len(legs) > 1 and abs(x) > 0.5 * reach else "center"
        axes.text(x, y, words, ha=align, va="center", fontsize=10)


def _group_by_azimuth(outline: pd.DataFrame) -> list[tuple[list[int], float]]:
    """Return legs in order of azimuth, those in one direction together, each group with its azimuth in radians."""
    groups: list[tuple[list[int], list[float]]] = []
    for leg, azimuth in zip(outline["leg"], np.arctan2(outline["y"], outline["x"]), strict=True):
        if groups and azimuth - groups[-1][1][-1] < ONE_DIRECTION:
            groups[-1][0].append(int(leg))
            groups[-1][1].append(float(azimuth))
        else:
            groups.append(([int(leg)], [float(azimuth)]))
    return [(legs, float(np.mean(azimuths))) for legs, azimuths in groups]


# --- flexures --------------------------------------------------------------------------------------------------------


def show_flexure(study: StudyResults) -> PageSection | None:
    """Return how the end of the longest flexure moves; None where no model has flexures."""
    if not study.has("flexure"):
        return None
    rows, name = choose_flexure(study.table("flexure")), "flexure"
    caption = (
        f"Flexure joint of {format_plain(rows['flexure_length_mm'].iloc[0])} mm bent by δ{study.cite('figures', name)}."
    )
    figure = Figure(name, caption, partial(draw_flexure, rows))
    return PageSection("Flexure joint", (figure,), anchor="flexure", short="Flexure")


def choose_flexure(flexure: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of the longest flexure, by bending angle, with the pivot's error (nm) added."""
    rows = flexure[flexure["flexure_length_mm"] == flexure["flexure_length_mm"].max()].sort_values("bending_deg")
    return rows.assign(pivot_error_nm=NANOMETRES * (rows["along_pivot_um"] - rows["along_beam_um"]))


def draw_flexure(rows: pd.DataFrame) -> Drawing:
    """Return the paths of the flexure's end (left) and the errors of circle and pivot (right) (RR-8096 figure 9).

    Parameters
    ----------
    rows : DataFrame
        From `choose_flexure`: bending_deg, across_um, along_beam_um, along_pivot_um, along_circle_um and the errors
        circle_error_nm and pivot_error_nm.
    """
    figure = Drawing(figsize=(9.4, 3.1))
    left, right = figure.subplots(1, 2)
    left.plot(rows["along_pivot_um"], rows["across_um"], color=ORANGE, linewidth=1.6, label="ideal pivot")
    left.plot(rows["along_beam_um"], rows["across_um"], color=INK, linewidth=1.6, label="bent beam")
    some = rows.iloc[:: max(1, len(rows) // 12)]
    marks = {"markersize": 5.5, "color": "none", "markeredgecolor": BLUE, "label": "circle"}
    left.plot(some["along_circle_um"], some["across_um"], "o", **marks)
    left.set_xlabel("Shortening Δx (µm)")
    left.set_ylabel("Deflection Δy (µm)")
    left.set_title(f"Path to {format_plain(rows['bending_deg'].max())} deg")
    left.set_xlim(left=0)
    left.set_ylim(bottom=0)
    left.legend(loc="lower right")
    left.grid()
    bending = rows["bending_deg"]
    for column, colour, label in (("pivot_error_nm", ORANGE, "ideal pivot"), ("circle_error_nm", BLUE, "circle")):
        error = rows[column].abs()
        shown = error >= MIN_SHOWN_ERROR_NM
        right.plot(bending[shown], error[shown], color=colour, linewidth=1.6)
        if shown.any():
            last = float(error.iloc[-1])
            text = f"{label}: {format_significant(last, 2)} nm"
            right.annotate(text, (float(bending.iloc[-1]), last), (-4, -24), textcoords="offset points", ha="right")
    right.set_yscale("log")
    right.yaxis.set_major_formatter(FuncFormatter(lambda value, _: format_plain(value)))
    right.set_xlim(left=0)
    right.set_xlabel("Bending δ (deg)")
    right.set_ylabel("Distance from beam (nm)")
    right.set_title("Approximation error")
    right.grid()
    return figure


# --- deformation of the platform -------------------------------------------------------------------------------------


def show_deformation(study: StudyResults) -> PageSection | None:
    """Return what targets at the joints show; None where there are none by design, on struts or without targets."""
    if not study.has("joint_deflection") and (study.has_struts or "pose_extraction" not in study.summary):
        return None
    name = "deflections"
    caption = f"Deflection of platform joints{study.cite('figures', name)}. Open: verification; line: κ; bars: 1 sd."
    figure = Figure(name, caption, None, "no targets at the joints")
    if study.has("joint_deflection"):
        figure = Figure(
            name, caption, partial(_draw_deflections, study.table("joint_deflection"), study.table("deformation"))
        )
    tables, statements = tabulate_deformation(study)
    blocks: list[Block] = [*statements, figure, *tables]
    return PageSection("Platform deformation", tuple(blocks), anchor="deformation", short="Deformation")


def tabulate_deformation(study: StudyResults) -> tuple[list[Table], list[Statement]]:
    """Return κ and K from the targets on the platform, and how well each describes the measured deflections."""
    if not study.has("deformation") or not study.has("joint_deflection"):
        return [], []
    frame = study.table("deformation")
    kappa = frame[frame["quantity"] == "kappa"].set_index("leg")
    matrix = frame[frame["quantity"] == "K"]
    tables = [
        make_table(
            f"κ in Δb_z = κ Δρ{study.cite('notation', 'kappa')}, mean ± sd.",
            [Column("", kind="symbol"), *(Column(f"leg {leg}", "10⁻³") for leg in kappa.index)],
            [["kappa", *map(format_estimate, kappa["mean_permille"], kappa["sd_permille"])]],
        )
    ]
    slopes = {"linear": np.diag(kappa["mean_permille"].to_numpy())}
    if len(matrix):
        mean, sd = (matrix.pivot(index="leg", columns="actuator", values=v) for v in ("mean_permille", "sd_permille"))
        slopes["matrix"] = mean.to_numpy()
        tables.append(
            make_table(
                f"K in Δb_z = K Δρ{study.cite('notation', 'K')}, mean ± sd; row: joint, column: actuator.",
                [Column("Joint", kind="text"), *(Column(f"actuator {j}", "10⁻³") for j in mean.columns)],
                [[f"leg {i}", *map(format_estimate, mean.loc[i], sd.loc[i])] for i in mean.index],
            )
        )
    statements = []
    for use, rows in study.table("joint_deflection").groupby("use", sort=True):
        travel, measured = (
            rows.pivot(index="pose", columns="leg", values=column).to_numpy()
            for column in ("actuator_displacement_mm", "deflection_um")
        )
        residuals = {name: np.abs(measured - travel @ slope.T) for name, slope in slopes.items()}  # 1e-3 of mm is µm
        described = "; ".join(
            f"residuals, {name}: mean {format_significant(float(np.mean(left)), 2)} µm, largest "
            f"{format_significant(float(np.max(left)), 2)} µm"
            for name, left in residuals.items()
        )
        noise = format_significant(float(rows["deflection_sd_um"].mean()), 2)
        reach = format_significant(float(np.max(np.abs(measured))), 2)
        text = f"{use} poses: joints deflect up to {reach} µm; {described}"
        statements.append(Statement(f"{text}; measuring sd {noise} µm."))
    return tables, statements


def _draw_deflections(ring: pd.DataFrame, deformation: pd.DataFrame) -> Drawing:
    """Return the measured deflection of each leg's joint against its own actuator, with the linear fit."""
    legs = sorted(set(ring["leg"]))
    n_columns = min(3, len(legs))
    n_rows = math.ceil(len(legs) / n_columns)
    figure = Drawing(figsize=(9.4, 0.3 + 1.85 * n_rows))
    grid = figure.subplots(n_rows, n_columns, sharex=True, sharey=True, squeeze=False)
    kappa = deformation[deformation["quantity"] == "kappa"].set_index("leg")
    for axes, leg in zip(grid.ravel(), legs, strict=False):
        _draw_leg(axes, ring[ring["leg"] == leg], kappa.loc[leg], leg)
    for axes in grid.ravel()[len(legs) :]:
        axes.set_axis_off()
    figure.supxlabel("Displacement Δρ of the actuator (mm)", fontsize=9)
    figure.supylabel("Deflection along z (µm)", fontsize=9)
    return figure


def _draw_leg(axes: Axes, rows: pd.DataFrame, kappa: pd.Series, leg: int) -> None:
    colour = leg_colour(leg)
    for use, fill in (("calibration", colour), ("verification", "white")):
        chosen = rows[rows["use"] == use]
        travel, deflection, sd = (chosen[c] for c in ("actuator_displacement_mm", "deflection_um", "deflection_sd_um"))
        axes.vlines(travel, deflection - sd, deflection + sd, color=colour, linewidth=0.8)
        axes.plot(travel, deflection, "o", markersize=4, color=fill, markeredgecolor=colour)
    ends = np.array([rows["actuator_displacement_mm"].min(), rows["actuator_displacement_mm"].max()])
    axes.plot(ends, kappa["mean_permille"] * ends, color=INK, linewidth=1.3)  # 1e-3 mm per mm is µm per mm
    axes.set_title(f"Leg {leg}: κ = ({format_estimate(kappa['mean_permille'], kappa['sd_permille'])})·10⁻³")
    axes.grid()
