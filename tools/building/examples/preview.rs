//! Looks at a building before any of it is simulated: a small path tracer for its views, and
//! floor plans seen from the ceiling.
//!
//! `cargo run --release -p enf-building --example preview -- FOLDER [KIND [SAMPLES [NAME...]]]`
//! where NAME is a view, `plan-0`, `plan-1` or `eye:X,Y,Z,X,Y,Z,FOV`. Of a tower, one floor.

use enf_building::palette::{self, Kind as Paint, PANEL};
use enf_building::plan::View;
use enf_building::rng::Rng;
use enf_building::{Building, Kind, Request, design};
use glam::{DVec3, Vec2, Vec3};
use std::error::Error;
use std::path::Path;

/// What the panels are made of.
static LIT: Paint = Paint::Matt([0.78; 3]);

struct Triangle {
    a: Vec3,
    e1: Vec3,
    e2: Vec3,
    n: Vec3,
    paint: &'static Paint,
    glow: Vec3,
}

struct Node {
    low: Vec3,
    high: Vec3,
    /// First child, or first triangle of a leaf.
    first: u32,
    count: u32,
}

struct World {
    plan: enf_building::plan::Plan,
    /// Emitting triangles of each room.
    own: Vec<Vec<u32>>,
    triangles: Vec<Triangle>,
    nodes: Vec<Node>,
    lights: Vec<u32>,
    /// The room of each emitting triangle.
    home: std::collections::BTreeMap<u32, Option<usize>>,
}

