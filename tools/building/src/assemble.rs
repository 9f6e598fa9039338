//! From a drawing of storeys to a building: every mesh once, with a place on every floor.

use crate::carcass::{Carcass, Wells};
use crate::fittings;
use crate::furnish::Placement;
use crate::furnish::auto::{self, Furnishing, Stock};
use crate::mesh::{Mesh, v};
use crate::outline::{Convex, at};
use crate::plan::{Plan, Room, View};
use crate::storey::{CEILING, HEIGHT, Storey};
use crate::{Building, Part, Request};
use std::collections::BTreeMap;

/// The drawing of a building of storeys.
#[derive(Clone, Debug, PartialEq)]
pub struct Drawing {
    /// Name of the building.
    pub name: &'static str,
    /// Outer faces of the outer walls, in pieces that touch.
    pub footprint: Vec<Convex>,
    /// The storeys from the ground up; the last one is repeated.
    pub storeys: Vec<Storey>,
    /// In how many ways each storey is furnished, floor after floor.
    pub furnishings: u32,
    /// Cameras, with the floor they are on.
    pub views: Vec<(u32, View)>,
}

/// A camera on a floor, at heights above it. Nothing will stand where it is.
pub fn look(
    storey: &mut Storey,
    name: &str,
    floor: u32,
    eye: (f64, f64, f64),
    target: (f64, f64, f64),
    fov: f64,
) -> (u32, View) {
    storey.eyes.push(at(eye.0, eye.1));
    let lift = HEIGHT * f64::from(floor);
    let view = View {
        name: name.into(),
        eye: v(eye.0, eye.1, eye.2 + lift),
        target: v(target.0, target.1, target.2 + lift),
        fov,
        size: (960, 600),
    };
    (floor, view)
}

/// Parts by name, in the order of their first use.
#[derive(Default)]
struct Parts {
    parts: Vec<Part>,
    index: BTreeMap<String, usize>,
}

impl Parts {
    fn get(&mut self, name: &str, make: impl FnOnce() -> Mesh) -> usize {
        if let Some(&k) = self.index.get(name) {
            return k;
        }
        self.parts.push(Part {
            name: name.to_owned(),
            mesh: make(),
            door: false,
            copies: Vec::new(),
        });
        self.index.insert(name.to_owned(), self.parts.len() - 1);
        self.parts.len() - 1
    }

    fn place(&mut self, part: usize, copy: Placement, z: f64) {
        let mut copy = copy;
        copy.position.z += z;
        self.parts[part].copies.push(copy);
    }

    fn fixed(&mut self, name: &str, z: f64, make: impl FnOnce() -> Mesh) {
        let part = self.get(name, make);
        if self.parts[part].mesh.triangles.is_empty() {
            return;
        }
        self.place(part, Placement::default(), z);
    }
}

