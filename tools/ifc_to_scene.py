#!/usr/bin/env python3
"""IFC in, a scene for Enfilade out: geometry, materials, rooms.

    pip install ifcopenshell zstandard
    tools/ifc_to_scene.py building.ifc -o building.toml
    enfilade run building.toml --ceiling-lights 500lx -o out/

Writes building.toml and, in building.meshes/ beside it, OBJ files with their MTL. Every element is one
object, called Type/GlobalId/Name. IfcSpaces become [[room]] tables: a box where the room is one, else a
footprint with the heights of floor and ceiling. The same file gives the same output, whatever --threads is.
"""

import argparse
import math
import os
import re
import sys
import tempfile

# Reflectance of the whitest paint: a colour of 1 would never lose light.
WHITEST = 0.9
# Reflectance of what has no style.
GREY = 0.7
# Corners of rooms closer than this are one, m.
WELD = 1e-4
# What is no matter: openings are cut out of their walls already.
NO_MATTER = (
    "IfcSpace",
    "IfcFeatureElementSubtraction",
    "IfcVirtualElement",
    "IfcAnnotation",
    "IfcGrid",
    "IfcSpatialZone",
)


class Failure(Exception):
    """Something that is said in one sentence; with the exit code."""

    def __init__(self, code, text):
        super().__init__(text)
        self.code = code


def say(text):
    print(f"ifc_to_scene: {text}", file=sys.stderr)


def arguments(argv):
    p = argparse.ArgumentParser(
        description="Turns an IFC file into a scene file with OBJ meshes and rooms.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    p.add_argument("ifc", help="building.ifc or building.ifc.zst")
    p.add_argument("-o", "--output", required=True, help="scene file to write (.toml)")
    p.add_argument(
        "--doors",
        choices=("as-modelled", "open"),
        default="as-modelled",
        help="open: doors are left out, frames and all",
    )
    p.add_argument("--no-hints", action="store_true", help="write no [[room]] tables")
    p.add_argument("--per-storey", action="store_true", help="an OBJ file for each storey")
    p.add_argument(
        "--lamp-lumens",
        type=float,
        metavar="N",
        help="light fixtures emit this much each, from their whole surface",
    )
    p.add_argument("--threads", type=int, default=min(4, os.cpu_count() or 1), help="for the geometry")
    args = p.parse_args(argv)
    if not args.output.endswith(".toml"):
        raise Failure(2, f"{args.output}: a scene file ends in .toml")
    if args.lamp_lumens is not None and not (0 < args.lamp_lumens < 1e12):
        raise Failure(2, f"--lamp-lumens {args.lamp_lumens}: give a number above 0")
    if args.threads < 1:
        raise Failure(2, f"--threads {args.threads}: give 1 or more")
    return args


def load(path):
    """The IFC file, read."""
    try:
        import ifcopenshell
        import ifcopenshell.geom
        import numpy  # noqa: F401
    except ImportError as e:
        raise Failure(2, f"the Python package {e.name} is missing: pip install ifcopenshell")
    try:
        with open(path, "rb") as f:
            data = f.read()
    except OSError as e:
        raise Failure(4, f"{path}: cannot be read: {e.strerror or e}")
    if path.endswith(".zst"):
        try:
            import zstandard
        except ImportError:
            raise Failure(2, "the Python package zstandard is missing: pip install zstandard")
        try:
            data = zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True).read()
        except zstandard.ZstdError as e:
            raise Failure(4, f"{path}: no zstd file, or damaged ({e}): fetch it again")
    text = data.decode("utf-8", "replace")
    if "ISO-10303-21" not in text[:1024]:
        raise Failure(4, f"{path}: no IFC file (it does not begin with ISO-10303-21)")
    if "END-ISO-10303-21" not in text[-4096:]:
        raise Failure(4, f"{path}: cut short (it does not end with END-ISO-10303-21): fetch it again")
    try:
        ifc = ifcopenshell.file.from_string(text)
        ifc.by_type("IfcProduct")
    except Exception as e:
        raise Failure(4, f"{path}: cannot be parsed: {one_line(e)}")
    return ifcopenshell, ifc


