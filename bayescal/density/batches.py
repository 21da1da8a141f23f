"""How many parameter vectors, and how many poses, the densities' hot loops take at a time."""

from __future__ import annotations

BATCH = 256  # vectors at a time: what the hot loop touches stays in the cache
POSES = 128  # poses of six legs at a time, for the same reason; memory then hardly grows with the poses


def batches(size: int, n_poses: int = 1) -> list[slice]:
    """Return slices of at most `BATCH` out of ``size``, fewer where each takes memory for very many poses at once."""
    most = max(1, BATCH * POSES // max(n_poses, POSES))
    return [slice(k, min(k + most, size)) for k in range(0, size, most)]
