#!/usr/bin/env python3
"""Learns from some of the bronchoscope clips and judges on others, which have no camera and no poses.

    scripts/bronchoscope.py CLIPS OUT [--minutes M] [--hfov DEGREES] [--model CHECKPOINT] [--judge NAME...]

CLIPS holds folders with frameVideo.mp4 and state.csv (docs/datasets.md); OUT must not exist. Every third clip in the order
of their names is judged, the others are learned from, unless --judge names those to judge. The field of view is not known
and assumed. With --model nothing is learned. ENDOSCAPE names the program.

Per clip: how the rotation about the optical axis and the motion along it correlate (Pearson's r) with what the robot's
state says it turned and pushed, from frame to frame and over ten frames, with the lag of 0 or 1 frames that fits best over
all clips; and in how many frames the darkest twentieth of the picture, where the lumen is, lies farther away than the rest
by the medians of both. Needs numpy, scipy and Pillow.
"""

import argparse
import csv
import os
import pathlib
import subprocess

import numpy as np
from PIL import Image, ImageFilter
from scipy.spatial.transform import Rotation

STRETCHES = (1, 10)


def endoscape(*words):
    subprocess.run([os.environ.get("ENDOSCAPE", "endoscape"), *map(str, words)], check=True)


def clips_of(arguments):
    """(learned from, judged on)."""
    clips = sorted(folder for folder in arguments.clips.iterdir() if (folder / "state.csv").is_file())
    judged = [clip for clip in clips if clip.name in arguments.judge] if arguments.judge else clips[2::3]
    return [clip for clip in clips if clip not in judged], judged


def state_of(clip):
    """Rotation in degrees and insertion in millimetres, per frame."""
    with open(clip / "state.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    return np.array([[float(row["rotation_deg"]), float(row["extension_mm"])] for row in rows])


def motions_of(run):
    """Rotation about the optical axis in degrees and motion along it, from each frame to the next."""
    poses = np.loadtxt(run / "trajectory.tum")
    places, turns = poses[:, 1:4], Rotation.from_quat(poses[:, 4:8])
    steps = turns[:-1].inv()
    turn = np.degrees((steps * turns[1:]).as_rotvec()[:, 2])
    push = steps.apply(np.diff(places, axis=0))[:, 2]
    return np.stack([turn, push], axis=1)


def correlation(said, true):
    """Pearson's r; nothing where one of them never changes."""
    if len(said) < 3 or said.std() == 0 or true.std() == 0:
        return float("nan")
    return float(np.corrcoef(said, true)[0, 1])


def correlations(motion, state, stretch, lag):
    """r of rotation and insertion with what the state did `lag` frames before."""
    # Summed from frame to frame, for the axis turns with the tip.
    motion = np.stack([np.convolve(part, np.ones(stretch), "valid") for part in motion.T], axis=1)
    change = state[stretch:] - state[:-stretch]
    count = min(len(motion) - lag, len(change))
    return [correlation(motion[lag : lag + count, part], change[:count, part]) for part in (0, 1)]


def lumen_is_far(run, pictures):
    """Share of frames whose darkest twentieth is farther than the rest, and the median ratio of both depths."""
    ratios = []
    for path in sorted((run / "depth").glob("*.png"))[::5]:
        depth = np.asarray(Image.open(path)).astype(float)
        picture = Image.open(pictures / path.name).convert("L").filter(ImageFilter.GaussianBlur(4))
        grey = np.asarray(picture.resize(depth.shape[::-1])).astype(float)
        inside = (grey > 4) & (depth > 0)
        if inside.sum() < 100:
            continue
        dark = inside & (grey <= np.quantile(grey[inside], 0.05))
        ratios.append(np.median(depth[dark]) / np.median(depth[inside & ~dark]))
    return float(np.mean(np.array(ratios) > 1)), float(np.median(ratios))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", type=pathlib.Path)
    parser.add_argument("out", type=pathlib.Path)
    parser.add_argument("--minutes", type=float, default=20)
    parser.add_argument("--hfov", type=float, default=90)
    parser.add_argument("--model", type=pathlib.Path)
    parser.add_argument("--judge", nargs="*", default=[])
    arguments = parser.parse_args()
    learned, judged = clips_of(arguments)
    arguments.out.mkdir()
    model = arguments.model
    if model is None:
        model = arguments.out / "model"
        endoscape("train", "--data", *learned, "--hfov", arguments.hfov, "--minutes", arguments.minutes, "--out", model)
    found = {}
    for clip in judged:
        run, pictures = arguments.out / clip.name, arguments.out / f"{clip.name}-pictures"
        endoscape("run", clip, "--hfov", arguments.hfov, "--model", model, "--out", run)
        endoscape("convert", clip, pictures)
        found[clip.name] = (motions_of(run), state_of(clip), lumen_is_far(run, pictures / "frames"))
    table(found)


def table(found):
    def of(lag):
        return {
            name: [correlations(motion, state, stretch, lag) for stretch in STRETCHES]
            for name, (motion, state, _) in found.items()
        }

    lag = max((0, 1), key=lambda lag: np.nansum(list(of(lag).values())))
    print(f"image {lag} rows behind the state; r over {STRETCHES} frames; - where the robot did not move that way\n")
    print("| clip | frames | r rotation | r insertion | lumen farther | depth, lumen / wall |\n|---|---|---|---|---|---|")
    for name, by_stretch in of(lag).items():
        motion, _, (share, ratio) = found[name]
        rotation, insertion = (", ".join("-" if np.isnan(r) else f"{r:.2f}" for r in part) for part in zip(*by_stretch))
        print(f"| {name} | {len(motion) + 1} | {rotation} | {insertion} | {share:.0%} | {ratio:.2f} |")


if __name__ == "__main__":
    main()
