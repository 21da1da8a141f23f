"""From Python as from the shell: the same config, the same numbers; and what a faulty table is refused with."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from io import BytesIO
from pathlib import Path

import numpy as np
import pandas as pd
import planar_rrr
import pytest
from efforts import searching_little

import bayescal as bc
from bayescal.projects.start import start_project

ROOT = Path(__file__).parents[1]
HEXAPOD = ROOT / "experiments" / "audit" / "m2_hexapod_mechanism.toml"
TINY = {
    "sampler": {"walkers": 96, "burn_in": 3, "steps": 6},
    "evidence": {"draws": 1000, "max_draws": 1000},
    "validation": {"draws": 100},
    "next": {"candidates": 0},
}
DELTA = {"x": 0.5, "y": 0.5, "l": 0.3, "s0": 0.5, "t_x": 0.1, "t_y": 0.1}
CASES = {
    "own file": (
        ROOT / "examples" / "own_machine" / "machine.toml",
        {"s": 0.005, "cam_x": 0.02, "cam_y": {"noise_um": 20.0, "noise_group": "camera"}, "height": 0.01},
        DELTA,
    ),
    "own class": (
        planar_rrr.PlanarRRR(None),
        {"theta": 1e-4, "cam_x": 0.02, "cam_y": 0.02, "cam_phi": 2e-4},
        {"x": 0.5, "y": 0.5, "l": [0.3, 0.3, 0.2], "theta0": {"prior": "uniform", "half_width": 0.5}},
        {"model_error": {"terms": ["random"]}},  # the others have the default one
    ),
    "sliding platform": (
        str(ROOT / "experiments" / "sliding_star" / "machine.toml"),
        {"s": 0.001, "phi": 5e-6},
        {"l": 0.3, "gamma0": 2.0},
        {"workspace": {"x": [-200.0, 200.0], "y": [-200.0, 200.0], "phi": [-0.5, 0.5]}},
    ),
}


def calibrate(case, **options):
    machine, noise, tolerances, *more = CASES[case]
    sections = dict(*more)
    found = bc.load_machine(machine)
    symbols = set(found.model.layout.symbols)
    tolerances = {name: width for name, width in tolerances.items() if name in symbols}
    workspace = {key: one for key, one in sections.items() if key == "workspace"}
    data = bc.simulate(machine, noise, tolerances, 8, seed=2, **workspace)
    return bc.calibrate(machine, data, tolerances, quiet=True, **TINY, **sections, **options)


@pytest.fixture(scope="module")
def delta(tmp_path_factory):
    with searching_little():
        return calibrate("own file", out=tmp_path_factory.mktemp("front") / "results")


@pytest.mark.runs
@pytest.mark.usefixtures("search_little", "no_pictures")
@pytest.mark.parametrize("case", CASES)
def test_the_shell_gives_the_same_numbers(case, tmp_path):
    study = calibrate(case)
    text = study.to_toml(tmp_path / "project")
    path = tmp_path / "project" / "study.toml"
    assert path.read_text() == text
    again = bc.run_experiment(str(path), tmp_path / "results", quiet=True)
    for name, table in again.tables.items():
        pd.testing.assert_frame_equal(table, study.tables[name], check_exact=True, obj=name)


@pytest.fixture(scope="module")
def hexapod(tmp_path_factory):
    """A project of `bayescal init`: a hexapod whose poses an instrument has measured."""
    folder = tmp_path_factory.mktemp("front") / "hexapod"
    start_project(folder, "hexapod", "poses")
    return folder


def calibrate_hexapod(folder, as_table):
    content = tomllib.loads((folder / "study.toml").read_text())
    (table,) = content["data"]
    data = {key: as_table(folder / one) if str(one).endswith(".csv") else one for key, one in table.items()}
    rigid = {key: one for key, one in content["variants"][0].items() if key not in ("name", "title")}
    assert repr(bc.load_machine(folder / content["machine"])).endswith(": 6 legs")
    return bc.calibrate(
        *(folder / content["machine"], data, content["parameters"]),
        **{"variants": {"rigid": rigid}, "provenance": content["provenance"], "sensors": content["sensors"]},
        **{"quiet": True, "model_error": {"terms": ["random"]}},
        **{key: TINY[key] for key in ("sampler", "evidence", "validation")},
    )


@pytest.mark.runs
@pytest.mark.usefixtures("search_little", "no_pictures")
def test_a_mechanism_measured_by_an_instrument_from_python_as_from_the_shell(hexapod, tmp_path):
    study = calibrate_hexapod(hexapod, lambda path: pd.read_csv(path, comment="#"))
    study.to_toml(tmp_path / "project")
    again = bc.run_experiment(tmp_path / "project" / "study.toml", tmp_path / "results", quiet=True)
    for name, table in again.tables.items():
        pd.testing.assert_frame_equal(table, study.tables[name], check_exact=True, obj=name)
    by_files = calibrate_hexapod(hexapod, Path)
    np.testing.assert_allclose(by_files.best.parameters["mean"], study.best.parameters["mean"], rtol=1e-9)
    assert study.best.name == "rigid"


@pytest.mark.runs
@pytest.mark.usefixtures("search_little", "no_pictures")
def test_a_mechanism_is_simulated_audited_and_calibrated_by_its_channels():
    """Noise without units is in the channels' own, as of any machine; the requirement is one the plan may miss."""
    noise = {"rho": 0.001, "x": 0.005, "y": 0.005, "z": 0.005, "rx": 1e-5, "ry": 1e-5, "rz": 1e-5}
    machine, tolerances = bc.load_machine(HEXAPOD), {"l": 0.05, "b_x": 0.05}
    rigid = {"rigid": {"model": "six_ups"}}
    audit = bc.audit(machine, noise, tolerances, poses=12, variants=rigid, quiet=True)
    assert audit.kind == "audit"
    assert (audit.tables["parameters"]["variant"] == "rigid").all()
    data = bc.simulate(machine, noise, tolerances, n_poses=12, model="six_ups")
    assert data.table.filter(regex="^rho_").shape == (12, 6)
    plain = {"model_error": {"terms": ["random"]}}
    study = bc.calibrate(machine, data, tolerances, variants=rigid, quiet=True, **TINY, **plain)
    found = study.best.parameters.set_index("parameter")["mean"]
    true = data.truth.set_index("parameter")["true"]
    assert (found[true.index] - true).abs().max() < 0.2  # mm, of tolerances of 0.05


