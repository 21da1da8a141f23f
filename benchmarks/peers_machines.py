"""bayescal beside what users would take instead, on measured data: an arm, a delta printer and a telescope's mount.

    python benchmarks/peers_machines.py [--machines ur10 flsun_v400 mmt_mount] [--peers bayescal scipy klipper ...]
                                        [--effort standard] [--folds 1] [--environments build/peers]
                                        [--add] [--name peers_machines]

A peer is a script of `machine_peers/`, as its users would write it: files in, positions or parameters out, as JSON.
Peers from an index state what they need at their head; their versions exclude each other's and bayescal's, so that each
gets an environment of its own the first time. What a peer finds is judged here, by the same lines for all:

- `ur10`: 60 rows calibrate; rms and mean distance, mm, from the tracker's positions of 119 other rows.
- `flsun_v400`: the radius, root mean squares of heights and of distances, µm, and the largest difference of a length
  from what the printer's own firmware had found of these data.
- `mmt_mount`: root mean square on the sky, arcsec, of all 80 stars, and of those left out of a fit (the first of the
  study's folds, 16 stars, by default).

Seconds are processor time of whole processes, imports included; lines are those of script or config that are neither
blank nor comment. bayescal runs the shipped study: its variants, checks and page; `seconds_alone` is one variant.
"""

from __future__ import annotations

import argparse
import ast
import json
import math
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from machine_peers.flsun_klipper import COMMANDS, locate
from telescope_problem import RESULTS, write_results

from bayescal.numerics.geometry import Array

ROOT = Path(__file__).parents[1]
SCRIPTS, EXPERIMENTS = Path(__file__).parent / "machine_peers", ROOT / "experiments"
THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
TURN = 360.0


@dataclass(frozen=True)
class Peer:
    """A script of `machine_peers/` with its last arguments, and what it says of uncertainty."""

    name: str
    script: str
    uncertainty: str
    option: str = ""
    written: str = ""  # by its user, where it is not the script


NONE = "none; a covariance from its Jacobian in one line"
PEERS = {
    "ur10": (
        Peer("robotkinecal", "ur10_robotkinecal.py", "one number a joint"),
        Peer("figaroh", "ur10_figaroh.py", "covariance of parameters", "structural"),
        Peer("figaroh, map_cv", "ur10_figaroh.py", "covariance of parameters", "map_cv"),
        Peer("figaroh, elastic", "ur10_figaroh.py", "covariance of parameters", "elastic"),
        *(
            Peer(f"scipy, {one}", "ur10_scipy.py", NONE, one)
            for one in ("links", "weighted links", "sines", "weighted sines")
        ),
    ),
    "flsun_v400": (
        Peer("klipper", "flsun_klipper.py", "none", written=COMMANDS),
        Peer("scipy", "flsun_scipy.py", NONE),
    ),
    "mmt_mount": (
        Peer("pytelpoint", "mmt_pytelpoint.py", "posterior of terms and scatters"),
        Peer("scipy", "mmt_scipy.py", NONE),
    ),
}
OURS = "posterior, ranked variants, intervals of predictions"


def run(command: list[object]) -> tuple[str, float]:
    """Return what a process prints and its processor time, children's too, s; RuntimeError with its last line."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [str(one) for one in command],
        env=os.environ | THREADS,
        capture_output=True,
        text=True,
        check=False,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise RuntimeError((done.stderr.strip().splitlines() or ["no output"])[-1])
    return done.stdout, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def read_dependencies(script: Path) -> list[str]:
    """Return the packages that a script states at its head (PEP 723)."""
    lines = script.read_text(encoding="utf-8").splitlines()
    if lines[0] != "# /// script":
        return []
    head = "\n".join(line[2:] for line in lines[1 : lines.index("# ///")])
    return [str(one) for one in tomllib.loads(head)["dependencies"]]


def find_python(script: Path, environments: Path) -> Path:
    """Return the Python that has what a script needs, its environment made where it is missing."""
    needed = read_dependencies(script)
    if not needed:
        return Path(sys.executable)
    folder, stated = environments / script.stem, "\n".join(needed)
    made, python = folder / "dependencies.txt", folder / "bin" / "python"
    if not made.exists() or made.read_text() != stated:
        run([sys.executable, "-m", "venv", "--clear", folder])
        run([python, "-m", "pip", "install", "--quiet", *needed])
        made.write_text(stated)
    return python


def read_versions(python: Path, script: Path) -> dict[str, str]:
    """Return the versions of the packages that a peer's environment was made for."""
    names = [one.split("=")[0].split("<")[0] for one in read_dependencies(script) or script.stem.split("_")[1:]]
    names = [one for one in names if one != "klipper"]  # its formulas are written down here
    code = "import sys; from importlib.metadata import version; print(*map(version, sys.argv[1:]))"
    return dict(zip(names, run([python, "-c", code, *names])[0].split(), strict=True))


