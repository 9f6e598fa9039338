//! What can be had: every piece that the automatic furnisher may order, in a few variants.

use super::Stance;
use crate::furniture::{decor, fine, seating, sets, storage, tables, wet};
use crate::mesh::Mesh;
use crate::rng::Rng;

/// One entry of the catalogue.
pub(crate) struct Piece {
    /// Name; the mesh of variant 2 is `name-2`.
    pub(crate) name: &'static str,
    /// Number of variants.
    pub(crate) variants: usize,
    /// How it stands.
    pub(crate) stance: Stance,
    /// Where it goes.
    pub(crate) place: Place,
    /// How many a room of 40 square metres has at most.
    pub(crate) most: usize,
    make: fn(usize, Rng) -> Mesh,
}

/// Where a piece goes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Place {
    /// With its back to a wall, so high above the floor.
    Wall(f64),
    /// In the room.
    Free,
    /// In a corner or along a wall, turned at will.
    Edge,
    /// Under the ceiling.
    Ceiling,
}

use Place::{Ceiling, Edge, Free, Wall};
use Stance::Stands;

const fn piece(
    name: &'static str,
    variants: usize,
    place: Place,
    make: fn(usize, Rng) -> Mesh,
) -> Piece {
    Piece { name, variants, stance: Stands, place, most: 40, make }
}

/// One that no room has many of.
const fn rare(
    most: usize,
    name: &'static str,
    variants: usize,
    place: Place,
    make: fn(usize, Rng) -> Mesh,
) -> Piece {
    Piece { most, ..piece(name, variants, place, make) }
}

impl Piece {
    /// Makes variant `k`.
    pub(crate) fn make(&self, k: usize, rng: Rng) -> Mesh {
        (self.make)(k, rng)
    }
}

/// The piece called `name`.
pub(crate) fn find(name: &str) -> Option<&'static Piece> {
    CATALOGUE.iter().find(|p| p.name == name)
}