def one_line(text):
    return " ".join(str(text).split())[:200]


def plain(name):
    """A name without blanks, fit for an OBJ or MTL file."""
    return re.sub(r"[^\w.()+,:;#%&@!=-]+", "_", name or "").strip("_")


def quoted(text):
    """A TOML string."""
    out = ""
    for c in text:
        if c in '\\"':
            out += "\\" + c
        elif ord(c) < 32 or ord(c) == 127:
            out += f"\\u{ord(c):04x}"
        else:
            out += c
    return f'"{out}"'


def number(v):
    """A coordinate to the tenth of a millimetre."""
    text = f"{v:.4f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def is_lamp(element):
    """A light fixture: by class, or (IFC2X3) by the class of its type."""
    if element.is_a("IfcLightFixture"):
        return True
    if not element.is_a("IfcFlowTerminal"):
        return False
    relations = list(getattr(element, "IsTypedBy", None) or ())
    relations += [r for r in element.IsDefinedBy if r.is_a("IfcRelDefinesByType")]
    return any(r.RelatingType.is_a("IfcLightFixtureType") for r in relations)


def storey_of(element):
    """The storey that contains an element, or the element that it is a part of."""
    for _ in range(32):
        if element.is_a("IfcBuildingStorey"):
            return element
        for relation in getattr(element, "ContainedInStructure", None) or ():
            element = relation.RelatingStructure
            break
        else:
            for relation in getattr(element, "Decomposes", None) or ():
                element = relation.RelatingObject
                break
            else:
                return None
    return None


class Materials:
    """Styles by names that depend on the file alone, not on the order in which elements are met."""

    def __init__(self, ifc):
        self.ifc = ifc
        self.looks = {}
        self.known = {}
        # The name of each style, and of what is in it (the kernel reports either).
        self.styles = {}
        count = {}
        for style in by_type(ifc, "IfcSurfaceStyle"):
            label = plain(style.Name) or "style"
            count[label] = count.get(label, 0) + 1
            for part in [style, *(style.Styles or ())]:
                self.styles[part.id()] = (label, style.id())
        self.twice = {label for label, n in count.items() if n > 1}

    def name(self, style):
        if style.name not in self.known:
            self.known[style.name] = self.look_up(style)
        return self.known[style.name]

    def look_up(self, style):
        diffuse = style.diffuse
        rgb = getattr(diffuse, "components", None)
        rgb = tuple(rgb) if rgb is not None else (diffuse.r(), diffuse.g(), diffuse.b())
        rgb = tuple(min(max(v, 0.0), WHITEST) if math.isfinite(v) else GREY for v in rgb)
        clear = style.transparency
        clear = min(max(clear, 0.0), 1.0) if clear is not None and math.isfinite(clear) else 0.0
        # "IfcSurfaceStyleRendering-3791": a style of the file; "IfcRailing": the kernel's own for the class.
        found = re.search(r"-(\d+)$", style.name)
        label, number_ = self.styles.get(int(found.group(1)), (None, 0)) if found else (None, 0)
        if label is None:
            label = "default_" + plain(style.name)
        elif label in self.twice:
            label = f"{label}.{number_}"
        return self.add(label, rgb, clear)

    def add(self, label, rgb, clear):
        self.looks.setdefault(label, (rgb, clear))
        return label

    def write(self, path):
        with open(path, "w", encoding="utf-8") as f:
            for name, (rgb, clear) in sorted(self.looks.items()):
                f.write(f"newmtl {name}\nKd {rgb[0]:.4f} {rgb[1]:.4f} {rgb[2]:.4f}\n")
                if clear > 0:
                    f.write(f"d {1 - clear:.4f}\n")
                f.write("\n")


