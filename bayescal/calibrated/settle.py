"""A machine of given parameters as the nominal machine of another mechanism: the same kinematics, new drawings.

Three things stand elsewhere than in the parameters. Actuators' readings go on counting from the initial positions: an
offset of ρ^0 moves the attachment, a + (ρ^0 - ρ^0_nominal) u, and nothing else. Directions are unit vectors, told by
the components that suit them. κ of each leg is the diagonal of a deformation matrix: no other file holds one per leg.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayescal.machines.deformations import (
    DEFORMATIONS,
    Deformation,
    FreeMatrixDeformation,
    MatrixDeformation,
    NoDeformation,
)
from bayescal.machines.kinematics import Machine, build_machine
from bayescal.machines.mechanism import BeamSection, Flexures
from bayescal.machines.models import MODELS
from bayescal.machines.models.legs import actuator_directions, chart_of
from bayescal.machines.models.six_pus import SixPus
from bayescal.machines.models.six_ups import SixUps
from bayescal.machines.parameters import ParameterLayout
from bayescal.numerics.geometry import DEGREES_OF_FREEDOM, Array

KAPPA, TRAVEL = "kappa", "rho0"


def find_hindrance(machine: Machine) -> str:
    """Return why no drawings hold a machine's kinematics, in words; empty where they do.

    Of a machine with more legs than six the home pose that flexures and the Jacobian-based model refer to is a
    compromise, weighed at the nominal machine (see `models.home`): with other drawings it is another one.
    """
    if type(machine.model) not in MODELS.values() or type(machine.deformation) not in DEFORMATIONS.values():
        return "a model or deformation of one's own, whose parameters no mechanism's file holds, expected built-in ones"
    if isinstance(machine.deformation, FreeMatrixDeformation):
        return "deformation 'free_matrix', whose parameters no mechanism's file holds, expected 'matrix' or another"
    perfect = isinstance(machine.model, SixPus | SixUps)
    if machine.mechanism.n_legs != DEGREES_OF_FREEDOM and not perfect:
        return (
            f"model {machine.model.name!r} of {machine.mechanism.n_legs} legs, which refers to the nominal home pose, "
            f"expected {DEGREES_OF_FREEDOM} legs or perfect joints"
        )
    return ""


def settle_machine(machine: Machine, theta: Array) -> Machine:
    """Return the machine whose nominal parameters are those of another, θ (D,), wherever they stand in its layout."""
    layout, mechanism = machine.layout, machine.mechanism
    attachments, directions = _place_actuators(machine, theta)
    moved = replace(
        mechanism,
        base_points=attachments,
        platform_points=layout.take_vector(theta, "b"),
        directions=mechanism.directions if directions is None else directions,
        leg_lengths=layout.take(theta, "l"),
        flexures=_settle_flexures(layout, theta, mechanism.flexures),
    )
    deformation: Deformation = NoDeformation()
    if KAPPA in layout.index:
        kappa = layout.take(theta, KAPPA)
        rest = machine.deformation.matrix if isinstance(machine.deformation, MatrixDeformation) else np.zeros((1, 1))
        deformation = MatrixDeformation(np.where(np.eye(len(kappa), dtype=bool), np.diag(kappa), rest))
    return build_machine(type(machine.model), moved, deformation)


def _place_actuators(machine: Machine, theta: Array) -> tuple[Array, Array | None]:
    """Return attachments and directions (..., N, 3) with the initial positions nominal; struts have no directions."""
    layout = machine.layout
    attachments = layout.take_vector(theta, "a")
    if TRAVEL not in layout.index:
        return attachments, None
    directions = actuator_directions(layout, theta)
    offset = layout.take(theta, TRAVEL) - machine.mechanism.initial_actuator_positions
    return attachments + offset[..., None] * directions, directions


def _settle_flexures(layout: ParameterLayout, theta: Array, flexures: Flexures | None) -> Flexures | None:
    if flexures is None:
        return None
    known = layout.index
    return Flexures(
        layout.take(theta, "l_b") if "l_b" in known else flexures.lengths,
        layout.take(theta, "beta") if "beta" in known else flexures.beta,
        _settle_section(layout, theta, "d", flexures.section),
        _settle_section(layout, theta, "l", flexures.leg_section),
    )


def _settle_section(
    layout: ParameterLayout, theta: Array, part: str, section: BeamSection | None
) -> BeamSection | None:
    if f"k1_{part}" not in layout.index:
        return section
    return BeamSection(*(float(layout.take(theta, f"{k}_{part}")[0]) for k in ("k1", "k2", "k3")))


def express_parameters(machine: Machine, settled: Machine, theta: Array) -> Array:
    """Return parameter vectors (..., D) of a machine as those of a settled one, shape (..., D')."""
    old, new = machine.layout, settled.layout
    result = np.broadcast_to(new.nominal, (*theta.shape[:-1], new.size)).copy()
    for symbol in set(old.symbols) & set(new.symbols):
        result[..., new.index[symbol]] = old.take(theta, symbol)
    attachments, directions = _place_actuators(machine, theta)
    for k, axis in enumerate("xyz"):
        result[..., new.index[f"a_{axis}"]] = attachments[..., k]
    if directions is not None:
        local = chart_of(new).to_local(directions)
        for k, symbol in enumerate(new.direction_symbols):
            result[..., new.index[symbol]] = local[..., k]
        result[..., new.index[TRAVEL]] = settled.mechanism.initial_actuator_positions
    return result
