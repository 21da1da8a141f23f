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

A point that keeps to a plane, such as the sled of a router on two chains or of a plotter on belts, has x and y alone,
and so have its anchors: how far an anchor is from the plane is known, and adds to the length of its line.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from bayescal.config.sections import NotNegative, Number, Positive, Section, Vector
from bayescal.machines.parameters import ParameterBlock
from bayescal.machines.readings.base import Channel, Coordinate, Given
from bayescal.machines.readings.function import Parameters, ReadingMachine
from bayescal.numerics.analytic import sqrt

GRAVITY = 9.80665
PER_MILLION = 1e-6
AXES = ("x", "y", "z")

type Row = Sequence[np.ndarray | float]  # arrays (...) of lines or axes, or constants


class LineConfig(Section):
    """A line: its anchor, its spool's radius at the origin, how many lines of the spool run in parallel."""

    anchor_mm: Vector
    """Where the line's anchor is."""
    spool_radius_mm: Positive
    """Radius of the spool with the line on it, when the mover is at the origin."""
    n_parallel_lines: Annotated[int, Field(ge=1, le=100)] = 1
    """How many lines run in parallel from the spool to the mover."""


class LineMachineConfig(Section):
    """A point on lines; ``tension`` says where the lines' tensions come from.

    ``none``: lines do not stretch; ``hanging``: of the weight and the pretension; ``measured``: columns ``force_1`` and
    so on of the data, in N, and ``force_at_origin_n``.
    """

    lines: Annotated[list[LineConfig], Field(min_length=1)]
    """The lines, one table each."""
    gear: Positive
    """Turns of the motor per turn of the spool [1]."""
    spool_buildup_mm: NotNegative
    """Build-up Q of line on a spool: r² = R² − n_parallel_lines · Q · (line paid out)."""
    workspace_half_width_mm: Annotated[list[Positive], Field(min_length=2, max_length=3)]
    """Half widths of the workspace in x, y and z; in x and y of a point that keeps to the plane z of the centre."""
    centre_mm: Vector = Field(default=[0.0, 0.0, 0.0])
    """Centre of the workspace."""
    tension: Literal["none", "hanging", "measured"] = "none"
    """Where the tensions of the lines come from: `none`, `hanging` (weight and pretension) or `measured` (columns of
    the data).
    """
    compliance_per_million: NotNegative = 0.0
    """Stretch of a line per force, in millionths of its length per N."""
    mass_kg: NotNegative = 0.0
    """Mass of the mover."""
    pretension_n: Number = 0.0
    """What pretension adds to the tensions of the lines."""
    force_at_origin_n: list[NotNegative] = Field(default=[])
    """Tensions at the origin, one per line; with `tension = "measured"`."""

    @model_validator(mode="after")
    def _check_tension(self) -> Self:
        if self.tension == "hanging" and len(self.workspace_half_width_mm) < len(AXES):
            raise ValueError("tension: found 'hanging' in a plane, expected 'none' or 'measured'")
        return self


