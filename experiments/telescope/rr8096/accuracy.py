"""Claims on accuracy and choice of model, from the posteriors' summary; and those that the data cannot judge."""

from __future__ import annotations

from bayescal.experiments.study.rows import ClaimRow
from rr8096.evidence import (
    DEFORMATION_ORDER,
    REFERENCE,
    TITLES,
    ClaimEvidence,
    ClaimRows,
    judge,
    untestable,
)
from rr8096.geometry import MICRO
from rr8096.identification import SAME, join, rms
from rr8096.identified import POINTS

EVIDENCE = 3.0
"""Difference of log-evidences up to which data do not tell two models apart."""
LENGTHS = (*POINTS, "l")
DESIRED_ORIENTATION = 0.05  # deg, table 1
POSTERIOR = "Errors of the posterior mean, model error free"
PERFECT = " The twin's joints are perfect: this says that poses cannot tell, not what the joints are."
TWIN = " The twin was simulated with the matrix deformation."


def _position(evidence: ClaimEvidence, name: str, use: str = "calibration") -> float:
    """Return the mean position error of a variant, µm."""
    return MICRO * float(evidence.variants[name][use]["position_error_mm"]["mean"])


def _orientation(evidence: ClaimEvidence, name: str, which: str = "mean", use: str = "calibration") -> float:
    """Return an orientation error of a variant, deg."""
    return float(evidence.variants[name][use]["orientation_error_deg"][which])


def _uses(evidence: ClaimEvidence, name: str) -> list[str]:
    return [use for use in ("calibration", "verification") if evidence.variants[name][use] is not None]


def _list(values: dict[str, str]) -> str:
    return ", ".join(f"{name} {value}" for name, value in values.items())


def jacobian_accuracy(evidence: ClaimEvidence) -> ClaimRows:
    """Sections 7.1.5 and 7.4: the Jacobian-based model is as accurate as the 6-PUS."""
    shared = evidence.deformations(REFERENCE, "jacobian")
    if not shared:
        return
    pairs = {d: [_position(evidence, f"{m}/{d}") for m in ("jacobian", REFERENCE)] for d in shared}
    ratios = {d: a / b for d, (a, b) in pairs.items()}
    worst = max(ratios.values())
    yield ClaimRow(
        claim="jacobian_accuracy",
        section="7.1.5",
        statement="The Jacobian-based model reaches the position accuracy of the 6-PUS.",
        expected="the same mean errors",
        found="mean errors of Jacobian-based and 6-PUS: "
        + _list({d: f"{a:.1f} and {b:.1f} µm" for d, (a, b) in pairs.items()}),
        value=worst,
        unit="1",
        verdict=judge(worst < 1.0 + SAME),
        reason=f"{POSTERIOR}, calibration poses; the largest ratio counts. The errors of linearisation are as large as "
        "the deformation, see linearisation.",
    )


def flexures_spherical(evidence: ClaimEvidence) -> ClaimRows:
    """Sections 7.4 and 8: flexures as perfect spherical joints."""
    for model in ("beam", "stiffness"):
        shared = evidence.deformations(REFERENCE, model)
        if not shared:
            continue
        pairs = {d: (evidence.variants[f"{model}/{d}"], evidence.variants[f"{REFERENCE}/{d}"]) for d in shared}
        gains = {d: a["log_evidence"] - b["log_evidence"] for d, (a, b) in pairs.items()}
        alone = [evidence.weigh_alone(f"{model}/{d}") - evidence.weigh_alone(f"{REFERENCE}/{d}") for d in shared]
        ratios = {d: _position(evidence, f"{model}/{d}") / _position(evidence, f"{REFERENCE}/{d}") for d in shared}
        largest = max(abs(x) for x in gains.values())
        close = all(abs(r - 1.0) < SAME for r in ratios.values())
        yield ClaimRow(
            claim=f"flexures_{model}",
            section="7.4, 8",
            statement=f"Flexures can be taken for spherical joints: the {TITLES[model]} model does no better than the "
            "6-PUS.",
            expected="the same accuracy",
            found=f"log-evidence over the 6-PUS {_list({d: f'{x:+.2f}' for d, x in gains.items()})}; "
            f"position errors as {_list({d: f'{r:.3f}' for d, r in ratios.items()})} to 1",
            value=largest,
            unit="nats",
            verdict=judge(close and largest < EVIDENCE),
            reason=f"{POSTERIOR}; models differ where evidence does by {EVIDENCE:g} nats or errors by a tenth. Without "
            f"model error evidence differs by up to {max(abs(x) for x in alone):.1f}, by Laplace's approximation."
            f"{PERFECT if evidence.simulated else ''}",
        )


