#!/usr/bin/env bash
# Photons stored a second: enf-trace, with everything that it does (load, inflate, trace, park, write), beside a photon tracer on Embree
# that has the whole scene in memory and keeps its photons there, and beside Radiance's mkpmap. Interleaved, in one run; medians.
#
#   benches/photons.sh [SCENE...]                 room60k and rooms32 by default
#
# A SCENE is one that bench-embree draws (room60k, rooms32), or PREFIX of PREFIX.vtx, .idx, .light, .mat and _mats.rad. All sides get the same
# triangles, lamps and reflectances.
#
#   EMBREE_LIBRARY   Embree's library, or a folder with it (see benches/embree/README.md)
#   RADIANCE         the folder that has bin/mkpmap, bin/oconv and lib/ in it: that of PyPI's pyradiance is .../site-packages/pyradiance.
#                    Without it mkpmap is left out, said loudly
#   PHOTONS (4M)     photons sent off by us and on Embree; RADIANCE_PHOTONS (1M) is the size of mkpmap's global map
#   THREADS ("1 2"), REPETITIONS (5), MEMORY (380M), FOLDER (a temporary one; its stores are kept when it is named)
#   BIN, EMBREE_BIN  folders of binaries that are built already (enf-*, and embree-photons)
#
# mkpmap stores no direct light, so each photon in its map has cost it more than one of ours; figures are as the programs count. On
# Embree the faster of single rays and packets of sixteen counts, without the time to build the hierarchy (printed beside it).
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
scenes=("$@")
[ ${#scenes[@]} -gt 0 ] || scenes=(room60k rooms32)
bin=${BIN:-$here/../target/release}
[ -n "${BIN:-}" ] || (cd "$here/.." && cargo build --release --quiet)
embree=${EMBREE_BIN:-$here/embree/target/release}
[ -n "${EMBREE_BIN:-}" ] || (cd "$here/embree" && cargo build --release --quiet --bin embree-photons)
photons=${PHOTONS:-4M} map=${RADIANCE_PHOTONS:-1M} memory=${MEMORY:-380M}
read -ra threads <<<"${THREADS:-1 2}"
repetitions=${REPETITIONS:-5}
if [ -n "${RADIANCE:-}" ]; then
    export PATH=$RADIANCE/bin:$PATH RAYPATH=.:$RADIANCE/lib
elif ! command -v mkpmap >/dev/null; then
    echo "photons.sh: no mkpmap here: RADIANCE is to name a folder with bin/mkpmap (pip install pyradiance); going on without it" >&2
fi
radiance=$(command -v mkpmap || true)
# Radiance has no suffixes.
plain() { case $1 in *[kK]) echo "${1%?}000" ;; *M) echo "${1%?}000000" ;; *) echo "$1" ;; esac; }

if [ -n "${FOLDER:-}" ]; then
    mkdir -p "$FOLDER"
else
    FOLDER=$(mktemp -d)
    trap 'rm -rf "$FOLDER"' EXIT
fi
for i in "${!scenes[@]}"; do
    if [ -e "${scenes[$i]}.vtx" ]; then scenes[i]=$(realpath "${scenes[$i]}.vtx"); scenes[i]=${scenes[$i]%.vtx}; fi
done
cd "$FOLDER"
figures=$PWD/photons.txt
: >"$figures"

# A number of a report, by its name; those of "io" and "memory" have names of their own.
number() { sed -n "s/^ *\"$2\": *\([0-9.e+-]*\),*$/\1/p" "$1" | head -1; }
# SCENE THREADS WHO STORED WALL CPU
note() { echo "$*" >>"$figures"; }

