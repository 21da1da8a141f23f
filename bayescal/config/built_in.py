"""Names of the package's own classes that a config can use, and what each is: known without importing them.

`bayescal list` and the schemas for editors need no more, and importing every class takes seconds.
"""

import ast
from functools import cache
from pathlib import Path
from typing import Final

PACKAGE = Path(__file__).parents[1]

BUILT_IN: Final[dict[str, dict[str, str]]] = {
    "KINDS": {
        "audit": "bayescal.experiments.audit.kind:Audit",
        "selection": "bayescal.experiments.selection.kind:Selection",
        "selftest": "bayescal.experiments.selftest.kind:Selftest",
        "sessions": "bayescal.experiments.sessions.kind:Sessions",
        "simulation": "bayescal.experiments.simulation.kind:Simulation",
        "study": "bayescal.experiments.study.kind:Study",
        "sweep": "bayescal.experiments.sweep.kind:Sweep",
        "table": "bayescal.experiments.table.kind:LookUpTable",
    },
    "BLOCKS": {},
    "CLAIMS": {},
    "MACHINES": {
        "arm": "bayescal.machines.readings.arm:Arm",
        "delta": "bayescal.machines.readings.delta:DeltaMachine",
        "five_bar": "bayescal.machines.readings.five_bar:FiveBar",
        "line_machine": "bayescal.machines.readings.line_machine:LineMachine",
        "mount": "bayescal.machines.readings.mount:Mount",
        "rotary_delta": "bayescal.machines.readings.rotary_delta:RotaryDelta",
        "sliding_platform": "bayescal.machines.readings.sliding_platform:SlidingPlatform",
        "strut_machine": "bayescal.machines.readings.strut_machine:StrutMachine",
    },
    "INSTRUMENTS": {
        "camera": "bayescal.machines.readings.camera:CameraInstrument",
        "distance": "bayescal.machines.readings.points:DistanceInstrument",
        "plane": "bayescal.machines.readings.planes:PlaneInstrument",
        "point": "bayescal.machines.readings.points:PointInstrument",
        "pose": "bayescal.machines.readings.points:PoseInstrument",
        "socket": "bayescal.machines.readings.sockets:SocketInstrument",
    },
    "READERS": {},
    "MODELS": {
        "beam": "bayescal.machines.models.beam:Beam",
        "jacobian": "bayescal.machines.models.jacobian:Jacobian",
        "six_pus": "bayescal.machines.models.six_pus:SixPus",
        "six_ups": "bayescal.machines.models.six_ups:SixUps",
        "stiffness": "bayescal.machines.models.stiffness:Stiffness",
        "stiffness_fixed": "bayescal.machines.models.stiffness:FixedStiffness",
    },
    "DEFORMATIONS": {
        "free_matrix": "bayescal.machines.deformations:FreeMatrixDeformation",
        "linear": "bayescal.machines.deformations:LinearDeformation",
        "matrix": "bayescal.machines.deformations:MatrixDeformation",
        "none": "bayescal.machines.deformations:NoDeformation",
    },
    "ERRORS": {
        "function": "bayescal.density.calibration.functions:FunctionErrors",
    },
    "SAMPLERS": {
        "emcee": "bayescal.inference.samplers:EmceeSampler",
        "nautilus": "bayescal.inference.nautilus:NautilusSampler",
        "smc": "bayescal.inference.samplers:TemperingSampler",
    },
    "SENSORS": {
        "pose": "bayescal.machines.sensors:PoseSensor",
        "targets": "bayescal.machines.sensors:PointSensor",
    },
    "CRITERIA": {
        "A": "bayescal.pose_selection.criteria.trace:AOptimality",
        "D": "bayescal.pose_selection.criteria.log_det:DOptimality",
        "I": "bayescal.pose_selection.criteria.trace:IOptimality",
        "O1": "bayescal.pose_selection.criteria.log_det:O1",
        "O2": "bayescal.pose_selection.criteria.spectral:O2",
        "O3": "bayescal.pose_selection.criteria.spectral:O3",
        "O4": "bayescal.pose_selection.criteria.spectral:O4",
        "O5": "bayescal.pose_selection.criteria.spectral:O5",
    },
    "METHODS": {
        "continuous": "bayescal.pose_selection.methods:Continuous",
        "exchange": "bayescal.pose_selection.methods:Exchange",
        "random": "bayescal.pose_selection.methods:RandomSets",
    },
}
"""``module:Class`` by name, for each registry."""


def describe_built_in(what: str, name: str) -> str:
    """Return the first paragraph of a built-in class's docstring, as its source has it."""
    module, _, found = BUILT_IN[what][name].partition(":")
    return " ".join(_read_docstrings(module)[found].partition("\n\n")[0].split())


@cache
def _read_docstrings(module: str) -> dict[str, str]:
    """Return the docstrings of a module's classes by name."""
    source = PACKAGE.joinpath(*module.split(".")[1:]).with_suffix(".py").read_text(encoding="utf-8")
    return {one.name: ast.get_docstring(one) or "" for one in ast.parse(source).body if isinstance(one, ast.ClassDef)}
