#!/bin/sh
# Every use of a calibrated machine of a user-defined class, from readings to files for a controller:
#
#     sh uses.sh
#
# Results keep the machine: what follows the run needs the folder `results` alone.
set -e

# The class is code: read linear_delta.py first. It is run until it changes, from here and as the results keep it.
bayescal trust .

# Is the calibration sound? Few simulated data sets find the usual faults; without --data-sets it takes more, and longer.
bayescal selftest study.toml --variant one_rod --data-sets 8 --out results/selftest --workers 1

# Calibrate, then write the report again from the results alone.
bayescal run study.toml --out results/study --workers 1
bayescal report results/study

# Where is the tool at these carriages, and which carriages hold it there? Both with their uncertainty.
bayescal predict results/study commands.csv --out results/poses.csv
bayescal compensate results/study results/poses.csv --out results/commands.csv

# How well is the tool known over the workspace, and where does the uncertainty come from?
bayescal certificate results/study --poses 64 --out results/certificate.html

# Which few readings show later whether the calibration still holds? Which pose should be measured next?
bayescal verify results/study --out results/plan.csv
bayescal next-pose next_pose.toml --out results/next_pose --workers 1

# The machine for the next tool: parameters with their covariance, as TOML, JSON and CSV; every command takes it again.
bayescal export results/study --out results/machine
bayescal predict results/machine commands.csv --out results/poses_again.csv
