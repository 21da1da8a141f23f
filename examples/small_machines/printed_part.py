"""Scales and skews of a printer's axes, from distances on a printed part: bayescal trust ., python printed_part.py."""

import numpy as np

import bayescal as bc

NOISE = {"axis": 0.001, "distance": 0.02}  # mm: of steps, and of a caliper
TOLERANCES = {"gain": 0.005, "skew_xy": 0.3, "skew_xz": 0.3, "skew_yz": 0.3}  # 1 and degrees


class Printer(bc.ReadingMachine):
    """Axes that are too long by a share, and that lean: y to x, z to x and to y."""

    member = "axis"
    parameters = [
        bc.ParameterBlock("gain", (0.0,) * 3, "1"),
        *(bc.ParameterBlock(f"skew_{pair}", (0.0,), "rad", per_leg=False) for pair in ("xy", "xz", "yz")),
    ]
    coordinates = [bc.Coordinate(axis, "mm", 100.0, 100.0) for axis in "xyz"]
    tool_channels = [bc.Channel(axis, "mm") for axis in "xyz"]
    channels = [bc.Channel(f"axis[{k}]", "mm") for k in (1, 2, 3)]

    def read(self, parameters, v, given):
        """Return what the axes are sent to where the part has v."""
        x, y, z = v[..., 0], v[..., 1], v[..., 2]
        y = y - parameters["skew_yz"] * z
        x = x - parameters["skew_xy"] * y - parameters["skew_xz"] * z
        return np.stack(np.broadcast_arrays(x, y, z), axis=-1) / (1.0 + parameters["gain"])


if __name__ == "__main__":
    machine = bc.load_machine("machine.toml")
    data = bc.simulate(machine, NOISE, TOLERANCES, n_poses=40)
    study = bc.calibrate(machine, data, TOLERANCES)
    print(study.best.parameters.merge(data.truth[["parameter", "true"]])[["parameter", "true", "mean", "sd"]])
    study.best.export("corrections", "grid")  # a table of corrections for the slicer or the firmware
