#!/usr/bin/env python3
"""Compares `endoscape eval trajectory --json` with evo from PyPI on random trajectory pairs.

evo is only called, as an independent judge; nothing of it is in this repository.

    cargo build -p endoscape-cli
    pip install evo numpy
    python scripts/compare_with_evo.py target/debug/endoscape            # 200 random pairs
    python scripts/compare_with_evo.py --print-reference                 # numbers of crates/eval/tests/evo_values.rs

Every figure has to agree to 1e-9 relative. Minima of errors and spreads may be tiny beside the errors themselves, so
"relative" is to the larger of the figure and the root mean square it belongs to.
"""

import argparse
import json
import math
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from evo.core import metrics, sync
from evo.core.trajectory import PoseTrajectory3D
from evo.tools import file_interface

TOLERANCE = 1e-9
ALIGNMENTS = ["none", "se3", "sim3", "scale", "first"]
UNITS = {
    "f": metrics.Unit.frames,
    "m": metrics.Unit.meters,
    "d": metrics.Unit.degrees,
    "r": metrics.Unit.radians,
}
RELATIONS = {
    "translation": metrics.PoseRelation.translation_part,
    "rotation": metrics.PoseRelation.rotation_angle_deg,
    "full": metrics.PoseRelation.full_transformation,
}


def quaternion_product(a, b):
    """Hamilton product, w last."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return np.array(
        [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ]
    )


def turn(vector):
    """Quaternion (w last) of a rotation vector."""
    angle = np.linalg.norm(vector)
    if angle < 1e-12:
        return np.array([0.0, 0.0, 0.0, 1.0])
    return np.append(vector / angle * math.sin(angle / 2), math.cos(angle / 2))


def random_pair(rng):
    """A smooth random truth and a noisy, scaled, moved estimate: arrays of (time, position, quaternion)."""
    count = int(rng.integers(30, 220))
    size = 10.0 ** rng.uniform(-2, 2)
    times = np.cumsum(rng.uniform(0.02, 0.06, count)) + rng.choice([0.0, 1.4e9])
    velocity = np.cumsum(rng.normal(0, 0.3, (count, 3)), axis=0)
    positions = np.cumsum(velocity, axis=0) * size * 0.01
    turns = rng.normal(0, 0.06, (count, 3)) + rng.normal(0, 0.05, 3)
    rotations = [turn(rng.normal(0, 1, 3))]
    for vector in turns[1:]:
        rotations.append(quaternion_product(rotations[-1], turn(vector)))
    truth = np.column_stack([times, positions, np.array(rotations)])

    noise = size * 10.0 ** rng.uniform(-4, -1)
    moved = positions * rng.uniform(0.2, 5.0) + rng.normal(0, size, 3) + rng.normal(0, noise, (count, 3))
    turned = [quaternion_product(q, turn(rng.normal(0, 0.03, 3))) for q in rotations]
    stamps = times + rng.uniform(-0.004, 0.004, count)
    estimate = np.column_stack([stamps, moved, np.array(turned)])
    estimate = estimate[np.argsort(estimate[:, 0], kind="stable")]
    return truth, estimate


def disturb(rng, truth, estimate):
    """Gaps, duplicated stamps, missing truth, in random mixture."""
    what = []
    if rng.random() < 0.5:
        what.append("gaps")
        start = int(rng.integers(0, len(estimate) - 10))
        estimate = np.delete(estimate, slice(start, start + int(rng.integers(1, 9))), axis=0)
        estimate = estimate[rng.random(len(estimate)) > 0.1]
    if rng.random() < 0.3:
        what.append("thin truth")
        truth = truth[rng.random(len(truth)) > 0.3]
    if rng.random() < 0.4:
        what.append("duplicates")
        for _ in range(3):
            index = int(rng.integers(0, len(estimate)))
            twin = estimate[index].copy()
            twin[1:4] += rng.normal(0, 0.01, 3)
            estimate = np.insert(estimate, index + 1, twin, axis=0)
    return truth, estimate, what


def write_tum(path, poses):
    path.write_text("\n".join(" ".join(repr(float(x)) for x in pose) for pose in poses) + "\n")


def with_evo(truth_file, estimate_file, align, delta, unit, all_pairs):
    """The same figures from evo; raises evo's exceptions where it refuses."""
    truth = file_interface.read_tum_trajectory_file(str(truth_file))
    estimate = file_interface.read_tum_trajectory_file(str(estimate_file))
    truth, estimate = sync.associate_trajectories(truth, estimate)
    scale = 1.0
    if align in ("se3", "sim3", "scale"):
        _, _, scale = estimate.align(truth, correct_scale=align == "sim3", correct_only_scale=align == "scale")
    elif align == "first":
        estimate.align_origin(truth)
    figures = {"matched": estimate.num_poses, "scale": scale}
    for name, relation in RELATIONS.items():
        absolute = metrics.APE(relation)
        absolute.process_data((truth, estimate))
        figures["ape " + name] = absolute.get_all_statistics()
        relative = metrics.RPE(relation, delta, UNITS[unit], all_pairs=all_pairs)
        relative.process_data((truth, estimate))
        figures["rpe " + name] = relative.get_all_statistics()
        figures["pairs"] = len(relative.delta_ids)
    return figures


