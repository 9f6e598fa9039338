//! What stands where, room by room.
//!
//! Positions are metres from a room's south-west corner. The comments give the room's size and
//! where its doors are, so that a list can be read beside the drawing in [`crate::lshape`].

use super::{Removal, Site};
use crate::furniture::{decor, seating, storage, tables, wet};
use crate::lshape::floor_name;
use crate::mesh::Paint;
use crate::plan::{Filling, Side};
use Side::{East, North, South, West};

/// Puts the furniture of one room.
type Furnisher = fn(&mut Site<'_, '_>);

/// Furnishes every room of the plan.
pub(super) fn furnish(lorry: &mut Removal<'_>) {
    windows(lorry);
    for storey in 0..lorry.plan.storeys {
        let prefix = floor_name(storey);
        let list: &[(&str, Furnisher)] = if storey == 0 {
            &[
                ("canteen", canteen),
                ("lobby", lobby),
                ("office-1", office_1),
                ("office-2", office_2),
                ("conference", conference),
                ("meeting", meeting),
                ("archive", archive),
                ("kitchen", kitchen),
                ("studio", studio),
                ("store", store),
                ("washroom", washroom),
                ("library", library),
                ("hall", hall),
            ]
        } else {
            &[
                ("living", living),
                ("salon", salon),
                ("study", study),
                ("bedroom", bedroom),
                ("atelier", atelier),
                ("bath", bath),
                ("dressing", dressing),
                ("nursery", nursery),
                ("kitchen", home_kitchen),
                ("child", child),
                ("guest", guest),
                ("games", games),
                ("hall", home_hall),
            ]
        };
        for (name, list) in list {
            if let Some(mut site) = lorry.site(&format!("{prefix}/{name}")) {
                list(&mut site);
            }
        }
        if let Some(mut site) = lorry.site_in(&format!("{prefix}/hall"), 1) {
            hall_leg(&mut site, storey > 0);
        }
    }
    if let Some(mut site) = lorry.site("stairwell") {
        stairwell(&mut site);
    }
}

/// Radiators or curtains at every window, as the room's use asks for.
fn windows(lorry: &mut Removal<'_>) {
    for o in lorry.plan.openings.clone() {
        let Filling::Window { .. } = o.filling else { continue };
        let r = o.rect();
        let (x, y) = ((r.x0 + r.x1) / 2.0, (r.y0 + r.y1) / 2.0);
        let z = (o.height.0 + o.height.1) / 2.0;
        let sides = if o.along_x {
            [(South, 0.0, 0.3), (North, 0.0, -0.3)]
        } else {
            [(West, 0.3, 0.0), (East, -0.3, 0.0)]
        };
        for (side, dx, dy) in sides {
            let Some(room) = lorry.plan.room_at(crate::mesh::v(x + dx, y + dy, z)) else {
                continue;
            };
            let name = lorry.plan.rooms[room].name.clone();
            let Some(mut site) = lorry.site(&name) else { continue };
            let along = if o.along_x { x - site.rect.x0 } else { y - site.rect.y0 };
            let width = o.span.1 - o.span.0;
            let cloth: Option<Paint> = match name.rsplit('/').next() {
                Some("living") => Some("fabric.cream"),
                Some("salon") => Some("fabric.mustard"),
                Some("bedroom") => Some("fabric.plum"),
                Some("guest") => Some("fabric.green"),
                Some("child" | "nursery") => Some("fabric.teal"),
                Some("library") => Some("fabric.red"),
                Some("stairwell" | "kitchen" | "store") => continue,
                _ => None,
            };
            if let Some(cloth) = cloth {
                let label = format!(
                    "curtains-{}-{}",
                    cloth.trim_start_matches("fabric."),
                    (width * 10.0) as u32
                );
                let rng = site.stream("curtains");
                site.against(side, &label, || decor::curtains(cloth, width, 2.4, rng), along, 2.5);
            } else {
                let label = format!("radiator-{}", (width * 10.0) as u32);
                site.against(side, &label, || decor::radiator(width - 0.3), along, 0.0);
            }
        }
    }
}

// Pieces that several rooms share, by name.

fn office_chair(s: &mut Site<'_, '_>, cloth: Paint, at: (f64, f64), to: (f64, f64)) {
    // Leather has arms.
    let arms = cloth.starts_with("leather");
    let name = format!("office-chair-{}", cloth.rsplit('.').next().unwrap_or(cloth));
    s.loose(0.05, 24.0).seat(&name, || seating::office_chair(cloth, arms), at, to);
    s.loose(0.0, 0.0);
}

fn shell_chair(s: &mut Site<'_, '_>, paint: Paint, at: (f64, f64), to: (f64, f64)) {
    let name = format!("shell-chair-{}", paint.rsplit('.').next().unwrap_or(paint));
    s.loose(0.05, 15.0).seat(&name, || seating::shell_chair(paint, "wood.oak"), at, to);
    s.loose(0.0, 0.0);
}

fn slat_chair(s: &mut Site<'_, '_>, at: (f64, f64), to: (f64, f64)) {
    s.loose(0.04, 12.0).seat(
        "slat-chair",
        || seating::slat_chair("wood.walnut", "fabric.cream"),
        at,
        to,
    );
    s.loose(0.0, 0.0);
}

fn armchair(s: &mut Site<'_, '_>, cloth: Paint, at: (f64, f64), to: (f64, f64)) {
    let name = format!("armchair-{}", cloth.rsplit('.').next().unwrap_or(cloth));
    s.loose(0.06, 12.0).seat(&name, || seating::armchair(cloth, "wood.walnut"), at, to);
    s.loose(0.0, 0.0);
}

fn stool(s: &mut Site<'_, '_>, cloth: Paint, tall: bool, x: f64, y: f64) {
    let height = if tall { 0.74 } else { 0.46 };
    let name = format!(
        "stool-{}-{}",
        if tall { "bar" } else { "low" },
        cloth.rsplit('.').next().unwrap_or(cloth)
    );
    s.loose(0.04, 45.0).put(
        super::Stance::Seat,
        &name,
        || seating::stool("wood.oak", cloth, height),
        (x, y, 0.0),
        0.0,
    );
    s.loose(0.0, 0.0);
}

fn bookcase(
    s: &mut Site<'_, '_>,
    side: Side,
    name: &str,
    along: f64,
    (w, h): (f64, f64),
    shelves: usize,
) {
    let rng = s.stream(name);
    s.against(side, name, || storage::bookcase("wood.oak", w, h, shelves, rng), along, 0.0);
}

