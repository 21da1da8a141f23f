"""Star files of TPOINT: a measured one gives the shipped experiment; others are refused in a line, with its number."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import studies
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bayescal.errors import InputError
from bayescal.experiments.runner.load import load
from bayescal.experiments.runner.run import check_experiment
from bayescal.importers import import_file
from bayescal.importers.tpoint import recognise
from bayescal.projects.start import start_from

MMT = studies.EXPERIMENTS / "mmt_mount"
CAPTION = "A mount in a garden"


def write_stars(rows, header=(CAPTION, ": ALTAZ", "+31 41 19.6 2021 8 21 13.0 741 2608.0 0.75")):
    """Return a star file of rows of cells."""
    return "\n".join([*header, *(" ".join(map(str, row)) for row in rows), "END"]) + "\n"


def read_shipped():
    """Return the shipped stars, (80, 4) as text."""
    table = pd.read_csv(MMT / "data" / "stars.csv", comment="#", dtype=str)
    return table.drop(columns="pose").to_numpy().tolist()


def draw_stars(rng, n=12):
    """Return directions on the sky and of encoders 12 degrees and 0.2 degrees off, scattered by 0.01 degrees."""
    sky = np.stack([rng.uniform(0.0, 360.0, n), rng.uniform(20.0, 80.0, n)], axis=-1)
    return np.concatenate([sky, sky + [12.0, 0.2] + 0.01 * rng.standard_normal((n, 2))], axis=-1).round(5)


def begin(folder, text, options=None):
    """Return the files of a project from a star file, checked as `validate` checks them."""
    path = folder / "stars.dat"
    path.write_text(text, encoding="utf-8")
    files, project = start_from(folder / "mine", path, options or {})
    check_experiment(load(folder / "mine" / "study.toml")[1], folder / "mine")
    return files, project


def test_a_measured_file_is_the_shipped_experiment(tmp_path):
    comment = "! transformed AZ into tpoint convention (South = 0, East=90)"
    _, project = begin(tmp_path, comment + "\n" + write_stars(read_shipped()))
    own = pd.read_csv(tmp_path / "mine" / "data" / "stars.csv", comment="#")
    shipped = pd.read_csv(MMT / "data" / "stars.csv", comment="#")
    np.testing.assert_array_equal(own.drop(columns="pose"), shipped.drop(columns="pose"))
    (_, mine), (_, theirs) = load(tmp_path / "mine" / "study.toml"), load(MMT / "study.toml")
    assert mine.parameters == theirs.parameters
    assert "latitude 31.6888°" in project.found[0]
    assert "from south" in project.found[1]


@pytest.mark.runs
def test_a_measured_file_gives_the_shipped_terms(call, tmp_path):
    path = tmp_path / "k_and_e.dat"
    path.write_text(write_stars(read_shipped()))
    assert call("init", tmp_path / "mine", "--from", path, "--option", "azimuth_from=south")[0] == 0
    shipped = Path(shutil.copytree(MMT, tmp_path / "shipped")) / "study.toml"
    shipped.write_text(shipped.read_text().partition("[[variants]]")[0] + '[[variants]]\nname = "eight"\n')
    found = {}
    for name, study in (("mine", tmp_path / "mine" / "study.toml"), ("shipped", shipped)):
        assert call("run", study, "--out", tmp_path / f"out_{name}", "--workers", 1)[0] == 0
        table = pd.read_csv(tmp_path / f"out_{name}" / "tables" / "parameters.csv")
        own = table[(table["variant"] == "eight") & table["unit"].eq("rad")]
        found[name] = own.set_index("parameter")[["mean", "sd"]]
    assert len(found["mine"]) == 8
    off = (found["mine"]["mean"] - found["shipped"]["mean"]) / found["shipped"]["sd"]
    assert off.abs().max() < 0.15
    np.testing.assert_allclose(found["mine"]["sd"], found["shipped"]["sd"], rtol=0.1)
    form = "--variant", "eight", "--format", "tpoint"
    assert call("export", tmp_path / "out_mine", *form, "--out", tmp_path / "model")[0] == 0
    assert any("NPAE" in one.read_text() for one in (tmp_path / "model").iterdir() if one.suffix not in (".nc", ".csv"))


@pytest.mark.parametrize("start", ["north", "south"])
def test_sexagesimal_rows_are_read_as_decimal_ones(tmp_path, rng, start):
    stars = draw_stars(rng)
    seconds = np.rint(np.abs(stars) * 36000.0) / 10.0
    signs = np.where(stars < 0.0, "-", "+")
    cells = [
        [f"{s}{int(one // 3600)} {int(one // 60 % 60)} {one % 60:.1f}" for s, one in zip(*row, strict=True)]
        for row in zip(signs, seconds, strict=True)
    ]
    begin(tmp_path, write_stars(cells), {"azimuth_from": start})
    own = pd.read_csv(tmp_path / "mine" / "data" / "stars.csv", comment="#").drop(columns="pose")
    np.testing.assert_allclose(own, np.sign(stars) * seconds / 3600.0, atol=1e-12)
    assert f'azimuth_from = "{start}"' in (tmp_path / "mine" / "machine.toml").read_text()


def change(k, column, value):
    """Return a function that puts a value into a star."""

    def put(stars):
        stars = stars.astype(object)
        stars[k, column] = value
        return stars

    return put


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (change(2, 1, -3.5), "line 6: found a star at elevation -3.5, below the horizon, expected 0 to 90 degrees"),
        (change(2, 1, 95.0), "line 6: found a star at elevation 95, beyond the zenith, expected 0 to 90 degrees"),
        (change(4, 0, "12:30"), "line 8: found '12:30', expected a number"),
        (change(4, 0, "nan"), "line 8: found 'nan', expected a number"),
        (change(4, 0, 1e6), "line 8: found azimuths 1e+06 and"),
        (change(5, 3, 70.0 - 55.0), "degrees off the other stars, expected at most 10"),
        (np.radians, "line 4: found azimuths up to"),
        (lambda stars: stars * [1, 1, -1, 1], "fall as those of the sky grow, expected both through east"),
        (lambda stars: stars[:, :3], "line 4: found 3 numbers, expected 4 in degrees, or 12 in degrees, minutes, sec"),
        (lambda stars: stars[:4], "line 3: found 4 stars below it, expected at least 6"),
        (lambda stars: stars[[*range(12), 3]], "line 16: found the star of line 7, expected each once"),
    ],
)
def test_what_is_wrong_with_stars_is_said_with_their_line(tmp_path, rng, spoil, said):
    stars = draw_stars(rng)
    stars[5, 1] = stars[5, 3] = 70.0
    with pytest.raises(InputError) as error:
        begin(tmp_path, write_stars(spoil(stars)))
    assert f"{tmp_path / 'stars.dat'}, line " in str(error.value)
    assert said in str(error.value)
    assert not (tmp_path / "mine").exists()


@pytest.mark.parametrize(
    ("header", "said"),
    [
        ((CAPTION, ": EQUAT", "31 41 19"), "line 2: found option 'EQUAT', expected ALTAZ"),
        ((CAPTION, ": NODA", "31 41 19"), "line 2: found no option ALTAZ"),
        ((CAPTION, ": ALTAZ"), "line 3: found 4 numbers, expected the site's latitude as degrees, minutes, seconds"),
        ((CAPTION, ": ALTAZ", "95 0 0"), "line 3: found latitude 95, expected -90 to 90"),
        ((CAPTION, ": ALTAZ", "31 61 0"), "line 3: found 61 minutes, 0 seconds, expected 0 to below 60"),
    ],
)
def test_what_is_wrong_above_the_stars_is_said_with_its_line(tmp_path, rng, header, said):
    with pytest.raises(InputError) as error:
        begin(tmp_path, write_stars(draw_stars(rng), header))
    assert said in str(error.value)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"azimuth_from": "west"}, "--option: azimuth_from: found 'west', expected north or south"),
        ({"latitude": "3"}, "--option: found 'latitude', expected azimuth_from"),
    ],
)
def test_options_that_are_none_are_refused(tmp_path, rng, options, said):
    with pytest.raises(InputError, match=said):
        begin(tmp_path, write_stars(draw_stars(rng)), options)


CELLS = st.one_of(
    st.floats().map(str), st.floats(-400.0, 400.0).map(str), st.text(max_size=8), st.sampled_from(["-0", "1e9", "END"])
)
LINES = st.one_of(
    st.lists(CELLS, max_size=14).map(" ".join),
    st.text(max_size=40),
    st.sampled_from([": ALTAZ", "! x", ":", "31 41 19.6"]),
)


@settings(max_examples=150, deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_any_file_is_read_or_refused_in_one_line(data):
    lines = write_stars(draw_stars(np.random.default_rng(3))).splitlines()
    for _ in range(data.draw(st.integers(1, 3))):
        k = data.draw(st.integers(0, len(lines) - 1))
        how = data.draw(st.sampled_from(["replace", "insert", "cell", "remove"]))
        if how == "cell" and (cells := lines[k].split()):
            cells[data.draw(st.integers(0, len(cells) - 1))] = data.draw(CELLS)
            lines[k] = " ".join(cells)
        elif how == "remove":
            lines[k] = ""
        else:
            lines[k : k + (how == "replace")] = [data.draw(LINES)]
    text = "\n".join(lines)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "stars.dat"
        path.write_bytes(text.encode("utf-8", "surrogatepass"))
        try:
            project = import_file(path)
        except InputError as error:
            said = str(error)
            assert len(said.splitlines()) == 1
            assert not recognise(path.name, text) or f"{path}, line " in said or "text file" in said
            return
        for name, content in project.files.items():
            (Path(folder) / name).parent.mkdir(exist_ok=True)
            (Path(folder) / name).write_bytes(content)
        check_experiment(load(Path(folder) / "study.toml")[1], Path(folder))
