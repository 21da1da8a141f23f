"""What systematic errors do to what an audit predicts: none, as large as expected, several times as large, unseen."""

from __future__ import annotations

from typing import Final

import numpy as np
import pandas as pd

from bayescal.experiments.audit.audit import Audit, judge
from bayescal.experiments.audit.results import unit_of
from bayescal.experiments.shared.hidden import tabulate_hidden
from bayescal.identifiability.hidden import add, choose_unseen, hide
from bayescal.numerics.units import MICROMETRE

TIMES: Final = (0.0, 1.0, 3.0)


def tabulate_errors(audit: Audit) -> dict[str, pd.DataFrame]:
    """Return tables of systematic errors by name, none where an audit has none.

    ``error_sizes`` has standard deviations of parameters, rms by symbol, and how requirements stand, in the config's
    units, with errors so many ``times`` as large as they are expected; ``model_error_hidden`` what those that leave no
    trace hide of each parameter.
    """
    inputs = audit.inputs
    if not inputs.sizes:
        return {}
    rows, units, measured = list[dict[str, object]](), inputs.units, inputs.config.data is not None
    true = inputs.sizes if measured else inputs.config.model_error.sizes(list(inputs.sizes))
    for times in TIMES:
        sizes = {name: times * size for name, size in true.items()}
        changed = inputs if times == 1.0 else inputs.resize(sizes) if measured else inputs.settle(sizes)
        one = audit if times == 1.0 else judge(changed)
        total = float(np.linalg.norm(list(sizes.values()))) / MICROMETRE
        at = {"times": times, "size_um": total}
        variance = inputs.sd**2 * np.diagonal(one.analysis.information.covariance)
        for symbol in dict.fromkeys(inputs.symbols):
            part = np.array([name == symbol for name in inputs.symbols])
            unit = inputs.parameters.units[int(part.argmax())]
            sd = float(np.sqrt(variance[part].mean())) / units.factor(unit)
            rows.append({**at, "what": "parameter", "name": symbol, "unit": units.name(unit), "sd": sd})
        for outlook in one.outlooks:
            unit = unit_of(inputs, outlook.requirement)
            own = {"name": outlook.requirement.name, "unit": units.name(unit)}
            sd = outlook.predicted_sd / units.factor(unit)
            rows.append({**at, "what": "requirement", **own, "sd": sd, "probability": outlook.probability})
    return {"error_sizes": pd.DataFrame(rows), "model_error_hidden": _tabulate_hidden(audit)}


def _tabulate_hidden(audit: Audit) -> pd.DataFrame:
    """Return what errors hide that are as large as stated, or as is usual, and leave no trace."""
    inputs = audit.inputs
    unseen = choose_unseen(inputs.floors, list(inputs.sizes))
    with_floors = inputs.sizes if inputs.floors else add(inputs.sizes, unseen)  # what is stated is among the sizes
    pair = with_floors, add(with_floors, unseen, -1.0)
    covariances = [inputs.resize(sizes).inform().covariance for sizes in pair]
    hidden, sd = hide(*covariances), np.sqrt(np.diagonal(audit.analysis.information.covariance))
    factors = inputs.sd / np.array([inputs.units.factor(unit) for unit in inputs.parameters.units])
    units = [inputs.units.name(unit) for unit in inputs.parameters.units]
    return tabulate_hidden(audit.inputs.config.variants[0].name, inputs.names, units, factors * hidden, factors * sd)
