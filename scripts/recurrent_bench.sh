#!/usr/bin/env bash
# Trains the recurrent network on simulated patients and compares it with the learned method on patients it never saw.
#
#   scripts/recurrent_bench.sh OUT [MINUTES]
#
# OUT must not exist. Seeds 301 to 316 teach, 401 and 402 choose the checkpoint, 501 to 504 judge. One lens and one frame
# rate throughout, as a recorder has them; all lengths are metres. Prints each method's errors on each unseen patient.
set -euo pipefail

out=$1 minutes=${2:-15}
endoscape=${ENDOSCAPE:-endoscape}
bundled=${MODEL:-$(dirname "$0")/../models/capsule}

patient() { # SEED ANATOMY PATH FRAMES
    "$endoscape" simulate "$out/$1" --seed "$1" --anatomy "$2" --path "$3" --fps 10 --frames "$4" --size 192x192
}
mkdir "$out"
patient 301 colon survey 120
patient 302 colon withdrawal 120
patient 303 colon insertion 120
patient 304 colon capsule 120
patient 305 colon survey 120
patient 306 stomach steered-1 120
patient 307 stomach steered-4 120
patient 308 stomach capsule 120
patient 309 small-bowel capsule 120
patient 310 small-bowel survey 120
patient 311 colon steered-2 120
patient 312 stomach steered-2 120
patient 313 colon withdrawal 120
patient 314 small-bowel withdrawal 120
patient 315 stomach survey 120
patient 316 colon steered-3 120
patient 401 colon survey 80
patient 402 stomach steered-3 80
patient 501 colon withdrawal 100
patient 502 stomach steered-2 100
patient 503 small-bowel capsule 100
patient 504 colon survey 100

"$endoscape" train --supervised --data "$out"/3?? --validation "$out"/4?? --minutes "$minutes" --out "$out/model"

judge() { # METHOD NAME [FLAGS]
    local method=$1 name=$2 model=$3
    shift 3
    for seed in 501 502 503 504; do
        "$endoscape" run "$out/$seed" --method "$method" --model "$model" --depth none --out "$out/$name-$seed" "$@" >/dev/null
        for align in se3 sim3; do
            echo "== $name $seed $align"
            "$endoscape" eval trajectory "$out/$name-$seed" "$out/$seed" --align "$align"
        done
    done
}
judge recurrent recurrent "$out/model"
judge learned learned "$bundled"
judge learned networks-only "$bundled" --networks-only