fn picture(
    s: &mut Site<'_, '_>,
    side: Side,
    name: &str,
    along: f64,
    z: f64,
    colours: [Paint; 3],
    (w, h): (f64, f64),
) {
    let rng = s.stream(name);
    s.against(side, name, || decor::picture("wood.black", colours, w, h, rng), along, z);
}

fn computer(s: &mut Site<'_, '_>, x: f64, y: f64, turn: f64) {
    s.loose(0.02, 4.0).rest("computer", decor::computer, (x, y, 0.741), turn);
    s.loose(0.0, 0.0);
}

fn mug(s: &mut Site<'_, '_>, paint: Paint, x: f64, y: f64, z: f64) {
    let name = format!("mug-{}", paint.rsplit('.').next().unwrap_or(paint));
    s.loose(0.02, 180.0).rest(&name, || decor::mug(paint), (x, y, z), 0.0);
    s.loose(0.0, 0.0);
}

fn papers(s: &mut Site<'_, '_>, x: f64, y: f64, z: f64, turn: f64) {
    let rng = s.stream("papers");
    s.loose(0.02, 12.0).rest("papers", || decor::papers(rng), (x, y, z), turn);
    s.loose(0.0, 0.0);
}

fn snake_plant(s: &mut Site<'_, '_>, x: f64, y: f64) {
    let rng = s.stream("snake-plant");
    s.loose(0.02, 180.0).stand(
        "snake-plant",
        || decor::snake_plant("pot.white", 10, rng),
        x,
        y,
        0.0,
    );
    s.loose(0.0, 0.0);
}

fn palm(s: &mut Site<'_, '_>, x: f64, y: f64) {
    let rng = s.stream("palm");
    s.loose(0.03, 180.0).stand("palm", || decor::palm("pot.dark", 1.5, 9, rng), x, y, 0.0);
    s.loose(0.0, 0.0);
}

fn rubber_tree(s: &mut Site<'_, '_>, x: f64, y: f64) {
    let rng = s.stream("rubber-tree");
    s.loose(0.03, 180.0).stand(
        "rubber-tree",
        || decor::rubber_tree("pot.clay", 1.7, 42, rng),
        x,
        y,
        0.0,
    );
    s.loose(0.0, 0.0);
}

fn pot_plant(s: &mut Site<'_, '_>, x: f64, y: f64, z: f64) {
    let rng = s.stream("pot-plant");
    s.loose(0.01, 180.0).rest("pot-plant", || decor::pot_plant("pot.clay", rng), (x, y, z), 0.0);
    s.loose(0.0, 0.0);
}

fn flowers(s: &mut Site<'_, '_>, x: f64, y: f64, z: f64) {
    let rng = s.stream("flowers");
    s.loose(0.02, 180.0).rest(
        "flowers",
        || decor::flowers("ceramic.blue", "lacquer.red", rng),
        (x, y, z),
        0.0,
    );
    s.loose(0.0, 0.0);
}

fn rug(
    s: &mut Site<'_, '_>,
    name: &str,
    paints: [Paint; 3],
    (w, d): (f64, f64),
    (x, y): (f64, f64),
    turn: f64,
) {
    let rng = s.stream(name);
    s.loose(0.03, 2.0).rug(
        name,
        || decor::rug(paints[0], paints[1], paints[2], w, d, rng),
        x,
        y,
        turn,
    );
    s.loose(0.0, 0.0);
}

fn basket(s: &mut Site<'_, '_>, x: f64, y: f64) {
    s.loose(0.03, 180.0).stand("basket", || decor::basket("metal.dark"), x, y, 0.0);
    s.loose(0.0, 0.0);
}

// The ground floor.

/// 4.9 x 6.95; doors: east 1.2 and 6.0, north 3.9.
fn canteen(s: &mut Site<'_, '_>) {
    let shells: [Paint; 3] = ["lacquer.yellow", "lacquer.white", "lacquer.green"];
    for (k, (x, y)) in [(1.3, 1.55), (3.15, 2.75), (1.3, 4.0)].into_iter().enumerate() {
        s.loose(0.04, 30.0).table(
            "cafe-table",
            || tables::round_table("wood.birch", "metal.dark", 0.45, 0.74),
            x,
            y,
            0.0,
        );
        s.loose(0.0, 0.0);
        for i in 0..3 {
            let (sn, cs) = crate::mesh::sin_cos(crate::mesh::radians(
                120.0 * f64::from(i) + 25.0 + 50.0 * k as f64,
            ));
            shell_chair(s, shells[(k + i as usize) % 3], (x + 0.66 * cs, y + 0.66 * sn), (x, y));
        }
        mug(s, if k == 1 { "ceramic.red" } else { "ceramic.blue" }, x + 0.2, y - 0.1, 0.741);
    }
    pot_plant(s, 3.15, 2.75, 0.741);
    s.against(
        North,
        "sideboard-canteen",
        || storage::sideboard("wood.oak", "lacquer.green", 1.9),
        1.6,
        0.0,
    );
    let rng = s.stream("fruit");
    s.rest(
        "fruit-bowl",
        || decor::fruit_bowl("ceramic.white", ["fruit.orange", "fruit.apple"], rng),
        (1.2, 6.68, 0.787),
        0.0,
    );
    for k in 0..2 {
        mug(s, "ceramic.ochre", 1.75 + 0.13 * f64::from(k), 6.68, 0.787);
    }
    snake_plant(s, 0.3, 6.6);
    picture(
        s,
        West,
        "picture-canteen",
        3.1,
        1.6,
        ["book.orange", "book.cream", "book.teal"],
        (0.9, 0.7),
    );
    s.against(North, "clock", || decor::clock("lacquer.red"), 2.1, 1.95);
    basket(s, 2.85, 6.65);
}

/// 4.6 x 4.9; doors: west and east 1.2, north 3.25, entrance south 2.3.
fn lobby(s: &mut Site<'_, '_>) {
    s.table("reception", || tables::counter("wood.walnut", "stone.white", 1.8), 1.25, 3.55, 0.0);
    office_chair(s, "fabric.charcoal", (1.25, 4.25), (1.25, 3.0));
    s.rest("laptop", || decor::laptop("metal.steel"), (1.0, 3.68, 0.732), 180.0);
    s.against(
        East,
        "sofa-teal-2",
        || seating::sofa("fabric.teal", ["fabric.mustard", "fabric.cream"], 2),
        3.25,
        0.0,
    );
    s.table("coffee-table", || tables::coffee_table("wood.walnut", 1.0, 0.55), 3.05, 3.2, 90.0);
    rug(
        s,
        "rug-lobby",
        ["fabric.grey", "fabric.navy", "fabric.mustard"],
        (1.7, 2.2),
        (3.1, 2.7),
        0.0,
    );
    let rng = s.stream("pile");
    s.rest("book-pile", || decor::book_pile(3, rng), (3.05, 3.35, 0.398), 20.0);
    rubber_tree(s, 0.5, 2.45);
    snake_plant(s, 1.1, 0.3);
    picture(
        s,
        North,
        "picture-lobby",
        1.25,
        1.75,
        ["book.navy", "book.teal", "book.cream"],
        (1.3, 0.8),
    );
}

