"""Reading a study's files: every fault of its input is found here, before any long computation."""

from __future__ import annotations

from pathlib import Path

from bayescal.config.load import look_up
from bayescal.data.actuators import check_moves, check_range
from bayescal.density.legs import check_machine
from bayescal.errors import InputError, PoseInputError, name_faults
from bayescal.experiments.shared.search_memory import check_poses
from bayescal.experiments.shared.study_schema import StudyConfig, VariantConfig
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.measurement import check_measurement, name_actuator_table, name_data, read_measurement
from bayescal.experiments.study.published import read_published
from bayescal.machines.kinematics import check_home_pose
from bayescal.machines.read import load_mechanism


def load_inputs(config: StudyConfig, folder: Path) -> StudyInputs:
    """Read all files of a study and check that every variant can be built.

    Raises
    ------
    InputError
        For anything at fault in the config's files, before any long computation.
    """
    mechanism = load_mechanism(folder / config.machine)
    measured = read_measurement(config, folder, mechanism)
    with name_faults(name_actuator_table(config.measured, folder)):
        check_range(measured.actuators, mechanism.initial_actuator_positions, mechanism.actuator_range, measured.names)
        check_moves(measured.actuators[~measured.verification])
    inputs = StudyInputs(config, folder, mechanism, measured)
    with name_faults(name_data(config.measured, folder)):
        _measure_deflection(inputs)
    for variant in config.variants:
        machine = inputs.machine(variant)
        with name_faults(folder / config.machine):
            check_home_pose(machine)
        check_poses(len(measured.names), mechanism.n_legs, machine.layout.size)
        check_measurement(inputs.measured, machine, config.measured, folder)
        with name_faults(f"variant {variant.name!r}"):
            check_machine(inputs.posterior(variant, with_model_error=True))
            _check_widths(inputs, variant)
        if variant.published is not None:
            read_published(folder / variant.published, mechanism.n_legs)
    known = {block.symbol for variant in config.variants for block in inputs.machine(variant).layout.blocks}
    for symbol in config.parameters:
        if symbol not in known:
            look_up(dict.fromkeys(known), symbol, "parameters", folder)
    return inputs


def _measure_deflection(inputs: StudyInputs) -> None:
    """Compute what the ring targets say now, so that a fault shows before any long computation."""
    try:
        _ = inputs.deflection
    except PoseInputError as error:
        raise InputError(f"pose {inputs.names[error.index]!r}: {error.fault}") from error


def _check_widths(inputs: StudyInputs, variant: VariantConfig) -> None:
    """Raise InputError for a factor that takes a uniform prior beyond what a parameter may be."""
    for factor in inputs.config.sensitivity.factor:
        with name_faults(f"sensitivity.factor {factor:g}"):
            check_machine(inputs.posterior(variant, True, factor))