impl World {
    fn new(b: &Building) -> Self {
        let mut triangles = Vec::new();
        let mut index = 0;
        let mut last = (0, 0);
        b.for_each_triangle(|p, c, corners| {
            if (p, c) != last {
                (last, index) = ((p, c), 0);
            }
            let t = b.parts[p].mesh.triangles[index];
            index += 1;
            let [a, q, r] = corners.map(DVec3::as_vec3);
            let (e1, e2) = (q - a, r - a);
            let mut glow = Vec3::ZERO;
            let copy = &b.parts[p].copies[c];
            if t.paint == PANEL
                && let Some(lamp) = copy.room.and_then(|r| b.plan.rooms[r].lamp.as_ref())
            {
                let area: f64 = (0..b.parts[p].mesh.triangles.len())
                    .filter(|&i| b.parts[p].mesh.triangles[i].paint == PANEL)
                    .map(|i| {
                        let [a, q, r] = b.parts[p].mesh.corners(i);
                        (q - a).cross(r - a).length() / 2.0
                    })
                    .sum();
                let c = lamp.colour;
                let y = 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2];
                let scale = lamp.lumens / (std::f64::consts::PI * area * y);
                glow = Vec3::new(c[0] as f32, c[1] as f32, c[2] as f32) * scale as f32;
            }
            let known = palette::all().find(|(name, _)| *name == t.paint);
            let paint = known.map_or(&LIT, |(_, kind)| kind);
            triangles.push(Triangle {
                a,
                e1,
                e2,
                n: e1.cross(e2).normalize_or_zero(),
                paint,
                glow,
            });
        });
        let mut world = Self {
            plan: b.plan.clone(),
            own: Vec::new(),
            triangles,
            nodes: Vec::new(),
            lights: Vec::new(),
            home: std::collections::BTreeMap::new(),
        };
        world.build();
        world.lights = (0..world.triangles.len() as u32)
            .filter(|&i| world.triangles[i as usize].glow != Vec3::ZERO)
            .collect();
        world.own = vec![Vec::new(); world.plan.rooms.len()];
        for &i in &world.lights {
            let t = &world.triangles[i as usize];
            let room = world.plan.room_at(t.a.as_dvec3());
            world.home.insert(i, room);
            if let Some(room) = room {
                world.own[room].push(i);
            }
        }
        world
    }

    fn build(&mut self) {
        let mut order: Vec<u32> = (0..self.triangles.len() as u32).collect();
        let mid: Vec<Vec3> = self.triangles.iter().map(|t| t.a + (t.e1 + t.e2) / 3.0).collect();
        let mut nodes = vec![];
        let mut stack = vec![(0usize, order.len(), usize::MAX)];
        nodes.push(Node { low: Vec3::ZERO, high: Vec3::ZERO, first: 0, count: 0 });
        stack[0].2 = 0;
        while let Some((from, to, node)) = stack.pop() {
            let (mut low, mut high) = (Vec3::splat(f32::MAX), Vec3::splat(f32::MIN));
            let (mut clow, mut chigh) = (low, high);
            for &i in &order[from..to] {
                let t = &self.triangles[i as usize];
                for p in [t.a, t.a + t.e1, t.a + t.e2] {
                    (low, high) = (low.min(p), high.max(p));
                }
                (clow, chigh) = (clow.min(mid[i as usize]), chigh.max(mid[i as usize]));
            }
            nodes[node].low = low - 1e-4;
            nodes[node].high = high + 1e-4;
            let size = chigh - clow;
            let axis = (0..3).max_by(|&a, &b| size[a].total_cmp(&size[b])).unwrap_or(0);
            if to - from <= 4 || size[axis] < 1e-6 {
                (nodes[node].first, nodes[node].count) = (from as u32, (to - from) as u32);
                continue;
            }
            // The middle in space, or of the list when that leaves a side empty.
            let plane = (clow[axis] + chigh[axis]) / 2.0;
            let mut split = from;
            for k in from..to {
                if mid[order[k] as usize][axis] < plane {
                    order.swap(k, split);
                    split += 1;
                }
            }
            if split == from || split == to {
                order[from..to]
                    .sort_by(|&a, &b| mid[a as usize][axis].total_cmp(&mid[b as usize][axis]));
                split = from.midpoint(to);
            }
            let first = nodes.len();
            nodes[node].first = first as u32;
            for _ in 0..2 {
                nodes.push(Node { low, high, first: 0, count: 0 });
            }
            stack.push((from, split, first));
            stack.push((split, to, first + 1));
        }
        let mut old: Vec<Option<Triangle>> = self.triangles.drain(..).map(Some).collect();
        self.triangles = order.iter().filter_map(|&i| old[i as usize].take()).collect();
        self.nodes = nodes;
    }

    /// Nearest triangle and distance; panes are passed unless `panes`.
    fn hit(&self, o: Vec3, d: Vec3, mut far: f32) -> Option<(f32, usize)> {
        let inv = d.recip();
        let enter = |i: u32, far: f32| {
            let node = &self.nodes[i as usize];
            let (t0, t1) = ((node.low - o) * inv, (node.high - o) * inv);
            let (a, b) = (t0.min(t1).max_element(), t0.max(t1).min_element());
            (a <= b.min(far) && b >= 0.0).then_some(a)
        };
        let mut stack = [(0u32, 0f32); 96];
        let mut top = 1;
        let mut best = None;
        while top > 0 {
            top -= 1;
            let (index, from) = stack[top];
            if from > far {
                continue;
            }
            let node = &self.nodes[index as usize];
            if node.count == 0 {
                let (a, b) = (node.first, node.first + 1);
                let (mut first, mut second) =
                    (enter(a, far).map(|t| (a, t)), enter(b, far).map(|t| (b, t)));
                if let (Some(x), Some(y)) = (first, second)
                    && x.1 < y.1
                {
                    (first, second) = (second, first);
                }
                for child in [first, second].into_iter().flatten() {
                    stack[top] = child;
                    top += 1;
                }
                continue;
            }
            for i in node.first as usize..(node.first + node.count) as usize {
                let t = &self.triangles[i];
                let p = d.cross(t.e2);
                let det = t.e1.dot(p);
                if det.abs() < 1e-12 {
                    continue;
                }
                let s = o - t.a;
                let u = s.dot(p) / det;
                let q = s.cross(t.e1);
                let w = d.dot(q) / det;
                let dist = t.e2.dot(q) / det;
                if u >= 0.0 && w >= 0.0 && u + w <= 1.0 && dist > 1e-4 && dist < far {
                    far = dist;
                    best = Some((dist, i));
                }
            }
        }
        best
    }

    fn shade(&self, mut o: Vec3, mut d: Vec3, rng: &mut Rng) -> Vec3 {
        let mut weight = Vec3::ONE;
        let mut sum = Vec3::ZERO;
        let mut seen = true;
        let mut bounce = 0;
        for _ in 0..12 {
            let Some((dist, i)) = self.hit(o, d, 1e9) else { break };
            let t = &self.triangles[i];
            let p = o + d * dist;
            let n = if t.n.dot(d) < 0.0 { t.n } else { -t.n };
            if t.glow != Vec3::ZERO && t.n.dot(d) < 0.0 {
                if seen {
                    sum += weight * t.glow;
                }
                break;
            }
            match t.paint {
                Paint::Glass(tf, _) => {
                    let mirror = 0.06 + 0.6 * (1.0 - d.dot(n).abs()).powi(5);
                    if (rng.unit() as f32) < mirror {
                        d -= n * (2.0 * d.dot(n));
                        o = p + n * 1e-4;
                    } else {
                        weight *= Vec3::new(tf[0] as f32, tf[1] as f32, tf[2] as f32);
                        o = p + d * 1e-4;
                    }
                }
                Paint::Mirror(r) => {
                    weight *= Vec3::new(r[0] as f32, r[1] as f32, r[2] as f32);
                    d -= n * (2.0 * d.dot(n));
                    o = p + n * 1e-4;
                }
                Paint::Matt(kd) | Paint::Gloss(kd, _) => {
                    weight *= Vec3::new(kd[0] as f32, kd[1] as f32, kd[2] as f32);
                    sum += weight * self.direct(p + n * 2e-4, n, rng);
                    bounce += 1;
                    if bounce > 3 {
                        break;
                    }
                    let (a, r) =
                        (std::f32::consts::TAU * rng.unit() as f32, (rng.unit() as f32).sqrt());
                    let x = n.any_orthonormal_vector();
                    let z = (1.0 - r * r).max(0.0).sqrt();
                    d = x * (r * a.cos()) + n.cross(x) * (r * a.sin()) + n * z;
                    o = p + n * 2e-4;
                    seen = false;
                }
            }
        }
        sum
    }

    /// Irradiance / pi from the lamps: one sample, chosen by distance among a few.
    fn direct(&self, p: Vec3, n: Vec3, rng: &mut Rng) -> Vec3 {
        let (mut chosen, mut total) = (None, 0.0);
        let empty = Vec::new();
        let room = self.plan.room_at(p.as_dvec3());
        let own = room.map_or(&empty, |r| &self.own[r]);
        for k in 0..16 {
            // Half from the room itself, half from the whole building.
            let list = if k % 2 == 0 && !own.is_empty() { own } else { &self.lights };
            let i = list[rng.below(list.len())] as usize;
            let t = &self.triangles[i];
            let (mut u, mut w) = (rng.unit() as f32, rng.unit() as f32);
            if u + w > 1.0 {
                (u, w) = (1.0 - u, 1.0 - w);
            }
            let to = t.a + t.e1 * u + t.e2 * w - p;
            let r2 = to.length_squared();
            let d = to / r2.sqrt();
            let g = n.dot(d).max(0.0) * (-t.n.dot(d)).max(0.0) / r2.max(0.01);
            let here = self.home.get(&(i as u32)) == Some(&room) && !own.is_empty();
            let all = 1.0 / self.lights.len() as f32;
            let density = match (own.is_empty(), here) {
                (true, _) => all,
                (false, true) => 0.5 * all + 0.5 / own.len() as f32,
                (false, false) => 0.5 * all,
            };
            let value = t.glow * (g * t.e1.cross(t.e2).length() / 2.0 / density);
            let y = value.element_sum();
            if y > 0.0 {
                total += y;
                if (rng.unit() as f32) < y / total {
                    chosen = Some((d, r2.sqrt(), value / y));
                }
            }
        }
        let Some((d, dist, colour)) = chosen else { return Vec3::ZERO };
        let mut o = p;
        let mut left = dist - 2e-3;
        let mut through = Vec3::ONE;
        while let Some((t, i)) = self.hit(o, d, left) {
            match self.triangles[i].paint {
                Paint::Glass(tf, _) => {
                    through *= Vec3::new(tf[0] as f32, tf[1] as f32, tf[2] as f32);
                    o += d * (t + 1e-4);
                    left -= t + 1e-4;
                }
                _ => return Vec3::ZERO,
            }
        }
        through * colour * (total / 16.0 / std::f32::consts::PI)
    }
}

