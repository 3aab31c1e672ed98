"""A selection as a whole: what it chooses, writes, tells; stopped, resumed, refused."""

import itertools
import json
import signal
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from small_selection import NETWORK_ONLY, plan_in, swings
from swinging import SWING, TRUTH

import tustinnet as tn
from tustinnet.control.plants import load_rivals
from tustinnet.data.spoiled import spoiled_record
from tustinnet.errors import InputError
from tustinnet.evaluate.bands import Calibration
from tustinnet.evaluate.metrics import mean_and_error
from tustinnet.fits import deadline
from tustinnet.fits.in_folder import fit_in_folder
from tustinnet.fitting.gradient.epoch import _run
from tustinnet.models.physical_values import equations_in
from tustinnet.report.selection import candidates_table
from tustinnet.report.tables import Table
from tustinnet.selection import choice as chosen
from tustinnet.selection import final_models, jobs, queue, scoring, select
from tustinnet.selection.applicability import applicable_candidates
from tustinnet.selection.choice import Choice
from tustinnet.selection.jobs import Job, RunContext
from tustinnet.selection.plan import read_plan
from tustinnet.selection.ranking import CandidateResult
from tustinnet.selection.scoring import Scorer
from tustinnet.selection.select import Reporter, SelectionOptions, select_model
from tustinnet.store.header import find_fitted, read_header
from tustinnet.store.kept_system import HEADER
from tustinnet.store.model_file import read_system_name
from tustinnet.store.run_folder import Earlier, find_rivals
from tustinnet.systems.files import find_system


