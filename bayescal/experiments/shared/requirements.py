"""What has to be accurate and in which frame, as configs of every kind state it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from bayescal.density.priors import Prior
from bayescal.errors import InputError
from bayescal.experiments.shared.schema import AccuracyFrame, UnitsConfig
from bayescal.identifiability.reading_rows import name_tool
from bayescal.identifiability.requirements import COMPONENTS, NORMS, Requirement
from bayescal.machines.readings import ReadingModel
from bayescal.numerics.units import Units

AXES = ("x", "y", "z")


def read_requirements(
    stated: Mapping[str, float],
    model: ReadingModel,
    section: UnitsConfig,
    of: Literal["all_poses", "rms"] = "all_poses",
) -> tuple[Requirement, ...]:
    """Return the largest errors that are allowed, in inner units; InputError for what the tool does not have.

    They are of the tool's numbers, of its lengths together (``position``) and of its rotation (``rotation``); numbers
    of a platform's rotation are called ``rx`` or ``rotation_x``.
    """
    units, said = _list_required(model), Units(section.length, section.angle)
    for name in stated:
        if name not in units:
            raise InputError(f"requirements: found {name!r}, expected one of {', '.join(units) or 'none: no tool'}")
    components, _ = name_tool(model)
    found = []
    for name, unit in units.items():
        if name not in stated:
            continue
        names = COMPONENTS if name in COMPONENTS and name not in components else components
        part = slice(0, len(model.tool_lengths)) if name == "position" and name not in components else None
        found.append(Requirement(name, stated[name] * said.factor(unit), names, of, part))
    return tuple(found)


def name_required_units(stated: Mapping[str, float], model: ReadingModel, section: UnitsConfig) -> dict[str, str]:
    """Return the units in which requirements are stated, by their names."""
    said = Units(section.length, section.angle)
    return {name: said.name(unit) for name, unit in _list_required(model).items() if name in stated}


def _list_required(model: ReadingModel) -> dict[str, str]:
    """Return what of a tool may be required, with inner units."""
    components, inner = name_tool(model)
    units = dict(zip(components, inner, strict=True))
    lengths = model.tool_lengths
    if 1 <= len(lengths) <= len(AXES) and lengths == [*range(len(lengths))]:
        units.setdefault("position", "mm")
    if model.tool_turned == [3, 4, 5]:
        units |= {name: "rad" for name in (*COMPONENTS[NORMS["rotation"]], "rotation") if name not in units}
    return units


def is_aligned(frame: AccuracyFrame, model: ReadingModel, priors: Mapping[str, Prior]) -> bool:
    """Return whether accuracy is what remains of errors after base and tool are aligned.

    InputError where accuracy is wanted in a base frame that nothing marks: of a tool without a place, or where an
    instrument's frame is known less well than the machine's own parts, so that nothing ties it to the base.
    """
    if frame == "aligned":
        return model.places_tool
    if not model.places_tool:
        names = ", ".join(name_tool(model)[0])
        raise InputError(
            f"accuracy_frame: found 'base' with tool ({names}), expected one to three lengths in tool_channels, or none"
        )
    layout, symbols = model.layout, set(model.instrument_symbols)
    sd = {True: {"": 0.0}, False: {"": 0.0}}
    for name, prior in priors.items():
        if name in layout.names and layout.units[layout.names.index(name)] == "mm":
            sd[name.partition("[")[0] in symbols][name] = prior.sd
    worst = max(sd[True], key=lambda name: sd[True][name])
    if sd[True][worst] > max(sd[False].values()):
        raise InputError(
            f"accuracy_frame: found 'base', but {worst} is known to {sd[True][worst]:g} mm only, "
            "expected a tolerance of that frame, or 'aligned'"
        )
    return False
