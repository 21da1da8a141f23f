"""What a certificate of a calibrated machine states, from the machine and the results it comes from, and its page."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import figure as mpl

from bayescal.calibrated.accuracy import (
    AXIS_CYCLES,
    CYCLES,
    GEOMETRY,
    AxisFigures,
    Budget,
    MonteCarloSpread,
    PoseFigures,
    Region,
    check_standards,
    compute_budget,
    coverage_factor,
    draw_cycles,
    enclose_measured,
    enclose_workspace,
    find_largest_cube,
    fit_cube,
    judge_axis,
    judge_poses,
    list_axis_poses,
    list_cube_poses,
    measure_beyond,
    place_lengths,
    propagate,
    sample_range,
    sample_region,
)
from bayescal.calibrated.drawn_machines import AlignedMachine, align_over
from bayescal.calibrated.machine import MATRIX, MODEL, NOISE, CalibratedMachine
from bayescal.calibrated.predict import check_determined
from bayescal.errors import InputError
from bayescal.experiments.runner.results import PROVENANCE_FILE, SUMMARY_FILE, Summary
from bayescal.experiments.shared.headline import say_accuracy, write_headline
from bayescal.experiments.shared.soundness import span_shares
from bayescal.files.atomic import read_json
from bayescal.limits import COVERAGE
from bayescal.numerics.geometry import Array
from bayescal.report.blocks import Cell, Column, Definitions, Figure, Page, PageSection, Statement, Table, make_table
from bayescal.report.numbers import format_percent, format_significant
from bayescal.report.style import LEG_COLOURS

AGREED = 0.02
"""How far the expanded uncertainty k u may be from that of the draws before the latter is stated."""
BOUND = 0.95  # share of machines of the posterior whose figure of merit is not larger
SHOWN = {"mm": (1e3, "µm"), "rad": (1e6, "µrad")}
"""Factors and units in which uncertainties are stated, by inner units."""
N_CHECKED = 64  # poses that draws go through
SOURCES = {
    GEOMETRY: "geometry (posterior)",
    NOISE: "stated actuator noise",
    MODEL: "model error",
    MATRIX: "deformation matrix",
}
KNOWN_SOURCES = SOURCES | {
    GEOMETRY: "geometry and systematic errors",
    MODEL: "random model error",
}
"""The same of a machine whose systematic errors are known."""
COLOURS = dict(zip(SOURCES, (LEG_COLOURS[4], LEG_COLOURS[1], LEG_COLOURS[0], LEG_COLOURS[3]), strict=True))
STATED = {"_um": "µm", "_mm": "mm", "_arcsec": "arcsec", "_deg": "°", "_rad": "rad", " noise": ""}
"""Endings of keys that state standard deviations, and their units."""
MUCH_BEYOND = 0.05
"""Share of poses beyond those that calibrated the machine from which on it is said."""


@dataclass(frozen=True)
class CertificateOptions:
    """What a certificate is to state."""

    coverage: float = 0.95  # probability of the expanded uncertainty
    n_poses: int = 512  # of the workspace
    n_draws: int = 2000  # of the posterior, at most
    cube_mm: float | None = None  # of ISO 9283; by default the largest about home within reach and within the region
    seed: int = 0
    region: Region | None = None  # by default that of the poses that calibrated the machine, where they are known
    full_range: bool = False  # all over its range instead


@dataclass(frozen=True, eq=False)
class Certificate:
    """What is certified."""

    calibrated: CalibratedMachine
    wishes: CertificateOptions
    budget: Budget
    factor: float  # k of the law of propagation
    spread: MonteCarloSpread  # by Monte Carlo, of the first poses of the budget
    cube_mm: float  # zero where figures of the standards have no meaning
    poses: PoseFigures | None  # ISO 9283 of each machine of the posterior, (S, 5)
    axes: tuple[AxisFigures, ...]  # ISO 230-2 along the tool's lengths, of each machine, (S,)
    summary: Summary  # of the results, as is the provenance; empty for a machine that was exported
    provenance: dict[str, Any]
    region: Region | None = None  # where; None for all over the actuators' range
    beyond: float = 0.0  # share of its poses outside of the box of those that calibrated the machine
    without: str = ""  # why there are no figures of the standards, in words
    # covariances without alignment, where all else is stated with base and tool aligned; None where it is not
    unaligned: Budget | None = None

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Names of the tool's numbers."""
        return tuple(one.name for one in self.calibrated.model.tool_channels)

    @property
    def sources(self) -> dict[str, str]:
        """What uncertainty comes from, in words, by source."""
        return SOURCES if self.calibrated.functions is None else KNOWN_SOURCES

    @property
    def units(self) -> tuple[str, ...]:
        """Units in which they are stated."""
        return tuple(SHOWN.get(one.unit, (1.0, one.unit))[1] for one in self.calibrated.model.tool_channels)

    @property
    def scale(self) -> Array:
        """How many of these make an inner one, shape (m,)."""
        return np.array([SHOWN.get(one.unit, (1.0, ""))[0] for one in self.calibrated.model.tool_channels])

    @property
    def where(self) -> str:
        """What is certified, in words."""
        return "over the actuator range" if self.region is None else f"over {self.region.words}"

    @property
    def ratios(self) -> Array:
        """The expanded uncertainty k u over that of the draws, per axis, rms over the poses of both, shape (m,)."""
        checked = self.factor * self.budget.sd()[: len(self.spread.half_width)]
        return np.asarray(_rms(checked) / _rms(self.spread.half_width))

    @property
    def agrees(self) -> bool:
        """Whether k u may be stated."""
        return bool(np.all(np.abs(self.ratios - 1.0) <= AGREED))

    @property
    def expanded(self) -> Array:
        """Expanded uncertainty of each pose, (P, m): k u, or as much more or less as the draws say."""
        expanded = self.factor * self.budget.sd()
        return np.asarray(expanded if self.agrees else expanded / self.ratios)

    @property
    def expanded_unaligned(self) -> Array | None:
        """Expanded uncertainty k u of each pose without alignment, (P, m); None where nothing is aligned."""
        return None if self.unaligned is None else self.factor * self.unaligned.sd()

    def summarise(self, values: Array) -> tuple[Array, Array]:
        """Return rms and largest of values (P, m) over the workspace, in the units in which they are stated."""
        return _rms(values) * self.scale, np.abs(values).max(axis=0) * self.scale

    def list_figures(self) -> Summary:
        """Return what is stated as numbers for files: µm and µrad, root mean squares over the workspace."""

        def name(values: Array) -> dict[str, float]:
            return dict(zip(self.axis_names, (float(f"{one:.6g}") for one in values), strict=True))

        typical, largest = self.summarise(self.expanded)
        unaligned = self.expanded_unaligned
        alike: dict[str, list[str]] = {}
        for one, unit in zip(self.axis_names, self.units, strict=True):
            alike.setdefault(unit, []).append(one)
        return {
            "experiment": self.calibrated.source.experiment,
            "variant": self.calibrated.source.variant,
            "data_origin": self.calibrated.source.data,
            "problems": list(self.calibrated.source.problems),
            "coverage": self.wishes.coverage,
            "poses": len(self.budget.commands),
            "workspace": self.where,
            "accuracy_frame": "base" if unaligned is None else "aligned",
            "share_extrapolated": float(f"{self.beyond:.4g}"),
            "unit": {", ".join(names): unit for unit, names in alike.items()},
            "standard_uncertainty": {
                **{source: name(self.summarise(self.budget.sd(source))[0]) for source in self.budget.parts},
                "combined": name(self.summarise(self.budget.sd())[0]),
            },
            "coverage_factor": float(f"{self.factor:.6g}"),
            "expanded_uncertainty": {
                "stated": name(typical),
                "largest": name(largest),
                **({} if unaligned is None else {"unaligned": name(self.summarise(unaligned)[0])}),
                "monte_carlo": name(self.summarise(self.spread.half_width)[0]),
                "propagated_over_monte_carlo": name(self.ratios),
                "method": "k u" if self.agrees else "Monte Carlo",
            },
        }