/// Builds `floors` storeys of a drawing.
pub fn build(request: &Request, drawing: &Drawing, floors: u32) -> Building {
    let carcass = Carcass::new(&drawing.footprint, &drawing.storeys);
    let mut parts = Parts::default();
    let mut stock = Stock::new(request.seed);
    let mut known: BTreeMap<(usize, u32), Furnishing> = BTreeMap::new();
    let mut rooms: Vec<Room> = Vec::new();
    parts.fixed("base", 0.0, || carcass.base());
    parts.fixed("outside", 0.0, || fittings::outside(&drawing.footprint, &drawing.storeys[0]));
    let top = HEIGHT * f64::from(floors);
    parts.fixed("roof", top, || carcass.roof());
    for floor in 0..floors {
        let t = (floor as usize).min(drawing.storeys.len() - 1);
        let storey = &drawing.storeys[t];
        let z = HEIGHT * f64::from(floor);
        let wells = Wells { below: floor > 0, above: floor + 1 < floors };
        let kind = match (wells.below, wells.above) {
            (false, false) => "only",
            (false, true) => "first",
            (true, true) => "middle",
            (true, false) => "top",
        };
        let tag = format!("{}-{kind}", t + 1);
        parts.fixed(&format!("shell-{tag}"), z, || carcass.storey(storey, wells));
        parts.fixed(&format!("trim-{}", t + 1), z, || fittings::trim(storey));
        if wells.above {
            parts.fixed(&format!("stairs-{}", t + 1), z, || fittings::stairs(storey));
        }
        if wells.below {
            parts.fixed(&format!("guards-{}", t + 1), z, || fittings::guards(storey));
        }
        for gap in &storey.gaps {
            if let Some((name, copy, mesh)) = fittings::leaf(gap) {
                let part = parts.get(&name, || mesh.named("door"));
                parts.parts[part].door = true;
                parts.place(part, copy, z);
            }
        }
        let first = rooms.len();
        for (i, space) in storey.spaces.iter().enumerate() {
            let mut lamp = None;
            if let Some(light) = &space.light {
                let (mut listed, hung) = fittings::lamps(light, space.area());
                listed.z += z;
                for (mesh, copy) in hung {
                    let part = lamp_part(&mut parts, mesh);
                    parts.place(part, Placement { room: Some(first + i), ..copy }, z);
                }
                lamp = Some(listed);
            }
            rooms.push(Room {
                name: format!("floor-{floor}/{}", space.name),
                storey: floor,
                rects: Vec::new(),
                height: (z, z + CEILING),
                shafts: Vec::new(),
                pieces: space.pieces.clone(),
                floor: space.floor,
                walls: [space.walls[0], space.walls[1], space.walls[0], space.walls[0]],
                lamp,
            });
        }
        let variant = floor % drawing.furnishings;
        let list = known.entry((t, variant)).or_insert_with(|| {
            let built = built(&carcass, storey, &parts, t);
            let target = storey.triangles.saturating_sub(built);
            auto::furnish(storey, target, request.seed, &format!("{t}/{variant}"), &mut stock)
        });
        for (mesh, space, copy) in list {
            let (name, m) = &stock.meshes[*mesh];
            let part = match parts.index.get(name) {
                Some(&k) => k,
                None => parts.get(name, || m.clone()),
            };
            parts.place(part, Placement { room: Some(first + *space), ..*copy }, z);
        }
    }
    let views = drawing.views.iter().filter(|(floor, _)| *floor < floors);
    let plan = Plan {
        name: drawing.name,
        footprint: Vec::new(),
        storeys: floors,
        rooms,
        openings: Vec::new(),
        views: views.map(|(_, view)| view.clone()).collect(),
    };
    Building { request: *request, plan, parts: parts.parts }
}

/// The part of a luminaire: the same shape is the same part.
fn lamp_part(parts: &mut Parts, mesh: Mesh) -> usize {
    let same = |p: &Part| p.name.starts_with("lamp-") && p.mesh == mesh;
    if let Some(k) = parts.parts.iter().position(same) {
        return k;
    }
    let count = parts.parts.iter().filter(|p| p.name.starts_with("lamp-")).count();
    parts.get(&format!("lamp-{}", count + 1), || mesh)
}

/// Triangles of a storey without furniture, as between two others.
fn built(carcass: &Carcass<'_>, storey: &Storey, parts: &Parts, t: usize) -> u64 {
    let size =
        |name: String| parts.index.get(&name).map_or(0, |&k| parts.parts[k].mesh.triangles.len());
    let mut sum = carcass.storey(storey, Wells { below: true, above: true }).triangles.len();
    sum += size(format!("trim-{}", t + 1));
    for space in &storey.spaces {
        if let Some(light) = &space.light {
            let (_, all) = fittings::lamps(light, space.area());
            sum += all.iter().map(|(mesh, _)| mesh.triangles.len()).sum::<usize>();
        }
    }
    let leaves = storey.gaps.iter().filter_map(fittings::leaf);
    (sum + leaves.map(|(_, _, mesh)| mesh.triangles.len()).sum::<usize>()) as u64
}