const CATALOGUE: &[Piece] = &[
    // Offices and meetings.
    piece("workplace", 4, Free, sets::desk),
    piece("island", 4, Free, sets::island),
    piece("conference-8", 2, Free, |k, r| sets::conference(k, 8, r)),
    piece("conference-14", 2, Free, |k, r| sets::conference(k, 14, r)),
    piece("meeting-round", 3, Free, sets::round_meeting),
    rare(1, "whiteboard", 1, Wall(1.5), |_, _| decor::whiteboard(2.0, 1.2)),
    piece("bookcase", 5, Wall(0.0), |k, r| {
        let wood = ["wood.oak", "wood.walnut", "wood.birch"][k % 3];
        storage::bookcase(wood, [1.2, 1.0][k % 2], 2.15, 6, r)
    }),
    piece("low-bookcase", 3, Wall(0.0), |k, r| {
        storage::bookcase(["wood.oak", "lacquer.white"][k % 2], 1.2, 0.8, 2, r)
    }),
    piece("sideboard", 4, Wall(0.0), sets::sideboard),
    // Living.
    piece("lounge", 4, Free, sets::lounge),
    piece("sofa", 3, Wall(0.0), |k, _| {
        let cloth = ["fabric.blue", "leather.brown", "fabric.green"][k % 3];
        seating::sofa(cloth, ["fabric.mustard", "fabric.cream"], 2 + k % 2)
    }),
    piece("armchair", 3, Edge, |k, _| {
        seating::armchair(["fabric.rose", "fabric.teal", "leather.brown"][k % 3], "wood.walnut")
    }),
    rare(2, "lounge-chair", 1, Edge, |_, _| seating::lounge_chair("leather.tan", "wood.walnut")),
    rare(1, "piano", 1, Wall(0.0), |_, _| tables::piano("wood.black")),
    piece("bed", 4, Wall(0.0), sets::bed),
    rare(2, "wardrobe", 2, Wall(0.0), |k, _| {
        storage::wardrobe(["lacquer.white", "lacquer.blue"][k % 2], [1.6, 1.0][k % 2], 2.2)
    }),
    rare(2, "clothes", 2, Wall(0.0), |k, r| storage::clothes(1.6, 12 + k, r)),
    piece("vitrine", 3, Wall(0.0), |k, r| {
        fine::vitrine(
            ["wood.oak", "wood.walnut", "lacquer.white"][k % 3],
            [1.2, 1.5, 1.0][k % 3],
            r,
        )
    }),
    piece("narrow-vitrine", 3, Wall(0.0), |k, r| {
        fine::vitrine(["wood.oak", "lacquer.white", "wood.cherry"][k % 3], 0.62, r)
    }),
    piece("narrow-bookcase", 3, Wall(0.0), |k, r| {
        storage::bookcase(["wood.oak", "wood.walnut", "wood.birch"][k % 3], 0.6, 2.15, 6, r)
    }),
    rare(1, "chandelier", 1, Ceiling, |_, _| fine::chandelier("metal.brass")),
    rare(1, "floor-lamp", 1, Edge, |_, _| decor::floor_lamp("metal.brass", "shade")),
    // Eating.
    piece("cafe", 4, Free, sets::cafe),
    piece("dining", 3, Free, sets::dining),
    rare(2, "kitchen", 2, Wall(0.0), |k, mut r| sets::kitchen(k, &mut r)),
    rare(1, "buffet", 2, Free, sets::buffet),
    rare(1, "fridge", 1, Wall(0.0), |_, _| wet::fridge("metal.steel")),
    // Reading, looking, making.
    piece("stack", 4, Free, sets::stack),
    piece("reading", 3, Free, sets::reading),
    piece("seats-4", 4, Free, |k, r| sets::seats(k, 4, r)),
    piece("seats-6", 4, Free, |k, r| sets::seats(k, 6, r)),
    piece("workbench", 3, Free, sets::bench_place),
    rare(3, "easel", 2, Edge, |k, _| {
        let strokes = [
            ["lacquer.blue", "fabric.teal", "fabric.mustard", "fabric.red"],
            ["fabric.plum", "fabric.orange", "lacquer.yellow", "fabric.rose"],
        ];
        tables::easel("wood.oak", strokes[k % 2])
    }),
    // Water.
    piece("washplace", 2, Wall(0.0), |k, _| sets::washplace(k)),
    rare(4, "toilet", 1, Wall(0.0), |_, _| sets::toilet()),
    rare(1, "bathtub", 1, Wall(0.0), |_, _| wet::bathtub()),
    rare(2, "towels", 2, Wall(0.6), |k, _| wet::towel_rail(["fabric.red", "fabric.blue"][k % 2])),
    rare(1, "washing-machine", 1, Wall(0.0), |_, _| wet::washing_machine()),
    // Storing.
    piece("rack", 4, Wall(0.0), |k, r| storage::rack([1.8, 2.2][k % 2], 2.1, 5, r)),
    piece("short-rack", 2, Wall(0.0), |_, r| storage::rack(1.2, 2.1, 5, r)),
    piece("carton", 1, Edge, |_, _| storage::carton(0.38, 0.34, 0.28)),
    rare(1, "mop", 1, Edge, |_, _| wet::mop_bucket()),
    // Anywhere.
    piece("ficus", 4, Edge, |k, r| {
        decor::rubber_tree(["pot.white", "pot.clay", "pot.dark"][k % 3], 1.9, 150 + 30 * k, r)
    }),
    rare(3, "palm", 3, Edge, |k, r| decor::palm(["pot.dark", "pot.white"][k % 2], 1.8, 15, r)),
    rare(2, "snake-plant", 2, Edge, |_, r| decor::snake_plant("pot.white", 10, r)),
    rare(2, "coats", 2, Edge, |_, r| decor::coat_stand(r)),
    rare(2, "basket", 1, Edge, |_, _| decor::basket("metal.dark")),
    rare(3, "bench", 2, Wall(0.0), |k, _| {
        seating::bench(["leather.tan", "fabric.teal"][k % 2], "wood.oak", 1.2)
    }),
    rare(2, "pouf", 2, Edge, |k, _| seating::pouf(["fabric.rose", "leather.tan"][k % 2])),
    rare(6, "picture", 5, Wall(1.65), |k, r| {
        let colours = [
            ["book.orange", "book.cream", "book.teal"],
            ["book.navy", "book.teal", "book.cream"],
            ["book.red", "book.wine", "book.grey"],
            ["book.green", "book.yellow", "book.orange"],
            ["book.violet", "book.blue", "book.cream"],
        ];
        decor::picture("wood.black", colours[k % 5], 0.9, 0.65, r)
    }),
    rare(1, "mirror", 1, Wall(1.45), |_, _| decor::mirror("wood.oak", 0.8, 1.3)),
    rare(1, "clock", 1, Wall(2.1), |_, _| decor::clock("lacquer.red")),
    rare(1, "television", 1, Wall(1.2), |_, _| decor::television(1.1)),
    rare(4, "lift", 1, Wall(0.0), |_, _| fine::lift_doors()),
];
