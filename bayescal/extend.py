"""What user-defined classes derive from and are made of, in one place; see `docs/howto/own_classes.md`."""

from bayescal.config.sections import ExperimentConfig, InputFile, Section
from bayescal.data.reader import TableReader
from bayescal.density.calibration.measurements import Measurements
from bayescal.density.calibration.terms import ErrorTerm
from bayescal.density.priors import HalfNormalPrior, NormalPrior, UniformPrior
from bayescal.experiments.runner.blocks import PageBlock
from bayescal.experiments.runner.experiment import Experiment
from bayescal.experiments.runner.results import Results
from bayescal.files.csv_tables import read_table
from bayescal.inference.samplers import Sampler, SamplingResult
from bayescal.machines.deformations import Deformation
from bayescal.machines.models import KinematicModel
from bayescal.machines.parameters import ParameterBlock
from bayescal.machines.readings import Channel, Coordinate, Instrument, ReadingMachine
from bayescal.machines.sensors import Sensor
from bayescal.pose_selection import Criterion, SelectionMethod
from bayescal.report.blocks import Column, Page, make_section, make_table
from bayescal.report.numbers import format_estimate, format_fixed, format_significant

__all__ = [
    "Channel",
    "Column",
    "Coordinate",
    "Criterion",
    "Deformation",
    "ErrorTerm",
    "Experiment",
    "ExperimentConfig",
    "HalfNormalPrior",
    "InputFile",
    "Instrument",
    "KinematicModel",
    "Measurements",
    "NormalPrior",
    "Page",
    "PageBlock",
    "ParameterBlock",
    "ReadingMachine",
    "Results",
    "Sampler",
    "SamplingResult",
    "Section",
    "SelectionMethod",
    "Sensor",
    "TableReader",
    "UniformPrior",
    "format_estimate",
    "format_fixed",
    "format_significant",
    "make_section",
    "make_table",
    "read_table",
]
