#!/usr/bin/env python3
"""Times inference and a training step of endoscape beside ONNX Runtime and PyTorch, in turns, on the same sizes.

    cargo build --release -p endoscape-train --example bench_nets
    python3 scripts/bench_nets.py [--binary FILE] [--rounds N] [--threads N] [--only inference|training|profile]

Every round runs each program in turn, so that a busy machine slows all of them; medians over all rounds and ratios of
the medians are printed as a Markdown table, then one of the layers of each network. Ratios below 1 mean endoscape is faster. Needs numpy and, for inference,
onnxruntime; for training, torch. Whichever is missing is left out.
"""

import argparse
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time

import numpy as np

try:
    import onnxruntime
except ImportError:
    onnxruntime = None
try:
    import torch
    from torch import nn
    from torch.nn import functional as F
except ImportError:
    torch = None

PER_ROUND = 5
# Passes of a network in a round: those of the motion network take a millisecond or two.
PASSES = {"depth": 20, "motion": 200, "both": 20}


class Endoscape:
    """The example binary, kept running with a fixed number of threads."""

    def __init__(self, binary, threads):
        environment = dict(os.environ, RAYON_NUM_THREADS=str(threads))
        self.process = subprocess.Popen(
            [binary], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
        )

    def ask(self, request):
        self.process.stdin.write(request + "\n")
        self.process.stdin.flush()
        return json.loads(self.process.stdout.readline())


def timed(function, count):
    function()
    seconds = []
    for _ in range(count):
        start = time.perf_counter()
        function()
        seconds.append(time.perf_counter() - start)
    return seconds


def row(task, ours, theirs):
    """One line of the table; `theirs` maps names to lists of seconds."""
    median = np.median(ours)
    for name, seconds in theirs.items():
        other = np.median(seconds)
        print(
            f"| {task} | {median * 1e3:.1f} / {np.min(ours) * 1e3:.1f} | {name} | {other * 1e3:.1f} / "
            f"{np.min(seconds) * 1e3:.1f} | {median / other:.2f} |",
            flush=True,
        )


def session(path, threads):
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])


def inference(endoscape, nets, size, arguments):
    """Depth and motion of one frame beside ONNX Runtime."""
    width, height = (int(length) for length in size.split("x"))
    with tempfile.TemporaryDirectory() as folder:
        endoscape.ask(f"export {folder} {nets} {size}")
        for what, file, channels in (("depth", "disp", 3), ("motion", "pose", 9)):
            network = session(pathlib.Path(folder) / f"{file}.onnx", arguments.threads)
            feed = {network.get_inputs()[0].name: np.full((1, channels, height, width), 0.25, np.float32)}
            ours, theirs = [], []
            for _ in range(arguments.rounds):
                ours += endoscape.ask(f"infer {what} {nets} {size} {PASSES[what]}")
                theirs += timed(lambda: network.run(None, feed), PASSES[what])
            row(f"{what}, `{nets}`, {size}", ours, {f"ONNX Runtime {onnxruntime.__version__}": theirs})


def rate(endoscape, nets, size, arguments):
    """Depth and motion together, in frames per second."""
    seconds = []
    for _ in range(arguments.rounds):
        seconds += endoscape.ask(f"infer both {nets} {size} {PASSES['both']}")
    print(f"| depth and motion, `{nets}`, {size} | {np.median(seconds) * 1e3:.1f} ms | {1 / np.median(seconds):.0f} frames/s |")


def profile(endoscape, what, nets, size, least_share=0.01):
    """Time of each step of a network; steps that take less than a share of all are added up."""
    steps = endoscape.ask(f"profile {what} {nets} {size} {PASSES[what]}")
    total = sum(seconds for *_, seconds in steps)
    print(f"\n| {what}, `{nets}`, {size}: layer | output | ms | share | GFLOP/s |\n|---|---|---|---|---|")
    rest = 0
    for name, (rows, columns), operations, seconds in steps:
        if seconds < least_share * total:
            rest += seconds
            continue
        speed = f"{operations / seconds / 1e9:.0f}" if operations else ""
        print(f"| {name} | {columns}x{rows} | {seconds * 1e3:.2f} | {seconds / total:.0%} | {speed} |")
    print(f"| others | | {rest * 1e3:.2f} | {rest / total:.0%} | |\n| all | | {total * 1e3:.2f} | | |")