/// 4.0 x 4.9; doors: west and east 1.2, north 3.1 (leaf inside).
fn office_1(s: &mut Site<'_, '_>) {
    s.table("desk-oak", || tables::desk("wood.oak", "lacquer.grey", 1.6), 1.5, 4.49, 0.0);
    office_chair(s, "fabric.blue", (1.5, 3.8), (1.5, 4.5));
    computer(s, 1.35, 4.5, 0.0);
    papers(s, 1.95, 4.4, 0.741, 10.0);
    s.table("desk-oak", || tables::desk("wood.oak", "lacquer.grey", 1.6), 3.58, 2.95, -90.0);
    office_chair(s, "fabric.blue", (2.9, 2.95), (3.6, 2.95));
    computer(s, 3.58, 3.1, -90.0);
    mug(s, "ceramic.red", 3.4, 2.5, 0.741);
    s.rest("desk-lamp", || decor::desk_lamp("lacquer.red"), (3.72, 2.35, 0.741), 90.0);
    bookcase(s, West, "bookcase-office-1", 3.0, (1.0, 1.3), 3);
    basket(s, 2.45, 4.6);
    picture(
        s,
        East,
        "picture-office-1",
        3.0,
        1.65,
        ["book.yellow", "book.orange", "book.red"],
        (0.8, 0.6),
    );
}

/// 4.05 x 4.9; doors: west 1.2, north 0.95 (leaf inside).
fn office_2(s: &mut Site<'_, '_>) {
    s.table("desk-birch", || tables::desk("wood.birch", "lacquer.white", 1.8), 2.2, 3.1, 180.0);
    office_chair(s, "fabric.charcoal", (2.2, 3.8), (2.2, 3.1));
    computer(s, 2.2, 3.1, 180.0);
    papers(s, 1.6, 3.1, 0.741, 170.0);
    mug(s, "ceramic.blue", 2.75, 3.3, 0.741);
    s.rest("desk-lamp", || decor::desk_lamp("lacquer.red"), (2.88, 2.9, 0.741), 200.0);
    shell_chair(s, "lacquer.green", (1.85, 2.2), (1.9, 3.0));
    shell_chair(s, "lacquer.white", (2.6, 2.15), (2.5, 3.0));
    bookcase(s, East, "bookcase-office-2", 3.6, (1.2, 1.95), 5);
    s.against(
        East,
        "sideboard-office",
        || storage::sideboard("wood.birch", "lacquer.white", 1.45),
        2.1,
        0.0,
    );
    s.rest("globe", decor::globe, (3.8, 1.75, 0.787), 40.0);
    picture(
        s,
        West,
        "picture-office-2",
        3.2,
        1.6,
        ["book.olive", "book.green", "book.cream"],
        (1.0, 0.75),
    );
}

/// 4.95 x 11.9; door: west 6.0.
fn conference(s: &mut Site<'_, '_>) {
    let (x, y) = (2.5, 5.9);
    s.table(
        "conference-table",
        || tables::conference_table("wood.walnut", "metal.dark", 6.4, 1.45),
        x,
        y,
        0.0,
    );
    for k in 0..6 {
        let cy = y - 2.6 + 1.04 * f64::from(k);
        office_chair(s, "leather.tan", (x - 1.02, cy), (x, cy));
        office_chair(s, "leather.tan", (x + 1.02, cy), (x, cy));
    }
    office_chair(s, "leather.tan", (x, y - 3.6), (x, y));
    office_chair(s, "leather.tan", (x, y + 3.6), (x, y));
    for (dx, dy, turn) in
        [(-0.4, -1.6, -90.0), (0.42, -0.5, 90.0), (-0.4, 1.55, -90.0), (0.4, 2.6, 90.0)]
    {
        s.loose(0.03, 8.0).rest(
            "laptop",
            || decor::laptop("metal.steel"),
            (x + dx, y + dy, 0.747),
            turn,
        );
        s.loose(0.0, 0.0);
    }
    for (dx, dy, turn) in [
        (0.42, -2.6, 80.0),
        (-0.42, -0.5, -95.0),
        (0.42, 0.55, 88.0),
        (-0.4, 2.6, -80.0),
        (0.42, 1.6, 90.0),
    ] {
        papers(s, x + dx, y + dy, 0.747, turn);
    }
    for (k, (dx, dy)) in
        [(-0.4, -2.2), (0.42, -1.9), (-0.42, 0.1), (0.4, 1.0), (-0.4, 2.0), (0.42, -1.1)]
            .into_iter()
            .enumerate()
    {
        mug(s, if k % 2 == 0 { "ceramic.white" } else { "ceramic.blue" }, x + dx, y + dy, 0.747);
    }
    s.rest("carafe", decor::carafe, (x, y - 1.2, 0.747), 80.0);
    s.rest("carafe", decor::carafe, (x, y + 1.3, 0.747), 100.0);
    flowers(s, x, y + 0.55, 0.747);
    s.put(super::Stance::Stands, "projector", decor::projector, (x, 9.3, 2.794), 180.0);
    s.against(West, "whiteboard", || decor::whiteboard(2.4, 1.2), 3.0, 1.55);
    s.against(
        West,
        "sideboard-conference",
        || storage::sideboard("wood.walnut", "wood.walnut", 2.4),
        9.4,
        0.0,
    );
    s.rest(
        "fruit-bowl",
        || {
            decor::fruit_bowl(
                "ceramic.white",
                ["fruit.orange", "fruit.apple"],
                crate::rng::Rng::new(1, "fruit"),
            )
        },
        (0.24, 8.8, 0.787),
        0.0,
    );
    pot_plant(s, 0.24, 10.2, 0.787);
    picture(
        s,
        West,
        "picture-conference",
        9.4,
        1.75,
        ["book.wine", "book.orange", "book.cream"],
        (1.6, 0.9),
    );
    palm(s, 4.25, 11.2);
    palm(s, 0.7, 11.2);
    rubber_tree(s, 0.55, 0.55);
}