@pytest.fixture(autouse=True, scope="module")
def _rough_models():
    """Networks of a few epochs are far off over whole records, by which they are judged here."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(queue, "OPTIONS", queue.QueueOptions(far=1.0))
        yield


# solved, not trained: for what has nothing to do with training
SOLVED = NETWORK_ONLY.replace("small.toml", "linear")
ONE_FOLD = ("folds = 3\n", "folds = 3\nscored = 1\n")
GREY_ONCE = (
    NETWORK_ONLY.replace("network", "grey").replace("small.toml", "grey.toml").replace(*ONE_FOLD)
)


def selected(
    folder: Path, earlier: Earlier = "refuse", data=None, text: str = NETWORK_ONLY, **changes
):
    """A selection of the network alone, and the jobs that were done in it."""
    done: list[Job] = []

    def tell(job: Job):
        done.append(job)
        return Reporter().make_listener(job)

    options = SelectionOptions(plan_in(folder, text), **changes)
    choice = select_model(
        data or swings(), folder / "run", options, earlier, Reporter(make_listener=tell)
    )
    return choice, done


class Made(NamedTuple):
    choice: Choice
    said: list[str]


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Made:
    """A selection with a system, and what was said while it went on."""
    folder, said = tmp_path_factory.mktemp("selection"), []
    options = SelectionOptions(plan_in(folder), SWING)
    return Made(
        select_model(swings(), folder / "run", options, reporter=Reporter(said.append)), said
    )


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    return selected(tmp_path_factory.mktemp("alone"))


# --- what is chosen ---


@pytest.mark.thorough
def test_a_difference_on_a_single_record_is_said_to_be_on_too_few(made):
    def on_one(result: CandidateResult) -> CandidateResult:
        first, *_ = result.fits_by_fold[0]
        rmse = {start: dict([next(iter(of.items()))]) for start, of in first.rmse.items()}
        return replace(result, fits_by_fold={0: (replace(first, rmse=rmse),)})

    candidates = made.choice.candidates
    results = tuple(map(on_one, candidates.results))
    few = replace(candidates, results=results)
    choice = replace(made.choice, candidates=few, best="grey", simplest="grey")
    (difference,) = [f for f in choice.findings if f.code.startswith("not clearly better")]
    assert difference.text.endswith("on 1 record, too few to be sure")


def test_the_chosen_model_has_bands_from_the_records_that_folds_left_out(made):
    header = read_header(made.choice.context.folder / "model.safetensors")
    bands = Calibration.from_header(header, "model")
    assert sorted(bands.records) == sorted(e.name for e in swings())
    assert bands.start == made.choice.context.scoring.start
    assert any("bands (simulate `band=`) of up to 83 %" in of.text for of in made.choice.findings)
    assert header["identification"]["estimates"]  # without its errors it had no alternatives


def test_rivals_are_other_candidates_with_equations_of_motion(made, alone):
    folder, best = made.choice.context.folder, made.choice.best
    files = find_rivals(folder / "model.safetensors")
    assert files
    assert all(file.is_file() and best not in file.parts for file in files)
    rivals = load_rivals(folder / "model.safetensors", SWING)
    assert all(equations_in(model) is not None for model in rivals)
    means = {r.name: r.mean for r in made.choice.candidates.results if r.fits_by_fold}
    as_good = find_rivals(folder / "model.safetensors", as_good=True)
    names = {name for name, mean in means.items() if name != best and mean < 2 * means[best]}
    assert {file.parent.name for file in as_good} == names
    assert find_rivals(alone[0].context.folder / "candidates" / "nothing.safetensors") == []


def test_one_model_a_fold_says_nothing_of_bands(alone):
    choice, _ = alone
    assert choice.bands is None
    assert "bands" not in read_header(choice.context.folder / "model.safetensors")


def test_the_chosen_model_is_the_best_on_records_that_its_models_did_not_see(made):
    choice = made.choice
    means = {s.name: mean_and_error(s.rmse().values())[0] for s in choice.candidates.choosable}
    assert choice.best == min(means, key=lambda name: means[name])
    for result in choice.candidates.results:
        for fold, models in result.fits_by_fold.items():
            split = choice.context.splits[fold]
            for model in models:
                trained = {
                    r["name"]
                    for r in read_header(choice.context.folder / model.model)["data"]["records"]
                }
                scored = {e.name for e in split.scored}
                assert not trained & scored
                assert set(next(iter(model.rmse.values()))) == scored


def test_the_scores_are_those_of_the_models_in_the_folders(made):
    choice = made.choice
    first = choice.result("network").fits_by_fold[1][0]
    model = tn.load_model(choice.context.folder / first.model)
    for start, rmse in first.rmse.items():
        records = [choice.context.data[name] for name in rmse]
        again = {s.experiment: s.rmse for s in tn.evaluate(model, records, start)}
        assert again == pytest.approx(dict(rmse), rel=1e-9)


def test_parameters_of_a_chosen_system_are_identified_from_all_records(made):
    choice = made.choice
    assert {choice.best, choice.simplest} & {"grey"}
    assert choice.origins["grey"] == "identified from all 5 records"
    model: Any = tn.load_model(choice.context.folder / choice.file("grey"), SWING)
    for name in ("damping", "gravity", "gain"):
        assert float(model.continuous.values[name]) == pytest.approx(TRUTH[name], rel=0.03)


@pytest.mark.thorough
def test_networks_of_all_folds_become_their_average(alone):
    choice, _ = alone
    model = tn.load_model(choice.context.folder / "model.safetensors")
    each = [tn.load_model(choice.context.folder / m.model) for m in choice.result("network").fits]
    assert len(each) == 3
    x, u = jnp.array([0.3, -0.2]), jnp.array([0.7])
    mean = np.mean([np.asarray(m.step(x, u)) for m in each], axis=0)
    np.testing.assert_allclose(np.asarray(model.step(x, u)), mean, rtol=1e-6)
    assert choice.origins["network"] == "the average of the models of 3 folds"


def test_candidates_for_fast_records_are_left_out_of_slow_ones(tmp_path):
    both = NETWORK_ONLY.replace(
        "candidates = [", 'candidates = [{ name = "fast", recipe = "small.toml", when = "fast" }, '
    )
    plan = read_plan(plan_in(tmp_path, both))
    candidates, left_out = applicable_candidates(
        plan, RunContext(swings(), Scorer(3, "model-10")), None
    )
    assert [c.name for c in candidates] == ["network"]
    assert "left out, only for fast records: fast" in map(str, left_out)
    t = np.arange(200)
    fast = tn.DataSet(
        "fast",
        tuple(
            tn.from_arrays(np.sin(0.8 * t + i), dt=0.02, coordinates={"a": "angular"}, name=f"r{i}")
            for i in range(3)
        ),
    )
    context = RunContext(fast, Scorer(3, "model-10"))
    candidates, _ = applicable_candidates(plan, context, None)
    assert [c.name for c in candidates] == ["fast", "network"]


def test_a_mechanism_of_too_many_coordinates_is_left_out_before_anything_is_fitted():
    t = np.arange(200)[:, None] + np.arange(7)
    many = tn.from_arrays(
        np.sin(0.1 * t), dt=0.02, coordinates={f"q{i}": "angular" for i in range(7)}
    )
    records = tn.DataSet("many", tuple(replace(many, name=f"r{i}") for i in range(3)))
    context = RunContext(records, Scorer(3, "model-10"))
    candidates, left_out = applicable_candidates(read_plan("usual"), context, None)
    assert not [c.name for c in candidates if "mechanism" in c.name or "hybrid" in c.name]
    (reason,) = [str(line) for line in left_out if "coordinates" in str(line)]
    assert "7 coordinates; expected 6 at most" in reason
    assert reason.endswith(": mechanism, mechanism + end_stops")


# --- what is written and told ---


def test_summary_and_header_say_what_was_found(made):
    choice = made.choice
    summary = json.loads((choice.context.folder / "summary.json").read_text())
    assert summary["best"] == choice.best
    by_name = {c["name"]: c for c in summary["candidates"]}
    assert set(by_name) == {"grey", "network", "hybrid"}
    for name, of in by_name.items():
        assert [*of["starts"]] == [choice.result(name).start]
        judged = next(iter(of["starts"].values()))
        assert judged["rmse"] == pytest.approx(choice.result(name).rmse())
        assert judged["mean"] == pytest.approx(np.mean(list(judged["rmse"].values())))
    assert by_name[choice.best]["difference"]["mean"] == 0.0
    header = read_header(choice.context.folder / "model.safetensors")
    assert header["selection"]["chosen"] == choice.best
    start, scores = next(iter(by_name[choice.best]["starts"].items()))
    assert header["scores"]["start"] == start
    assert header["scores"]["mean"] == pytest.approx(scores["mean"])
    assert len(header["data"]["records"]) == 5
    inputs = np.concatenate([e.u for e in choice.context.data])
    assert header["range"]["inputs"] == [[inputs.min(), inputs.max()]]
    assert len(header["range"]["states"]) == choice.model.state_size


def test_plain_words_say_how_good_it_is_and_why_this_one(made):
    told = [f.text for f in made.choice.findings]
    assert told[0].startswith(f"chosen: {made.choice.best}, ")
    assert "free runs of 5 records that its models were not fitted to: " in told[1]
    assert "% of the error of standing still (" in told[1]
    table = candidates_table(made.choice)
    assert table.rows[-1][0] == "(standing still)"
    assert made.choice.as_plain()["reference"]["mean"] == made.choice.reference.mean
    assert told[2].startswith("follows ")
    assert set(made.choice.whole) == {e.name for e in made.choice.context.data}
    assert told[3].startswith("a new record of these kinds: typically ")
    assert " than the next, " in told[4]
    assert any(line.startswith("best so far: grey, off by ") for line in made.said)


def test_the_table_says_how_many_free_runs_are_lost(made):
    candidates = made.choice.candidates
    middle = float(np.median([*made.choice.result(made.choice.best).rmse().values()]))

    def table(lost: float) -> Table:
        results = tuple(replace(s, lost=lost) for s in candidates.results)
        return candidates_table(
            replace(made.choice, candidates=replace(candidates, results=results))
        )

    assert "lost" not in table(np.inf).markdown()
    assert table(middle).rows[0][-3] == "5, 2 lost"
    assert "a lost one is further off than records move" in table(middle).title


def test_words_say_of_how_many_records_and_when_no_candidate_is_close(made, monkeypatch):
    choice, name = made.choice, "grey"
    fewer = [
        replace(s, fits_by_fold={0: s.fits_by_fold[0]}) if s.name == name else s
        for s in choice.candidates.results
    ]
    candidates = replace(choice.candidates, results=tuple(fewer))
    cut = replace(choice, candidates=candidates, best=name)
    assert "free runs of 2 records (of 5) that its models" in cut.findings[1].text
    close = [monkeypatch.setattr(chosen, "_POOR", level) or cut.findings for level in (9.0, 0.0)]
    assert len(close[1]) == len(close[0]) + 1
    assert "no candidate follows these records closely" in "\n".join(map(str, close[1]))
    small = replace(choice.reference.scores[0], rmse=1e-6)
    lost = replace(choice, reference=replace(choice.reference, scores=(small,)))
    (short,) = [f.text for f in lost.findings if f.code == "nothing follows"]
    assert short.startswith("nothing follows these records better than standing still; look at ")
    # a record at rest beside one that moves tells nothing
    both = replace(choice.reference, scores=(small, choice.reference.scores[1]))
    assert not [f for f in replace(choice, reference=both).findings if f.code == "nothing follows"]


def with_errors(choice: Choice, *errors: float, kinds: str = "r") -> Choice:
    """A choice whose chosen candidate has these errors, a record each, on one fold."""
    rmse = {f"{kinds[i % len(kinds)]}{i}": error for i, error in enumerate(errors)}
    result = replace(
        choice.result("grey"),
        fits_by_fold={0: (replace(choice.result("grey").fits[0], rmse={"model-10": rmse}),)},
    )
    results = [result if r.name == "grey" else r for r in choice.candidates.results]
    return replace(
        choice, candidates=replace(choice.candidates, results=tuple(results)), best="grey"
    )


def test_words_say_how_far_off_a_new_record_may_be_and_when_the_mean_says_little(made):
    even, uneven = (with_errors(made.choice, *e) for e in ((0.1, 0.1, 0.2), (0.01, 0.01, 0.01, 9)))
    assert "typically 0.13 rad, " in even.findings[3].text
    assert not any("pessimistic" in line.text for line in even.findings)
    assert "pessimistic for most records, as few of them make it: r3;" in uneven.findings[4].text
    assert [e.findings[3].code for e in (even, uneven)] == ["expected", "expected vaguely"]
    assert "192 % of the error of standing still (1.18 rad); worst r3" in uneven.findings[1].text
    two = with_errors(made.choice, *(0.01, 5) * 3, kinds="ab").findings[4].text
    assert two.endswith("; typical of a kind: a 0.01, b 5 rad")
    assert even.as_plain()["claim"]["level"] == 0.9
    assert with_errors(made.choice, 0.1, 0.2).findings[3].code == "expected"
    # what left all bounds on one of its records is worse by no number
    other = replace(even.result("hybrid"), fits_by_fold={0: even.result("grey").fits})
    fit = replace(other.fits[0], rmse={"model-10": {"r0": 0.1, "r1": np.inf, "r2": 0.2}})
    beside = [even.result("grey"), replace(other, fits_by_fold={0: (fit,)})]
    alone = replace(even, candidates=replace(even.candidates, results=tuple(beside)))
    assert "compared with nothing" in [f.code for f in alone.findings]
    cut = replace(even, is_cut=True).findings
    assert [f.code for f in cut].count("pieces are alike") == 1


def test_the_time_of_a_selection_is_that_of_its_parts(made):
    parts = made.choice.seconds_by_part
    assert made.choice.seconds == pytest.approx(sum(parts.values()))
    tried = sum(r.seconds for r in made.choice.candidates.results)
    assert parts["candidates"] == pytest.approx(tried, rel=0.2)


@pytest.mark.thorough
def test_every_model_can_be_loaded(made):
    folder = made.choice.context.folder
    files = sorted(folder.glob("**/*.safetensors"))
    models = [f for f in files if f.name == "model.safetensors"]
    assert len(models) > 10
    for file in models:
        found = tn.load_model(file, SWING if read_system_name(file) else None)
        assert found.channels.n_q == 1


@pytest.mark.thorough
def test_where_whole_free_runs_say_nothing_a_horizon_is_judged_over_and_nothing_fitted_again(
    tmp_path, monkeypatch
):
    whole = scoring.score_runs

    def unstable(model, records, start, *, horizon=None):
        scores = whole(model, records, start, horizon=horizon)
        return [replace(s, rmse=np.inf) for s in scores] if horizon is None else scores

    monkeypatch.setattr(scoring, "score_runs", unstable)
    fitted: list[Path] = []
    monkeypatch.setattr(
        jobs,
        "fit_in_folder",
        lambda folder, *more, **named: (
            fitted.append(folder),
            fit_in_folder(folder, *more, **named),
        )[1],
    )
    choice, _ = selected(tmp_path, text=SOLVED)
    horizon = choice.context.scoring.horizon
    assert horizon == pytest.approx(0.1 * 200 * 0.02, abs=0.25)
    assert f"judged over pieces of {horizon:.3g} s instead" in choice.findings[-2].text
    assert len(fitted) == len(set(fitted)) == 3
    assert np.isfinite(list(choice.result("network").rmse().values())).all()


# --- stopped and resumed ---


def test_a_selection_is_refused_where_another_is(alone):
    choice, _ = alone
    with pytest.raises(InputError, match=r"earlier selection.*`resume=`"):
        selected(choice.context.folder.parent)


@pytest.mark.thorough
def test_resumed_it_does_no_job_twice_and_comes_to_the_same(alone):
    choice, _ = alone
    before = (choice.context.folder / "model.safetensors").read_bytes()
    again, told = selected(choice.context.folder.parent, "resume")
    assert len(told) == 3  # asked of, not fitted
    assert again.result("network").rmse() == choice.result("network").rmse()
    assert again.result("network").seconds == choice.result("network").seconds
    assert (choice.context.folder / "model.safetensors").read_bytes() == before


@pytest.mark.thorough
def test_a_job_of_other_records_is_done_again(tmp_path):
    data = swings()
    first, _ = selected(tmp_path, text=SOLVED)
    last = data[4]
    other = replace(data, experiments=(*data[:4], replace(last, q=last.q + 0.01)))
    with pytest.raises(InputError, match=r"another data \(noise3\)"):
        selected(tmp_path, "resume", other, SOLVED)
    (first.context.folder / "question.json").unlink()  # as of a folder that does not say it
    again, _ = selected(tmp_path, "resume", other, SOLVED)
    assert again.result("network").rmse() != first.result("network").rmse()


@pytest.mark.thorough
def test_a_damaged_account_of_a_job_is_not_believed(tmp_path, monkeypatch):
    first, _ = selected(tmp_path, text=SOLVED)
    paths = sorted(first.context.folder.glob("candidates/*/*/scores.json"))
    sound = [path.read_text() for path in paths]
    for path, text in zip(paths, ("{", "[]", sound[2].replace('"done"', '"fine"')), strict=True):
        path.write_text(text)
    fitted: list[Path] = []

    def fit(folder, *more, **named):
        fitted.append(folder)
        return fit_in_folder(folder, *more, **named)

    monkeypatch.setattr(jobs, "fit_in_folder", fit)
    again, _ = selected(tmp_path, "resume", text=SOLVED)
    assert len(fitted) == 3
    assert again.result("network").rmse() == first.result("network").rmse()


def compiled_programs() -> int:
    """How many programs of epochs have been compiled in this process."""
    of: Any = _run
    return of._cache_size()


@pytest.mark.thorough
def test_jobs_of_one_candidate_share_a_compiled_program(tmp_path):
    # other shapes than elsewhere: nothing is compiled yet
    data = swings()
    cut = replace(data, experiments=tuple(e[: len(e) - 7] for e in data))
    sizes: list[int] = []

    def tell(job: Job):
        sizes.append(compiled_programs())
        return Reporter().make_listener(job)

    options = SelectionOptions(plan_in(tmp_path, NETWORK_ONLY))
    select_model(cut, tmp_path / "run", options, "refuse", Reporter(make_listener=tell))
    assert sizes[1] == sizes[2] == sizes[0] + 1


# --- what does not go ---

TWO = """
name = "two"
folds = 3
start = "model-10"
candidates = [{ name = "grey", recipe = "grey.toml" }, { name = "network", recipe = "small.toml" }]
"""


def failing(monkeypatch, names: set[str], error: BaseException) -> None:
    """Fits of some candidates raise."""

    def fit(folder, *more, **named):
        if names & set(folder.parts):
            raise error
        return fit_in_folder(folder, *more, **named)

    monkeypatch.setattr(jobs, "fit_in_folder", fit)


def test_a_candidate_that_raises_is_told_in_a_line_and_the_others_go_on(tmp_path, monkeypatch):
    failing(monkeypatch, {"network"}, ZeroDivisionError("integer modulo\nby zero"))
    said: list[str] = []
    options = SelectionOptions(plan_in(tmp_path, TWO), SWING)
    choice = select_model(swings(), tmp_path / "run", options, reporter=Reporter(said.append))
    assert choice.best == "grey"
    why = "ZeroDivisionError: integer modulo by zero"
    assert said.count(f"network, fold 0: {why}") == 1
    assert choice.result("network").why == why
    failing(monkeypatch, {"network", "grey"}, MemoryError())
    with pytest.raises(InputError, match=r"no candidate could be fitted \(grey, network: MemoryE"):
        select_model(swings(), tmp_path / "none", options)


def test_an_identification_from_all_records_that_raises_leaves_the_models_of_folds(
    tmp_path, monkeypatch
):
    def fails(*arguments, **named):
        raise FloatingPointError("overflow")

    monkeypatch.setattr(final_models, "fit_in_folder", fails)
    plan = plan_in(tmp_path, GREY_ONCE)
    choice = select_model(swings(), tmp_path / "run", SelectionOptions(plan, SWING))
    assert choice.origins["grey"].endswith(
        "; not identified from all records: FloatingPointError: overflow"
    )
    assert (tmp_path / "run" / "model.safetensors").is_file()


def test_a_record_that_is_simulated_as_well_as_others_is_not_spoiled(tmp_path, monkeypatch):
    def every_record(model, records):
        return tuple(spoiled_record(e, "other conditions", "another payload?") for e in records)

    monkeypatch.setattr(select, "find_spoiled", every_record)
    plan = plan_in(tmp_path, GREY_ONCE)
    choice = select_model(swings(), tmp_path / "run", SelectionOptions(plan, SWING))
    scored = choice.result("grey").rmse().keys()
    assert scored
    assert {part.record for part in choice.spoiled} == {e.name for e in swings()} - scored


def test_a_parameter_at_its_bound_is_said_of_the_chosen_model(tmp_path):
    narrow = [
        replace(p, upper=0.8 * TRUTH["gravity"]) if p.name == "gravity" else p
        for p in SWING.parameters
    ]
    plan = plan_in(tmp_path, GREY_ONCE)
    options = SelectionOptions(plan, replace(SWING, parameters=tuple(narrow)))
    choice = select_model(swings(), tmp_path / "run", options)
    assert any("'gravity' is at its upper bound" in f.text for f in choice.findings)


def test_an_interruption_before_the_first_score_ends_the_selection(tmp_path, monkeypatch):
    failing(monkeypatch, {"network"}, KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        selected(tmp_path)
    assert not (tmp_path / "run" / "model.safetensors").exists()


class Signal(KeyboardInterrupt):
    """An interruption as the command raises it."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


