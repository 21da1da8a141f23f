"""The page of an experiment on pose selection."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import pandas as pd

from bayescal.experiments.frame.results import Results
from bayescal.experiments.selection.compare import tabulate_pairs
from bayescal.experiments.selection.figures import (
    Quantity,
    draw_errors,
    draw_paired,
    draw_random_sets,
    draw_ratios,
    draw_traces,
)
from bayescal.experiments.selection.schema import SelectionConfig
from bayescal.experiments.selection.tasks import DESIGN
from bayescal.experiments.selection.verdict import PRINTED, Tables, state_headline, state_verdict
from bayescal.experiments.shared.origin import name_origin
from bayescal.report.blocks import Cell, Column, Figure, Page, Section, Statement, Table, make_section, make_table
from bayescal.report.numbers import (
    MINUS,
    NOTHING,
    format_estimate,
    format_fixed,
    format_plain,
    format_scientific,
    format_significant,
)

KIND = "Pose selection"
INDICES = ("O1", "O2", "O3", "O4", "O5")
SMALL = 1e-2


def build_page(config: SelectionConfig, results: Results) -> Page:
    """Return the page of an experiment's results."""
    tables = Tables.of(config, results)
    sections = [
        *_published_section(tables),
        *_trace_section(tables),
        *_random_section(tables),
        *_error_sections(tables),
        *_design_section(tables),
        _chosen_section(tables),
        _method_section(results.summary["n_parameters"], tables),
    ]
    return Page(
        KIND,
        config.name,
        config.title,
        name_origin(config.origin.model_dump()),
        state_headline(tables),
        tuple(state_verdict(tables)),
        tuple(sections),
        (("Machine", results.summary["machine"]), ("Candidates", _describe_candidates(config, results))),
    )


def _describe_candidates(config: SelectionConfig, results: Results) -> str:
    section = config.candidates
    how = {
        "random": "at random",
        "even": f"evenly on a grid of {section.levels} levels",
        "factorial": "on a full factorial",
    }
    where = "the actuators' range" if config.domain.within == "actuators" else "the workspace"
    if config.domain.position_mm is not None and config.domain.rotation_deg is not None:
        position, rotation = (
            " × ".join(f"±{format_plain(x)}" for x in halves)
            for halves in (config.domain.position_mm, config.domain.rotation_deg)
        )
        where += f", {position} mm, {rotation} deg"
    again = "; other ones in each repeat" if section.redraw else ""
    measured = results.summary["n_measured"]
    beside = "" if measured is None else f"; besides {measured} poses measured already"
    return f"{section.count} {how[section.spread]} of {where}{again}{beside}"


def _estimate(mean: float, sd: float) -> str:
    """Return mean ± sd of a number of any size; the mean alone without an sd."""
    if not sd > 0:
        return _plain(mean)
    if mean == 0.0 or abs(mean) >= SMALL:
        return format_estimate(mean, sd)
    power = -math.floor(math.log10(abs(mean)))
    return f"({format_estimate(mean * 10.0**power, sd * 10.0**power)})e{MINUS}{power}"


def _plain(value: float) -> str:
    if value == 0.0 or abs(value) >= SMALL:
        return format_significant(value, 4)
    return format_scientific(value, 4)


def _published_section(tables: Tables) -> list[Section]:
    table = tables.published
    if table.empty or tables.config.published is None:
        return []
    columns = [
        Column("Method", kind="text"),
        Column("Index", kind="text"),
        Column("Poses"),
        Column("printed", group="published"),
        Column("best", group="found"),
        Column("mean ± sd", group="found"),
        Column("repeats", group="found"),
        Column("best", "%", "found against published"),
        Column("mean", "%", "found against published"),
    ]
    rows: list[Sequence[str | Cell]] = [
        [
            str(row["label"]),
            str(row["criterion"]),
            str(row["n_poses"]),
            _plain(row["published"]),
            _plain(row["best"]),
            _estimate(row["mean"], row["sd"]),
            str(row["repeats"]),
            Cell(
                format_fixed(100 * (row["ratio"] - 1), 1, sign=True),
                "good" if row["ratio"] > 1.0 - PRINTED else "warning",
            ),
            format_fixed(100 * (row["ratio_of_mean"] - 1), 1, sign=True),
        ]
        for _, row in table.iterrows()
    ]
    figure = Figure(
        "published",
        "Indices found, by those published: best of the repeats, and mean with standard deviation over repeats.",
        partial(draw_ratios, table),
    )
    caption = f"Indices published by {tables.config.published.source} and found here."
    return [make_section("Published and found", (), (make_table(caption, columns, rows),), (figure,))]


