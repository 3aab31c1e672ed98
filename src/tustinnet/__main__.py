"""The command as `python -m tustinnet`."""

from tustinnet.cli.entry import run

if __name__ == "__main__":
    run()
