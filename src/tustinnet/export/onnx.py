"""ONNX: a step and a free run, batched, in double and in single precision."""

import json
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from tustinnet.export.source import Source
from tustinnet.export.target import Files, Stepper, Target, Vector

STEP, ROLLOUT = "step.onnx", "rollout.onnx"
SINGLE = "step-float32.onnx", "rollout-float32.onnx"


class Onnx(Target):
    """ONNX, run by onnxruntime, or by ONNX's own reference where that is not installed."""

    name = "onnx"
    extra = "onnx", ("onnx",)

    def files(self, source: Source) -> Files:
        """`step.onnx` and `rollout.onnx`, and both in single precision."""
        # here, as the package is an extra
        from tustinnet.export.onnx_graph import rollout_model, step_model

        # names, units and period in the metadata of every file, each a text in JSON
        metadata = {
            "states": source.states,
            "units": source.units,
            "inputs": [i.name for i in source.channels.inputs],
            "samples": source.input_layout.offsets,
            "period": source.channels.dt,
        }
        about = {name: json.dumps(value) for name, value in metadata.items()}
        program = source.step
        return {
            name: make(program, kind, about).SerializeToString(deterministic=True)
            for kind, names in ((np.float64, (STEP, ROLLOUT)), (np.float32, SINGLE))
            for name, make in zip(names, (step_model, rollout_model), strict=True)
        }

    def stepper(self, folder: Path, source: Source) -> Stepper:
        """A step by `step.onnx`, run by onnxruntime or the reference of ONNX."""
        path = str(folder / STEP)
        if find_spec("onnxruntime") is None:
            from onnx.reference import ReferenceEvaluator

            session = ReferenceEvaluator(path)
        else:
            from onnxruntime import InferenceSession

            session = InferenceSession(path, providers=["CPUExecutionProvider"])

        def step(x: Vector, u: Vector) -> Vector:
            (following,) = session.run(None, {"x": x[None], "u": u[None]})
            return np.asarray(following)[0]

        return step


TARGET = Onnx()
