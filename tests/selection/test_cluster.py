"""Jobs on a cluster: this machine as one, workers that die, addresses that do not answer."""

import contextlib
import os
import signal
import socket
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest
from safetensors.numpy import load_file
from small_selection import NETWORK, plan_in, swings
from swinging import SWING

from tustinnet.data.declaration import parse_toml
from tustinnet.errors import InputError
from tustinnet.fitting.listener import Listener
from tustinnet.fitting.recipe_reading import read_recipe
from tustinnet.selection import cluster as room
from tustinnet.selection.cluster import _call, cluster, versions
from tustinnet.selection.cross_validation import cross_validate, make_cross_validation_options
from tustinnet.selection.jobs import Job, JobResult, RunContext
from tustinnet.selection.runner import Workplace, run_jobs
from tustinnet.selection.scoring import Scorer
from tustinnet.selection.select import Reporter, SelectionOptions, select_model
from tustinnet.systems.files import SystemFile

SCORING = Scorer(3, "model-10")
WAITING = """
name = "waiting"
folds = 3
scored = 1
start = "model-10"
candidates = [
    { name = "grey", recipe = "grey.toml" },
    { name = "hybrid", recipe = "hybrid.toml", corrects = ["grey"] },
]
"""
PARTED = "import os, signal\nos.kill(os.getpid(), signal.SIGKILL)\n"


@pytest.fixture(scope="module")
def machine():
    """This machine as a cluster."""
    with cluster() as workers:
        yield workers


def arrays_below(folder: Path) -> dict[str, dict]:
    """Of all models below a folder."""
    return {
        path.relative_to(folder).as_posix(): load_file(path)
        for path in folder.glob("**/model.safetensors")
    }


def worker_of(driver: int) -> int | None:
    """The process that does a job of this one, as Ray names it."""
    for place in Path("/proc").glob("[0-9]*"):
        try:
            if not (place / "cmdline").read_bytes().startswith(b"ray::_call"):
                continue
            parent = int(place.name)
            while parent > 1:
                if parent == driver:
                    return int(place.name)
                parent = int((Path("/proc") / str(parent) / "stat").read_text().split()[3])
        except (OSError, ValueError):
            continue
    return None


# --- what comes out ---


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="finds processes in /proc")
@pytest.mark.thorough
def test_a_selection_with_a_killed_worker_comes_to_what_one_process_comes_to(machine, tmp_path):
    said: list[str] = []
    # a job of a fold waits for another
    options = SelectionOptions(plan_in(tmp_path, WAITING), SWING)
    here = select_model(swings(), tmp_path / "here", options)
    killed: list[int] = []

    def kill() -> None:
        """Kills the first worker that has begun to train."""
        while not list((tmp_path / "there").glob("candidates/hybrid/*/*/log.jsonl")):
            time.sleep(0.002)
        while (of := worker_of(os.getpid())) is None:
            time.sleep(0.002)
        os.kill(of, signal.SIGKILL)
        killed.append(of)

    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    there = select_model(
        swings(), tmp_path / "there", options, "refuse", Reporter(said.append), machine
    )
    killer.join(10)
    assert len(killed) == 1
    assert sum(": done in " in line for line in said) == sum(
        len(r.fits) for r in there.candidates.results
    )
    assert (there.best, there.findings[1:]) == (here.best, here.findings[1:])
    for name in ("grey", "hybrid"):
        assert there.result(name).fits_by_fold == here.result(name).fits_by_fold
    found, wanted = arrays_below(tmp_path / "there"), arrays_below(tmp_path / "here")
    assert found.keys() == wanted.keys()
    for path, arrays in wanted.items():
        for name, array in arrays.items():
            assert (found[path][name] == array).all(), (path, name)


@pytest.mark.thorough
def test_a_cross_validation_comes_to_what_one_process_comes_to(machine, tmp_path):
    said: list[str] = []
    recipe = read_recipe(parse_toml(NETWORK), ["stages.*.epochs=2"])
    options = make_cross_validation_options(recipe, folds=3, seeds=(0,))
    here, there = (
        cross_validate(swings(), options),
        cross_validate(
            swings(), options, Listener(on_message=said.append), folder=tmp_path, executor=machine
        ),
    )
    assert sorted(there.scores, key=str) == sorted(here.scores, key=str)
    assert sum(line.startswith("recipe, fold") and "done in" in line for line in said) == 3