def _rms(values: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def certify(calibrated: CalibratedMachine, path: Path, wishes: CertificateOptions) -> Certificate:
    """Return what a certificate states of a calibrated machine, loaded from a directory.

    Raises
    ------
    InputError
        Without draws of the posterior, where commands do not tell the pose, or where the cube is out of reach.
    """
    check_determined(calibrated)
    known = enclose_measured(calibrated)
    everywhere = enclose_workspace(calibrated)
    region = everywhere if wishes.full_range else wishes.region or known or everywhere
    if region is None:
        commands = sample_range(calibrated, wishes.n_poses, wishes.seed)
    else:
        commands = sample_region(calibrated, region, wishes.n_poses, wishes.seed)
    given = calibrated.typical(len(commands))
    aligned = align_over(calibrated, commands, given) if calibrated.aligned else None
    budget = compute_budget(calibrated, commands, given, aligned)
    checked = {name: value[:N_CHECKED] for name, value in given.items()}
    effort = wishes.coverage, wishes.n_draws, wishes.seed + 1
    spread = propagate(calibrated, commands[:N_CHECKED], *effort, checked, aligned)
    without = check_standards(calibrated)
    if without and wishes.cube_mm is not None:
        raise InputError(f"cube: not meaningful: {without}")
    cube, poses, axes = (0.0, None, ()) if without else _judge(calibrated, wishes, region, budget, aligned)
    files = [path / name for name in (SUMMARY_FILE, PROVENANCE_FILE)]
    summary, provenance = (read_json(one) if one.is_file() else {} for one in files)
    return Certificate(
        calibrated,
        wishes,
        budget,
        coverage_factor(wishes.coverage),
        spread,
        cube,
        poses,
        axes,
        summary,
        provenance,
        region,
        measure_beyond(calibrated, commands, known),
        without,
        None if aligned is None else compute_budget(calibrated, commands, given),
    )


def _judge(
    calibrated: CalibratedMachine,
    wishes: CertificateOptions,
    region: Region | None,
    budget: Budget,
    aligned: AlignedMachine | None,
) -> tuple[float, PoseFigures, tuple[AxisFigures, ...]]:
    """Return the edge of a cube about home, and the standards' figures of poses and axes in it."""
    home = calibrated.model.tool_values(calibrated.theta, calibrated.model.home_pose)
    within = np.inf if region is None else find_largest_cube(calibrated, region, budget.tool)
    cube, n = wishes.cube_mm or fit_cube(calibrated, home, within or np.inf), len(calibrated.lengths)
    effort = (wishes.n_draws, wishes.seed + 2)
    visited = draw_cycles(
        calibrated, place_lengths(calibrated, home, list_cube_poses(cube, n)), CYCLES, *effort, aligned
    )
    axes = []
    for axis in range(n):
        poses = place_lengths(calibrated, home, list_axis_poses(cube, axis, n))
        axes.append(judge_axis(draw_cycles(calibrated, poses, AXIS_CYCLES, *effort, aligned)[..., axis]))
    return cube, judge_poses(visited), tuple(axes)


def build_certificate(found: Certificate) -> Page:
    """Return the page of a certificate."""
    source = found.calibrated.source
    failures = tuple(Statement(f"Not converged: {one}.", "bad") for one in source.problems)
    figures: Table | Statement = Statement(f"Not meaningful: {found.without}.", "plain", "Figures")
    if found.poses is not None:
        figures = _tabulate_figures(found, found.poses)
    caption = "Share of the variance by source."
    shares = Figure("budget", caption, partial(draw_shares, _find_shares(found), found.axis_names))
    return Page(
        kind="Certificate",
        name=source.experiment,
        title=f"Calibrated machine: {found.calibrated.name}",
        origin=source.data,
        headline=state_headline(found),
        verdict=tuple(_state_verdict(found)),
        sections=(
            PageSection("Subject", (_tabulate_subject(found),), "subject", "Subject"),
            PageSection("Uncertainty budget", (_tabulate_budget(found), shares), "budget", "Budget"),
            PageSection("ISO figures", (figures,), "figures", "Figures"),
            PageSection("Inputs", _list_inputs(found), "inputs", "Inputs"),
            PageSection("Method", (Definitions(_explain(found)),), "method", "Method"),
        ),
        failures=failures,
    )


def state_headline(found: Certificate) -> str:
    """Return the expanded uncertainty of the tool's position, of all its numbers where it has none, in one sentence."""
    typical, largest = found.summarise(found.expanded)
    chosen = _choose_main(found)
    unit = found.units[chosen[0]]
    each = say_accuracy({found.axis_names[k]: f"±{_micro(typical[k])} {unit}" for k in chosen}, found.wishes.coverage)
    what = "Position" if found.calibrated.model.places_tool else "Tool"
    if not found.calibrated.model.states_tool:
        what = "Coordinates"
    worst = f"at the worst pose ±{_micro(largest[chosen].max())} {unit}"
    unaligned, frame = found.expanded_unaligned, ""
    if unaligned is not None:
        base = found.summarise(unaligned)[0]
        own = ", ".join(f"{found.axis_names[k]} ±{_micro(base[k])} {unit}" for k in chosen)
        differ = any(_micro(base[k]) != _micro(typical[k]) for k in chosen)
        frame = f" with base and tool aligned{f' (unaligned {own})' if differ else ''}"
    return write_headline([f"{what}: {each}, root mean square {found.where}{frame}; {worst}"])


def _choose_main(found: Certificate) -> list[int]:
    """Return the places of the tool's lengths; those of its first unit where it has none."""
    lengths = [int(k) for k in found.calibrated.lengths]
    return lengths or [k for k, unit in enumerate(found.units) if unit == found.units[0]]


def _micro(value: float) -> str:
    return format_significant(float(value), 2)


# --- the verdict -------------------------------------------------------------------------------------------------


def _state_verdict(found: Certificate) -> list[Statement]:
    model, shares, main, said = found.calibrated.model, _find_shares(found), _choose_main(found), list[Statement]()
    if not model.states_tool:
        names = ", ".join(one.name for one in model.coordinates)
        text = f"No tool in the class: coordinates {names} are certified."
        said.append(Statement(text, "warning", "Tool"))
    if found.beyond > MUCH_BEYOND:
        text = f"{format_percent(found.beyond)} of the poses are extrapolated."
        action = "Omit --full-range, or measure poses there."
        said.append(Statement(text, "warning", "Extrapolated", action=action))
    first = max(shares, key=lambda source: shares[source][main].mean())
    text = f"{found.sources[first]}: {format_percent(float(shares[first][main].mean()))} of the variance"
    text += " of position." if model.places_tool else "."
    said.append(Statement(f"{text[:1].upper()}{text[1:]}", "plain", "Main source"))
    worst = found.ratios[np.argmax(np.abs(found.ratios - 1.0))] - 1.0
    text = f"Monte Carlo ({found.spread.n_draws} draws) differs from k u by {100 * worst:+.1f} %"
    if found.agrees:
        said.append(Statement(f"{text} (limit {format_percent(AGREED)}): k u is stated.", "good", "Checked"))
    else:
        said.append(Statement(f"{text}: the Monte Carlo result is stated.", "warning", "Checked"))
    held_back, n = _find_held_back(found), found.summary.get("n_poses", {}).get("verification", 0)
    if held_back and n:
        inside = held_back["interval_90_coverage"]
        text = f"{format_percent(inside)} of {n} verification poses lie within 90 % intervals."
        low, high = span_shares(COVERAGE, n)
        good = low <= inside <= high
        said.append(Statement(text, "good" if good else "warning", "Verified"))
    return said


def _find_held_back(found: Certificate) -> Summary:
    fit = found.summary.get("variants", {}).get(found.calibrated.source.variant, {})
    held_back = fit.get("verification")
    return held_back if isinstance(held_back, dict) else {}


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

    rows = [write(found.sources[source], found.summarise(found.budget.sd(source))[0]) for source in found.budget.parts]
    rows.append(write("combined u", found.summarise(found.budget.sd())[0]))
    percent = format_percent(found.wishes.coverage)
    rows.append(
        write(f"expanded, k = {found.factor:.2f} ({percent})", found.summarise(found.factor * found.budget.sd())[0])
    )
    rows.append(write(f"expanded, Monte Carlo ({percent})", found.summarise(found.spread.half_width)[0]))
    rows.append(write("stated U", found.summarise(found.expanded)[0]))
    rows.append(write("U, worst pose", found.summarise(found.expanded)[1]))
    unaligned = found.expanded_unaligned
    if unaligned is not None:
        rows.append(write("U without alignment", found.summarise(unaligned)[0]))
    radius = float(np.sqrt(np.mean(found.spread.radius**2))) * 1e3
    notes = [
        Statement(f"{percent} of positions lie within {_micro(radius)} µm (Monte Carlo, rms).")
        if found.calibrated.model.places_tool
        else Statement("Monte Carlo: rms."),
        Statement(
            "In the base frame; add your instrument's frame uncertainty."
            if unaligned is None
            else "After best-fit frame alignment."
        ),
    ]
    return make_table("Standard uncertainty by source, rms", columns, rows, notes)


def _describe_machine(found: Certificate) -> list[tuple[str, str]]:
    """Return what is certified, and of which machine."""
    calibrated, model = found.calibrated, found.calibrated.model
    if model.legs is not None:
        mechanism = model.legs.machine.mechanism
        measurand = "platform pose at given actuator positions, unloaded"
        words = f"{mechanism.name}, {mechanism.n_legs} legs, actuators ±{mechanism.actuator_range:g} mm"
        return [("Measurand", measurand), ("Machine", words)]
    what = "tool" if model.states_tool else "coordinates"
    measurand = f"{what} {', '.join(found.axis_names)} at given commands {', '.join(model.commanded)}"
    typical = ", ".join(f"{name} = {value[0]:.4g}" for name, value in calibrated.typical(1).items())
    rows = [("Measurand", measurand), ("Machine", calibrated.name)]
    return rows + ([("At", f"{typical} (median)")] if typical else [])


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
        rows.append([title, *(_micro(one) for one in ends), "predicted"])

    shape = ("line", "square", "cube")[len(found.calibrated.lengths) - 1]
    edge = f"{shape} of {found.cube_mm:g} mm about home"
    add(f"ISO 9283 pose accuracy AP, {edge}", poses.accuracy.max(axis=1))
    add("ISO 9283 pose repeatability RP", poses.repeatability.max(axis=1))
    for name, axis in zip([found.axis_names[k] for k in found.calibrated.lengths], found.axes, strict=True):
        add(f"ISO 230-2 accuracy A of {name}", axis.accuracy)
        add(f"ISO 230-2 systematic deviation E of {name}", axis.systematic)
        add(f"ISO 230-2 repeatability R of {name}", axis.repeatability)
    held_back = _find_held_back(found)
    if held_back:
        error = held_back["position_error_mm"]
        mean, largest = (_micro(error[key] * 1e3) for key in ("mean", "max"))
        rows.append(
            [
                "position error, verification poses: mean, largest",
                mean,
                largest,
                "measured",
            ]
        )
    notes = [Statement("Predicted. Excludes friction, backlash, drift and temperature.")]
    return make_table("", columns, rows, notes)


def _list_inputs(found: Certificate) -> tuple[Table, ...]:
    provenance = found.provenance
    columns = [Column("Input", kind="text"), Column("", kind="text")]
    if not provenance:
        row = ("exported machine", "results not available")
        return (make_table("", columns, [row]),)
    config, known = provenance["config"], dict[str, Any]()
    for name, section in (*(("", one) for one in config.get("data", [])), *config.get("sensors", {}).items()):
        known |= {f"{name} {key}".strip(): value for key, value in section.items()}
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
            "SHA-256 of files", [Column("File", kind="name"), Column("SHA-256", kind="text")], files, style="wide"
        ),
        make_table("Stated standard deviations, versions", columns, stated),
    )


