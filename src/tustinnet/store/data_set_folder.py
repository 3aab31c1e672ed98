"""Records as a folder of CSV files with a data card."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tustinnet.channels import Input, PDLoop
from tustinnet.data.catalog import CARD_NAME
from tustinnet.data.dataset import DataSet
from tustinnet.data.declaration import bare_key, quote
from tustinnet.store.files import require_outputs, require_writable_folder, write_into


def write_data_set(
    data: DataSet, folder: Path, description: str, *, overwrite: bool = False
) -> Path:
    """Writes records in the layout of the published Qube-Servo 2 logs, and a card that reads them.

    Columns without header: inputs, positions, time, then velocities where the records have them,
    and what a controller in the loop computed.

    Args:
        data: the records.
        folder: where to; a file a record in a subfolder a split.
        description: a sentence for the card.
        overwrite: replace files that are there.

    Returns:
        The data card.
    """
    files = {e.name: f"{e.split}/{e.name}.csv" if e.split else f"{e.name}.csv" for e in data}
    card = folder / CARD_NAME
    require_outputs([card, *(folder / file for file in files.values())], overwrite=overwrite)
    require_writable_folder(folder)
    for e in data:
        columns = [e.u, e.q, e.t[:, None], *(x for x in (e.v, e.outputs) if x is not None)]
        lines = [",".join(f"{x:.9g}" for x in row) for row in np.concatenate(columns, axis=1)]
        write_into(folder, files[e.name], "".join(f"{line}\n" for line in lines))
    first, channels = data[0], data.channels
    time = channels.n_u + channels.n_q + 1
    width = time + (0 if first.v is None else channels.n_q)
    places = {i.name: k for k, i in enumerate(channels.inputs, 1)}
    loops = () if channels.controller is None else channels.controller.loops
    if first.outputs is not None:
        places |= {loop.input: k for k, loop in enumerate(loops, width + 1)}
        width += len(loops)
    coordinates = []
    for k, c in enumerate(channels.coordinates, channels.n_u + 1):
        entry = c.as_header() | {"column": k, "unit": c.unit}
        if first.v is not None:
            speed = {"column": k + channels.n_q + 1, "unit": f"{c.unit}/s"}
            entry["velocity"] = speed | {"measured": first.v_measured}
        coordinates.append(entry)
    splits = {
        split: [
            {"file": files[e.name], "name": e.name}
            | ({"groups": dict(e.groups)} if e.groups else {})
            for e in data.split(split)
        ]
        for split in data.splits
    }
    content = {
        "name": data.name,
        "description": description,
        "dt": data.dt,
        "format": {"header": False, "columns": width},
        "time": {"column": time},
        "inputs": [_input_entry(i, places.get(i.name)) for i in channels.plant.inputs],
        "coordinates": coordinates,
        "splits": splits,
    }
    if loops:
        kind = "pid" if any("ki" in loop.gains for loop in loops) else "pd"
        entries = [_loop_entry(loop, kind, places) for loop in loops]
        content["controller"] = {"kind": kind, "loops": entries}
    write_into(folder, CARD_NAME, _to_toml(content))
    return card


def _input_entry(i: Input, column: int | None) -> dict[str, Any]:
    """The entry of an input in a card."""
    entry = i.as_header() | {"hold": i.hold or "zero-order", "column": column}
    if i.delay is None:
        entry["delay"] = "unknown"
    elif i.delay == 0 and not (i.is_delay_declared and column):
        del entry["delay"]
    return entry


def _loop_entry(loop: PDLoop, kind: str, places: Mapping[str, int]) -> dict[str, Any]:
    """The entry of a loop in a card, with its columns by the names of inputs."""
    entry = loop.as_header()
    if kind == "pid" and loop.ki == 0:
        entry["ki"] = 0.0  # without this key the gain would be searched for
    set_points = ("position", "velocity", "feedforward")
    return entry | {key: places[name] for key in set_points if (name := entry.pop(key))}


def _to_toml(content: Mapping[str, Any]) -> str:
    """A card as TOML: values, then tables, and lists of tables."""
    plain, tables = [], []
    for name, value in content.items():
        if isinstance(value, dict):
            tables += ["", f"[{name}]", *_lines(value)]
        elif isinstance(value, list) and value:
            tables += [line for row in value for line in ("", f"[[{name}]]", *_lines(row))]
        else:
            plain += _lines({name: value})
    return "\n".join([*plain, *tables]) + "\n"


def _lines(table: Mapping[str, Any]) -> list[str]:
    """The lines of a table, without values that are None."""
    values = ((key, value) for key, value in table.items() if value is not None)
    return [f"{bare_key(key)} = {_value(value)}" for key, value in values]


def _value(value: Any) -> str:
    """A value as TOML has it, on one line."""
    if isinstance(value, str):
        return quote(value)
    if isinstance(value, dict):
        return f"{{ {', '.join(_lines(value))} }}"
    if isinstance(value, list):
        return f"[{', '.join(map(_value, value))}]"
    return str(value).lower() if isinstance(value, bool) else str(value)
