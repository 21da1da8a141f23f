"""The table of docs/uses.md, cell by cell, through the command line: what it says works, works; what not, is refused.

Each machine is calibrated once, tiny, and all uses take that result.
"""

from __future__ import annotations

import html
import json
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from html_reader import leave_out_script
from seven_machines import MACHINES, Written

from bayescal.experiments.runner.results import read_results
from bayescal.experiments.study.page.build import BLOCKS
from bayescal.experiments.study.page.results import StudyResults
from bayescal.report.blocks import Page
from bayescal.report.page import render_page
from bayescal.report.pictures import Picture

pytestmark = [pytest.mark.runs, pytest.mark.usefixtures("no_pictures", "search_little")]

PAGE = Path(__file__).parents[1] / "docs" / "uses.md"
REFUSED = "not meaningful: "
UNCONVERGED = "not everything converged"
OF_LEGS = {"mechanism": "mechanism", "URDF": "urdf", "genhexkins": "genhexkins"}
PARAMETERS = ("parameters", "toml", "json", "csv")


def read_page() -> tuple[str, dict[str, dict[str, str]]]:
    """Return the first paragraph, which names what all machines take, and the cells by machine and use."""
    text = PAGE.read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if line.startswith("|")]
    head, _, *rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return text.split("\n\n")[1], {name: dict(zip(head[1:], cells, strict=True)) for name, *cells in rows}


COMMON, ROWS = read_page()


@dataclass(eq=False)
class Place:
    """A machine's folder and its results, which are there once they are asked for."""

    written: Written
    run_tiny: Callable[..., Path]

    @cached_property
    def results(self) -> Path:
        """Return the results of its study."""
        return self.run_tiny(self.written.folder / "study.toml", self.written.folder / "results")


@dataclass(frozen=True, eq=False)
class Use:
    """What a test of one cell needs: the machine, the command line, an empty folder, the words of the cell."""

    place: Place
    call: Callable[..., tuple[int, str, str]]
    out: Path
    cell: str

    @property
    def folder(self) -> Path:
        """Return the machine's folder."""
        return self.place.written.folder

    def run(self, *arguments: object) -> str:
        """Call a command that has to work; return what it says."""
        code, said, complaint = self.call(*arguments)
        assert code == 0, complaint
        return said

    def take(self, command: str, *arguments: object) -> str:
        """Call a command of a calibrated machine that has to work."""
        return self.run(command, self.place.results, *self.of_machine, *arguments)

    @property
    def of_machine(self) -> tuple[object, ...]:
        """Return options of commands that take a calibrated machine: of its tiny run, converged or not."""
        return ("--variant", self.place.written.variant, "--trust-code", "--allow-unconverged")

    def refuse(self, reason: str, *arguments: object) -> None:
        """Call a command that has to be refused in one line for a reason, with nothing written."""
        code, said, complaint = self.call(*arguments)
        assert (code, said, complaint.count("\n")) == (2, "", 1), complaint
        assert reason in complaint
        assert not list(self.out.iterdir())


def run_tiny(call: Callable[..., tuple[int, str, str]]) -> Callable[..., Path]:
    """Return a function that runs a study; so little may not converge, and is written all the same."""

    def run(study: Path, out: Path) -> Path:
        code, _, complaint = call("run", study, "--out", out, "--workers", 1)
        assert code == 0 or (code == 3 and UNCONVERGED in complaint), complaint
        return out

    return run


def read(path: Path, *columns: str) -> pd.DataFrame:
    """Return a table that has rows, no infinities, and finite numbers in some columns."""
    table = pd.read_csv(path, comment="#")
    assert len(table), path
    assert not np.isinf(table.select_dtypes("number").to_numpy()).any(), path
    assert np.isfinite(table[list(columns)].to_numpy(dtype=float)).all(), path
    return table


def find(folder: Path, name: str) -> Path:
    """Return the file of a name under a folder, where there is one."""
    (found,) = folder.rglob(name)
    return found


def list_numbers(content: object) -> Iterator[float]:
    """Return all numbers of a JSON file's content."""
    for one in content.values() if isinstance(content, dict) else content if isinstance(content, list) else ():
        yield from list_numbers(one)
    if isinstance(content, int | float):
        yield content


# --- the uses ---------------------------------------------------------------------------------------------------------


def calibrate(use: Use) -> None:
    """Run, report, compare: a posterior with a spread, its page written again, results side by side."""
    results = use.place.results
    found = read(find(results, "parameters.csv"), "mean", "sd")
    assert (found["sd"] > 0.0).all()
    (results / "report.html").unlink()
    use.run("report", results)
    assert (results / "report.html").stat().st_size > 10_000
    assert use.place.written.variant in use.run("compare", results, results)
    check_blocks(results)