def done(machine, context: RunContext, job: Job) -> JobResult:
    """The result of a single job."""
    results: list[JobResult] = []
    waiting = [[job]]
    run_jobs(
        lambda: waiting.pop() if waiting else [],
        results.append,
        lambda: context,
        Workplace(machine),
    )
    return results[0]


def test_a_job_whose_workers_always_die_is_told_as_a_failure(machine, tmp_path, monkeypatch):
    monkeypatch.setattr(machine, "_call", machine._call.options(max_retries=0))
    system = SystemFile(Path("deadly.py"), PARTED)
    context = RunContext(swings(), SCORING, tmp_path, system=system)
    found = done(machine, context, Job("grey", read_recipe("grey"), 1))
    assert (found.candidate, found.fold, found.ended) == ("grey", 1, "failed")
    assert "WorkerCrashedError" in found.why


def test_what_goes_wrong_in_a_job_is_told_as_in_one_process(machine, tmp_path):
    system = SystemFile(Path("arm.py"), "SYSTEM = 1 / 0\n")
    context = RunContext(swings(), SCORING, tmp_path, system=system)
    found = done(machine, context, Job("grey", read_recipe("grey"), 0))
    assert found.ended == "failed"
    assert "arm.py" in found.why
    assert "line 1" in found.why


# --- what does not go ---


@pytest.mark.parametrize(
    ("address", "told"),
    [
        ("nonsense", r"cluster nonsense: no address.*HOST:PORT"),
        ("ray://10.0.0.5:10001", r"no address"),
        ("127.0.0.1:1", r"cluster 127.0.0.1:1: does not answer .*refused.*ray start --head"),
        ("no-such-host.invalid:6379", r"does not answer"),
    ],
)
def test_an_address_that_does_not_answer_is_told(address, told):
    with pytest.raises(InputError, match=told), cluster(address):
        pass


def test_auto_is_the_cluster_that_the_environment_names(monkeypatch):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        named = f"127.0.0.1:{other.getsockname()[1]}"  # nobody listens there
        monkeypatch.setenv("RAY_ADDRESS", named)
        with pytest.raises(InputError, match=rf"RAY_ADDRESS={named}: does not answer"), cluster():
            pass


@pytest.mark.parametrize("answer", [b"", b"HTTP/1.1 400 Bad Request\r\n"], ids=["none", "other"])
def test_a_port_where_something_else_listens_is_told(answer, monkeypatch):
    monkeypatch.setattr(room, "_ANSWERS", 3.0)
    with socket.create_server(("127.0.0.1", 0)) as server:

        def listen() -> None:
            for _ in range(2):  # whether somebody listens, then what it says
                known, _ = server.accept()
                with known, contextlib.suppress(OSError):
                    known.sendall(answer)
                    known.recv(1000)

        other = threading.Thread(target=listen, daemon=True)
        other.start()
        address = f"127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(InputError, match=r"does not answer"), cluster(address):
            pass


def test_without_ray_the_extra_is_named(monkeypatch):
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match=r"ray is not installed.*tustinnet\[ray\]"), cluster():
        pass


def test_a_machine_with_other_packages_does_nothing(machine, monkeypatch):
    other = {**versions(), "jax": "0.0.1"}
    with pytest.raises(InputError, match=r"has jax .*expected the versions of the process .*0.0.1"):
        _call(other, print, b"")
    monkeypatch.setattr(room, "versions", lambda: other)
    with pytest.raises(InputError, match=r"worker on .* has jax"):
        done(machine, RunContext(swings(), SCORING, Path("x")), Job("l", read_recipe("linear"), 0))


@pytest.mark.thorough
def test_a_folder_that_a_worker_does_not_share_ends_the_selection(machine, tmp_path, monkeypatch):
    context = RunContext(swings(), SCORING, tmp_path / "there")
    elsewhere = replace(context, folder=tmp_path / "here")
    contexts = iter([context, elsewhere])
    waiting = [[Job("linear", read_recipe("linear"), 0)]]
    with pytest.raises(
        InputError, match=r"here lacks .*linear.*expected a folder that all workers"
    ):
        run_jobs(
            lambda: waiting.pop() if waiting else [],
            lambda result: None,
            lambda: next(contexts),
            Workplace(machine),
        )
