"""Computing sessions: with and without drift, and with every part that may move held still by itself."""

from __future__ import annotations

import zlib
from typing import Any

import numpy as np
import pandas as pd

from bayescal.density.sessions import SessionModel
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.experiments.sessions.fit import SessionFit, fit_sessions
from bayescal.experiments.sessions.inputs import SessionsInputs
from bayescal.experiments.sessions.tables import SHIFT_ARCSEC, Found, tabulate
from bayescal.experiments.shared.origin import name_origin

ALL, NONE = "drift", "no drift"
STILL = "still: "

type Task = tuple[SessionModel, int, int]


def compute_sessions(inputs: SessionsInputs, run: Run) -> Results:
    """Return what sessions tell of drift, of legs, and of expansion."""
    model, config = inputs.model, inputs.config
    units = model.drift.units
    tasks = {ALL: units, NONE: ()} | {f"{STILL}{one}": tuple(u for u in units if u != one) for one in _single(units)}
    fits = run.map("sessions", _fit, (model, config.draws, config.seed), tasks, (SessionFit,))
    found = Found(inputs, fits[ALL])
    tables = tabulate(found)
    tables["scales"]["log_odds_moved"] = [_weigh(fits, one) for one in units]
    tables["models"] = _tabulate_models(fits)
    drift = fits[ALL].log_evidence - fits[NONE].log_evidence
    summary: dict[str, Any] = {
        "name": config.name,
        "title": config.title,
        "study": config.study,
        "variant": config.variant,
        "data_origin": name_origin(config.origin.model_dump()),
        "hierarchy": config.drift.hierarchy,
        "symbols": config.drift.symbols,
        "per_leg": config.drift.per_leg,
        "shift_um": config.shift_um,
        **({} if inputs.first.by_leg else {"shift_arcsec": config.shift_arcsec or SHIFT_ARCSEC}),
        "has_temperature": config.thermal is not None,
        "n_sessions": model.n_sessions,
        "n_poses": int(inputs.n_poses.sum()),
        "n_parameters": len(model.mean),
        "log_evidence_drift": drift,
        "log_evidence_drift_se": float(np.hypot(fits[ALL].standard_error, fits[NONE].standard_error)),
        "sound": {name: fit.is_sound for name, fit in fits.items()},
        **({"denied_slips": inputs.denied} if inputs.denied else {}),
    }
    return Results(summary, tables)


def _single(units: tuple[str, ...]) -> tuple[str, ...]:
    """Return the units that are worth holding still by themselves: a single one is no drift at all."""
    return units if len(units) > 1 else ()


def _fit(shared: Task, units: tuple[str, ...]) -> SessionFit:
    model, n_draws, seed = shared
    rng = np.random.default_rng([seed, zlib.crc32("/".join(units).encode())])
    return fit_sessions(model.keep(units), n_draws, rng)


def _weigh(fits: dict[str, SessionFit], unit: str) -> float:
    """Return the log-odds that a unit moves against that it does not, the others free to move, at even prior odds."""
    return fits[ALL].log_evidence - fits.get(f"{STILL}{unit}", fits[NONE]).log_evidence


def _tabulate_models(fits: dict[str, SessionFit]) -> pd.DataFrame:
    rows = [(name, fit.log_evidence, fit.standard_error, *map(float, fit.quality)) for name, fit in fits.items()]
    columns = ["model", "log_evidence", "se", "efficiency", "pareto_k", "exact_efficiency", "exact_pareto_k"]
    return pd.DataFrame(rows, columns=columns)
