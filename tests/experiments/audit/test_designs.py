"""Every shipped design runs and says what its machine is known to hide; the command line runs one as a user would."""

from __future__ import annotations

import json

import audit_problems as problems
import numpy as np
import pytest

from bayescal.experiments.audit import compute
from bayescal.experiments.audit.audit import analyse
from bayescal.experiments.audit.design import load_audit
from bayescal.experiments.audit.schema import AuditSweepConfig, ScenarioConfig
from bayescal.experiments.runner.run import compute_experiment

pytestmark = pytest.mark.runs

NULLS = {"six_pus": 6, "beam": 6, "jacobian": {"none": 24, "linear": 30, "matrix": 30}}
HEXAPODS = {"camera_hexapod": (42, 42), "m2_hexapod": (42, 42), "camera_hexapod_frames": (54, 42)}
WHOLE = ("telescope_six_pus_none", "camera_hexapod_frames")
"""Of legs that are pushed and of struts with frames: with sweep and profiles, which are the same code for all."""
KEYS = {"contraction", "nats", "kind", "loadings", "sentence"}


@pytest.mark.parametrize("name", problems.SHIPPED)
def test_shipped_design(name, monkeypatch):
    """Two of them with all that an audit has; the others without sweeps, profiles and functions, which take long.

    What-ifs are tried once a model of the legs: they change plans, not the deformation.
    """
    path = problems.DESIGNS / f"{name}.toml"
    config = load_audit(path)
    changes = {"n_simulated_calibrations": 0, "n_prior_draws": 0, "sweep": problems.SHORT_SWEEP}
    if name.endswith(("_linear", "_matrix")):
        changes["scenarios"] = [ScenarioConfig(name="twice the poses", poses_factor=2.0)]
    if name not in WHOLE:
        changes["sweep"] = AuditSweepConfig(noise=[1.0], poses=[40], workspace=[1.0])
        changes["model_error"] = config.model_error.model_copy(update={"terms": ["random"]})
        monkeypatch.setattr(compute, "choose_profiles", lambda inputs, audit: [])
    summary = compute_experiment(config.model_copy(update=changes), path.parent).summary
    json.dumps(summary, allow_nan=False)
    assert summary["structural_rank_is_clear"]
    n, rank = summary["n_parameters"], summary["structural_rank"]
    if name in HEXAPODS:
        assert (n, rank) == HEXAPODS[name]
        assert {s.partition("[")[0] for s in summary["reduced_set"]["free"]} >= {"l"}
    else:
        _, *model, deformation = name.split("_")
        expected = NULLS.get("_".join(model), 6)
        expected = expected[deformation] if isinstance(expected, dict) else expected
        if "stiffness" in name:
            assert n - rank >= expected  # springs in a row besides
        else:
            assert n - rank == expected
        last = "u_x" if deformation == "none" else "kappa"
        assert {s.partition("[")[0] for s in summary["reduced_set"]["free"]} == {"a_x", "a_y", "b_x", "b_y", "l", last}
    assert all(set(direction) >= KEYS for direction in summary["directions"])
    for name_, values in summary["parameters"].items():
        assert values["verdict"] in ("identifiable", "weak", "not"), name_
        assert values["reason"]
    assert summary["free"] == list(summary["parameters"])
    assert all({"limit", "predicted_sd", "probability"} <= set(r) for r in summary["requirements"].values())


def test_directions_of_rubins_m2_hexapod():
    """Strut 4 lies along x at home: of a_x, b_x and l it shows the sum alone."""
    plan = problems.read_shipped("m2_hexapod")
    analysis = analyse(plan)
    weak = np.stack([d.vector for d in analysis.directions if d.kind == "practical"], axis=1)
    basis = np.linalg.qr(weak)[0]
    for symbols, moves in ((("a_x", "l"), (1.0, 1.0)), (("b_x", "l"), (1.0, -1.0)), (("a_x", "b_x"), (1.0, 1.0))):
        vector = np.zeros(len(plan.names))
        for symbol, move in zip(symbols, moves, strict=True):
            place = plan.names.index(f"{symbol}[4]")
            vector[place] = (-move if symbols[1] == "l" and symbol == "l" else move) / plan.sd[place]
        vector /= np.linalg.norm(vector)
        assert np.linalg.norm(basis.T @ vector) > 0.99, symbols
