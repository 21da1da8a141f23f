"""One contract for every kind of experiment in the registry, at tiny effort."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import calibrations
import lookup_tables
import pytest
import session_studies
import studies
import sweeps
import tiny_experiments
from page_rules import check_findings, check_first_sight

import bayescal as bc
from bayescal.config.registry import list_references
from bayescal.experiments import USES
from bayescal.experiments.runner import memory
from bayescal.experiments.runner.identity import hash_identity
from bayescal.experiments.runner.load import load
from bayescal.experiments.runner.results import read_results
from bayescal.experiments.runner.run import prepare_run, run_experiment, write_report
from bayescal.experiments.runner.store import Store
from bayescal.files.manifest import MANIFEST
from bayescal.files.rows import OTHERS
from bayescal.report.findings import FindingRow
from bayescal.report.pictures import Picture

pytestmark = pytest.mark.runs

AUDIT = 'extends = "camera_hexapod.toml"\nname = "small"\nn_simulated_calibrations = 4\nprofiles = ["l[1]"]\n'
AUDIT += 'n_prior_draws = 3\n[poses]\ncount = 12\n[[scenarios]]\nname = "twice"\nposes_factor = 2.0\n'
AUDIT += "[workspace]\nposes = 20\n[sweep]\nnoise = [1.0]\nposes = [40]\nworkspace = [1.0]\n"

CHECK = 'kind = "selftest"\nname = "selftest"\ntitle = "Self-test"\nseed = 3\nstudy = "study.toml"\ndata_sets = 4\n'
CHECK += 'draws = 300\nvariants = ["six_pus/matrix"]\n'

NEXT = 'name = "next_pose"\ntitle = "Next"\nseed = 3\nstudy = "study.toml"\ndraws = 200\nhorizon = 2\n'
NEXT += "[workspace]\nposition_mm = [0.3, 0.3, 0.3]\nrotation_deg = [0.1, 0.1, 0.1]\nposes = 12\n"
NEXT += "[requirements]\nz = 0.05\n[candidates]\ncount = 64\nrange_mm = 1.2\n"


def write_audit(folder: Path) -> Path:
    for path in (tiny_experiments.SHIPPED / "audit").glob("camera_hexapod*.toml"):
        shutil.copy(path, folder)
    (folder / "small.toml").write_text(AUDIT)
    return folder / "small.toml"


def write_check(folder: Path) -> Path:
    studies.write_tiny_study(folder)
    (folder / "selftest.toml").write_text(CHECK)
    return folder / "selftest.toml"


def write_next(folder: Path) -> Path:
    studies.write_tiny_study(folder)
    (folder / "next_pose.toml").write_text(NEXT)
    return folder / "next_pose.toml"


def take_tiny(name: str) -> Callable[[Path], Path]:
    return lambda folder: tiny_experiments.copy_tiny(folder) / f"{name}.toml"


def write_selection(folder: Path) -> Path:
    path = take_tiny("pose_selection/hexapod_i_optimal")(folder)
    text = re.sub(r"(?m)^criteria = .*$", 'criteria = ["O1"]', path.read_text())
    path.write_text(text.replace("machines = 4", "machines = 2"))
    return path


MAKE = {
    "audit": write_audit,
    "selftest": write_check,
    "kind.py:HexapodCalibrations": take_tiny("yu2023/figure10"),
    "table": lookup_tables.write_rail,
    "next_pose": write_next,
    "pose_methods.py:PoseMethods": take_tiny("rr8096/figure5"),
    "selection": write_selection,
    "self_calibrations.py:SelfCalibrations": take_tiny("sika2008/calibrations"),
    "sessions": session_studies.write_sessions,
    "simulation": take_tiny("telescope/simulate"),
    "study": studies.write_tiny_study,
    "study of tables": calibrations.write_delta,
    "sweep": sweeps.write_apart,
}
"""What writes a small experiment of a kind to a folder and returns its config."""
WITHOUT_TASKS = (
    "simulation",
    "next_pose",
)  # over in an instant: nothing is worth keeping


def test_every_kind_is_here():
    assert {kind.partition(" ")[0] for kind in MAKE if ":" not in kind} == {*list_references("KINDS"), *USES}


@pytest.fixture(scope="module", params=sorted(MAKE))
def finished(request, tmp_path_factory):
    """Return a kind, its config and the results of a run with one worker, pictures not drawn."""
    folder = tmp_path_factory.mktemp(request.param)
    path = MAKE[request.param](folder)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("bayescal.report.page.render_picture", lambda draw: Picture(b"not drawn"))
        run(path, folder / "out")
    return request.param, path, folder / "out"


def test_results_keep_what_gives_them_again(finished, tmp_path):
    """The config and all files that it names, which written anew are the same experiment."""
    _, _, out = finished
    kept = bc.load_results(out, trust=True)
    kept.to_toml(tmp_path)
    path = tmp_path / kept.stated.file
    again = prepare_run(load(path)[1], path.parent, 1).identity
    assert hash_identity(again) == kept.results.provenance["config_sha256"]


def run(path: Path, out: Path, **options):
    return run_experiment(load(path)[1], path.parent, out, **options)


def read_all(out: Path) -> dict[str, bytes]:
    """Return all files of a results directory, wall times aside; of posteriors' files only that they are there.

    Of the manifest the names, which are of all files: it has the hashes of those with wall times, too.
    """
    found = {}
    for path in sorted(out.rglob("*")):
        if path.is_dir():
            continue
        content = b"" if path.suffix == ".nc" else path.read_bytes()
        if path.name == MANIFEST:
            content = json.dumps(sorted(json.loads(content)["sha256"])).encode()
        if path.stem in ("timing", "timings"):
            content = re.sub(rb",[^,\n]*$", b"", content, flags=re.MULTILINE)
        content = re.sub(rb'"wall_seconds": [0-9.e-]+', b"", content)
        found[str(path.relative_to(out))] = re.sub(rb'<td class="seconds[^>]*>[^<]*', b"", content)
    return found


def test_results_say_what_was_found_and_where_it_comes_from(finished):
    kind, path, out = finished
    summary, provenance = (json.loads((out / f"{name}.json").read_text()) for name in ("summary", "provenance"))
    assert summary["headline"]
    assert provenance["kind"] == provenance["config"]["kind"] == kind.partition(" of ")[0]
    assert {"name", "title", "seed", "python", "platform", "versions", "files", "tables"} <= set(provenance)
    for name in provenance["files"]:
        assert (path.parent / name).is_file()
    page = (out / "report.html").read_text()
    assert provenance["config_sha256"] in page
    assert all(value in page for value in (*provenance["files"].values(), provenance["versions"]["numpy"]))
    assert not re.search(r"\bnan\b", re.sub(r"base64,[^\"]*", "", page))
    assert not list(out.parent.glob("out.*"))


def test_every_table_is_as_its_rows_are_declared(finished):
    """So that the reference lists every column, and whoever reads a table meets no other."""
    name, path, out = finished
    kind, tables = load(path)[0], read_results(out).tables
    declared = {row.table: row for row in (FindingRow, *kind.rows)}
    assert len(declared) == 1 + len(kind.rows)
    if ":" in name:  # a user's kind need not declare its own
        return
    for table in tables:
        row, columns = declared[table], list(tables[table].columns)
        others = [one for one in columns if one not in [known.name for known in row.list_columns()]]
        assert not others or any(one.name == OTHERS for one in fields(row)), (table, others)
        if len(tables[table]):
            row.check(tables[table], out / table)
    assert all(one.text for one in FindingRow.read(tables["findings"]))


def test_findings_are_short(finished):
    results = read_results(finished[2])
    check_findings(FindingRow.read(results.tables["findings"]), results.summary["headline"])


def test_a_page_begins_with_figures_and_few_sentences(finished):
    check_first_sight((finished[2] / "report.html").read_text(), ":" not in finished[0])


PICTURED = (
    rb'(?s)<div class="picture">.*?</div>|<svg class="glyphs".*?</svg>|(?<="report.html": )"\w+"|"figures/[^"]*": "\w+"'
)
"""What a page shows of pictures, and what a manifest says of these."""


def leave_out_pictures(files: dict[str, bytes]) -> dict[str, bytes]:
    """Return the files' names and contents, nothing of what is in pictures."""
    found = {name: b"" if name.endswith(".png") else content for name, content in files.items()}
    return {name: re.sub(PICTURED, b"", content) for name, content in found.items()}


