#!/usr/bin/env python3
"""Times endoscape's rectification and decoding beside OpenCV's, in turns, on the same pictures.

    cargo build --release -p endoscape-frames --example bench_frames
    python3 scripts/bench_frames.py PICTURE FOLDER [FOLDER ...] [--binary FILE] [--rounds N]

PICTURE is any 1350x1080 picture; each FOLDER holds pictures to decode. Needs numpy and opencv-python.
Every round runs endoscape, then OpenCV, so that a busy machine slows both; medians and minima over all rounds are
printed as a Markdown table. Ratios below 1 mean endoscape is faster.
"""

import argparse
import json
import os
import pathlib
import subprocess
import time

import cv2
import numpy as np

PER_ROUND = 20


class Endoscape:
    """The example binary, kept running with a fixed number of threads."""

    def __init__(self, binary, threads):
        environment = dict(os.environ, RAYON_NUM_THREADS=str(threads))
        self.process = subprocess.Popen(
            [binary], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
        )

    def seconds(self, request):
        self.process.stdin.write(request + "\n")
        self.process.stdin.flush()
        return json.loads(self.process.stdout.readline())


def maps():
    """Where each pixel of the 640x512 pinhole comes from, by Newton's rule on the polynomial of bench_frames.rs."""
    column, row = np.meshgrid(np.arange(640.0), np.arange(512.0))
    x, y = (column - 319.5) / 360.0, (row - 255.5) / 360.0
    radius = np.hypot(x, y)
    a0, a2, a3, a4 = 769.24, -8.128e-4, 6.257e-7, -1.1966e-9
    rho = a0 * radius
    for _ in range(20):
        height = a0 + rho**2 * (a2 + rho * (a3 + rho * a4))
        slope = 1.0 - radius * rho * (2 * a2 + rho * (3 * a3 + rho * 4 * a4))
        rho -= (rho - height * radius) / slope
    x, y = x / radius * rho, y / radius * rho
    return (x + 0.00288 * y + 678.54).astype(np.float32), (-0.00296 * x + y + 542.98).astype(np.float32)


def timed(function, count):
    seconds = []
    for _ in range(count):
        start = time.perf_counter()
        function()
        seconds.append(time.perf_counter() - start)
    return seconds


def row(name, threads, ours, theirs):
    """One line of the table: OpenCV's better variant by median counts."""
    best = min(theirs, key=lambda variant: np.median(theirs[variant]))
    other, median, least = theirs[best], np.median(ours), np.min(ours)
    print(
        f"| {name} | {threads} | {median * 1e3:.2f} / {least * 1e3:.2f} | {best} | "
        f"{np.median(other) * 1e3:.2f} / {np.min(other) * 1e3:.2f} | {median / np.median(other):.2f} / {least / np.min(other):.2f} |"
    )


def rectify(binary, picture, threads, rounds):
    cv2.setNumThreads(threads)
    image, float_maps = cv2.imread(picture), maps()
    variants = {"float maps": float_maps, "fixed-point maps": cv2.convertMaps(*float_maps, cv2.CV_16SC2)}
    endoscape, ours, theirs = Endoscape(binary, threads), [], {name: [] for name in variants}
    for _ in range(rounds):
        ours += endoscape.seconds(f"rectify {picture} {PER_ROUND}")
        for name, (first, second) in variants.items():
            theirs[name] += timed(lambda: cv2.remap(image, first, second, cv2.INTER_LINEAR), PER_ROUND)
    row("rectify 1350x1080 to 640x512", threads, ours, theirs)


def decode_opencv(path):
    rgb = cv2.cvtColor(cv2.imread(path), cv2.COLOR_BGR2RGB)
    return np.ascontiguousarray(rgb.transpose(2, 0, 1), dtype=np.float32) / np.float32(255)


def decode(binary, folder, rounds):
    cv2.setNumThreads(1)
    endoscape, ours, theirs = Endoscape(binary, 1), [], {"imread": []}
    files = sorted(str(path) for path in pathlib.Path(folder).iterdir())
    for _ in range(rounds):
        ours += endoscape.seconds(f"decode {folder}")
        for path in files:
            theirs["imread"] += timed(lambda: decode_opencv(path), 1)
    row(f"decode {pathlib.Path(folder).name} to f32 planes", 1, ours, theirs)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("picture")
    parser.add_argument("folders", nargs="*")
    parser.add_argument("--binary", default="target/release/examples/bench_frames")
    parser.add_argument("--rounds", type=int, default=10)
    arguments = parser.parse_args()
    print("| task | threads | endoscape, ms (median / least) | OpenCV variant | OpenCV, ms | ratio |")
    print("|---|---|---|---|---|---|")
    for threads in (1, 2):
        rectify(arguments.binary, arguments.picture, threads, arguments.rounds)
    for folder in arguments.folders:
        decode(arguments.binary, folder, arguments.rounds)


if __name__ == "__main__":
    main()