def _trace_section(tables: Tables) -> list[Section]:
    """Return the traces of the first number of poses, where there are methods that go on from set to set."""
    section = tables.config.published
    if section is None or not section.iterations or tables.traces.empty:
        return []
    first = tables.traces.iloc[0]
    criterion, n = str(first["criterion"]), int(first["n_poses"])
    rows = tables.selections[(tables.selections["criterion"] == criterion) & (tables.selections["n_poses"] == n)]
    columns = [
        Column("Method", kind="text"),
        Column("iterations", group="published"),
        Column("iterations", group="found"),
        Column(f"{criterion}, first repeat", group="found"),
        Column(f"{criterion}, mean ± sd", group="found"),
    ]
    body = []
    for label, group in rows.groupby("label", sort=False):
        if label in section.iterations:
            steps = group["n_iterations"]
            span = f"{steps.min()} to {steps.max()}" if steps.min() < steps.max() else str(steps.min())
            value = group["value"]
            body.append(
                [
                    str(label),
                    str(section.iterations[str(label)]),
                    span,
                    _plain(value.iloc[0]),
                    _estimate(value.mean(), value.std()),
                ]
            )
    figure = Figure(
        "traces",
        f"{criterion} of {n} poses by iteration: the first repeat thick, the others, with other candidates and another "
        "start, thin.",
        partial(draw_traces, tables.traces, criterion, n, section.iterations),
    )
    table = make_table(f"Iterations and {criterion} of {n} poses.", columns, body)
    return [make_section("The way there", (), (table,), (figure,))]


def _random_section(tables: Tables) -> list[Section]:
    if tables.random_sets.empty:
        return []
    section = tables.config.published
    mean, largest = (None, None) if section is None else (section.random_mean, section.random_max)
    sets = tables.random_sets
    criterion, n = str(sets["criterion"].iloc[0]), int(sets["n_poses"].iloc[0])
    groups = sets.groupby("repeat")["value"]
    columns = [Column("", kind="text"), Column("published"), Column("first draw", group="found")]
    columns.append(Column("mean ± sd over draws", group="found"))
    rows = [
        [
            what,
            NOTHING if published is None else _plain(published),
            _plain(values.iloc[0]),
            _estimate(values.mean(), values.std()),
        ]
        for what, values, published in (("mean", groups.mean(), mean), ("largest", groups.max(), largest))
    ]
    figure = Figure(
        "random_sets",
        f"{criterion} of random sets of {n} poses, first draw.",
        partial(draw_random_sets, sets, criterion, mean, largest),
    )
    return [make_section("Random sets", (), (make_table(f"{criterion} of random sets.", columns, rows),), (figure,))]


def _error_sections(tables: Tables) -> list[Section]:
    if tables.errors.empty:
        return []
    wanted = tables.config.calibrations
    assert wanted is not None
    how = "with the tolerances known to it" if wanted.known else "by least squares weighted by the noise"
    text = (
        f"For each set of poses {wanted.machines} machines were drawn within the tolerances, measured with all noise "
        f"and identified {how}; their poses over the workspace were then predicted and compared with the true ones. "
        "Ways to choose poses are compared repeat by repeat, with the same candidates and machines.",
    )
    summary = tables.error_summary
    own, designs = summary[summary["criterion"] != DESIGN], summary[summary["criterion"] == DESIGN]
    names = list(dict.fromkeys(own["name"]))
    quantities = [Quantity("mean_position_um", "Mean position error, µm", "mean_position_um_sd")]
    if tables.metric == "simulated_share_of_limits":
        label = "Pose error in units of the limits"
        quantities.append(Quantity("simulated_share_of_limits", label, "simulated_share_of_limits_sd"))
    else:
        bars = "simulated_rotation_arcsec_sd"
        quantities.append(Quantity("simulated_rotation_arcsec", "Rms rotation error, arcsec", bars))
    figures = [
        Figure(
            "errors",
            "Simulated pose errors over the workspace against the number of poses: mean and standard deviation over "
            "repeats, each of which is a mean over machines.",
            partial(draw_errors, own, names, designs, quantities),
        )
    ]
    return [
        make_section(
            "Accuracy after calibration",
            text,
            (_tabulate_errors(summary),),
            tuple(figures + _pair_figures(tables)),
            (),
            True,
        )
    ]


def _pair_figures(tables: Tables) -> list[Figure]:
    errors = tables.errors[tables.errors["criterion"] != DESIGN]
    observed = errors[(errors["criterion"] == "O1") & (errors["name"] != "random")]
    if errors["criterion"].nunique() < 2 or observed.empty:
        return []
    reference = str(observed["name"].iloc[0])
    part = "share_of_limits" if tables.metric == "simulated_share_of_limits" else "position_um"
    pairs = tabulate_pairs(errors, reference, part)
    pairs = pairs[pairs["name"] != "random"]
    caption = f"Pose errors by those of {reference} with the same machines: the geometric mean over repeats."
    return [Figure("pairs", caption, partial(draw_paired, pairs, reference))]


