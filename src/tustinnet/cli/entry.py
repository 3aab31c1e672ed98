"""Entry point of the command; from the first moment on, signals end it with one line."""

from tustinnet.cli.terminal import shorten_warnings, stoppable


def run() -> None:
    """Runs the command."""
    with stoppable():
        shorten_warnings()
        from tustinnet.cli.main import run as command

        command()
