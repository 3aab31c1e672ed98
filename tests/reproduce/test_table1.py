"""Table 1: its rows, formats and choices, on a stand-in with the published layout."""

import json
from dataclasses import replace

import numpy as np
import pytest

import tustinnet as tn
from tustinnet.data.catalog import QUBE_SERVO2
from tustinnet.fitting.listener import SILENT
from tustinnet.reproduce import figures, table1
from tustinnet.reproduce.published import AUTHORS_ROWS, TABLE_1, load_authors_weights


@pytest.fixture
def layout(tmp_path):
    """A folder of short records that go by the published names, and weights like the authors'."""
    generator = np.random.default_rng(0)
    for file in QUBE_SERVO2.checksums():
        path = tmp_path / "qube" / file
        path.parent.mkdir(parents=True, exist_ok=True)
        n = 120
        t = np.arange(n) * 0.01
        u = generator.uniform(-2, 2, n) if "wN" in file else np.zeros(n)
        q = np.column_stack([0.3 * np.sin(3 * t), np.pi + np.exp(-t) * np.cos(8 * t)])
        v = np.gradient(q, 0.01, axis=0)
        v[:3] = v[-2:] = 0.0
        np.savetxt(path, np.column_stack([u, q, t, v]), delimiter=",")
    weights = tmp_path / "qube" / "authors_weights"
    weights.mkdir()
    shapes = {"fc1": (9, 7), "fc2": (8, 9), "fc3": (8, 8), "fc4": (2, 8)}
    for stem in AUTHORS_ROWS.values():
        arrays = {}
        for name, shape in shapes.items():
            arrays[f"{name}.weight"] = generator.normal(0, 0.01, shape).astype(np.float32)
            arrays[f"{name}.bias"] = np.zeros(shape[0], np.float32)
        np.savez(weights / f"{stem}.npz", velocity_scale=np.array([6.8, 1.5]), **arrays)
    return tmp_path / "qube"


def authors_rows(layout, split):
    options = table1.ReproductionOptions(["authors"], split)
    return table1.build_rows(tn.load(layout), layout, options, layout / "runs", lambda name: SILENT)


@pytest.mark.thorough
def test_the_test_split_is_scored_where_it_is_there_else_validation(layout):
    data = tn.load(layout)
    assert table1.choose_split(data, None) == "test"
    assert table1.choose_split(data, "validation") == "validation"
    for path in (layout / "test").iterdir():
        path.unlink()
    assert table1.choose_split(tn.load(layout), None) == "validation"
    with pytest.raises(tn.InputError, match="no split 'test'"):
        table1.choose_split(tn.load(layout), "test")


def test_the_test_records_come_in_the_papers_order(layout):
    names = [e.name for e in tn.load(layout).split("test")]
    falls = [f"fallTest{i}" for i in range(1, 5)]
    assert names == [*falls, "wN_2V", "wN_2_5V", "wN_3V", "wN_3_5V"]


@pytest.mark.thorough
def test_the_json_says_split_units_start_records_and_rows(layout):
    content = json.loads(json.dumps(table1.as_json(authors_rows(layout, "test"), "test")))
    assert (content["split"], content["units"], content["x0"]) == ("test", "rad", "file")
    assert [r["model"] for r in content["rows"]] == list(AUTHORS_ROWS)
    row = content["rows"][0]
    assert set(row) == {
        "model",
        "seed",
        "recipe",
        "rmse",
        "mean",
        "train_seconds",
        "windows",
        "epochs",
    }
    assert "start" not in row  # that of the table; rows that start otherwise say so
    assert list(row["rmse"]) == content["experiments"]
    assert row["mean"] == pytest.approx(np.mean(list(row["rmse"].values())))


@pytest.mark.thorough
def test_the_papers_own_numbers_stand_beside_ours_on_its_own_records(layout):
    table = table1.as_table(authors_rows(layout, "test"), "test")
    paper = next(row for row in table.rows if row[0].endswith("(Algorithm 1)"))
    assert paper[1:] == [
        "0.075",
        "0.153",
        "0.111",
        "0.094",
        "0.103",
        "0.142",
        "0.168",
        "0.177",
        "0.128",
    ]
    validation = table1.as_table(authors_rows(layout, "validation"), "validation")
    assert validation.rows[0][1:] == [*["–"] * 6, "0.171*"]


def test_the_papers_means_are_those_it_reports():
    means = [round(float(np.mean(values)), 3) for values in TABLE_1.values()]
    assert means == [0.171, 0.261, 0.128]


def test_several_seeds_get_a_row_with_their_median_and_range(layout):
    row = authors_rows(layout, "test")[0]
    rows = [table1.Row("tustin-transfer", seed, "r", row.scores, row.model) for seed in (0, 1, 2)]
    last = table1.as_table(rows, "test").rows[-1]
    assert last[0] == "tustin-transfer, median of 3 seeds"
    assert last[-1].count("..") == 1


