"""A point on N lines from spools: a cable robot whose platform is a point, such as a Hangprinter.

Line i runs from its anchor A_i to the point p, which stands at v = p. Encoders count the spools from where v = 0. With
the length l_i = |A_i - p| of the line and its strain c F_i (c the compliance, per newton; F_i the tension), the line
paid out since is

    Δ_i = l_i(p) / (1 + c F_i(p)) - l_i(0) / (1 + c F_i(0)).

A spool of radius R_i at the origin winds the line in layers: with m_i lines of one spool in parallel and the build-up
factor Q its radius obeys r² = R_i² - m_i Q Δ_i, so that a motor with gear g turns by

    θ_i = 2 g m_i Δ_i / (R_i + sqrt(R_i² - m_i Q Δ_i)),

which is g m_i Δ_i / R_i without build-up. Tensions are either given with each row of the data, or those of a point that
hangs in its lines, pretensioned alike as far as its weight allows: F = T + U⁺ (W - U T), U the lines' directions.

An instrument that sees the point reads o + (1 + s)(v + ω e_z × v): offset o, scale s and turn ω of its frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from bayescal.config.sections import NotNegative, Number, Positive, Section, Vector
from bayescal.machines.parameters import ParameterBlock
from bayescal.machines.readings.base import Channel, Coordinate
from bayescal.machines.readings.function import Parameters, ReadingMachine

GRAVITY = 9.80665
PER_MILLION = 1e-6
AXES = ("x", "y", "z")


class LineConfig(Section):
    """A line: its anchor, its spool's radius at the origin, how many lines of the spool run in parallel."""

    anchor_mm: Vector
    spool_radius_mm: Positive
    parallel: Annotated[int, Field(ge=1, le=100)] = 1


class LineMachineConfig(Section):
    """A point on lines; ``tension`` says where the lines' tensions come from.

    ``none``: lines do not stretch; ``hanging``: of the weight and the pretension; ``given``: columns ``force_1`` and so
    on of the data, in N, and ``force_at_origin_n``.
    """

    lines: Annotated[list[LineConfig], Field(min_length=1)]
    gear: Positive
    buildup_mm: NotNegative
    reach_mm: Annotated[list[Positive], Field(min_length=3, max_length=3)]
    centre_mm: Vector = Field(default=[0.0, 0.0, 0.0])
    tension: Literal["none", "hanging", "given"] = "none"
    compliance_per_million: NotNegative = 0.0
    mass_kg: NotNegative = 0.0
    pretension_n: Number = 0.0
    force_at_origin_n: list[NotNegative] = Field(default=[])


class LineMachine(ReadingMachine):
    """A point on lines with encoders at their spools, seen or not by an instrument beside it."""

    Config = LineMachineConfig
    member = "line"

    def __init__(self, config: LineMachineConfig) -> None:
        """Lay out parameters, coordinates and channels."""
        self.tension = config.tension
        self.parallel = np.array([float(one.parallel) for one in config.lines])
        self.gear, self.weight = config.gear, config.mass_kg * GRAVITY
        n = range(1, len(config.lines) + 1)
        anchors = np.array([one.anchor_mm for one in config.lines]).T
        self.parameters = [
            *(ParameterBlock(f"A_{axis}", tuple(one)) for axis, one in zip(AXES, anchors, strict=True)),
            ParameterBlock("R", tuple(one.spool_radius_mm for one in config.lines), lower=0.0),
            ParameterBlock("Q", (config.buildup_mm,), per_leg=False),
            ParameterBlock("c", (config.compliance_per_million,), "1e-6/N", per_leg=False),
            ParameterBlock("T", (config.pretension_n,), "N", per_leg=False),
            *(ParameterBlock(f"o_{axis}", (0.0,), per_leg=False) for axis in AXES),
            ParameterBlock("s", (0.0,), "1", per_leg=False),
            ParameterBlock("omega", (0.0,), "rad", per_leg=False),
        ]
        self.coordinates = [
            Coordinate(axis, "mm", home, reach)
            for axis, home, reach in zip(AXES, config.centre_mm, config.reach_mm, strict=True)
        ]
        self.channels = [
            *(Channel(f"motor[{k}]", "rad") for k in n),
            *(Channel(axis, "mm", external=True) for axis in AXES),
            *(Channel(f"length[{k}]", "mm", external=True) for k in n),
        ]
        self.given = tuple(f"force_{k}" for k in n) if config.tension == "given" else ()
        self.at_origin = np.array(config.force_at_origin_n or [0.0] * len(config.lines))

    def read(self, parameters: Parameters, v: Any, given: Mapping[str, Any]) -> Any:
        """Return the motors' angles, the point as an instrument sees it, and the lines' lengths."""
        length, now = self._pay_out(parameters, [v[..., k, None] for k in range(len(AXES))], given)
        _, before = self._pay_out(parameters, [0.0, 0.0, 0.0], None)
        paid_out, radius = now - before, parameters["R"]
        wound = np.sqrt(radius**2 - self.parallel * parameters["Q"][..., None] * paid_out)
        motor = 2.0 * self.gear * self.parallel * paid_out / (radius + wound)
        seen = [np.broadcast_to(one[..., None], (*motor.shape[:-1], 1)) for one in self._see(parameters, v)]
        return np.concatenate([motor, *seen, length], axis=-1)

    def _see(self, parameters: Parameters, v: Any) -> Any:
        """Return the point as an instrument sees it, three arrays (...)."""
        x, y, z = v[..., 0], v[..., 1], v[..., 2]
        turn, scale = parameters["omega"], 1.0 + parameters["s"]
        turned = (x - turn * y, y + turn * x, z)
        return [parameters[f"o_{axis}"] + scale * one for axis, one in zip(AXES, turned, strict=True)]

    def _pay_out(self, parameters: Parameters, p: list[Any], given: Mapping[str, Any] | None) -> Any:
        """Return the lines' lengths at p and what of them has left the spools, both (..., N)."""
        span = [parameters[f"A_{axis}"] - one for axis, one in zip(AXES, p, strict=True)]
        length = np.sqrt(span[0] * span[0] + span[1] * span[1] + span[2] * span[2])
        if self.tension == "none":
            return length, length
        if self.tension == "hanging":
            force = self._hang(parameters, [one / length for one in span])
        elif given is None:
            force = self.at_origin
        else:
            force = np.stack([given[name] for name in self.given], axis=-1)
        return length, length / (1.0 + PER_MILLION * parameters["c"][..., None] * force)

    def _hang(self, parameters: Parameters, directions: list[Any]) -> Any:
        """Return the tensions (..., N) of a point that hangs in its lines of directions x, y, z, (..., N) each."""
        even = parameters["T"][..., None]
        # U Uᵀ by its six entries, and W - U T: Cramer's rule is quicker than LAPACK for a pose each
        xx, yy, zz, xy, xz, yz = (
            (directions[i] * directions[j]).sum(axis=-1) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
        )
        weight = (0.0, 0.0, self.weight)
        a, b, c = (w - (even * one).sum(axis=-1) for w, one in zip(weight, directions, strict=True))
        p, q, r = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
        determinant = xx * p + xy * q + xz * r
        solved = (
            (p * a + q * b + r * c) / determinant,
            (q * a + (xx * zz - xz * xz) * b + (xy * xz - xx * yz) * c) / determinant,
            (r * a + (xy * xz - xx * yz) * b + (xx * yy - xy * xy) * c) / determinant,
        )
        return even + sum(one * by[..., None] for one, by in zip(directions, solved, strict=True))
