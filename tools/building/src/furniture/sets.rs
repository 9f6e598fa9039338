//! Pieces that belong together, as one mesh: a laid table with its chairs, a desk with its day's
//! work. Fewer instances, and nobody has to push the chairs in.
//!
//! As single pieces: centred on x = y = 0, on z = 0, front to -y, back to +y.

use super::{decor, fine, seating, storage, tables, wet};
use crate::mesh::{Mesh, Paint, radians, sin_cos, soft};
use crate::rng::Rng;

/// `piece` turned by degrees and put at `(x, y, z)` in `m`.
fn put(m: &mut Mesh, piece: Mesh, (x, y, z): (f64, f64, f64), turn: f64) {
    m.add(piece.turned(turn).at(x, y, z));
}

const CLOTH: [Paint; 8] = [
    "fabric.blue",
    "fabric.charcoal",
    "fabric.green",
    "fabric.orange",
    "fabric.teal",
    "fabric.mustard",
    "fabric.plum",
    "fabric.red",
];
const WOOD: [Paint; 4] = ["wood.oak", "wood.walnut", "wood.birch", "wood.cherry"];
const CUPS: [Paint; 5] =
    ["ceramic.white", "ceramic.blue", "ceramic.green", "ceramic.red", "ceramic.ochre"];
const SHELLS: [Paint; 4] = ["lacquer.yellow", "lacquer.white", "lacquer.green", "lacquer.red"];

/// A desk with its chair, screen, lamp and papers. The chair is on the front side.
pub fn desk(k: usize, mut rng: Rng) -> Mesh {
    let mut m = tables::desk(WOOD[k % 3], "lacquer.grey", 1.6);
    let chair = seating::office_chair(CLOTH[k % 8], true);
    put(
        &mut m,
        chair,
        (rng.around(0.12), -0.72 + rng.around(0.05), 0.001),
        180.0 + rng.around(30.0),
    );
    desktop(&mut m, k, (0.0, 0.0), 0.0, &mut rng);
    m
}

/// What lies on a desk at `(x, y)` that is turned by degrees.
fn desktop(m: &mut Mesh, k: usize, (x, y): (f64, f64), turn: f64, rng: &mut Rng) {
    let (s, c) = sin_cos(radians(turn));
    let mut rest = |piece: Mesh, a: f64, b: f64, twist: f64| {
        put(m, piece, (x + c * a - s * b, y + s * a + c * b, 0.742), turn + twist);
    };
    if k % 3 == 2 {
        rest(decor::laptop("metal.steel"), 0.0, -0.08, 5.0);
        rest(decor::book_pile(3, rng.clone()), 0.5, 0.12, 30.0);
    } else {
        rest(decor::computer(), -0.1 + rng.around(0.05), 0.0, rng.around(6.0));
    }
    rest(decor::mug(CUPS[k % 5]), 0.36, -0.12 + rng.around(0.06), rng.range(0.0, 360.0));
    rest(decor::papers(rng.clone()), 0.48, -0.1 + rng.around(0.05), rng.around(20.0));
    if k.is_multiple_of(2) {
        rest(decor::desk_lamp("lacquer.red"), -0.62, 0.16, -20.0);
    } else {
        rest(decor::pot_plant("pot.clay", rng.clone()), -0.64, 0.16, rng.range(0.0, 360.0));
    }
}

/// Four desks face to face with a felt screen between them.
pub fn island(k: usize, mut rng: Rng) -> Mesh {
    let mut m = Mesh::new();
    let wood = WOOD[k % 3];
    for (i, (x, y, turn)) in
        [(-0.81, -0.39, 0.0), (0.81, -0.39, 0.0), (-0.81, 0.39, 180.0), (0.81, 0.39, 180.0)]
            .into_iter()
            .enumerate()
    {
        put(&mut m, tables::desk(wood, "lacquer.white", 1.6), (x, y, 0.0), turn);
        desktop(&mut m, k + i, (x, y), turn, &mut rng);
        let out = if turn == 0.0 { -0.72 } else { 0.72 };
        let chair = seating::office_chair(CLOTH[(k * 3 + i / 2) % 8], true);
        let facing = turn + 180.0 + rng.around(35.0);
        put(&mut m, chair, (x + rng.around(0.15), y + out + rng.around(0.05), 0.001), facing);
    }
    m.add(soft("felt.green", 3.1, 0.016, 0.36, 0.006, 1).at(0.0, 0.0, 0.745));
    m
}

