#!/usr/bin/env python3
"""Renders a view that enf-export wrote with Mitsuba 3, and says how long it took.

    pip install mitsuba
    python3 render.py mitsuba/VIEW.xml VIEW.exr --spp 256 --max-depth -1 --threads 2

Only needed for the comparison in docs/benchmarks.md; nothing here needs it to be built, tested or used.
"""

import argparse
import resource
import time

import drjit
import mitsuba


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("xml")
    parser.add_argument("exr")
    parser.add_argument("--spp", type=int, default=64, help="paths per pixel")
    parser.add_argument("--max-depth", type=int, default=-1, help="-1: all light; 2: direct light and lamps alone")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--variant", default="scalar_rgb")
    args = parser.parse_args()

    mitsuba.set_variant(args.variant)
    mitsuba.set_log_level(mitsuba.LogLevel.Warn)
    drjit.set_thread_count(args.threads)
    begin, before = time.time(), cpu()
    scene = mitsuba.load_file(args.xml, spp=args.spp, max_depth=args.max_depth)
    image = mitsuba.render(scene, seed=args.seed, spp=args.spp)
    mitsuba.Bitmap(image).write(args.exr)
    print(
        f"{args.exr}: {args.spp} paths a pixel, depth {args.max_depth}: "
        f"{time.time() - begin:.1f} s, {cpu() - before:.1f} s CPU"
    )


def cpu():
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


if __name__ == "__main__":
    main()
