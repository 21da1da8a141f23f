"""A scheduler here and as many SLURM jobs with workers as there is work, between two limits (dask-jobqueue).

    pip install 'bayescal[dask]' dask-jobqueue
    python examples/deployment/slurm_jobqueue.py --queue compute --least 2 --most 64 &
    bayescal run experiments/audit/m2_hexapod_tracker.toml --dask-scheduler scheduler.json

It serves until it is interrupted; workers whose jobs end are replaced, and their tasks repeated.
"""

from __future__ import annotations

import argparse
import json
import signal
from pathlib import Path

from dask_jobqueue import SLURMCluster

THREADS = ["export OMP_NUM_THREADS=1", "export OPENBLAS_NUM_THREADS=1", "export MKL_NUM_THREADS=1"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--queue", required=True)
    parser.add_argument("--account")
    parser.add_argument("--walltime", default="02:00:00")
    parser.add_argument("--memory", default="2GB", help="of each worker")
    parser.add_argument("--interface", help="network that nodes and this machine share, such as ib0")
    parser.add_argument("--least", type=int, default=1)
    parser.add_argument("--most", type=int, default=32)
    parser.add_argument("--file", type=Path, default=Path("scheduler.json"))
    options = parser.parse_args()
    cluster = SLURMCluster(
        queue=options.queue,
        account=options.account,
        walltime=options.walltime,
        cores=1,
        processes=1,
        memory=options.memory,
        interface=options.interface,
        job_script_prologue=THREADS,
    )
    cluster.adapt(minimum_jobs=options.least, maximum_jobs=options.most)
    options.file.write_text(json.dumps({"address": cluster.scheduler_address}) + "\n")
    try:
        signal.pause()
    finally:
        options.file.unlink(missing_ok=True)
        cluster.close()


if __name__ == "__main__":
    main()
