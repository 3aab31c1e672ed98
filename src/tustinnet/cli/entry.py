"""Where the command begins: signals end it with one line from the first moment on."""

from tustinnet.cli.terminal import stoppable


def run() -> None:
    """Runs the command."""
    with stoppable():
        from tustinnet.cli.main import run as command

        command()
