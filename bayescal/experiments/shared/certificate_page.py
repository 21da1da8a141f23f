"""The page of a certificate: what is sure, how sure, where from, and what it does not cover."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from matplotlib import figure as mpl

from bayescal.calibrated.accuracy import GEOMETRY, PoseFigures
from bayescal.calibrated.machine import MATRIX, MODEL, NOISE
from bayescal.experiments.shared.certify import AGREED, BOUND, Certificate
from bayescal.experiments.shared.headline import say_accuracy, write_headline
from bayescal.machines.readings import Legs
from bayescal.numerics.geometry import Array
from bayescal.report.blocks import (
    Cell,
    Column,
    Definitions,
    Figure,
    Page,
    Section,
    Statement,
    Table,
    make_table,
)
from bayescal.report.numbers import format_percent, format_significant
from bayescal.report.style import LEG_COLOURS

KIND = "Certificate"
SOURCES = {
    GEOMETRY: "geometry (the posterior of the calibration)",
    NOISE: "noise of the actuators, as stated",
    MODEL: "model error τ, what the model leaves unexplained",
    MATRIX: "deformation matrix, as measured",
}
COLOURS = dict(zip(SOURCES, (LEG_COLOURS[4], LEG_COLOURS[1], LEG_COLOURS[0], LEG_COLOURS[3]), strict=True))
STATED = {"_um": "µm", "_mm": "mm", "_arcsec": "arcsec", "_deg": "°", "_rad": "rad", " noise": ""}
"""Endings of keys that state standard deviations, and their units."""
HELD_BACK = "from the data's held-back poses"
PREDICTED = "predicted"
MUCH_BEYOND = 0.05
"""Share of poses beyond those that calibrated the machine from which on it is said."""


def build_certificate(found: Certificate) -> Page:
    """Return the page of a certificate."""
    source = found.calibrated.source
    failures = tuple(Statement(f"Not converged, certified by force: {one}.", "bad") for one in source.problems)
    return Page(
        kind=KIND,
        name=source.experiment,
        title=f"Uncertainty of a calibrated machine: {found.calibrated.name}",
        origin=source.data,
        headline=state_headline(found),
        verdict=tuple(_state_verdict(found)),
        sections=(
            Section("What is certified", (_tabulate_subject(found),), "subject", "Subject"),
            Section("Budget by source", (_tabulate_budget(found), _plot_shares(found)), "budget", "Budget"),
            Section("Figures of ISO 9283 and ISO 230-2", _show_figures(found), "figures", "Figures"),
            Section("Inputs and software", _list_inputs(found), "inputs", "Inputs"),
            Section("How it was computed", (Definitions(_explain(found)),), "method", "Method"),
        ),
        failures=failures,
        failures_title="Do not rely on this certificate",
    )


def state_headline(found: Certificate) -> str:
    """Return the expanded uncertainty of the tool's position, of all its numbers where it has none, in one sentence."""
    typical, largest = _summarise(found, found.expanded)
    chosen = _choose_main(found)
    unit = found.units[chosen[0]]
    each = say_accuracy({found.axis_names[k]: f"±{_micro(typical[k])} {unit}" for k in chosen}, found.wishes.coverage)
    what = "Position" if len(found.calibrated.lengths) else "Tool"
    if not found.calibrated.model.states_tool:
        what = "Coordinates"
    worst = f"at the worst pose ±{_micro(largest[chosen].max())} {unit}"
    return write_headline([f"{what}: {each}, root mean square {found.where}; {worst}"])


def _choose_main(found: Certificate) -> list[int]:
    """Return the places of the tool's lengths; those of its first unit where it has none."""
    lengths = [int(k) for k in found.calibrated.lengths]
    return lengths or [k for k, unit in enumerate(found.units) if unit == found.units[0]]


def _micro(value: float) -> str:
    return format_significant(float(value), 2)


def _summarise(found: Certificate, values: Array) -> tuple[Array, Array]:
    """Return rms and largest of values (P, m) over the workspace, in the units in which they are stated."""
    return np.sqrt(np.mean(values**2, axis=0)) * found.scale, np.abs(values).max(axis=0) * found.scale