/// A conference table for `seats` (even) with papers, laptops and cups. Its long side is along x.
pub fn conference(k: usize, seats: usize, mut rng: Rng) -> Mesh {
    let side = seats / 2;
    let length = 1.0 * side as f64 + 0.4;
    let mut m = tables::conference_table(WOOD[k % 2 + 1], "metal.dark", length, 1.3).turned(90.0);
    for i in 0..side {
        let x = 1.0 * (i as f64 - (side as f64 - 1.0) / 2.0);
        for (s, turn) in [(-1.0, 0.0), (1.0, 180.0)] {
            let chair = seating::office_chair(["leather.tan", "leather.black"][k % 2], true);
            let at = (x + rng.around(0.05), s * (0.96 + rng.around(0.06)), 0.001);
            put(&mut m, chair, at, turn + 180.0 + rng.around(18.0));
            let what = rng.below(3);
            let z = 0.748;
            let at = (x + rng.around(0.05), s * 0.4, z);
            match what {
                0 => put(&mut m, decor::laptop("metal.steel"), at, turn + rng.around(8.0)),
                1 => put(&mut m, decor::papers(rng.clone()), at, turn + rng.around(12.0)),
                _ => {}
            }
            let cup = decor::mug(CUPS[rng.below(5)]);
            put(&mut m, cup, (x + 0.3, s * 0.36, z), rng.range(0.0, 360.0));
        }
    }
    put(&mut m, decor::carafe(), (0.1, 0.0, 0.748), 80.0);
    m
}

/// A round table with `seats` chairs.
pub fn round_meeting(k: usize, mut rng: Rng) -> Mesh {
    let mut m = tables::round_table("wood.birch", "metal.dark", 0.8, 0.74);
    let seats = 5 + k % 2;
    for i in 0..seats {
        let angle = 360.0 * i as f64 / seats as f64 + rng.around(6.0);
        let (s, c) = sin_cos(radians(angle));
        let chair = seating::office_chair(CLOTH[(k + 2) % 8], true);
        put(&mut m, chair, (1.08 * c, 1.08 * s, 0.001), angle - 90.0 + rng.around(15.0));
        put(&mut m, decor::mug(CUPS[i % 5]), (0.55 * c, 0.55 * s, 0.741), angle);
        if i % 2 == 0 {
            let (s, c) = sin_cos(radians(angle + 24.0));
            put(&mut m, decor::papers(rng.clone()), (0.5 * c, 0.5 * s, 0.741), angle + 90.0);
        }
    }
    put(&mut m, decor::flowers("ceramic.blue", "lacquer.red", rng), (0.0, 0.0, 0.741), 0.0);
    m
}

/// A small round table with three or four chairs, laid.
pub fn cafe(k: usize, mut rng: Rng) -> Mesh {
    let mut m = tables::round_table("wood.birch", "metal.dark", 0.45, 0.74);
    let seats = 3 + k % 2;
    for i in 0..seats {
        let angle = 360.0 * i as f64 / seats as f64 + rng.around(10.0);
        let (s, c) = sin_cos(radians(angle));
        let out = 0.72 + rng.around(0.05);
        let chair = if k.is_multiple_of(3) {
            seating::shell_chair(SHELLS[(k + i) % 4], "wood.oak")
        } else {
            seating::slat_chair("wood.walnut", "fabric.cream")
        };
        // A chair's front looks to the middle.
        put(&mut m, chair, (out * c, out * s, 0.001), angle - 90.0 + rng.around(14.0));
        let setting = decor::place_setting();
        put(&mut m, setting, (0.27 * c, 0.27 * s, 0.741), angle + 90.0);
    }
    put(&mut m, decor::flowers("ceramic.blue", "lacquer.yellow", rng), (0.02, 0.0, 0.741), 0.0);
    m
}

/// A dining table with six chairs, laid.
pub fn dining(k: usize, mut rng: Rng) -> Mesh {
    let mut m = tables::table(WOOD[k % 4], 2.0, 0.95, 0.75);
    for x in [-0.62, 0.0, 0.62] {
        for (s, turn) in [(-1.0, 0.0), (1.0, 180.0)] {
            let chair = seating::slat_chair("wood.walnut", CLOTH[k % 8]);
            let at = (x + rng.around(0.04), s * (0.66 + rng.around(0.05)), 0.001);
            put(&mut m, chair, at, turn + 180.0 + rng.around(12.0));
            put(&mut m, decor::place_setting(), (x, s * 0.28, 0.752), turn);
        }
    }
    let fruit = decor::fruit_bowl("ceramic.white", ["fruit.orange", "fruit.apple"], rng.clone());
    put(&mut m, fruit, (0.3, 0.0, 0.752), 0.0);
    put(&mut m, decor::flowers("ceramic.green", "lacquer.red", rng), (-0.25, 0.0, 0.752), 0.0);
    m
}

