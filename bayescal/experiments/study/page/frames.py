"""The frames of instrument and tool that a calibration had to find."""

from __future__ import annotations

from bayescal.experiments.study.page.results import StudyResults
from bayescal.experiments.study.page.variants import VARIANT, label_variant
from bayescal.report.blocks import Column, Section, make_table
from bayescal.report.numbers import count_decimals, format_estimate, format_significant

TEXT = (
    "Where the instrument's frame lies against the base and the probe's against the platform was not known; both were "
    "found with the machine. A frame and the joints that move with it are distinguished by their tolerances alone, so "
    "that a frame may stay as uncertain as before though every pose is predicted well."
)


def show_frames(results: StudyResults) -> Section | None:
    """Return the frames found, with model error, beside what was known of them; None where all were known."""
    rows = results.frames
    rows = rows[rows["model_error"] == "free"]
    if rows.empty:
        return None
    symbols = list(dict.fromkeys(rows["symbol"]))
    columns = [VARIANT]
    cells = {name: [label_variant(results, name)] for name in results.ranking}
    before = ["known before"]
    for symbol in symbols:
        chosen = rows[rows["symbol"] == symbol].set_index("variant")
        factor, unit = results.scale_of(symbol, str(chosen["unit"].iloc[0]))
        columns.append(Column(symbol, unit, symbolic=True))
        before.append(f"± {format_significant(factor * float(chosen['prior_sd'].iloc[0]), 2)}")
        places = min(4, count_decimals(factor * float(chosen["sd"].min())))
        for name in results.ranking:
            one = chosen.loc[name]
            cells[name].append(format_estimate(factor * one["mean"], factor * one["sd"], places, sign=True))
    caption = "Frames found, posterior mean ± sd; displacements along and rotation vectors about the axes."
    return Section("Frames", (TEXT, make_table(caption, columns, [*cells.values(), before])), anchor="frames")