def obj_text(name, shape, materials, lamp):
    """An element as OBJ. Vertices count back from the end, so that the text may stand anywhere."""
    import numpy

    geometry = shape.geometry
    verts = numpy.asarray(geometry.verts, dtype=float).reshape(-1, 3)
    faces = numpy.asarray(geometry.faces, dtype=int).reshape(-1, 3)
    if not len(faces):
        return None, 0
    if not numpy.isfinite(verts).all():
        say(f"{name}: a coordinate is not finite: left out")
        return None, 0
    ids = numpy.asarray(geometry.material_ids, dtype=int)
    if len(ids) != len(faces):
        ids = numpy.full(len(faces), -1)
    names = [materials.name(m) for m in geometry.materials]
    out = [f"o {name}\n"]
    # Six decimals of a metre; 0.0 once more takes the sign off zero.
    out += ["v %.6f %.6f %.6f\n" % tuple(p) for p in (verts.round(6) + 0.0).tolist()]
    last = None
    for (a, b, c), m in zip((faces - len(verts)).tolist(), ids.tolist()):
        if lamp:
            used = "lamp"
        elif 0 <= m < len(names):
            used = names[m]
        else:
            used = materials.add("no_style", (GREY, GREY, GREY), 0.0)
        if used != last:
            out.append(f"usemtl {used}\n")
            last = used
        out.append(f"f {a} {b} {c}\n")
    return "".join(out).encode(), len(faces)


def geometry_settings(ifcopenshell):
    settings = ifcopenshell.geom.settings()
    settings.set("use-world-coords", True)
    settings.set("apply-default-materials", True)
    return settings


def write_meshes(args, ifcopenshell, ifc, folder):
    """The OBJ and MTL files; returns their names, and whether there is a lamp."""
    left_out = [e for kind in NO_MATTER for e in by_type(ifc, kind)]
    doors = by_type(ifc, "IfcDoor")
    if args.doors == "open":
        left_out += doors
    skipped = {e.id() for e in left_out}
    wanted = [
        e for e in by_type(ifc, "IfcProduct") if e.Representation and e.id() not in skipped
    ]
    if not wanted:
        raise Failure(4, f"{args.ifc}: no element with geometry in it")
    materials = Materials(ifc)
    # Elements arrive in any order: they wait in a file, and are put in the order of the IFC file.
    with tempfile.TemporaryFile(dir=folder) as waiting:
        pieces = []
        arrived = set()
        lamps = triangles = 0
        iterator = ifcopenshell.geom.iterator(
            geometry_settings(ifcopenshell), ifc, args.threads, include=wanted
        )
        ready = iterator.initialize()
        while ready:
            shape = iterator.get()
            arrived.add(shape.id)
            element = ifc.by_id(shape.id)
            name = f"{element.is_a()}/{element.GlobalId}/{plain(element.Name) or '-'}"
            lamp = args.lamp_lumens is not None and is_lamp(element)
            text, count = obj_text(name, shape, materials, lamp)
            if text is not None:
                lamps += lamp
                triangles += count
                storey = storey_of(element) if args.per_storey else None
                pieces.append((storey.id() if storey else 0, shape.id, waiting.tell(), len(text)))
                waiting.write(text)
            ready = iterator.next()
        pieces.sort()
        lost = [e for e in wanted if e.id() not in arrived]
        if lost:
            named = ", ".join(f"{e.is_a()} {e.GlobalId}" for e in lost[:3])
            more = f" and {len(lost) - 3} more" if len(lost) > 3 else ""
            say(f"{args.ifc}: no geometry could be made of {named}{more}: left out")
        if not pieces:
            raise Failure(4, f"{args.ifc}: no triangle could be made of its {len(wanted)} elements")
        files = write_objs(args, ifc, folder, pieces, waiting)
    materials.write(os.path.join(folder, "building.mtl"))
    say(
        f"{len(pieces)} elements, {triangles} triangles, {len(doors)} doors "
        + ("left out" if args.doors == "open" else "as modelled")
    )
    if args.lamp_lumens is not None and not lamps:
        say(f"{args.ifc}: no light fixture in it: --lamp-lumens does nothing")
    return files, lamps > 0


def by_type(ifc, kind):
    """Elements of a class; none where the schema does not have it."""
    try:
        return ifc.by_type(kind)
    except RuntimeError:
        return []


