"""Cells of tutorials, run in this process: what is imported and compiled serves them all."""

import ast
import contextlib
import json
import os
import socket
import subprocess
import sys
import types
from pathlib import Path

import matplotlib.pyplot as plt
from IPython.display import Image

from tustinnet.cli.main import run

SHELL = "%%bash\n"  # what shell cells begin with
# stands for the command in shell cells: asks this process to run it, with its own output
_COMMAND = """#!{python} -IS
import json, os, socket, sys
asked = socket.socket(socket.AF_UNIX)
asked.connect({place!r})
socket.send_fds(asked, [json.dumps([os.getcwd(), sys.argv[1:]]).encode()], [1, 2])
sys.exit(int(asked.recv(16) or b"1"))
"""


def _answer(asked: socket.socket) -> None:
    """Runs the command as a shell asks for it."""
    message, (out, err), _, _ = socket.recv_fds(asked, 2**16, 2)
    folder, arguments = json.loads(message)
    with (
        os.fdopen(out, "w") as text,
        os.fdopen(err, "w") as messages,
        contextlib.redirect_stdout(text),
        contextlib.redirect_stderr(messages),
        contextlib.chdir(folder),
    ):
        code = 0
        try:
            run(arguments)
        except SystemExit as ended:
            code = int(ended.code or 0)
    asked.send(str(code).encode())


def run_shell(script: str, beside: Path) -> str:
    """What a shell cell prints, every command of which must succeed.

    Args:
        script: the cell.
        beside: a folder for the command that it finds, and for what it prints.
    """
    place = str(beside / "asked")
    command = beside / "tustinnet"
    command.write_text(_COMMAND.format(python=sys.executable, place=place))
    command.chmod(0o755)
    env = os.environ | {"PATH": f"{beside}{os.pathsep}{os.environ['PATH']}"}
    told = beside / "told.txt"
    with socket.socket(socket.AF_UNIX) as server, told.open("w") as opened:
        server.bind(place)
        server.listen()
        server.settimeout(0.02)
        shell = subprocess.Popen(
            ["bash", "-e", "-o", "pipefail", "-c", script],
            stdout=opened,
            stderr=subprocess.STDOUT,
            env=env,
        )
        while shell.poll() is None:
            with contextlib.suppress(TimeoutError):
                asked, _ = server.accept()
                with asked:
                    _answer(asked)
    Path(place).unlink()
    text = told.read_text()
    assert shell.returncode == 0, text
    return text


class Notebook:
    """The names that cells share, as in a kernel."""

    def __init__(self) -> None:
        self._module = types.ModuleType("__main__")

    def run(self, source: str) -> list[object]:
        """Runs a Python cell, and gives the pictures that it shows."""
        names = vars(self._module)
        parts = ast.parse(source)
        last = parts.body.pop() if parts.body and isinstance(parts.body[-1], ast.Expr) else None
        exec(compile(parts, "cell", "exec"), names)
        shown = None
        if isinstance(last, ast.Expr):
            shown = eval(compile(ast.Expression(last.value), "cell", "eval"), names)
        pictures: list[object] = [shown.data] if isinstance(shown, Image) else []
        for number in plt.get_fignums():
            (canvas := plt.figure(number).canvas).draw()
            pictures.append(canvas)
        plt.close("all")
        return pictures