def count_lines(text: str, python: bool) -> int:
    """Return lines that are neither blank nor comment, nor, of Python, docstrings."""
    silent: set[int] = set()
    for node in ast.walk(ast.parse(text)) if python else ():
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            silent |= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    lines = enumerate(text.splitlines(), start=1)
    return sum(bool(line.strip()) and not line.lstrip().startswith("#") and k not in silent for k, line in lines)


def judge_positions(predicted: Array) -> dict[str, float]:
    """Return rms and mean distance, mm, of predicted positions (P, 3) from those of the held-back rows."""
    held = pd.read_csv(EXPERIMENTS / "ur10" / "data" / "held_back.csv", comment="#")
    off = np.linalg.norm(predicted - held.filter(like="tracker").to_numpy(), axis=1)
    return {"rms_mm": float(np.sqrt((off**2).mean())), "mean_mm": float(off.mean()), "n": len(off)}


def judge_delta(x: list[float]) -> dict[str, float]:
    """Return radius, residuals and the difference from the firmware's fit of (r, two angles, endstops, arms)."""
    data = EXPERIMENTS / "flsun_v400" / "data"
    table = pd.read_csv(data / "readings.csv", comment="#").drop(columns="pose").to_numpy().tolist()
    above = [locate(x, r[3 * k : 3 * k + 3])[2] - r[6 + k] for r in table for k in (0, 1) if not math.isnan(r[6 + k])]
    apart = [math.dist(locate(x, r[:3]), locate(x, r[3:6])) - r[8] for r in table if not math.isnan(r[8])]
    theirs = pd.read_csv(data / "klipper.csv", comment="#").set_index("quantity")["value"]
    order = ["r", "angle[1]", "angle[2]", *(f"{symbol}[{k}]" for symbol in "el" for k in (1, 2, 3))]
    heights, distances = (1e3 * float(np.sqrt(np.mean(np.square(one)))) for one in (above, apart))
    difference = np.abs(np.array(x) - theirs[order].to_numpy())
    lengths = float(np.delete(difference, [1, 2]).max())
    return {"radius_mm": x[0], "rms_heights_um": heights, "rms_distances_um": distances, "from_firmware_mm": lengths}


def judge_sky(predicted: Array, sky: Array) -> float:
    """Return the root mean square, arcsec, of directions from those on the sky, both (P, 2), degrees."""
    off = (predicted - sky + TURN / 2) % TURN - TURN / 2
    off[:, 0] *= np.cos(np.radians(sky[:, 1]))
    return 3600.0 * float(np.sqrt((off**2).sum(axis=1).mean()))


def list_folds(n: int, folds: int) -> list[Array]:
    """Return the first folds of the mount's study, masks (P,)."""
    study = tomllib.loads((EXPERIMENTS / "mmt_mount" / "study.toml").read_text(encoding="utf-8"))
    order = np.random.default_rng([study["seed"], 6]).permutation(n)
    every = study["validation"]["folds"]
    return [np.isin(np.arange(n), order[k::every]) for k in range(folds)]


def run_peer(machine: str, peer: Peer, python: Path, folder: Path, folds: int) -> dict[str, Any]:
    """Return a peer's figures."""
    data, script = EXPERIMENTS / machine / "data", SCRIPTS / peer.script

    def call(*arguments: object) -> tuple[dict[str, Any], float]:
        text, seconds = run([python, script, *arguments, *([peer.option] if peer.option else [])])
        return json.loads(text.splitlines()[-1]), seconds

    if machine == "ur10":
        write_urdf(folder / "ur10.urdf")
        more = [] if peer.name.startswith("scipy") else [folder / "ur10.urdf"]
        found, seconds = call(data / "rows_60.csv", data / "held_back.csv", *more)
        figures: dict[str, Any] = dict(judge_positions(np.array(found["predicted"])))
    elif machine == "flsun_v400":
        found, seconds = call(data / "readings.csv")
        figures = dict(judge_delta(found["found"]))
    else:
        found, seconds = call(data / "stars.csv", data / "stars.csv")
        stars = pd.read_csv(data / "stars.csv", comment="#")
        sky = stars[["azimuth_deg", "elevation_deg"]].to_numpy()
        figures = {"rms_arcsec": judge_sky(np.array(found["predicted"]), sky)}
        left = np.zeros(0)
        for held in list_folds(len(stars), folds):
            for name, rows in (("fit", stars[~held]), ("held", stars[held])):
                rows.to_csv(folder / f"{name}.csv", index=False)
            one = judge_sky(np.array(call(folder / "fit.csv", folder / "held.csv")[0]["predicted"]), sky[held])
            left = np.append(left, one)
        figures["left_out_arcsec"] = float(np.sqrt((left**2).mean()))
    said = {key: value for key, value in found.items() if key not in {"predicted", "found"}}
    return figures | {"seconds": seconds, "versions": read_versions(python, script), "said": said}