def write_objs(args, ifc, folder, pieces, waiting):
    """Copies the waiting elements into one file, or one for each storey."""
    files = []
    storeys = []
    for piece in pieces:
        if piece[0] not in storeys:
            storeys.append(piece[0])
    storeys.sort(key=lambda s: (elevation(ifc, s), s))
    for storey in storeys:
        label = plain(ifc.by_id(storey).Name) if storey else ""
        base = label.replace(":", "_") or ("building" if not args.per_storey else "no_storey")
        file, n = f"{base}.obj", 2
        while file in files:
            file, n = f"{base}.{n}.obj", n + 1
        with open(os.path.join(folder, file), "wb") as out:
            out.write(b"mtllib building.mtl\n")
            for _, _, at, length in (p for p in pieces if p[0] == storey):
                waiting.seek(at)
                out.write(waiting.read(length))
        files.append(file)
    return files


def elevation(ifc, storey):
    return float((ifc.by_id(storey).Elevation if storey else None) or 0.0)


def footprint(verts, faces):
    """The outline of a solid's lowest faces: corners, lowest and highest z, and whether the solid is the
    prism over it. None if there is no such outline."""
    import numpy

    low, high = verts[:, 2].min(), verts[:, 2].max()
    a, b, c = (verts[faces[:, k]] for k in range(3))
    normal = numpy.cross(b - a, c - a)
    area = numpy.linalg.norm(normal, axis=1)
    volume = abs(numpy.einsum("ij,ij->i", a, numpy.cross(b, c)).sum() / 6)
    at_floor = numpy.maximum(numpy.maximum(a[:, 2], b[:, 2]), c[:, 2]) < low + 0.01
    bottom = faces[(area > 1e-9) & at_floor & (numpy.abs(normal[:, 2]) > 0.999 * area)]
    # Corners at one place are one; an edge that only one triangle has is on the outline.
    keys, place = numpy.unique(
        (verts[:, :2] / WELD).round().astype(numpy.int64), axis=0, return_inverse=True
    )
    place = place.reshape(-1)
    inner = set()
    edges = set()
    for triangle in place[bottom].tolist():
        corners = [keys[k] for k in triangle]
        (ax, ay), (bx, by), (cx, cy) = (map(int, k) for k in corners)
        turn = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if turn == 0:
            continue
        i, j, k = triangle if turn > 0 else triangle[::-1]
        for edge in ((i, j), (j, k), (k, i)):
            if edge[::-1] in edges:
                edges.discard(edge[::-1])
                inner.add(edge)
            elif edge in edges or edge in inner:
                return None
            else:
                edges.add(edge)
    following = {}
    for i, j in sorted(edges):
        if i in following:
            return None
        following[i] = j
    loops = []
    while following:
        start = min(following)
        loop, at = [start], following.pop(start)
        while at != start:
            if at not in following:
                return None
            loop.append(at)
            at = following.pop(at)
        loops.append(keys[loop].astype(float) * WELD)
    outer = max(loops, key=twice_area, default=None)
    if outer is None or twice_area(outer) <= 0:
        return None
    floor = sum(twice_area(loop) for loop in loops) / 2
    # Counter-clockwise loops beside the outer one are rooms apart; clockwise ones are columns.
    if sum(twice_area(loop) > 0 for loop in loops) > 1:
        return None
    is_prism = abs(volume - floor * (high - low)) < 0.02 * volume
    return straightened(outer), low, high, is_prism


def twice_area(loop):
    x, y = loop[:, 0], loop[:, 1]
    return float((x * shifted(y) - shifted(x) * y).sum())


def shifted(values):
    import numpy

    return numpy.roll(values, -1)


def straightened(loop):
    """The loop without corners that lie on the line between their neighbours."""
    corners = loop.tolist()
    i = 0
    while len(corners) > 3 and i < len(corners):
        (ax, ay), (bx, by), (cx, cy) = (corners[(i + k) % len(corners)] for k in (-1, 0, 1))
        off = abs((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))
        if off <= 1e-3 * math.hypot(cx - ax, cy - ay):
            corners.pop(i)
            i = max(i - 1, 0)
        else:
            i += 1
    return corners


