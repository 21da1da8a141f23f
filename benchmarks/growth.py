"""How time and memory grow with poses, legs, parameters and candidates: each point a process of its own.

    python benchmarks/growth.py [--what hexapod own poses audit legs parameters candidates calibration sliding_platform
                                        rows channels variants]
                                [--most 10000] [--write benchmarks/results/growth.json] [--picture FILE.png]

- ``hexapod``, ``own``: the study that `bayescal init` writes, of legs by poses and of a machine of one function, with
  its effort and so many simulated rows, a tenth of them held back; beside them what the run says first that it
  takes (``said_s``, ``said_mib``), and what `validate` takes, Python's modules among it;

- ``poses``: a study of six struts (42 parameters, poses by a tracker, one model error), from reading to its page;
- ``audit``: the audit of as many planned poses of that machine;
- ``legs``: the same study with more struts, three parameters each, 40 poses;
- ``parameters``: 50 struts with one to six parameters each, 80 poses;
- ``candidates``: exchange and O1 out of as many candidates, 42 parameters;
- ``calibration``: a hexapod under its weight by its encoders and a tracker's poses, one variant of 30 parameters;
- ``sliding_platform``: a planar platform by its own readings at as many poses, four variants of 18 to 28 parameters;
- ``rows``: `examples/own_machine`, a machine of one function with 14 parameters, one variant, at as many rows;
- ``variants``: the same with 25 rows and as many variants, in which none, one or two of its parameters are fixed;
- ``channels``: a point in the plane that as many wires measure, a machine of one function with six parameters, 40 rows.

Seconds are CPU of the process, reading of Python's modules left out; memory is the largest resident size, with and
without what an empty process takes. An exponent is the slope of log over log between the two largest sizes, and a
least-squares one over all. Machines and readings are simulated with small effort (``EFFORT``): what is fixed by the
effort and not by the size is small beside what grows. ``--picture`` draws whole studies by rows, parameters, channels
and variants, as far as the file of figures has them.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from itertools import combinations
from pathlib import Path

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"
os.environ["BAYESCAL_TRUST"] = "1"  # machines of one function are files of their own

import numpy as np  # noqa: E402 - after the number of threads is set

SIZES = {
    "hexapod": (1000, 3000, 10_000),
    "own": (1000, 3000, 10_000),
    "poses": (100, 316, 1000, 3162, 10_000),
    "audit": (100, 316, 1000, 3162, 10_000),
    "legs": (6, 12, 24, 60),
    "parameters": (20, 50, 100, 200, 300),
    "candidates": (2000, 20_000, 200_000),
    "calibration": (30, 100, 300, 1000),
    "sliding_platform": (64, 128, 256, 512),
    "rows": (30, 100, 300, 1000),
    "channels": (3, 6, 12, 24, 48),
    "variants": (1, 3, 10, 30, 100),
}
PICTURED = ("rows", "parameters", "channels", "variants")
OWN_MACHINE = Path(__file__).parents[1] / "examples" / "own_machine"
WIRES = '''
"""A point in the plane whose distance from points on an ellipse is measured by wires."""

import numpy as np

from bayescal import Channel, Coordinate, ParameterBlock, ReadingMachine, Section


class WiresConfig(Section):
    wires: int


class Wires(ReadingMachine):
    Config = WiresConfig

    def __init__(self, config):
        angle = 2.0 * np.pi * np.arange(config.wires) / config.wires
        self.cosine, self.sine = np.cos(angle), np.sin(angle)
        nominal = {"r_x": 500.0, "r_y": 500.0, "c_x": 0.0, "c_y": 0.0, "zero": 0.0}
        self.parameters = [ParameterBlock(name, (value,), per_leg=False) for name, value in nominal.items()]
        self.parameters.append(ParameterBlock("gain", (1.0,), "1", per_leg=False))
        self.coordinates = [Coordinate("x", "mm", 0.0, 200.0), Coordinate("y", "mm", 0.0, 200.0)]
        self.channels = [Channel(f"w[{k}]", "mm", external=True) for k in range(1, config.wires + 1)]

    def read(self, p, v, given):
        x = v[..., 0, None] - p["c_x"][..., None] - p["r_x"][..., None] * self.cosine
        y = v[..., 1, None] - p["c_y"][..., None] - p["r_y"][..., None] * self.sine
        return p["gain"][..., None] * np.sqrt(x * x + y * y) - p["zero"][..., None]
'''
OF_WIRES = """
machine = "machine.toml"