/// A sofa, a low table and two armchairs around a rug.
pub fn lounge(k: usize, mut rng: Rng) -> Mesh {
    let cloth = ["fabric.grey", "fabric.teal", "leather.brown", "fabric.plum"][k % 4];
    let sofa = seating::sofa(cloth, ["fabric.mustard", "fabric.cream"], 3);
    let mut m = Mesh::new();
    put(&mut m, sofa, (0.0, 1.05, 0.001), rng.around(2.0));
    put(
        &mut m,
        tables::coffee_table("wood.walnut", 1.0, 0.55),
        (0.0, 0.05, 0.001),
        rng.around(5.0),
    );
    for s in [-1.0, 1.0] {
        let chair = seating::armchair(CLOTH[(k + 5) % 8], "wood.walnut");
        put(
            &mut m,
            chair,
            (s * 0.75, -1.05 + rng.around(0.08), 0.001),
            180.0 + s * 20.0 + rng.around(10.0),
        );
    }
    put(&mut m, decor::book_pile(4, rng.clone()), (-0.25, 0.1, 0.399), 20.0);
    put(&mut m, decor::mug(CUPS[k % 5]), (0.2, -0.05, 0.399), 0.0);
    let colours: [Paint; 3] =
        [["fabric.red", "fabric.blue", "fabric.green"][k % 3], "fabric.navy", "fabric.cream"];
    let rug = decor::rug(colours[0], colours[1], colours[2], 2.4, 2.0, rng);
    put(&mut m, rug, (0.0, 0.0, 0.001), 1.5);
    m
}

/// A double bed with night stands and lamps, its head to the wall.
pub fn bed(k: usize, rng: Rng) -> Mesh {
    let cover = ["fabric.navy", "fabric.green", "fabric.plum", "fabric.teal"][k % 4];
    let mut m = seating::bed(WOOD[k % 2], cover, "fabric.white", 1.6, rng);
    for s in [-1.0, 1.0] {
        let stand = tables::drawers("wood.oak", "metal.brass", (0.44, 0.4, 0.5), 2);
        put(&mut m, stand, (s * 1.15, 0.86, 0.0), 0.0);
        put(&mut m, decor::table_lamp("ceramic.blue", "shade"), (s * 1.15, 0.86, 0.503), 0.0);
    }
    m
}

/// A sideboard with what people put on it.
pub fn sideboard(k: usize, mut rng: Rng) -> Mesh {
    let (body, front) = [
        ("wood.oak", "lacquer.green"),
        ("wood.birch", "lacquer.yellow"),
        ("wood.walnut", "wood.walnut"),
        ("lacquer.white", "lacquer.blue"),
    ][k % 4];
    let width = [1.45, 1.9][k % 2];
    let mut m = storage::sideboard(body, front, width);
    let z = 0.788;
    let w = width / 2.0 - 0.2;
    put(&mut m, decor::vase(CUPS[k % 5], 0.3), (-w, 0.02, z), 0.0);
    put(&mut m, decor::book_pile(4, rng.clone()), (-w * 0.3, 0.0, z), rng.around(30.0));
    match k % 3 {
        0 => put(&mut m, decor::globe(), (w * 0.8, 0.0, z), 40.0),
        1 => put(&mut m, decor::table_lamp("metal.brass", "lacquer.green"), (w * 0.8, 0.0, z), 0.0),
        _ => put(
            &mut m,
            decor::flowers("ceramic.blue", "lacquer.red", rng.clone()),
            (w * 0.8, 0.0, z),
            0.0,
        ),
    }
    let fruit = decor::fruit_bowl("ceramic.white", ["fruit.lime", "fruit.apple"], rng);
    put(&mut m, fruit, (w * 0.3, 0.0, z), 0.0);
    m
}

/// Six kitchen units with cupboards, a hood and pots above them.
pub fn kitchen(k: usize, rng: &mut Rng) -> Mesh {
    let front = ["lacquer.white", "lacquer.blue", "lacquer.green"][k % 3];
    let mut m = Mesh::new();
    for (i, kind) in [1, 0, 3, 0, 2, 1].into_iter().enumerate() {
        let x = 0.6 * i as f64 - 1.5;
        put(&mut m, wet::base_unit(front, "stone.dark", 0.6, kind), (x, 0.0, 0.0), 0.0);
        if kind == 2 {
            put(&mut m, wet::hood(), (x, 0.06, 1.6), 0.0);
        } else if kind != 3 {
            put(&mut m, wet::wall_unit(front, 0.6), (x, 0.14, 1.45), 0.0);
        }
    }
    put(&mut m, wet::worktop_things(), (-0.85 + rng.around(0.05), 0.02, 0.898), 0.0);
    put(&mut m, wet::cooking_pot("metal.steel", 0.11, 0.14), (0.78, -0.1, 0.904), 30.0);
    put(&mut m, wet::cooking_pot("ceramic.red", 0.09, 0.1), (1.03, 0.1, 0.904), 100.0);
    m
}

