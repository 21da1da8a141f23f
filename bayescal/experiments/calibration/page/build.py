"""The page of a calibration: variants, parameters, accuracy, held-back readings, poses, what to measure next."""

from __future__ import annotations

from typing import Any

import pandas as pd

from bayescal.experiments.calibration.page import figures
from bayescal.experiments.calibration.page.verdict import state_headline, state_verdict
from bayescal.experiments.calibration.tables import choose_best
from bayescal.experiments.shared.diagnostics_table import tabulate_diagnostics
from bayescal.experiments.shared.function_page import judge_functions, show_functions
from bayescal.experiments.shared.joints import MOST_POSES
from bayescal.experiments.shared.judgement_page import tabulate_power_scaling, tabulate_widths
from bayescal.experiments.shared.knowledge_page import VERDICT_LEVELS, show_accuracy, show_next, show_ridges
from bayescal.experiments.shared.machine_scene import AXES, build_line_scene
from bayescal.experiments.shared.origin import name_origin
from bayescal.limits import PARETO_K_LIMIT
from bayescal.report.blocks import (
    Cell,
    Column,
    Figure,
    Page,
    Section,
    make_section,
    make_table,
)
from bayescal.report.numbers import format_estimate, format_fixed, format_percent, format_significant
from bayescal.report.reading import Row, list_rows
from bayescal.report.scene import Triple
from bayescal.report.units import Asked, shown_in

KIND = "Calibration"


