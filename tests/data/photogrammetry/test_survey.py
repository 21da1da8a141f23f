"""Surveys from files: every fault of the data names file and line; targets that were not seen are no fault."""

from __future__ import annotations

import random
import re
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import studies
from refusals import line_of

from bayescal.data.actuators import name_actuators
from bayescal.data.photogrammetry.poses import extract_poses
from bayescal.data.photogrammetry.survey import Survey, read_survey
from bayescal.errors import BayescalError

FILES = ("data/targets.csv", "data/actuators.csv", "data/target_reference.csv")
N_MUTATIONS = 250


@pytest.fixture
def folder(tmp_path) -> Path:
    """Return a folder with a tiny study and its data."""
    studies.write_tiny_study(tmp_path)
    return tmp_path


def read(folder: Path) -> Survey:
    return read_survey(*(folder / name for name in FILES), name_actuators(6))


def fail(folder: Path, name: str) -> str:
    """Return the one-line message with which reading fails; it names the file at fault."""
    message = line_of(read, folder)
    assert str(folder / name) in message
    return message


def change_rows(path: Path, change: Callable[[list[str]], list[str] | None]) -> None:
    """Change the cells of every data row, or drop the row where the change returns None."""
    lines = path.read_text().splitlines()
    start = next(k for k, line in enumerate(lines) if not line.startswith("#")) + 1
    rows = [change(line.split(",")) for line in lines[start:]]
    path.write_text("\n".join([*lines[:start], *(",".join(row) for row in rows if row is not None)]) + "\n")


def test_tiny_survey_reads(folder):
    survey = read(folder)
    assert len(survey.poses) == studies.N_CALIBRATION + studies.N_VERIFICATION
    assert int(survey.verification.sum()) == studies.N_VERIFICATION
    assert survey.base.measured.shape == (16, 7, 3)
    assert survey.platform.measured.shape == (16, 7 + 6 * 2, 3)
    assert np.isfinite(survey.platform.measured).all()
    np.testing.assert_array_equal(np.unique(survey.platform.leg), range(7))


# --- faults on a line ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "start", "old", "new", "expected"),
    [
        (0, "pose,body", "x_mm", "x_in", "found column 'x_in', did you mean 'x_mm'?"),
        (0, "pose,body", ",z_mm", "", "found no column 'z_mm'"),
        (0, "C02,base,B03", "C02,base,B03,", "C02,base,B03,oops", "x_mm: found 'oops"),
        (0, "C02,base,B03", "C02,base,B03,", "C02,base,B03,,", "found 7 cells, expected 6"),
        (0, "C02,base,B03", "base", "bass", "body: found 'bass', expected one of base, platform"),
        (0, "C02,base,B03", "B03", "B99", "base target 'B99': not in"),
        (0, "C02,base,B03", "B03", "B02", "pose/body/target 'C02/base/B02' is already on line"),
        (0, "C02,base,B03", "C02", "C99", "pose 'C99': not in"),
        (0, "C02,base,B03", "C02", "", "pose: found an empty cell, expected a name"),
        (1, "pose,use", "rho_6_mm", "rho_6_in", "found column 'rho_6_in', did you mean 'rho_6_mm'?"),
        (1, "pose,use", ",rho_6_mm", "", "found no column 'rho_6_mm'"),
        (1, "pose,use", "rho_6_mm", "rho_6_mm,rho_7_mm", "found column 'rho_7_mm'"),
        (1, "C03", "calibration", "calibrate", "use: found 'calibrate', expected one of calibration, verification"),
        (1, "C03", "C03", "C02", "pose 'C02' is already on line"),
        (1, "C03", "C03,calibration,", "C03,calibration,nan", "expected"),
        (2, "base,B02", "B02", "B01", "target 'base/B01' is already on line"),
        (2, "base,B02", "base", "basis", "body: found 'basis'"),
        (2, "base,B02,0", ",0,", ",1,", "leg: found 1, expected 0 on the base"),
        (2, "platform,L11", ",1,", ",7,", "leg: found 7, expected 0 to 6"),
        (2, "platform,L11", ",1,", ",1.5,", "leg: found 1.5, expected 0 to 6"),
        (2, "platform,L11", ",1,", ",-1,", "leg: found -1, expected 0 to 6"),
    ],
)
def test_fault_names_file_and_line(folder, name, start, old, new, expected):
    path = folder / FILES[name]
    line = studies.find_line(path, start)
    lines = path.read_text().splitlines()
    assert old in lines[line - 1]
    lines[line - 1] = lines[line - 1].replace(old, new, 1)
    path.write_text("\n".join(lines) + "\n")
    message = fail(folder, FILES[name])
    assert f"line {line}: " in message
    assert expected in message