fn tone(c: Vec3, exposure: f32) -> [u8; 3] {
    (c * exposure).to_array().map(|x| {
        // Hable's curve in short, then the display's.
        let x = x.max(0.0);
        let y = (x * (2.51 * x + 0.03)) / (x * (2.43 * x + 0.59) + 0.14);
        (255.0 * y.clamp(0.0, 1.0).powf(1.0 / 2.2) + 0.5) as u8
    })
}

fn save(path: &Path, w: u32, h: u32, pixels: &[u8]) -> Result<(), Box<dyn Error>> {
    let mut e = png::Encoder::new(std::io::BufWriter::new(std::fs::File::create(path)?), w, h);
    e.set_color(png::ColorType::Rgb);
    e.set_depth(png::BitDepth::Eight);
    e.write_header()?.write_image_data(pixels)?;
    println!("{}", path.display());
    Ok(())
}

fn render(
    world: &World,
    (w, h): (u32, u32),
    seed: u64,
    f: impl Fn(&World, u32, u32, &mut Rng) -> Vec3 + Sync,
) -> Vec<Vec3> {
    let mut image = vec![Vec3::ZERO; (w * h) as usize];
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let rows: Vec<_> = image.chunks_mut(w as usize).enumerate().collect();
    let queue = std::sync::Mutex::new(rows.into_iter());
    std::thread::scope(|s| {
        for _ in 0..threads {
            s.spawn(|| {
                while let Some((y, row)) = queue.lock().ok().and_then(|mut q| q.next()) {
                    let mut rng = Rng::new(seed + y as u64, "row");
                    for (x, p) in row.iter_mut().enumerate() {
                        *p = f(world, x as u32, y as u32, &mut rng);
                    }
                }
            });
        }
    });
    image
}