def block(channels_in, channels_out, kernel, stride):
    return nn.Sequential(nn.Conv2d(channels_in, channels_out, kernel, stride, (kernel - 1) // 2), nn.ReLU(inplace=True))


def up_block(channels_in, channels_out, kernel, **options):
    return nn.Sequential(
        nn.ConvTranspose2d(channels_in, channels_out, kernel, 2, 1, **options), nn.ReLU(inplace=True)
    ) if torch else None


class Disparity(nn.Module if torch else object):
    """The depth network of `nets::disp_net`, full width."""

    def __init__(self):
        super().__init__()
        encoder, kernels = [32, 64, 128, 256, 512, 512, 512], [7, 5, 3, 3, 3, 3, 3]
        decoder, inputs = [512, 512, 256, 128, 64, 32, 16], [3] + encoder[:-1]
        self.encoder = nn.ModuleList(
            nn.Sequential(block(a, b, k, 2), block(b, b, k, 1)) for a, b, k in zip(inputs, encoder, kernels)
        )
        ups = [512] + decoder[:-1]
        self.up = nn.ModuleList(up_block(a, b, 3, output_padding=1) for a, b in zip(ups, decoder))
        skips = encoder[5::-1] + [0]
        fused = [b + skip + (index > 3) for index, (b, skip) in enumerate(zip(decoder, skips))]
        self.fuse = nn.ModuleList(block(a, b, 3, 1) for a, b in zip(fused, decoder))
        self.heads = nn.ModuleList(nn.Conv2d(b, 1, 3, padding=1) for b in decoder[3:])

    def forward(self, image):
        features, skips = image, []
        for stage in self.encoder:
            features = stage(features)
            skips.append(features)
        skips.pop()
        scales = []
        for index, (up, fuse) in enumerate(zip(self.up, self.fuse)):
            skip = skips.pop() if skips else None
            size = (skip if skip is not None else image).shape[2:]
            inputs = [up(features)[..., : size[0], : size[1]]] + ([skip] if skip is not None else [])
            if scales:
                finer = F.interpolate(scales[-1], scale_factor=2, mode="bilinear", align_corners=False)
                inputs.append(finer[..., : size[0], : size[1]])
            features = fuse(torch.cat(inputs, 1))
            if index >= 3:
                scales.append(10 * torch.sigmoid(self.heads[index - 3](features)) + 0.01)
        return scales[::-1]


class Motion(nn.Module if torch else object):
    """The motion and mask network of `nets::pose_mask_net`, full width, two sources."""

    def __init__(self):
        super().__init__()
        widths, kernels = [9, 16, 32, 64, 128, 256], [7, 5, 3, 3, 3]
        self.encoder = nn.ModuleList(block(a, b, k, 2) for a, b, k in zip(widths, widths[1:], kernels))
        self.motion = nn.Sequential(block(256, 256, 3, 2), block(256, 256, 3, 2), nn.Conv2d(256, 12, 1))
        decoder = [256, 256, 128, 64, 32, 16]
        self.up = nn.ModuleList(up_block(a, b, 4) for a, b in zip(decoder, decoder[1:]))
        self.heads = nn.ModuleList(nn.Conv2d(b, 2, 3, padding=1) for b in decoder[2:])

    def forward(self, snippet):
        features, sizes = snippet, [snippet.shape[2:]]
        for stage in self.encoder:
            features = stage(features)
            sizes.append(features.shape[2:])
        motion = 0.01 * self.motion(features).mean((2, 3)).view(-1, 2, 6)
        masks = []
        for index, (up, size) in enumerate(zip(self.up, sizes[-2::-1])):
            features = up(features)[..., : size[0], : size[1]]
            if index > 0:
                masks.append(torch.sigmoid(self.heads[index - 1](features)))
        return motion, masks[::-1]


def euler(angles):
    """Rx Ry Rz, `[batch, 3, 3]`."""
    (x, y, z), zero, one = angles.unbind(1), torch.zeros_like(angles[:, 0]), torch.ones_like(angles[:, 0])

    def matrix(*entries):
        return torch.stack(entries, 1).view(-1, 3, 3)

    rx = matrix(one, zero, zero, zero, x.cos(), -x.sin(), zero, x.sin(), x.cos())
    ry = matrix(y.cos(), zero, y.sin(), zero, one, zero, -y.sin(), zero, y.cos())
    rz = matrix(z.cos(), -z.sin(), zero, z.sin(), z.cos(), zero, zero, zero, one)
    return rx @ ry @ rz


def warp(source, disparity, motion, camera):
    """The target painted with the source, and which pixels have a source; mid-grey elsewhere."""
    batch, _, height, width = source.shape
    focal, cx, cy = camera
    row, column = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    rays = torch.stack([(column - cx) / focal, (row - cy) / focal, torch.ones(height, width)]).view(1, 3, -1)
    points = euler(motion[:, 3:]) @ (rays * disparity.reciprocal().view(batch, 1, -1)) + motion[:, :3, None]
    depth = points[:, 2].clamp(min=1e-3)
    x = 2 * (focal * points[:, 0] / depth + cx) / (width - 1) - 1
    y = 2 * (focal * points[:, 1] / depth + cy) / (height - 1) - 1
    grid = torch.stack([x, y], 2).view(batch, height, width, 2)
    inside = (grid.detach().abs().amax(3) <= 1).unsqueeze(1)
    return F.grid_sample(source, grid, align_corners=True) * inside, inside


def paper_objective(target, sources, scales, motion, masks, focal):
    """The `paper` preset: L1 under the mask at each scale, second-order smoothness, mask cross-entropy."""
    total = 0.0
    for scale, (disparity, mask) in enumerate(zip(scales, masks)):
        height, width = disparity.shape[2:]
        small = [F.adaptive_avg_pool2d(picture, (height, width)) for picture in (target, *sources)]
        camera = focal / 2**scale, (width - 1) / 2, (height - 1) / 2
        for index, source in enumerate(small[1:]):
            painted, _ = warp(source, disparity, motion[:, index], camera)
            error = (small[0] - painted).abs().mean(1, keepdim=True)
            total = total + (error * mask[:, index : index + 1]).mean()
        dx, dy = disparity.diff(dim=3), disparity.diff(dim=2)
        rough = dx.diff(dim=3).abs().mean() + 2 * dx.diff(dim=2).abs().mean() + dy.diff(dim=2).abs().mean()
        total = total + 0.4 / 2**scale * rough + 0.15 * -mask.clamp(min=1e-7).log().mean()
    return total


class TorchStep:
    """One joint training step in PyTorch."""

    def __init__(self, size, batch, channels_last):
        width, height = (int(length) for length in size.split("x"))
        layout = torch.channels_last if channels_last else torch.contiguous_format
        self.nets = nn.ModuleList([Disparity(), Motion()]).to(memory_format=layout)
        self.frames = [torch.rand(batch, 3, height, width).mul(2).sub(1).to(memory_format=layout) for _ in range(3)]
        self.snippet = torch.cat(self.frames, 1).contiguous(memory_format=layout)
        self.focal = width / 2 / np.tan(np.radians(35))
        self.adam = torch.optim.Adam(self.nets.parameters(), 2e-4, fused=True)

    def __call__(self):
        disparity, pose = self.nets
        target, *sources = self.frames
        motion, masks = pose(self.snippet)
        loss = paper_objective(target, sources, disparity(target), motion, masks, self.focal)
        self.adam.zero_grad(set_to_none=True)
        loss.backward()
        self.adam.step()


def training(endoscape, size, batch, arguments):
    torch.set_num_threads(arguments.threads)
    variants = {
        f"PyTorch {torch.__version__}": TorchStep(size, batch, False),
        f"PyTorch {torch.__version__}, channels last": TorchStep(size, batch, True),
    }
    ours, theirs = [], {name: [] for name in variants}
    for _ in range(arguments.rounds):
        ours += endoscape.ask(f"step paper endo {size} {batch} {PER_ROUND}")
        for name, step in variants.items():
            theirs[name] += timed(step, PER_ROUND)
    row(f"training step, objective `paper`, batch {batch}, {size}", ours, theirs)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", default="target/release/examples/bench_nets")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--only", choices=["inference", "training", "profile"])
    arguments = parser.parse_args()
    endoscape = Endoscape(arguments.binary, arguments.threads)
    print("| task | endoscape, ms (median / least) | other | other, ms | ratio of medians |")
    print("|---|---|---|---|---|")
    if arguments.only in (None, "inference") and onnxruntime:
        for nets, size in (("endo", "416x128"), ("fast", "160x128"), ("fast", "256x256")):
            inference(endoscape, nets, size, arguments)
    if arguments.only in (None, "training") and torch:
        training(endoscape, "416x128", 4, arguments)
    if arguments.only in (None, "inference"):
        for size in ("160x128", "256x256"):
            rate(endoscape, "fast", size, arguments)
    if arguments.only in (None, "profile"):
        for what in ("depth", "motion"):
            profile(endoscape, what, "endo", "416x128")
    if not (onnxruntime or torch):
        sys.exit("neither onnxruntime nor torch is installed")


if __name__ == "__main__":
    main()