/// A washbasin with its mirror and towels.
pub fn washplace(k: usize) -> Mesh {
    let mut m = wet::washbasin(["lacquer.white", "wood.oak"][k % 2], 0.9);
    let back = m.bounds().1.y;
    let mirror = decor::mirror("metal.steel", 0.8, 1.0);
    let deep = mirror.bounds().1.y;
    put(&mut m, mirror, (0.0, back - deep, 1.55), 0.0);
    m
}

/// A toilet with its paper.
pub fn toilet() -> Mesh {
    let mut m = wet::toilet();
    let back = m.bounds().1.y;
    let paper = wet::paper_roll();
    let deep = paper.bounds().1.y;
    put(&mut m, paper, (0.36, back - deep, 0.75), 0.0);
    m
}

/// Two bookcases back to back.
pub fn stack(k: usize, mut rng: Rng) -> Mesh {
    let mut m = Mesh::new();
    for turn in [0.0, 180.0] {
        let label = Rng::new(rng.bits(), "stack");
        // Low: one looks across a reading hall.
        let case = storage::bookcase(WOOD[k % 2], 1.2, 1.5, 4, label);
        let back = case.bounds().1.y + 0.001;
        m.add(case.at(0.0, -back, 0.0).turned(turn));
    }
    m
}

/// A long reading table with six chairs and lamps.
pub fn reading(k: usize, mut rng: Rng) -> Mesh {
    let mut m = tables::table("wood.walnut", 2.6, 1.1, 0.75);
    for x in [-0.85, 0.0, 0.85] {
        for (s, turn) in [(-1.0, 0.0), (1.0, 180.0)] {
            let chair = seating::slat_chair("wood.walnut", CLOTH[(k + 2) % 8]);
            let at = (x + rng.around(0.06), s * (0.72 + rng.around(0.08)), 0.001);
            put(&mut m, chair, at, turn + 180.0 + rng.around(15.0));
        }
        put(&mut m, decor::book_pile(2 + rng.below(3), rng.clone()), (x + 0.2, 0.25, 0.752), 40.0);
        put(&mut m, decor::papers(rng.clone()), (x, -0.3, 0.752), rng.around(15.0));
    }
    for x in [-0.6, 0.6] {
        put(&mut m, decor::table_lamp("metal.brass", "lacquer.green"), (x, 0.0, 0.752), 0.0);
    }
    m
}

/// A counter with a laid buffet behind glass-clear air: bowls, fruit, carafes.
pub fn buffet(k: usize, mut rng: Rng) -> Mesh {
    let mut m = tables::counter("wood.walnut", "stone.white", 2.4);
    let z = 1.076;
    for i in 0..4 {
        let x = 0.55 * f64::from(i) - 0.85;
        match (i as usize + k) % 3 {
            0 => put(
                &mut m,
                decor::fruit_bowl("ceramic.white", ["fruit.orange", "fruit.lime"], rng.clone()),
                (x, -0.2, z),
                rng.range(0.0, 360.0),
            ),
            1 => put(&mut m, decor::carafe(), (x, -0.2, z), 90.0),
            _ => put(&mut m, decor::vase("ceramic.ochre", 0.26), (x, -0.2, z), 0.0),
        }
    }
    m
}

/// A workbench with drawing things and two stools.
pub fn bench_place(k: usize, mut rng: Rng) -> Mesh {
    let mut m = tables::workbench("wood.birch", 2.0);
    for x in [-0.5, 0.5] {
        put(
            &mut m,
            seating::stool("wood.oak", "leather.tan", 0.7),
            (x + rng.around(0.1), -0.75, 0.001),
            rng.range(0.0, 90.0),
        );
    }
    put(&mut m, decor::papers(rng.clone()), (0.1, 0.0, 0.873), 10.0);
    put(&mut m, decor::vase(CUPS[k % 5], 0.24), (-0.6, 0.1, 0.873), 0.0);
    put(&mut m, decor::book_pile(3, rng), (0.55, 0.05, 0.873), 20.0);
    m
}

/// A row of theatre seats.
pub fn seats(k: usize, count: usize, rng: Rng) -> Mesh {
    fine::seat_row(["fabric.red", "fabric.navy", "fabric.plum"][k % 3], count, rng)
}
