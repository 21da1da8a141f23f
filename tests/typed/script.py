"""What a user writes, for type checkers: a machine of one's own, every public call, what is read of results."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

import bayescal as bc
import bayescal.extend as bx

type Array = npt.NDArray[np.float64]


class ArmConfig(bc.Section):
    """What its file says."""

    length_mm: float = 100.0


class Arm(bc.ReadingMachine):
    """One link seen by a tracker."""

    Config = ArmConfig
    member = "link"

    def __init__(self, config: ArmConfig) -> None:
        self.parameters = [bc.ParameterBlock("l", (config.length_mm,)), bc.ParameterBlock("q0", (0.0,), "rad")]
        self.coordinates = [bc.Coordinate("q", "rad", -1.0, 1.0)]
        self.tool_channels = [bc.Channel("x", "mm"), bc.Channel("y", "mm")]
        self.channels = [bc.Channel("q", "rad"), bc.Channel("x", "mm", external=True)]

    def read(self, parameters: Mapping[str, Array], v: Array, given: Mapping[str, Array]) -> Array:
        """Return the joint's angle, and where the link's end is."""
        del given
        q = v[..., 0]
        return np.stack(np.broadcast_arrays(q - parameters["q0"][..., 0], parameters["l"][..., 0] * np.cos(q)), axis=-1)


class Logger(bc.TableReader):
    """A logger that separates by semicolons."""

    def read(self, path: Path) -> pd.DataFrame:
        """Return its readings."""
        return pd.read_csv(path, sep=";")


class Gauge(bc.Instrument):
    """A dial gauge that reads the height of the tool above a plate."""

    parameters = (bc.ParameterBlock("plate", (0.0,), per_leg=False),)
    channels = (bc.Channel("", "mm"),)

    def see(self, parameters: Mapping[str, Array], position: Array, rotation: Array) -> Array:
        """Return the height."""
        del rotation
        height: Array = position[..., 2:] - parameters["plate"]
        return height


class Vibration(bc.ErrorTerm):
    """Noise that all channels have beside what is stated."""

    names, units, priors = ("vibration",), ("mm",), (bx.HalfNormalPrior(0.01),)

    def variance(self, zeta: Array, data: bx.Measurements) -> Array:
        """Return its variance."""
        return np.broadcast_to(self.natural(zeta)[:, :, None] ** 2, (len(zeta), *data.sd.shape))


class GaugeBlock(bx.Sensor):
    """What sees the height of the platform alone."""

    def __init__(self, config: bc.Section) -> None:
        del config

    def information(self, position: Array, rotation: Array) -> Array:
        """Return the information on each pose."""
        del rotation
        return np.broadcast_to(np.diag([0.0, 0.0, 1e4, 0.0, 0.0, 0.0]), (len(position), 6, 6)).copy()


class First(bx.SelectionMethod):
    """The first candidates."""

    name, title, source = "first", "The first candidates", "Nobody"

    def __init__(self, config: bc.Section) -> None:
        del config

    def select(self, problem: Any, rng: np.random.Generator) -> Any:
        """Return the first of all."""
        del rng
        return self._from_candidates(problem, np.arange(problem.n), [0.0], 1, "nothing to search")


class Prior(bx.Sampler):
    """Draws of the prior."""

    def sample(self, task: Any) -> bx.SamplingResult:
        """Return them as two runs."""
        rng = np.random.default_rng(task.seed)
        return bx.SamplingResult(task.collect(np.stack([task.draw_prior(500, rng) for _ in range(2)])))


class Lengths(bx.PageBlock):
    """What the lengths are."""

    def show(self, results: bx.Results) -> Any:
        """Return a section of the page."""
        columns = [bx.Column("Link", kind="name"), bx.Column("sd", "mm")]
        rows = [
            [str(row["parameter"]), bx.format_significant(row["sd"])]
            for row in results.table("parameters").to_dict("records")
        ]
        said = f"{bx.format_estimate(1.0, 0.1)}, {bx.format_fixed(1.0, 1)}"
        return bx.make_section("Lengths", (said,), (bx.make_table("Lengths.", columns, rows),))


class HeightsConfig(bx.ExperimentConfig):
    """A table of heights."""

    heights: bx.InputFile


class Heights(bx.Experiment[HeightsConfig, Array]):
    """The mean of heights."""

    schema = HeightsConfig

    def read(self, config: HeightsConfig, folder: Path) -> Array:
        """Return the heights."""
        return bx.read_table(folder / config.heights, ("z_mm",)).numbers(("z_mm",))

    def compute(self, inputs: Array, run: Any) -> bx.Results:
        """Return their mean."""
        del run
        return bx.Results({"mean": float(inputs.mean())})

    def page(self, results: bx.Results) -> bx.Page:
        """Return the page."""
        return bx.Page("Heights", "heights", "Heights", "", str(results.summary["mean"]), (), ())


PRIORS = (bx.NormalPrior(0.0, 1.0), bx.UniformPrior(0.0, 1.0))
MADE: tuple[type, ...] = (bx.KinematicModel, bx.Deformation, bx.Criterion)


def calibrate(folder: Path) -> pd.DataFrame:
    """Calibrate, and use the machine as calibrated."""
    machine = bc.load_machine(Arm(ArmConfig(length_mm=99.0)))
    nominal: pd.DataFrame = machine.parameters
    seen: pd.DataFrame = machine.read([[0.1], [0.2]])
    noise, tolerances = {"q": 1e-4, "x": 0.01}, {"l": 0.5, "q0": [0.1]}
    data: bc.Data = bc.simulate(Arm, noise, tolerances, n_poses=12, seed=2)
    measured = bc.Data(pd.concat([data.table, seen]), noise, ["q"], verification_poses=["C001"])
    plan = bc.audit(machine, noise, tolerances, 20, requirements={"x": 0.05}, quiet=True)
    plan.page(folder / "audit.html")
    study: bc.StudyResult = bc.calibrate(machine, measured, tolerances, variants={"all": {"title": "All"}}, workers=2)
    best: bc.VariantResult = study.best
    question: bc.LoadedResults = bc.next_pose(study, {"x": 0.04}, 50)
    said: str = question.to_toml()
    draws: Array = study.posterior("all")["posterior"]["l[1]"].to_numpy()
    calibrated: bc.CalibratedMachine = best.machine
    commands: pd.DataFrame = best.compensate({"x_mm": [1.0], "y_mm": [2.0]})
    written: list[Path] = best.export(folder / "machine")
    found = bc.predict_poses(calibrated, np.zeros((1, 1)), {})
    held = bc.compensate_poses(calibrated, np.zeros((1, 2)))
    print(
        held,
        nominal,
        best.predict(commands),
        best.tool_accuracy(0.95),
        written,
        found,
        draws.mean(),
        said,
        plan.findings,
    )
    return study.ranking


def reuse(folder: Path) -> str:
    """Take results up again; return a fault in words."""
    try:
        bc.trust(folder)
        config = bc.load_experiment(folder / "study.toml")
        results: bc.LoadedResults = bc.run_experiment(config, folder / "out", folder=folder, quiet=True)
        again = bc.load_results(results.folder, trust=True)
        if isinstance(again, bc.StudyResult):
            print(again.parameters[["mean", "sd"]], again.predictions, again.variants, again["all"].take_mode(1))
        bc.export_machine(bc.load_calibrated(folder / "out"), folder / "machine")
    except bc.InputError as error:
        return "\n".join(error.lines)
    except bc.NumericalError as error:
        return f"not computed: {error}"
    except bc.BayescalError as error:
        return str(error.exit_code)
    return ""
