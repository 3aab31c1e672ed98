"""Controllers as files of numbers: JSON, and MAT files for MATLAB and scipy."""

import json
from collections.abc import Callable, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from tustinnet.channels import Channels
from tustinnet.control.lqr import AccelerationGains, Feedback, Recovery, Tracking
from tustinnet.control.plan import Plan
from tustinnet.errors import InputError, convert_errors
from tustinnet.export.mat import mat_cells, mat_file
from tustinnet.store.files import to_json

JSON, MAT = "controller.json", "controller.mat"
_FORM = "tustinnet-controller"  # what a file says first

Reader = Callable[..., np.ndarray]  # of name and shape of an array, and of its default


def controller_json(controller: Feedback | Tracking, channels: Channels) -> str:
    """A controller as JSON, with the names of its coordinates and inputs."""
    return to_json(
        {
            "form": _FORM,
            "period": controller.final.dt,
            "coordinates": [c.name for c in channels.coordinates],
            "inputs": [i.name for i in channels.inputs],
            **_content(controller),
        }
    )


def controller_mat(controller: Feedback | Tracking, channels: Channels) -> bytes:
    """A controller as a MAT file: structures `feedback`, `plan` and `recovery`, and `gains`.

    Vectors are columns; `gains` of a plan is (steps, inputs, states). Indices count from 0.
    """
    return mat_file(
        {
            "form": _FORM,
            "period": controller.final.dt,
            "coordinates": mat_cells([c.name for c in channels.coordinates]),
            "inputs": mat_cells([i.name for i in channels.inputs]),
            **_to_columns(_content(controller)),
        }
    )


def read_controller(path: str | Path) -> Feedback | Tracking:
    """The controller of an exported folder, or of its JSON or MAT file.

    Args:
        path: the folder, or the file.

    Returns:
        The feedback, or the tracking of a plan, with the numbers that were exported.

    Raises:
        InputError: there is no such file, it is no exported controller, or an entry is missing, of
            another shape or not finite.
    """
    file = Path(path) / JSON if Path(path).is_dir() else Path(path)
    expected = f"{JSON} or {MAT} of an exported controller"
    if file.suffix not in (".json", ".mat"):
        raise InputError(file, f"ending '{file.suffix}'", expected)
    with convert_errors(file, "cannot be read", expected):
        raw = file.read_bytes()
        content = json.loads(raw) if file.suffix == ".json" else _read_mat(raw)
    if not isinstance(content, dict) or content.get("form") != _FORM:
        raise InputError(file, "no exported controller", expected)
    feedback, plan = content.get("feedback"), content.get("plan")
    if not isinstance(feedback, dict) or not isinstance(plan, dict | None):
        raise InputError(file, "a controller without its feedback", expected)
    read_whole = _array_reader(file, content, "")
    period = float(read_whole("period", ()))
    final = _read_feedback(_array_reader(file, feedback, "feedback."), period)
    if plan is None:
        return final
    read = _array_reader(file, plan, "plan.")
    n_u, n_x = len(final.u0), len(final.x0)
    u = read("u", (None, n_u))
    x = read("x", (len(u) + 1, n_x))
    motion = Plan(
        x=x,
        u=u,
        cost=float(read("cost", ())),
        converged=bool(read("converged", ())),
        reached=bool(read("reached", ())),
        iterations=int(read("iterations", ())),
        dt=period,
        goal=read("goal", (n_x,)),
        before=read("before", (n_u,)),
        delay=final.delay,
    )
    own = None
    if "acceleration" in plan:
        own = AccelerationGains(*read("acceleration", (3,)).tolist())
    n_z = n_x + (len(final.integral) if own else final.previous * n_u)
    gains = read_whole("gains", (len(u), n_u, n_z))
    recovery = None
    if "recovery" in content:
        part = content["recovery"]
        settle = part.get("feedback") if isinstance(part, dict) else None
        if not isinstance(settle, dict):
            raise InputError(file, "a recovery without its feedback", expected)
        read = _array_reader(file, part, "recovery.")
        recovery = Recovery(
            feedback=_read_feedback(_array_reader(file, settle, "recovery.feedback."), period),
            fallen_beyond=read("fallen_beyond", (n_x,)),
            settled_within=read("settled_within", (n_x,)),
        )
        if recovery.feedback.gain.shape != (n_u, n_z):
            raise InputError(
                file,
                f"entry 'recovery.feedback.gain' of shape {recovery.feedback.gain.shape}",
                f"{n_u} x {n_z}",
            )
    return Tracking(motion, gains, final, recovery, own)


