"""What a user writes, for type checkers: a machine of one's own, every public call, what is read of results."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

import bayescal as bc
from bayescal.density.calibration.measurements import Measurements
from bayescal.density.priors import HalfNormalPrior

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

    names, units, priors = ("vibration",), ("mm",), (HalfNormalPrior(0.01),)

    def variance(self, zeta: Array, data: Measurements) -> Array:
        """Return its variance."""
        return np.broadcast_to(self.natural(zeta)[:, :, None] ** 2, (len(zeta), *data.sd.shape))


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
