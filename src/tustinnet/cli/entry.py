"""Where the command begins: signals end it with one line from the first moment on."""

from tustinnet.cli.terminal import stoppable, shorten_warnings


def run() -> None:
    """Runs the command."""
    with stoppable():
        shorten_warnings()
        from tustinnet.cli.main import run as command

        command()