def same_none_linear(evidence: ClaimEvidence) -> ClaimRows:
    """Section 7.2: no deformation or the linear one."""
    for model, title in TITLES.items():
        if not {"none", "linear"} <= set(evidence.deformations(model)):
            continue
        none, linear = (_position(evidence, f"{model}/{d}") for d in ("none", "linear"))
        yield ClaimRow(
            claim=f"same_none_linear_{model}",
            section="7.2",
            statement=f"Without deformation and with the linear one the {title} model is equally accurate.",
            expected="the same mean position errors",
            found=f"{none:.1f} µm without, {linear:.1f} µm with",
            value=none / linear,
            unit="1",
            verdict=judge(abs(none / linear - 1.0) < SAME),
            reason=f"{POSTERIOR}, calibration poses, within a tenth.",
        )


def matrix_gain(evidence: ClaimEvidence) -> ClaimRows:
    """Section 7.3: the matrix helps orientation, not position."""
    if not {"linear", "matrix"} <= set(evidence.deformations(REFERENCE)):
        return
    pair = [f"{REFERENCE}/{d}" for d in ("linear", "matrix")]
    uses = _uses(evidence, pair[0])
    position = {use: [_position(evidence, name, use) for name in pair] for use in uses}
    orientation = {use: [_orientation(evidence, name, use=use) for name in pair] for use in uses}
    gain = position["calibration"][0] / position["calibration"][1]
    reason = f"{POSTERIOR}, 6-PUS.{TWIN if evidence.simulated else ''}"
    yield ClaimRow(
        claim="matrix_position",
        section="7.3",
        statement="The matrix deformation does not improve position much over the linear one.",
        expected="no significant gain",
        found=f"mean errors {_list({u: f'{a:.1f} to {b:.1f} µm' for u, (a, b) in position.items()})}",
        value=gain,
        unit="1",
        verdict=judge(gain < 1.0 + SAME),
        reason=reason + (" The real platform must have deformed in more ways than K." if evidence.simulated else ""),
    )
    gain = orientation["calibration"][0] / orientation["calibration"][1]
    yield ClaimRow(
        claim="matrix_orientation",
        section="7.3",
        statement="The matrix deformation improves orientation over the linear one.",
        expected="smaller errors",
        found=f"mean errors {_list({u: f'{a:.4f} to {b:.4f} deg' for u, (a, b) in orientation.items()})}",
        value=gain,
        unit="1",
        verdict=judge(gain > 1.0 + SAME),
        reason=reason,
    )


def deformation_choice(evidence: ClaimEvidence) -> ClaimRows:
    """Section 7.4: accuracy cannot choose the deformation."""
    if not {"linear", "matrix"} <= set(evidence.deformations(REFERENCE)):
        return
    linear, matrix = (float(evidence.variants[f"{REFERENCE}/{d}"]["log_evidence"]) for d in ("linear", "matrix"))
    yield ClaimRow(
        claim="deformation_choice",
        section="7.4",
        statement="Results of calibration cannot choose between the linear and the matrix deformation.",
        expected="neither is preferred",
        found=f"log-evidence of matrix over linear {matrix - linear:+.0f}",
        value=matrix - linear,
        unit="nats",
        verdict=judge(abs(matrix - linear) < EVIDENCE),
        reason=f"6-PUS, model error free; {EVIDENCE:g} nats would be a preference.{TWIN if evidence.simulated else ''}",
    )