def test_an_interrupted_run_is_taken_up_by_another_number_of_workers(finished, monkeypatch, no_pictures):
    """Interrupted with one worker and ended with two: the same bytes as uninterrupted with one."""
    kind, path, out = finished
    again, save, kept = out.with_name("again"), Store.save_task, []

    def stop(store, key, arrays):
        save(store, key, arrays)
        kept.append(key)
        raise KeyboardInterrupt

    monkeypatch.setattr(Store, "save_task", stop)
    if kind in WITHOUT_TASKS:
        run(path, again)
        assert kept == []
        return
    with pytest.raises(KeyboardInterrupt):
        run(path, again)
    assert len(kept) == 1
    assert not again.exists()
    monkeypatch.setattr(Store, "save_task", lambda store, key, arrays: (kept.append(key), save(store, key, arrays)))
    run(path, again, workers=2, resume=True)
    assert len(kept) == len(set(kept))  # nothing that was kept is done again
    assert read_all(again) == read_all(out)


def test_the_page_is_written_again_from_files_alone(finished, tmp_path, pictures):
    """With its pictures, which the first one has not: all are drawn from the files of the results."""
    _, _, out = finished
    shutil.copytree(out, tmp_path / "moved")
    for path in [tmp_path / "moved/report.html", *(tmp_path / "moved").glob("figures/*")]:
        path.unlink()
    write_report(tmp_path / "moved", trust=True)
    again = read_all(tmp_path / "moved")
    assert leave_out_pictures(again) == leave_out_pictures(read_all(out))
    page = again["report.html"].decode()
    described = re.findall(r'<(?:svg|img) [^>]*(?:aria-label|alt)="([^"]*)"', page)
    assert all(re.search(r"\w[^\s]*\.$", one) and not re.search(r"\b(nan|inf|None)\b", one) for one in described)
    for name, content in again.items():
        if name.endswith(".png"):
            assert content.startswith(b"\x89PNG"), name
            assert re.search(rf'<figure id="figure-{Path(name).stem}">\s*<div class="picture">\s*<(svg|img) ', page), (
                name
            )


