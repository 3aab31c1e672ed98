"""What other programs take of the processors is measured and said."""

import pytest
from small_selection import NETWORK_ONLY, plan_in, swings

from tustinnet import cores
from tustinnet.cores import OtherPrograms
from tustinnet.selection.select import Reporter, SelectionOptions, select_model


@pytest.mark.parametrize(("others", "share"), [(5.0, 0.5), (-1.0, 0.0), (50.0, 0.9), (None, 0.0)])
def test_the_share_of_others_is_of_all_processors(others, share, monkeypatch):
    clock: list[float] = [100.0]
    seconds: list[float | None] = [7.0]
    monkeypatch.setattr(cores.time, "monotonic", lambda: clock[0])
    monkeypatch.setattr(cores.os, "cpu_count", lambda: 2)
    monkeypatch.setattr(cores, "_seconds_of_others", lambda: seconds[0])
    measured = OtherPrograms()
    clock[0] += 5.0
    seconds[0] = None if others is None else 7.0 + others
    assert measured.share == pytest.approx(share)


@pytest.mark.thorough
def test_a_busy_machine_is_named_with_the_budget_that_does_the_same(tmp_path, monkeypatch):
    monkeypatch.setattr(OtherPrograms, "share", 0.6)
    said: list[str] = []
    plan = plan_in(tmp_path, NETWORK_ONLY.replace("folds = 3 }", "folds = 1 }"))
    options = SelectionOptions(plan, budget=60.0)
    choice = select_model(swings(), tmp_path / "run", options, reporter=Reporter(said.append))
    line = "other programs used 60 % of the processors: `budget=` 150s does here what 60 s do "
    assert [note.text.startswith(line) for note in choice.findings].count(True) == 1
    assert said[-1].startswith(line)
