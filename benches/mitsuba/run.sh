#!/bin/sh
# Ours beside Mitsuba 3's path tracer, linear pictures, mean radiance room by room. Needs PYTHON with the package mitsuba.
#
#   PYTHON=venv/bin/python3 benches/mitsuba/run.sh OUT [SCENE VIEW WIDTH HEIGHT PHOTONS SPP]
#
# Without a scene: the box, the two rooms from both sides, and the demo's library (its window panes without refraction,
# because a sheet of one interface has no counterpart). First direct light alone, then all of it. What differs by more than 1 % is
# said, and the exit code is 1 then.
set -eu
here=$(cd "$(dirname "$0")/../.." && pwd)
bin=${CARGO_TARGET_DIR:-$here/target}/release
python=${PYTHON:-python3}
out=${1:?a folder for the results}
mkdir -p "$out"
failed=0

# scene view width height photons spp
one() {
    name=$(basename "$1" .toml)
    dir=$out/$name-$2
    mkdir -p "$dir"
    "$bin/enf-export" "$1" --mitsuba "$dir/mitsuba" --view "$2" --width "$3" --height "$4"
    xml=$dir/mitsuba/$2.xml
    ours="--view $2 --width $3 --height $4 --photons-per-light $5 --threads 2 --memory 4G --formats exr --quiet"
    echo "== $name, $2: direct light"
    # shellcheck disable=SC2086
    "$bin/enfilade" run "$1" -o "$dir/direct" $ours --indirect none --samples 64 --max-samples 64 >"$dir/log"
    "$python" "$here/benches/mitsuba/render.py" "$xml" "$dir/direct.exr" --spp 64 --max-depth 2
    "$bin/enf-export" compare "$dir/direct/$2.exr" "$dir/direct.exr" || failed=1
    echo "== $name, $2: all light"
    # shellcheck disable=SC2086
    /usr/bin/time -f "ours: %e s, %U s CPU" "$bin/enfilade" run "$1" -o "$dir/all" $ours --indirect final-gather \
        --samples 16 --max-samples 16 --gather-rays 64 >>"$dir/log"
    "$python" "$here/benches/mitsuba/render.py" "$xml" "$dir/all.exr" --spp "$6"
    "$bin/enf-export" compare "$dir/all/$2.exr" "$dir/all.exr" || failed=1
}

if [ $# -gt 1 ]; then
    one "$2" "$3" "${4:-256}" "${5:-192}" "${6:-2M}" "${7:-256}"
else
    one "$here/fixtures/scenes/box.toml" box 256 192 2M 128
    one "$here/fixtures/scenes/two-rooms.toml" west 256 192 2M 128
    one "$here/fixtures/scenes/two-rooms.toml" east 256 192 2M 512
    "$bin/enfilade" building l-shape --floors 1 -o "$out/l-shape.toml"
    sed '/^name = "glass.pane"/,/^ni = /s/^ni = .*/ni = 1.0/' "$out/l-shape.toml" >"$out/l-plain.toml"
    one "$out/l-plain.toml" library 256 160 500k 256
fi
exit $failed