def run_bayescal(machine: str, folder: Path, effort: str, folds: int) -> dict[str, dict[str, Any]]:
    """Return the figures of each variant of the shipped study, best first, and the time of one variant alone."""
    shutil.copytree(EXPERIMENTS / machine, folder / machine)
    study = tomllib.loads((folder / machine / "study.toml").read_text(encoding="utf-8"))
    first = ", ".join(f"{key} = {json.dumps(value)}" for key, value in study["variants"][0].items())
    (folder / machine / "alone.toml").write_text(
        f'extends = "study.toml"\nname = "alone"\nvariants = [{{ {first} }}]\n'
    )
    seconds = {}
    for name in ("study", "alone"):
        command = [sys.executable, "-m", "bayescal", "run", folder / machine / f"{name}.toml", "--out", folder / name]
        seconds[name] = run([*command, "--workers", 1, "--quiet", "--effort", effort])[1]
    tables = folder / "study" / "tables"
    variants = pd.read_csv(tables / "variants.csv").sort_values("log_evidence", ascending=False)
    judge: dict[str, Callable[[Path, str, int], dict[str, float]]] = {
        "ur10": _judge_arm,
        "flsun_v400": _judge_printer,
        "mmt_mount": _judge_mount,
    }
    found = {}
    for name in variants["variant"] if machine != "flsun_v400" else ["arms_differ", "arms_alike"]:
        found[f"bayescal, {name}"] = judge[machine](tables, name, folds) | {"seconds": seconds["study"]}
    for row in found.values():
        row["seconds_alone"] = seconds["alone"]
    return found


def _judge_arm(tables: Path, variant: str, folds: int) -> dict[str, float]:
    rows = pd.read_csv(tables / "tool_predictions.csv").query(
        "variant == @variant and channel.str.startswith('tracker')"
    )
    inside = float(rows["in_interval_90"].mean())
    order = pd.read_csv(EXPERIMENTS / "ur10" / "data" / "held_back.csv", comment="#")["pose"]
    return judge_positions(rows.pivot(index="pose", columns="channel", values="mean").loc[order].to_numpy()) | {
        "in_90": inside
    }


def _judge_printer(tables: Path, variant: str, folds: int) -> dict[str, float]:
    rows = pd.read_csv(tables / "parameters.csv").query("variant == @variant").set_index("parameter")
    mean, degrees = rows["mean"], np.degrees(rows["mean"].filter(like="angle"))
    arms = [mean.get(f"l[{k}]", mean.get("l[1,2,3]")) for k in (1, 2, 3)]
    x = [mean["r"], degrees["angle[1]"], degrees["angle[2]"], *(mean[f"e[{k}]"] for k in (1, 2, 3)), *arms]
    return judge_delta([float(one) for one in x]) | {"sd_radius_mm": float(rows["sd"]["r"])}


def _judge_mount(tables: Path, variant: str, folds: int) -> dict[str, float]:
    stars = pd.read_csv(EXPERIMENTS / "mmt_mount" / "data" / "stars.csv", comment="#").set_index("pose")
    sky = stars[["azimuth_deg", "elevation_deg"]]
    rows = pd.read_csv(tables / "residuals.csv").query("variant == @variant")
    off = rows.pivot(index="pose", columns="channel", values="residual").loc[sky.index, ["encoder[1]", "encoder[2]"]]
    predicted = pd.read_csv(tables / "tool_predictions.csv").query("variant == @variant")
    inside = float(predicted["in_interval_90"].mean())
    means = np.degrees(
        predicted.pivot(index="pose", columns="channel", values="mean").loc[sky.index, ["azimuth", "elevation"]]
    )
    left = [judge_sky(means.to_numpy()[held], sky.to_numpy()[held]) for held in list_folds(len(sky), folds)]
    return {
        "rms_arcsec": judge_sky(sky.to_numpy() + np.degrees(off.to_numpy()), sky.to_numpy()),
        "left_out_arcsec": float(np.sqrt(np.mean(np.square(left)))),
        "in_90": inside,
    }


