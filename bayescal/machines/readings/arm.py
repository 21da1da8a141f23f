"""An arm: joints in a chain, from Denavit-Hartenberg rows or a URDF file, with the errors that joints and links have.

The coordinates q are what the joints have turned or slid. With O_i the nominal frame of joint i in that before,
M_i(q_i) a turn about, or a slide along, its z axis and E_i its error the tip stands at

    T(q) = Π O_i E_i M_i(q_i) O_tip E_tip,    E_i = (x, y, z; rx, ry, offset),

in the frame of joint i itself, so that parallel axes have no singularity, as the complete and continuous
parametrisations of Mooring, Roth and Driels (1991) have none. ``offset`` turns about the joint's own axis: the zero of
a joint that turns; ``z`` is that of one that slides. Commands, or encoders, read

    q_i - gain_i q_i - s1_i sin q_i - c1_i cos q_i - s2_i sin 2 q_i - c2_i cos 2 q_i - k_i τ_i(q),

the harmonics those of an eccentric gear or scale, k_i the compliance of a joint under the moment τ_i of what it carries
about its axis, of the nominal chain and its stated masses.

Not all of these can be distinguished: z_i and offset_i move on to the next joint whose axis is parallel, those of the
first joint are as well the instrument's frame, those of the last the tool's; gain and harmonics look alike where a
joint turns little. Of tips seen as points 4 n + 3 directions are determined at most for n joints that turn.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

import numpy as np
from pydantic import Field, PrivateAttr, ValidationInfo, model_validator
from scipy.spatial.transform import Rotation

from bayescal.config.load import FOLDER
from bayescal.config.sections import InputFile, NotNegative, Number, Section, Vector
from bayescal.errors import say_twice
from bayescal.machines.chains import FURTHEST, Chain, DenavitRow, Joint, Place, chain_rows, read_urdf
from bayescal.machines.parameters import ParameterBlock
from bayescal.machines.readings.base import POSE_CHANNELS, Channel, Coordinate, Given
from bayescal.machines.readings.function import Parameters, ReadingMachine
from bayescal.numerics.analytic import rotation_matrix, rotation_vector
from bayescal.numerics.geometry import Array, compute_left_inverse_jacobian, compute_left_jacobian

GRAVITY: Final = 9.80665
PLACES: Final = ("x", "y", "z")
TURNS: Final = ("rx", "ry", "offset")
HARMONICS: Final = {"s1": (np.sin, 1), "c1": (np.cos, 1), "s2": (np.sin, 2), "c2": (np.cos, 2)}
N_M: Final = 1e-3  # per N mm
PER_MILLION: Final = 1e-6
NO_ENDS: Final = (-np.inf, np.inf)
FULL_TURN: Final = np.pi  # either way, of a joint whose range nobody says


class JointConfig(Section):
    """A joint by its Denavit-Hartenberg row."""

    d_mm: Number = 0.0
    """Along its axis [mm]."""
    a_mm: Number = 0.0
    """Along the common normal of two axes [mm]."""
    alpha_deg: Number = 0.0
    """Between two axes, about their common normal."""
    theta_deg: Number = 0.0
    """About its axis where it reads zero."""
    name: str = ""
    """What the joint is called."""
    range_deg: Annotated[list[Number], Field(min_length=2, max_length=2)] = Field(default=[-180.0, 180.0])
    """Smallest and largest reading of a joint that turns."""
    range_mm: Annotated[list[Number], Field(min_length=2, max_length=2)] = Field(default=[])
    """Smallest and largest reading of a joint that slides along its axis: one that states it does."""
    mass_kg: NotNegative = 0.0
    """What it moves up to the next joint."""
    centre_mm: Vector = Field(default=[0.0, 0.0, 0.0])
    """Centre of that mass, in the frame that its row ends in (modified rows: the joint's own)."""


class ArmConfig(Section):
    """An arm: a URDF file with the links it runs between, or the rows of its joints."""

    urdf: InputFile | None = None
    """URDF file, of which origins, axes, limits and inertias are read."""
    base: str = ""
    """Link of the URDF file that stands still; its root where nothing is said."""
    tip: str = ""
    """Link of the URDF file whose pose counts; its only leaf where nothing is said."""
    joints: list[JointConfig] = Field(default=[])
    """Rows of the joints, instead of a URDF file."""
    convention: Literal["classical", "modified"] = "classical"
    """Of the rows: `classical` (Denavit and Hartenberg) or `modified` (Craig)."""
    base_mm: Vector = Field(default=[0.0, 0.0, 0.0])
    """Where the frame that the first row begins in is, seen from the base."""
    base_deg: Vector = Field(default=[0.0, 0.0, 0.0])
    """Rotation vector that turns the axes of the base to that frame's."""
    tip_mm: Vector = Field(default=[0.0, 0.0, 0.0])
    """Where the tip is in the frame that the last row ends in."""
    tip_deg: Vector = Field(default=[0.0, 0.0, 0.0])
    """Rotation vector that turns the axes of that frame to the tip's."""
    payload_kg: NotNegative = 0.0
    """Mass at the tip."""
    down: Vector = Field(default=[0.0, 0.0, -1.0])
    """Where gravity points, frame of the base; of any length [1]."""
    workspace_deg: list[Annotated[list[Number], Field(min_length=2, max_length=2)]] = Field(default=[])
    """Smallest and largest angle of each joint (mm of one that slides) where accuracy counts; the joints' ranges where
    nothing is said.
    """
    _chain: Chain = PrivateAttr()

    @property
    def chain(self) -> Chain:
        """The joints."""
        return self._chain

    @model_validator(mode="after")
    def _read_chain(self, info: ValidationInfo) -> Self:
        if (self.urdf is None) == (not self.joints):
            raise ValueError("found both or neither of urdf and joints, expected one")
        if self.urdf is not None:
            folder = (info.context or {}).get(FOLDER, Path())
            self._chain = read_urdf(folder / self.urdf, self.base, self.tip)
        else:
            if self.base or self.tip:
                raise ValueError("found base or tip beside joints, expected them beside urdf")
            self._chain = self._chain_rows()
            if self._chain.reach > FURTHEST:
                raise ValueError(f"found an arm of {self._chain.reach / 1e3:.0f} m, expected lengths in mm")
        if not any(self.down):
            raise ValueError("down: found a zero vector, expected a direction")
        n, names = len(self._chain.joints), [one.name for one in self._chain.joints]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(say_twice("joints", name))
        if self.workspace_deg and len(self.workspace_deg) != n:
            raise ValueError(f"workspace_deg: found {len(self.workspace_deg)} joints, expected {n}")
        ranges = [stated for one in self.joints for stated in (one.range_deg, one.range_mm) if stated]
        for low, high in (*self.workspace_deg, *ranges):
            if not low < high:
                raise ValueError(f"found a range from {low:g} to {high:g}, expected the smaller first")
        return self

    def _chain_rows(self) -> Chain:
        rows = [
            DenavitRow(one.d_mm, one.a_mm, *(float(x) for x in np.radians([one.alpha_deg, one.theta_deg])))
            for one in self.joints
        ]
        joints = list[Joint]()
        for k, (one, row) in enumerate(zip(self.joints, rows, strict=True), start=1):
            low, high = one.range_mm or np.radians(one.range_deg)
            centre = np.array(one.centre_mm)
            if self.convention == "classical":  # the row's end, seen from the joint's own frame
                end = Place(np.array([row.a, 0.0, 0.0]), Rotation.from_euler("x", row.alpha).as_matrix())
                centre = end.position + end.axes @ centre
            name = one.name or f"joint_{k}"
            joints.append(Joint(name, Place(), bool(one.range_mm), (float(low), float(high)), one.mass_kg, centre))
        base, tip = (
            Place(np.array(position), Rotation.from_rotvec(np.radians(turn)).as_matrix())
            for position, turn in ((self.base_mm, self.base_deg), (self.tip_mm, self.tip_deg))
        )
        return chain_rows(rows, joints, self.convention == "modified", tip, base)


class Arm(ReadingMachine):
    """Joints in a chain; commands, or encoders, of each."""

    Config = ArmConfig
    member = "joint"
    commanded = ("joint",)
    tool_channels = POSE_CHANNELS

    def __init__(self, config: ArmConfig) -> None:
        """Lay out parameters, coordinates and channels."""
        super().__init__(config)
        self.chain = config.chain
        joints, n = self.chain.joints, len(self.chain.joints)
        self.down = GRAVITY * np.array(config.down) / np.linalg.norm(config.down)
        self.payload = config.payload_kg
        self.has_mass = bool(self.payload or any(one.mass for one in joints))
        self.slides = np.array([one.slides for one in joints])
        nothing = (0.0,) * n
        self.parameters = [
            *(ParameterBlock(symbol, nothing) for symbol in PLACES),
            *(ParameterBlock(symbol, nothing, "rad") for symbol in TURNS),
            ParameterBlock("tool", (0.0,) * 3, axes="xyz"),
            ParameterBlock("tool_r", (0.0,) * 3, "rad", axes="xyz"),
            ParameterBlock("gain", nothing, "1"),
            *(ParameterBlock(symbol, nothing, "rad") for symbol in HARMONICS),
            *([ParameterBlock("k", nothing, "1e-6 rad/(N m)")] if self.has_mass else []),
        ]
        ends = [one.ends if one.slides else _limit(*one.ends) for one in joints]
        if config.workspace_deg:
            unit = np.where(self.slides, 1.0, np.radians(1.0))[:, None]
            ends = [(float(low), float(high)) for low, high in unit * np.array(config.workspace_deg)]
        units = ["mm" if one else "rad" for one in self.slides]
        self.coordinates = [
            Coordinate(f"q{k}", unit, (low + high) / 2.0, (high - low) / 2.0)
            for k, (unit, (low, high)) in enumerate(zip(units, ends, strict=True), start=1)
        ]
        own = zip(units, joints, config.joints or (None,) * n, strict=True)
        self.channels = [  # a row's range counts where somebody states it
            Channel(
                f"joint[{k}]", unit, ends=joint.ends if row is None or "range_deg" in row.model_fields_set else NO_ENDS
            )
            for k, (unit, joint, row) in enumerate(own, start=1)
        ]

    def read(self, parameters: Parameters, v: np.ndarray, given: Given) -> np.ndarray:
        """Return what commands, or encoders, of the joints read."""
        del given
        turned = v - parameters["gain"] * v
        for symbol, (function, times) in HARMONICS.items():
            if np.any(parameters[symbol]):
                turned = turned - parameters[symbol] * np.where(self.slides, 0.0, function(times * v))
        if self.has_mass and np.any(parameters["k"]):
            axes, carried, _ = self._weigh(v)
            moment = (np.cross(axes, carried) @ self.down) * N_M * ~self.slides
            turned = turned - PER_MILLION * parameters["k"] * moment
        return np.asarray(turned)

    def slopes(self, parameters: Parameters, v: np.ndarray, given: Given) -> Sequence[Sequence[np.ndarray | float]]:
        """Return ∂h/∂q: of a joint by itself, and by what all joints change of the moment about its axis.

        The moment is g·(z_k × S_k), S_k the first moment of mass beyond joint k: with i the lower and j the upper of
        two joints it changes by g·(z_i × (z_j × S_j)) where j turns, by g·(z_k × z_j) m_j where j, beyond k, slides.
        """
        del given
        own = 1.0 - parameters["gain"] * np.ones_like(v)
        for symbol, (_, times) in HARMONICS.items():
            change = times * np.cos(times * v) if symbol[0] == "s" else -times * np.sin(times * v)
            own = own - parameters[symbol] * np.where(self.slides, 0.0, change)
        n = len(self.chain.joints)
        rows = [[own[..., k] if i == k else 0.0 for i in range(n)] for k in range(n)]
        if self.has_mass and np.any(parameters["k"]):
            axes, carried, mass = self._weigh(v)
            lever = np.cross(axes, carried)
            for k in np.flatnonzero(~self.slides).tolist():
                for i in range(n):
                    turn = np.cross(axes[..., min(i, k), :], lever[..., max(i, k), :])
                    if self.slides[i]:
                        turn = np.cross(axes[..., k, :], axes[..., i, :]) * mass[i] * (i > k)
                    rows[k][i] = rows[k][i] - PER_MILLION * parameters["k"][..., k] * N_M * (turn @ self.down)
        return rows

    # --- where the tip is --------------------------------------------------------------------------------------------

    def _follow(self, parameters: Parameters, v: np.ndarray) -> dict[str, Any]:
        """Return origins (..., n + 1, 3) and axes (..., n + 1, 3, 3) of all joints and the tip, base frame.

        ``drawn`` are the axes in which errors stand, before they turn; ``axes`` those of a joint before it moves.
        """
        places = np.stack([parameters[symbol] for symbol in PLACES], axis=-1)
        turns = np.stack([parameters[symbol] for symbol in TURNS], axis=-1)
        errors = rotation_matrix(turns)
        leading = np.broadcast_shapes(places.shape[:-2], v.shape[:-1])
        position: np.ndarray = np.zeros(3)
        axes: np.ndarray = np.eye(3)
        origins, drawn, turned = list[np.ndarray](), list[np.ndarray](), list[np.ndarray]()
        for k, joint in enumerate(self.chain.joints):
            position = position + axes @ joint.place.position
            drawn.append(axes @ joint.place.axes)
            position = position + (drawn[-1] @ places[..., k, :, None])[..., 0]
            axes = drawn[-1] @ errors[..., k, :, :]
            turned.append(axes)
            origins.append(position)
            q = v[..., k, None]
            x, y, z = (axes[..., i] for i in range(3))
            if joint.slides:
                position = position + q * z
            else:
                cosine, sine = np.cos(q), np.sin(q)
                axes = np.stack(np.broadcast_arrays(cosine * x + sine * y, cosine * y - sine * x, z), axis=-1)
        position = position + axes @ self.chain.tip.position
        drawn.append(axes @ self.chain.tip.axes)
        origins.append(position + (drawn[-1] @ parameters["tool"][..., None])[..., 0])
        turned.append(drawn[-1] @ rotation_matrix(parameters["tool_r"]))
        return {
            "origins": np.stack([np.broadcast_to(one, (*leading, 3)) for one in origins], axis=-2),
            "drawn": np.stack([np.broadcast_to(one, (*leading, 3, 3)) for one in drawn], axis=-3),
            "axes": np.stack([np.broadcast_to(one, (*leading, 3, 3)) for one in turned], axis=-3),
            "turns": turns,
        }

    def _walk(self, steps: Array, v: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield where each joint stands and its axes before it moves, (..., 3) and (..., 3, 3), and the tip's at last.

        Of one machine, steps (n + 1, 3, 4) and coordinates (..., n), or of many, (B, n + 1, 3, 4) and (P, n) or
        (B, P, n): what leads from one joint to the next, axes beside place. The axes of all poses of a machine are the
        rows of one matrix.
        """
        lead = steps.shape[:-3]
        shape = np.broadcast_shapes((*lead, *(1,) * len(lead)), v.shape[:-1])
        axes, position = np.broadcast_to(np.eye(3), (*shape, 3, 3)), np.zeros((*shape, 3))
        cosine, sine = np.cos(v)[..., None], np.sin(v)[..., None]
        for k in range(steps.shape[-3]):
            moved = (axes.reshape(*lead, -1, 3) @ steps[..., k, :, :]).reshape(*shape, 3, 4)
            axes, position = moved[..., :3], position + moved[..., 3]
            yield position, axes
            if k == len(self.slides):
                return
            if self.slides[k]:
                position = position + v[..., k, None] * axes[..., 2]
                continue
            x, y, c, s = axes[..., 0], axes[..., 1], cosine[..., k, :], sine[..., k, :]
            axes = np.stack([c * x + s * y, c * y - s * x, axes[..., 2]], axis=-1)

    @cached_property
    def _drawn_steps(self) -> Array:
        """What leads from joint to joint of the chain as it is drawn, (n + 1, 3, 4)."""
        places = [*(one.place for one in self.chain.joints), self.chain.tip]
        return np.stack([np.column_stack([one.axes, one.position]) for one in places])

    def _weigh(self, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, Array]:
        """Return axes of the joints (..., n, 3), the first moment about each of the mass beyond it, and that mass (n,).

        Of the chain as it is drawn, kg mm and kg.
        """
        *joints, (tip, _) = self._walk(self._drawn_steps, v)
        moment, mass, moments, masses = self.payload * tip, self.payload, list[np.ndarray](), list[float]()
        for k in reversed(range(len(joints))):
            joint, (origin, axes) = self.chain.joints[k], joints[k]
            if joint.mass:
                q, (x, y, z) = v[..., k, None], (axes[..., i] for i in range(3))
                cosine, sine = (np.cos(q), np.sin(q)) if not joint.slides else (1.0, 0.0)
                a, b, c = joint.centre
                centre = origin + a * (cosine * x + sine * y) + b * (cosine * y - sine * x) + c * z
                moment = moment + joint.mass * (centre + (q * z if joint.slides else 0.0))
                mass += joint.mass
            moments.insert(0, moment - mass * origin)
            masses.insert(0, mass)
        return np.stack([axes[..., 2] for _, axes in joints], axis=-2), np.stack(moments, axis=-2), np.array(masses)

    def tool(self, parameters: Parameters, v: np.ndarray) -> np.ndarray:
        """Return position and rotation vector of the tip in the base frame."""
        position, axes = self.place_tool(parameters, v)
        return np.concatenate([position, rotation_vector(axes)], axis=-1)

    def place_tool(self, parameters: Parameters, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return position and axes of the tip in the base frame."""
        own = parameters["x"]
        if own.ndim == 3 and own.shape[1] == 1 and v.ndim > 1 and not np.iscomplexobj(own) and not np.iscomplexobj(v):
            return self._follow_many(parameters, v)
        at = self._follow(parameters, v)
        return at["origins"][..., -1, :], at["axes"][..., -1, :, :]

    def _follow_many(self, parameters: Parameters, v: np.ndarray) -> tuple[Array, Array]:
        """Return the tip of many machines (B, 1, D) at poses (P, n) or (B, P, n): a product of matrices each a joint.

        As `_follow`, where the axes of all poses of a machine are the rows of one matrix.
        """
        moves = [np.stack([parameters[one] for one in names], axis=-1)[:, 0] for names in (PLACES, TURNS)]
        tools = (parameters["tool"], parameters["tool_r"])
        moves = [np.concatenate([one, tool], axis=1) for one, tool in zip(moves, tools, strict=True)]
        turns, drawn = rotation_matrix(moves[1]), self._drawn_steps
        moved = drawn[:, :, 3] + np.einsum("kij,bkj->bki", drawn[:, :, :3], moves[0])
        *_, tip = self._walk(np.concatenate([drawn[:, :, :3] @ turns, moved[..., None]], axis=-1), v)
        return tip

    def outline(self, parameters: Parameters, v: np.ndarray) -> tuple[np.ndarray, Sequence[tuple[int, int]]]:
        """Return the base, where each joint's frame stands, and the tip, one after another."""
        origins = self._follow(parameters, v)["origins"]
        base = np.zeros((*origins.shape[:-2], 1, 3))
        return np.concatenate([base, origins], axis=-2), [(k, k + 1) for k in range(origins.shape[-2])]

    def tool_slopes(
        self, parameters: Parameters, v: np.ndarray, with_parameters: bool
    ) -> tuple[Array, Mapping[str, Array]]:
        """Return how the tip moves by the coordinates, (..., 6, n), and by parameters: a screw of each."""
        at = self._follow(parameters, v)
        n = len(self.chain.joints)
        tip = at["origins"][..., -1:, :]
        reach = tip - at["origins"][..., :-1, :]
        vector = compute_left_inverse_jacobian(rotation_vector(at["axes"][..., -1, :, :]))[..., None, :, :]

        def screw(axis: Array, arm: Array) -> Array:
            """Return what a turn about an axis through a point moves, (..., 6)."""
            turned = (vector @ axis[..., None])[..., 0]
            moved, turned = np.broadcast_arrays(np.cross(axis, arm), turned)
            return np.concatenate([moved, turned], axis=-1)

        def slide(axis: Array) -> Array:
            return np.concatenate([axis, np.zeros_like(axis)], axis=-1)

        own = at["axes"][..., :n, :, 2]
        by_pose = np.where(self.slides[:, None], slide(own), screw(own, reach))
        by = dict[str, Array]()
        if not with_parameters:
            return np.swapaxes(by_pose, -1, -2), by
        # Exp(φ + dφ) = Exp(Jl dφ) Exp(φ), in the axes as drawn
        bent = at["drawn"][..., :n, :, :] @ compute_left_jacobian(at["turns"])
        # a slide comes after its joint's error, which turns it: the arm reaches from the joint's origin all the same
        for i in range(3):
            by[PLACES[i]] = np.swapaxes(slide(at["drawn"][..., :n, :, i]), -1, -2)
            by[TURNS[i]] = np.swapaxes(screw(bent[..., i], reach), -1, -2)
        last = at["drawn"][..., -1, :, :]
        by["tool"] = np.concatenate([last, np.zeros_like(last)], axis=-2)
        turned = vector[..., 0, :, :] @ last @ compute_left_jacobian(np.asarray(parameters["tool_r"]))
        by["tool_r"] = np.concatenate([np.zeros_like(turned), turned], axis=-2)
        return np.swapaxes(by_pose, -1, -2), by


def _limit(low: float, high: float) -> tuple[float, float]:
    """Return the range of a joint that turns, within one full turn about zero where it has any of it."""
    inner = max(low, -FULL_TURN), min(high, FULL_TURN)
    return inner if inner[0] < inner[1] else (max(low, high - 2.0 * FULL_TURN), high)