def test_an_interruption_ends_with_the_best_so_far_and_a_resumed_run_goes_on(tmp_path, monkeypatch):
    said: list[str] = []
    options = SelectionOptions(plan_in(tmp_path, TWO), SWING)
    with monkeypatch.context() as patch:
        failing(patch, {"network"}, Signal(signal.SIGINT))
        choice = select_model(swings(), tmp_path / "run", options, reporter=Reporter(said.append))
    assert choice.best == "grey"
    assert choice.origins["grey"].startswith("the ")
    assert "interrupted: ends with the best so far, grey; once more: at once" in said
    assert choice.findings[-1].text.startswith("interrupted: the best so far was taken")
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["best"] == "grey"
    model = tn.load_model(tmp_path / "run" / "model.safetensors", SWING)
    assert tn.evaluate(model, [swings()[0]], "model-10")[0].rmse < 0.1
    again = select_model(swings(), tmp_path / "run", options, "resume")
    assert again.result("network").fits_by_fold.keys() == {0, 1, 2}
    # it is ahead, and fitted to further records
    assert again.result("grey").rmse().items() >= choice.result("grey").rmse().items()


def test_another_signal_and_a_second_interruption_end_it_at_once(tmp_path, monkeypatch):
    options = SelectionOptions(plan_in(tmp_path, TWO), SWING)
    with monkeypatch.context() as patch:
        failing(patch, {"network"}, Signal(signal.SIGTERM))
        with pytest.raises(Signal):
            select_model(swings(), tmp_path / "run", options)
    failing(monkeypatch, {"network"}, Signal(signal.SIGINT))
    monkeypatch.setattr("tustinnet.selection.select.make_final_models", _interrupted)
    with pytest.raises(KeyboardInterrupt):
        select_model(swings(), tmp_path / "run", options, "discard")
    assert not (tmp_path / "run" / "model.safetensors").exists()
    assert not (tmp_path / "run" / "summary.json").exists()


