"""The structured model error of a study's variants, pose by pose."""

from __future__ import annotations

import numpy as np
import pandas as pd

from bayescal.experiments.shared.estimate import Fit
from bayescal.experiments.study.fit import Task
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.structured import find_telling_actuators
from bayescal.numerics.units import MICROMETRE


def tabulate_structured(inputs: StudyInputs, fits: dict[Task, Fit]) -> pd.DataFrame:
    """Return the error of every leg at every pose, with its 90 % interval, along the actuator that tells most of it."""
    n_poses, n_legs = inputs.displacement.shape
    use = np.where(inputs.verification, "verification", "calibration")
    frames = []
    for task, fit in fits.items():
        arrays = fit.evaluated
        if "structured_mean" not in arrays:
            continue
        actuators = find_telling_actuators(inputs, arrays)
        frames.append(
            pd.DataFrame(
                {
                    "variant": task.variant,
                    "pose": np.repeat(inputs.names, n_legs),
                    "use": np.repeat(use, n_legs),
                    "leg": np.tile(np.arange(1, n_legs + 1), n_poses),
                    "actuator": np.tile(actuators + 1, n_poses),
                    "travel_mm": inputs.displacement[:, actuators].ravel(),
                    **{f"{k}_um": (arrays[f"structured_{k}"] / MICROMETRE).ravel() for k in ("mean", "low", "high")},
                }
            )
        )
    return pd.concat(frames, ignore_index=True)
