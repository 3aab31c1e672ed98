"""Records that disagree: parameters by group, and what is said of them."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from swinging import DT, SWING, changed, data_set, declared

import tustinnet as tn
from tustinnet.evaluate.bands import find_alternatives
from tustinnet.evaluate.next_record import Proposal, rank_proposals
from tustinnet.fitting.shooting.information import fisher_information, search_space_for
from tustinnet.models.lagrangian import LagrangianSystem, Parameter

MASSES = {"1kg": 0.21, "2kg": 0.42}
DAMPING, GAIN = 0.02, 0.15
CARRYING = LagrangianSystem(
    name="carrying",
    coordinates=SWING.coordinates,
    inputs=SWING.inputs,
    parameters=(
        Parameter("mass", "kg", 0.3, 0.05, 2.0),
        Parameter("damping", "N m s", 0.04, 1e-3, 1.0),
        Parameter("gain", "N m/V", GAIN, 0.01, 1.0, fixed=True),
    ),
    kinetic=lambda q, v, p: 0.08 * p["mass"] * v[0] ** 2,
    potential=lambda q, p: -3.924 * p["mass"] * jnp.cos(q[0]),
    dissipation=lambda q, v, p: p["damping"] * v,
    input_map=lambda q, v, u, p: p["gain"] * u,
)
PER = changed("mass", CARRYING, per="payload")


def carried(i: int, payload: str | None, mass: float | None = None) -> tn.Experiment:
    """A record with white noise of 5 mrad."""
    generator = np.random.default_rng([0, i])
    values = {"mass": mass or MASSES[str(payload)], "damping": DAMPING, "gain": GAIN}
    model = tn.discretise(CARRYING.model({k: jnp.asarray(v) for k, v in values.items()}), DT, 2)
    x0, u = generator.uniform(-1.5, 1.5, 2), generator.uniform(-5, 5, 120)
    q = np.asarray(tn.rollout(model, x0, u[:-1, None]))[:, 0]
    return tn.from_arrays(
        q + 0.005 * generator.normal(size=120),
        u,
        dt=DT,
        name=f"r{i}",
        coordinates=CARRYING.coordinates,
        inputs=declared(CARRYING.inputs),
        groups={"payload": payload} if payload else {},
    )


@cache
def both() -> tuple[tn.Experiment, ...]:
    """Three records with each payload."""
    return tuple(carried(i, ("1kg", "2kg")[i % 2]) for i in range(6))


@cache
def found_per_payload() -> tn.Identification:
    return tn.identify(data_set(list(both())), PER)


def test_groups_that_disagree_are_told_with_what_to_declare():
    result = tn.identify(data_set(list(both())), CARRYING)
    (disagreement,) = [d for d in result.disagreements if d.group]
    assert (disagreement.parameter, disagreement.group) == ("mass", "payload")
    for side, (payload, mass) in zip(disagreement.sides, MASSES.items(), strict=True):
        assert side.what == f"payload={payload}"
        assert side.value == pytest.approx(mass, rel=0.02)
    assert any(
        f.text.startswith("the records of payload=1kg and payload=2kg disagree about `mass` (0.2")
        and f.mend == 'declare it per="payload"'
        for f in result.findings
    )
    assert result.as_plain()["disagreements"][0]["parameter"] == "mass"


def test_each_group_has_a_value_of_its_own_within_its_interval():
    result = found_per_payload()
    estimates = {e.name: e for e in result.estimates}
    assert set(estimates) == {"mass[1kg]", "mass[2kg]", "damping"}
    truth = {"mass[1kg]": 0.21, "mass[2kg]": 0.42, "damping": DAMPING}
    for name, e in estimates.items():
        assert e.interval is not None
        assert e.interval[0] <= truth[name] <= e.interval[1]
        assert e.value == pytest.approx(truth[name], rel=0.01)
    assert result.disagreements == ()


def test_one_model_simulates_every_record_with_the_values_of_its_group(tmp_path: Path):
    model = found_per_payload().model
    tn.save(model, tmp_path / "m.safetensors")
    loaded = tn.load_model(tmp_path / "m.safetensors", PER)
    scores = tn.evaluate(loaded, both(), "model-60")
    assert max(s.rmse for s in scores) < 0.04
    alone = [tn.free_run(loaded, e, "model-60")[0] for e in both()]
    for score, x in zip(scores, alone, strict=True):
        np.testing.assert_allclose(score.simulated, x, rtol=1e-7, atol=1e-9)
    other = replace(both()[0], groups=(("payload", "2kg"),))
    assert tn.evaluate(loaded, other, "model-60")[0].rmse > 2 * scores[0].rmse
    with pytest.raises(tn.InputError, match="parameters that the system does not have"):
        tn.load_model(tmp_path / "m.safetensors", CARRYING)
    taken = tmp_path / "taken.safetensors"
    tn.save(model.for_record(both()[0]), taken)  # the file of a record's model has all values
    assert tn.evaluate(tn.load_model(taken, PER), both()[1], "model-60")[0].rmse < 0.04


@pytest.mark.parametrize(
    ("groups", "message"),
    [
        ((), "record 'r0': no group 'payload'"),
        ((("payload", "3kg"),), "record 'r0': payload '3kg'"),
    ],
)
def test_a_record_that_the_model_does_not_know_is_refused(groups, message):
    stranger = replace(both()[0], groups=groups)
    with pytest.raises(tn.InputError, match=f"{message}.*expected one of 1kg, 2kg"):
        tn.evaluate(found_per_payload().model, [both()[1], stranger], "derived-6")
    if not groups:
        with pytest.raises(tn.InputError, match=message):
            tn.identify(data_set([stranger, *both()[1:]]), PER)


def test_without_a_record_a_model_of_several_groups_does_not_step():
    with pytest.raises(tn.InputError, match=r"no one value of 'mass'.*model\.for_record\(record\)"):
        tn.linearize(found_per_payload().model, np.zeros(2), np.zeros(1))
    at = tn.linearize(found_per_payload().model.for_record(both()[0]), np.zeros(2), np.zeros(1))
    assert at.b[1, 0] == pytest.approx(GAIN * DT / (0.16 * 0.21), rel=0.05)


@pytest.mark.thorough
def test_values_are_fixed_for_all_groups_or_for_one():
    result = tn.identify(data_set(list(both())), PER, fixed={"mass": 0.42, "mass[1kg]": 0.21})
    assert result.fixed["mass[1kg]"] == 0.21
    assert result.fixed["mass[2kg]"] == 0.42
    assert [e.name for e in result.estimates] == ["damping"]
    with pytest.raises(tn.InputError, match=r"no parameter 'mass\[3kg\]'.*mass\[1kg\]"):
        tn.identify(data_set(list(both())), PER, begin={"mass[3kg]": 0.2})


def test_a_record_that_contradicts_the_others_is_named():
    records = [carried(i, None, 0.42 if i == 2 else 0.21) for i in range(6)]
    result = tn.identify(data_set(records), CARRYING)
    assert {d.sides[0].what for d in result.disagreements} == {"r2"}
    (mass,) = [d for d in result.disagreements if d.parameter == "mass"]
    assert mass.sides[0].value == pytest.approx(0.42, rel=0.05)
    assert mass.sides[1].value == pytest.approx(0.21, rel=0.01)
    assert "record 'r2' and the 5 others disagree about `mass`" in " ".join(
        f.text for f in result.findings
    )


def test_records_that_agree_contradict_nobody():
    records = [carried(i, None, 0.21) for i in range(6)]
    assert tn.identify(data_set(records), CARRYING).disagreements == ()


def test_a_network_is_not_trained_on_physics_that_differ():
    recipe = tn.read_recipe("best-hybrid")
    data = data_set([replace(e, split="train") for e in both()])
    with pytest.raises(tn.InputError, match="payload '1kg' of 'r0' and payload '2kg' of 'r1'"):
        tn.fit(data, recipe, physics=found_per_payload().model)


@pytest.mark.parametrize(
    ("changes", "message"),
    [({"fixed": True}, "fixed, and one per payload"), ({"per": "a/b"}, "the name 'a/b'")],
)
def test_what_contradicts_itself_in_a_parameter_is_refused(changes, message):
    with pytest.raises(tn.InputError, match=message):
        changed("mass", PER, **changes)


def swing(**groups: str) -> Proposal:
    pushed = 5 * np.sin(np.arange(100) / 3)[:, None]
    name = f"with {groups.get('payload', 'nothing')}"
    return Proposal(name, np.array([1.0]), np.zeros(1), pushed, groups)


def what_would_tell(*proposals: Proposal) -> dict[str, float]:
    result = found_per_payload()
    header = {"identification": result.as_plain()}
    assert find_alternatives(result.model, header, "the model")
    return {
        proposal.name: proposal.value
        for proposal in rank_proposals(result.model, header, proposals)
    }


def test_a_proposed_record_is_ranked_with_the_mass_that_it_is_made_with():
    both = what_would_tell(swing(payload="1kg"), swing(payload="2kg"))
    assert min(both.values()) > 0.01
    # whatever else is proposed
    alone = what_would_tell(swing(payload="2kg"))
    assert alone["with 2kg"] == pytest.approx(both["with 2kg"], rel=1e-9)
    assert both["with 1kg"] != pytest.approx(both["with 2kg"], rel=1e-3)


def test_a_record_informs_of_the_value_of_its_own_group_alone():
    values = {e.name: e.value for e in found_per_payload().estimates} | {"gain": GAIN}
    space = search_space_for(PER, values, ["mass[1kg]", "mass[2kg]", "damping"])
    records = [e for e in both() if e.group("payload") == "2kg"]
    of_one, of_two = (space.names.index(f"mass[{payload}]") for payload in ("1kg", "2kg"))
    for matrix in fisher_information(space, PER, values, records, 2, 0.005):
        assert matrix[of_one, of_one] == 0
        assert matrix[of_two, of_two] > 1


@pytest.mark.parametrize(
    ("groups", "message"),
    [
        ({}, "no group 'payload', which 'mass' is per; expected one of 1kg, 2kg"),
        ({"payload": "3kg"}, "payload '3kg', for which 'mass' has no value"),
        ({"payload": "1kg", "colour": "red"}, "group 'colour', which nothing in the model is per"),
    ],
)
def test_a_proposed_record_of_unknown_groups_is_refused(groups, message):
    with pytest.raises(tn.InputError, match="with") as error:
        what_would_tell(swing(**groups))
    assert message in str(error.value)
