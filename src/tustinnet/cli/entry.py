"""Where the command begins: signals end it with one line from the first moment on."""

from tustinnet.cli.terminal import stoppable, tell_warnings


def run() -> None:
    """Runs the command."""
    with stoppable():
        tell_warnings()
        from tustinnet.cli.main import run as command

        command()
