#!/usr/bin/env bash
# The experiment of Turan et al. (2018) on simulated stomachs: four steered flights, every method, one comparison.
#
#   scripts/paper_experiment.sh OUT MODEL [RECURRENT]
#
# OUT/flight-1 to flight-4 are simulated unless they exist. MODEL is a model of `train`, RECURRENT one of
# `train --supervised`; with ORB=1 and a binary built with `--features orb`, ORB SLAM takes part. The page is
# OUT/comparison/report.html.
set -euo pipefail

out=$1 model=$2 recurrent=${3:-}
endoscape=${ENDOSCAPE:-endoscape}

flight() { # NUMBER FPS FRAMES: a slow capsule is filmed at a low rate, as its makers do
    [ -d "$out/flight-$1" ] || "$endoscape" simulate "$out/flight-$1" --anatomy stomach --seed "40$1" \
        --path "steered-$1" --fps "$2" --frames "$3" --size 192x192
}
mkdir -p "$out"
flight 1 2 400
flight 2 5 320
flight 3 4 400
flight 4 10 300

methods=(learned direct magnetic fused)
[ -z "$recurrent" ] || methods+=(recurrent)
[ -z "${ORB:-}" ] || methods+=(orb)

truths=() runs=()
for number in 1 2 3 4; do
    truths+=(--truth "$out/flight-$number")
    for method in "${methods[@]}"; do
        case $method in
        learned | fused) options=(--model "$model") ;;
        recurrent) options=(--model "$recurrent") ;;
        *) options=() ;;
        esac
        result=$out/runs/$number/$method
        mkdir -p "$out/runs/$number"
        [ -d "$result" ] ||
            "$endoscape" run "$out/flight-$number" --method "$method" "${options[@]}" --depth none --out "$result"
        runs+=("$method=$result")
    done
done
"$endoscape" compare "${truths[@]}" --out "$out/comparison" --lengths 0.05,0.1,0.2,0.3,0.4,0.5 "${runs[@]}"
