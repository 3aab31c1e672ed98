"""The simulated machines of `benchmarks/machines.py`: records, data cards, system files, rows."""

from dataclasses import replace

import jax.numpy as jnp
import machines
import numpy as np
import pytest
from simulated.machines import MACHINES
from simulated.measurement import Run, measure, simulate

import tustinnet as tn

SECONDS = 1.0
NAMES = list(MACHINES)


def shortened(runs: list[Run], seconds: float) -> list[Run]:
    return [Run(r.name, seconds, r.initial, r.command) for r in runs]


def system(name: str) -> tn.LagrangianSystem:
    return tn.load_system(str(machines.system_file(name)))


@pytest.mark.parametrize("name", NAMES)
def test_records_are_finite_and_plausible(name):
    machine, rng = MACHINES[name](True), np.random.default_rng(0)
    fit, held_out = machine.runs(rng)
    assert 6 <= len(fit) <= 12
    assert len(held_out) >= 3
    assert len({r.name for r in (*fit, *held_out)}) == len(fit) + len(held_out)
    assert all(2 <= r.seconds <= 20 for r in (*fit, *held_out))
    for motion in simulate(machine, shortened([fit[0], fit[-1], *held_out], SECONDS), rng):
        names, table = measure(machine, motion, rng)
        assert len(names) == 1 + len(machine.sensors) + len(machine.actuators)
        assert np.isfinite(table).all()
        intervals = np.diff(table[:, 0])
        assert intervals.min() > 0.7 * machine.dt
        for i, sensor in enumerate(machine.sensors):
            q = motion.x[:, i]
            # m; a turn or more in the sampling period would not be unwrapped
            assert np.abs(q).max() < (1.0 if sensor.kind == "linear" else 500.0)
            if sensor.kind == "angular":
                assert np.abs(np.diff(q)).max() < 1.5
            readings = table[:, 1 + i]
            assert np.allclose(readings / sensor.step, np.round(readings / sensor.step), atol=1e-6)


@pytest.mark.thorough
@pytest.mark.parametrize("name", NAMES)
def test_the_system_file_describes_the_machine_without_its_further_effects(name):
    machine, rng = MACHINES[name](False), np.random.default_rng(1)
    physics = system(name)
    n_q = len(machine.sensors)
    assert [c.name for c in physics.coordinates] == [s.name for s in machine.sensors]
    assert [i.name for i in physics.inputs] == [a.name for a in machine.actuators]
    ranges = {p.name: (p.lower, p.upper) for p in physics.parameters}
    for parameter, value in machine.truth.items():
        assert ranges[parameter][0] < value < ranges[parameter][1], parameter
    begin = physics.nominal()
    assert any(abs(begin[k] / v - 1) > 0.1 for k, v in machine.truth.items())
    inputs = tuple(tn.Input(a.name, a.unit, hold=a.hold) for a in machine.actuators)
    model = tn.discretise(
        physics.model({k: jnp.asarray(v) for k, v in (begin | machine.truth).items()}),
        machine.dt,
        machine.substeps,
        inputs=inputs,
    )
    runs = shortened(machine.runs(rng)[0][:1], machine.comparable)
    (motion,) = simulate(machine, runs, rng, effects=False)
    record = tn.from_arrays(
        motion.x[:, :n_q],
        motion.u,
        dt=machine.dt,
        coordinates={s.name: s.kind for s in machine.sensors},
        inputs=inputs,
        name="truth",
    )
    states = n_q * 2 + len(physics.memory.names if physics.memory else ())
    x = np.asarray(tn.rollout(model, motion.x[0, :states], tn.input_signal(model, record)))
    error = x[: len(motion.x), :n_q] - motion.x[:, :n_q]
    assert np.abs(error).max() < 0.01 * np.abs(motion.x[:, :n_q]).max()


@pytest.mark.thorough
def test_written_records_load(tmp_path, monkeypatch):
    disc = MACHINES["unbalanced-disc"](True)

    def short(effects):
        assert effects
        return replace(disc, runs=lambda rng: tuple(shortened(r, 3.0) for r in disc.runs(rng)))

    monkeypatch.setitem(MACHINES, "unbalanced-disc", short)
    machines.write(tmp_path, ["unbalanced-disc"], seed=3)
    folder = tmp_path / "unbalanced-disc"
    logs, held_out = tn.load(folder / "logs"), tn.load(folder / "heldout")
    assert len(logs) == 9
    assert len(held_out) == 3
    assert logs.channels == held_out.channels
    assert (folder / "system.py").is_file()
    assert logs.channels.dt == 0.02
    assert any("unwrapped" in note for record in logs for note in record.notes)


def test_spread_and_error_of_angles_are_within_turns():
    turning = np.linspace(0, 40 * np.pi, 4001)[:, None]
    assert machines.spread([turning], ["angular"]) < np.pi
    assert machines.spread([turning], ["linear"]) > 30
    assert machines.rms([turning], [turning + 2 * np.pi], ["angular"]) == pytest.approx(0, abs=1e-9)


def test_rows_are_kept_and_tabled(tmp_path):
    row = machines.Row(machine="duffing", exit_code=1, wall=12.0, traceback=True)
    file = tmp_path / "rows.jsonl"
    machines.append_row(file, row)
    assert machines.read_rows(file) == [row]
    assert "| duffing |" in machines.table([row])