# --- the verdict -------------------------------------------------------------------------------------------------


def _state_verdict(found: Certificate) -> list[Statement]:
    shares = _find_shares(found)
    main = _choose_main(found)
    first = max(shares, key=lambda source: shares[source][main].mean())
    share = format_percent(float(shares[first][main].mean()))
    worst = found.ratios[np.argmax(np.abs(found.ratios - 1.0))] - 1.0
    said = (
        f"k u and Monte Carlo by {found.spread.n_draws} draws of the posterior differ by {100 * worst:+.1f} % at most"
    )
    statements = [
        Statement(
            f"{_begin(SOURCES[first])} makes {share} of the variance of position."
            if len(found.calibrated.lengths)
            else f"{_begin(SOURCES[first])} makes {share} of the variance.",
            "plain",
            "Where it comes from",
        ),
        Statement(f"{said}, within {format_percent(AGREED)}: k u is stated.", "good", "Checked")
        if found.agrees
        else Statement(f"{said}: what is stated is that of Monte Carlo.", "warning", "Checked"),
    ]
    return _state_tool(found) + _state_beyond(found) + statements + _state_held_back(found)


def _state_tool(found: Certificate) -> list[Statement]:
    model = found.calibrated.model
    if model.states_tool:
        return []
    names = ", ".join(one.name for one in model.coordinates)
    return [
        Statement(
            f"The machine's class states no tool: its coordinates {names} are certified instead.", "warning", "Tool"
        )
    ]


def _state_beyond(found: Certificate) -> list[Statement]:
    if found.beyond <= MUCH_BEYOND:
        return []
    return [
        Statement(
            f"{format_percent(found.beyond)} of the poses lie outside of the box of the poses that calibrated the "
            "machine: there the uncertainty is extrapolated by the model, and mostly larger. Certify the region that "
            "was measured (leave out --whole-range, --position-mm and --rotation-deg), or measure poses there.",
            "warning",
            "Extrapolated",
        )
    ]


def _begin(words: str) -> str:
    return words[:1].upper() + words[1:]


def _find_fit(found: Certificate) -> dict[str, object]:
    fit: dict[str, object] = found.summary.get("variants", {}).get(found.calibrated.source.variant, {})
    return fit


def _state_held_back(found: Certificate) -> list[Statement]:
    held_back, n = _find_fit(found).get("verification"), found.summary.get("n_poses", {}).get("verification", 0)
    if not isinstance(held_back, dict) or not n:
        return []
    inside = held_back["interval_90_coverage"]
    return [
        Statement(
            f"{format_percent(inside)} of the pose components of {n} held-back poses lie within their 90 % intervals.",
            "good" if abs(inside - 0.9) <= 3 * np.sqrt(0.09 / (6 * n)) else "warning",
            "Confirmed by held-back data",
        )
    ]


# --- tables ------------------------------------------------------------------------------------------------------


def _tabulate_subject(found: Certificate) -> Table:
    calibrated, main = found.calibrated, _choose_main(found)
    low, high = found.budget.tool.min(axis=0), found.budget.tool.max(axis=0)
    span = "; ".join(f"{found.axis_names[k]} {low[k]:.4g} to {high[k]:.4g}" for k in main)
    span += f" {calibrated.model.tool_channels[main[0]].unit}"
    rows = [
        *_describe_machine(found),
        ("Model", f"{calibrated.source.variant} of experiment {calibrated.source.experiment}"),
        ("Uncertain parameters", str(len(calibrated.free))),
        ("Workspace", f"{len(found.budget.commands)} poses {found.where}: {span}"),
        ("Data", calibrated.source.data),
    ]
    return make_table("", [Column("What", kind="text"), Column("", kind="text")], rows)


def _find_shares(found: Certificate) -> dict[str, Array]:
    """Return the share of each source in the variance, mean over the workspace, shapes (m,)."""
    total = (found.budget.sd() ** 2).mean(axis=0)
    return {source: (found.budget.sd(source) ** 2).mean(axis=0) / total for source in found.budget.parts}