/// 4.8 x 4.8; door: south 3.8 (leaf inside); glass screen west 1.2 to 3.2.
fn meeting(s: &mut Site<'_, '_>) {
    let (x, y) = (2.3, 2.7);
    s.table(
        "meeting-table",
        || tables::round_table("wood.birch", "metal.dark", 0.8, 0.74),
        x,
        y,
        15.0,
    );
    for k in 0..5 {
        let (sn, cs) = crate::mesh::sin_cos(crate::mesh::radians(72.0 * f64::from(k) + 10.0));
        slat_chair(s, (x + 1.0 * cs, y + 1.0 * sn), (x, y));
    }
    papers(s, x + 0.4, y - 0.2, 0.741, 60.0);
    mug(s, "ceramic.ochre", x - 0.3, y + 0.35, 0.741);
    s.against(
        East,
        "sideboard-meeting",
        || storage::sideboard("wood.birch", "lacquer.yellow", 1.45),
        2.7,
        0.0,
    );
    s.rest("television", || decor::television(1.1), (4.56, 2.7, 0.787), -90.0);
    basket(s, 0.3, 0.4);
    picture(
        s,
        South,
        "picture-meeting",
        1.5,
        1.6,
        ["book.violet", "book.blue", "book.cream"],
        (1.0, 0.7),
    );
}

/// 3.1 x 4.8, unlit; door: south 1.0 (leaf inside).
fn archive(s: &mut Site<'_, '_>) {
    for (name, side, along, w) in
        [("rack-archive-1", West, 2.7, 2.2), ("rack-archive-2", East, 2.6, 2.2)]
    {
        let rng = s.stream(name);
        s.against(side, name, || storage::rack(w, 2.1, 5, rng), along, 0.0);
    }
    s.loose(0.03, 20.0);
    s.stand("carton", || storage::carton(0.38, 0.34, 0.28), 1.1, 4.15, 8.0);
    s.rest("carton", || storage::carton(0.38, 0.34, 0.28), (1.1, 4.15, 0.283), -6.0);
    s.stand("carton", || storage::carton(0.38, 0.34, 0.28), 1.75, 4.1, 0.0);
    s.loose(0.0, 0.0);
    stool(s, "leather.black", false, 1.5, 2.6);
}

/// A run of kitchen units along a wall; `kinds` from west or south, `wet::base_unit`.
fn units(s: &mut Site<'_, '_>, side: Side, front: Paint, from: f64, kinds: &[u32]) {
    let tint = front.rsplit('.').next().unwrap_or(front).to_owned();
    for (k, &kind) in kinds.iter().enumerate() {
        let name = format!("unit-{tint}-{kind}");
        s.against_as(
            super::Stance::Stands,
            side,
            &name,
            || wet::base_unit(front, "stone.dark", 0.6, kind),
            from + 0.3 + 0.6 * k as f64,
            0.0,
        );
    }
}

/// 4.9 x 4.8; doors: south 3.9, east 4.0 (leaf inside).
fn kitchen(s: &mut Site<'_, '_>) {
    units(s, West, "lacquer.white", 0.6, &[0, 1, 3, 1, 1]);
    units(s, North, "lacquer.white", 0.7, &[0, 2, 0, 1]);
    for along in [1.0, 2.2] {
        s.against(North, "wall-unit-white", || wet::wall_unit("lacquer.white", 0.6), along, 1.45);
    }
    s.against(North, "hood", wet::hood, 1.6, 1.6);
    s.against(North, "fridge-steel", || wet::fridge("metal.steel"), 3.45, 0.0);
    s.rest("pot-steel", || wet::cooking_pot("metal.steel", 0.11, 0.14), (1.47, 4.4, 0.903), 30.0);
    s.rest("pot-red", || wet::cooking_pot("ceramic.red", 0.09, 0.1), (1.73, 4.6, 0.903), 100.0);
    s.rest("worktop-things", wet::worktop_things, (0.34, 1.3, 0.897), 90.0);
    s.table("work-table", || tables::table("wood.birch", 1.7, 0.85, 0.9), 2.7, 2.3, 0.0);
    for (x, y) in [(2.2, 1.65), (3.1, 1.65)] {
        stool(s, "leather.tan", true, x, y);
    }
    let rng = s.stream("fruit-bowl");
    s.rest(
        "fruit-bowl",
        || decor::fruit_bowl("ceramic.white", ["fruit.orange", "fruit.apple"], rng),
        (2.9, 2.4, 0.902),
        0.0,
    );
}

/// 4.9 x 5.35; door: east 1.05 (leaf inside).
fn studio(s: &mut Site<'_, '_>) {
    for (x, y, turn) in [(1.75, 2.6, 0.0), (1.75, 3.38, 180.0), (3.2, 2.6, 0.0)] {
        s.table("desk-white", || tables::desk("lacquer.white", "lacquer.grey", 1.4), x, y, turn);
        let out = if turn == 0.0 { -0.72 } else { 0.72 };
        office_chair(s, "fabric.mustard", (x, y + out), (x, y));
        computer(s, x, y, turn);
    }
    papers(s, 2.25, 2.45, 0.741, 5.0);
    mug(s, "ceramic.green", 3.72, 2.75, 0.741);
    s.against(
        North,
        "sideboard-studio",
        || storage::sideboard("lacquer.white", "lacquer.blue", 1.45),
        2.85,
        0.0,
    );
    pot_plant(s, 2.5, 5.1, 0.787);
    picture(
        s,
        North,
        "picture-studio",
        2.85,
        1.6,
        ["book.blue", "book.white", "book.yellow"],
        (1.1, 0.8),
    );
    basket(s, 0.4, 4.4);
}

/// 4.8 x 2.0, unlit; door: west 1.25 (leaf inside).
fn store(s: &mut Site<'_, '_>) {
    let rng = s.stream("rack-store-1");
    s.against(South, "rack-store-1", || storage::rack(1.8, 2.0, 5, rng), 2.6, 0.0);
    s.stand("mop-bucket", wet::mop_bucket, 4.4, 1.65, 200.0);
    s.against(North, "washing-machine", wet::washing_machine, 2.0, 0.0);
    s.loose(0.02, 10.0).stand("carton", || storage::carton(0.38, 0.34, 0.28), 3.4, 1.7, 0.0);
    s.loose(0.0, 0.0);
}

