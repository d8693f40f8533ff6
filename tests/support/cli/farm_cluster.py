"""A Dask cluster of two workers on this computer, each a process: tells its address and the
workers' numbers, ends with its input.
"""

import sys

import dask
from distributed import LocalCluster

if __name__ == "__main__":
    # The workers are forks of one process that has the imports, which take a second for each.
    dask.config.set({"distributed.worker.multiprocessing-method": "forkserver"})
    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1"
    ) as cluster:
        workers = [worker.pid for worker in cluster.workers.values()]
        sys.stdout.write(f"{cluster.scheduler_address} {workers[0]} {workers[1]}\n")
        sys.stdout.flush()
        sys.stdin.read()
