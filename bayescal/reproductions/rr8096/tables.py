"""Own findings on the report's tables 5 (d), 6 (d), 7 (d) and 7 (c)."""

from __future__ import annotations

import numpy as np

from bayescal.density.least_squares import minimise
from bayescal.numerics.geometry import Array
from bayescal.reproductions.rr8096.claim import UNTESTABLE, Claim, ClaimRows, judge
from bayescal.reproductions.rr8096.evidence import FREE, POINTS, REFERENCE, ClaimEvidence
from bayescal.reproductions.rr8096.identification import SAME, TABLES, join, rms

ROUGH = 1e-6  # tolerance of the least squares: two digits of a correlation
FOLLOWS = 0.5  # correlation from which on a pattern counts as found


def stiffness_objective(evidence: ClaimEvidence) -> ClaimRows:
    """Own: tables (d) differ from tables (a) because their objective weighs newtons and newton metres alike."""
    for deformation, table in TABLES.items():
        ours, reference = f"stiffness/{deformation}", f"{REFERENCE}/{deformation}"
        known = [set(POINTS) <= set(evidence.published.get(name, {})) for name in (ours, reference)]
        if not all(known) or not evidence.repeats(ours, reference):
            continue
        published = join(evidence.published[ours], POINTS)
        moved = published - join(evidence.published[reference], POINTS)
        base = join(evidence.offsets(reference), POINTS)
        found = {
            "leg": _solve(evidence, "stiffness", deformation, own_objective=False),
            "wrench": join(evidence.offsets(ours), POINTS),
            "fixed": _solve(evidence, "stiffness_fixed", deformation, own_objective=True),
        }
        shifts = {name: rms(values - base) for name, values in found.items()}
        apart = {name: rms(values - published) for name, values in found.items()}
        alike = {name: float(np.corrcoef(values - base, moved)[0, 1]) for name, values in found.items()}
        yield Claim(
            claim=f"stiffness_objective_table{table}",
            section="own",
            statement=f"Table {table}(d) differs from table {table}(a) for its objective, newtons and newton metres "
            "weighed alike, more than for its physics.",
            expected=f"with that objective a and b move from table {table}(a) towards {table}(d)",
            found=f"correlation of the move with the published one {alike['wrench']:.2f} with the objective in N and "
            f"N m ({alike['fixed']:.2f} with directions kept), {alike['leg']:.2f} in leg lengths; "
            f"{apart['wrench']:.2f} ({apart['fixed']:.2f}) and {apart['leg']:.2f} mm rms from table {table}(d)",
            value=alike["wrench"],
            unit="1",
            verdict=UNTESTABLE
            if shifts["wrench"] < SAME * rms(moved)
            else judge(alike["wrench"] > FOLLOWS and apart["wrench"] < apart["leg"]),
            why=f"Least squares; the published move is {rms(moved):.2f} mm rms, that with the objective in N and N m "
            f"{shifts['wrench']:.2f}, in leg lengths {shifts['leg']:.2f}. The assumed stiffness "
            "matters little, legs being alike. Where the deformation is right the objective hardly matters: a move of "
            "less than a tenth of the published one tests nothing.",
        )


def _solve(evidence: ClaimEvidence, model: str, deformation: str, own_objective: bool) -> Array:
    """Return a and b by least squares from the 6-PUS's solution, in the model's own objective or in leg lengths."""
    machine, reference = evidence.machine(model, deformation), evidence.fits[f"{REFERENCE}/{deformation}"]
    exact = evidence.machine(REFERENCE, deformation)
    assert machine is not None
    assert exact is not None
    layout, symbols = machine.layout, evidence.free[f"{REFERENCE}/{deformation}"]
    free, start = np.concatenate([layout.index[s] for s in symbols]), layout.nominal.copy()
    for symbol in symbols:
        start[layout.index[symbol]] = exact.layout.take(reference.theta, symbol)
    weight = machine.model.objective(machine.mechanism) if own_objective else np.eye(machine.mechanism.n_legs)
    offset = minimise(machine, evidence.poses, free, start, weight, ROUGH).theta - layout.nominal
    return np.concatenate([layout.take(offset, symbol) for symbol in POINTS])


def beam_kappa(evidence: ClaimEvidence) -> ClaimRows:
    """Own: κ of table 7 (c)."""
    pair = [f"{model}/matrix" for model in (REFERENCE, "beam")]
    tables = [evidence.published.get(name, {}) for name in pair]
    if not evidence.repeats(*pair) or not all(FREE["matrix"] <= set(table) for table in tables):
        return
    (a, c), (ours, beam) = (t["kappa"] for t in tables), (evidence.offsets(name)["kappa"] for name in pair)
    printed, found = float(a @ c / (a @ a)), float(ours @ beam / (ours @ ours))
    lengths = (*POINTS, "l")
    yield Claim(
        claim="beam_kappa",
        section="own",
        statement="Table 7(c) prints Δκ of the beam model about ten times too small.",
        expected="Δκ as with the 6-PUS, ratio 1",
        found=f"published ratio {printed:.2f}, least squares {found:.2f}",
        value=printed,
        unit="1",
        verdict=judge(abs(found - 1.0) < 0.1 and 0.05 < printed < 0.2),
        why="Regression of (c) on (a). Its lengths are off as well: "
        f"{rms(join(tables[1], lengths) - join(tables[0], lengths)):.2f} mm rms from table 7(a) as published, "
        f"{rms(join(evidence.offsets(pair[1]), lengths) - join(evidence.offsets(pair[0]), lengths)):.3f} mm by least "
        "squares.",
    )


CLAIMS = (stiffness_objective, beam_kappa)