def _interrupted(*_: Any) -> None:
    raise KeyboardInterrupt


def test_an_interruption_of_what_comes_after_the_candidates_ends_with_the_best(
    tmp_path, monkeypatch
):
    times = iter([True, False])

    def make(*arguments: Any) -> Any:
        if next(times):
            raise KeyboardInterrupt
        assert arguments[-1].remaining <= 0
        return final_models.make_final_models(*arguments)

    monkeypatch.setattr("tustinnet.selection.select.make_final_models", make)
    choice, _ = selected(tmp_path, text=SOLVED)
    assert choice.best == "network"
    assert choice.findings[-1].text.startswith("interrupted: ")


def outcomes(choice: Choice) -> list[tuple[str, str]]:
    """How the jobs of the network ended, as their files have it, and its first training."""
    found = []
    for path in sorted(choice.context.folder.glob("candidates/network/*/scores.json")):
        result = json.loads(path.read_text())["result"]
        found.append((result["ended"], result["scores"][0]["outcome"]))
    return found


@pytest.mark.thorough
def test_a_training_that_is_stopped_is_scored_and_a_resumed_run_goes_on_with_it(
    alone, tmp_path, monkeypatch
):
    with monkeypatch.context() as patch:
        patch.setattr(deadline.Deadline, "comes_within", lambda self, seconds: True)
        stopped, _ = selected(tmp_path)
    assert outcomes(stopped) == [("out of time", "out of time")] * 3
    assert np.isfinite(list(stopped.result("network").rmse().values())).all()
    assert any("trainings stopped by the budget: 3 of 3" in s.text for s in stopped.findings)
    header = read_header(stopped.context.folder / stopped.result("network").fits[0].model)
    assert header["training"]["outcome"] == "out of time"
    resumed, _ = selected(tmp_path, "resume")
    assert outcomes(resumed) == [("done", "finished")] * 3
    assert resumed.result("network").rmse() == alone[0].result("network").rmse()