def _tabulate_budget(found: Certificate) -> Table:
    columns = [
        Column("Source", kind="text"),
        *(Column(*one) for one in zip(found.axis_names, found.units, strict=True)),
    ]

    def write(title: str, values: Array) -> list[str | Cell]:
        return [title, *(_micro(value) for value in values)]

    rows = [write(SOURCES[source], _summarise(found, found.budget.sd(source))[0]) for source in found.budget.parts]
    rows.append(write("combined standard uncertainty u", _summarise(found, found.budget.sd())[0]))
    percent = format_percent(found.wishes.coverage)
    rows.append(
        write(f"expanded, k = {found.factor:.2f} ({percent})", _summarise(found, found.factor * found.budget.sd())[0])
    )
    rows.append(write(f"expanded, Monte Carlo ({percent})", _summarise(found, found.spread.half_width)[0]))
    rows.append(write("stated expanded uncertainty U", _summarise(found, found.expanded)[0]))
    rows.append(write("stated U at the worst pose", _summarise(found, found.expanded)[1]))
    radius = float(np.sqrt(np.mean(found.spread.radius**2))) * 1e3
    notes = [
        Statement(
            f"{percent} of positions lie within {_micro(radius)} µm of the stated one in any direction (Monte Carlo, "
            f"root mean square over {len(found.spread.radius)} poses)."
        )
        if len(found.calibrated.lengths)
        else Statement(f"Monte Carlo: root mean square over {len(found.spread.radius)} poses."),
        Statement(
            "Instrument frame: nothing is added. Poses are those in the base frame of the machine; whoever measures "
            "in another frame adds the uncertainty of where that frame is."
        ),
    ]
    return make_table("Standard uncertainties by source, root mean square over the workspace", columns, rows, notes)


def _describe_machine(found: Certificate) -> list[tuple[str, str]]:
    """Return what is certified, and of which machine."""
    calibrated, model = found.calibrated, found.calibrated.model
    if isinstance(model, Legs):
        mechanism = model.machine.mechanism
        measurand = "pose of the platform's frame in the base frame at given actuator positions, without a load"
        words = f"{mechanism.name}, {mechanism.n_legs} legs, actuators ±{mechanism.actuator_range:g} mm"
        return [("Measurand", measurand), ("Machine", words)]
    what = "tool" if model.states_tool else "coordinates"
    measurand = f"{what} {', '.join(found.axis_names)} at given commands {', '.join(model.commanded)}"
    typical = ", ".join(f"{name} = {value[0]:.4g}" for name, value in calibrated.typical(1).items())
    rows = [("Measurand", measurand), ("Machine", calibrated.name)]
    return rows + ([("At", f"{typical}, the median of the poses that calibrated it")] if typical else [])


def _show_figures(found: Certificate) -> tuple[Table | Statement, ...]:
    if found.poses is None:
        return (Statement(f"Not meaningful: {found.without}.", "plain", "Figures"),)
    return (_tabulate_figures(found, found.poses),)


def _tabulate_figures(found: Certificate, poses: PoseFigures) -> Table:
    columns = [
        Column("Figure", kind="text"),
        Column("expected", "µm"),
        Column(f"with {format_percent(BOUND)} at most", "µm"),
        Column("Label", kind="text"),
    ]
    rows = list[list[str | Cell]]()

    def add(title: str, values: Array) -> None:
        ends = (values.mean() * 1e3, np.quantile(values, BOUND) * 1e3)
        rows.append([title, *(_micro(one) for one in ends), PREDICTED])

    shape = ("line", "square", "cube")[len(found.calibrated.lengths) - 1]
    edge = f"{shape} of {found.cube_mm:g} mm about home"
    add(f"ISO 9283 pose accuracy AP, worst of five poses in a {edge}", poses.accuracy.max(axis=1))
    add("ISO 9283 pose repeatability RP, worst of five poses, 30 cycles", poses.repeatability.max(axis=1))
    for name, axis in zip([found.axis_names[k] for k in found.calibrated.lengths], found.axes, strict=True):
        add(f"ISO 230-2 accuracy A of {name}, one direction", axis.accuracy)
        add(f"ISO 230-2 systematic deviation E of {name}, one direction", axis.systematic)
        add(f"ISO 230-2 repeatability R of {name}, one direction", axis.repeatability)
    held_back = _find_fit(found).get("verification")
    if isinstance(held_back, dict):
        error = held_back["position_error_mm"]
        mean, largest = (_micro(error[key] * 1e3) for key in ("mean", "max"))
        rows.append(["position error, mean and largest of the held-back poses", mean, largest, HELD_BACK])
    notes = [
        Statement(
            "Predicted figures are those of machines of the posterior commanded by the calibrated one. They hold "
            "neither friction, backlash and reversal nor drift and temperature, which only a measurement of the "
            "standards' own cycles shows."
        )
    ]
    return make_table("", columns, rows, notes)


