"""The hostile suite: mutated configs, tables and results, and runs that are disturbed, of every kind and use.

    python tests/fuzz/suite.py [--share 0.1] [--minutes 60] [--workers 2] [--write docs/hostile.md]

Every case follows from its number. What each has to keep is in ``judged``; besides, what `validate` accepts `run` does
not refuse as bad input, and what `run` refuses `validate` refuses with the same line. The tests take the cases in
shares; this script takes all of them, writes their table, and ends with exit code 1 where one is at fault.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import joblib
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))  # as pytest does

import calibrated_machines as made_up
import telescope_machines as machines
from fuzz import disturbed
from fuzz.drawn import write_project
from fuzz.hostile import change_file
from fuzz.judged import Outcome, judge_call
from fuzz.subjects import DISTURBED, QUICK, Subject, read_subject, write_subjects

from bayescal.calibrated.formats import export_machine
from bayescal.calibrated.predict import predict_poses
from bayescal.data.actuators import name_actuators
from bayescal.errors import InputError, NumericalError
from bayescal.experiments.runner import losses
from bayescal.experiments.runner import run as frame
from bayescal.experiments.runner.load import load, load_experiment
from bayescal.experiments.runner.results import read_results
from bayescal.files.manifest import MANIFEST, write_manifest
from bayescal.numerics.geometry import rotation_vector_from_matrix
from bayescal.report.page import PAGE

ROOT = Path(__file__).parents[2]
UNDER_WAY = "under_way.txt"
CUT = "cut: what was read would be computed now"
WORDS = {
    "audit": ["audit"],
    "sweep": ["sweep"],
    "table": ["table"],
    "study": ["selftest", "next-pose", "poses-from-targets"],
}
WORDS["simulation"] = ["show"]
"""Commands beside `run` that take a config, or its machine, by its kind."""
RESULTS_COMMANDS = (
    "report",
    "compare",
    "export",
    "predict",
    "report",
    "update-manifest",
    "certificate",
    "verify",
    "compensate",
)
UNTOUCHED = {"init": "reads nothing", "list": "reads nothing", "schema": "reads nothing", "trust": "takes code alone"}
"""Commands that no case calls, and why."""
WHOLE = tuple(ROOT / "results" / name for name in ("hangprinter", "hexapod_figure10", "pose_extraction", "telescope"))
"""Committed results with all that reports and comparisons need."""
MADE = (
    "audit/m2_hexapod.toml",
    "own_machine/audit.toml",
    "own_machine/study.toml",
    "pose_selection/hexapod_i_optimal.toml",
    "sessions/sessions.toml",
    "sika2008/calibrations.toml",
    "sliding_star/short.toml",
    "sweep/sweep.toml",
    "rail/table.toml",
    "telescope/selftest.toml",
    "telescope/next_pose.toml",
    "telescope/short.toml",
    "telescope/simulate.toml",
    "yu2023/table4.toml",
)
"""Experiments of all kinds, run for their results."""
NOTES = ("no posterior draws", "used (--allow-changed-files)", "found no manifest.json")
"""What is said beside success of results that lack something."""
POSE = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")
NOISE = ("--position-um", "15", "--orientation-arcsec", "15")
USES = ("verify", "predict", "compensate", "certificate", "plan")


@dataclass(frozen=True)
class Trial:
    """What came of a case: the exit code that counts, and what is at fault, empty where all is well."""

    code: int
    faults: str = ""


def tell(case: str, code: int, outcomes: list[Outcome], *more: str) -> Trial:
    """Return what came of calls, faults with the case that led to them."""
    faults = [fault for one in outcomes for fault in one.faults if not any(note in fault for note in NOTES)]
    said = "\n  ".join([*faults, *more])
    return Trial(code, f"{case}\n  {said}" if said else "")


@contextmanager
def cutting() -> Iterator[None]:
    """Let every run end where it would begin to compute."""

    def refuse(*_: object, **__: object) -> None:
        raise NumericalError(CUT)

    whole, frame.Run = frame.Run, refuse  # type: ignore[assignment,misc]
    try:
        yield
    finally:
        frame.Run = whole  # type: ignore[misc]


@dataclass(eq=False)
class Ground:
    """A folder of subjects, results and machines, each made when it is first needed."""

    folder: Path
    cases: int = field(default=0, init=False)
    undisturbed: dict[tuple[str, int], tuple[disturbed.Undisturbed, list[str]]] = field(
        default_factory=dict, init=False
    )

    @cached_property
    def root(self) -> Path:
        """Where the experiments stand."""
        write_subjects(self.folder)
        return self.folder / "experiments"

    @cached_property
    def subjects(self) -> dict[str, Subject]:
        """Configs by their names, all kinds and uses among them."""
        return {name: read_subject(self.root / name) for name in sorted(QUICK)}

    @cached_property
    def results(self) -> list[Path]:
        """Results of all kinds, committed ones first."""
        return [*WHOLE, *(self._compute(name) for name in MADE)]

    def _compute(self, name: str) -> Path:
        out, config = self.folder / "results" / name.replace("/", "-").removesuffix(".toml"), self.root / name
        frame.run_experiment(load_experiment(config), config.parent, out)
        return out

    @cached_property
    def machine(self) -> Path:
        """A machine as `export` writes it, poses measured with it, and positions, in a folder."""
        folder, rng = self.folder / "machine", np.random.default_rng(2)
        folder.mkdir()
        calibrated = made_up.build_made_up(machines.build_machine("none"), rng, n_draws=60, scale=1e-3)
        export_machine(calibrated, folder / "machine", "mechanism")
        actuators = made_up.measurable_actuators(calibrated.legs, 6, rng)
        found = predict_poses(calibrated, actuators)
        poses = np.concatenate([found.position, np.degrees(rotation_vector_from_matrix(found.rotation))], axis=1)
        positions, poses = ([list(map(repr, row)) for row in one.tolist()] for one in (actuators, poses))
        measured = [[*pose, "calibration", *rho] for pose, rho in zip(poses, positions, strict=True)]
        names = name_actuators(6)
        for name, columns, rows in (
            ("poses", POSE, poses),
            ("positions", names, positions),
            ("measured", (*POSE, "use", *names), measured),
        ):
            lines = [",".join(["pose", *columns]), *(",".join([f"P{k}", *row]) for k, row in enumerate(rows))]
            (folder / f"{name}.csv").write_text("\n".join(lines) + "\n")
        return folder

    @contextmanager
    def emptied(self) -> Iterator[Path]:
        """Hold an empty folder for one case."""
        self.cases += 1
        folder = self.folder / "cases" / f"{os.getpid()}-{self.cases}"
        folder.mkdir(parents=True)
        try:
            yield folder
        finally:
            shutil.rmtree(folder)

    @contextmanager
    def changed(self, subject: Subject, rng: np.random.Generator, gentle: float) -> Iterator[str]:
        """Change one of a subject's files, the config most often, and put it right again; yield what was changed."""
        weights = np.array([3.0, *[1.0] * (len(subject.files) - 1)])
        path = subject.files[rng.choice(len(subject.files), p=weights / weights.sum())]
        original = path.read_bytes()
        content, said = change_file(path, rng, gentle)
        try:
            path.write_bytes(content)
            yield f"{subject.config.parent.name}/{subject.config.name}, {path.name}: {said}"
        finally:
            path.write_bytes(original)