def test_a_study_says_what_it_found(delta, tmp_path):
    assert delta.summary["headline"] in repr(delta)
    assert delta.best.name == "everything"
    assert delta["everything"].parameters.equals(delta.best.parameters)
    assert "<table" in delta._repr_html_()
    assert "<html" in delta.page(tmp_path / "report.html").read_text()[:200]
    assert set(delta.best.posterior.children) >= {"posterior", "observed_data", "log_likelihood"}
    with pytest.raises(bc.InputError, match="mean 'everything'"):
        delta["everythin"]


def test_tables_of_truth_and_parameters_merge_by_what_they_share():
    machine = bc.load_machine(ROOT / "examples" / "machines" / "five_bar.toml")
    truth = bc.simulate(machine, {"q": 1e-4}, {"L": 0.3, "o": 0.1}, 3).truth
    written = [float(f"{one:.9g}") for one in machine.parameters.set_index("parameter")["nominal"][truth["parameter"]]]
    assert list(truth["nominal"]) == written
    assert truth["nominal"].tolist()[-1] != machine.model.layout.nominal[-1]  # 20 degrees have more digits


def test_noise_of_instruments_is_in_their_own_units_too():
    known = {"it": {"kind": "point"}}
    there = {"it": {**known["it"], "frame_mm": [300.0, 0.0, 0.0], "frame_deg": [10.0, 20.0, 30.0]}}
    machine, tolerances = CASES["own file"][0], {"l": 0.3}
    data = bc.simulate(machine, {"s": 0.005, "it[x]": 0.02, "it[y]": 0.02}, tolerances, 6, instruments=there)
    assert list(data.table.columns[-2:]) == ["it_x_mm", "it_y_mm"]
    assert data.noise["it[x]"] == {"noise_mm": 0.02}
    with pytest.raises(bc.InputError, match=r"instruments\.it\.kind: found 'pont'"):
        bc.simulate(machine, {"s": 0.005, "it": 0.02}, tolerances, 6, instruments={"it": {"kind": "pont"}})


