"""What a job of a selection costs in one process and on a cluster, and what is sent.

    python benchmarks/cluster.py FOLDER [ADDRESS]

Linear models in few epochs, 5 folds with some seeds each, a job each, one core for a job. Then the
same jobs once more, which find that they are done: that is what a job costs beside its fit.
"""

import argparse
import pickle
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import jax

jax.config.update("jax_num_cpu_devices", 1)
jax.config.update("jax_enable_x64", True)

import numpy as np

import tustinnet as tn
from tustinnet.fitting.listener import Listener
from tustinnet.selection.cluster import AUTO, cluster
from tustinnet.selection.jobs import Job, JobResult, Judging, RunContext
from tustinnet.selection.runner import Executor, InProcess

FOLDS, SEEDS, EPOCHS = 5, 4, 6


def done(executor: Executor, jobs: Sequence[Job]) -> list[JobResult]:
    """Does jobs, as many at once as the executor takes."""
    waiting, running, found = list(jobs), 0, []
    while waiting or running:
        if waiting and executor.free:
            executor.submit(waiting.pop(0))
            running += 1
        else:
            found.append(executor.result())
            running -= 1
    assert all(result.ended == "done" for result in found), found
    return found


def measure(name: str, make: Callable[[RunContext], Executor], data: tn.DataSet) -> None:
    """Prints how long the jobs take with an executor, and how long when they are done already."""
    recipe = tn.read_recipe("linear", [f"stages.*.epochs={EPOCHS}"])
    jobs = [Job("linear", recipe, f, (seed,)) for seed in range(SEEDS) for f in range(FOLDS)]
    with tempfile.TemporaryDirectory() as folder:
        at = RunContext(Path(folder), data, Judging(FOLDS, "model-20"))
        executor, begun = make(at), time.monotonic()
        seconds = [result.seconds for result in done(executor, jobs)]
        whole, begun = time.monotonic() - begun, time.monotonic()
        done(executor, jobs)
        again = time.monotonic() - begun
        files = sum(path.stat().st_size for path in at.folder.rglob("*") if path.is_file())
    sent, order = len(pickle.dumps(at)), len(pickle.dumps(jobs[0]))
    print(f"{name}: {len(jobs)} jobs in {whole:.1f} s")
    print(f"  a job: median {np.median(seconds):.2f} s, longest {max(seconds):.1f} s (it compiles)")
    print(f"  found done: {again / len(jobs) * 1e3:.1f} ms a job")
    print(f"  sent: once {sent / 1e6:.2f} MB, a job {order} bytes")
    print(f"  written: {files / len(jobs) / 1e3:.0f} kB a job", flush=True)


def main() -> None:
    """In this process, then on a cluster."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("address", nargs="?", default=AUTO)
    args = parser.parse_args()
    data = tn.load(args.folder)
    measure("in process", lambda at: InProcess(at, lambda job: lambda plan: Listener()), data)
    begun = time.monotonic()
    with cluster(args.address) as workers:
        print(f"joined in {time.monotonic() - begun:.1f} s", flush=True)
        measure("cluster", workers, data)


if __name__ == "__main__":
    main()
