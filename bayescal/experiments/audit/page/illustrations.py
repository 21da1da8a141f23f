"""Which figures the page of an audit has, what each shows, and which must be left out for want of data."""

from __future__ import annotations

from functools import partial

import numpy as np
import pandas as pd

from bayescal.experiments.audit.page.borne_out import KEPT, is_kept
from bayescal.experiments.audit.page.figures.heat import NUMBERED, draw_changes, draw_contraction
from bayescal.experiments.audit.page.figures.profiles import draw_profiles, draw_ridge_plots
from bayescal.experiments.audit.page.figures.requirements import draw_requirements
from bayescal.experiments.audit.page.figures.spectrum import draw_spectrum
from bayescal.experiments.audit.page.figures.sweeps import SWEEPS, draw_sweeps
from bayescal.experiments.audit.page.results import AuditResults, Ridge
from bayescal.experiments.audit.page.tables import name_change
from bayescal.experiments.shared.machine_scene import build_scene, read_joint_columns
from bayescal.report.blocks import Figure
from bayescal.report.numbers import format_percent, join_words
from bayescal.report.scene import Scene
from bayescal.report.symbols import split_name

IN_MM = {"um": 1e-3, "mm": 1.0, "m": 1e3}
PANELS = 12  # of ridges in the first figure


def show_machine(audit: AuditResults) -> list[Scene]:
    """Return the machine in space at its planned poses, with what remains unknown of its joints."""
    if "joints" not in audit.tables:
        return []
    frame = audit.parameters.assign(sd=audit.parameters["posterior_sd"] * audit.parameters["unit"].map(IN_MM))
    scene = build_scene(audit.tables["joints"], spreads=read_joint_columns(frame.dropna(subset="sd"), "sd"))
    return [] if scene is None else [scene]


def show_contraction(results: AuditResults) -> Figure:
    """Return the contraction of every parameter as a map."""
    frame = results.parameters
    legs = sorted(set(frame["leg"]) - {0}) + ([0] if (frame["leg"] == 0).any() else [])
    values = frame.pivot(index="symbol", columns="leg", values="contraction").loc[results.symbols, legs]
    free = frame.pivot(index="symbol", columns="leg", values="in_reduced_set").loc[results.symbols, legs]
    caption = (
        "Contraction of every parameter with all others unknown: the share of its tolerance's variance that the "
        "measurements remove, 0 where nothing is learnt. From 0.75 on the tolerance is at least halved (blue). "
        "Outlined: the reduced set of reproductions."
    )
    draw = partial(
        draw_contraction,
        values.to_numpy(dtype=float),
        results.symbols,
        [f"{results.member} {leg}" if leg else "machine" for leg in legs],
        free.eq(True).to_numpy(dtype=bool),
    )
    return Figure("contraction", caption, draw)


def show_spectrum(results: AuditResults) -> Figure:
    """Return the spectra that decide."""
    caption = (
        "Left: singular values of the noise-free identification Jacobian over a wide workspace, per tolerance; what "
        "lies at the level of rounding is a combination that no measurement of this kind sees, and the gap decides the "
        "rank. Right: how well the planned measurements determine each combination, its tolerance divided by what "
        "their noise alone would leave; below the upper line the tolerance is not halved, below the lower one hardly "
        "anything is learnt."
    )
    return Figure("spectrum", caption, partial(draw_spectrum, results.tables["spectrum"]))


def show_requirements(results: AuditResults) -> Figure:
    """Return the predicted errors against their limits."""
    caption = (
        "Largest standard deviation of the predicted pose anywhere in the workspace, in per cent of each requirement's "
        "limit, logarithmic. The tick is the part of the geometry; the rest up to the dot are actuators and model "
        f"error. Blue: met with a probability of {format_percent(KEPT)} or more, as in the table; red: not reliably."
    )
    if not results.requirements:
        return Figure("requirements", caption, None, "the design states no requirement")
    return Figure(
        "requirements",
        caption,
        partial(draw_requirements, results.requirements, [is_kept(results, r) for r in results.requirements]),
    )


def show_changes(results: AuditResults) -> Figure:
    """Return what other plans would tell of each weak combination."""
    ridges = [ridge for ridge in results.ridges if ridge.kind == "practical"]
    order = {symbol: k for k, symbol in enumerate(results.symbols)}
    ridges.sort(key=lambda ridge: (order[split_name(ridge.pivot)[0]], split_name(ridge.pivot)[1]))
    names, rows = _gather(results, ridges)
    which = (
        "the combination named after each parameter"
        if len(ridges) == len(names)
        else (f"the combinations named after each symbol, on the {results.member} known least")
    )
    caption = (
        f"Contraction of {which} under other plans; the first row is the plan itself. Blue: determined. Combinations "
        "that no measurement of this kind sees are not shown, no plan helps them."
    )
    if not ridges or not results.changes:
        reason = "no combination is weak" if not ridges else "no change of the plan was looked at"
        return Figure("changes", caption, None, reason)
    first = "as it is" if results.is_measured else "as planned"
    labels = [first, *(name_change(change) for change in results.changes)]
    return Figure("changes", caption, partial(draw_changes, rows, labels, names))