def test_data_are_not_called_measured_unasked(delta):
    assert bc.Data(pd.DataFrame({"s_1_mm": [1.0]}), {"s": 0.1}).provenance["status"] == "unstated"
    assert delta.summary["origin"]["status"] == "simulated"


def test_results_loaded_later_are_the_same(delta):
    again = bc.load_results(str(delta.folder), trust=True)
    assert isinstance(again, bc.StudyResult)
    pd.testing.assert_frame_equal(again.best.parameters, delta.best.parameters)
    assert set(again.stated.files) == set(delta.stated.files)


@pytest.mark.runs
def test_a_calibrated_machine_predicts_what_it_was_commanded(delta, tmp_path):
    """Of so few draws, converged or not."""
    best = bc.load_results(delta.folder, trust=True, allow_unconverged=True).best
    commands = pd.DataFrame({"s_1_mm": [250.0, 240.0], "s_2_mm": [250.0, 250.0], "s_3_mm": [250.0, 260.0]})
    found = best.predict(commands)
    back = best.compensate(found[["pose", "x_mm", "y_mm", "z_mm"]])
    np.testing.assert_allclose(back[list(commands)], commands, atol=1e-6)
    alone = best.predict(commands.iloc[1].to_dict())
    pd.testing.assert_frame_equal(alone, found.iloc[1:].assign(pose="P1").reset_index(drop=True))
    with pytest.raises(bc.InputError, match="1 of 1 poses"):
        best.compensate({"x_mm": 4000.0, "y_mm": 0.0, "z_mm": 0.0})
    accuracy = best.tool_accuracy(poses=16)
    assert list(accuracy.index) == ["x", "y", "z"]
    assert (accuracy["standard"] < accuracy["expanded"]).all()
    assert [path.name for path in best.export(tmp_path / "out")]
    assert len(repr(best.machine).splitlines()) == 1


def test_a_page_goes_into_a_folder_that_is_there(delta, tmp_path):
    assert delta.page(tmp_path / "page.html").is_file()
    with pytest.raises(bc.InputError, match="no folder"):
        delta.page(tmp_path / "nowhere" / "page.html")


@pytest.mark.runs
@pytest.mark.usefixtures("search_little", "no_pictures")
def test_the_next_pose_is_asked_of_what_was_calibrated(tmp_path):
    study = calibrate("own file")
    found = bc.next_pose(study, {"x": 0.05, "z": 0.05}, 20, quiet=True)
    assert found.summary["headline"] in repr(found)
    assert found.folder.name == "next_pose"
    found.to_toml(tmp_path)
    asked = bc.load_experiment(tmp_path / "next_pose.toml")
    assert (asked.kind, bc.load_experiment(tmp_path / asked.study).kind) == ("next_pose", "study")


@pytest.mark.usefixtures("search_little", "no_pictures")
def test_the_next_pose_is_asked_of_results_loaded_later(delta):
    asked = [
        bc.next_pose(one, {"x": 0.05}, 12, quiet=True) for one in (delta, bc.load_results(delta.folder, trust=True))
    ]
    pd.testing.assert_frame_equal(*(one.tables["next_poses"] for one in asked))