def test_a_training_that_reaches_the_deadline_is_chosen_with_its_best_weights(
    tmp_path, monkeypatch
):
    check, skipped = deadline.Deadline.comes_within, [0.0]

    def later(self, seconds):
        skipped[0] = 15.0  # once the training has begun, it takes most of the budget at a stroke
        return check(self, seconds)

    clock = SimpleNamespace(monotonic=lambda: time.monotonic() + skipped[0])
    monkeypatch.setattr(deadline, "time", clock)
    monkeypatch.setattr(deadline.Deadline, "comes_within", later)
    text = NETWORK_ONLY.replace(
        'recipe = "small.toml"', 'recipe = "small.toml", set = ["stages.0.epochs=100000"]'
    ).replace("folds = 3 }", "folds = 1 }")
    options = SelectionOptions(plan_in(tmp_path, text), budget=20.0)
    choice = select_model(swings(), tmp_path / "run", options)
    assert outcomes(choice) == [("out of time", "out of time")]
    assert choice.best == "network"
    assert choice.seconds < 60


def stop_searches(monkeypatch, asked: int) -> None:
    """The deadline of every identification of a fold comes when it has asked for it so often."""

    def fit(folder, task, listener, **named):
        questions = itertools.count()
        stopped = replace(listener, should_stop=lambda seconds: next(questions) >= asked)
        return fit_in_folder(folder, task, stopped, **named)

    monkeypatch.setattr(jobs, "fit_in_folder", fit)