class LineMachine(ReadingMachine):
    """A point on lines with encoders at their spools, seen or not by an instrument beside it."""

    Config = LineMachineConfig
    member = "line"

    def __init__(self, config: LineMachineConfig) -> None:
        """Lay out parameters, coordinates and channels."""
        self.tension, self.axes = config.tension, AXES[: len(config.workspace_half_width_mm)]
        self.parallel = np.array([float(one.n_parallel_lines) for one in config.lines])
        self.gear, self.weight = config.gear, config.mass_kg * GRAVITY
        n = range(1, len(config.lines) + 1)
        anchors = np.array([one.anchor_mm for one in config.lines]).T
        self.away = () if self.axes == AXES else anchors[2] - config.centre_mm[2]  # of anchors from the plane
        self.parameters = [
            *(ParameterBlock(f"A_{axis}", tuple(one)) for axis, one in zip(self.axes, anchors, strict=False)),
            ParameterBlock("R", tuple(one.spool_radius_mm for one in config.lines), lower=0.0),
            ParameterBlock("Q", (config.spool_buildup_mm,), per_leg=False),
            ParameterBlock("c", (config.compliance_per_million,), "1e-6/N", per_leg=False),
            ParameterBlock("T", (config.pretension_n,), "N", per_leg=False),
            *(ParameterBlock(f"o_{axis}", (0.0,), per_leg=False) for axis in self.axes),
            ParameterBlock("s", (0.0,), "1", per_leg=False),
            ParameterBlock("omega", (0.0,), "rad", per_leg=False),
        ]
        self.coordinates = [
            Coordinate(axis, "mm", home, reach)
            for axis, home, reach in zip(self.axes, config.centre_mm, config.workspace_half_width_mm, strict=False)
        ]
        self.channels = [
            *(Channel(f"motor[{k}]", "rad") for k in n),
            *(Channel(axis, "mm", external=True) for axis in self.axes),
            *(Channel(f"length[{k}]", "mm", external=True) for k in n),
        ]
        self.tool_channels = [Channel(axis, "mm") for axis in self.axes]
        self.commanded = ["motor"]
        self.given = tuple(f"force_{k}" for k in n) if config.tension == "measured" else ()
        self.at_origin = np.array(config.force_at_origin_n or [0.0] * len(config.lines))

    def read(self, parameters: Parameters, v: np.ndarray, given: Given) -> np.ndarray:
        """Return the motors' angles, the point as an instrument sees it, and the lines' lengths."""
        lengths, now = self._pay_out(parameters, [v[..., k] for k in range(len(self.axes))], given)
        _, before = self._pay_out(parameters, [0.0] * len(self.axes), None)
        motors = [
            self._wind(parameters["R"][..., k], parameters["Q"], away - home, self.parallel[k])
            for k, (away, home) in enumerate(zip(now, before, strict=True))
        ]
        return np.stack(np.broadcast_arrays(*motors, *self._see(parameters, v), *lengths), axis=-1)

    def _wind(
        self, radius: np.ndarray, buildup: np.ndarray, paid_out: np.ndarray | float, parallel: float
    ) -> np.ndarray:
        """Return by how much the motor of a spool has turned."""
        wound = sqrt(radius * radius - parallel * buildup * paid_out)
        return 2.0 * self.gear * parallel * paid_out / (radius + wound)

    def _see(self, parameters: Parameters, v: np.ndarray) -> Row:
        """Return the point as an instrument sees it, an array (...) for each axis."""
        x, y, *above = (v[..., k] for k in range(len(self.axes)))
        turn, scale = parameters["omega"], 1.0 + parameters["s"]
        turned = (x - turn * y, y + turn * x, *above)
        return [parameters[f"o_{axis}"] + scale * one for axis, one in zip(self.axes, turned, strict=True)]

    def _pay_out(self, parameters: Parameters, p: Row, given: Given | None) -> tuple[Row, Row]:
        """Return the lines' lengths at p and what of them has left the spools, N arrays (...) each."""
        lengths, directions = self._span(parameters, p)
        if self.tension == "none":
            return lengths, lengths
        forces = self._pull(parameters, directions, given)
        compliance = PER_MILLION * parameters["c"]
        return lengths, [one / (1.0 + compliance * by) for one, by in zip(lengths, forces, strict=True)]

    def _span(self, parameters: Parameters, p: Row) -> tuple[Row, Sequence[Row]]:
        """Return the lines' lengths, N arrays (...), and directions u, as many by axes.

        Line by line: arrays whose last axis is as short as that of the lines are slow ones.
        """
        anchors = [parameters[f"A_{axis}"] for axis in self.axes]
        spans = [[one[..., k] - at for one, at in zip(anchors, p, strict=True)] for k in range(len(self.parallel))]
        if len(self.away):
            lengths = [sqrt(x * x + y * y + z * z) for (x, y), z in zip(spans, self.away, strict=True)]
        else:
            lengths = [sqrt(x * x + y * y + z * z) for x, y, z in spans]
        return lengths, [[one / by for one in span] for span, by in zip(spans, lengths, strict=True)]

    def _pull(self, parameters: Parameters, directions: Sequence[Row], given: Given | None) -> Row:
        """Return the lines' tensions, N arrays (...)."""
        if self.tension == "hanging":
            return self._hang(parameters["T"], directions)[0]
        return [*self.at_origin] if given is None else [given[name] for name in self.given]

    def _hang(self, even: np.ndarray, directions: Sequence[Row]) -> tuple[Row, Row, Sequence[Row]]:
        """Return tensions F = T + uᵀλ, N arrays (...), of a point that hangs in its lines, λ and M⁻¹ = (U Uᵀ)⁻¹."""
        # by its six entries: Cramer's rule is quicker than LAPACK for a pose each
        xx, yy, zz, xy, xz, yz = (
            sum(one[i] * one[j] for one in directions) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
        )
        p, q, r = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
        share = 1.0 / (xx * p + xy * q + xz * r)
        p, q, r = p * share, q * share, r * share
        s, t, u = (xx * zz - xz * xz) * share, (xy * xz - xx * yz) * share, (xx * yy - xy * xy) * share
        inverse = [[p, q, r], [q, s, t], [r, t, u]]
        open_ = [w - even * sum(one[i] for one in directions) for i, w in enumerate((0.0, 0.0, self.weight))]
        solved = [dot(row, open_) for row in inverse]
        return [even + dot(one, solved) for one in directions], solved, inverse

    # --- by the pose ---------------------------------------------------------------------------------------------

    def slopes(self, parameters: Parameters, v: np.ndarray, given: Given) -> Sequence[Row]:
        """Return ∂h/∂v in closed form: ∂l/∂p = -u, ∂θ/∂Δ = g m / r."""
        point = [v[..., k] for k in range(len(self.axes))]
        lengths, directions = self._span(parameters, point)
        _, before = self._pay_out(parameters, [0.0] * len(self.axes), None)
        away, by_point = self._stretch(parameters, lengths, directions, given)
        motors = []
        for k, slope in enumerate(by_point):
            paid_out = self.parallel[k] * parameters["Q"] * (away[k] - before[k])
            gain = self.gear * self.parallel[k] / np.sqrt(parameters["R"][..., k] ** 2 - paid_out)
            motors.append([gain * one for one in slope])
        turn, scale = parameters["omega"], 1.0 + parameters["s"]
        seen = [[scale, -scale * turn, 0.0], [scale * turn, scale, 0.0], [0.0, 0.0, scale]]
        n = len(self.axes)
        return [*motors, *(row[:n] for row in seen[:n]), *([-one for one in u] for u in directions)]

    def _stretch(
        self, parameters: Parameters, lengths: Row, directions: Sequence[Row], given: Given
    ) -> tuple[Row, Sequence[Row]]:
        """Return what has left the spools, N arrays (...), and its derivatives by the point, as many by axes."""
        rigid = [[-one for one in u] for u in directions]
        if self.tension == "none":
            return lengths, rigid
        compliance, paid_out, slopes = PER_MILLION * parameters["c"], [], []
        if self.tension == "hanging":
            forces, by_point = self._differentiate_forces(parameters["T"], lengths, directions)
        else:
            forces, by_point = self._pull(parameters, directions, given), [[0.0] * len(self.axes)] * len(lengths)
        for length, force, by, slope in zip(lengths, forces, by_point, rigid, strict=True):
            share = 1.0 / (1.0 + compliance * force)
            paid_out.append(length * share)
            slopes.append([share * (one - paid_out[-1] * compliance * two) for one, two in zip(slope, by, strict=True)])
        return paid_out, slopes

    def _differentiate_forces(
        self, even: np.ndarray, lengths: Row, directions: Sequence[Row]
    ) -> tuple[Row, Sequence[Row]]:
        """Return the tensions of a point that hangs and their derivatives by the point.

        With ∂u/∂p = -(1 - u uᵀ)/l and e = (λ - u uᵀλ)/l they are ∂F/∂p = -e + Bᵀ M⁻¹ u, where
        M ∂λ/∂p = B = Σ F (1 - u uᵀ)/l + u eᵀ.
        """
        forces, solved, inverse = self._hang(even, directions)
        by_length = [force / length for force, length in zip(forces, lengths, strict=True)]
        across = [
            [(one - (force - even) * axis) / length for one, axis in zip(solved, u, strict=True)]
            for force, length, u in zip(forces, lengths, directions, strict=True)
        ]
        every, axes = list(zip(by_length, directions, across, strict=True)), range(len(AXES))
        load = [[sum(u[i] * (e[m] - by * u[m]) for by, u, e in every) for m in axes] for i in axes]
        for i in axes:
            load[i][i] = load[i][i] + sum(by_length)
        slopes = []
        for u, e in zip(directions, across, strict=True):
            share = [dot(row, u) for row in inverse]
            slopes.append([sum(share[i] * load[i][m] for i in axes) - e[m] for m in axes])
        return forces, slopes


def dot(one: Row, other: Row) -> np.ndarray | float:
    """Return the scalar product of vectors given by their three components."""
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]
