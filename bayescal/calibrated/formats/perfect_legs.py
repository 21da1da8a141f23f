"""Formats that hold joints and rigid links take machines with perfect joints on a rigid platform, and no others."""

from __future__ import annotations

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.errors import InputError, name_faults
from bayescal.machines.deformations import NoDeformation
from bayescal.machines.models.six_pus import SixPus
from bayescal.machines.models.six_ups import SixUps


def check_perfect_legs(calibrated: CalibratedMachine, what: str, drives: tuple[str, ...]) -> None:
    """Raise InputError where a format cannot have the kinematics of a machine, saying why.

    Parameters
    ----------
    calibrated : CalibratedMachine
    what : str
        The format.
    drives : tuple of str
        Those that it takes.
    """
    with name_faults(f"format {what}"):
        machine, variant = calibrated.legs, calibrated.source.variant
    if machine.mechanism.drive not in drives:
        raise InputError(f"format {what}: found actuators at the base in variant {variant!r}, expected struts")
    if not isinstance(machine.model, SixPus | SixUps):
        raise InputError(
            f"format {what}: found model {machine.model.name!r} in variant {variant!r}, "
            f"expected one of perfect joints, {SixPus.name} or {SixUps.name}"
        )
    if not isinstance(machine.deformation, NoDeformation):
        raise InputError(f"format {what}: found a platform that bends in variant {variant!r}, expected a rigid one")
