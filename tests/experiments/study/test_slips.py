"""Slips planted in the data of a study: refused where they contradict, else the cause is found; clean ones are not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import studies
from shares import run_rest

from bayescal.errors import InputError
from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.shared.slips import CORRECTED
from bayescal.experiments.simulation.compute import build_twin, format_survey
from bayescal.experiments.study.inputs import StudyInputs

type Rows = list[list[str]]

ACTUATORS, TARGETS, REFERENCE = "actuators.csv", "targets.csv", "target_reference.csv"
HOME = 10.0  # mm, of the initial actuator positions
NAMED = {
    "legs exchanged": (lambda rho: rho[:, [0, 2, 1, 3, 4, 5]], "readings of rho[2] and rho[3] seem to be exchanged"),
    "displacements in metres": (
        lambda rho: HOME + 1e-3 * (rho - HOME),
        "displacements of rho from home seem to be in metres",
    ),
    "the other sign": (lambda rho: 2 * HOME - rho, "displacements of rho from home seem to be of the other sign"),
}
"""What happens to the actuators' positions, and what is said of it."""


@pytest.fixture(scope="module")
def drawn(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("slips")
    studies.write_tiny_study(folder)
    return folder


def load(folder: Path):
    return StudyInputs.load(load_experiment(folder / "study.toml"), folder)


@pytest.mark.parametrize(
    "what", ["legs exchanged", *(pytest.param(one, marks=pytest.mark.slow) for one in NAMED if one != "legs exchanged")]
)
def test_likely_cause_is_found_by_trying_it(drawn, what, call):
    mend, said = NAMED[what]
    with studies.changed_table(drawn / "data" / ACTUATORS, studies.change_actuators(mend)):
        code, out, complaint = call("validate", drawn / "study.toml")
        if what == "displacements in metres":  # by which pads seem to move a metre, and no pose is reached
            assert (code, "metres?" in complaint) == (2, True)
            rigid = drawn / "rigid.toml"
            rigid.write_text(
                (drawn / "study.toml").read_text().replace('deformation = "matrix"', 'deformation = "linear"')
            )
            code, _, complaint = call("validate", rigid)
            assert (code, said in complaint) == (2, True)
            return
    assert code == 3
    assert said in out.partition(CORRECTED)[2]


@pytest.mark.parametrize("seed", run_rest(range(20), 3))
def test_no_clean_twin_is_suspected(drawn, seed, tmp_path):
    studies.write_texts(tmp_path, studies.tiny_texts())
    config = load_experiment(tmp_path / "simulate.toml")
    rng = np.random.default_rng(500 + seed)
    twin = build_twin(config, tmp_path)
    theta = twin.theta.copy()
    lengths = twin.machine.layout.index["l"]
    theta[lengths] = twin.machine.layout.nominal[lengths] + rng.normal(0.0, 2.0, len(lengths))
    survey = twin.seen.survey(twin, rng, theta)[0]
    studies.write_texts(
        tmp_path, {f"data/{n}": text for n, text in format_survey(survey, config.provenance.text).items()}
    )
    assert load(tmp_path).slip is None


# --- contradictions --------------------------------------------------------------------------------------------------


def exchange(one: str, other: str, column: int) -> Callable[[Rows], Rows]:
    names = {one: other, other: one}
    return lambda rows: [[*row[:column], names.get(row[column], row[column]), *row[column + 1 :]] for row in rows]


def exchange_pads(rows: Rows) -> Rows:
    names = {"L21": "L31", "L31": "L21", "L22": "L32", "L32": "L22"}
    return [[*row[:2], names.get(row[2], row[2]), *row[3:]] for row in rows]


def copy_pose(source: str, target: str) -> Callable[[Rows], Rows]:
    def apply(rows: Rows) -> Rows:
        return [*(row for row in rows if row[0] != target), *([target, *row[1:]] for row in rows if row[0] == source)]

    return apply


CONTRADICTIONS: dict[str, tuple[str, Callable[[Rows], Rows], str]] = {
    "two targets exchanged": (TARGETS, exchange("P01", "P03", 2), "targets 'P01' and 'P03'"),
    "two targets of the base": (TARGETS, exchange("B02", "B04", 2), "targets 'B02' and 'B04'"),
    "pads exchanged": (TARGETS, exchange_pads, "pad of leg 2 where leg 3 should be"),
    "pads numbered otherwise": (REFERENCE, exchange("2", "3", 2), "pad of leg 2 213 mm from its joint"),
    "a pose twice": (TARGETS, copy_pose("C02", "C05"), "pose 'C05': found the readings of pose 'C02'"),
    "verification is calibration": (TARGETS, copy_pose("C02", "V01"), "pose 'V01': found the readings of pose 'C02'"),
    "positions in metres": (
        ACTUATORS,
        lambda rows: [[*row[:2], *(str(1e-3 * float(x)) for x in row[2:])] for row in rows],
        "; metres?",
    ),
    "displacements": (
        ACTUATORS,
        lambda rows: [[*row[:2], *(f"{float(x) - HOME:.6f}" for x in row[2:])] for row in rows],
        "pose 'C01', rho_2_mm: found -1.3 mm",
    ),
    "no motion": (
        ACTUATORS,
        lambda rows: [[*row[:2], *["10.0"] * 6] for row in rows],
        "equal actuator positions at all 13",
    ),
    "out of range": (
        ACTUATORS,
        lambda rows: [[*row[:-1], "12.0"] for row in rows],
        "expected at most 1.3 mm",
    ),
}


@pytest.mark.parametrize("what", CONTRADICTIONS)
def test_contradiction_is_refused(drawn, what):
    name, mend, said = CONTRADICTIONS[what]
    table = drawn / "data" / name
    with (
        studies.changed_table(table, lambda rows: [rows[0], *mend(rows[1:])]),
        pytest.raises(InputError, match="found") as error,
    ):
        load(drawn)
    assert said in str(error.value)


def test_order_of_columns_does_not_matter(drawn):
    before = load(drawn).measured[0].poses.actuators
    with studies.changed_table(drawn / "data" / ACTUATORS, lambda rows: [row[::-1] for row in rows]):
        after = load(drawn).measured[0].poses.actuators
    np.testing.assert_array_equal(before, after)


@pytest.mark.parametrize("values", ["0,0,0,0,0,0", "1,2,3,4,5,6"])
def test_plan_without_motion_is_refused(drawn, values, tmp_path):
    studies.write_texts(tmp_path, studies.tiny_texts())
    path = tmp_path / "calibration_configurations.csv"
    header = next(line for line in path.read_text().splitlines() if not line.startswith("#"))
    path.write_text(f"{header}\n{values}\n{values}\n")
    config = load_experiment(tmp_path / "simulate.toml")
    with pytest.raises(InputError, match=r"equal .* 2 poses"):
        build_twin(config, tmp_path)
