"""Writing a controller as a folder: C, gains, and scripts of solvers, compared with Python."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from jaxtyping import Float

from tustinnet.channels import SAME_PERIOD
from tustinnet.control.disturbances import DisturbedModel
from tustinnet.control.dynamics import InputLimits, Limits, controlled
from tustinnet.control.export.check import BOUND, LoopCheck, check_loop
from tustinnet.control.export.code import gains_of, make_code, make_readme
from tustinnet.control.export.gains import JSON, MAT, controller_json, controller_mat
from tustinnet.control.export.scripts import make_scripts
from tustinnet.control.ilqr import make_cost
from tustinnet.control.input_history import causal_source
from tustinnet.control.lqr import Feedback, Tracking, as_tracking
from tustinnet.control.mpc import Mpc, make_controller
from tustinnet.control.weights import Deviations
from tustinnet.errors import InputError
from tustinnet.export.source import Source
from tustinnet.models.contract import Model
from tustinnet.models.groups import model_for_groups
from tustinnet.simulate.filtering import LOST_AFTER, FilterNoise, checked_vector
from tustinnet.simulate.range import Range
from tustinnet.store.exported import CARD, make_card, require_export_folder, write_export
from tustinnet.store.header import read_header

Vector = Float[np.ndarray, " _"]


@dataclass(frozen=True)
class ControllerExport:
    """A controller that was exported.

    Attributes:
        folder: the folder of its files.
        files: their names.
        checked: how the loop in C compares with that in Python.
        notes: remarks for those who use it.
    """

    folder: Path
    files: tuple[str, ...]
    checked: LoopCheck
    notes: tuple[str, ...]


def export_controller(
    model: Model,
    controller: Feedback | Tracking | Mpc,
    noise: FilterNoise,
    out: str | Path,
    *,
    deviations: Deviations | None = None,
    within: Limits | None = None,
    start: Vector | None = None,
    file: str | Path | None = None,
    groups: Mapping[str, str] | None = None,
    lost_after: int = LOST_AFTER,
    remarks: Sequence[str] = (),
    overwrite: bool = False,
) -> ControllerExport:
    """Writes a controller with its estimator and model as C, as gains, and as scripts of solvers.

    The loop that the C code closes in software is compared with that of Python before anything is
    written.

    Args:
        model: the model on which the controller was designed, for the estimator.
        controller: the feedback, the feedback along a plan, or predictive control, on this model.
        noise: the noise of the estimator, see `find_noise`.
        out: the folder, which is empty or has an earlier export.
        deviations: acceptable deviations of states and inputs by name, as the controller was
            designed with (`lqr`, `ilqr`): the scripts of solvers weight errors by them.
        within: limits of states by name, as in `ilqr`, for these scripts.
        start: the state from which the loop in software begins, (n_x,); by default the beginning
            of the plan, or ten encoder counts beside the goal.
        file: the model's file. From it the card takes data and scores, and the weights take the
            range of the training records.
        groups: for models with values by group: which to take, as `{"payload": "1kg"}`.
        lost_after: samples in a row that the estimator cannot use, after which the inputs are the
            safe ones of the controller (`Feedback.safe`) until as many were used.
        remarks: what else those who use it have to know, for README.md.
        overwrite: whether an export that is there may be replaced.

    Returns:
        What was written.

    Raises:
        InputError: a folder that holds something else, or an export that may not be replaced; a
            controller of other sizes than the model's; a plan that does not
            reach its goal; a closed loop that diverges, or differs in C. Nothing is written then.
    """
    folder = Path(out)
    require_export_folder(folder, overwrite=overwrite)
    header = {} if file is None else read_header(file)
    gains = gains_of(controller)
    model = model_for_groups(model, groups or {}, "export")
    inner = model.inner if isinstance(model, DisturbedModel) else model
    known = Range.from_header(header, inner)
    if isinstance(model, DisturbedModel) and known is not None:
        known = model.extend_range(known)
    final = gains.final
    source = causal_source(model, final.delay).described(known, header)
    noise = noise.checked(source.n_x, source.channels.n_q, "the estimator's noise")
    _require_fit(gains, source)
    if start is None:
        start = _default_start(gains, source)
    start = checked_vector("start", start, source.n_x, "the controller")
    # periods of the loop in software
    tracking = as_tracking(gains)
    steps = 300 + len(tracking.plan.u)
    code = make_code(controller, source, noise, start, steps, lost_after)
    check = check_loop(
        code, make_controller(controller), source, noise, start, steps, _fall(tracking), lost_after
    )
    notes, scripts = [*source.notes], {}
    if check.note:
        notes.append(check.note)
    if inner is not model:
        notes.append("no scripts for CasADi, acados and do-mpc: they have no disturbances")
    elif find_spec("casadi") is None:
        notes.append(
            "the package casadi is not installed (pip install 'tustinnet[casadi]'): no scripts for "
            "CasADi, acados and do-mpc"
        )
    else:
        limits = InputLimits(final.lower, final.upper)
        system = controlled(model, final.delay)
        cost, _ = make_cost(
            system,
            limits,
            final.x0,
            final.u0,
            deviations=deviations,
            range=source.range,
            within=within,
        )
        scripts = make_scripts(gains, system, cost, start)
    files = {
        **code,
        JSON: controller_json(gains, source.channels),
        MAT: controller_mat(gains, source.channels),
        **scripts,
        "README.md": make_readme(controller, source, tuple(scripts), [*remarks, *notes]),
    }
    checked = {
        "steps": check.steps,
        "difference": check.difference,
        "bound": BOUND,
        "note": check.note,
    }
    write_export(
        folder, {CARD: make_card(source, "controller", files, checked, source.notes, file), **files}
    )
    return ControllerExport(folder, (*files, CARD), check, tuple(notes))


def _default_start(controller: Feedback | Tracking, source: Source) -> Vector:
    """The beginning of the plan; without one a state near the goal."""
    if isinstance(controller, Tracking):
        return controller.plan.x[0]
    resolution = source.channels.resolution
    start = np.array(controller.x0, np.float64)
    # ten counts of an encoder, or 0.01 rad or m where its resolution is not known
    start[source.channels.position] += np.where(resolution > 0, 10 * resolution, 0.01)
    return start


def _fall(tracking: Tracking) -> Vector | None:
    """A state to which a held device falls in the check: beside the start, so that it swings."""
    recovery = tracking.recovery
    return None if recovery is None else tracking.plan.x[0] + recovery.fallen_beyond


def _require_fit(controller: Feedback | Tracking, source: Source) -> None:
    """Raises unless a controller has the sizes and the period of a model.

    Raises:
        InputError: other sizes or another period, a plan that does not reach its goal.
    """
    final = controller.final
    n_x, n_u = source.n_x, source.channels.n_u
    shapes = {"x0": (n_x,), "u0": (n_u,), "lower": (n_u,), "upper": (n_u,)}
    for name, shape in shapes.items():
        value = np.asarray(getattr(final, name))
        if value.shape != shape or not np.isfinite(value).all():
            raise InputError(f"{name} of the controller", f"{value}", f"{shape[0]} finite numbers")
    previous = len(source.input_layout.offsets) - 1
    n_z = n_x + len(final.integral) + previous * n_u
    if np.shape(final.gain) != (n_u, n_z) or not np.isfinite(final.gain).all():
        raise InputError(
            "gain of the controller",
            f"shape {np.shape(final.gain)}",
            f"finite numbers, ({n_u}, {n_z}): {n_x} states, {len(final.integral)} integrals, "
            f"{previous} samples of previous commands",
        )
    if abs(final.dt / source.channels.dt - 1) > SAME_PERIOD:
        raise InputError(
            "the controller",
            f"period {final.dt:g} s",
            f"that of the model, {source.channels.dt:g} s",
        )
    if isinstance(controller, Tracking):
        plan, steps = controller.plan, len(controller.plan.u)
        n_p, recovery = n_x + previous * n_u, controller.recovery
        n_p += len(controller.integral)
        if not plan.reached:
            miss = zip(source.states, plan.miss.tolist(), strict=True)
            raise InputError(
                "the plan",
                f"it ends {', '.join(f'{m:.3g} in {name}' for name, m in miss)} beside "
                "its goal, where linear feedback does not hold it",
                "a plan that reaches the goal",
                "plan more steps, or from other first guesses",
            )
        arrays = [
            ("x of the plan", plan.x, (steps + 1, n_x)),
            ("u of the plan", plan.u, (steps, n_u)),
            ("gains along the plan", controller.gains, (steps, n_u, n_p)),
        ]
        if recovery is not None:
            arrays += [
                ("gain of the recovery", recovery.feedback.gain, (n_u, n_p)),
                ("x0 of the recovery", recovery.feedback.x0, (n_x,)),
                ("u0 of the recovery", recovery.feedback.u0, (n_u,)),
                ("fallen_beyond of the recovery", recovery.fallen_beyond, (n_x,)),
                ("settled_within of the recovery", recovery.settled_within, (n_x,)),
            ]
        for name, value, shape in arrays:
            if np.shape(value) != shape or not np.isfinite(value).all():
                raise InputError(name, f"shape {np.shape(value)}", f"finite numbers, {shape}")
