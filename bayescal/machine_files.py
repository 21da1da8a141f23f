"""A machine in Python: its TOML file, or a class that a user wrote, with the files that a run needs of it."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from bayescal.config.load import read_toml
from bayescal.config.local_imports import find_local_imports
from bayescal.config.sections import Section
from bayescal.config.trust import vouch
from bayescal.errors import InputError
from bayescal.files.memory import MemoryPath
from bayescal.files.toml import write_toml
from bayescal.importers.xacro_files import SUFFIX, expand, name_urdf
from bayescal.machines.chains import name_arm
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.read import keep_machines, load_mechanism, read_reading_model
from bayescal.machines.readings import Channel, ReadingMachine, ReadingModel
from bayescal.machines.readings.legs import list_leg_channels

if TYPE_CHECKING:
    import pandas as pd  # tables need it, naming things does not

MACHINE = "machine.toml"

type AnyMachine = Path | str | ReadingMachine | type[ReadingMachine] | MachineFiles


@dataclass(frozen=True, eq=False, repr=False)
class MachineFiles:
    """A machine with the files that it is read from, by their names in one folder; see `load_machine`.

    ``seen`` is what it reads; None of a mechanism's file, whose parameters depend on a model.
    """

    files: dict[str, bytes]
    entry: str  # the machine's own file
    seen: ReadingModel | None
    mechanism: Mechanism | None = None

    @property
    def model(self) -> ReadingModel:
        """The machine by its channels; InputError for a mechanism's file, which has none by itself."""
        if self.seen is None:
            raise InputError(f"{self.entry}: found a mechanism, expected kind = 'legs'")
        return self.seen

    @property
    def channels(self) -> Sequence[Channel]:
        """Its channels; of a mechanism's file those of its legs, whatever model they are seen by."""
        legs = self.mechanism
        return self.model.channels if legs is None else list_leg_channels(legs.n_legs, inclined=True)

    @property
    def name(self) -> str:
        """Its name."""
        return str(getattr(self.seen or self.mechanism, "name", self.entry))

    @property
    def parameters(self) -> pd.DataFrame:
        """Nominal values of its parameters, with their units."""
        import pandas as pd

        layout = self.model.layout
        return pd.DataFrame({"parameter": layout.names, "nominal": layout.nominal, "unit": layout.units})

    def read(self, pose: ArrayLike, parameters: ArrayLike | None = None, **given: ArrayLike) -> pd.DataFrame:
        """Return what its channels read at poses (P, q), of the nominal machine or of parameters (D,).

        What a class's `given` names is stated by keywords, a number or one for each pose.
        """
        import pandas as pd

        pose = np.atleast_2d(np.asarray(pose, dtype=np.float64))
        theta = self.model.layout.nominal if parameters is None else np.asarray(parameters, dtype=np.float64)
        known = {name: np.broadcast_to(np.asarray(value, np.float64), len(pose)) for name, value in given.items()}
        columns = [f"{one.stem}_{one.unit}" for one in self.model.channels]
        return pd.DataFrame(self.model.read(theta, pose, known), columns=columns)

    def __repr__(self) -> str:
        if self.mechanism is not None:
            return f"mechanism {self.name!r}: {self.mechanism.n_legs} legs"
        model = self.model
        tool = ", ".join(one.name for one in model.tool_channels) if model.states_tool else "not stated"
        return (
            f"machine {self.name!r}: {model.layout.size} parameters ({', '.join(model.layout.symbols)}), "
            f"channels {', '.join(model.names)}, coordinates {', '.join(one.name for one in model.coordinates)}, "
            f"tool {tool}"
        )