def on_a_line(body):
    """Return a change that puts the rigid targets of a body on a line."""
    return lambda row: [*row[:3], str(10 * int(row[1][1:])), "1", "2"] if (row[0], row[2]) == (body, "0") else row


def hide(body):
    """Return a change that hides all but two rigid targets of a body at pose C04."""
    hidden = {f"{body[0].upper()}0{k}" for k in range(3, 8)}
    return lambda row: None if row[0] == "C04" and row[2] in hidden else row


FAULTS = {
    "no targets": (0, lambda row: None if row[0] == "C05" else row, 1, "found no targets of pose 'C05'"),
    "no actuators": (1, lambda row: None if row[0] == "C05" else row, 0, "pose 'C05': not in"),
    "no calibration": (1, lambda row: [row[0], "verification", *row[2:]], 1, "found no calibration pose"),
    **{
        f"two on the {body}": (
            0,
            hide(body),
            0,
            f"pose 'C04': found 2 rigid targets on the {body}, expected at least 3",
        )
        for body in ("base", "platform")
    },
    "pads alone": (
        2,
        lambda row: [*row[:2], "1", *row[3:]] if row[1].startswith("P") else row,
        2,
        "found 0 rigid targets on the platform, expected at least 3",
    ),
    **{
        f"a line on the {body}": (2, on_a_line(body), 2, f"rigid targets of the {body} lie")
        for body in ("base", "platform")
    },
    "one point": (2, lambda row: [*row[:3], "1", "2", "3"] if row[0] == "base" else row, 2, "lie on a line"),
}


@pytest.mark.parametrize(("changed", "change", "named", "expected"), FAULTS.values(), ids=FAULTS)
def test_a_survey_that_lacks_something_is_refused(folder, changed, change, named, expected):
    """The message names the file that was changed, and of poses that one of two files lacks the other as well."""
    change_rows(folder / FILES[changed], change)
    message = fail(folder, FILES[named])
    assert expected in message
    assert str(folder / FILES[changed]) in message


def test_collinear_as_seen(folder):
    on_line = {"B01", "B02", "B03"}
    change_rows(
        folder / FILES[2],
        lambda row: [*row[:3], str(50 * int(row[1][1:])), "0", "0"] if row[1] in on_line else row,
    )
    assert read(folder).base.reference.shape == (7, 3)
    change_rows(folder / FILES[0], lambda row: None if row[:2] == ["C06", "base"] and row[2] not in on_line else row)
    assert "pose 'C06': seen" in fail(folder, FILES[0])


# --- targets that are measured, but wrong ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "place"),
    [
        (lambda row: [*row[:3], *(f"{1e-3 * float(x):.9f}" for x in row[3:])], "pose 'C01': base"),
        (lambda row: [*row[:3], "1", "2", "3"] if row[:2] == ["C02", "platform"] else row, "pose 'C02': platform"),
        (lambda row: [*row[:4], "0", "0"] if row[:2] == ["C02", "base"] else row, "pose 'C02': base"),
    ],
    ids=["metres", "all in one point", "measured on a line"],
)
def test_targets_that_fit_no_rigid_body_are_refused(folder, change, place):
    change_rows(folder / FILES[0], change)
    line = line_of(studies.load_study, folder / "study.toml")
    assert re.search(rf"targets\.csv: {place}: found \d consistent .* 3\b", line)


def test_one_wrong_target_is_rejected_and_named(folder):
    change_rows(
        folder / FILES[0], lambda row: [*row[:5], str(float(row[5]) + 5)] if row[:3] == ["C02", "base", "B04"] else row
    )
    inputs = studies.load_study(folder / "study.toml")
    assert ("C02", "base", "B04") in inputs.measured[0].targets.extraction.rejected


# --- what is no fault ------------------------------------------------------------------------------------------------