def test_an_identification_that_is_stopped_is_scored_and_a_resumed_run_repeats_it(
    tmp_path, monkeypatch
):
    options = SelectionOptions(plan_in(tmp_path, GREY_ONCE), SWING)
    said: list[str] = []

    def select(earlier: Earlier) -> tuple[Choice, list[tuple[str, str]]]:
        choice = select_model(swings(), tmp_path / "run", options, earlier, Reporter(said.append))
        paths = sorted(choice.context.folder.glob("candidates/grey/*/scores.json"))
        results = [json.loads(path.read_text())["result"] for path in paths]
        return choice, [(r["ended"], r["scores"][0]["outcome"]) for r in results]

    with monkeypatch.context() as patch:
        stop_searches(patch, 0)
        with pytest.raises(InputError, match=r"before a stage of its search.*more time: `budget=`"):
            select("refuse")
        stop_searches(patch, 3)
        stopped, ended = select("resume")
    assert [e for e, _ in ended] == ["out of time"]
    assert all("stopped at its time limit after stage 1 of " in outcome for _, outcome in ended)
    assert np.isfinite(list(stopped.result("grey").rmse().values())).all()
    assert (
        "grey, fold 0: its share of the budget was spent: its last finished stage is scored" in said
    )
    assert any("identifications stopped by the budget: 1 of 1" in s.text for s in stopped.findings)
    resumed, ended = select("resume")
    assert [e for e, _ in ended] == ["done"]
    assert all(outcome.startswith("converged") for _, outcome in ended)
    assert not any("stopped by the budget" in s.text for s in resumed.findings)