/// 4.8 x 3.2; door: west 0.8 (leaf inside).
fn washroom(s: &mut Site<'_, '_>) {
    for x in [0.9, 2.0] {
        s.against(North, "washbasin-white", || wet::washbasin("lacquer.white", 0.9), x, 0.0);
        s.against(North, "mirror-wash", || decor::mirror("metal.steel", 0.8, 1.0), x, 1.55);
    }
    for x in [2.0, 2.95] {
        s.against(South, "toilet", wet::toilet, x, 0.0);
        s.against(South, "paper-roll", wet::paper_roll, x + 0.34, 0.75);
    }
    for x in [1.52, 2.47, 3.42] {
        s.stand("cubicle-wall", || wet::cubicle_wall("lacquer.blue", 1.35), x, 0.7, 0.0);
    }
    s.against(North, "towel-rail-blue", || wet::towel_rail("fabric.blue"), 3.0, 0.6);
    basket(s, 3.6, 2.95);
}

/// 11.9 x 4.85; door: south 6.0.
fn library(s: &mut Site<'_, '_>) {
    bookcase(s, South, "bookcase-library-1", 0.95, (1.2, 2.15), 5);
    bookcase(s, South, "bookcase-library-2", 2.2, (1.2, 2.15), 5);
    bookcase(s, South, "bookcase-library-3", 3.45, (1.2, 2.15), 5);
    bookcase(s, North, "bookcase-library-4", 4.03, (1.1, 2.15), 5);
    bookcase(s, North, "bookcase-library-5", 7.87, (1.1, 2.15), 5);
    s.table("reading-table", || tables::table("wood.walnut", 2.6, 1.0, 0.75), 9.3, 2.2, 0.0);
    for (x, y, ty) in [(8.6, 1.55, 2.2), (9.9, 1.5, 2.2), (8.65, 2.9, 2.2), (10.0, 2.9, 2.2)] {
        slat_chair(s, (x, y), (x, ty));
    }
    for x in [8.7, 9.9] {
        s.rest(
            "table-lamp",
            || decor::table_lamp("metal.brass", "lacquer.green"),
            (x, 2.2, 0.752),
            0.0,
        );
    }
    let rng = s.stream("pile");
    s.loose(0.03, 30.0).rest("book-pile", || decor::book_pile(3, rng), (9.3, 2.3, 0.752), 40.0);
    s.loose(0.0, 0.0);
    papers(s, 8.3, 2.0, 0.752, 10.0);
    rug(
        s,
        "rug-library",
        ["fabric.red", "fabric.navy", "fabric.cream"],
        (3.5, 2.3),
        (2.7, 2.75),
        0.0,
    );
    armchair(s, "leather.brown", (1.4, 2.9), (2.6, 2.7));
    armchair(s, "leather.brown", (3.6, 2.9), (2.5, 2.6));
    s.table("side-table", || tables::side_table("wood.walnut"), 2.5, 3.3, 0.0);
    s.rest("globe", decor::globe, (2.5, 3.3, 0.527), 70.0);
    s.table("coffee-table", || tables::coffee_table("wood.walnut", 1.0, 0.55), 2.5, 2.3, 0.0);
    s.rest(
        "book-pile-2",
        || decor::book_pile(4, crate::rng::Rng::new(5, "pile")),
        (2.35, 2.3, 0.398),
        15.0,
    );
    s.stand("floor-lamp", || decor::floor_lamp("metal.brass", "shade"), 0.45, 3.9, 0.0);
    rubber_tree(s, 11.3, 4.2);
    s.against(
        East,
        "sideboard-library",
        || storage::sideboard("wood.walnut", "wood.walnut", 1.2),
        0.68,
        0.0,
    );
    picture(
        s,
        South,
        "picture-library",
        8.3,
        1.7,
        ["book.wine", "book.brown", "book.cream"],
        (1.5, 1.0),
    );
    snake_plant(s, 5.0, 0.35);
    s.loose(0.05, 90.0).stand("pouf-tan", || seating::pouf("leather.tan"), 3.7, 1.75, 0.0);
    s.loose(0.0, 0.0);
}

/// The first leg, 12.95 x 1.9; doors: south 3.25, 7.85, 9.85; north 5.85, 7.65, 10.85.
fn hall(s: &mut Site<'_, '_>) {
    s.against(North, "bench-hall", || seating::bench("leather.tan", "wood.oak", 1.2), 4.1, 0.0);
    s.against(South, "mirror-hall", || decor::mirror("wood.oak", 0.9, 1.4), 5.6, 1.45);
    rug(s, "runner", ["fabric.teal", "fabric.navy", "fabric.cream"], (3.2, 0.9), (4.6, 0.85), 0.0);
    picture(
        s,
        North,
        "picture-hall-1",
        4.1,
        1.65,
        ["book.green", "book.yellow", "book.orange"],
        (0.9, 0.65),
    );
    picture(
        s,
        South,
        "picture-hall-2",
        1.6,
        1.65,
        ["book.blue", "book.teal", "book.white"],
        (0.9, 0.65),
    );
    picture(
        s,
        North,
        "picture-hall-3",
        9.3,
        1.65,
        ["book.red", "book.wine", "book.grey"],
        (0.9, 0.65),
    );
}

/// The second leg, 1.9 x 10.45; doors: west 4.15 and 6.15, east 6.35 and 8.05, north.
fn hall_leg(s: &mut Site<'_, '_>, upper: bool) {
    rug(s, "runner", ["fabric.teal", "fabric.navy", "fabric.cream"], (3.2, 0.9), (0.95, 2.4), 90.0);
    picture(
        s,
        West,
        "picture-leg-1",
        2.3,
        1.65,
        ["book.orange", "book.red", "book.violet"],
        (0.8, 1.0),
    );
    picture(
        s,
        West,
        "picture-leg-2",
        8.2,
        1.65,
        ["book.teal", "book.olive", "book.cream"],
        (1.1, 0.7),
    );
    picture(
        s,
        East,
        "picture-leg-3",
        4.7,
        1.65,
        ["book.navy", "book.blue", "book.white"],
        (0.7, 0.9),
    );
    if upper {
        s.against(
            West,
            "bench-upper",
            || seating::bench("fabric.teal", "wood.walnut", 1.1),
            8.2,
            0.0,
        );
    }
}

// The apartments.