SCRIPT = """
import numpy as np
import bayescal as bc

HOME = 10.0
def stretch(v):
    return HOME + v

class Slide(bc.ReadingMachine):
    parameters = [bc.ParameterBlock("o", (0.0,), per_leg=False)]
    coordinates = [bc.Coordinate("x", "mm", 0.0, 50.0)]
    channels = [bc.Channel("scale", "mm"), bc.Channel("laser", "mm", external=True)]

    def read(self, parameters, v, given):
        away = v[..., 0] - parameters["o"]
        return np.stack(np.broadcast_arrays(stretch(away), stretch(v[..., 0])), axis=-1)

data = bc.simulate(Slide, {"scale": 0.001, "laser": 0.01}, {"o": 0.5}, 6)
study = bc.calibrate(Slide(), data, {"o": 0.5}, quiet=True, sampler={"walkers": 24, "burn_in": 20, "steps": 60})
print("mean", float(study.best.parameters["mean"][0]), float(data.truth["true"][0]))
"""


@pytest.mark.runs
def test_a_class_of_a_script_is_taken_with_what_it_uses(tmp_path):
    path = tmp_path / "slide_script.py"
    path.write_text(SCRIPT)
    done = subprocess.run([sys.executable, str(path)], capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    lines = [line for line in done.stdout.splitlines() if line.startswith("mean")]
    assert len(lines) == 1  # the script was run once
    mean, truth = map(float, lines[0].split()[1:])
    assert abs(mean - truth) < 5 * 0.01 / np.sqrt(6)


@pytest.mark.runs
def test_the_notebook_runs_in_few_lines_and_agrees_with_the_firmware(tmp_path, monkeypatch):
    shutil.copytree(ROOT / "experiments" / "flsun_v400", tmp_path / "flsun_v400")
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "tutorials" / "delta_printer.md").read_text()
    cells = re.findall(r"```\{code-cell\}\n(.*?)```", page, re.DOTALL)
    assert len([line for cell in cells for line in cell.splitlines() if line.strip()]) <= 25
    namespace: dict = {}
    for cell in cells:
        exec(cell, namespace)
    study, theirs = namespace["study"], namespace["theirs"]
    assert study.ranking["converged"].all()
    assert study.summary["origin"]["status"] == "measured"
    assert (np.abs(theirs["mean"] - theirs["value"]) < theirs["sd"]).all()
    assert len(theirs) == 9
    assert "Klipper&#39;s fit" in (tmp_path / "report.html").read_text()
    assert (tmp_path / "flsun_calibrated" / "covariance.csv").is_file()


# --- what is refused -------------------------------------------------------------------------------------------------

FAULTS = {
    "missing channel": (lambda t: t.drop(columns="s_2_mm"), "found no column of 's[2]', which data.channels"),
    "wrong unit": (lambda t: t.rename(columns={"s_1_mm": "s_1_kg"}), "column 's_1_kg',"),
    "one name twice": (lambda t: t.assign(pose="A"), "row 2: pose 'A'"),
    "no rows": (lambda t: t.head(0), "found no rows"),
    "a row of NaN": (
        lambda t: t.mask(t["pose"] == "C003").assign(pose=t["pose"], use=t["use"]),
        "pose 'C003': found no",
    ),
    "text": (lambda t: t.astype(object).replace({"s_1_mm": {t["s_1_mm"][0]: "a"}}), "found 'a', expected a"),
    "infinite": (lambda t: t.assign(s_1_mm=np.inf), "s_1_mm: found inf, expected a finite number"),
}


def read_kept(study):
    return pd.read_csv(BytesIO(study.stated.files["data/readings.csv"]))


