#!/usr/bin/env bash
# Streets first, endoscopy second, against endoscopy alone in the same time (the paper's transfer).
#
#   scripts/two_stages.sh DATA OUT [MINUTES] [SEED]
#
# DATA holds kitti-odometry and what bench_split.sh needs; OUT must not exist. MINUTES (20) are those of the whole: half of
# them on KITTI 00 and half on the bench split, and all of them on the bench split alone. Both are judged on C3VD frames 0
# to 119 (seen) and 120 to 149 (unseen). before/ and after/ hold disparity of the same picture after each stage.
set -euo pipefail

data=$1 out=$2 minutes=${3:-20} seed=${4:-0}
endoscape=${ENDOSCAPE:-endoscape}
pinhole=$out/c3vd-pinhole
half=$(awk "BEGIN { print $minutes / 2 }")

mkdir "$out"
"$endoscape" convert "$data/c3vd/cecum_t1_a" "$pinhole" --rectify --size 640x512 --hfov 83.27
printf '[objective]\nlight_weight = 0.0\n' >"$out/streets.toml"
endoscopy=("$pinhole@0..120" "$data/endoslam/UnityCam/Stomach")

"$endoscape" train --data "$data/kitti-odometry/sequences/00" --config "$out/streets.toml" --minutes "$half" --seed "$seed" --out "$out/streets"
"$endoscape" train --data "${endoscopy[@]}" --init "$out/streets" --minutes "$half" --seed "$seed" --out "$out/transferred"
"$endoscape" train --data "${endoscopy[@]}" --minutes "$minutes" --seed "$seed" --out "$out/alone"

picture=$pinhole/frames/000000.png
"$endoscape" depth "$picture" --model "$out/streets" --out "$out/before"
"$endoscape" depth "$picture" --model "$out/transferred" --out "$out/after"
for model in transferred alone; do
    for part in seen:0..120 unseen:120..150; do
        result=$out/$model-${part%%:*}
        "$endoscape" run "$pinhole" --model "$out/$model" --range "${part#*:}" --out "$result"
        "$endoscape" eval trajectory "$result" "$pinhole" --align sim3 | tee "$result-trajectory.txt"
        "$endoscape" eval depth "$result" "$pinhole" --scaling median | tee "$result-depth.txt"
    done
done