/// 4.9 x 6.95; doors: east 1.2 and 6.0, north 3.9.
fn living(s: &mut Site<'_, '_>) {
    rug(
        s,
        "rug-living",
        ["fabric.cream", "fabric.red", "fabric.navy"],
        (2.2, 3.0),
        (3.0, 3.6),
        0.0,
    );
    s.against(
        East,
        "sofa-grey-3",
        || seating::sofa("fabric.grey", ["fabric.orange", "fabric.teal"], 3),
        3.6,
        0.0,
    );
    s.table("coffee-table", || tables::coffee_table("wood.walnut", 1.0, 0.55), 3.1, 3.6, 90.0);
    s.rest(
        "book-pile-2",
        || decor::book_pile(4, crate::rng::Rng::new(5, "pile")),
        (3.1, 3.85, 0.398),
        100.0,
    );
    mug(s, "ceramic.white", 3.05, 3.35, 0.398);
    armchair(s, "fabric.mustard", (1.75, 4.55), (3.1, 3.6));
    s.loose(0.04, 10.0).seat(
        "lounge-chair",
        || seating::lounge_chair("leather.brown", "wood.walnut"),
        (1.6, 2.9),
        (3.1, 3.5),
    );
    s.loose(0.0, 0.0);
    s.against(North, "fireplace", decor::fireplace, 1.9, 0.0);
    flowers(s, 1.2, 6.78, 1.078);
    s.rest("vase-ochre", || decor::vase("ceramic.ochre", 0.26), (2.45, 6.84, 1.078), 0.0);
    s.against(North, "mirror-living", || decor::mirror("metal.brass", 0.8, 0.9), 1.9, 1.75);
    picture(
        s,
        East,
        "picture-living",
        3.6,
        1.7,
        ["book.navy", "book.orange", "book.yellow"],
        (1.5, 0.85),
    );
    s.stand("floor-lamp", || decor::floor_lamp("metal.brass", "shade"), 4.6, 2.1, 0.0);
    snake_plant(s, 0.4, 6.5);
}

/// 4.6 x 4.9; doors: west and east 1.2, north 3.25.
fn salon(s: &mut Site<'_, '_>) {
    s.against(North, "piano", || tables::piano("wood.black"), 1.25, 0.0);
    stool(s, "leather.black", false, 1.25, 4.0);
    s.rug("round-rug", || decor::round_rug("fabric.cream", "fabric.blue", 1.15), 2.2, 2.75, 0.0);
    s.against(
        East,
        "sofa-plum-2",
        || seating::sofa("fabric.plum", ["fabric.rose", "fabric.cream"], 2),
        3.1,
        0.0,
    );
    armchair(s, "fabric.teal", (1.3, 2.6), (2.6, 2.8));
    s.table("side-table", || tables::side_table("wood.walnut"), 2.4, 2.9, 0.0);
    s.rest(
        "table-lamp-blue",
        || decor::table_lamp("ceramic.blue", "shade"),
        (2.4, 2.9, 0.527),
        0.0,
    );
    rubber_tree(s, 0.5, 3.1);
    picture(
        s,
        North,
        "picture-salon",
        1.25,
        1.8,
        ["book.cream", "book.orange", "book.wine"],
        (1.2, 0.7),
    );
    picture(
        s,
        East,
        "picture-salon-2",
        3.1,
        1.65,
        ["book.teal", "book.grey", "book.cream"],
        (0.9, 0.9),
    );
}

/// 4.0 x 4.9; doors: west and east 1.2, north 3.1 (leaf inside).
fn study(s: &mut Site<'_, '_>) {
    bookcase(s, West, "bookcase-study-1", 2.7, (1.2, 2.15), 5);
    s.table("desk-walnut", || tables::desk("wood.walnut", "wood.walnut", 1.5), 2.2, 3.1, 180.0);
    office_chair(s, "fabric.green", (2.2, 3.85), (2.2, 3.0));
    s.rest("laptop", || decor::laptop("metal.steel"), (2.2, 3.15, 0.741), 180.0);
    s.rest(
        "table-lamp",
        || decor::table_lamp("metal.brass", "lacquer.green"),
        (1.65, 2.9, 0.741),
        0.0,
    );
    papers(s, 2.65, 3.1, 0.741, 190.0);
    armchair(s, "leather.brown", (3.45, 2.5), (2.2, 2.9));
    rug(
        s,
        "rug-study",
        ["fabric.green", "fabric.navy", "fabric.cream"],
        (2.4, 1.7),
        (2.3, 3.2),
        0.0,
    );
    s.against(
        North,
        "sideboard-study",
        || storage::sideboard("wood.walnut", "wood.walnut", 1.2),
        1.5,
        0.0,
    );
    s.rest("globe", decor::globe, (1.2, 4.66, 0.787), 15.0);
    picture(
        s,
        North,
        "picture-study",
        1.5,
        1.65,
        ["book.brown", "book.cream", "book.olive"],
        (0.9, 0.7),
    );
}

/// 4.05 x 4.9; doors: west and east 1.2, north 0.95 (leaf inside).
fn bedroom(s: &mut Site<'_, '_>) {
    let rng = s.stream("bed");
    s.against(
        East,
        "bed-double-blue",
        || seating::bed("wood.oak", "fabric.navy", "fabric.white", 1.6, rng),
        3.4,
        0.0,
    );
    for y in [2.25, 4.55] {
        s.against(
            East,
            "nightstand",
            || tables::drawers("wood.oak", "metal.brass", (0.44, 0.4, 0.5), 2),
            y,
            0.0,
        );
        s.rest(
            "table-lamp-blue",
            || decor::table_lamp("ceramic.blue", "shade"),
            (3.8, y, 0.503),
            0.0,
        );
    }
    s.against(West, "wardrobe-white", || storage::wardrobe("lacquer.white", 1.6, 2.2), 2.9, 0.0);
    rug(
        s,
        "rug-bedroom",
        ["fabric.rose", "fabric.plum", "fabric.cream"],
        (2.0, 1.4),
        (2.2, 3.3),
        90.0,
    );
    s.loose(0.04, 90.0).stand("pouf", || seating::pouf("fabric.rose"), 2.9, 2.0, 0.0);
    s.loose(0.0, 0.0);
    picture(
        s,
        North,
        "picture-bedroom",
        2.6,
        1.7,
        ["book.violet", "book.wine", "book.cream"],
        (1.1, 0.7),
    );
}