[provenance]
status = "simulated"
text = "never measured"

[sensors]
w = { noise_um = 10.0 }

[parameters]
r_x = { prior = "normal", sd = 0.5 }
r_y = { prior = "normal", sd = 0.5 }
c_x = { prior = "normal", sd = 0.5 }
c_y = { prior = "normal", sd = 0.5 }
zero = { prior = "normal", sd = 0.5 }
gain = { prior = "normal", sd = 0.001 }
"""
SYMBOLS = ("l", "a_x", "a_y", "b_x", "b_y", "b_z", "a_z")
SAMPLING = """
[sampler]
ensembles = 4
walkers = 32
burn_in = 5
steps = 10

[evidence]
draws = 1000
max_draws = 1000
"""
EFFORT = f"{SAMPLING}\n[sensitivity]\nprior_width_factors = [1.0]\n"
RUN = """
import resource, sys, time
from pathlib import Path
from bayescal import load_experiment
from bayescal.experiments.runner.run import run_experiment
import bayescal.report.page, arviz, matplotlib.pyplot
path, out = Path(sys.argv[1]), Path(sys.argv[2])
begun, before = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
config = load_experiment(path)
run_experiment(config, path.parent, out)
after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(time.process_time() - begun, before / 1024, after / 1024)
"""
SAY = """
import sys
from pathlib import Path
from bayescal import load_experiment
from bayescal.experiments.runner.run import admit
path = Path(sys.argv[1])
admitted = admit(load_experiment(path), path.parent, 1)
print(admitted.experiment.estimate_seconds(admitted.inputs, 1), admitted.need.sum_up(1) / 2**20)
"""
VALIDATE = """
import os, resource, sys
sys.argv = ["bayescal", "validate", sys.argv[1]]
from bayescal.cli import main
try:
    main()
finally:
    used = resource.getrusage(resource.RUSAGE_SELF)
    print(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)
