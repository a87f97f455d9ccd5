#!/usr/bin/env bash
# Trains the bundled model (models/capsule) on simulated patients and nothing else.
#
#   scripts/bundled_model.sh OUT [MINUTES]
#
# OUT must not exist. Seeds 101 to 112 teach, 201 and 202 choose the checkpoint; `endoscape demo` flies through another.
# Lenses go from a narrow endoscope's to a capsule's, so that the networks do not learn one of them by heart.
set -euo pipefail

out=$1 minutes=${2:-25}
endoscape=${ENDOSCAPE:-endoscape}

mkdir "$out" "$out/lenses"
lens() { # NAME FOCAL_LENGTH: a pinhole for pictures of 160x128
    printf 'width = 160\nheight = 128\nmodel = "pinhole"\nfx = %s\nfy = %s\ncx = 79.5\ncy = 63.5\n' "$2" "$2" \
        >"$out/lenses/$1.toml"
}
lens narrow 90 # 83 degrees across
lens wide 57   # 109 degrees

patient() { # SEED ANATOMY PATH LENS FPS: lens `capsule` is the simulator's own, 145 degrees
    local camera=()
    [ "$4" = capsule ] || camera=(--camera "$out/lenses/$4.toml")
    "$endoscape" simulate "$out/$1" --seed "$1" --anatomy "$2" --path "$3" --fps "$5" \
        --frames 200 --size 160x128 "${camera[@]}"
}
patient 101 colon survey narrow 10
patient 102 colon withdrawal capsule 10
patient 103 colon insertion wide 10
patient 104 colon capsule capsule 10
patient 105 colon survey wide 15
patient 106 stomach steered-1 narrow 10
patient 107 stomach steered-4 capsule 10
patient 108 stomach capsule wide 10
patient 109 small-bowel capsule capsule 10
patient 110 small-bowel survey narrow 10
patient 111 colon withdrawal narrow 10
patient 112 colon steered-2 wide 10
patient 201 colon survey capsule 10
patient 202 stomach steered-3 narrow 10

"$endoscape" train --data "$out"/1?? --validation "$out"/2?? --preset fast --minutes "$minutes" --out "$out/model"