@pytest.fixture
def refused(delta, call, tmp_path, monkeypatch):
    """Return a function that gives the line by which a study is refused, from Python as from the shell but for names.

    Python names the argument and its row, the shell the file and its line.
    """

    def refuse(table, noise):
        machine, own, tolerances = CASES["own file"]
        delta.to_toml(tmp_path / "shell")
        data = bc.Data(table, own if noise is None else noise)
        with pytest.raises(bc.InputError) as caught:
            bc.calibrate(machine, data, tolerances, out=tmp_path / "out", quiet=True, **TINY)
        monkeypatch.chdir(tmp_path / "shell")
        if noise is None:
            table.to_csv("data/readings.csv", index=False)
        else:
            text = Path("study.toml").read_text()
            Path("study.toml").write_text(f"{text}\n[sensors.{next(iter(noise))}]\nnoise = 1.0\n")
        code, out, err = call("run", "study.toml", "--quiet")
        file = err.removeprefix("bayescal: ").removeprefix("study.toml: ").rstrip("\n")
        row = re.sub(r"line (\d+)", lambda found: f"row {int(found[1]) - 1}", file)
        said = row.replace("data/readings.csv", "data", 1).replace("study.toml, row 24: sensors", "noise")
        assert (code, out, said) == (2, "", caught.value.lines[0])
        assert not (tmp_path / "out").exists()
        assert not Path("results").exists()
        return str(caught.value)

    return refuse


@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_table_is_refused_as_the_shell_refuses_it(fault, delta, refused):
    change, said = FAULTS[fault]
    table = read_kept(delta)
    line = refused(change(table), None)
    assert re.match(r"data[,:] ", line), line
    assert said in line


class Empty(bc.ReadingMachine):
    pass


def test_a_class_without_read_and_an_unknown_channel_are_refused(tmp_path, call, delta, refused):
    with pytest.raises(bc.InputError, match=r"^machine.toml: kind: .*without read") as caught:
        bc.load_machine(Empty)
    (tmp_path / "empty.py").write_text("import bayescal as bc\n\n\nclass Empty(bc.ReadingMachine):\n    pass\n")
    (tmp_path / "machine.toml").write_text('kind = "empty.py:Empty"\nname = "empty"\ntitle = "Empty"\n')
    _, _, err = call("show", tmp_path / "machine.toml")
    assert err.replace("empty.py:", "test_api.py:") == f"bayescal: {tmp_path}/{caught.value}\n"
    assert "'motor'" in refused(read_kept(delta), {"motor": 1.0})


@pytest.mark.parametrize("load", [bc.load_experiment, bc.run_experiment])
def test_an_unknown_kind_is_refused_as_in_the_shell(load, tmp_path, call):
    path = tmp_path / "study.toml"
    path.write_text('kind = "stdy"\nname = "old"\ntitle = "Old"\nseed = 1\n')
    with pytest.raises(bc.InputError, match="mean 'study'") as caught:
        load(str(path))
    assert call("run", path) == (2, "", f"bayescal: {caught.value}\n")


@pytest.mark.parametrize(
    "load", [bc.load_machine, bc.load_experiment, bc.load_results, bc.load_calibrated, bc.run_experiment]
)
@pytest.mark.parametrize("kind", [str, Path])
def test_paths_are_texts_or_paths(load, kind, tmp_path):
    with pytest.raises(bc.InputError, match=r"nowhere\b.*no such"):
        load(kind(tmp_path / "nowhere"))


@pytest.mark.runs
@pytest.mark.parametrize("page", ["README.md", "docs/howto/python.md"])
def test_the_lines_of_a_page_run_as_they_stand(page, tmp_path, monkeypatch, capsys):
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    monkeypatch.chdir(tmp_path)
    text = (ROOT / page).read_text()
    code = re.search(r"```python\n(.*?)```", text, re.DOTALL).group(1)
    if page == "README.md":
        assert len(code.splitlines()) <= 12
        assert len(text.splitlines()) <= 110
        assert text.index(code) < text.index("\n|")  # before any table
    namespace: dict = {}
    exec(code, namespace)
    assert namespace["study"].best.name in namespace["study"].variants
    assert "standard uncertainty" in capsys.readouterr().out
    if page == "README.md":
        assert namespace["study"].summary["title"] in (tmp_path / "report.html").read_text()
        assert list((tmp_path / "delta_calibrated").iterdir())