"""


def describe_machine(n_legs: int) -> str:
    """Return the file of a machine on so many struts, in pairs whose lower joints lie apart."""
    k = np.arange(n_legs)
    low = 2 * np.pi * (k // 2 * 2 + np.where(k % 2, 1.7, 0.3)) / n_legs
    high = 2 * np.pi * (k // 2 * 2 + np.where(k % 2, 1.15, 0.85)) / n_legs
    base = np.stack([1700.0 * np.cos(low), 1700.0 * np.sin(low), 30.0 * np.cos(3.0 * k)], axis=1)
    platform = np.stack([1200.0 * np.cos(high), 1200.0 * np.sin(high), 20.0 * np.sin(2.0 * k)], axis=1)
    return (
        f'name = "struts"\n[base]\npoints_mm = {base.round(3).tolist()}\n[platform]\n'
        f"points_mm = {platform.round(3).tolist()}\n[home]\nposition_mm = [0.0, 0.0, 1300.0]\n"
        '[legs]\nactuated_joint = "strut"\nactuator_range_mm = 150.0\n'
    )


def describe_parameters(symbols: tuple[str, ...], n_legs: int = 6, n_parameters: int | None = None) -> str:
    """Return the tolerances."""
    del n_legs, n_parameters
    return "[parameters]\n" + "".join(f'{symbol} = {{ prior = "normal", sd = 0.5 }}\n' for symbol in symbols)


def write_poses(folder: Path, n_legs: int, n_poses: int) -> None:
    """Simulate actuators and poses of a machine that is off by its tolerances."""
    from scipy.spatial.transform import Rotation

    from bayescal.machines.deformations import NoDeformation
    from bayescal.machines.kinematics import Machine, solve_forward_kinematics
    from bayescal.machines.models.six_ups import SixUps
    from bayescal.machines.read import load_mechanism
    from bayescal.numerics.geometry import matrix_from_rotation_vector

    rng = np.random.default_rng([n_legs, n_poses])
    mechanism = load_mechanism(folder / "machine.toml")
    machine = Machine(mechanism, SixUps(), NoDeformation())
    move = rng.uniform(-1.0, 1.0, size=(n_poses, 6)) * [40.0, 40.0, 40.0, 0.03, 0.03, 0.03]
    position = mechanism.home_position + move[:, :3]
    rotation = matrix_from_rotation_vector(move[:, 3:])
    platform = position[:, None] + np.einsum("pij,nj->pni", rotation, mechanism.platform_points)
    length = np.linalg.norm(platform - mechanism.base_points, axis=-1)
    home = np.linalg.norm(mechanism.home_position + mechanism.platform_points - mechanism.base_points, axis=-1)
    actuators = mechanism.initial_actuator_positions + length - home
    theta = machine.layout.nominal + 0.3 * rng.normal(size=machine.layout.size) * _is_free(machine.layout.names)
    reached = solve_forward_kinematics(machine, theta, actuators)
    seen = reached.position + rng.normal(size=(n_poses, 3)) * 0.01
    turned = Rotation.from_matrix(reached.rotation).as_rotvec(degrees=True) + rng.normal(size=(n_poses, 3)) * 6e-4
    names = [f"p{k}" for k in range(n_poses)]
    legs = ",".join(f"rho_{k + 1}_mm" for k in range(n_legs))
    use = ["calibration" if k >= n_poses // 10 else "verification" for k in range(n_poses)]
    rows = [f"{n},{u}," + ",".join(f"{x:.6f}" for x in row) for n, u, row in zip(names, use, actuators, strict=True)]
    (folder / "actuators.csv").write_text("\n".join([f"pose,use,{legs}", *rows]) + "\n")
    both = np.concatenate([seen, turned], axis=1)
    rows = [f"{n}," + ",".join(f"{x:.9f}" for x in row) for n, row in zip(names, both, strict=True)]
    (folder / "poses.csv").write_text("\n".join(["pose,x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg", *rows]) + "\n")


def _is_free(names: tuple[str, ...]) -> np.ndarray:
    return np.array([name.partition("[")[0] in SYMBOLS for name in names])


def write_study(folder: Path, n_legs: int, n_poses: int, symbols: tuple[str, ...]) -> Path:
    """Write a study of simulated poses; return its config."""
    (folder / "machine.toml").write_text(describe_machine(n_legs))
    write_poses(folder, n_legs, n_poses)
    path = folder / "study.toml"
    path.write_text(
        f'kind = "study"\nname = "growth"\ntitle = "Growth"\nseed = 1\nmachine = "machine.toml"\n'
        '[provenance]\nstatus = "simulated"\ntext = "never measured"\n'
        '[data]\ninstrument = "poses"\nposes = "poses.csv"\n'
        'actuators = "actuators.csv"\nactuator_noise_um = 1.0\nposition_um = 10.0\norientation_arcsec = 2.0\n'
        f"{describe_parameters(symbols)}[model_error]\nrandom_scale_um = 10.0\nseparate_by_leg = false\n"
        f'[[variants]]\nmodel = "six_ups"\ndeformation = "none"\nfree = {json.dumps(symbols)}\n{EFFORT}'
    )
    return path


DESIGN = """
machine = "machine.toml"

[[variants]]
model = "six_ups"
{deformation}
[noise]
actuator_um = 1.0

[sensors.tracker]
kind = "pose"
position_um = 10.0
orientation_arcsec = 2.0

[workspace]
position_mm = [40.0, 40.0, 40.0]
rotation_deg = [1.0, 1.0, 1.0]

