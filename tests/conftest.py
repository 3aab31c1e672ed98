"""Set-up of all tests: double precision, a small system, the measured data where it is at hand."""

import gc
import os
import shutil
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

# before JAX is loaded, and for the processes that tests start: what one test has compiled serves
# the next ones, those of other processes and later runs too; also the hundred small programs that
# each fit needs, which take longer to compile than to write and read
os.environ["JAX_COMPILATION_CACHE_DIR"] = str(Path(__file__).parents[1] / ".pytest_cache/compiled")
os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
os.environ["JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES"] = "-1"
# as the command has it, of workers and of processes that tests start: where more threads than cores
# multiply small matrices, they wait for one another ten times as long as they work
os.environ["OPENBLAS_NUM_THREADS"] = "1"
# what tests trust is no business of whoever runs them
os.environ["TUSTINNET_CONFIG"] = str(Path(__file__).parents[1] / ".pytest_cache/config")
# compiling is most of the time, running what was compiled is not: with these a quarter of the time
# (JAX 0.11 no longer knows the last one, and ends where it reads a flag that it does not know)
os.environ.setdefault(
    "XLA_FLAGS",
    "--xla_backend_optimization_level=0 --xla_cpu_parallel_codegen_split_count=1"
    + (" --xla_cpu_use_fusion_emitters=false" if int(version("jaxlib").split(".")[1]) < 11 else ""),
)

import jax
import jaxtyping
import numpy as np
import pytest
import remembered_checks  # noqa: F401 (before tustinnet: replaces the hook's decorator)

import tustinnet as tn
from tustinnet.fits.request import FitRequest, prepare
from tustinnet.fits.run import run_fit
from tustinnet.fitting.task import Member
from tustinnet.simulate.programs import make_room

# objects of JAX and of loaded modules live until the end: looking through them again and again took
# a tenth of the time
gc.freeze()
gc.set_threshold(50_000, 20, 50)

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_num_cpu_devices", 2)  # as the command has on a machine with two cores

DT = 0.02
_SHARE = 0.3  # of the room for programs, which one module may take after another
COUNT = 2 * np.pi / 4096


@pytest.fixture(autouse=True, scope="module")
def _room_for_programs() -> Iterator[None]:
    """Forgets compiled programs before there are too many."""
    yield
    make_room(_SHARE)


