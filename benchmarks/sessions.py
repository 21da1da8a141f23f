"""Sessions on twins: do intervals of a leg's motion hold it, and how often is drift seen where there is none.

Machines of the tolerances of experiments/m2_hexapod, model errors and drift scales drawn from their priors, measured in
monthly sessions of a few of that study's poses; then the same with legs that stand still.
`python benchmarks/sessions.py --twins 100`; add `--first N` to do them in parts.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pandas as pd

from bayescal.density.sessions import DAYS_IN_MONTH, DriftModel, Part, SessionModel, walk_loadings
from bayescal.experiments.runner.load import load
from bayescal.experiments.selftest.inputs import TestedVariant
from bayescal.experiments.sessions.compute import SessionFit, fit_sessions
from bayescal.experiments.sessions.inputs import describe_free, pick_rows
from bayescal.experiments.shared.measured import measure_variants
from bayescal.numerics.geometry import Array

STUDY = Path(__file__).parents[1] / "experiments" / "m2_hexapod" / "study.toml"
VARIANT = "six_ups/none"
SESSIONS, POSES, SCALE = 4, 8, 0.01
CLEAR = 3.0
"""Nats from which on a page calls drift clear."""


def make_sessions(subject: TestedVariant, moves: bool, rng: np.random.Generator) -> tuple[SessionModel, Array]:
    """Return sessions of a twin, and the true lengths in each, (S, N), less those of the first."""
    posterior = subject.posterior
    layout = posterior.likelihood.layout
    truth, free = posterior.draw_prior(1, rng), posterior.sampling.free
    theta, lengths = posterior.theta(truth), np.flatnonzero(np.isin(free, layout.index["l"]))
    loadings = walk_loadings(DAYS_IN_MONTH * np.arange(SESSIONS))
    scales = np.abs(rng.normal(0.0, SCALE * moves, len(lengths)))
    moved = loadings @ (rng.standard_normal((SESSIONS - 1, len(lengths))) * scales)
    parts = []
    for session in range(SESSIONS):
        now = theta.copy()
        now[:, free[lengths]] += moved[session]
        plan = TestedVariant(subject.measured.pick(rng.choice(posterior.likelihood.data.n_poses, POSES, replace=False)))
        values = plan.simulate(posterior.to_coordinates(now, posterior.zeta(truth))[0], rng)
        assert values is not None
        parts.append(Part(pick_rows(plan.measured.retake(values), np.arange(POSES)), session))
    units = tuple(f"l[{k}]" for k in range(1, len(lengths) + 1))
    drift = DriftModel(loadings, lengths, np.arange(len(lengths)), units, np.full(len(lengths), SCALE))
    return SessionModel(tuple(parts), *describe_free(subject.measured, "study"), drift, ()), moved


def compare(model: SessionModel, fit: SessionFit, moved: Array) -> tuple[Array, Array]:
    """Return the share of draws below each leg's true motion from first to last, and its error over its sd, (N,)."""
    x, _ = model.split(fit.z, model.read_scales(fit.zeta)[1])
    found = (x[:, -1] - x[:, 0])[:, model.drift.index]
    truth = moved[-1]
    return np.mean(found < truth, axis=0), (found.mean(axis=0) - truth) / found.std(axis=0)


def try_twin(subject: TestedVariant, moves: bool, seed: int, n_draws: int) -> dict[str, object]:
    """Return what sessions of one twin say."""
    rng = np.random.default_rng([2026, seed, int(moves)])
    model, moved = make_sessions(subject, moves, rng)
    fits = [fit_sessions(one, n_draws, rng) for one in (model, model.keep([]))]
    ranks, z = compare(model, fits[0], moved)
    row: dict[str, object] = {"twin": seed, "moves": moves, "nats": fits[0].log_evidence - fits[1].log_evidence}
    row["pareto_k"] = max(fit.quality[[1, 3]].max() for fit in fits)
    row["largest_um"] = 1e3 * np.abs(moved[-1]).max()
    return row | {f"rank_{k + 1}": r for k, r in enumerate(ranks)} | {f"z_{k + 1}": r for k, r in enumerate(z)}


def main() -> None:
    """Print shares with their standard errors."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--twins", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--draws", type=int, default=900)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    experiment, study = load(STUDY)
    subject = TestedVariant(measure_variants(experiment, study, STUDY, [VARIANT])[VARIANT])
    seeds = range(given.first, given.first + given.twins)
    table = pd.DataFrame([try_twin(subject, moves, seed, given.draws) for seed in seeds for moves in (True, False)])
    if given.out is not None:
        table.to_csv(given.out, index=False)
    report(table)


def report(table: pd.DataFrame) -> None:
    """Print what the twins of a table tell."""
    for moves, mine in table.groupby("moves"):
        ranks = mine.filter(like="rank_").to_numpy(dtype=float)
        held = np.mean((ranks > 0.05) & (ranks < 0.95), axis=1)
        rms = np.sqrt(np.mean(mine.filter(like="z_").to_numpy(dtype=float) ** 2))
        clear = float(np.mean(mine["nats"] > CLEAR))
        error = np.sqrt(max(clear * (1 - clear), 1 / len(mine)) / len(mine))
        print(f"{len(mine)} twins whose legs {'move' if moves else 'stand still'}:")
        print(f"  90 % intervals hold {100 * held.mean():.1f} ± {100 * held.std(ddof=1) / np.sqrt(len(held)):.1f} %")
        print(f"  errors over stated sd, rms: {rms:.3f}")
        print(f"  evidence of drift above {CLEAR:g} nats: {100 * clear:.1f} ± {100 * error:.1f} %")
        print(
            f"  mean evidence of drift: {mine['nats'].mean():.2f} nats, largest Pareto k {mine['pareto_k'].max():.2f}"
        )


if __name__ == "__main__":
    main()
