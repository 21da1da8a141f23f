"""Names of the package's own classes that a config can use, and what each is: known without their modules.

`bayescal list` and the schemas for editors need no more, and importing every class takes seconds. The texts are the
classes' own first sentences; where names lead to is listed in the packages of the classes (see `registry`).
"""

from typing import Final

BUILT_IN: Final[dict[str, dict[str, str]]] = {
    "KINDS": {
        "audit": "What a machine's measurements can and cannot determine.",
        "selection": "Which poses to measure, by criteria and methods compared.",
        "selftest": "A study's config, checked by simulation and against its data.",
        "sessions": (
            "One machine measured again and again, or machines of one design: what moved, by how much, how sure."
        ),
        "simulation": (
            "Readings of any machine, or what an instrument sees of a platform on legs, with the truth beside them."
        ),
        "study": "A machine calibrated from what was measured of it: variants ranked by evidence and by prediction.",
        "sweep": "Many experiments of one kind that differ in some keys.",
        "table": "What actuators have to do by elevation, temperature and the like.",
    },
    "BLOCKS": {},
    "CLAIMS": {},
    "MACHINES": {
        "arm": "Joints in a chain; commands, or encoders, of each.",
        "delta": "Carriages below their endstops, and the height that a probe on the tool reads of the bed.",
        "five_bar": "Encoders of two cranks; instruments see the tool.",
        "line_machine": "A point on lines with encoders at their spools, seen or not by an instrument beside it.",
        "mount": "Encoders of both axes, and where the mount points on the sky.",
        "rotary_delta": "Encoders of the upper arms, and the height that a probe on the tool reads of the bed.",
        "sliding_platform": (
            "A planar platform on N sliding legs with its sensors, and its tool's pose as an instrument sees it."
        ),
        "strut_machine": (
            "A hexapod on struts with encoders, seen or not by an instrument, at known elevations and temperatures."
        ),
    },
    "INSTRUMENTS": {
        "camera": "A camera: position and rotation vector of a calibration board in the camera's frame.",
        "distance": (
            "A ball bar or a draw-wire: the distance from a fixed point to a point on the tool, less that "
            "where it is zero."
        ),
        "plane": "A touch probe on a plane: how high its tip is over it, zero where it touches.",
        "point": "A tracked point: x, y and z of a target on the tool, in the instrument's frame.",
        "pose": "A tracked pose: position and rotation vector of a frame on the tool, in the instrument's frame.",
        "socket": "A socket of a ball: by how much its centre is off the socket's place, along the axes of the base.",
    },
    "READERS": {},
    "MODELS": {
        "beam": "P-U-S legs whose joints are flexures that bend as beams.",
        "jacobian": "Kinematics linear in pose and actuators.",
        "six_pus": "P-U-S legs with perfect joints.",
        "six_ups": "U-P-S struts with perfect joints.",
        "stiffness": "Static equilibrium on legs that are chains of beams, taken along the legs as they stand.",
        "stiffness_fixed": "The report's own: K of every leg stays as it is at the home pose (eq. 28).",
    },
    "DEFORMATIONS": {
        "free_matrix": (
            "Every actuator moves every joint, Δb_z = K Δρ, and nothing of K is known but a tolerance: "
            "nominally it is zero."
        ),
        "linear": "Each joint follows its own actuator, Δb_z,i = κ_i Δρ_i (RR-8096 eq. 1); ``kappa`` is nominal.",
        "matrix": "Every actuator moves every joint, Δb_z = K Δρ (RR-8096 eq. 2), K of shape (N, N) in mm per mm.",
        "none": "No deformation: the platform is rigid, b* = b (RR-8096 section 7.1).",
    },
    "ERRORS": {
        "function": "Functions of F channels, which share G scales and a length.",
    },
    "SAMPLERS": {
        "emcee": (
            "Ensembles that mix jumps of the proposal with emcee's differential evolution; each ensemble is a chain."
        ),
        "nautilus": (
            "Importance nested sampling from the prior by the library nautilus, an outside check of the evidence."
        ),
        "smc": "Sequential Monte Carlo from the prior to the posterior, which owes nothing to the search for modes.",
    },
    "SENSORS": {
        "pose": (
            "Whole poses, or only positions or orientations, as a laser tracker with its probe has them, "
            "noise independent."
        ),
        "targets": (
            "Targets on the platform, and on the base where the instrument's own frame wanders: "
            "photogrammetry, a tracker."
        ),
    },
    "CRITERIA": {
        "A": "Minus the mean posterior variance of parameters, in shares of the prior's.",
        "D": "½ log det(1 + Λ): what the poses tell of the parameters, in nats, prior and noise counted.",
        "I": "Minus the mean over the workspace of the predicted pose's weighted variance that the parameters cause.",
        "O1": "O1 = (σ_1 … σ_L)^(1/L) / √n.",
        "O2": "O2 = σ_L / σ_1.",
        "O3": "O3 = σ_L.",
        "O4": "O4 = σ_L² / σ_1.",
        "O5": "O5 = 1 / Σ 1/σ_i.",
    },
    "METHODS": {
        "continuous": "Local optimisation of all poses of a set that another method found.",
        "exchange": (
            "Eliminate and add; where the pose that matters least stays the best choice, the next one is tried."
        ),
        "random": "The best of random sets; its trace holds the criterion of each (Yu, Wu and Wang 2023, figure 7).",
    },
}