def test_single_missing_targets_are_nan_and_no_fault(folder):
    missing = {("C01", "B02"), ("C01", "L31"), ("C07", "P05"), ("V02", "B01")}
    change_rows(folder / FILES[0], lambda row: None if (row[0], row[2]) in missing else row)
    survey = read(folder)
    unseen = {
        (survey.poses[p], body.names[k])
        for body in (survey.base, survey.platform)
        for p, k in np.argwhere(np.isnan(body.measured[..., 0]))
    }
    assert unseen == missing
    assert np.isfinite(extract_poses(survey, 3e-3).poses.covariance).all()
    assert studies.load_study(folder / "study.toml").pads.pads is not None


@pytest.mark.parametrize(
    "rewrite",
    [
        lambda text: b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode(),
        lambda text: ("# more to say\n\n" + text + "\n# the end\n\n").encode(),
        lambda text: re.sub(",(?!.* )", " , ", text).encode(),
    ],
    ids=["byte order mark and windows lines", "comments", "spaces"],
)
def test_other_ways_to_write_the_same_survey(folder, rewrite):
    expected = read(folder)
    for name in FILES:
        (folder / name).write_bytes(rewrite((folder / name).read_text()))
    found = read(folder)
    assert found.poses == expected.poses
    assert found.platform.names == expected.platform.names
    np.testing.assert_array_equal(found.actuators, expected.actuators)
    np.testing.assert_array_equal(found.platform.measured, expected.platform.measured)


def test_order_of_rows_does_not_matter(folder):
    expected = read(folder)
    path = folder / FILES[0]
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:3], *reversed(lines[3:])]) + "\n")
    np.testing.assert_array_equal(read(folder).base.measured, expected.base.measured)


# --- fuzzing ---------------------------------------------------------------------------------------------------------

TOKENS = (
    *("nan", "inf", "-1", "0", "1e300", "-1e-300", '"', "'", "", ",", "\n", "[", "]", "{", "=", "#", "true", '"2 mm"'),
    *("1979-05-27", "\x00", "\ufeff", "\u2028", "é", "-", "1_0", "0x10", "[]", "[[]]", '""', "1e400", "[1,2]", "'''"),
    *("1" * 5000, "[" * 3000),
)


def mutate(text: str, rng: random.Random) -> str:
    """Return a text with one line spoilt: replaced, lost, doubled, one cell or character changed, exchanged."""
    lines = text.split("\n")
    n, token = rng.randrange(len(lines)), rng.choice(TOKENS)
    line = lines[n]
    at = rng.randrange(len(line) + 1)
    parts = re.split(r"([,= ])", line)
    parts[rng.randrange(len(parts))] = token
    other = rng.randrange(len(lines))
    operations: list[Callable[[], list[str]]] = [
        lambda: [*lines[:n], token, *lines[n + 1 :]],
        lambda: [*lines[:n], *lines[n + 1 :]],
        lambda: [*lines[:n], line, *lines[n:]],
        lambda: [*lines[:n], "".join(parts), *lines[n + 1 :]],
        lambda: [*lines[:n], line[:at] + token + line[at:], *lines[n + 1 :]],
        lambda: [*lines[:n], line[:at] + line[at + 1 :], *lines[n + 1 :]],
        lambda: [*lines[:n], lines[other], *lines[n + 1 :]],
    ]
    return "\n".join(rng.choice(operations)())


def find_refusal(folder: Path) -> BayescalError | None:
    """Return the error with which a study is refused, if it is; any other exception passes through."""
    try:
        studies.load_study(folder / "study.toml")
    except BayescalError as error:
        return error
    return None


@pytest.mark.runs
def test_no_mutation_of_a_file_ends_in_a_traceback(folder):
    rng = random.Random(8096)
    names = ("study.toml", "mechanism.toml", *FILES)
    refused = 0
    for _ in range(N_MUTATIONS):
        name = rng.choice(names)
        text = (folder / name).read_text()
        (folder / name).write_text(mutate(text, rng))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            found = find_refusal(folder)
        if found is not None:
            refused += 1
            assert found.exit_code in (2, 3)
            assert "\n" not in str(found)
            assert re.search("expected|cannot|not valid TOML|: not ", str(found)), found
        (folder / name).write_text(text)
    assert 0.4 * N_MUTATIONS < refused < N_MUTATIONS
