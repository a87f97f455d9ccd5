#!/usr/bin/env python3
"""What the 8-bit depth of EndoSLAM's UnityCam means, read off the pictures themselves.

The renderer's only light sits at the lens, so linear brightness falls with the square of the distance. If the stored
value v is proportional to 1/z, linear brightness grows with v^2; if it is proportional to z, with v^-2.

usage: endoslam_unity_evidence.py FOLDER     (the folder that holds Frames and "Pixelwise Depths")
needs: numpy, pillow
"""
import sys
from pathlib import Path

import numpy as np
from PIL import Image

GAMMA = 2.2


def rank(values):
    return np.argsort(np.argsort(values))


def main(folder):
    frames = sorted(Path(folder, "Frames").glob("image_*.png"))
    slopes, correlations, levels = [], [], []
    for frame in frames[::10]:
        rgb = np.asarray(Image.open(frame).convert("RGB"), float)
        depth = np.asarray(Image.open(Path(folder, "Pixelwise Depths", f"aov_{frame.name}")))[..., 0].astype(float)
        luma = rgb @ [0.299, 0.587, 0.114]
        rows, columns = np.mgrid[: luma.shape[0], : luma.shape[1]]
        centre = (luma.shape[0] - 1) / 2
        inside = (rows - centre) ** 2 + (columns - centre) ** 2 < (0.44 * luma.shape[0]) ** 2
        use = inside & (luma > 25) & (luma < 240) & (depth >= 2)
        slopes.append(np.polyfit(np.log(depth[use]), GAMMA * np.log(luma[use]), 1)[0])
        correlations.append(np.corrcoef(rank(luma[use]), rank(depth[use]))[0, 1])
        levels.append(len(np.unique(depth)))
    print(f"frames looked at: {len(slopes)}")
    print(f"distinct depth values per frame: {min(levels)} to {max(levels)}")
    print(f"rank correlation of brightness and stored value: median {np.median(correlations):.3f}, least {min(correlations):.3f}")
    print(f"slope of log linear brightness over log value: median {np.median(slopes):.2f} (1/z: +2, z: -2)")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(sys.argv[1])