def with_endoscape(binary, truth_file, estimate_file, align, delta, unit, all_pairs):
    command = [binary, "eval", "trajectory", estimate_file, truth_file, "--json", "--keep-duplicates"]
    command += ["--align", align, "--rpe-delta", repr(delta), "--rpe-unit", unit]
    command += ["--all-pairs"] if all_pairs else []
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        return None, done.stderr.strip()
    result = json.loads(done.stdout)
    rpe = result["rpe"]
    return {
        "matched": result["matched"],
        "scale": result["scale"],
        "pairs": rpe["pairs"],
        "ape translation": result["ate_m"],
        "ape rotation": result["rotation_deg"],
        "ape full": result["full"],
        "rpe translation": rpe["translation_m"],
        "rpe rotation": rpe["rotation_deg"],
        "rpe full": rpe["full"],
    }, ""


def worst_difference(ours, theirs):
    """Largest relative difference over all figures, with its name."""
    worst = (0.0, "")
    for name, expected in theirs.items():
        if isinstance(expected, dict):
            rmse = abs(expected["rmse"])
            for statistic, value in expected.items():
                floor = rmse * rmse if statistic == "sse" else rmse
                difference = abs(ours[name][statistic] - value) / max(abs(value), floor, 1e-300)
                worst = max(worst, (difference, f"{name} {statistic}"))
        else:
            worst = max(worst, (abs(ours[name] - expected) / max(abs(expected), 1e-300), name))
    return worst


def random_delta(rng, truth):
    unit = str(rng.choice(list(UNITS)))
    steps = np.linalg.norm(np.diff(truth[:, 1:4], axis=0), axis=1)
    delta = {
        "f": float(rng.integers(1, 12)),
        "m": float(steps.mean() * rng.uniform(2, 12)),
        "d": float(rng.uniform(8, 60)),
        "r": float(rng.uniform(0.15, 1.0)),
    }[unit]
    return delta, unit


def compare(binary, pairs, seed):
    rng = np.random.default_rng(seed)
    worst, compared, refused, kinds = (0.0, ""), 0, 0, {}
    with tempfile.TemporaryDirectory() as folder:
        truth_file, estimate_file = Path(folder) / "truth.tum", Path(folder) / "estimate.tum"
        while compared < pairs:
            truth, estimate = random_pair(rng)
            truth, estimate, disturbed = disturb(rng, truth, estimate)
            delta, unit = random_delta(rng, truth)
            align, all_pairs = ALIGNMENTS[compared % len(ALIGNMENTS)], bool(rng.random() < 0.5)
            write_tum(truth_file, truth)
            write_tum(estimate_file, estimate)
            arguments = (truth_file, estimate_file, align, delta, unit, all_pairs)
            ours, sentence = with_endoscape(binary, *arguments)
            try:
                theirs = with_evo(*arguments)
            except Exception as refusal:
                # Nothing to compare, but both have to refuse.
                if ours is not None:
                    sys.exit(f"evo refuses what endoscape accepts: {refusal} ({arguments})")
                refused += 1
                continue
            if ours is None:
                sys.exit(f"endoscape refuses what evo accepts: {sentence} ({arguments})")
            difference = worst_difference(ours, theirs)
            worst = max(worst, difference)
            if difference[0] > TOLERANCE:
                sys.exit(f"{difference[1]} differs by {difference[0]:.2e} ({align}, {delta} {unit}, all={all_pairs}, {disturbed})")
            for kind in [f"align {align}", f"unit {unit}", "all pairs" if all_pairs else "consecutive", *disturbed]:
                kinds[kind] = kinds.get(kind, 0) + 1
            compared += 1
    print(f"{compared} pairs agree with evo to {worst[0]:.1e} relative (worst: {worst[1]}); both refused {refused} more")
    print(", ".join(f"{kind}: {count}" for kind, count in sorted(kinds.items())))


def reference_pair():
    """The trajectories of crates/eval/tests/evo_values.rs, by the same formulae."""
    truth, estimate = [], []
    for i in range(120):
        angle = 0.05 * i
        position = np.array([3 * math.sin(angle), 2 * math.cos(0.7 * angle), 0.5 * angle])
        rotation = turn(np.array([0.3, 1.0, -0.2]) * 0.4 * angle)
        truth.append(np.concatenate([[0.1 * i], position, rotation]))
        wobble = np.array([math.sin(1.3 * i), math.cos(2.1 * i), math.sin(0.4 * i + 1)]) * 0.05
        turned = quaternion_product(rotation, turn(wobble * 0.4))
        estimate.append(np.concatenate([[0.1 * i + 0.003], position * 0.5 + wobble + np.array([1.0, -2.0, 3.0]), turned]))
    return np.array(truth), np.array(estimate)


def print_reference():
    with tempfile.TemporaryDirectory() as folder:
        truth_file, estimate_file = Path(folder) / "truth.tum", Path(folder) / "estimate.tum"
        truth, estimate = reference_pair()
        write_tum(truth_file, truth)
        write_tum(estimate_file, estimate)
        cases = [("none", 1.0, "f", False), ("se3", 0.5, "m", True), ("sim3", 0.5, "m", False)]
        cases += [("scale", 10.0, "d", True), ("first", 0.2, "r", False)]
        for case in cases:
            figures = with_evo(truth_file, estimate_file, *case)
            ape, turned = figures["ape translation"], figures["ape rotation"]
            moved, rotated = figures["rpe translation"], figures["rpe rotation"]
            print(case, figures["scale"], ape["rmse"], ape["median"], turned["mean"], figures["ape full"]["rmse"])
            print("   ", figures["pairs"], moved["rmse"], moved["max"], rotated["rmse"], figures["rpe full"]["mean"])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("binary", nargs="?", default="target/debug/endoscape")
    parser.add_argument("--pairs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--print-reference", action="store_true")
    arguments = parser.parse_args()
    if arguments.print_reference:
        print_reference()
    else:
        compare(arguments.binary, arguments.pairs, arguments.seed)


if __name__ == "__main__":
    main()