/// 4.95 x 11.9; doors: west 1.2 and 6.0.
fn atelier(s: &mut Site<'_, '_>) {
    s.loose(0.08, 20.0);
    s.stand(
        "easel-1",
        || {
            tables::easel(
                "wood.oak",
                ["lacquer.blue", "fabric.teal", "fabric.mustard", "fabric.red"],
            )
        },
        1.6,
        9.8,
        150.0,
    );
    s.stand(
        "easel-2",
        || {
            tables::easel(
                "wood.oak",
                ["fabric.plum", "fabric.orange", "lacquer.yellow", "fabric.rose"],
            )
        },
        3.5,
        9.7,
        205.0,
    );
    s.loose(0.0, 0.0);
    stool(s, "leather.tan", false, 1.9, 8.9);
    stool(s, "leather.tan", false, 3.2, 8.8);
    s.stand("workbench", || tables::workbench("wood.birch", 2.0), 2.6, 7.0, 0.0);
    papers(s, 2.7, 6.95, 0.872, 20.0);
    s.table("drawing-table", || tables::table("wood.oak", 2.2, 1.0, 0.75), 2.9, 3.6, 0.0);
    for (x, y) in [(2.3, 2.95), (3.4, 2.95), (2.3, 4.25), (3.4, 4.25)] {
        shell_chair(s, "lacquer.white", (x, y), (x, 3.6));
    }
    papers(s, 2.4, 3.5, 0.752, 0.0);
    papers(s, 3.3, 3.7, 0.752, 180.0);
    s.rest("desk-lamp", || decor::desk_lamp("lacquer.red"), (2.9, 3.75, 0.752), 20.0);
    picture(
        s,
        West,
        "picture-atelier-1",
        3.6,
        1.9,
        ["lacquer.blue", "lacquer.yellow", "lacquer.red"],
        (1.2, 0.8),
    );
    s.against(
        West,
        "sideboard-canteen",
        || storage::sideboard("wood.oak", "lacquer.green", 1.9),
        3.6,
        0.0,
    );
    rubber_tree(s, 4.3, 0.65);
    s.loose(0.05, 20.0).stand("arc-lamp", decor::arc_lamp, 0.7, 11.3, 20.0);
    s.loose(0.0, 0.0);
}

/// 3.15 x 4.8; door: south 2.4 (leaf inside).
fn bath(s: &mut Site<'_, '_>) {
    s.against(North, "bathtub", wet::bathtub, 1.0, 0.0);
    s.stand("shower", wet::shower, 2.68, 4.33, 0.0);
    s.against(West, "washbasin-oak", || wet::washbasin("wood.oak", 1.0), 2.5, 0.0);
    s.against(West, "mirror-bath", || decor::mirror("metal.steel", 1.1, 1.0), 2.5, 1.55);
    s.against(East, "toilet", wet::toilet, 2.4, 0.0);
    s.against(East, "paper-roll", wet::paper_roll, 1.95, 0.75);
    s.against(West, "towel-rail-red", || wet::towel_rail("fabric.red"), 1.2, 0.6);
    rug(
        s,
        "bath-mat",
        ["fabric.teal", "fabric.white", "fabric.white"],
        (0.9, 0.6),
        (1.1, 3.5),
        0.0,
    );
    basket(s, 0.4, 0.4);
}

/// 1.5 x 4.8, unlit; door: south 0.75 (leaf inside).
fn dressing(s: &mut Site<'_, '_>) {
    let rng = s.stream("clothes");
    s.stand("clothes-rail", || storage::clothes(2.0, 12, rng), 0.32, 2.6, 90.0);
    s.against(North, "mirror-dressing", || decor::mirror("wood.oak", 0.7, 1.6), 0.75, 1.1);
    s.stand("pouf", || seating::pouf("fabric.rose"), 1.1, 3.9, 0.0);
    s.loose(0.01, 5.0);
    s.stand("carton", || storage::carton(0.38, 0.34, 0.28), 1.22, 1.4, 90.0);
    s.rest("carton", || storage::carton(0.38, 0.34, 0.28), (1.22, 1.4, 0.283), 86.0);
    s.stand("carton", || storage::carton(0.38, 0.34, 0.28), 1.22, 1.9, 92.0);
    s.loose(0.0, 0.0);
    s.against(West, "bench-dressing", || seating::bench("fabric.rose", "wood.oak", 0.8), 4.2, 0.0);
}

/// 3.1 x 4.8; door: south 1.0 (leaf inside).
fn nursery(s: &mut Site<'_, '_>) {
    s.stand("cot", || seating::cot("lacquer.white", "fabric.teal"), 2.66, 3.1, 0.0);
    s.rug(
        "round-rug-nursery",
        || decor::round_rug("fabric.mustard", "fabric.cream", 0.95),
        1.4,
        2.9,
        0.0,
    );
    let rng = s.stream("toys");
    s.loose(0.08, 90.0).stand("toys", || decor::toys(rng), 1.4, 2.8, 20.0);
    s.loose(0.06, 30.0).stand("rocking-horse", decor::rocking_horse, 1.1, 3.95, 40.0);
    s.loose(0.0, 0.0);
    bookcase(s, West, "bookcase-nursery", 1.9, (0.9, 1.05), 3);
    armchair(s, "fabric.rose", (2.42, 1.35), (1.4, 2.4));
    s.rest("bear", || seating::bear("leather.tan"), (0.2, 1.9, 1.082), 90.0);
    picture(
        s,
        East,
        "picture-nursery",
        3.1,
        1.7,
        ["lacquer.green", "lacquer.blue", "lacquer.yellow"],
        (0.9, 0.6),
    );
}

/// 4.9 x 4.8; doors: south 3.9, east 4.0 (leaf inside).
fn home_kitchen(s: &mut Site<'_, '_>) {
    units(s, West, "lacquer.blue", 0.9, &[0, 3, 1, 2]);
    s.against(West, "fridge-white", || wet::fridge("lacquer.white"), 3.75, 0.0);
    s.rest("pot-red", || wet::cooking_pot("ceramic.red", 0.09, 0.1), (0.36, 2.87, 0.903), 20.0);
    s.rest("worktop-things", wet::worktop_things, (0.34, 1.2, 0.897), 90.0);
    s.table("dining-table", || tables::table("wood.oak", 1.7, 0.95, 0.75), 2.8, 2.5, 0.0);
    for (x, y) in [(2.35, 1.9), (3.25, 1.9), (2.35, 3.12), (3.25, 3.12)] {
        slat_chair(s, (x, y), (x, 2.5));
        let (py, turn) = if y < 2.5 { (2.22, 0.0) } else { (2.78, 180.0) };
        s.loose(0.01, 4.0).rest("place-setting", decor::place_setting, (x, py, 0.752), turn);
        s.loose(0.0, 0.0);
    }
    flowers(s, 2.8, 2.5, 0.752);
    s.against(
        North,
        "sideboard-kitchen",
        || storage::sideboard("wood.oak", "lacquer.blue", 1.6),
        2.2,
        0.0,
    );
    let rng = s.stream("fruit");
    s.rest(
        "fruit-bowl",
        || decor::fruit_bowl("ceramic.white", ["fruit.orange", "fruit.apple"], rng),
        (2.2, 4.56, 0.787),
        0.0,
    );
    picture(
        s,
        North,
        "picture-kitchen",
        2.2,
        1.6,
        ["book.red", "book.yellow", "book.cream"],
        (0.9, 0.6),
    );
}