/// The rooms' bounds in plan, a little wider.
fn extent(rooms: &[&enf_building::plan::Room]) -> (Vec2, Vec2) {
    let corners = rooms.iter().flat_map(|r| {
        let own = r.rects.iter().flat_map(|q| [(q.x0, q.y0), (q.x1, q.y1)]);
        own.chain(r.pieces.iter().flat_map(|c| c.0.iter().map(|p| (p.x, p.y)))).collect::<Vec<_>>()
    });
    let (mut low, mut high) = (Vec2::splat(f32::MAX), Vec2::splat(f32::MIN));
    for (x, y) in corners {
        let p = Vec2::new(x as f32, y as f32);
        (low, high) = (low.min(p), high.max(p));
    }
    (low - 0.6, high + 0.6)
}

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let folder = Path::new(args.first().map_or(".", String::as_str)).to_owned();
    let kind: Kind = args.get(1).map_or("l-shape", String::as_str).parse()?;
    let samples: u32 = args.get(2).and_then(|s| s.parse().ok()).unwrap_or(16);
    let floors = (kind == Kind::Tower).then_some(1);
    let b = design(&Request { kind, floors, seed: 1 })?;
    let world = World::new(&b);
    let mut names: Vec<String> = args.iter().skip(3).cloned().collect();
    if names.is_empty() {
        names = b.plan.views.iter().map(|v| v.name.clone()).collect();
        names.extend((0..b.plan.storeys).map(|s| format!("plan-{s}")));
    }
    for (k, name) in names.iter().enumerate() {
        if let Some(storey) = name.strip_prefix("plan-").and_then(|s| s.parse::<u32>().ok()) {
            let here: Vec<_> = b.plan.rooms.iter().filter(|r| r.storey == storey).collect();
            let z = here.iter().map(|r| r.height.0).fold(f64::MAX, f64::min) as f32 + 2.6;
            let (low, high) = extent(&here);
            let scale = (2000.0 / (high - low).max_element()).min(60.0);
            let (w, h) = (((high.x - low.x) * scale) as u32, ((high.y - low.y) * scale) as u32);
            let image = render(&world, (w, h), 1, |world, x, y, _| {
                let o = Vec3::new(low.x + x as f32 / scale, high.y - y as f32 / scale, z);
                let Some((t, i)) = world.hit(o, -Vec3::Z, 1e9) else { return Vec3::ZERO };
                let tri = &world.triangles[i];
                if tri.n.z < 0.0 {
                    return Vec3::splat(0.02);
                }
                let light = 0.35 + 0.65 * tri.n.dot(Vec3::new(0.35, 0.45, 0.82)).max(0.0);
                let c = match tri.paint {
                    Paint::Matt(c) | Paint::Gloss(c, _) => {
                        Vec3::new(c[0] as f32, c[1] as f32, c[2] as f32)
                    }
                    _ => Vec3::new(0.3, 0.6, 0.9),
                };
                c * light * (1.25 - 0.18 * t)
            });
            let pixels: Vec<u8> = image.iter().flat_map(|&c| tone(c, 1.0)).collect();
            save(&folder.join(format!("{name}.png")), w, h, &pixels)?;
            continue;
        }
        let view = match name.strip_prefix("eye:") {
            Some(list) => {
                let n: Vec<f64> = list.split(',').map(str::parse).collect::<Result<_, _>>()?;
                View {
                    name: format!("eye-{k}"),
                    eye: DVec3::new(n[0], n[1], n[2]),
                    target: DVec3::new(n[3], n[4], n[5]),
                    fov: n[6],
                    size: (640, 400),
                }
            }
            None => b.plan.views.iter().find(|v| v.name == *name).ok_or("no such view")?.clone(),
        };
        let (w, h) = if samples < 32 { (view.size.0 / 2, view.size.1 / 2) } else { view.size };
        let ahead = (view.target - view.eye).normalize().as_vec3();
        let right = ahead.cross(Vec3::Z).normalize();
        let up = right.cross(ahead);
        let tan = (view.fov as f32 / 2.0).to_radians().tan();
        let eye = view.eye.as_vec3();
        let image = render(&world, (w, h), 7, |world, x, y, rng| {
            let mut sum = Vec3::ZERO;
            for _ in 0..samples {
                let px = (2.0 * (x as f32 + rng.unit() as f32) / w as f32 - 1.0) * tan * w as f32
                    / h as f32;
                let py = (1.0 - 2.0 * (y as f32 + rng.unit() as f32) / h as f32) * tan;
                let d = (ahead + right * px + up * py).normalize();
                sum += world.shade(eye, d, rng).min(Vec3::splat(4000.0));
            }
            sum / samples as f32
        });
        let mut y: Vec<f32> =
            image.iter().map(|c| c.dot(Vec3::new(0.2126, 0.7152, 0.0722))).collect();
        y.sort_by(f32::total_cmp);
        let exposure = 0.55 / y[y.len() * 7 / 10].max(1e-6);
        let pixels: Vec<u8> = image.iter().flat_map(|&c| tone(c, exposure)).collect();
        save(&folder.join(format!("{}.png", view.name)), w, h, &pixels)?;
    }
    Ok(())
}