[requirements]
x = 0.05
y = 0.05
z = 0.02
"""


def write_audit(folder: Path, n_poses: int) -> Path:
    """Write the audit of a plan; return its config."""
    (folder / "machine.toml").write_text(describe_machine(6))
    path = folder / "audit.toml"
    path.write_text(
        'kind = "audit"\nname = "growth"\ntitle = "Growth"\nseed = 1\n'
        + DESIGN.format(deformation='deformation = "none"\n')
        + f'{describe_parameters(SYMBOLS)}[poses]\nsampling = "uniform"\ncount = {n_poses}\nrange_mm = 10.0\n'
    )
    return path


def write_selection(folder: Path, n_candidates: int) -> Path:
    """Write a selection of poses; return its config."""
    (folder / "machine.toml").write_text(describe_machine(6))
    path = folder / "selection.toml"
    path.write_text(
        'kind = "selection"\nname = "growth"\ntitle = "Growth"\nseed = 1\n'
        'provenance = { status = "simulated", text = "for a benchmark" }\n'
        + DESIGN.format(deformation="")
        .replace("[workspace]", "[workspace]\nposes = 50")
        .replace("[[variants]]", '[variant]\nsensors = ["tracker"]')
        + f'{describe_parameters(SYMBOLS)}[domain]\nkind = "workspace"\nposition_mm = [40.0, 40.0, 40.0]\n'
        f"rotation_deg = [1.0, 1.0, 1.0]\n[candidates]\ncount = {n_candidates}\n[[selections]]\n"
        'method = "exchange"\ncriteria = ["O1", "I"]\nn_poses = [12]\n'
    )
    return path


def write_project(folder: Path, machine: str, n_rows: int) -> Path:
    """Write the project of `bayescal init` with so many rows, simulated; return the config of its study."""
    import memory

    from bayescal.projects.start import start_project

    start_project(folder, machine, None if machine == "own" else "poses")
    n_held, simulation = n_rows // 10, folder / "simulate.toml"
    if machine == "own":
        text = simulation.read_text().replace("\nn_poses = 25", f"\nn_poses = {n_rows - n_held}")
        simulation.write_text(text.replace("n_verification_poses = 5", f"n_verification_poses = {n_held}"))
    else:
        rng, columns = np.random.default_rng(n_rows), ",".join(f"drho_{k}" for k in range(1, 7))
        for use, n in (("calibration", n_rows - n_held), ("verification", n_held)):
            rows = [",".join(f"{x:.3f}" for x in row) for row in rng.uniform(-15.0, 15.0, size=(n, 6))]
            (folder / f"{use}_configurations.csv").write_text("\n".join([columns, *rows]) + "\n")
    shutil.rmtree(folder / "data")
    memory.simulate(simulation, folder / "data")
    return folder / "study.toml"


def write_own_machine(folder: Path, n_rows: int, n_variants: int) -> Path:
    """Write the study of the example's machine with so many rows, a tenth of them held back, and variants."""
    import memory

    for name in ("machine.toml", "linear_delta.py"):
        shutil.copy(OWN_MACHINE / name, folder)
    simulation, n_held = (OWN_MACHINE / "simulate.toml").read_text(), n_rows // 10
    simulation = simulation.replace("\nn_poses = 25", f"\nn_poses = {n_rows - n_held}")
    simulation = simulation.replace("n_verification_poses = 5", f"n_verification_poses = {n_held}")
    (folder / "simulate.toml").write_text(simulation)
    memory.simulate(folder / "simulate.toml", folder / "data")
    names = [*(f"{symbol}[{k}]" for symbol in ("x", "y", "l", "s0") for k in (1, 2, 3)), "t_x", "t_y"]
    fixed = [one for count in range(3) for one in combinations(names, count)][:n_variants]
    assert len(fixed) == n_variants
    variants = [f'[[variants]]\nname = "v{k}"\nfixed = {json.dumps(one)}\n' for k, one in enumerate(fixed)]
    path, study = folder / "study.toml", (OWN_MACHINE / "study.toml").read_text()
    path.write_text(study.partition("\n[[variants]]")[0] + "\n" + "\n".join(variants) + EFFORT)
    return path


def write_wires(folder: Path, n_channels: int) -> Path:
    """Write the study of a point that so many wires measure."""
    import memory

    (folder / "wires.py").write_text(WIRES)
    machine = f'kind = "wires.py:Wires"\nname = "wires"\ntitle = "Wires"\n[machine]\nwires = {n_channels}\n'
    (folder / "machine.toml").write_text(machine)
    head = f'name = "wires"\ntitle = "Wires"\nseed = 1\n{OF_WIRES}'
    simulation = 'kind = "simulation"\nn_poses = 36\nn_verification_poses = 4\n'
    (folder / "simulate.toml").write_text(simulation + head)
    memory.simulate(folder / "simulate.toml", folder / "data")
    path = folder / "study.toml"
    data = '[[data]]\nfile = "data/readings.csv"\n\n[[variants]]\nname = "all"\n'
    path.write_text(f'kind = "study"\n{head}\n{data}{EFFORT}')
    return path


