"""Readings of a machine drawn within its tolerances, with the truth beside them."""

from __future__ import annotations

import numpy as np

from bayescal.data.truth import (
    PARAMETERS_FILE,
    POSES_FILE,
    format_true_parameters,
    format_true_poses,
    round_as_written,
)
from bayescal.errors import InputError
from bayescal.experiments.self_calibration.reading_table import POSE_COLUMNS, USES, name_column
from bayescal.experiments.self_calibration.schema import ReadingSimulationConfig
from bayescal.experiments.shared.reading_machine import build_sensors, draw_poses, free_parameters
from bayescal.experiments.shared.simulated_data import Simulated, tabulate_truth
from bayescal.files.csv_tables import format_table
from bayescal.machines.readings import SlidingPlatform
from bayescal.numerics.geometry import Array

LENGTH_DECIMALS, ANGLE_DECIMALS = 6, 9


def simulate_readings(
    config: ReadingSimulationConfig, model: SlidingPlatform, rng: np.random.Generator, truth: Array | None = None
) -> Simulated:
    """Return ``readings.csv``, ``true_parameters.csv`` and ``true_poses.csv`` of a machine.

    Everything that the sensors see, but for what defines the frames, deviates by its tolerance; true parameters (D,)
    that are given stand in for what is drawn, while the random numbers that follow stay the same.
    """
    sensors = build_sensors(model, config.sensors)
    free = free_parameters(model, sensors.names, config.tolerances)
    theta = free.draw(rng, 1)[0]
    for symbol in config.common:
        if symbol not in model.layout.index:
            raise InputError(f"common: found {symbol!r}, expected one of {', '.join(model.layout.symbols)}")
        alike = np.intersect1d(model.layout.index[symbol], free.places)
        theta[alike] = (model.layout.nominal + (theta - model.layout.nominal)[alike[-1:]])[alike]
    theta = round_as_written(theta if truth is None else truth)
    section = config.poses
    count = section.n_poses + config.verification_poses
    pose = draw_poses(model, section.model_copy(update={"n_poses": count}), rng)
    names = [f"C{k:03d}" for k in range(1, section.n_poses + 1)]
    names += [f"V{k:02d}" for k in range(1, config.verification_poses + 1)]
    exact = sensors.read(theta, pose)
    if not np.isfinite(exact).all():
        raise InputError("tolerances: found a machine that cannot take all poses, expected smaller tolerances")
    measured = exact + sensors.noise * rng.standard_normal(exact.shape)
    channels = [model.channels[k] for k in sensors.chosen]
    decimals = [LENGTH_DECIMALS if channel.unit == "mm" else ANGLE_DECIMALS for channel in channels]
    uses = [USES[k >= section.n_poses] for k in range(count)]
    rows = [
        (name, use, *(f"{x:.{d}f}" for x, d in zip(values, decimals, strict=True)))
        for name, use, values in zip(names, uses, measured, strict=True)
    ]
    columns = ("pose", "use", *(name_column(channel) for channel in channels))
    comments = [config.origin, "Readings of carriages in mm, of angles in rad; columns end with their unit."]
    files = {"readings.csv": format_table(comments, columns, rows), **_format_truth(config, model, theta, names, pose)}
    layout = model.layout
    off_nominal = tabulate_truth(layout.names, layout.units, layout.nominal, theta)
    return Simulated(files, off_nominal, config.origin, section.n_poses, config.verification_poses)


def _format_truth(
    config: ReadingSimulationConfig, model: SlidingPlatform, theta: Array, names: list[str], pose: Array
) -> dict[str, str]:
    about_parameters = "True parameters of the machine that the readings are of."
    about_poses = "True poses of the platform's frame at the readings."
    return {
        PARAMETERS_FILE: format_true_parameters([config.origin, about_parameters], model.layout, theta),
        POSES_FILE: format_true_poses([config.origin, about_poses], POSE_COLUMNS[1:], names, pose),
    }
