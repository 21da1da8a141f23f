"""Where actuators read numbers far from zero, a tolerance of their directions is one of their joints, too.

A joint stands at a + ρ u (RR-8096 eq. 30): a tolerance of u turns the rail about the point where the actuator reads
zero. Readings of 731 mm with a tolerance of 0.5 mrad add 0.37 mm to the joint's, and of a and u the poses tell little
more than the sum. With the zero in the middle of the readings each is a dimension of its own.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bayescal.experiments.audit.audit import Audit
from bayescal.experiments.audit.inputs import AuditInputs
from bayescal.identifiability.design import Knowledge
from bayescal.machines.parameters import AXES
from bayescal.numerics.geometry import Array

FAR = 2.0
"""How many half ranges of its readings a lever is long, from which on it is worth saying."""
SHARE = 0.05
"""Of a ridge, from which on a parameter takes part in it."""


def describe_far_readings(audit: Audit, inputs: AuditInputs) -> dict[str, Any]:
    """Return how far from zero the actuators read whose places and directions a ridge ties, mm; nothing without one."""
    knowledge, actuators = inputs.knowledge, inputs.plan.actuators
    chart = knowledge.machine.layout.directions
    if chart is None or knowledge.machine.mechanism.drive != "base":
        return {}
    middle, half = actuators.mean(axis=0), 0.5 * np.ptp(actuators, axis=0)
    tied: set[int] = set()
    for ridge in audit.ridges:
        tied |= _find_tied(knowledge, ridge.direction.vector, chart.symbols)
    legs = sorted(leg for leg in tied if abs(middle[leg]) > FAR * half[leg])
    if not legs:
        return {}
    far = max(legs, key=lambda leg: abs(middle[leg]))
    sd = dict(zip(knowledge.names, knowledge.sd.tolist(), strict=True))
    turned = max(sd.get(f"{symbol}[{far + 1}]", 0.0) for symbol in chart.symbols)
    found = {"legs": [leg + 1 for leg in legs], "reading_mm": float(middle[far]), "direction_sd": turned}
    return {"far_readings": found}


def _find_tied(knowledge: Knowledge, vector: Array, symbols: tuple[str, str]) -> set[int]:
    """Return the legs, from zero, of which both a component of the place and one of the direction are in a ridge."""
    strong = {knowledge.names[k] for k in np.flatnonzero(vector**2 >= SHARE)}
    return {
        leg
        for leg in range(knowledge.machine.mechanism.n_legs)
        if any(f"{symbol}[{leg + 1}]" in strong for symbol in symbols)
        and any(f"a_{axis}[{leg + 1}]" in strong for axis in AXES)
    }