def write_urdf(path: Path) -> None:
    """Write the arm of the study, as drawn, as URDF, which is what figaroh and robotkinecal read."""
    rows = tomllib.loads((EXPERIMENTS / "ur10" / "machine.toml").read_text(encoding="utf-8"))["machine"]["joints"]
    text, parent, x, z, turn = ['<robot name="ur10"><link name="base"/>'], "base", 0.0, 0.0, 0.0
    for row in [*rows, {"name": "tool"}]:
        name, kind = row["name"], "fixed" if row["name"] == "tool" else "revolute"
        text += [
            f'<joint name="{name}_joint" type="{kind}"><origin xyz="{x} 0 {z}" rpy="{turn} 0 0"/><axis xyz="0 0 1"/>',
            f'<parent link="{parent}"/><child link="{name}"/>',
            '<limit lower="-6.2832" upper="6.2832" effort="330" velocity="2"/></joint>',
        ]
        x, z, turn = 1e-3 * row.get("a_mm", 0.0), 1e-3 * row.get("d_mm", 0.0), math.radians(row.get("alpha_deg", 0.0))
        a, b, c = (1e-3 * one for one in row.get("centre_mm", (0.0, 0.0, 0.0)))
        along = f"{x + a} {math.cos(turn) * b - math.sin(turn) * c} {z + math.sin(turn) * b + math.cos(turn) * c}"
        inertia = '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>'
        mass = f'<inertial><origin xyz="{along}"/><mass value="{row.get("mass_kg", 0.0)}"/>{inertia}</inertial>'
        text.append(f'<link name="{name}">{mass if "mass_kg" in row else ""}</link>')
        parent = name
    path.write_text("\n".join([*text, "</robot>\n"]))


def compare(machine: str, options: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """Return the rows of a machine; a peer that fails has its error for a row."""
    rows: dict[str, dict[str, Any]] = {}
    if not options.peers or "bayescal" in options.peers:
        with tempfile.TemporaryDirectory() as folder:
            found = run_bayescal(machine, Path(folder), options.effort, options.folds)
        written = [EXPERIMENTS / machine / name for name in ("machine.toml", "study.toml")]
        lines = sum(count_lines(path.read_text(encoding="utf-8"), python=False) for path in written)
        rows |= {name: row | {"lines": lines, "uncertainty": OURS} for name, row in found.items()}
    for peer in PEERS[machine]:
        if options.peers and peer.name.split(",")[0] not in options.peers:
            continue
        script = (SCRIPTS / peer.script).read_text(encoding="utf-8")
        lines = count_lines(peer.written or script, python=not peer.written)
        try:
            python = find_python(SCRIPTS / peer.script, options.environments.resolve())
            with tempfile.TemporaryDirectory() as folder:
                found_row = run_peer(machine, peer, python, Path(folder), options.folds)
        except RuntimeError as failure:
            found_row = {"error": str(failure)}
        rows[peer.name] = found_row | {"lines": lines, "uncertainty": peer.uncertainty}
    return rows


def report(machine: str, rows: dict[str, dict[str, Any]]) -> None:
    """Print a machine's table."""
    print(f"\n{machine}")
    for name, row in rows.items():
        figures = "  ".join(f"{key} {value:.4g}" for key, value in row.items() if isinstance(value, float))
        print(f"  {name:24}{row.get('error', figures)}  lines {row['lines']}  {row['uncertainty']}", flush=True)


def main() -> None:
    """Run all, print the tables, write the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--machines", nargs="*", choices=PEERS, default=list(PEERS))
    names = sorted({"bayescal", *(one.name.split(",")[0] for group in PEERS.values() for one in group)})
    parser.add_argument("--peers", nargs="*", choices=names, default=[], help="all by default")
    parser.add_argument("--effort", default="standard", help="of bayescal")
    parser.add_argument("--folds", type=int, default=1, help="of the stars, that are left out one after another")
    parser.add_argument(
        "--environments", type=Path, default=ROOT / "build" / "peers", help="of the peers; made where missing"
    )
    parser.add_argument("--add", action="store_true", help="machines to what the results' file has")
    parser.add_argument("--name", default="peers_machines", help="of the results' file")
    options = parser.parse_args()
    kept = RESULTS / f"{options.name}.json"
    found = {}
    if options.add:
        found = {key: value for key, value in json.loads(kept.read_text()).items() if key in PEERS}
    for machine in options.machines:
        found[machine] = compare(machine, options)
        report(machine, found[machine])
    print(write_results(options.name, found, ("numpy", "scipy", "emcee")).name)


if __name__ == "__main__":
    main()
