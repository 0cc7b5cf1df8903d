"""A dask cluster of this machine."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from distributed import Client, LocalCluster

from sassgis.simulation.cluster import Cluster


@contextmanager
def local_cluster(processes: int) -> Iterator[Cluster]:
    """Workers on a cluster that is there as long as the block."""
    with (
        LocalCluster(
            n_workers=processes, threads_per_worker=1, processes=True, dashboard_address=":0",
            silence_logs=50,
        ) as own,
        Client(own) as client,
    ):  # fmt: skip
        yield Cluster(client)
