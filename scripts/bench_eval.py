#!/usr/bin/env python3
"""Time and memory of `endoscape eval trajectory` beside evo on one long trajectory.

    cargo build --release -p endoscape-cli
    pip install evo numpy
    python scripts/bench_eval.py target/release/endoscape --poses 1000000

Both read the same two TUM files and compute the absolute error (translation and rotation) after Sim(3) alignment and the
relative error over 10 frames. endoscape computes its sub-trajectory errors and three baselines besides. Wall time and
peak memory are those of the whole process.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

WITH_EVO = """
import sys
from evo.core import metrics, sync
from evo.tools import file_interface
truth, estimate = (file_interface.read_tum_trajectory_file(path) for path in sys.argv[1:3])
truth, estimate = sync.associate_trajectories(truth, estimate)
estimate.align(truth, correct_scale=True)
for relation in (metrics.PoseRelation.translation_part, metrics.PoseRelation.rotation_angle_deg):
    absolute = metrics.APE(relation)
    absolute.process_data((truth, estimate))
    relative = metrics.RPE(relation, 10, metrics.Unit.frames)
    relative.process_data((truth, estimate))
    print(absolute.get_all_statistics()["rmse"], relative.get_all_statistics()["rmse"])
"""


def write(path, poses, seed):
    """A winding path with noise, 0.04 s between poses."""
    rng = np.random.default_rng(seed)
    angle = np.arange(poses) * 0.01
    position = np.column_stack([5 * np.sin(angle), 3 * np.cos(0.7 * angle), 0.02 * angle])
    position += rng.normal(0, 0.001, position.shape)
    quaternion = np.column_stack([np.zeros(poses), np.sin(angle / 2), np.zeros(poses), np.cos(angle / 2)])
    np.savetxt(path, np.column_stack([np.arange(poses) * 0.04, position, quaternion]), fmt="%.9f")


def measured(command):
    """Wall seconds, peak resident MiB and output of one process."""
    start = time.perf_counter()
    process = subprocess.Popen([str(part) for part in command], stdout=subprocess.PIPE, text=True)
    output = process.stdout.read()
    _, status, usage = os.wait4(process.pid, 0)
    if status != 0:
        sys.exit(f"{command[0]} failed")
    return time.perf_counter() - start, usage.ru_maxrss / 1024, output


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("binary", nargs="?", default="target/release/endoscape")
    parser.add_argument("--poses", type=int, default=1_000_000)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        truth, estimate = Path(folder) / "truth.tum", Path(folder) / "estimate.tum"
        write(truth, arguments.poses, 1)
        write(estimate, arguments.poses, 2)
        ours = measured([arguments.binary, "eval", "trajectory", estimate, truth, "--rpe-delta", "10", "--json"])
        theirs = measured([sys.executable, "-c", WITH_EVO, truth, estimate])
    print(f"{'':<12}{'seconds':>10}{'MiB':>10}")
    for name, (seconds, memory, _) in (("endoscape", ours), ("evo", theirs)):
        print(f"{name:<12}{seconds:>10.2f}{memory:>10.0f}")
    print(f"{theirs[0] / ours[0]:.1f} times faster, {theirs[1] / ours[1]:.1f} times less memory")
    print("evo:", theirs[2].split())


if __name__ == "__main__":
    main()
