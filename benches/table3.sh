#!/usr/bin/env bash
# Table 3 of Fradin, Meneveaux and Horna 2005 with the generated buildings: photons, times, loads, reflections, bytes, memory.
#
#   benches/table3.sh [FOLDER] [BUILDING...]      a building is one of those below; all but the towers by default
#
# Everything goes to FOLDER (default ./table3), which keeps the statistics of each stage and loses each store when its row is
# printed (KEEP=1 keeps them, and goes on with what is there). MEMORY (380M) and THREADS are handed on; BIN is a folder of binaries that are built already. Z-Building_101 takes 20 GB of disk, Tower_024 another 20.
set -euo pipefail
cd "$(dirname "$0")/.."
folder=${1:-table3}
shift || true
buildings=("$@")
[ ${#buildings[@]} -gt 0 ] || buildings=(L-Shape Z-Building Octagon Z-Building_021 Z-Building_101)
bin=${BIN:-$PWD/target/release}
[ -n "${BIN:-}" ] || cargo build --release --quiet
mkdir -p "$folder"
cd "$folder"
flags=(--memory "${MEMORY:-380M}" ${THREADS:+--threads "$THREADS"})

# What the generator is asked for, photons a light, and the paper's row: millions of impacts, propagation, photon maps.
paper() {
    case $1 in
    L-Shape) echo "l-shape 50k 4.6 1'19\" 21\"" ;;
    Z-Building) echo "z-building 50k 3 33\" 1\"" ;;
    Z-Building_021) echo "z-building:21 50k 63 18'07\" 5'24\"" ;;
    Z-Building_101) echo "z-building:101 50k 303 1h49' 26'02\"" ;;
    Octagon) echo "octagon 50k 30 4'04\" 2'14\"" ;;
    Tower_024) echo "tower:24 2200 51 30'39\" 4'16\"" ;;
    Tower_040) echo "tower:40 20k 898 4h07' 1h34'" ;;
    *) echo "$0: there is no $1 in the table" >&2 && exit 2 ;;
    esac
}

# A number of a report, by its name; those of "io" and "memory" have names of their own.
number() {
    sed -n "s/^ *\"$2\": *\([0-9.e+-]*\),*$/\1/p" "$1" | head -1
}

# What was reserved when the most was, MiB, as the paper splits it: geometry (with what keeps triangles apart from rays), photons, all else.
split() {
    sed -n '/"reserved_at_peak"/,/}/s/^ *"\([^"]*\)": *\([0-9]*\),*$/\2 \1/p' "$1" | awk '
        /tile$/ { geometry += $1; next }
        /photon|map of a room/ { photons += $1; next }
        { other += $1 }
        END { printf "%.0f / %.0f / %.0f", geometry / 1048576, photons / 1048576, other / 1048576 }'
}

printf '| building | photons emitted, M | impacts, M (paper) | propagation, s: wall, CPU (paper) | photon maps, s: wall, CPU (paper) | loads of a tile: mean, max, never | reflections: min, mean, max | through portals | read, written, MB | peak resident, MiB: trace, maps | reserved then, MiB: geometry / photons / other: trace; maps |\n'
printf '|---|---|---|---|---|---|---|---|---|---|---|\n'
for building in "${buildings[@]}"; do
    read -r kind photons impacts propagation maps < <(paper "$building")
    scene=$building.toml
    floors=()
    case $kind in *:*) floors=(--floors "${kind#*:}") ;; esac
    [ -n "${KEEP:-}" ] || rm -rf "$building".enf
    "$bin/enfilade" building "${kind%:*}" "${floors[@]}" -o "$scene" --force >/dev/null
    "$bin/enf-partition" "$scene" -o "$building.enf" "${flags[@]}" --quiet --stats "$building.partition.json" >/dev/null
    "$bin/enf-grid" "$building.enf" "${flags[@]}" --quiet --stats "$building.grid.json" </dev/null >/dev/null
    "$bin/enf-trace" "$building.enf" "${flags[@]}" --photons-per-light "$photons" --quiet --stats "$building.trace.json" </dev/null >/dev/null
    "$bin/enf-kdtree" "$building.enf" "${flags[@]}" --quiet --stats "$building.kdtree.json" </dev/null >/dev/null
    trace() { number "$building.trace.json" "$1"; }
    kdtree() { number "$building.kdtree.json" "$1"; }
    awk -v name="$building" -v impacts="$impacts" -v propagation="$propagation" -v maps="$maps" \
        -v emitted="$(trace photons_emitted)" -v stored="$(trace photons_stored)" -v through="$(trace photons_through_portals)" \
        -v wall="$(trace wall_s)" -v cpu="$(trace cpu_s)" -v kwall="$(kdtree wall_s)" -v kcpu="$(kdtree cpu_s)" \
        -v mean="$(trace room_load_mean)" -v max="$(trace room_load_max)" -v never="$(trace rooms_never_loaded)" \
        -v rmin="$(trace reflections_min)" -v rmean="$(trace reflections_mean)" -v rmax="$(trace reflections_max)" \
        -v escaped="$(trace photons_escaped)" -v read="$(trace read_bytes)" -v written="$(trace written_bytes)" \
        -v peak="$(trace peak_resident_bytes)" -v kpeak="$(kdtree peak_resident_bytes)" -v parts="$(split "$building.trace.json"); $(split "$building.kdtree.json")" 'BEGIN {
        printf "| %s | %.2f | %.1f (%s) | %.1f, %.1f (%s) | %.1f, %.1f (%s) | %.2f, %d, %d | %d, %.2f, %d | %.1f %% | %.0f, %.0f | %.0f, %.0f | %s |\n", name, emitted / 1e6, stored / 1e6, impacts,
            wall, cpu, propagation, kwall, kcpu, maps, mean, max, never, rmin, rmean, rmax, 100 * through / (stored + escaped), read / 1e6, written / 1e6,
            peak / 1048576, kpeak / 1048576, parts }'
    [ -n "${KEEP:-}" ] || rm -rf "$building.enf" "$scene" "${scene%.toml}.meshes"
done