def _gather(results: AuditResults, ridges: list[Ridge]) -> tuple[list[str], np.ndarray]:
    """Return a column per ridge, or the least of each symbol where these are too many to be read."""
    pivots = [ridge.pivot for ridge in ridges]
    plan = {ridge.pivot: ridge.contraction for ridge in ridges}
    table = pd.DataFrame(
        [plan, *({p: c.ridges.get(p, np.nan) for p in pivots} for c in results.changes)], columns=pivots
    )
    if len(pivots) > NUMBERED:
        table = table.T.groupby([split_name(p)[0] for p in pivots], sort=False).min().T
    return list(table.columns), table.to_numpy(dtype=float)


def show_sweeps(results: AuditResults) -> Figure:
    """Return how everything goes with noise, number of poses and displacements."""
    sweeps = results.tables.get("sweeps")
    caption = (
        f"What is left of the tolerances on the {results.member} that is known least, a line per symbol, with all "
        "parameters unknown (dashed red: contraction 0.75 and 0.1), and below it the predicted standard deviations in "
        "per cent of their limits. The grey line is the plan; open marks need more than the actuators' range. Lines "
        "that stay level wait for another kind of measurement."
    )
    if sweeps is None or not set(sweeps["sweep"]) & set(SWEEPS):
        return Figure("sweeps", caption, None, "nothing was swept")
    plan = {"noise": 1.0, "poses": float(results.n_poses), "workspace": 1.0}
    return Figure("sweeps", caption, partial(draw_sweeps, sweeps, results.tables.get("sweep_requirements"), plan))


def show_profiles(results: AuditResults) -> Figure:
    """Return the profile likelihoods."""
    profiles = results.tables.get("profiles")
    caption = (
        "Profile likelihoods: a parameter is held at a value, all others are fitted again, and the deviance shows what "
        "that costs. Where the full line stays below the dotted one, the measurements alone do not bound the parameter."
    )
    if profiles is None:
        return Figure("profiles", caption, None, "the design asks for no profile likelihoods")
    centres = {str(name): float(value) for name, value in results.parameters["nominal"].items()}
    best = profiles.loc[profiles.groupby("parameter", sort=False)["deviance_total"].idxmin()]
    centres |= dict(zip(best["parameter"], best["value"], strict=True))
    return Figure("profiles", caption, partial(draw_profiles, profiles, centres))


def show_ridges(results: AuditResults) -> Figure:
    """Return the first ridge of each kind."""
    first, _ = _split_by_kind(results)
    draws, curves = _find_plots(results)
    left_out = results.summary.get("posterior_left_out")
    caption = _describe_plots({*draws["source"], *curves["source"]}, left_out)
    if not first:
        reason = left_out if isinstance(left_out, str) else "no draws of the posterior were made"
        return Figure("ridges", caption, None, reason)
    return Figure("ridges", caption, partial(draw_ridge_plots, first, draws, curves))


def show_other_ridges(results: AuditResults) -> Figure | None:
    """Return all other ridges; None where there are none."""
    _, others = _split_by_kind(results)
    if not others:
        return None
    draw = partial(draw_ridge_plots, others, *_find_plots(results))
    return Figure("ridges_others", "The same for the other ridges.", draw)


def _find_plots(results: AuditResults) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return draws and curves, without rows where there are none."""
    empty = pd.DataFrame(columns=["direction", "source", "x", "y"])
    draws, curves = (results.tables.get(name, empty) for name in ("ridge_draws", "ridge_curves"))
    return draws, curves


def _describe_plots(sources: set[str], left_out: object) -> str:
    words = {
        "prior": "draws of the prior (grey)",
        "forecast": "draws of what the information leaves of it (blue)",
        "posterior": "draws of the posterior (blue)",
        "analytic": "the analytic curve (red)",
        "profile": "the path that the profile takes (dashed)",
        "tangent": "the straight direction of the information (dotted)",
    }
    shown = join_words([text for source, text in words.items() if source in sources])
    caption = (
        f"Ridges, two parameters each that the measurements do not distinguish: {shown}. Each draw is shown without "
        "its moves along the other ridges."
    )
    if "posterior" in sources:
        return f"{caption} Posterior draws as wide along a curve as the prior's are what is not identifiable."
    reason = f": {left_out}" if isinstance(left_out, str) else ""
    return f"{caption} Draws of the posterior are left out{reason}."


def _split_by_kind(results: AuditResults) -> tuple[list[Ridge], list[Ridge]]:
    """Return the ridges that have a plot: the first of each kind, and all others."""
    there = {number for table in _find_plots(results) for number in table["direction"]}
    plotted = [ridge for ridge in results.ridges if ridge.plot and ridge.number in there]
    leading = [next((ridge for ridge in group.ridges if ridge in plotted), None) for group in results.groups]
    first = [ridge for ridge in leading if ridge is not None][:PANELS]
    return first, [ridge for ridge in plotted if ridge not in first]