def _list_inputs(found: Certificate) -> tuple[Table, ...]:
    provenance = found.provenance
    columns = [Column("Input", kind="text"), Column("", kind="text")]
    if not provenance:
        row = ("exported machine", "its results, which name files and versions, are not beside it")
        return (make_table("", columns, [row]),)
    config, known = provenance["config"], dict[str, Any]()
    for name, section in (("", config.get("data", {})), *config.get("sensors", {}).items()):
        pairs = section.items() if isinstance(section, dict) else ()
        known |= {f"{name} {key}".strip(): value for key, value in pairs}
    stated = [
        (f"{key[: -len(ending)].replace('_', ' ')}", f"{value:g} {unit}")
        for key, value in known.items()
        for ending, unit in STATED.items()
        if key.endswith(ending) and isinstance(value, int | float)
    ]
    stated.append(("seed", str(provenance["seed"])))
    stated += [(name, version) for name, version in provenance["versions"].items()]
    files = [(name, digest) for name, digest in provenance["files"].items()]
    return (
        make_table(
            "Files by their SHA-256", [Column("File", kind="name"), Column("SHA-256", kind="text")], files, style="wide"
        ),
        make_table("Standard deviations as stated, and versions", columns, stated),
    )


# --- the figure and the method -----------------------------------------------------------------------------------


def _plot_shares(found: Certificate) -> Figure:
    caption = "Share of each source in the variance of each axis, mean over the workspace."
    return Figure("budget", caption, partial(draw_shares, _find_shares(found), found.axis_names))


def draw_shares(shares: dict[str, Array], names: tuple[str, ...]) -> mpl.Figure:
    """Return stacked bars of what each source has of each axis's variance."""
    figure = mpl.Figure(figsize=(6.4, 2.6), layout="constrained")
    axes, left = figure.subplots(), np.zeros(len(names))
    for source, share in shares.items():
        axes.barh(names, 100 * share, left=left, color=COLOURS[source], label=source, height=0.7)
        left += 100 * share
    axes.invert_yaxis()
    axes.set_xlim(0.0, 100.0)
    axes.set_xlabel("Share of the variance in %")
    figure.legend(loc="outside upper left", ncols=len(shares))
    return figure


def _explain(found: Certificate) -> tuple[tuple[str, str], ...]:
    return (
        (
            "Where do the standard uncertainties come from?",
            "The posterior of the calibration gives the uncertainty of the geometry (type A, with tolerances as type B "
            "through their priors); noise is taken as stated (type B). The kinematics turn both into poses: the law "
            "of propagation of uncertainty (JCGM 100, section 5).",
        ),
        (
            "Why k, and why Monte Carlo?",
            f"k = {found.factor:.2f} holds {format_percent(found.wishes.coverage)} of a normal quantity. Draws of the "
            "posterior go through the kinematics as they are, bent ridges and all (JCGM 101). Where both differ by "
            f"more than {format_percent(AGREED)}, Monte Carlo's interval is stated.",
        ),
        (
            "What is not covered?",
            "Load, temperature, drift since the calibration, friction and backlash, unless the model has them. Whether "
            "the calibration still holds is a question of its own.",
        ),
    )