def check_blocks(results: Path) -> None:
    """Every block of the study's page returns nothing, or a section with a title whose cells all say something."""
    study = StudyResults.of(read_results(results))
    for block in BLOCKS:
        section = block(study)
        if section is None:
            continue
        assert section.title, block
        assert section.blocks, block
        page = Page("Study", "name", "title", "", "headline", (), (section,))
        shown = render_page(page, {one.name: Picture(b"") for one in page.figures() if one.draw is not None})
        words = re.sub(r"<[^>]*>", "|", leave_out_script(shown))
        assert not re.search(r"\b(nan|inf)\b|\| *None *\|", words), block


def predict_rows(use: Use) -> None:
    """Rows left out, stacking, and how much the posterior depends on priors and data, of two variants."""
    results = use.place.results
    (path,) = (one for name in ("variants.csv", "ranking.csv") for one in results.rglob(name))
    found = read(path, "elpd_loo", "elpd_loo_se", "log_evidence")
    assert len(found) == 2
    if path.name == "variants.csv":
        weights, columns = list(found["stacking_weight"]), ("prior_sensitivity", "likelihood_sensitivity")
        depends = read(results / "tables" / "parameters.csv", *columns)
    else:
        stacked = json.loads((results / "summary.json").read_text()).get("stacked")
        leads = found["elpd_loo_difference"].abs().max() > 2.0 * found["elpd_loo_difference_se"].max()
        assert (stacked is None) == leads  # a study stacks the variants that predict alike
        weights, columns = [1.0] if leads else list(stacked["weights"].values()), ("prior", "likelihood")
        depends = read(results / "tables" / "power_scaling.csv", *columns)
    assert sum(weights) == pytest.approx(1.0, abs=1e-6)
    assert (depends[columns[1]] > 0.0).any()


def combine_errors(use: Use) -> None:
    """All kinds of errors in one variant."""
    results = use.place.run_tiny(use.place.written.together, use.out / "results")
    found = read(results / "tables" / "parameters.csv", "mean", "sd")
    kinds = {name.partition("(")[0] for name in found["parameter"]}
    assert {"noise_factor", "model_error", "sigma_g"} <= kinds
    assert read(results / "tables" / "variants.csv", "log_evidence", "elpd_loo")["has_outliers"].all()


def validate(use: Use) -> None:
    """Say before a run what the data can determine."""
    said = use.run("validate", use.folder / "study.toml")
    assert len(re.findall(r"combinations? will be determined", said)) == 2, said


def selftest(use: Use) -> None:
    """Look for the usual faults, and simulate from prior and posterior."""
    variant = use.place.written.variant
    options = ("--variant", variant, "--data-sets", 4, "--seed", 2, "--workers", 1)
    study = use.folder / "study.toml"
    if 'status = "measured"' in study.read_text():  # a real machine has errors that its model has not
        code, _, complaint = use.call("selftest", study, *options, "--out", use.out)
        assert code in (0, 3), complaint
        found = read(use.out / "tables" / "checks.csv")
        assert set(found.loc[found["level"] != "good", "fault"].dropna()) <= {"model error"}
        return
    use.run("selftest", study, *options, "--out", use.out)
    found = read(use.out / "tables" / "checks.csv")
    by_ranks = found["subject"].str.startswith("Simulated")  # of four data sets, which are no verdict
    assert set(found.loc[~by_ranks, "level"]) == {"good"}
    assert set(found.loc[by_ranks, "level"]) == {"warning"}
    assert len(read(use.out / "tables" / "ranks.csv")) == 8


def ask_next(use: Use) -> None:
    """Name the next pose, and say whether to stop."""
    use.run("next-pose", use.folder / "next_pose.toml", "--out", use.out, "--workers", 1)
    poses = read(use.out / "next_poses.csv")
    assert np.isfinite(poses.select_dtypes("number").to_numpy()).all()
    assert json.loads((use.out / "summary.json").read_text())["decision"] in ("stop", "measure")


def join_sessions(use: Use) -> None:
    """Two sessions of one machine: nothing has moved between them."""
    use.run("run", use.folder / "sessions.toml", "--out", use.out, "--workers", 1)
    found = read(use.out / "tables" / "shifts.csv", "mean", "sd")
    assert (np.abs(found["mean"]) < 5.0 * found["sd"]).all()


def predict_and_command(use: Use) -> None:
    """Commands of predicted poses take the machine there again."""
    where = use.place.written.coordinates
    names = ("told", "poses", "wanted", "commands", "again")
    told, poses, wanted, commands, again = (use.out / f"{name}.csv" for name in names)
    assert use.place.results.is_dir()  # its commands are there once it has run
    given = read(use.place.written.commands).head(4)
    given.to_csv(told, index=False)
    use.take("predict", told, "--out", poses)
    found = read(poses, *where)
    known = [name for name in given if name in found and name not in ("pose", *where)]
    found[["pose", *where, *known]].to_csv(wanted, index=False)
    use.take("compensate", wanted, "--out", commands)
    use.take("compensate", poses, "--out", again)  # the table as predicted
    pd.testing.assert_frame_equal(read(again), read(commands), atol=1e-6)
    use.take("predict", commands, "--out", again)
    np.testing.assert_allclose(read(again)[list(where)], found[list(where)], rtol=0, atol=1e-5)


