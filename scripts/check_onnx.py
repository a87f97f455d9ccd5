#!/usr/bin/env python3
"""Runs exported ONNX files in onnxruntime and compares them with the outputs of this repository's own networks.

    python3 -m venv venv && venv/bin/pip install numpy onnx onnxruntime safetensors
    cargo run -p endoscape-nets --example onnx_samples -- SAMPLES
    venv/bin/python scripts/check_onnx.py SAMPLES

Each NAME.safetensors in SAMPLES holds inputs and outputs; every NAME_*.onnx beside it must reproduce them. Prints the
largest error of each output relative to its largest value, and fails above 1e-4.
"""

import sys
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
from safetensors.numpy import load_file

TOLERANCE = 1e-4


def check(path, arrays):
    """Largest relative error over the outputs of one file."""
    model = onnx.load(path)
    onnx.checker.check_model(model, full_check=True)
    opset = model.opset_import[0].version
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    inputs = {value.name: arrays[value.name] for value in session.get_inputs()}
    names = [value.name for value in session.get_outputs()]
    errors = {}
    for name, output in zip(names, session.run(names, inputs)):
        expected = arrays[name]
        if output.shape != expected.shape:
            sys.exit(f"{path}: {name} is {output.shape} but should be {expected.shape}")
        errors[name] = np.abs(output - expected).max() / np.abs(expected).max()
    line = ", ".join(f"{name} {error:.1e}" for name, error in errors.items())
    print(f"{path.name}: opset {opset}, {len(model.graph.node)} nodes, {line}")
    return max(errors.values())


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    samples = Path(sys.argv[1])
    errors = [
        check(path, load_file(arrays))
        for arrays in sorted(samples.glob("*.safetensors"))
        for path in sorted(samples.glob(f"{arrays.stem}_*.onnx"))
    ]
    if not errors:
        sys.exit(f"{samples}: no samples; write them with the example onnx_samples")
    print(f"largest relative error: {max(errors):.1e}")
    if max(errors) > TOLERANCE:
        sys.exit(f"above {TOLERANCE}")


if __name__ == "__main__":
    main()