def build_page(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> Page:
    """Return the page of an experiment's tables."""
    best, asked = choose_best(summary), summary["units"]
    accuracy = show_accuracy(tables, asked)
    sections = [
        _show_variants(tables, summary),
        _show_parameters(tables, best, asked),
        *show_machine(tables, best),
        *show_functions(tables),
        *([] if accuracy is None else [accuracy]),
        *_show_predictions(tables, best),
        _show_poses(tables, best),
        *_show_judgement(tables, summary, best),
        *show_ridges(tables, best),
        *_show_beside(tables, best, asked),
        *show_next(tables, best, asked),
        _show_method(tables),
    ]
    row = next(row for row in list_rows(tables["variants"]) if row["variant"] == best)
    return Page(
        KIND,
        summary["experiment"],
        summary["title"],
        name_origin(summary["origin"]),
        state_headline(tables, summary),
        (*state_verdict(tables, summary), *judge_functions(tables)),
        tuple(sections),
        (("Machine", str(summary["machine"])), ("Data of the best variant", str(row["data"]))),
    )


def list_variants(tables: dict[str, pd.DataFrame]) -> list[str]:
    """Return what the terminal says of each variant, a line each of at most 80 letters."""
    width = min(34, max(len(str(name)) for name in tables["variants"]["variant"]))
    lines = [f"{'variant':{width}}  free  log-evidence       elpd  inside 90 %  converged"]
    for row in list_rows(tables["variants"]):
        inside = format_percent(row["inside_90"]) if "inside_90" in row else format_percent(None)
        lines.append(
            f"{row['variant']:{width}}  {row['n_parameters']:4d}  {format_fixed(row['log_evidence'], 2):>12}  "
            f"{format_fixed(row['elpd'], 1):>9}  {inside:>11}  {'yes' if row['converged'] else 'NO'}"
        )
    return lines


def _show_variants(tables: dict[str, pd.DataFrame], summary: dict[str, Any]) -> Section:
    columns = [Column("Variant", kind="text"), Column("Readings", kind="text"), Column("Free"), Column("Equations")]
    columns += [Column("Log-evidence"), Column("behind the best"), Column("elpd"), Column("What is left, in noise")]
    columns += [Column("Held-back readings in their 90 % intervals")]
    rows_of = {str(row["variant"]): row for row in list_rows(tables["variants"])}
    rows: list[list[str | Cell]] = []
    for names in summary["rankings"]:
        first = rows_of[names[0]]["log_evidence"]
        for name in names:
            row = rows_of[name]
            inside = format_percent(row.get("inside_90")) if row.get("held_readings") else format_percent(None)
            rows.append(
                [
                    str(row["title"]),
                    str(row["data"]),
                    str(row["n_parameters"]),
                    str(row["n_equations"]),
                    format_estimate(row["log_evidence"], row["log_evidence_se"]),
                    format_fixed(row["log_evidence"] - first, 1),
                    format_fixed(row["elpd"], 1),
                    format_significant(row["misfit"], 2),
                    inside,
                ]
            )
    text = (
        "Evidence says how probable the readings were under a variant before they were taken; it can be compared "
        "where the same readings are taken in. The expected log predictive density (elpd) of held-back poses asks the "
        "same of readings that a variant has not seen.",
    )
    return make_section("Which model", text, (make_table("Variants, best first.", columns, rows),))


def _show_parameters(tables: dict[str, pd.DataFrame], best: str, asked: Asked) -> Section:
    mine = tables["parameters"][tables["parameters"]["variant"] == best]
    columns = [Column("Parameter", kind="text"), Column("Unit", kind="text"), Column("beforehand"), Column("now")]
    columns += [Column("90 % interval"), Column("Contraction"), Column("Told", kind="text")]
    rows: list[list[str | Cell]] = []
    for row in list_rows(mine):
        factor, unit = shown_in(row["unit"], asked)
        verdict = str(row["verdict"])
        rows.append(
            [
                str(row["parameter"]),
                unit,
                format_estimate(factor * row["nominal"], factor * row["prior_sd"]),
                format_estimate(factor * row["mean"], factor * row["sd"]),
                f"{format_significant(factor * row['q05'], 5)} to {format_significant(factor * row['q95'], 5)}",
                format_fixed(row["contraction"], 2),
                Cell("" if verdict == "noise" else verdict, VERDICT_LEVELS[verdict]),
            ]
        )
    titles = dict(zip(tables["variants"]["variant"], tables["variants"]["title"], strict=True))
    figure = Figure(
        "parameters",
        "What remains of each parameter's tolerance.",
        lambda: figures.draw_parameters(tables["parameters"], titles),
    )
    text = ("Contraction is the part of the prior's variance that the readings removed: 0.75 halves the tolerance.",)
    caption = f"Parameters of “{titles[best]}”, mean ± standard deviation."
    return make_section("Parameters", text, (make_table(caption, columns, rows),), (figure,))


def show_machine(tables: dict[str, pd.DataFrame], best: str) -> list[Section]:
    """Return a machine of lines in space, anchors where they were found; nothing of other machines."""
    rows = tables["parameters"][tables["parameters"]["variant"] == best].set_index("parameter")
    n_lines = sum(str(name).startswith("A_x[") for name in rows.index)
    wanted = [[f"A_{axis}[{k}]" for axis in AXES] for k in range(1, n_lines + 1)]
    if not n_lines or not {name for names in wanted for name in names} <= set(rows.index):
        return []
    moved = rows["mean"] - rows["nominal"]
    anchors, offsets, spreads = (
        [_take_triple(column, names) for names in wanted] for column in (rows["nominal"], moved, rows["sd"])
    )
    places = {"origin": (0.0, 0.0, 0.0)}
    poses = tables.get("poses", pd.DataFrame(columns=["variant"]))
    for row in list_rows(poses[poses["variant"] == best][:MOST_POSES]):
        places[f"pose {row['pose']}"] = (float(row["x_mm"]), float(row["y_mm"]), float(row["z_mm"]))
    return [Section("The machine", (build_line_scene(anchors, offsets, spreads, places),), "machine")]


def _take_triple(column: pd.Series, names: list[str]) -> Triple:
    x, y, z = (float(column[name]) for name in names)
    return x, y, z


def _show_predictions(tables: dict[str, pd.DataFrame], best: str) -> list[Section]:
    if "predictions" not in tables:
        return []
    titles = dict(zip(tables["variants"]["variant"], tables["variants"]["title"], strict=True))
    predictions = tables["predictions"].assign(kind=tables["predictions"]["channel"].str.partition("[")[0])
    kinds = list(dict.fromkeys(str(kind) for kind in predictions["kind"]))
    columns = [Column("Variant", kind="text"), *(Column(kind, group="in their 90 % intervals") for kind in kinds)]
    rows: list[list[str | Cell]] = []
    for name, title in titles.items():
        mine = predictions[predictions["variant"] == name]
        counts = [mine[mine["kind"] == kind]["inside"] for kind in kinds]
        rows.append([str(title), *(f"{int(one.sum())} of {len(one)}" if len(one) else "–" for one in counts)])
    mine = predictions[predictions["variant"] == best]
    text = (
        "Each reading of a held-back pose, predicted from the other readings there and from a calibration that has not "
        "seen the pose.",
    )
    shown = (
        ()
        if mine.empty
        else (Figure("predictions", f"Held-back readings, “{titles[best]}”.", lambda: figures.draw_predictions(mine)),)
    )
    return [make_section("Held-back readings", text, (make_table("Coverage.", columns, rows),), shown)]


def _show_judgement(tables: dict[str, pd.DataFrame], summary: dict[str, Any], best: str) -> list[Section]:
    """Return what poses left out, and prior and readings raised to powers, say; nothing of results without them."""
    if "elpd_loo" not in tables["variants"]:
        return []
    titles = dict(zip(tables["variants"]["variant"], tables["variants"]["title"], strict=True))
    rows_of = {str(row["variant"]): row for row in list_rows(tables["variants"])}
    columns = [Column("Variant", kind="text"), Column("elpd", "nat", "Each pose left out")]
    columns += [Column("behind the best", "nat", "Each pose left out"), Column("Weight when stacked", "%")]
    columns += [Column("Largest Pareto k"), Column("Poses sampled again without")]
    columns += [
        Column("residuals", "", "χ² per degree of freedom"),
        Column("deviations", "", "χ² per degree of freedom"),
    ]
    rows: list[list[str | Cell]] = []
    for name in (name for names in summary["rankings"] for name in names):
        row = rows_of[name]
        behind = (row["elpd_loo_difference"], row["elpd_loo_difference_se"])
        k = Cell(format_fixed(row["loo_pareto_k_max"], 2), "warning" if row["loo_unreliable"] else "plain")
        rows.append(
            [
                str(row["title"]),
                format_estimate(row["elpd_loo"], row["elpd_loo_se"]),
                format_estimate(*behind) if any(behind) else "–",
                format_percent(row["stacking_weight"]),
                k,
                str(row["loo_refitted"]),
                *(_per_degree(row[f"{one}_chi2"], row[f"{one}_dof"]) for one in ("misfit", "pulls")),
            ]
        )
    text = (
        "Each pose is predicted by a posterior that has not seen it: by weights of the draws, or by a run of its own "
        f"where their Pareto k exceeds {PARETO_K_LIMIT}. Stacked, the variants predict best with these weights. "
        "Residuals are compared with the stated noise, deviations from nominal with the stated tolerances.",
    )
    power = tables["parameters"][tables["parameters"]["variant"] == best]
    power = power.rename(columns={"prior_sensitivity": "prior", "likelihood_sensitivity": "likelihood"})
    blocks = [make_table("Poses left out, residuals, tolerances.", columns, rows)]
    blocks.append(tabulate_power_scaling(power, "entry"))
    if "sensitivity" in tables:
        caption = "Log-evidence for wider and narrower priors."
        labels = {name: str(titles[name]) for names in summary["rankings"] for name in names}
        blocks.append(tabulate_widths(tables["sensitivity"], labels, Column("Variant", kind="text"), caption))
    return [make_section("How far this is to be trusted", text, blocks)]


def _per_degree(chi2: float, dof: float) -> str:
    return format_fixed(chi2 / dof, 2) if dof > 0 else "–"


def _show_poses(tables: dict[str, pd.DataFrame], best: str) -> Section:
    mine = tables["poses"][tables["poses"]["variant"] == best]
    figure = Figure("poses", "What the best machine leaves of each pose's readings.", lambda: figures.draw_poses(mine))
    columns = [Column("Pose", kind="text"), Column("Equations"), Column("What is left, in noise"), Column("Trust")]
    doubtful = mine[mine["doubtful"]]
    rows: list[list[str | Cell]] = [
        [
            str(row["pose"]),
            str(row["equations"]),
            format_significant((row["square"] / max(1, row["equations"])) ** 0.5, 2),
            format_fixed(row["trust"], 2),
        ]
        for row in list_rows(doubtful)
    ]
    tables_shown = (make_table("Doubtful poses.", columns, rows),) if rows else ()
    text = () if rows else ("No pose is doubtful.",)
    return make_section("Poses", text, tables_shown, (figure,))


def _show_beside(tables: dict[str, pd.DataFrame], best: str, asked: Asked) -> list[Section]:
    if "beside" not in tables:
        return []
    mine = tables["beside"][tables["beside"]["variant"] == best]
    columns = [Column("Quantity", kind="text"), Column("Unit", kind="text"), Column("calibrated"), Column("beside")]
    columns += [Column("Difference"), Column("in deviations")]
    shown = []
    for title, rows in mine.groupby("beside", sort=False):
        lines = [_list_beside(row, asked) for row in list_rows(rows)]
        source = str(rows["source"].iloc[0])
        caption = f"{title}{f' ({source})' if source else ''}. These values stay out of the fit."
        shown.append(make_table(caption, columns, lines))
    return [make_section("Beside other values", (), shown)]


def _list_beside(row: Row, asked: Asked) -> list[str | Cell]:
    factor, unit = shown_in(row["unit"], asked)
    spread = (row["sd"] ** 2 + (row["value_sd"] if row["value_sd"] == row["value_sd"] else 0.0) ** 2) ** 0.5
    away = row["value"] - row["mean"]
    return [
        str(row["quantity"]),
        unit,
        format_estimate(factor * row["mean"], factor * row["sd"]),
        format_significant(factor * row["value"], 6),
        format_significant(factor * away),
        format_fixed(away / spread, 1, sign=True) if spread > 0.0 else "–",
    ]


def _show_method(tables: dict[str, pd.DataFrame]) -> Section:
    text = (
        "Each pose may lie anywhere in the workspace alike and is integrated out, to first order about the one that "
        "explains its readings best; what is left of the readings in the space that no pose reaches is the likelihood. "
        "A robust variant gives each pose a precision of its own, so that a bad one loses its weight. Unknown noise is "
        "a factor on the stated one, lognormal about one beforehand.",
    )
    table = tabulate_diagnostics("Evidence in two ways, and the chains.", list_rows(tables["variants"]))
    return make_section("Method and diagnostics", text, (table,))