def swing(samples: int, seed: int, *, forced: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Angle and torque of a damped pendulum (0 hangs down), integrated at a tenth of DT."""
    generator = np.random.default_rng(seed)
    u = generator.uniform(-3, 3, samples) if forced else np.zeros(samples)
    state = np.array([generator.uniform(1.0, 2.5), generator.uniform(-1, 1)])
    if forced:
        state *= 0.1

    def slope(x: np.ndarray, torque: float) -> np.ndarray:
        return np.array([x[1], -20.0 * np.sin(x[0]) - 0.8 * x[1] + 4.0 * torque])

    angles = np.empty(samples)
    h = DT / 10
    for k in range(samples):
        angles[k] = state[0]
        for _ in range(10):
            middle = state + h / 2 * slope(state, u[k])
            state = state + h * slope(middle, u[k])
    return angles, u


def record(
    name: str, samples: int, seed: int, split: str, *, forced: bool = False
) -> tn.Experiment:
    """A record of the pendulum, its angle read by an encoder."""
    angle, u = swing(samples, seed, forced=forced)
    return tn.from_arrays(
        np.round(angle / COUNT) * COUNT,
        u,
        dt=DT,
        coordinates=[tn.Coordinate("angle", "angular", COUNT)],
        inputs=[tn.Input("torque", "N m", "zero-order", is_delay_declared=True)],
        name=name,
        split=split,
    )


@pytest.fixture(scope="session")
def pendulum() -> tn.DataSet:
    """Five records of unequal length of a small system."""
    return tn.DataSet(
        "pendulum",
        (
            record("fall1", 300, 1, "train"),
            record("fall2", 260, 2, "train"),
            record("noise1", 240, 3, "train", forced=True),
            record("fall3", 200, 4, "validation"),
            record("noise2", 180, 5, "validation", forced=True),
        ),
    )


CARD = """
name = "pendulum"
dt = 0.02
[time]
column = "time"
[[coordinates]]
name = "angle"
kind = "angular"
column = "angle"
unit = "deg"
counts_per_revolution = 4096
[[inputs]]
name = "torque"
column = "torque"
unit = "N m"
hold = "zero-order"
delay = 0.0
[splits]
train = ["fall1.csv", "fall2.csv", "noise1.csv"]
validation = ["fall3.csv", "noise2.csv"]
"""


@pytest.fixture
def folder(pendulum: tn.DataSet, tmp_path: Path) -> Path:
    """The same system as a folder of CSV files with a data card."""
    return write_folder(pendulum, tmp_path / "logs")


def write_folder(pendulum: tn.DataSet, place: Path) -> Path:
    """Writes records of the small system as CSV files with a data card."""
    place.mkdir()
    for e in pendulum:
        rows = np.column_stack([e.t, np.rad2deg(e.q[:, 0]), e.u[:, 0]])
        np.savetxt(
            place / f"{e.name}.csv",
            rows,
            delimiter=",",
            header="time,angle,torque",
            comments="",
            fmt="%.9g",
        )
    (place / "dataset.toml").write_text(CARD)
    return place


def find_real_data() -> Path | None:
    """The measured Qube-Servo 2 data: TUSTINNET_DATA, or a `shared` folder beside the project."""
    beside = Path(__file__).parents[2] / "shared" / "data" / "qube_servo2"
    for candidate in (os.environ.get("TUSTINNET_DATA"), beside):
        if candidate and (Path(candidate) / "train").is_dir():
            return Path(candidate)
    return None


@pytest.fixture
def unchecked() -> Iterator[None]:
    """The package as people run it: without the type checks of the test set-up."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


REAL_DATA = find_real_data()  # looked up once, before the variable is hidden from the tests


@pytest.fixture
def real_data() -> Path:
    """The folder of the measured data; skips, and says so, where it is not at hand."""
    if REAL_DATA is None:
        pytest.skip("the measured Qube-Servo 2 data is not at hand (set TUSTINNET_DATA)")
    return REAL_DATA


@pytest.fixture(autouse=True)
def _no_data_variable(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tests do not depend on the variable of whoever runs them."""
    monkeypatch.delenv("TUSTINNET_DATA", raising=False)


SYSTEM = (Path(__file__).parent / "torture/pendulum.py").read_text()


@pytest.fixture
def system(tmp_path: Path) -> Path:
    """The physical system of the small pendulum, as a file."""
    path = tmp_path / "small_pendulum.py"
    path.write_text(SYSTEM)
    return path


@pytest.fixture(scope="session")
def identified_once(pendulum: tn.DataSet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of an identification of the small pendulum by the command."""
    from tustinnet.cli.main import run

    place = tmp_path_factory.mktemp("identified")
    (place / "small_pendulum.py").write_text(SYSTEM)
    logs = write_folder(pendulum, place / "logs")
    with pytest.raises(SystemExit) as ended:
        run(
            [
                "fit",
                str(logs),
                "--recipe",
                "grey",
                "--system",
                str(place / "small_pendulum.py"),
                "--out",
                str(place / "grey"),
            ]
        )
    assert not ended.value.code
    return place / "grey"


@pytest.fixture
def identified(identified_once: Path, tmp_path: Path) -> Path:
    """A copy of that folder, which a test may change."""
    return Path(shutil.copytree(identified_once, tmp_path / "grey"))


SMALL_RECIPE = """
name = "small"
start = "derived-6"
[model]
hidden = [8, 6]
stem = 5
[[stages]]
name = "first"
windows = { draw = "strided", length = 10, step = 8 }
rate = 3e-3
epochs = 5
batch = 16
plateau = { factor = 0.5, patience = 1 }
[[stages]]
name = "second"
windows = { draw = "random", length = 15, count = 40 }
rate = 1e-3
epochs = 4
batch = 16
frozen_layers = 1
"""


@pytest.fixture
def small_recipe(tmp_path: Path) -> Path:
    """A recipe of two short stages, as a file."""
    path = tmp_path / "small.toml"
    path.write_text(SMALL_RECIPE)
    return path


@pytest.fixture
def tiny_recipe(tmp_path: Path) -> Path:
    """A recipe of one short stage, as a file: half as long to compile as the small one."""
    path = tmp_path / "tiny.toml"
    path.write_text("""
name = "tiny"
start = "derived-6"
[model]
hidden = [4]
[[stages]]
name = "only"
windows = { draw = "strided", length = 10, count = 20 }
rate = 3e-3
epochs = 2
batch = 16
""")
    return path


@pytest.fixture(scope="session")
def trained_once(pendulum: tn.DataSet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run folder of two seeds of the small recipe on the small system's folder."""
    place = tmp_path_factory.mktemp("trained")
    (place / "small.toml").write_text(SMALL_RECIPE)
    data = tn.load(write_folder(pendulum, place / "logs"))
    request = FitRequest(data, place / "small.toml", [Member(0), Member(1)])
    run_fit(prepare(request), place / "run")
    return place / "run"


@pytest.fixture
def run_folder(trained_once: Path, tmp_path: Path) -> Path:
    """A copy of that run folder, which a test may change."""
    return Path(shutil.copytree(trained_once, tmp_path / "run"))


REMARKING = ("fit", "cross-validate", "demo", "reproduce")  # verbs that first print remarks


@pytest.fixture
def refused(capsys):
    """Runs the command, which must refuse with one line that has some words."""
    from tustinnet.cli.main import run

    def check(*arguments: object, names: str | tuple[str, ...]) -> None:
        with pytest.raises(SystemExit) as ended:
            run([str(a) for a in arguments])
        out, err = capsys.readouterr()
        assert (ended.value.code, out) == (1, ""), err
        lines = err.splitlines()
        (line,) = [x for x in lines if x.startswith("error: ") or arguments[0] not in REMARKING]
        assert "Traceback" not in err
        for words in [names] if isinstance(names, str) else names:
            assert words in line

    return check
