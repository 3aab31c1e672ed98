"""Jobs on a cluster: this machine as one, workers that die, addresses that do not answer."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from importlib import import_module
from pathlib import Path

import pytest
from safetensors.numpy import load_file
from small_selection import NETWORK, PLAN, plan_in, swings
from swinging import SWING

from tustinnet.data.declaration import parse_toml
from tustinnet.errors import InputError
from tustinnet.fits.deadline import NEVER
from tustinnet.fitting.recipe_reading import read_recipe
from tustinnet.selection import cluster as room
from tustinnet.selection.cluster import _make_work, cluster, perform_here, versions
from tustinnet.selection.cross_validation import cross_validate, make_cross_validation_options
from tustinnet.selection.jobs import Job, RunContext
from tustinnet.selection.scoring import Scorer
from tustinnet.selection.select import Reporter, SelectionOptions, select_model
from tustinnet.systems.files import SystemFile

SCORING = Scorer(3, "model-10")
PARTED = "import os, signal\nos.kill(os.getpid(), signal.SIGKILL)\n"


@pytest.fixture(scope="module")
def machine():
    """This machine as a cluster, and what was said of its jobs."""
    said: list[str] = []
    with cluster(on_message=said.append) as workers:
        yield workers, said


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
            if not (place / "cmdline").read_bytes().startswith(b"ray::work"):
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
def test_a_selection_with_a_killed_worker_comes_to_what_one_process_comes_to(machine, tmp_path):
    workers, said = machine
    options = SelectionOptions(plan_in(tmp_path, PLAN[: PLAN.rindex("[[rounds]]")]), SWING)
    here = select_model(swings(), tmp_path / "here", options)
    killed: list[int] = []

    def kill() -> None:
        """Kills the first worker that has begun to train."""
        while not list((tmp_path / "there").glob("candidates/network/*/*/log.jsonl")):
            time.sleep(0.002)
        while (of := worker_of(os.getpid())) is None:
            time.sleep(0.002)
        os.kill(of, signal.SIGKILL)
        killed.append(of)

    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    there = select_model(swings(), tmp_path / "there", options, "refuse", Reporter(), workers)
    killer.join(10)
    assert len(killed) == 1
    assert len([line for line in said if line.endswith("its worker died, done again")]) == 1
    assert (there.best, there.sentences[1:]) == (here.best, here.sentences[1:])
    for name in ("grey", "network", "hybrid"):
        assert there.result(name).fits_by_fold == here.result(name).fits_by_fold
    found, wanted = arrays_below(tmp_path / "there"), arrays_below(tmp_path / "here")
    assert found.keys() == wanted.keys()
    for path, arrays in wanted.items():
        for name, array in arrays.items():
            assert (found[path][name] == array).all(), (path, name)
    assert len(list((tmp_path / "there").rglob(".*"))) == 1  # the mark, until the workers end


def test_a_cross_validation_comes_to_what_one_process_comes_to(machine, tmp_path):
    workers, said = machine
    recipe = read_recipe(parse_toml(NETWORK), ["stages.*.epochs=5"])
    options = make_cross_validation_options(recipe, folds=3, seeds=(0, 1))
    here, there = (
        cross_validate(swings(), options),
        cross_validate(swings(), options, folder=tmp_path, executor=workers),
    )
    assert sorted(there.scores, key=str) == sorted(here.scores, key=str)
    assert sum(line.startswith("recipe, fold") and "done on" in line for line in said) == 3


def test_a_job_whose_workers_always_die_is_told_as_a_failure(machine, tmp_path):
    workers, said = machine
    system = SystemFile(Path("deadly.py"), PARTED)
    executor = workers(RunContext(swings(), SCORING, tmp_path, system=system))
    executor.submit(Job("grey", read_recipe("grey"), 1), NEVER)
    found = executor.result()
    assert (found.candidate, found.fold, found.ended) == ("grey", 1, "failed")
    assert found.why.startswith("its worker died 3 times (WorkerCrashedError: ")
    assert said[-3:] == ["grey, fold 1: begins", *2 * ["grey, fold 1: its worker died, done again"]]


def test_what_goes_wrong_in_a_job_is_told_as_in_one_process(machine, tmp_path):
    workers, _ = machine
    system = SystemFile(Path("arm.py"), "SYSTEM = 1 / 0\n")
    executor = workers(RunContext(swings(), SCORING, tmp_path, system=system))
    assert executor.is_free
    executor.submit(Job("grey", read_recipe("grey"), 0), NEVER)
    assert executor.is_free == (executor._places > 1)
    found = executor.result()
    assert executor.is_free
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


def test_a_machine_with_other_packages_or_another_folder_does_nothing(tmp_path):
    about = {"mark": str(tmp_path / "mark"), "versions": versions()}
    assert "does not see" in perform_here(b"", b"", about)[0]  # pyright: ignore[reportIndexIssue]
    other = {**about, "versions": {**versions(), "jax": "0.0.1"}}
    assert perform_here(b"", b"", other) == (
        f"has jax {versions()['jax']}",
        "the versions of the process that asks: jax 0.0.1",
    )


def test_a_folder_that_a_worker_does_not_see_ends_the_selection(machine, tmp_path):
    executor = machine[0](RunContext(swings(), SCORING, tmp_path))
    executor._mark.unlink()  # as on a machine that has a folder of its own there
    executor.submit(Job("linear", read_recipe("linear"), 0), NEVER)
    with pytest.raises(InputError, match=r"worker on .*: does not see .*all machines share"):
        executor.result()


def test_a_worker_without_the_package_says_so():
    cloudpickle = import_module("ray.cloudpickle")
    code = f"""
import pickle, sys
sys.modules["tustinnet"] = None
work = pickle.loads({cloudpickle.dumps(_make_work())!r})
print(work(b"", b"", {{"jax": {{}}}}))
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "cannot load tustinnet" in run.stdout, run.stderr
    assert "pip install tustinnet there" in run.stdout
