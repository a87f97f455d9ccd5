#!/usr/bin/env bash
# What each part of preset `fast` is worth: trains it with one thing changed at a time and judges every model.
#
#   scripts/ablation.sh DATA OUT [STEPS] [ROW...]
#
# DATA is that of bench_split.sh. Each ROW (all by default, see below) becomes OUT/ROW; rows that are there already are resumed,
# so that an interrupted table can be finished. Training sees the pictures of the bench split and nothing else; the
# figures are those of frames 0 to 119: AbsRel and ATE with aligned pictures, then of the networks alone.
set -euo pipefail

data=$1 out=$2 steps=${3:-1000}
endoscape=${ENDOSCAPE:-endoscape}
pinhole=$out/c3vd-pinhole
declare -A change=(
    [fast]=''
    [no-mask]='[nets.pose]\nmask = "none"'
    [batch-norm]='[nets.disp]\nbatch_norm = true\n[nets.pose]\nbatch_norm = true'
    [paper-losses]='[objective]\nssim_weight = 0.0\nout_of_view = "grey"\nacross_sources = "sum"\nauto_mask = false\nbrightness = "constant"\nsmoothness = "second-order-disparity"\nsmoothness_weight = 0.4\nmask_weight = 0.15\nlight_weight = 0.0'
    [no-light]='[objective]\nlight_weight = 0.0'
    [no-auto-mask]='[objective]\nauto_mask = false'
    [no-ssim]='[objective]\nssim_weight = 0.0'
    [sum-of-sources]='[objective]\nacross_sources = "sum"'
    [constant-brightness]='[objective]\nbrightness = "constant"'
    [with-geometry]='[objective]\ngeometry_weight = 0.5'
)
rows=("${@:4}")
[ ${#rows[@]} -gt 0 ] || rows=(fast no-mask batch-norm paper-losses no-light no-auto-mask no-ssim sum-of-sources constant-brightness with-geometry)

mkdir -p "$out"
# 83.27 degrees over 640 pixels is f = 360.
[ -d "$pinhole" ] || "$endoscape" convert "$data/c3vd/cecum_t1_a" "$pinhole" --rectify --size 640x512 --hfov 83.27

estimate() { grep '^estimate' "$1" | head -1 | awk '{ print $2 }'; }

judge() { # ROW [--networks-only]: AbsRel and ATE in mm
    local result=$out/$1-run${2:-}
    rm -rf "$result"
    "$endoscape" run "$pinhole" --model "$out/$1" --range 0..120 --out "$result" "${@:2}" >"$result.log" 2>&1
    "$endoscape" eval depth "$result" "$pinhole" --scaling median >"$result-depth.txt" 2>&1
    "$endoscape" eval trajectory "$result" "$pinhole" --align sim3 >"$result-trajectory.txt" 2>&1
    printf '%s %s ' "$(estimate "$result-depth.txt")" "$(estimate "$result-trajectory.txt")"
}

for row in "${rows[@]}"; do
    printf "${change[$row]}\n" >"$out/$row.toml"
    how=(--preset fast --config "$out/$row.toml")
    [ ! -d "$out/$row" ] || how=(--resume)
    "$endoscape" train --data "$pinhole@0..120" "$data/endoslam/UnityCam/Stomach" "${how[@]}" --steps "$steps" \
        --out "$out/$row" >"$out/$row.log" 2>&1
    echo "$row $(judge "$row")$(judge "$row" --networks-only)"
done