def _content(controller: Feedback | Tracking) -> dict[str, Any]:
    """The numbers of a controller by name, as arrays."""
    feedback = _feedback_content(controller.final)
    if isinstance(controller, Feedback):
        return {"feedback": feedback}
    plan, recovery = _numbers(controller.plan, ("dt", "delay")), controller.recovery
    if controller.by_acceleration:
        plan["acceleration"] = np.array(controller.by_acceleration)
    content = {"feedback": feedback, "plan": plan, "gains": controller.gains}
    if recovery is not None:
        own = _feedback_content(recovery.feedback)
        content["recovery"] = {"feedback": own, **_numbers(recovery, ("feedback",))}
    return content


def _feedback_content(feedback: Feedback) -> dict[str, Any]:
    """The numbers of a feedback by name, as arrays."""
    safe = np.broadcast_to(feedback.safe, feedback.u0.shape)
    return {**_numbers(feedback, ("dt",)), "safe": safe}


def _numbers(part: Feedback | Plan | Recovery, elsewhere: Sequence[str]) -> dict[str, Any]:
    """The numbers of a part by name, as arrays, but for those that stand elsewhere."""
    return {
        name: np.array(value, int) if isinstance(value, tuple) else np.asarray(value)
        for name, value in vars(part).items()
        if name not in elsewhere
    }


def _to_columns(content: Mapping[str, Any]) -> dict[str, Any]:
    """Content with vectors as columns, as MATLAB has them."""
    return {
        name: _to_columns(value)
        if isinstance(value, dict)
        else value[:, None]
        if np.ndim(value) == 1
        else value
        for name, value in content.items()
    }


def _read_mat(raw: bytes) -> dict[str, Any]:
    """The variables of a MAT file, structures as dictionaries."""
    from scipy.io import loadmat

    return loadmat(BytesIO(raw), simplify_cells=True)


def _array_reader(file: Path, content: Mapping[str, Any], place: str) -> Reader:
    """A function that reads an array of a shape from a part of a file's content."""

    def read(name: str, shape: tuple[int | None, ...]) -> np.ndarray:
        where = f"{place}{name}"
        if name not in content:
            raise InputError(
                file,
                f"no entry '{where}'",
                "an exported controller",
                "one of before 0.3 lacks it: design it again",
            )
        expected = " x ".join("n" if n is None else str(n) for n in shape) or "a number"
        with convert_errors(file, f"entry '{where}'", f"numbers, {expected}"):
            array = np.array(content[name], np.float64)
        free = sum(n is None for n in shape)
        size = int(np.prod([n for n in shape if n is not None]))
        # a MAT file keeps no axes of length 1, and has vectors as columns
        if array.size % size == 0 if free else array.size == size:
            array = array.reshape([-1 if n is None else n for n in shape])
        else:
            raise InputError(file, f"entry '{where}' of shape {array.shape}", expected)
        if not np.isfinite(array).all():
            raise InputError(file, f"entry '{where}' is not finite", f"finite numbers, {expected}")
        return array

    return read


def _read_feedback(read: Reader, period: float) -> Feedback:
    """The feedback that a file holds."""
    x0, u0 = read("x0", (None,)), read("u0", (None,))
    integral = tuple(int(i) for i in read("integral", (None,)))
    return Feedback(
        gain=read("gain", (len(u0), None)),
        x0=x0,
        u0=u0,
        lower=read("lower", (len(u0),)),
        upper=read("upper", (len(u0),)),
        integral=integral,
        periodic=tuple(int(i) for i in read("periodic", (None,))),
        delay=int(read("delay", ())),
        dt=period,
        speeds=read("speeds", (None,)),
        safe=read("safe", (len(u0),)),
    )
