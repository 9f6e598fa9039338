#!/usr/bin/env bash
# How long Ctrl-C takes: every stage of a building is begun and interrupted at several moments, with SIGINT and SIGTERM in turn. Prints the
# longest wait of each stage, the moment, and whatever ended with another code than 130 or 143 or said nothing about going on.
#
#   benches/interrupt.sh [BUILDING] [MOMENTS] [FOLDER]     # octagon, 8, a temporary folder
#
# BUILDING is what `enfilade building` knows, with its flags ("tower --floors 4"), or a scene file. BIN is the folder of the binaries
# (target/release), PHOTONS the photons a light (50k), SIZE the pictures' (640x480), VIEW which (auto: three), FLAGS more flags for every stage.
set -euo pipefail
building=${1:-octagon} moments=${2:-8} folder=${3:-}
bin=$(realpath "${BIN:-$(dirname "$0")/../target/release}")
photons=${PHOTONS:-50k} size=${SIZE:-640x480} flags=${FLAGS:-}
if [ -z "$folder" ]; then
    folder=$(mktemp -d)
    trap 'rm -rf "$folder"' EXIT
fi
if [ -e "$building" ]; then building=$(realpath "$building"); fi
mkdir -p "$folder"
cd "$folder"
if [ -e "$building" ]; then
    scene=$building
else
    # shellcheck disable=SC2086
    "$bin/enfilade" building $building -o scene.toml
    scene=scene.toml
fi

# Milliseconds.
now() { echo $(($(date +%s%N) / 1000000)); }

stage() {
    local name=$1
    shift
    local began total longest=0 where=0 wrong=0 caught=0
    rm -f "b.enf/$name".*
    began=$(now)
    # shellcheck disable=SC2086
    "$bin/enf-$name" "$@" $flags --quiet >/dev/null
    total=$(($(now) - began))
    for ((i = 1; i <= moments; i++)); do
        rm -f "b.enf/$name".*
        local signal=INT code=0 wanted=130 at=$((total * i / (moments + 1)))
        if ((i % 2 == 0)); then signal=TERM wanted=143; fi
        # shellcheck disable=SC2086
        "$bin/enf-$name" "$@" $flags --quiet >/dev/null 2>said &
        local child=$!
        sleep "$(printf '%d.%03d' $((at / 1000)) $((at % 1000)))"
        began=$(now)
        if ! kill -s $signal $child 2>/dev/null; then
            wait $child || true
            continue
        fi
        wait $child || code=$?
        local waited=$(($(now) - began))
        # It may have come to its end meanwhile.
        if ((code == 0)); then continue; fi
        caught=$((caught + 1))
        if ((code != wanted)) || ! grep -q "goes on from here" said; then
            wrong=$((wrong + 1))
            echo "$name at $at ms: exit $code, $(cat said)" >&2
        fi
        if ((waited > longest)); then longest=$waited where=$at; fi
    done
    # Whatever the last one left is gone on with.
    # shellcheck disable=SC2086
    "$bin/enf-$name" "$@" $flags --quiet >/dev/null
    printf '%-10s %8d ms in all, %2d times interrupted, longest wait %5d ms (at %d ms), %d wrong\n' \
        "$name" "$total" "$caught" "$longest" "$where" "$wrong"
}

stage partition "$scene" -o b.enf
stage grid b.enf
stage trace b.enf --photons-per-light "$photons"
stage kdtree b.enf
stage render b.enf --view "${VIEW:-auto}" --width "${size%x*}" --height "${size#*x}" -o pictures
