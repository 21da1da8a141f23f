"""Rows that a machine cannot reach, and the usual mistakes that lead there: one line each, before any sampling."""

from __future__ import annotations

import numpy as np
import planar_rrr
import pytest
from shares import run_rest

from bayescal.experiments.shared.slips import CORRECTED


def change(columns, function):
    """Return what changes some columns of readings by a function of theirs."""

    def apply(values):
        values = values.copy()
        values[:, columns] = function(values[:, columns])
        return values

    return apply


MISTAKES = {
    "camera in metres": (change([3, 4], lambda x: 1e-3 * x), "readings of cam_x and cam_y seem to be in metres"),
    "camera in micrometres": (change([3, 4], lambda x: 1e3 * x), "cam_x and cam_y seem to be 1000 times too large"),
    "degrees for radians": (change([0, 1, 2], np.degrees), "readings of theta seem to be in degrees"),
    "radians for degrees": (change([0, 1, 2], np.radians), "theta seem to be in radians where degrees are stated"),
    "the other sign": (change([0, 1, 2], lambda x: -x), "readings of theta seem to be of the other sign"),
    "exchanged motors": (lambda x: x[:, [1, 0, 2, 3, 4, 5]], "readings of theta[1] and theta[2] seem to be exchanged"),
    "exchanged axes": (lambda x: x[:, [0, 1, 2, 4, 3, 5]], "readings of cam_x and cam_y seem to be exchanged"),
    "shifted rows": (change([0, 1, 2], lambda x: np.roll(x, 1, axis=0)), "rows of theta seem shifted"),
    "a frozen motor": (change([1], lambda x: 0.0 * x + x[0]), "theta[2] does not move: it reads"),
    "a negated motor": (change([1], lambda x: -x), "readings of theta[2] seem to be of the other sign"),
    "a scaled motor": (change([2], lambda x: 2.0 * x), "readings of theta[3] seem to be twice too large"),
}


@pytest.fixture(scope="module")
def readings():
    return planar_rrr.simulate(14)


@pytest.mark.parametrize("mistake", run_rest(MISTAKES, 4))
def test_a_usual_mistake_is_one_line_that_says_what_is_wrong(mistake, readings, tmp_path, call):
    change_readings, said = MISTAKES[mistake]
    path = planar_rrr.write_project(tmp_path / "project", change_readings(readings))
    code, out, complaint = call("validate", path)
    assert (code, out) == (2, "")
    assert complaint.count("\n") == 1
    assert said in complaint.partition(CORRECTED)[2]


def test_wrapped_angles_are_doubted_though_some_machine_has_them_all(readings, tmp_path, call):
    """Least squares come to a machine far from nominal that stands wherever it was read, and fits badly."""
    wrapped = change([0, 1, 2], lambda x: x % (2.0 * np.pi))
    code, out, complaint = call("validate", planar_rrr.write_project(tmp_path / "project", wrapped(readings)))
    assert code == 3, complaint
    assert "theta" in out.partition(CORRECTED)[2]


def test_readings_that_never_change_are_refused(readings, tmp_path, refuse):
    path = planar_rrr.write_project(tmp_path / "project", 0.0 * readings)
    refuse("found equal readings in all 14 rows", tmp_path / "out", "run", path)


def test_another_zero_is_doubted_where_the_machine_can_have_it(readings, tmp_path, call):
    path = planar_rrr.write_project(tmp_path / "project", change([0], lambda x: x + 0.5 * np.pi)(readings))
    code, out, complaint = call("validate", path)
    assert "another zero, +90.4°" in out + complaint
    assert code in (2, 3)


@pytest.mark.parametrize("seed", range(1, 7))
def test_clean_readings_accuse_nothing(seed, tmp_path, call):
    path = planar_rrr.write_project(tmp_path / "project", planar_rrr.simulate(14, seed))
    code, out, _ = call("validate", path)
    assert code == 0
    assert CORRECTED not in out


def test_a_single_row_out_of_reach_is_named_with_its_channel(readings, tmp_path, refuse):
    readings = readings.copy()
    readings[6, 3] = -391.0
    path = planar_rrr.write_project(tmp_path / "project", readings)
    said = r"row 7 \(pose 'R07'\) .*channel cam_x reads -391 mm.*without cam_x"
    refuse(said, tmp_path / "out", "run", path, "--quiet")


def test_channels_without_a_reading_are_named_with_the_place(readings, tmp_path, refuse):
    """Motors alone: three readings for three coordinates, which leave nothing to compare slips by."""
    study = planar_rrr.STUDY.replace("[[variants]]", '[[variants]]\nsensors = ["theta"]')
    broken = change([0, 1, 2], lambda x: -x)(readings)
    path = planar_rrr.write_project(tmp_path / "project", broken, study=study)
    said = (
        "cannot be reached by the nominal machine: channel.* no reading at x = .* rad, where the row's readings lead.*"
    )
    refuse(f"{said}check units, signs, zeros", tmp_path / "out", "run", path, "--quiet")