# --- the figure and the method -----------------------------------------------------------------------------------


def draw_shares(shares: dict[str, Array], names: tuple[str, ...]) -> mpl.Figure:
    """Return stacked bars of what each source has of each axis's variance."""
    figure = mpl.Figure(figsize=(6.4, 2.6), layout="constrained")
    axes, left = figure.subplots(), np.zeros(len(names))
    for source, share in shares.items():
        axes.barh(names, 100 * share, left=left, color=COLOURS[source], label=source, height=0.7)
        left += 100 * share
    axes.invert_yaxis()
    axes.set_xlim(0.0, 100.0)
    axes.set_xlabel("Share of variance (%)")
    figure.legend(loc="outside upper left", ncols=len(shares))
    return figure


def _explain(found: Certificate) -> tuple[tuple[str, str], ...]:
    return (
        (
            "Standard uncertainties",
            "Geometry: posterior (type A; priors type B). Noise: stated (type B). Propagation: JCGM 100, section 5.",
        ),
        (
            "Coverage",
            f"k = {found.factor:.2f} ({format_percent(found.wishes.coverage)}); Monte Carlo (JCGM "
            f"101) where it differs by more than {format_percent(AGREED)}.",
        ),
        (
            "Not covered",
            "Load, temperature, drift, friction and backlash, unless modelled.",
        ),
    )