def test_results_of_another_config_are_refused(finished, refuse):
    _, path, out = finished
    refuse("holds results of another config", out, "run", path, "--seed", 987654)


def test_more_than_there_is_memory_for_is_refused_before_anything_is_written(finished, monkeypatch, refuse):
    """By the kind's own estimate: there is enough for Python and for reading."""
    kind, path, out = finished
    experiment, config = load(path)
    need = experiment.estimate_memory(experiment.read(config, path.parent))
    if kind == "sweep":  # its members are of somebody's own kind, which says nothing
        assert need == memory.MemoryEstimate()
        return
    assert need.each > 0.0
    enough = need.sum_up(1)
    monkeypatch.setattr(memory, "measure_available", lambda: enough - 1.0)
    where = out.with_name("refused") / "out"
    refuse("memory: found", where, "run", path, "--workers", 1)
    assert not where.parent.exists()
    monkeypatch.setattr(memory, "measure_available", lambda: enough)
    memory.check_memory(need, 1)


def test_there_must_be_something_to_resume(finished, refuse, tmp_path):
    _, path, _ = finished
    refuse("found no interrupted run", tmp_path / "new" / "out", "run", path, "--resume")
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("name", ["provenance.json", "summary.json", "a table"])
@pytest.mark.parametrize("damage", ["removed", "emptied"])
def test_damaged_results_are_one_line(finished, name, damage, call, tmp_path):
    found = shutil.copytree(finished[2], tmp_path / "damaged")
    tables = json.loads((found / "provenance.json").read_text())["tables"]
    if name == "a table" and not tables:
        pytest.skip("this kind writes no tables")
    path = found / (next(iter(tables)) if name == "a table" else name)
    header = path.read_text().partition("\n")[0]
    if damage == "removed":
        path.unlink()
    else:
        nonsense = f"{header}\n{','.join(['nonsense'] * len(header.split(',')))}\n"
        path.write_text(nonsense if name == "a table" else "{}\n")
    before = read_all(found)
    code, said, complaint = call("report", found, "--trust-code")
    assert (code, said, complaint.count("\n")) == (2, "", 1), complaint
    assert str(found) in complaint
    assert read_all(found) == before


def test_compare_takes_two_results_or_says_why_not(finished, call):
    _, _, out = finished
    code, said, complaint = call("compare", out, out, "--trust-code")
    assert code == 0, complaint
    assert "variant" in said or "entry" in said