def orientation_reached(evidence: ClaimEvidence) -> ClaimRows:
    """Section 7.3: the linear model reaches the desired orientation accuracy."""
    models = [m for m in TITLES if "linear" in evidence.deformations(m)]
    if not models:
        return
    largest = {
        TITLES[m]: max(_orientation(evidence, f"{m}/linear", "max", use) for use in _uses(evidence, f"{m}/linear"))
        for m in models
    }
    worst = max(largest.values())
    yield ClaimRow(
        claim="orientation_reached",
        section="7.3",
        statement="The linear deformation suffices for the desired orientation accuracy.",
        expected=f"errors below {DESIRED_ORIENTATION:g} deg (180 arcsec; printed as arcmin)",
        found=f"largest errors {_list({m: f'{x:.3f} deg' for m, x in largest.items()})}",
        value=worst,
        unit="deg",
        verdict=judge(worst < DESIRED_ORIENTATION),
        reason=f"{POSTERIOR}, all poses.",
    )


def matrix_nearest(evidence: ClaimEvidence) -> ClaimRows:
    """Sections 7.4 and 8: the matrix brings the parameters nearest to nominal."""
    models = [m for m in TITLES if len(evidence.deformations(m)) == 3]
    if not models:
        return
    distance = {
        m: {
            d: float(evidence.variants[f"{m}/{d}"]["distance_from_nominal_mm"]) for d in evidence.deformations(m)
        }
        for m in models
    }
    worst = max(d["matrix"] / min(d["none"], d["linear"]) for d in distance.values())
    shown = {TITLES[m]: " / ".join(f"{x:.2f}" for x in d.values()) for m, d in distance.items()}
    tables = [evidence.published.get(f"{REFERENCE}/{d}", {}) for d in DEFORMATION_ORDER]
    printed = ""
    if all(set(LENGTHS) <= set(table) for table in tables):
        printed = "; tables 5 to 7 (a) " + " / ".join(f"{rms(join(table, LENGTHS)):.2f}" for table in tables)
    yield ClaimRow(
        claim="matrix_nearest",
        section="7.4, 8",
        statement="With the matrix deformation the parameters come out nearest to nominal.",
        expected="the least distance of the three",
        found=f"none / linear / matrix, mm rms: {_list(shown)}{printed}",
        value=worst,
        unit="1",
        verdict=judge(worst < 1.0),
        reason=f"Posterior means of all lengths; the largest ratio counts.{TWIN if evidence.simulated else ''}",
    )


def hardware(evidence: ClaimEvidence) -> ClaimRows:
    """List what only the telescope itself could tell."""
    yield untestable(
        "deformation_from_stress",
        "3.3, 7.4",
        "The platform deforms because the flexures are stressed.",
        "deformation follows the forces of the flexures",
        "Poses and targets show that it deforms with the actuators, not why; no force and no stiffness was measured.",
    )
    if not evidence.simulated:
        return
    origin = f"Origin of the data: {evidence.origin}."
    yield untestable(
        "accuracy_of_the_telescope",
        "7.4, 8",
        "The telescope is positioned to some micrometres after calibration (figures 15 to 17).",
        "some micrometres",
        f"{origin} Errors on a twin show what the models can do, not what the telescope does.",
    )
    yield untestable(
        "desired_accuracy",
        "2.3, 7.4",
        "The desired accuracy of table 1 is reached, 0.1 mm in x and y and 0.01 mm in z.",
        "10 µm in z",
        f"{origin} What the real platform does beyond K is not in it.",
    )


CLAIMS = (
    jacobian_accuracy,
    flexures_spherical,
    same_none_linear,
    matrix_gain,
    deformation_choice,
    orientation_reached,
    matrix_nearest,
    hardware,
)