def export(use: Use) -> None:
    """Write all formats that the cell names, and refuse the others."""
    named = [one for name, one in OF_LEGS.items() if name in use.cell]
    assert "parameters" in use.cell
    for one in (*named, *PARAMETERS):
        variant = use.place.written.rigid if one in named else use.place.written.variant
        options = ("--variant", variant, "--trust-code", "--allow-unconverged", "--format", one)
        use.run("export", use.place.results, *options, "--out", use.out / one)
        covariance = [path for path in (use.out / one).iterdir() if path.name == "covariance.csv"]
        assert np.isfinite(pd.read_csv(covariance[0], comment="#", index_col=0).to_numpy(dtype=float)).all()
    before = sorted(use.out.iterdir())
    for one in set(OF_LEGS.values()) - set(named):
        options = (*use.of_machine, "--format", one, "--out", use.out / one)
        code, said, complaint = use.call("export", use.place.results, *options)
        assert (code, said, complaint.count("\n")) == (2, "", 1), complaint
    assert sorted(use.out.iterdir()) == before


def certify(use: Use) -> None:
    """Certify the poses, with figures of ISO or the reason of the cell why there are none."""
    path = use.out / "certificate.html"
    use.take("certificate", "--poses", 16, "--out", path)
    found = json.loads(path.with_suffix(".json").read_text())
    numbers = [*list_numbers(found["standard_uncertainty"]), *list_numbers(found["expanded_uncertainty"])]
    assert len(numbers) > 5
    assert np.isfinite(numbers).all()
    page = html.unescape(re.sub(r"<[^>]+>", "", path.read_text()))
    _, _, without = use.cell.partition("; no ISO figures: ")
    assert ("accuracy AP" in page) == ("with figures" in use.cell) == (not without)
    assert without in page


def verify(use: Use) -> None:
    """Plan the fewest poses; where the cell says that own sensors show nothing, they are refused."""
    use.take("verify", *use.place.written.verify, "--out", use.out / "plan.csv")
    read(use.out / "plan.csv")
    alone = re.search(r"not by its (\w+)s alone: (.*)", use.cell)
    if alone:
        (use.out / "plan.csv").unlink()
        use.refuse(alone[2], "verify", use.place.results, *use.of_machine, "--sensors", alone[1])


def tabulate(use: Use) -> None:
    """A table by what is given beside the pose."""
    options = ("--allow-unconverged", "--out", use.out / "table", "--workers", 1)
    if use.cell.startswith(REFUSED):
        use.refuse(use.cell.removeprefix(REFUSED), "table", use.folder / "table.toml", *options)
        return
    _ = use.place.results
    use.run("table", use.folder / "table.toml", *options)
    assert sum(len(read(path)) for path in (use.out / "table").rglob("*.csv")) > 3


USES = {
    "`run`, `report`, `compare`": calibrate,
    "leave-one-out, stacking, prior and data sensitivity": predict_rows,
    "errors: noise by group, model error, functions, outliers, together": combine_errors,
    "`validate`": validate,
    "`selftest`": selftest,
    "`next-pose`": ask_next,
    "`sessions`": join_sessions,
    "`predict`, `compensate`": predict_and_command,
    "`export`": export,
    "`certificate`": certify,
    "`verify`": verify,
    "`table`": tabulate,
}
CELLS = [pytest.param(machine, row, id=f"{USES[row].__name__}: {machine}") for machine in MACHINES for row in USES]


@pytest.fixture(scope="module")
def places(tmp_path_factory) -> dict[str, Place]:
    """Return the machines that tests have asked for so far."""
    return {}


@pytest.mark.parametrize(("machine", "row"), CELLS)
def test_cell(machine, row, places, call, tmp_path, tmp_path_factory):
    if machine not in places:
        folder = tmp_path_factory.mktemp("uses") / re.sub(r"\W+", "_", machine)
        places[machine] = Place(MACHINES[machine](folder), run_tiny(call))
    place = places[machine]
    place.run_tiny = run_tiny(call)  # of this test
    cell = ROWS[machine].get(row, "yes")
    assert cell.startswith(("yes", REFUSED)) or row == "`export`", cell
    USES[row](Use(place, call, tmp_path, cell))


def test_the_page_has_these_uses_and_machines():
    assert sorted(ROWS) == sorted(MACHINES)
    for cells in ROWS.values():
        assert set(cells) < set(USES)
        words = " ".join(USES.keys() - cells).replace(":", "").replace(",", "").split()
        assert set(words) <= set(re.findall(r"[^\s,.:]+", COMMON))