@pytest.mark.thorough
def test_no_unfinished_search_from_all_records_is_taken_instead_of_finished_ones(
    tmp_path, monkeypatch
):
    questions = itertools.count()

    def fit(folder, task, listener, **named):
        stopped = replace(listener, should_stop=lambda seconds: next(questions) >= 4)
        return fit_in_folder(folder, task, stopped, **named)

    monkeypatch.setattr("tustinnet.selection.final_models.fit_in_folder", fit)
    choice = select_model(
        swings(), tmp_path / "run", SelectionOptions(plan_in(tmp_path, GREY_ONCE), SWING)
    )
    assert choice.origins["grey"].startswith("the model of one fold")
    assert choice.origins["grey"].endswith("no time was left to identify it from all records")
    fitted = find_fitted(tn.read_header(tmp_path / "run" / "model.safetensors"), swings())
    assert 0 < len(fitted) < len(swings())


@pytest.mark.thorough
def test_a_training_that_the_budget_stops_is_scored_with_the_weights_that_it_has(tmp_path):
    changes = '["stages.0.epochs=100000", "stages.0.keep=last"]'
    text = NETWORK_ONLY.replace('recipe = "small.toml"', f'recipe = "small.toml", set = {changes}')
    options = SelectionOptions(plan_in(tmp_path, text), budget=20.0)
    choice = select_model(swings(), tmp_path / "run", options)
    assert any("stopped by the budget: " in line.text for line in choice.findings)


def test_one_record_is_cut_and_told(tmp_path):
    one = replace(swings(), experiments=(swings()[0],))
    short = replace(one, experiments=(one[0][:149],))
    with pytest.raises(InputError, match=r"fall1.*149 samples, too few.*at least 50, 3 in all"):
        selected(tmp_path, data=short, text=SOLVED)
    long = replace(
        one,
        experiments=(
            tn.from_arrays(
                np.tile(one[0].q[:, 0], 4),
                np.zeros(800),
                dt=0.02,
                name="long",
                coordinates=one[0].coordinates,
                inputs=one[0].inputs,
            ),
        ),
    )
    choice, _ = selected(tmp_path, data=long, text=SOLVED)
    assert "cut into 6 pieces in time" in choice.findings[-2].text
    assert len(choice.result("network").rmse()) == 6


@pytest.mark.thorough
def test_test_records_take_part_in_nothing(tmp_path):
    data = swings()
    kept = replace(data[0], split="test")
    choice, _ = selected(tmp_path, data=replace(data, experiments=(kept, *data[1:])), text=SOLVED)
    assert kept.name not in choice.result("network").rmse()
    told = read_header(choice.context.folder / "model.safetensors")["data"]["records"]
    assert kept.name not in [r["name"] for r in told]