# --- configs and tables ----------------------------------------------------------------------------------------------


def hold_gate(looked: Outcome, ran: Outcome) -> list[str]:
    """Return where `validate` and `run` do not say the same of an experiment."""
    if looked.code in (0, 3) and ran.code == 2:
        return [f"validate accepts what run refuses: {ran.err}"]
    if looked.code == 2 and (ran.code != 2 or ran.err not in looked.err.splitlines(keepends=True)):
        return [f"validate refuses with {looked.err!r}, run has {ran.code}: {ran.err!r}"]
    if frame.FOUND_LATE in ran.err:
        return [f"validate accepts what is refused when it is computed: {ran.err}"]
    return [] if looked.code in (0, 2, 3) else [f"validate ends with exit code {looked.code}: {looked.err}"]


def try_inputs(ground: Ground, number: int) -> Trial:
    """Look at a changed experiment, and run it to where it would compute."""
    subject, rng = ground.subjects[sorted(QUICK)[number % len(QUICK)]], np.random.default_rng([14, number])
    with ground.changed(subject, rng, 0.3) as said, ground.emptied() as folder, cutting():
        outcomes = look_and_run(subject, folder)
        words = WORDS.get(subject.kind, ())
        for word in words[number // len(QUICK) % 6 :][:1]:  # one of them, or none
            more = ["--quiet"] if word in ("audit", "sweep", "table", "selftest", "next-pose") else []
            file = subject.machine if word == "show" else subject.config
            outcomes.append(judge_call([word, file, "--out", folder / word, *more], *outcomes_in(subject)))
    return tell(f"inputs {number}: {said}", outcomes[0].code, outcomes, *hold_gate(*outcomes[:2]))


def outcomes_in(subject: Subject) -> tuple[Path]:
    """Return the folder in which no call may change anything."""
    return (subject.config.parents[1],)


def look_and_run(subject: Subject, folder: Path) -> list[Outcome]:
    """Return what `validate` and `run` make of an experiment."""
    call = ["run", subject.config, "--out", folder / "out", "--quiet", "--workers", 1]
    if subject.kind == "simulation":
        call = ["simulate", subject.config, "--out", folder / "out"]
    where = outcomes_in(subject)
    return [judge_call(["validate", subject.config], *where, folder), judge_call(call, *where, folder)]


def try_computed(ground: Ground, number: int) -> Trial:
    """Look at a changed experiment that takes little, and run it to its end."""
    cheap = [name for name, computed in sorted(QUICK.items()) if computed]
    subject, rng = ground.subjects[cheap[number % len(cheap)]], np.random.default_rng([16, number])
    with ground.changed(subject, rng, 0.9) as said, ground.emptied() as folder:
        outcomes = look_and_run(subject, folder)
    late = [] if ":" in subject.kind else hold_gate(*outcomes)  # papers' own kinds are not mended: results know them
    return tell(f"computed {number}: {said}", outcomes[1].code, outcomes, *late)


# --- results ---------------------------------------------------------------------------------------------------------


def damage(folder: Path, rng: np.random.Generator) -> str:
    """Change, empty or remove one of the files of a results directory; half of the time with a manifest that fits."""
    files = [path for path in sorted(folder.rglob("*")) if path.suffix in (".csv", ".json", ".toml")]
    path = files[rng.integers(len(files))]
    way, sealed = rng.random(), rng.random() < 0.5 and path.name != MANIFEST
    said = f"{path.name} removed" if way < 0.08 else f"{path.name} emptied or cut"
    if way < 0.08:
        path.unlink()
    elif way < 0.16:
        path.write_bytes(b"" if way < 0.12 else path.read_bytes()[: path.stat().st_size // 2])
    else:
        content, what = change_file(path, rng, 0.3)
        path.write_bytes(content)
        said = f"{path.name}: {what}"
    if sealed:
        write_manifest(folder)
    return f"{said}{', sealed' if sealed else ''}"


def try_results(ground: Ground, number: int) -> Trial:
    """Use damaged results."""
    rng, whole = np.random.default_rng([15, number]), ground.results
    source, command = whole[number % len(whole)], RESULTS_COMMANDS[number // len(whole) % len(RESULTS_COMMANDS)]
    with ground.emptied() as folder:
        found = Path(shutil.copytree(source, folder / "found"))
        said = damage(found, rng)
        more: list[object] = {
            "compare": [source],
            "export": ["--out", folder / "machines", "--allow-unconverged"],
            "certificate": ["--out", folder / "certificate.html", "--poses", 16],
            "verify": ["--measured", source / "none.csv"],
            "predict": [source / "none.csv", "--out", folder / "predicted.csv"],
            "compensate": [source / "none.csv", "--out", folder / "commands.csv"],
        }.get(command, [])
        outcome = judge_call([command, found, *more], folder)
    return tell(f"results {number}: {command} {source.name}: {said}", outcome.code, [outcome])


# --- tables of a calibrated machine ----------------------------------------------------------------------------------


def list_call(use: str, folder: Path) -> list[object]:
    """Return a call with whole files."""
    machine, out = folder / "machine", folder / "out"
    return {
        "verify": ["verify", machine, *NOISE, "--measured", folder / "measured.csv"],
        "plan": ["verify", machine, *NOISE, "--shift-um", 5000, "--candidates", folder / "positions.csv"],
        "predict": ["predict", machine, folder / "positions.csv", "--out", out / "p.csv", "--draws-out", out / "d.csv"],
        "compensate": ["compensate", machine, folder / "poses.csv", "--out", out / "c.csv"],
        "certificate": ["certificate", machine, "--poses", 16, "--out", out / "c.html"],
    }[use]


def try_tables(ground: Ground, number: int) -> Trial:
    """Use a calibrated machine with one of the files changed."""
    rng, use = np.random.default_rng([17, number]), USES[number % len(USES)]
    with ground.emptied() as above:
        folder = Path(shutil.copytree(ground.machine, above / "in"))
        (folder / "out").mkdir()
        call = list_call(use, folder)
        files = [path for path in call if isinstance(path, Path) and path.suffix == ".csv" and path.is_file()]
        own = [path for path in sorted((folder / "machine").iterdir()) if path.name != MANIFEST]
        files += own[: 1 + (number % 2) * 9]
        path = files[rng.integers(len(files))]
        content, said = change_file(path, rng)
        path.write_bytes(content)
        if path.parent.name == "machine":
            write_manifest(folder / "machine")
        outcome = judge_call(call, folder)
    return tell(f"tables {number}: {use}: {path.name}: {said}", outcome.code, [outcome])


# --- machines that are drawn -----------------------------------------------------------------------------------------

DRAWN_SECONDS = 120
"""Of the processor, within which a drawn machine's call ends."""


def try_drawn(ground: Ground, number: int) -> Trial:
    """Draw a machine with its study and its data, and calibrate it to the end: no result of it is lost."""
    with ground.emptied() as folder:
        said = write_project(number, folder / "project")
        config, out, where = folder / "project" / "study.toml", folder / "out", (folder,)
        looked = judge_call(["validate", config], *where, seconds=DRAWN_SECONDS)
        call = ["run", config, "--out", out, "--quiet", "--workers", 1]
        ran = judge_call(call, *where, seconds=DRAWN_SECONDS)
        outcomes, more = [looked, ran], hold_gate(looked, ran)
        if ran.code in (0, 3):
            for command in (["report", out], ["export", out, "--out", folder / "machines", "--allow-unconverged"]):
                outcomes.append(judge_call(command, *where, seconds=DRAWN_SECONDS))
            more += list_lost(out, ran)
        if outcomes[2:3] and outcomes[2].code:
            more.append(f"report of a finished run ends with exit code {outcomes[2].code}: {outcomes[2].err}")
    return tell(f"drawn {number}: {said}", ran.code, outcomes, *more)


def list_lost(out: Path, ran: Outcome) -> list[str]:
    """Return what a run that was not refused did not leave: results that are read back, and a page."""
    if not out.is_dir():
        return [f"no results after exit code {ran.code}: {ran.err}"]
    try:
        read_results(out)
    except InputError as error:
        return [f"results are not read back: {error}"]
    return [] if (out / PAGE).is_file() else ["no page"]


# --- disturbed runs --------------------------------------------------------------------------------------------------


def try_disturbed(ground: Ground, number: int) -> Trial:
    """Disturb a run of each kind in each way; the undisturbed one is kept from case to case."""
    ways = list(disturbed.DISTURBANCES)
    kind, how = sorted(DISTURBED)[number // len(ways) % len(DISTURBED)], ways[number % len(ways)]
    rng, config = np.random.default_rng([18, number]), ground.root / DISTURBED[kind]
    load(config)  # imported before anything is forked
    known, seed = ground.undisturbed, number // len(ways) // len(DISTURBED)
    if (kind, seed) not in known:
        with ground.emptied() as folder:
            (folder / "results").mkdir()
            known[kind, seed] = disturbed.run_undisturbed(disturbed.Stage(config, seed, folder))
    quiet, faults = known[kind, seed]
    with ground.emptied() as folder:
        (folder / "results").mkdir()
        faults = [*faults, *disturbed.disturb(disturbed.Stage(config, seed, folder), quiet, how, rng)]
    possible = [fault for fault in faults if disturbed.NOT_POSSIBLE not in fault]
    return tell(f"disturbed {number}: {kind}, {how}", 1 if len(possible) < len(faults) else 0, [], *possible)


# --- all of it -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Sort:
    """Cases of a sort: what they are, how many, and what tries one by its number."""

    title: str
    n: int
    attempt: Callable[[Ground, int], Trial]


N_DISTURBED = len(DISTURBED) * len(disturbed.DISTURBANCES)
SORTS = {
    "inputs": Sort("configs, machines and tables: `validate`, then `run` up to where it computes", 3650, try_inputs),
    "computed": Sort("the same, computed to the end", 250, try_computed),
    "results": Sort("results of every kind: report, compare, export, predict and other uses", 700, try_results),
    "tables": Sort(
        "tables and files of a calibrated machine: predict, compensate, certificate, verify", 400, try_tables
    ),
    "drawn": Sort("drawn machines: `validate`, `run` to the end, `report`, `export`", 300, try_drawn),
    "disturbed": Sort("runs killed, without room, or met by another", N_DISTURBED, try_disturbed),
}


def try_share(sort: str, numbers: range) -> tuple[str, Counter[int], list[str], float]:
    """Return exit codes and faults of some cases of a sort."""
    begun = time.monotonic()
    under_way = _ground.folder / UNDER_WAY  # who dies leaves it
    under_way.write_text(f"{sort} {numbers[0]} to {numbers[-1]}")
    trials = [SORTS[sort].attempt(_ground, number) for number in numbers]
    under_way.unlink()
    faults = [one.faults for one in trials if one.faults]
    return sort, Counter(one.code for one in trials), faults, time.monotonic() - begun


_ground: Ground


def _begin(folder: str) -> None:
    """Make a process ready: subjects of its own, pictures not drawn, nothing said of code that is run."""
    global _ground
    _ground = Ground(Path(tempfile.mkdtemp(dir=folder)))
    from bayescal.report import page, pictures

    for module in (page, pictures):
        module.render_picture = lambda draw: pictures.Picture(b"not drawn")  # type: ignore[assignment]
    sys.modules["bayescal.cli.app"]._say = lambda line: None  # type: ignore[attr-defined]
    losses.RAISE_OTHERS = True  # a programming error is a fault, and not the loss of a line
    joblib.cpu_count = frame.cpu_count = lambda: 1  # no processes within these


def list_shares(share: float) -> Iterator[tuple[str, range]]:
    """Yield cases by sort, those that take longest first, in pieces of a kind where kinds share what is made."""
    for sort in ("disturbed", "drawn", "computed", "results", "tables", "inputs"):
        n = round(share * SORTS[sort].n)
        step = len(disturbed.DISTURBANCES) if sort == "disturbed" else 25
        for k in range(0, n, step):
            yield sort, range(k, min(k + step, n))


def run(share: float, workers: int, minutes: float) -> tuple[dict[str, Counter[int]], list[str], float]:
    """Return exit codes by sort, faults and seconds; disturbed runs go on for so many minutes."""
    codes: dict[str, Counter[int]] = {sort: Counter() for sort in SORTS}
    faults: list[str] = []
    begun = time.monotonic()

    def keep(found: tuple[str, Counter[int], list[str], float]) -> None:
        sort, counted, wrong, _ = found
        codes[sort] += counted
        faults.extend(wrong)
        for fault in wrong:
            print(f"FAULT {fault}", flush=True)

    context, n_ways, first = multiprocessing.get_context("fork"), len(disturbed.DISTURBANCES), N_DISTURBED
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(workers, context, _begin, (folder,)) as pool,
    ):
        try:
            for done in as_completed([pool.submit(try_share, *case) for case in list_shares(share)]):
                keep(done.result())
            while time.monotonic() - begun < 60.0 * minutes:
                last = first + n_ways * workers
                cases = [("disturbed", range(k, k + n_ways)) for k in range(first, last, n_ways)]
                for done in as_completed([pool.submit(try_share, *case) for case in cases]):
                    keep(done.result())
                first = last
        except BrokenProcessPool:  # the pool only asks the others to end, which a case may be deaf to, and waits
            for one in multiprocessing.active_children():
                one.kill()
            cases = " or ".join(sorted(path.read_text() for path in Path(folder).glob(f"*/{UNDER_WAY}")))
            faults.append(f"{cases}: the process died")
            print(f"FAULT {faults[-1]}", flush=True)
    return codes, faults, time.monotonic() - begun


DOCUMENT = """# Hostile files and disturbed runs

What happens to bad input and broken runs? `make hostile` changes configs, tables and results of every kind, disturbs
runs, and draws machines with their studies and data; every case follows from its number. Each call has to end with
exit code 0, 2 or 3 and one line per fault, never with a traceback; after exit code 2 nothing has changed on the disk,
nothing ever changes outside `--out`, and results there are whole. `validate` refuses what `run` does, with the same
line.

Drawn machines have 0 to 6 coordinates, 1 to 12 channels of any unit, 1 to 60 rows, some with gaps; among them are
singular and mirrored ones, and slips in their data. A call ends within {seconds} s of the processor.

{table}

Disturbed runs: {disturbed}. Each is resumed until it ends, and its results are then those of a run that nobody
disturbed. {note}The suite is shown to fail on planted faults (`tests/fuzz/test_planted.py`). `make hostile` writes this
page.
"""


def write_page(path: Path, codes: dict[str, Counter[int]], faults: list[str]) -> None:
    """Write the table of what was tried."""
    lines = ["| what | tried | exit code 0 | 2 | 3 | at fault |", "|---|---|---|---|---|---|"]
    for sort, one in SORTS.items():
        counted, wrong = codes[sort], sum(fault.startswith(sort) for fault in faults)
        cells = ["–"] * 3 if sort == "disturbed" else [str(counted[code]) for code in (0, 2, 3)]
        lines.append(f"| {one.title} | {counted.total()} | {' | '.join(cells)} | {wrong} |")
    skipped = codes["disturbed"][1]
    note = f"{skipped} of them were left out, as this system lets nobody mount a file system. " if skipped else ""
    text = DOCUMENT.format(
        table="\n".join(lines), seconds=DRAWN_SECONDS, disturbed=", ".join(disturbed.DISTURBANCES), note=note
    )
    path.write_text(text, encoding="utf-8")


def main() -> None:
    """Try all cases, or a share of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--share", type=float, default=1.0, help="of the cases of every sort")
    parser.add_argument("--minutes", type=float, default=0.0, help="go on with disturbed runs until then")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--write", type=Path, help="page for the table")
    options = parser.parse_args()
    os.environ["BAYESCAL_TRUST"] = "1"
    codes, faults, seconds = run(options.share, options.workers, options.minutes)
    for sort, counted in codes.items():
        print(f"{sort}: {counted.total()} tried, by exit code {dict(sorted(counted.items()))}")
    print(f"{len(faults)} faults, {seconds:.0f} s")
    if options.write is not None:
        write_page(options.write, codes, faults)
    sys.exit(bool(faults))


if __name__ == "__main__":
    main()