def test_tables_come_in_markdown_and_latex(layout):
    table = table1.as_table(authors_rows(layout, "test"), "test")
    assert "| model | fallTest1 |" in table.markdown()
    assert r"wN\_2\_5V" in table.latex()
    assert table.latex().count(r"\\") == len(table.rows) + 1


@pytest.mark.thorough
def test_figures_are_drawn_for_every_record_and_figure_4_for_the_papers(layout, tmp_path):
    data = tn.load(layout)
    assert figures.choose_experiment(data, "test", None) == "fallTest4"
    assert figures.choose_experiment(data, "validation", None) == "fallVal4"
    assert figures.choose_experiment(data, "test", "wN_3V") == "wN_3V"
    with pytest.raises(tn.InputError, match="no record 'fallVal1'"):
        figures.choose_experiment(data, "test", "fallVal1")
    rows = authors_rows(layout, "validation")
    written = figures.draw(data, rows, "validation", "fallVal4", tmp_path / "out")
    names = {p.name for p in written}
    assert {
        "figure1.svg",
        "figure2.svg",
        "figure4.png",
        "figure4.svg",
        "free_run_wN_3_5V_val.png",
    } <= names
    assert all(p.stat().st_size > 1000 for p in written)


def test_models_are_chosen_by_name(layout, tmp_path):
    assert table1.choose_models([], layout) == (
        [
            "authors",
            "tustin-standard",
            "tustin-transfer",
            "euler-lagrange",
            "euler-lagrange-naive",
            "best-tustin",
            "best-grey",
            "best-hybrid",
        ],
        "",
    )
    models, remark = table1.choose_models([], tmp_path / "elsewhere")
    assert models == [
        "tustin-standard",
        "tustin-transfer",
        "euler-lagrange",
        "euler-lagrange-naive",
        "best-tustin",
        "best-grey",
        "best-hybrid",
    ]
    assert "left out" in remark
    listed = ["authors, gru", "linear", "gru"]
    assert table1.choose_models(listed, layout) == (["authors", "gru", "linear"], "")
    with pytest.raises(tn.InputError, match="unknown model 'lstm'"):
        table1.choose_models(["lstm"], layout)
    with pytest.raises(tn.InputError, match="authors"):
        table1.choose_models(["authors"], tmp_path / "elsewhere")


def test_files_that_are_not_the_authors_weights_are_refused(layout):
    data = tn.load(layout)
    with pytest.raises(tn.InputError, match="no such file"):
        load_authors_weights(layout / "none.npz", data)
    np.savez(layout / "other.npz", a=np.zeros(2))
    with pytest.raises(tn.InputError, match="not the authors' weights"):
        load_authors_weights(layout / "other.npz", data)


def test_reproduce_writes_tables_and_figures_and_trains_on_no_test_record(
    layout, tmp_path, capsys, monkeypatch
):
    from tustinnet.cli.main import run

    changes = ["epochs=1", "windows.length=20", "windows.step=30"]
    short = tn.read_recipe("paper-code-transfer", [f"stages.*.{c}" for c in changes])
    monkeypatch.setattr(table1, "read_recipe", lambda name: short)
    out = tmp_path / "out"
    with pytest.raises(SystemExit) as ended:
        run(
            [
                "reproduce",
                "--data",
                str(layout),
                "--out",
                str(out),
                "--models",
                "tustin-transfer",
                "--json",
                "--quiet",
            ]
        )
    assert not ended.value.code
    captured = capsys.readouterr()
    assert "scoring the test split" in captured.err
    assert "not as published" in captured.err
    content = json.loads((out / "table1.json").read_text())
    assert json.loads(captured.out) == content
    row = content["rows"][0]
    assert (row["model"], row["seed"], row["recipe"]) == (
        "tustin-transfer",
        0,
        "paper-code-transfer",
    )
    assert len(row["windows"]) == len(row["epochs"]) == 2
    assert row["train_seconds"] > 0
    model = tn.read_header(out / "runs" / "tustin-transfer" / "model.safetensors")
    assert "test" not in {record["split"] for record in model["data"]["records"]}
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "Show tustin-transfer" in page
    assert "it is off by " in page
    assert "6 of 8 test records" in page
    assert f"report: {out / 'report.html'}" in captured.err
    for name in ("table1.md", "table1.tex", "free_run_fallTest4.png", "free_run_fallTest4.svg"):
        assert (out / name).is_file()


@pytest.mark.thorough
def test_a_row_that_starts_otherwise_than_the_table_says_so(layout):
    row = authors_rows(layout, "test")[0]
    scores = tuple(replace(score, start="warm-up-20") for score in row.scores)
    other = replace(row, name="gru", scores=scores)
    (told,) = table1.as_json([other], "test")["rows"]
    assert told["start"] == "warm-up-20"
    assert any("gru, from warm-up-20" in line[0] for line in table1.as_table([other], "test").rows)
