"""What is warned of, as the command tells it."""

import warnings

from tustinnet.cli.terminal import shorten_warnings


def test_a_warning_of_the_package_is_a_line_without_a_place_in_its_source(capsys, monkeypatch):
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    shorten_warnings()
    warnings.showwarning(UserWarning("slower"), UserWarning, "file.py", 3)
    assert capsys.readouterr().err == "note: slower\n"


def test_other_warnings_are_shown_as_python_shows_them(capsys, monkeypatch):
    shown: list[object] = []
    monkeypatch.setattr(warnings, "showwarning", lambda *given: shown.append(given[1]))
    shorten_warnings()
    warnings.showwarning(RuntimeWarning("overflow"), RuntimeWarning, "file.py", 3)
    assert shown == [RuntimeWarning]
    assert capsys.readouterr().err == ""