def write_point(folder: Path, what: str, size: int) -> Path:
    """Write the experiment of one point; return its config."""
    import memory  # which has machines of this file for other kinds

    if what in ("hexapod", "own"):
        return write_project(folder / "project", what, size)
    if what == "poses":
        return write_study(folder, 6, size, SYMBOLS)
    if what == "audit":
        return write_audit(folder, size)
    if what == "calibration":
        return memory.write_calibration(folder, size, SAMPLING)
    if what == "sliding_platform":
        return memory.write_sliding_platform(folder, size, SAMPLING)
    if what == "rows":
        return write_own_machine(folder, size, 1)
    if what == "variants":
        return write_own_machine(folder, 28, size)
    if what == "channels":
        return write_wires(folder, size)
    if what == "legs":
        return write_study(folder, size, 40, SYMBOLS[:3])
    if what == "parameters":
        n_legs = 50 if size >= 50 else size
        return write_study(folder, n_legs, 80, SYMBOLS[: max(1, size // n_legs)])
    return write_selection(folder, size)


def measure(what: str, size: int, limit: float) -> dict[str, float | str]:
    """Return CPU seconds and MiB of one point, in a process of its own; what it said where it failed."""
    with tempfile.TemporaryDirectory() as name:
        path = write_point(Path(name), what, size)
        programs = {("cpu_s", "before_mib", "peak_mib"): RUN}
        if what in ("hexapod", "own"):
            programs |= {("said_s", "said_mib"): SAY, ("validate_s", "validate_mib"): VALIDATE}
        found: dict[str, float | str] = {"size": size}
        for names, program in programs.items():
            command = [sys.executable, "-c", program, str(path), str(Path(name) / "out")]
            try:
                done = subprocess.run(command, capture_output=True, text=True, timeout=limit, check=False)
            except subprocess.TimeoutExpired:
                return {"size": size, "failed": f"more than {limit:.0f} s"}
            if done.returncode:
                return {"size": size, "failed": (done.stderr.strip().splitlines() or [f"exit {done.returncode}"])[-1]}
            found |= dict(zip(names, map(float, done.stdout.split()[-len(names) :]), strict=True))
    return found | {"own_mib": float(found["peak_mib"]) - float(found.pop("before_mib"))}


def fit_exponents(points: list[dict]) -> dict[str, float]:
    """Return the slopes of log time and log memory over log size, over all points and between the last two."""
    good = [point for point in points if "failed" not in point]
    if len(good) < 2:
        return {}
    size = np.log([point["size"] for point in good])
    found = {}
    for key in ("cpu_s", "own_mib"):
        value = np.log([max(point[key], 1e-3) for point in good])
        found[f"{key}_all"] = float(np.polyfit(size, value, 1)[0])
        found[f"{key}_last"] = float((value[-1] - value[-2]) / (size[-1] - size[-2]))
    return found


def draw(figures: dict[str, dict], path: Path) -> None:
    """Draw seconds and memory by what whole studies have more of, log over log."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 2)
    for axis, key, label in zip(axes, ("cpu_s", "own_mib"), ("CPU, s", "memory beyond the process, MiB"), strict=True):
        for what, marker in zip(PICTURED, "os^D", strict=True):
            points = [one for one in figures.get(what, {}).get("points", []) if "failed" not in one]
            if points:
                power = f"{what}, power {figures[what][f'{key}_last']:.1f}" if len(points) > 1 else what
                axis.loglog([one["size"] for one in points], [one[key] for one in points], marker=marker, label=power)
        axis.set(xlabel="number", ylabel=label)
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8)
    figure.savefig(path, dpi=90)


def main() -> None:
    """Measure, print a table, and keep it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--what", nargs="+", choices=SIZES, default=list(SIZES))
    parser.add_argument("--least", type=int, default=0)
    parser.add_argument("--most", type=int, default=200_000, help="largest size")
    parser.add_argument("--limit", type=float, default=600.0, help="seconds for one point")
    parser.add_argument("--write", type=Path, help="JSON file for the figures; what stands there of others is kept")
    parser.add_argument("--picture", type=Path, help="PNG of rows, parameters, channels and variants")
    options = parser.parse_args()
    figures: dict[str, dict] = {}
    for what in options.what:
        points = []
        print(f"{what:>12}{'CPU s':>9}{'MiB':>8}{'own':>8}")
        for size in (s for s in SIZES[what] if options.least <= s <= options.most):
            points.append(point := measure(what, size, options.limit))
            said = point.get("failed") or f"{point['cpu_s']:9.1f}{point['peak_mib']:8.0f}{point['own_mib']:8.0f}"
            more = ", ".join(f"{name} {value:.1f}" for name, value in point.items() if name.startswith(("said", "val")))
            print(f"{size:12d}{said}  {more}", flush=True)
        exponents = fit_exponents(points)
        print("   exponents: " + ", ".join(f"{name} {value:.2f}" for name, value in exponents.items()))
        figures[what] = {"points": points, **exponents}
        if options.write is not None:
            known = json.loads(options.write.read_text()) if options.write.exists() else {}
            figures = known | figures
            options.write.write_text(json.dumps(figures, indent=1) + "\n")
    if options.picture is not None:
        draw(figures, options.picture)


if __name__ == "__main__":
    main()