def _tabulate_errors(summary: pd.DataFrame) -> Table:
    columns = [Column("Way to choose", kind="text"), Column("Poses")]
    for title, unit in (("Position, rms", "µm"), ("Rotation, rms", "arcsec"), ("In units of the limits, rms", "")):
        columns += [Column("predicted", unit, title), Column("simulated ± se", unit, title)]
    columns += [Column("simulated ± sd", "µm", "Position, mean"), Column("rms", "tolerances", "Parameters")]
    columns.append(Column("failed"))
    rows = []
    for _, row in summary.iterrows():
        cells = [str(row["name"]), str(row["n_poses"])]
        for part in ("position_um", "rotation_arcsec", "share_of_limits"):
            cells.append(format_significant(row[f"predicted_{part}"], 3))
            cells.append(format_estimate(row[f"simulated_{part}"], row[f"simulated_{part}_se"]))
        cells.append(format_estimate(row["mean_position_um"], row["mean_position_um_sd"]))
        cells += [format_significant(row["parameters_rms"], 3), str(row["n_failed"])]
        rows.append(cells)
    return make_table("Pose errors over the workspace after calibration, all repeats together.", columns, rows)


def _design_section(tables: Tables) -> list[Section]:
    given = tables.selections[tables.selections["criterion"] == DESIGN].drop_duplicates("label")
    if given.empty:
        return []
    numbers = set(given["n_poses"])
    columns = [Column("Poses by", kind="text"), Column("Poses"), *(Column(name) for name in INDICES)]
    rows = []
    for _, row in given.iterrows():
        rows.append([str(row["label"]), str(row["n_poses"]), *(_plain(row[name]) for name in INDICES)])
    found = tables.selections[(tables.selections["criterion"] != DESIGN) & tables.selections["n_poses"].isin(numbers)]
    for (label, criterion, n), group in found.groupby(["label", "criterion", "n_poses"], sort=False):
        cells = [_estimate(group[name].mean(), group[name].std()) for name in INDICES]
        rows.append([f"{label}, {criterion}, mean ± sd", str(n), *cells])
    table = make_table("Observability indices of given sets of poses and of those found here.", columns, rows)
    return [make_section("Given sets of poses", (), (table,))]


def _chosen_section(tables: Tables) -> Section:
    columns = [
        Column("Method", kind="text"),
        Column("Criterion", kind="text"),
        Column("Poses"),
        Column("best"),
        Column("mean ± sd"),
        Column("repeats"),
        Column("time", "s, mean", kind="seconds"),
    ]
    seconds = tables.timings.groupby(["label", "criterion", "n_poses"])["seconds"].mean()
    rows = [
        [
            str(row["label"]),
            str(row["criterion"]),
            str(row["n_poses"]),
            _plain(row["best"]),
            _estimate(row["mean"], row["sd"]),
            str(row["repeats"]),
            format_significant(float(seconds.loc[(row["label"], row["criterion"], row["n_poses"])]), 2),
        ]
        for _, row in tables.summary.iterrows()
        if row["criterion"] != DESIGN
    ]
    note = Statement(
        "The best set of each row is in plans/, as a table of actuator displacements in mm that an audit's plan of "
        "kind “file” reads; all poses are in poses.csv."
    )
    table = make_table("Every selection: the criterion, larger is better, and the time of one.", columns, rows)
    return make_section("What was chosen", (), (table,), (), (note,))


def _method_section(n_parameters: int, tables: Tables) -> Section:
    criteria = [[name, *tables.describe("criterion", name)] for name in tables.list_used("criterion")]
    methods = [[*tables.describe("method", name)] for name in tables.list_used("method")]
    of = {
        "pose": "the measured pose, in mm and rad (rotation vector)",
        "angles": "the measured pose, in mm and rad (angles of R = R_z R_y R_x)",
        "closure": "the closure, J_2",
    }[tables.config.jacobian]
    text: tuple[str, ...] = (
        f"Indices O1 to O5 are those of the derivatives of {of}, by {n_parameters} parameters. "
        "Repeats of the same number use the same candidates, start and machines for all ways to choose.",
    )
    if {"exchange", "continuous"} <= set(tables.selections["method"]):
        text += (
            "Exchange knows nothing but its candidates, which may not reach the boundary; continuous optimisation "
            "leaves them. With other candidates the order of the two may be another.",
        )
    tables_ = (
        make_table(
            "Criteria.",
            [Column("Criterion", kind="text"), Column("What it is", kind="text"), Column("Source", kind="text")],
            criteria,
        ),
        make_table("Methods.", [Column("Method", kind="text"), Column("Source", kind="text")], methods),
    )
    return make_section("How it was computed", text, tables_)
