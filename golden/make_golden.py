#!/usr/bin/env python3
"""Golden numbers for the networks, from an implementation in plain NumPy that shares nothing with the Rust one.

Run from anywhere: python3 golden/make_golden.py (needs numpy and safetensors). It writes golden/nets/:

  port_disp.pth.tar, port_pose.pth.tar   weights in PyTorch's file format, N = 3, sigmoid masks, symmetric padding
  port_expected.safetensors              inputs and outputs
  paper_weights.safetensors              weights with batch normalisation, N = 5, softmax masks, SAME padding
  paper_expected.safetensors             inputs, inference outputs, training outputs (batch statistics)
"""

import collections
import io
import pickle
import sys
import types
import zipfile
from pathlib import Path

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from safetensors.numpy import save_file

OUT = Path(__file__).resolve().parent / "nets"
ALPHA = 10.0


# --- layers, written from their definitions ---------------------------------------------------------------------


def same_padding(size, kernel, stride):
    """TensorFlow's SAME: the output has ceil(size / stride) rows, the larger half of the padding comes after."""
    total = max((-(-size // stride) - 1) * stride + kernel - size, 0)
    return total // 2, total - total // 2


def conv(x, weight, bias, stride, padding):
    kernel = weight.shape[2]
    pads = [same_padding(n, kernel, stride) if padding == "same" else ((kernel - 1) // 2,) * 2 for n in x.shape[2:]]
    windows = sliding_window_view(np.pad(x, [(0, 0), (0, 0), *pads]), (kernel, kernel), axis=(2, 3))
    windows = windows[:, :, ::stride, ::stride]
    return np.einsum("bihwkl,oikl->bohw", windows, weight, optimize=True) + bias[None, :, None, None]


def up_conv(x, weight, bias, padding, size):
    """Adjoint of a stride-2 convolution from 2n to n rows, cut to `size`."""
    batch, _, height, width = x.shape
    kernel = weight.shape[2]
    full = np.zeros((batch, weight.shape[1], 2 * height + kernel, 2 * width + kernel))
    for row in range(kernel):
        for column in range(kernel):
            part = np.einsum("bihw,io->bohw", x, weight[:, :, row, column])
            full[:, :, row : row + 2 * height : 2, column : column + 2 * width : 2] += part
    first = (kernel - 2) // 2 if padding == "same" else (kernel - 1) // 2
    return full[:, :, first : first + size[0], first : first + size[1]] + bias[None, :, None, None]


def batch_norm(x, weights, name, training):
    if f"{name}.norm.weight" not in weights:
        return x
    gamma, beta, mean, var = (weights[f"{name}.norm.{k}"] for k in ("weight", "bias", "running_mean", "running_var"))
    if training:
        mean, var = x.mean(axis=(0, 2, 3)), x.var(axis=(0, 2, 3))
    wide = lambda v: v[None, :, None, None]
    return (x - wide(mean)) / np.sqrt(wide(var) + 1e-5) * wide(gamma) + wide(beta)


def sigmoid(x):
    return 1.0 / (1.0 + np.exp(-x))


def double(x, size):
    """Bilinear, pixel areas aligned: output pixel i samples input position (i + 0.5) / 2 - 0.5, clamped."""

    def along(x, axis):
        n = x.shape[axis]
        position = np.clip((np.arange(2 * n) + 0.5) / 2 - 0.5, 0, n - 1)
        low = np.floor(position).astype(int)
        high = np.minimum(low + 1, n - 1)
        shape = [1] * x.ndim
        shape[axis] = -1
        t = (position - low).reshape(shape)
        return x.take(low, axis) * (1 - t) + x.take(high, axis) * t

    return along(along(x, 2), 3)[:, :, : size[0], : size[1]]


class Net:
    def __init__(self, weights, padding, training):
        self.weights, self.padding, self.training = weights, padding, training

    def bare(self, name, x, stride=1):
        return conv(x, self.weights[f"{name}.weight"], self.weights[f"{name}.bias"], stride, self.padding)

    def block(self, name, x, stride=1):
        return np.maximum(batch_norm(self.bare(name, x, stride), self.weights, name, self.training), 0)

    def up(self, name, x, size):
        x = up_conv(x, self.weights[f"{name}.weight"], self.weights[f"{name}.bias"], self.padding, size)
        return np.maximum(batch_norm(x, self.weights, name, self.training), 0)


# --- the two networks -------------------------------------------------------------------------------------------


def disp_net(net, image, beta):
    features = [image]
    for k in range(1, 8):
        features.append(net.block(f"conv{k}.2", net.block(f"conv{k}.0", features[-1], 2)))
    x, disparities = features[7], {}
    for k in range(7, 0, -1):
        skip = features[k - 1]
        size = skip.shape[2:]
        parts = [net.up(f"upconv{k}.0", x, size)]
        parts += [skip] if k > 1 else []
        parts += [double(disparities[k + 1], size)] if k + 1 in disparities else []
        x = net.block(f"iconv{k}.0", np.concatenate(parts, 1))
        if k <= 4:
            disparities[k] = ALPHA * sigmoid(net.bare(f"predict_disp{k}.0", x)) + beta
    return [disparities[k] for k in (1, 2, 3, 4)]


def pose_mask_net(net, snippet, softmax):
    features = [snippet]
    for k in range(1, 6):
        features.append(net.block(f"conv{k}.0", features[-1], 2))
    x = net.bare("pose_pred", net.block("conv7.0", net.block("conv6.0", features[5], 2), 2))
    pose = 0.01 * x.mean(axis=(2, 3)).reshape(len(x), -1, 6)
    x, masks = features[5], {}
    for k in range(5, 0, -1):
        x = net.up(f"upconv{k}.0", x, features[k - 1].shape[2:])
        if k <= 4:
            logits = net.bare(f"predict_mask{k}", x)
            if softmax:
                exp = np.exp(logits.reshape(len(x), -1, 2, *x.shape[2:]))
                masks[k] = (exp / exp.sum(axis=2, keepdims=True))[:, :, 1]
            else:
                masks[k] = sigmoid(logits)
    return pose, [masks[k] for k in (1, 2, 3, 4)]


# --- weights ----------------------------------------------------------------------------------------------------


def random_layer(rng, weights, name, shape, channels_out, norm):
    fan = np.prod(shape) / channels_out
    weights[f"{name}.weight"] = rng.normal(0, 1.6 / np.sqrt(fan), shape)
    weights[f"{name}.bias"] = rng.normal(0, 0.1, channels_out)
    if norm:
        weights[f"{name}.norm.weight"] = rng.uniform(0.5, 1.5, channels_out)
        weights[f"{name}.norm.bias"] = rng.normal(0, 0.2, channels_out)
        weights[f"{name}.norm.running_mean"] = rng.normal(0, 0.2, channels_out)
        weights[f"{name}.norm.running_var"] = rng.uniform(0.5, 1.5, channels_out)


def disp_weights(rng, encoder, decoder, norm):
    weights = collections.OrderedDict()
    for k, (c_in, c, kernel) in enumerate(zip([3, *encoder], encoder, [7, 5, 3, 3, 3, 3, 3]), 1):
        random_layer(rng, weights, f"conv{k}.0", (c, c_in, kernel, kernel), c, norm)
        random_layer(rng, weights, f"conv{k}.2", (c, c, kernel, kernel), c, norm)
    for i, (c_in, c) in enumerate(zip([encoder[6], *decoder], decoder)):
        k = 7 - i
        random_layer(rng, weights, f"upconv{k}.0", (c_in, c, 3, 3), c, norm)
        fused = c + (encoder[k - 2] if k > 1 else 0) + (1 if k < 4 else 0)
        random_layer(rng, weights, f"iconv{k}.0", (c, fused, 3, 3), c, norm)
        if k <= 4:
            random_layer(rng, weights, f"predict_disp{k}.0", (1, c, 3, 3), 1, False)
    return weights


def pose_weights(rng, frames, encoder, decoder, kernels, heads, norm):
    weights = collections.OrderedDict()
    for k, (c_in, c, kernel) in enumerate(zip([3 * frames, *encoder], encoder, [7, 5, 3, 3, 3, 3, 3]), 1):
        random_layer(rng, weights, f"conv{k}.0", (c, c_in, kernel, kernel), c, norm)
    random_layer(rng, weights, "pose_pred", (6 * (frames - 1), encoder[6], 1, 1), 6 * (frames - 1), False)
    for i, (c_in, c, kernel) in enumerate(zip([encoder[4], *decoder], decoder, kernels)):
        k = 5 - i
        random_layer(rng, weights, f"upconv{k}.0", (c_in, c, kernel, kernel), c, norm)
        if k <= 4:
            size = kernel if kernel % 2 else 3
            random_layer(rng, weights, f"predict_mask{k}", (heads, c, size, size), heads, False)
    return weights


# --- PyTorch's file format without PyTorch ----------------------------------------------------------------------


def write_pytorch(path, weights):
    """A zip of raw storages and a pickle that rebuilds tensors from them (documented in torch/serialization.py)."""
    torch, utils = types.ModuleType("torch"), types.ModuleType("torch._utils")
    torch.FloatStorage = type("FloatStorage", (), {"__module__": "torch"})
    exec("def _rebuild_tensor_v2(*arguments): pass", utils.__dict__)
    utils._rebuild_tensor_v2.__module__ = "torch._utils"
    sys.modules.update({"torch": torch, "torch._utils": utils})

    class Storage:
        def __init__(self, key, count):
            self.key, self.count = key, count

    class Tensor:
        def __init__(self, key, array):
            self.key, self.array = key, array

        def __reduce__(self):
            strides = tuple(step // self.array.itemsize for step in self.array.strides)
            storage = Storage(self.key, self.array.size)
            arguments = (storage, 0, self.array.shape, strides, False, collections.OrderedDict())
            return utils._rebuild_tensor_v2, arguments

    class Pickler(pickle.Pickler):
        def persistent_id(self, value):
            if isinstance(value, Storage):
                return ("storage", torch.FloatStorage, value.key, "cpu", value.count)
            return None

    arrays = {name: np.ascontiguousarray(value, np.float32) for name, value in weights.items()}
    tensors = collections.OrderedDict((name, Tensor(str(i), value)) for i, (name, value) in enumerate(arrays.items()))
    buffer = io.BytesIO()
    Pickler(buffer, protocol=2).dump({"epoch": 1, "state_dict": tensors})
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        entries = [("data.pkl", buffer.getvalue()), ("byteorder", b"little")]
        entries += [(f"data/{i}", value.tobytes()) for i, value in enumerate(arrays.values())]
        for name, data in [*entries, ("version", b"3\n")]:
            # A fixed date keeps the file the same from run to run.
            archive.writestr(zipfile.ZipInfo(f"weights/{name}", (2026, 1, 1, 0, 0, 0)), data)


def write_arrays(name, arrays, metadata=None):
    save_file({key: np.ascontiguousarray(value, np.float32) for key, value in arrays.items()}, OUT / name, metadata)
    (OUT / name).chmod(0o644)


def rounded(weights):
    """The weights as the file will hold them, so that rounding them is no part of the comparison."""
    return collections.OrderedDict((k, v.astype(np.float32).astype(np.float64)) for k, v in weights.items())


def outputs(disp, pose, frames, image_size, padding, softmax, beta, rng):
    images = rng.uniform(-1, 1, (frames, 2, 3, *image_size)).astype(np.float32).astype(np.float64)
    result = {"target": images[0], **{f"source{i}": image for i, image in enumerate(images[1:])}}
    normalised = any(".norm." in name for name in disp)
    for suffix, training in [("", False), ("_train", True)] if normalised else [("", False)]:
        for scale, value in enumerate(disp_net(Net(disp, padding, training), images[0], beta)):
            result[f"disp{scale}{suffix}"] = value
        motion, masks = pose_mask_net(Net(pose, padding, training), np.concatenate(images, 1), softmax)
        result[f"motion{suffix}"] = motion
        result.update({f"mask{scale}{suffix}": value for scale, value in enumerate(masks)})
    return result


# What the shapes of the weights do not tell, as endoscape's own files carry it.
PAPER_CONFIG = """
[disp]
beta = 0.1
encoder = [2, 3, 4, 4, 5, 5, 4]
decoder = [4, 5, 4, 4, 3, 3, 2]
batch_norm = true
padding = "same"
[pose]
snippet_length = 5
mask = "softmax"
encoder = [3, 3, 4, 5, 5]
motion = [4, 4]
mask_decoder = [5, 4, 4, 3, 2]
mask_kernels = [3, 3, 3, 5, 7]
batch_norm = true
padding = "same"
"""


def main():
    OUT.mkdir(exist_ok=True)
    rng = np.random.default_rng(20260101)
    disp = rounded(disp_weights(rng, [3, 4, 5, 6, 6, 5, 4], [5, 6, 5, 4, 4, 3, 2], False))
    pose = rounded(pose_weights(rng, 3, [3, 4, 4, 5, 6, 5, 4], [6, 5, 4, 3, 2], [4] * 5, 2, False))
    write_pytorch(OUT / "port_disp.pth.tar", disp)
    write_pytorch(OUT / "port_pose.pth.tar", pose)
    # Odd sizes: every skip and every mask has to be cut.
    write_arrays("port_expected.safetensors", outputs(disp, pose, 3, (37, 51), "symmetric", False, 0.01, rng))

    disp = rounded(disp_weights(rng, [2, 3, 4, 4, 5, 5, 4], [4, 5, 4, 4, 3, 3, 2], True))
    pose = rounded(pose_weights(rng, 5, [3, 3, 4, 5, 5, 4, 4], [5, 4, 4, 3, 2], [3, 3, 3, 5, 7], 8, True))
    both = {f"disp.{k}": v for k, v in disp.items()} | {f"pose.{k}": v for k, v in pose.items()}
    write_arrays("paper_weights.safetensors", both, {"config": PAPER_CONFIG})
    write_arrays("paper_expected.safetensors", outputs(disp, pose, 5, (24, 43), "same", True, 0.1, rng))


if __name__ == "__main__":
    main()