for scene in "${scenes[@]}"; do
    name=$(basename "$scene")
    "$embree/embree-photons" "$scene" --write .
    "$bin/enf-partition" "$name.toml" -o "$name.enf" --memory "$memory" --quiet >/dev/null
    "$bin/enf-grid" "$name.enf" --memory "$memory" --quiet </dev/null >/dev/null
    if [ -n "$radiance" ]; then oconv -w "$name.rad" >"$name.oct"; fi
    for ((r = 0; r < repetitions; r++)); do
        for n in "${threads[@]}"; do
            rm -f "$name.enf"/trace.*
            "$bin/enf-trace" "$name.enf" --photons "$photons" --threads "$n" --memory "$memory" --quiet \
                --stats trace.json </dev/null >/dev/null
            note "$name" "$n" enf-trace "$(number trace.json photons_stored)" "$(number trace.json wall_s)" \
                "$(number trace.json cpu_s)" "$(number trace.json peak_resident_bytes)"
            for ways in "" --packets; do
                # stored S wall W cpu C build B
                # shellcheck disable=SC2086
                read -r _ stored _ wall _ cpu _ build < <("$embree/embree-photons" "$scene" \
                    --photons "$photons" --threads "$n" $ways)
                note "$name" "$n" "embree${ways#-}" "$stored" "$wall" "$cpu" "$build"
            done
            if [ -n "$radiance" ]; then
                TIMEFORMAT='%R %U %S'
                { time mkpmap -n "$n" -fo+ -t 0 -apm 5000 -apg "$name.pm" "$(plain "$map")" \
                    "$name.oct" >mkpmap.said 2>&1; } 2>mkpmap.time
                read -r wall user system <mkpmap.time
                note "$name" "$n" mkpmap "$(plain "$map")" "$wall" \
                    "$(awk "BEGIN { print $user + $system }")" 0
            fi
        done
    done
done

awk '
function median(list, n,   i, j, x) {
    for (i = 2; i <= n; i++) {
        x = list[i]
        for (j = i - 1; j >= 1 && list[j] > x; j--) list[j + 1] = list[j]
        list[j + 1] = x
    }
    return n % 2 ? list[(n + 1) / 2] : (list[n / 2] + list[n / 2 + 1]) / 2
}
function middle(key, column,   i, n, list) {
    n = count[key]
    for (i = 1; i <= n; i++) list[i] = value[key, i, column]
    return median(list, n)
}
# How many times as fast as `other` we are: the median of neighbouring runs.
function ratio(where, other, column,   i, n, list) {
    n = count[where " " other]
    for (i = 1; i <= n; i++)
        list[i] = value[where " enf-trace", i, column] / value[where " " other, i, column]
    return median(list, n)
}
{
    key = $1 " " $2 " " $3
    where = $1 " " $2
    if (!(where in seen)) { seen[where] = 1; order[++places] = where }
    n = ++count[key]
    value[key, n, "wall"] = $4 / $5 / 1e6
    value[key, n, "cpu"] = $4 / $6 / 1e6
    value[key, n, "stored"] = $4
    value[key, n, "more"] = $7
}
END {
    print "| scene | threads | who | photons stored, M | stored a second, M | a CPU second, M | ours over it: wall, CPU | |"
    print "|---|---|---|---|---|---|---|---|"
    split("enf-trace embree embree-packets mkpmap", who, " ")
    for (p = 1; p <= places; p++) {
        split(order[p], at, " ")
        for (w = 1; w <= 4; w++) {
            key = order[p] " " who[w]
            if (!(key in count)) continue
            more = middle(key, "more")
            note = w == 1 ? sprintf("%.0f MiB resident", more / 1048576) : w < 4 ? sprintf("and %.2f s to build", more) : ""
            over = w == 1 ? "" : sprintf("%.2f, %.2f", ratio(order[p], who[w], "wall"), ratio(order[p], who[w], "cpu"))
            printf "| %s | %s | %s | %.2f | %.3f | %.3f | %s | %s |\n", at[1], at[2], who[w],
                middle(key, "stored") / 1e6, middle(key, "wall"), middle(key, "cpu"), over, note
        }
    }
}' "$figures"