def load_machine(
    machine: AnyMachine, *, base: str = "", tip: str = "", arguments: Mapping[str, str] | None = None
) -> MachineFiles:
    """Return a machine: of its TOML file, of an arm's URDF or xacro file, or of a user's class, or an instance of it.

    ``base`` and ``tip`` are links of a URDF file; by default its root and its only leaf. ``arguments`` are those of a
    xacro file, which `xacrodoc` expands once its user has trusted it.

    Raises
    ------
    InputError
        For anything wrong with the file or the class, and for code that a file names and nobody has trusted (`trust`).

    Examples
    --------
    >>> import bayescal as bc
    >>> machine = bc.load_machine("examples/own_machine/machine.toml")
    >>> machine
    machine 'delta': 14 parameters (x, y, l, s0, t_x, t_y), channels s[1], s[2], s[3], cam_x, cam_y, height,
    coordinates x, y, z, tool x, y, z
    >>> machine.read([0.0, 0.0, 30.0]).round(3)
       s_1_mm  s_2_mm  s_3_mm  cam_x_mm  cam_y_mm  height_mm
    ...
    """
    if isinstance(machine, MachineFiles):
        return machine
    if (base or tip) and not _is_urdf(machine):
        raise InputError(f"{machine}: found base or tip, expected them with a URDF file alone")
    if arguments and not str(machine).lower().endswith(SUFFIX):
        raise InputError(f"{machine}: found arguments, expected them with a xacro file alone")
    if _is_urdf(machine):
        path = Path(machine)  # type: ignore[arg-type]
        try:
            files = {path.name: path.read_bytes()}
            if path.suffix.lower() == SUFFIX:
                expanded = expand(path, arguments or {})
                path = path.with_name(name_urdf(path))
                files = {path.name: expanded}
        except OSError as error:
            raise InputError(f"{path}: {error.strerror}, expected a URDF file") from error
        named = {key: value for key, value in (("base", base), ("tip", tip)) if value}
        name = name_arm(path)
        arm = {"kind": "arm", "name": name, "title": name, "machine": {"urdf": path.name, **named}}
        files[MACHINE] = write_toml(arm).encode()
        return MachineFiles(files, MACHINE, read_reading_model(MemoryPath(MACHINE, files=files)))
    if isinstance(machine, str | Path):
        path = Path(machine)
        legs = isinstance(read_toml(path)[0].get("legs"), dict)
        seen = (None, load_mechanism(path)) if legs else (read_reading_model(path), None)
        files, names = keep_machines([path])
        return MachineFiles(files, names[path], *seen)
    found = machine if isinstance(machine, type) else type(machine)
    config = getattr(machine, "config", None)
    section = config.model_dump(exclude_none=True) if isinstance(config, Section) else {}
    module, files = _list_sources(found)
    content = {"kind": f"{module}:{found.__qualname__}", "name": found.__name__.lower(), "title": found.__name__}
    files[MACHINE] = write_toml(content | ({"machine": section} if section else {})).encode()
    vouch(files.values())  # whoever has the class has run its code
    return MachineFiles(files, MACHINE, read_reading_model(MemoryPath(MACHINE, files=files)))


def _is_urdf(machine: AnyMachine) -> bool:
    return isinstance(machine, str | Path) and Path(machine).suffix.lower() in (".urdf", SUFFIX)


def _list_sources(found: type) -> tuple[str, dict[str, bytes]]:
    """Return the name of the file that a class stands in, and that with the files it imports from beside itself."""
    try:
        path = Path(inspect.getsourcefile(found) or "")
    except (OSError, TypeError):
        path = Path()
    if not path.is_file():
        raise InputError(f"class {found.__name__}: found no file, expected a class imported from one")
    name, content = path.name, path.read_bytes()
    if found.__module__ == "__main__":  # a script is not run again for the sake of a class
        name, content = f"{path.stem}.py", _extract(content.decode(), found.__name__).encode()
    return name, {name: content} | {one.name: one.read_bytes() for one in find_local_imports(path).values()}


def _extract(source: str, name: str) -> str:
    """Return the definition of a class with what it uses of its module, and all imports."""
    tree = ast.parse(source)
    defined: dict[str, ast.stmt] = {}
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            defined[node.name] = node
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        for target in (one for whole in targets if whole is not None for one in ast.walk(whole)):
            if isinstance(target, ast.Name):
                defined[target.id] = node
    wanted, waiting = set(), [name]
    while waiting:
        one = waiting.pop()
        if one in defined and one not in wanted:
            wanted.add(one)
            waiting += [node.id for node in ast.walk(defined[one]) if isinstance(node, ast.Name)]
    kept = {id(defined[one]) for one in wanted}
    body = [n for n in tree.body if isinstance(n, ast.Import | ast.ImportFrom) or id(n) in kept]
    return "\n\n".join(ast.unparse(node) for node in body) + "\n"
