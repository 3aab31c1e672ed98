"""What a job of a selection costs in one process and on a cluster, and what is sent.

    python benchmarks/cluster.py FOLDER [ADDRESS]

Networks in few epochs, 5 folds with some seeds each, a job each, one core for a job. Then the
same jobs once more, which find that they are done: that is what a job costs beside its fit.
"""

import argparse
import pickle
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import Executor
from pathlib import Path

import jax

jax.config.update("jax_num_cpu_devices", 1)
jax.config.update("jax_enable_x64", True)

import numpy as np

import tustinnet as tn
from tustinnet.selection.cluster import AUTO, cluster
from tustinnet.selection.jobs import Job, JobResult, RunContext
from tustinnet.selection.runner import Workplace, run_jobs
from tustinnet.selection.scoring import Scorer

FOLDS, SEEDS, EPOCHS = 5, 4, 6


def do_all(context: RunContext, executor: Executor | None, jobs: Sequence[Job]) -> list[JobResult]:
    """Does jobs, as many at once as the executor takes."""
    waiting, results = list(jobs), list[JobResult]()
    run_jobs(
        lambda: [waiting.pop(0)] if waiting else [],
        results.append,
        lambda: context,
        Workplace(executor),
    )
    assert all(result.ended == "done" for result in results), results
    return results


def measure(name: str, executor: Executor | None, data: tn.DataSet) -> None:
    """Prints how long the jobs take with an executor, and how long when they are done already."""
    recipe = tn.read_recipe("network", [f"stages.*.epochs={EPOCHS}"])
    jobs = [Job("network", recipe, f, (seed,)) for seed in range(SEEDS) for f in range(FOLDS)]
    with tempfile.TemporaryDirectory() as folder:
        context = RunContext(data, Scorer(FOLDS, "model-20"), Path(folder))
        begun = time.monotonic()
        seconds = [result.seconds for result in do_all(context, executor, jobs)]
        whole, begun = time.monotonic() - begun, time.monotonic()
        do_all(context, executor, jobs)
        again = time.monotonic() - begun
        files = sum(path.stat().st_size for path in context.folder.rglob("*") if path.is_file())
    sent, order = len(pickle.dumps(context)), len(pickle.dumps(jobs[0]))
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
    measure("in process", None, data)
    begun = time.monotonic()
    with cluster(args.address) as executor:
        print(f"joined in {time.monotonic() - begun:.1f} s", flush=True)
        measure("cluster", executor, data)


if __name__ == "__main__":
    main()
