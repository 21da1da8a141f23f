"""Whether there is memory for an experiment: an estimate from its sizes, refused before anything is computed.

A process that asks for more than there is gets killed, often with others beside it, and says nothing. What a kind of
experiment will hold at once it estimates itself (`Experiment.estimate_memory`); what there is, is asked here.
"""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from bayescal.errors import InputError
from bayescal.report.numbers import join_words

DOUBLE = 8.0  # bytes
READING = 15.0
"""Bytes that a table's text, its cells and their numbers take for each byte of its file, as measured."""
GIB = 2.0**30
PROCESS = 0.25 * GIB
"""What Python and the libraries take in every process."""
CGROUPS = (
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.stat", "/sys/fs/cgroup/memory.current"),
    (
        "/sys/fs/cgroup/memory/memory.limit_in_bytes",
        "/sys/fs/cgroup/memory/memory.stat",
        "/sys/fs/cgroup/memory/memory.usage_in_bytes",
    ),
)
"""Limit, what could be given back, and use of a container's memory, versions 2 and 1."""


@dataclass(frozen=True)
class MemoryEstimate:
    """What an experiment will hold at once, beside Python and the libraries."""

    shared: float = 0.0  # bytes in the process that collects the results
    each: float = 0.0  # bytes in every process that computes
    sizes: str = ""  # what it comes from, such as "10000 poses, 42 parameters"
    remedy: str = ""  # what would take less

    def sum_up(self, workers: int) -> float:
        """Return the bytes of all processes, the first of which computes itself where it is alone."""
        collecting = PROCESS if workers > 1 else 0.0
        return self.shared + collecting + workers * (self.each + PROCESS)

    def describe(self, workers: int) -> str:
        """Return what there is and what it takes, in words."""
        by = f" with {workers} workers" if workers > 1 else ""
        return f"{self.sizes}, which take about {self.sum_up(workers) / GIB:.1f} GiB{by}"


def estimate_arrays(
    counts: Mapping[str, int],
    held: Iterable[Sequence[float]],
    remedy: str,
    kept: Iterable[Sequence[float]] = (),
) -> MemoryEstimate:
    """Return the need of an experiment from the sizes of its arrays of doubles.

    ``counts``: what there is many of, in words, and how many; ``held``: of arrays that every process has, how many
    alike, then their shape; ``kept``: the same of the process that collects the results; ``remedy``: what would take
    less.
    """
    sizes = join_words([f"{number} {what}" for what, number in counts.items()])
    return MemoryEstimate(_count_bytes(kept), _count_bytes(held), sizes, remedy)


def check_arrays(counts: Mapping[str, int], held: Iterable[Sequence[float]], remedy: str) -> None:
    """Raise InputError where this process has no memory for arrays; arguments as those of `estimate_arrays`.

    For what reading itself takes, before an experiment is there that its need could be asked of.
    """
    check_memory(estimate_arrays(counts, (), remedy, held), 0)


def _count_bytes(arrays: Iterable[Sequence[float]]) -> float:
    return DOUBLE * sum(math.prod(map(float, one)) for one in arrays)


def check_tables(files: Iterable[Path]) -> None:
    """Raise InputError where there is no memory to read files, before the first of them is."""
    sizes = {path: path.stat().st_size for path in files if path.is_file()}
    if not sizes:
        return
    largest = max(sizes, key=sizes.__getitem__)
    what = f"{sum(sizes.values()) / 1000000.0:.0f} MB of files ({largest.name} the largest)"
    check_memory(MemoryEstimate(shared=READING * sum(sizes.values()), sizes=what, remedy="shorter tables"), 0)


def check_memory(need: MemoryEstimate, workers: int) -> None:
    """Raise InputError where there is too little memory; with no workers of this machine others compute."""
    available, wanted = measure_available(), need.sum_up(workers)
    if need.sizes and available is not None and wanted > available:
        fewer = " or fewer workers" if workers > 1 else ""
        raise InputError(
            f"memory: found {need.describe(workers)}, with {available / GIB:.1f} GiB available, expected {need.remedy}"
            f"{fewer}"
        )


def measure_available() -> float | None:
    """Return the bytes that this process may still take; None where the system does not say."""
    known: list[float] = []
    with contextlib.suppress(OSError):
        lines = Path("/proc/meminfo").read_text().splitlines()
        known += [1024.0 * float(line.split()[1]) for line in lines if line.startswith("MemAvailable:")]
    if not known:
        with contextlib.suppress(ValueError, OSError, AttributeError):
            known.append(float(os.sysconf("SC_AVPHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE"))
    for limit, stat, use in CGROUPS:  # what a container's limit leaves; files that the kernel caches can be given back
        with contextlib.suppress(OSError, ValueError):  # no such limit, or "max"
            rows = [line.split() for line in Path(stat).read_text().splitlines()]
            cached = sum(float(size) for name, size, *_ in rows if name in ("inactive_file", "total_inactive_file"))
            known.append(max(0.0, float(Path(limit).read_text()) - float(Path(use).read_text()) + cached))
    return min(known, default=None)
