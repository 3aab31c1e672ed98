"""Records as a folder of CSV files with a data card."""

from pathlib import Path

import numpy as np

from tustinnet.artifact.files import require_new, require_writable_folder, write_atomically
from tustinnet.data.catalog import CARD_NAME
from tustinnet.data.dataset import DataSet
from tustinnet.data.experiment import Experiment


def write_data_set(
    data: DataSet, folder: Path, description: str, *, overwrite: bool = False
) -> Path:
    """Writes records in the layout of the published Qube-Servo 2 logs, and a card that reads them.

    Columns without header: inputs, positions, time, then velocities where the records have them.

    Args:
        data: the records.
        folder: where to; a file a record in a subfolder a split.
        description: what the card says of them.
        overwrite: replace files that are there.

    Returns:
        The data card.
    """
    paths = {e.name: folder / (e.split or "") / f"{e.name}.csv" for e in data}
    card = folder / CARD_NAME
    require_new([card, *paths.values()], overwrite=overwrite)
    require_writable_folder(folder)
    for e in data:
        write_atomically(paths[e.name], _rows(e))
    write_atomically(card, _card(data, folder, paths, description))
    return card


def _rows(e: Experiment) -> str:
    columns = [e.u, e.q, e.t[:, None], *([] if e.v is None else [e.v])]
    table = np.concatenate(columns, axis=1)
    return "".join(",".join(f"{x:.9g}" for x in row) + "\n" for row in table)


def _card(data: DataSet, folder: Path, paths: dict[str, Path], description: str) -> str:
    first = data[0]
    n_u, n_q = len(first.inputs), len(first.coordinates)
    time = n_u + n_q + 1
    lines = [
        f'name = "{data.name}"',
        f'description = "{description}"',
        f"dt = {data.dt!r}",
        "",
        "[format]",
        "header = false",
        f"columns = {time + (0 if first.v is None else n_q)}",
        "",
        "[time]",
        f"column = {time}",
    ]
    for i, channel in enumerate(first.inputs):
        lines += [
            "", "[[inputs]]", f'name = "{channel.name}"', f"column = {i + 1}",
            f'unit = "{channel.unit}"', f'hold = "{channel.hold}"',
        ]  # fmt: skip
        if channel.limits:
            lines.append(f"limits = [{channel.limits[0]!r}, {channel.limits[1]!r}]")
    for j, c in enumerate(first.coordinates):
        lines += [
            "", "[[coordinates]]", f'name = "{c.name}"', f'kind = "{c.kind}"',
            f"column = {n_u + j + 1}", f'unit = "{c.unit}"',
        ]  # fmt: skip
        if c.resolution:
            lines.append(f"resolution = {c.resolution!r}")
        if first.v is not None:
            measured = "true" if first.v_measured else "false"
            lines.append(
                f'velocity = {{ column = {time + j + 1}, unit = "{c.unit}/s", '
                f"measured = {measured} }}"
            )
    lines += ["", "[splits]"]
    for split in data.splits:
        lines.append(f"{split} = [")
        lines += [
            f'  {{ file = "{paths[e.name].relative_to(folder).as_posix()}", name = "{e.name}" }},'
            for e in data.split(split)
        ]
        lines.append("]")
    return "\n".join(lines) + "\n"
