#!/usr/bin/env bash
# Trains on the bench split and judges the result on seen and unseen frames.
#
#   scripts/bench_split.sh DATA OUT [MINUTES] [PRESET] [SEED]
#
# DATA holds c3vd/cecum_t1_a and endoslam/UnityCam/Stomach (docs/datasets.md); OUT must not exist. Training sees pictures
# only: C3VD frames 0 to 119 through a pinhole of 640x512, f = 360, and the 270 UnityCam frames. The networks then run
# over C3VD frames 0..120 (seen), 120..150 (unseen) and all 150, with a depth map of every frame.
set -euo pipefail

data=$1 out=$2 minutes=${3:-25} preset=${4:-fast} seed=${5:-0}
endoscape=${ENDOSCAPE:-endoscape}
pinhole=$out/c3vd-pinhole

mkdir "$out"
# 83.27 degrees over 640 pixels is f = 360.
"$endoscape" convert "$data/c3vd/cecum_t1_a" "$pinhole" --rectify --size 640x512 --hfov 83.27
"$endoscape" train --data "$pinhole@0..120" "$data/endoslam/UnityCam/Stomach" \
    --preset "$preset" --minutes "$minutes" --seed "$seed" --out "$out/model"

for part in seen:0..120 unseen:120..150 all:0..150; do
    name=${part%%:*} range=${part##*:}
    "$endoscape" run "$pinhole" --model "$out/model" --range "$range" --out "$out/$name"
    "$endoscape" eval trajectory "$out/$name" "$pinhole" --align sim3 | tee "$out/$name-trajectory.txt"
    "$endoscape" eval snippets "$out/$name" "$pinhole" | tee "$out/$name-snippets.txt"
    "$endoscape" eval depth "$out/$name" "$pinhole" --scaling median | tee "$out/$name-depth.txt"
done

# The one unseen picture with known depth, in the run over all frames: there motion has corrected it.
mkdir "$out/unseen-in-all"
cp "$out/all/depth/000120.png" "$out/unseen-in-all"
"$endoscape" eval depth "$out/unseen-in-all" "$pinhole" --scaling median | tee "$out/unseen-in-all-depth.txt"
