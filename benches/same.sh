#!/usr/bin/env bash
# The same photons, whatever happens: the L-Shape (337,262 triangles, 24 lights) traced with other threads, budgets, rooms, tiles,
# queues and processes, and in runs that are killed at random moments and begun again. And the same pictures: its views, a plan and a
# panorama, seen directly and by final gathering, with other threads, budgets, tiles and queues.
#
#   benches/same.sh [KILLED RUNS, 100] [PHOTONS A LIGHT, 5k] [WIDTH OF PICTURES, 320]
#
# Prints each digest and exits with 1 at the first that differs. BIN is a folder of binaries that are built already. SEED (1) decides
# when runs are killed.
set -euo pipefail
cd "$(dirname "$0")/.."
runs=${1:-100}
photons=${2:-5k}
width=${3:-320}
bin=${BIN:-$PWD/target/release}
[ -n "${BIN:-}" ] || cargo build --release --quiet
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"$bin/enfilade" building l-shape -o l.toml >/dev/null 2>&1
RANDOM=${SEED:-1}

prepared() { # flags of the partitioner
    rm -rf l.enf
    "$bin/enf-partition" l.toml -o l.enf --quiet "$@" >/dev/null
    "$bin/enf-grid" l.enf --quiet </dev/null >/dev/null
}
trace() {
    "$bin/enf-trace" "${store:-l.enf}" --photons-per-light "$photons" --quiet "$@" </dev/null >/dev/null
}
expected=
check() { # what was done
    local digest
    digest=$("$bin/enfilade" inspect "${store:-l.enf}" --digest photons)
    [ -n "$expected" ] || expected=$digest
    printf '%s  %s\n' "$digest" "$1"
    [ "$digest" = "$expected" ] || { echo "$0: that is another one" >&2 && exit 1; }
}

prepared
for threads in 1 2 4; do
    prepared
    trace --threads $threads && check "$threads threads"
done
for memory in 64M 128M 380M 1G 4G; do
    prepared --memory $memory
    trace --memory $memory && check "--memory $memory"
done
for rooms in 1 8 64 200 500; do
    prepared --rooms $rooms
    trace && check "--rooms $rooms"
done
prepared --random-tiles 60
trace --queue-rows 4 --queue-block 64 --resident-rooms 1 --schedule most-work && check "60 random tiles, small queues, one tile at a time"
prepared --random-tiles 60
for share in 0/2 1/2; do
    trace --share $share --threads 1 &
done
wait
check "60 random tiles, two processes"

prepared
trace
"$bin/enf-kdtree" l.enf --quiet </dev/null >/dev/null
seen=
pictures() { # what is done, flags of the renderer
    local what=$1 digest
    shift
    rm -rf pictures
    "$bin/enf-render" l.enf --view all --view plan:0 --view panorama:0 --width "$width" --formats exr,png --force --quiet \
        -o pictures "$@" </dev/null >/dev/null
    digest=$(cd pictures && sha256sum * | sha256sum | cut -c1-32)
    [ -n "$seen" ] || seen=$digest
    printf '%s  pictures, %s\n' "$digest" "$what"
    [ "$digest" = "$seen" ] || { echo "$0: those are others" >&2 && exit 1; }
}
for indirect in photon-map final-gather; do
    seen=
    for memory in 64M 380M 4G; do
        for threads in 1 2; do
            pictures "$indirect, --memory $memory, $threads threads" --indirect $indirect --memory $memory --threads $threads
        done
    done
    pictures "$indirect, small queues, one tile at a time" --indirect $indirect --queue-rows 4 --queue-block 500 --resident-rooms 1
done

prepared
cp -r l.enf clean.enf
store=killed.enf
kills=0
killed=("$bin/enf-trace" killed.enf --photons-per-light "$photons" --queue-block 1k --epoch 0.02 --quiet)
# How long a whole one takes, in ms: a run is killed after 5 to 80 % of that.
cp -r clean.enf killed.enf
began=${EPOCHREALTIME//[.,]/}
"${killed[@]}" </dev/null >/dev/null 2>&1
whole=$(((${EPOCHREALTIME//[.,]/} - began) / 1000))
for ((run = 1; run <= runs; run++)); do
    rm -rf killed.enf
    cp -r clean.enf killed.enf
    times=0
    while :; do
        "${killed[@]}" </dev/null >/dev/null 2>&1 &
        process=$!
        sleep "$(printf '%d.%03d' $(((after = whole * (RANDOM % 75 + 5) / 100) / 1000)) $((after % 1000)))"
        kill -9 $process 2>/dev/null || true
        wait $process 2>/dev/null && break
        times=$((times + 1))
    done
    kills=$((kills + times))
    check "run $run, killed $times times"
done
echo "one digest; $runs runs were killed $kills times"