def test_what_means_nothing_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"`system=`.*not applicable to the plan 'network only'"):
        selected(tmp_path, system=SWING)
    with pytest.raises(InputError, match=r"`budget=`.*-1"):
        selected(tmp_path, budget=-1.0)


def test_candidates_of_a_system_are_left_out_without_one(tmp_path):
    said: list[str] = []
    plan = plan_in(tmp_path).read_text().replace("small.toml", "linear")
    options = SelectionOptions(plan_in(tmp_path, plan.replace(*ONE_FOLD)))
    choice = select_model(swings(), tmp_path / "run", options, reporter=Reporter(said.append))
    assert said[0] == "left out, requires a system (`system=`): grey, hybrid"
    assert choice.best == "network"
    bands = "no bands around free runs (the chosen model: does not say how sure it is)"
    assert [f.text for f in choice.findings[-2:]] == [said[0], bands]


MECHANISM = """
name = "unknown"
folds = 3
start = "model-10"

[[candidates]]
name = "mechanism"
recipe = "mechanism"
set = ["search.refine=none", "search.substeps=1"]
when = "no-system"

[[candidates]]
name = "hybrid"
recipe = "hybrid.toml"
corrects = ["mechanism"]
"""


@pytest.mark.thorough
def test_without_a_system_a_mechanism_is_found_and_corrected(tmp_path):
    plan = plan_in(tmp_path, MECHANISM)
    with pytest.raises(InputError, match=r"only without a system: mechanism, hybrid"):
        select_model(swings(), tmp_path / "refused", SelectionOptions(plan, SWING))
    one_fold = plan_in(tmp_path, MECHANISM.replace(*ONE_FOLD))
    choice = select_model(swings(), tmp_path / "run", SelectionOptions(one_fold))
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    of = {c["name"]: c for c in summary["candidates"]}
    assert of["mechanism"]["starts"]["model-10"]["mean"] < 0.02
    assert len(of["hybrid"]["folds"]) == 1
    for name in ("mechanism", "hybrid"):
        model = tn.load_model(tmp_path / "run" / of[name]["models"][0])
        assert tn.evaluate(model, [swings()[0]], "model-10")[0].rmse < 0.1
    assert tn.load_model(tmp_path / "run" / "model.safetensors").channels == choice.model.channels


@pytest.mark.thorough
def test_a_mechanism_competes_with_a_system_that_is_given(tmp_path):
    content = (
        MECHANISM.replace('when = "no-system"\n', "")
        .replace(
            'name = "hybrid"\nrecipe = "hybrid.toml"\ncorrects = ["mechanism"]',
            'name = "grey"\nrecipe = "grey.toml"',
        )
        .replace(*ONE_FOLD)
    )
    (file := tmp_path / "swing.py").write_text("from swinging import SWING as SYSTEM\n")
    plan = plan_in(tmp_path, content)
    select_model(swings(), tmp_path / "run", SelectionOptions(plan, find_system(file)))
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    of = {c["name"]: c for c in summary["candidates"]}
    files = {name: tmp_path / "run" / of[name]["models"][0] for name in ("mechanism", "grey")}
    assert {name: read_system_name(path) for name, path in files.items()} == {
        "mechanism": "mechanism",
        "grey": "swing",
    }
    # a mechanism is in its own file; the other one belongs to the copy of the system
    assert [name for name, path in files.items() if HEADER in read_header(path)] == ["grey"]
    model = tn.load_model(files["mechanism"])
    assert tn.evaluate(model, [swings()[0]], "model-10")[0].rmse < 0.1


def test_models_of_several_systems_are_not_averaged():
    first = tn.discretise(SWING.model({k: jnp.asarray(x) for k, x in TRUTH.items()}), 0.02, 1)
    other = replace(SWING, name="other").model({k: jnp.asarray(x) for k, x in TRUTH.items()})
    with pytest.raises(InputError, match="models of the systems swing, other"):
        final_models._average([first, tn.discretise(other, 0.02, 1)])


@pytest.mark.thorough
def test_the_file_of_a_system_is_run_once(tmp_path):
    runs, file = tmp_path / "runs.txt", tmp_path / "swing.py"
    file.write_text(
        f"with open({str(runs)!r}, 'a') as log:\n    log.write('run\\n')\n"
        "from swinging import SWING as SYSTEM\n"
    )
    plan = plan_in(tmp_path, GREY_ONCE)
    options = SelectionOptions(plan, find_system(file))
    choice = select_model(swings(), tmp_path / "run", options)
    assert choice.origins["grey"] == "identified from all 5 records"
    assert runs.read_text() == "run\n"
