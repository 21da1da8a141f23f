"""A mechanism audited by its channels and by an instrument that sees its platform: the same poses, the same figures."""

from __future__ import annotations

import audit_problems as problems
import numpy as np
import pandas as pd

from bayescal.experiments.audit.design import load_audit, read_design, read_inputs
from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.numerics.geometry import rotation_vector_from_matrix

CHANNELS = ("x", "y", "z", "rx", "ry", "rz")


def test_deviations_are_the_same_either_way(tmp_path):
    folder = problems.DESIGNS
    seen = read_inputs(config := load_audit(folder / "m2_hexapod.toml"), folder)
    knowledge = seen.knowledge
    found = solve_forward_kinematics(knowledge.machine, knowledge.machine_centre, seen.plan.actuators)
    pose = np.concatenate([found.position, rotation_vector_from_matrix(found.rotation)], axis=1)
    table = pd.DataFrame(pose, columns=["x_mm", "y_mm", "z_mm", "rx_rad", "ry_rad", "rz_rad"])
    table.insert(0, "pose", [f"P{k}" for k in range(len(pose))])
    table.to_csv(tmp_path / "poses.csv", index=False, float_format="%.17g")
    dumped = config.model_dump(mode="json", exclude_none=True)
    kept = {key: dumped[key] for key in ("kind", "name", "title", "seed", "parameters")}
    noise = {name: {"noise_um": 10.0} for name in CHANNELS[:3]} | {n: {"noise_arcsec": 2.0} for n in CHANNELS[3:]}
    content = {
        **kept,
        "machine": str(folder / "m2_hexapod_mechanism.toml"),
        "sensors": {"rho": {"noise_um": 1.0}, **noise},
        "poses": {"file": "poses.csv"},
        "workspace": {
            name: [float(low) - 1e-3, float(high) + 1e-3]
            for name, low, high in zip(CHANNELS, pose.min(axis=0), pose.max(axis=0), strict=True)
        },
        "variants": [{"model": "six_ups"}, {"name": "bent", "model": "six_ups", "deformation": "linear"}],
    }
    plans = read_design(type(config).model_validate(content), tmp_path).channels
    assert ["kappa" in one.variant.model.layout.symbols for one in plans.values()] == [False, True]
    read = plans["all"]
    assert read.names == seen.names
    one, other = (np.sqrt(np.diagonal(plan.bare().inform().covariance)) for plan in (seen, read))
    np.testing.assert_allclose(one, other, rtol=1e-6)
    # functions go over the actuators' range, of channels over that of the workspace, as in studies
    one, other = (np.sqrt(np.diagonal(plan.inform().covariance)) for plan in (seen, read))
    np.testing.assert_allclose(one, other, rtol=0.05)