def rooms(ifcopenshell, ifc, path):
    """[[room]] tables of the IfcSpaces."""
    import numpy

    settings = geometry_settings(ifcopenshell)
    out = []
    boxes = sloped = 0
    for space in sorted(by_type(ifc, "IfcSpace"), key=lambda s: s.id()):
        label = " ".join(t for t in (space.Name, space.LongName) if t) or space.GlobalId
        if not space.Representation:
            say(f'{path}: the space "{label}" has no geometry: no hint')
            continue
        try:
            geometry = ifcopenshell.geom.create_shape(settings, space).geometry
            verts = numpy.asarray(geometry.verts, dtype=float).reshape(-1, 3)
            faces = numpy.asarray(geometry.faces, dtype=int).reshape(-1, 3)
        except Exception as e:
            say(f'{path}: no solid could be made of the space "{label}" ({one_line(e)}): no hint')
            continue
        if not len(faces) or not numpy.isfinite(verts).all():
            say(f'{path}: the space "{label}" is empty: no hint')
            continue
        found = footprint(verts, faces)
        low, high = verts.min(axis=0), verts.max(axis=0)
        if (high - low).min() < 0.01:
            say(f'{path}: the space "{label}" has no volume: no hint')
            continue
        text = f"\n[[room]]  # {space.GlobalId}\nname = {quoted(label)}\n"
        if found is None:
            boxes += 1
            say(f'{path}: the space "{label}" has no simple footprint: its box is the hint')
        elif not found[3]:
            sloped += 1
        box = (high - low)[:2].prod()
        corners = found[0] if found else []
        if found is None or abs(twice_area(numpy.array(corners)) / 2 - box) < 1e-3 * box:
            text += f"min = [{', '.join(map(number, low.tolist()))}]\n"
            text += f"max = [{', '.join(map(number, high.tolist()))}]\n"
        else:
            text += "polygon = ["
            text += ", ".join(f"[{number(x)}, {number(y)}]" for x, y in corners)
            text += f"]\nz = [{number(found[1])}, {number(found[2])}]\n"
        out.append(text)
    if sloped:
        say(f"{path}: {sloped} spaces are no prisms; their footprint is extended to their highest point")
    return out


def convert(args):
    ifcopenshell, ifc = load(args.ifc)
    stem = os.path.basename(args.output)[: -len(".toml")]
    folder = os.path.join(os.path.dirname(args.output), f"{stem}.meshes")
    try:
        os.makedirs(folder, exist_ok=True)
        files, lamps = write_meshes(args, ifcopenshell, ifc, folder)
        tables = [] if args.no_hints else rooms(ifcopenshell, ifc, args.ifc)
        aside = args.output + ".tmp"
        with open(aside, "w", encoding="utf-8") as f:
            f.write(f"# from {os.path.basename(args.ifc)} by ifc_to_scene.py\n")
            for file in files:
                f.write(f"[[mesh]]\nfile = {quoted(f'{stem}.meshes/{file}')}\n")
            if lamps:
                f.write(f'\n[[material]]\nname = "lamp"\nkd = 0.5\nlumens = {args.lamp_lumens!r}\n')
            f.writelines(tables)
        os.replace(aside, args.output)
    except OSError as e:
        raise Failure(5, f"{e.filename or folder}: cannot be written: {e.strerror or e}")
    if not args.no_hints:
        say(f"{len(tables)} rooms")
    if not lamps:
        say("no light in it: give enfilade --ceiling-lights, or the scene file a [[light]]")
    print(args.output)


def main(argv=None):
    try:
        convert(arguments(argv))
    except Failure as e:
        say(e)
        return e.code
    except BrokenPipeError:
        return 0
    except KeyboardInterrupt:
        say("interrupted; nothing is finished")
        return 130
    except MemoryError:
        say("out of memory: the model is too large for this machine")
        return 5
    return 0


if __name__ == "__main__":
    sys.exit(main())