/// 4.9 x 5.35; door: east 1.05 (leaf inside).
fn child(s: &mut Site<'_, '_>) {
    let rng = s.stream("bed");
    s.against(
        North,
        "bed-single-teal",
        || seating::bed("wood.birch", "fabric.mustard", "fabric.white", 0.9, rng),
        0.75,
        0.0,
    );
    let rng = s.stream("bed-2");
    s.against(
        North,
        "bed-single-red",
        || seating::bed("wood.birch", "fabric.red", "fabric.white", 0.9, rng),
        3.9,
        0.0,
    );
    s.against(
        North,
        "nightstand",
        || tables::drawers("wood.oak", "metal.brass", (0.44, 0.4, 0.5), 2),
        2.3,
        0.0,
    );
    s.rest("bear", || seating::bear("leather.tan"), (2.3, 5.1, 0.503), 10.0);
    s.table("desk-child", || tables::desk("wood.birch", "lacquer.yellow", 1.2), 1.6, 0.42, 180.0);
    shell_chair(s, "lacquer.yellow", (1.6, 1.05), (1.6, 0.4));
    s.rest("globe", decor::globe, (1.2, 0.35, 0.741), 0.0);
    papers(s, 1.7, 0.45, 0.741, 180.0);
    s.against(South, "wardrobe-blue", || storage::wardrobe("lacquer.blue", 1.0, 1.9), 3.2, 0.0);
    rug(
        s,
        "rug-child",
        ["fabric.teal", "fabric.orange", "fabric.cream"],
        (2.0, 1.5),
        (2.4, 2.5),
        0.0,
    );
    s.loose(0.0, 0.0);
    picture(
        s,
        East,
        "picture-child",
        3.2,
        1.7,
        ["lacquer.red", "lacquer.white", "lacquer.blue"],
        (1.0, 0.7),
    );
}

/// 4.8 x 5.35; door: west 2.95 (leaf inside).
fn guest(s: &mut Site<'_, '_>) {
    let rng = s.stream("bed");
    s.against(
        South,
        "bed-double-green",
        || seating::bed("wood.walnut", "fabric.green", "fabric.cream", 1.6, rng),
        2.6,
        0.0,
    );
    for x in [1.45, 3.75] {
        s.against(
            South,
            "nightstand",
            || tables::drawers("wood.oak", "metal.brass", (0.44, 0.4, 0.5), 2),
            x,
            0.0,
        );
        s.rest(
            "table-lamp-blue",
            || decor::table_lamp("ceramic.blue", "shade"),
            (x, 0.25, 0.503),
            0.0,
        );
    }
    s.against(North, "wardrobe-white", || storage::wardrobe("lacquer.white", 1.6, 2.2), 1.3, 0.0);
    s.against(
        North,
        "sideboard-guest",
        || storage::sideboard("wood.walnut", "wood.walnut", 1.2),
        3.2,
        0.0,
    );
    s.rest("television", || decor::television(1.1), (3.2, 5.1, 0.787), 0.0);
    armchair(s, "fabric.green", (3.9, 3.2), (2.4, 3.0));
    rug(
        s,
        "rug-guest",
        ["fabric.cream", "fabric.green", "fabric.mustard"],
        (2.2, 1.4),
        (2.6, 2.6),
        0.0,
    );
    picture(
        s,
        South,
        "picture-guest",
        2.6,
        1.7,
        ["book.green", "book.olive", "book.cream"],
        (1.2, 0.7),
    );
}

/// 11.9 x 4.85; door: south 6.0.
fn games(s: &mut Site<'_, '_>) {
    s.table("pool-table", || tables::pool_table("wood.cherry"), 3.1, 2.3, 0.0);
    s.table("bar", || tables::counter("wood.walnut", "stone.dark", 2.0), 9.6, 3.75, 0.0);
    for x in [8.9, 9.6, 10.3] {
        stool(s, "leather.brown", true, x, 3.1);
    }
    s.against(
        South,
        "sofa-brown-3",
        || seating::sofa("leather.brown", ["fabric.mustard", "fabric.green"], 3),
        8.6,
        0.0,
    );
    s.table("coffee-table", || tables::coffee_table("wood.walnut", 1.0, 0.55), 8.6, 1.35, 0.0);
    rug(
        s,
        "rug-games",
        ["fabric.navy", "fabric.red", "fabric.mustard"],
        (2.6, 1.9),
        (8.6, 1.35),
        0.0,
    );
    armchair(s, "leather.brown", (10.4, 1.5), (8.8, 1.2));
    picture(
        s,
        South,
        "picture-games",
        8.6,
        1.7,
        ["book.navy", "book.red", "book.yellow"],
        (1.6, 0.8),
    );
    s.stand("floor-lamp", || decor::floor_lamp("metal.brass", "shade"), 7.05, 0.35, 0.0);
    snake_plant(s, 0.5, 4.4);
}

/// As downstairs, with other pictures.
fn home_hall(s: &mut Site<'_, '_>) {
    s.against(
        North,
        "sideboard-hall",
        || storage::sideboard("wood.oak", "lacquer.white", 1.2),
        3.0,
        0.0,
    );
    s.against(North, "mirror-hall", || decor::mirror("wood.oak", 0.9, 1.4), 3.0, 1.7);
    rug(s, "runner", ["fabric.teal", "fabric.navy", "fabric.cream"], (3.2, 0.9), (5.5, 0.85), 0.0);
    picture(
        s,
        South,
        "picture-hall-4",
        5.6,
        1.65,
        ["book.violet", "book.teal", "book.yellow"],
        (0.9, 0.65),
    );
    picture(
        s,
        South,
        "picture-hall-5",
        1.6,
        1.65,
        ["book.wine", "book.orange", "book.cream"],
        (0.9, 0.65),
    );
}

/// 2.7 x 4.8, the landing; door: south 0.65.
fn stairwell(s: &mut Site<'_, '_>) {
    snake_plant(s, 2.4, 0.4);
    picture(
        s,
        West,
        "picture-stairs",
        2.6,
        1.9,
        ["book.yellow", "book.red", "book.cream"],
        (0.9, 1.1),
    );
}
