//! Photons of a furnished room: walks of light from a ceiling lamp, reflected diffusely, among some ninety boxes; or those
//! of a store.

use std::path::Path;

use enf_layout::octahedral;
use enf_layout::photon::PhotonRecord;
use enf_layout::segment::{ExtentKind, StageKind};
use enf_store::{MemoryBudget, StageReader, StoreDir, StoreError};
use glam::Vec3;

/// A small generator (splitmix64); the bench needs no better one.
pub struct Random(pub u64);

impl Random {
    /// Uniform in [0, 1).
    pub fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 40) as f32 / 16_777_216.0
    }
}

/// Inner size of the room, m.
const ROOM: Vec3 = Vec3::new(8.0, 6.0, 3.0);

/// Boxes that stand about: tables and chairs of a top and four legs, shelves with books, lockers.
fn furniture() -> Vec<[Vec3; 2]> {
    let mut r = Random(7);
    let mut boxes = Vec::new();
    let mut put = |low: Vec3, size: Vec3| boxes.push([low, low + size]);
    for (i, top) in [0.75, 0.75, 0.45, 0.45, 0.45, 0.45, 0.45, 0.45].into_iter().enumerate() {
        let size = if top > 0.5 { Vec3::new(1.6, 0.8, 0.04) } else { Vec3::new(0.45, 0.45, 0.04) };
        let at = Vec3::new(0.5 + 0.9 * i as f32, 1.0 + r.next() * 2.0, 0.0);
        put(at + Vec3::Z * top, size);
        for corner in 0..4 {
            let x = if corner & 1 == 0 { 0.02 } else { size.x - 0.07 };
            let y = if corner & 2 == 0 { 0.02 } else { size.y - 0.07 };
            put(at + Vec3::new(x, y, 0.0), Vec3::new(0.05, 0.05, top - 0.001));
        }
    }
    for shelf in 0..5 {
        let z = 0.3 + 0.4 * shelf as f32;
        put(Vec3::new(5.0, 5.6, z), Vec3::new(2.0, 0.35, 0.02));
        for book in 0..7 {
            let x = 5.02 + 0.27 * book as f32;
            let size = Vec3::new(0.03 + 0.2 * r.next(), 0.22, 0.15 + 0.15 * r.next());
            put(Vec3::new(x, 5.65, z + 0.021), size);
        }
    }
    put(Vec3::new(0.01, 4.0, 0.0), Vec3::new(0.6, 1.9, 2.1));
    put(Vec3::new(3.0, 5.2, 0.0), Vec3::new(1.0, 0.7, 0.9));
    boxes
}

/// Where a ray meets the room or a box: the point, and the normal against the ray.
fn hit(boxes: &[[Vec3; 2]], from: Vec3, along: Vec3) -> (Vec3, Vec3) {
    let inverse = along.recip();
    let slabs = |low: Vec3, high: Vec3| {
        let (a, b) = ((low - from) * inverse, (high - from) * inverse);
        (a.min(b), a.max(b))
    };
    let (_, leave) = slabs(Vec3::ZERO, ROOM);
    let mut t = leave.min_element();
    let mut axis = (0..3).find(|&a| leave[a] == t).unwrap_or(2);
    for [low, high] in boxes {
        let (enter, leave) = slabs(*low, *high);
        let first = enter.max_element();
        if first > 1e-4 && first < leave.min_element() && first < t {
            t = first;
            axis = (0..3).find(|&a| enter[a] == t).unwrap_or(2);
        }
    }
    let mut normal = Vec3::ZERO;
    normal[axis] = if along[axis] > 0.0 { -1.0 } else { 1.0 };
    (from + along * t, normal)
}

/// The cosine-weighted hemisphere about a normal along an axis.
fn diffuse(normal: Vec3, r: &mut Random) -> Vec3 {
    // A point on the sphere about the tip of the normal.
    loop {
        let p = Vec3::new(r.next(), r.next(), r.next()) * 2.0 - 1.0;
        let length = p.length();
        if length > 0.1 && length < 1.0 {
            let way = normal + p / length;
            if way.length_squared() > 1e-4 {
                return way.normalize();
            }
        }
    }
}

/// The first `n` impacts of walks of a generator.
pub fn impacts(n: usize, seed: u64) -> Vec<PhotonRecord> {
    let boxes = furniture();
    let mut r = Random(seed);
    let mut out = Vec::with_capacity(n);
    while out.len() < n {
        let lamp = Vec3::new(3.7 + 0.6 * r.next(), 2.7 + 0.6 * r.next(), 2.98);
        let (mut at, mut normal) = (lamp, -Vec3::Z);
        loop {
            let along = diffuse(normal, &mut r);
            (at, normal) = hit(&boxes, at, along);
            let code = |v: Vec3| octahedral::encode(v.to_array());
            out.push(PhotonRecord {
                position_bits: at.to_array().map(f32::to_bits),
                flux: [200, 180, 150, 120],
                directions: PhotonRecord::pack_directions(code(along), code(normal)),
                flags: 0,
            });
            if out.len() == n || r.next() > 0.7354 {
                break;
            }
            at += normal * 1e-4;
        }
    }
    out
}

/// All impacts in one room of a store that `enf-trace` has finished, as they were stored.
pub fn of_store(store: &Path, room: u32) -> Result<Vec<PhotonRecord>, StoreError> {
    let budget = MemoryBudget::new(u64::MAX >> 1);
    let reader = StageReader::open(&StoreDir::open(store)?, StageKind::Trace)?;
    let mut out = Vec::new();
    for extent in reader.find(ExtentKind::Photons, room) {
        let block = reader.read(extent, &budget, "photons")?;
        out.extend_from_slice(block.as_slice_of::<PhotonRecord>()?);
    }
    Ok(out)
}

/// Order along a curve through 1024 cells a side.
pub fn sorted(queries: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let mut list = queries.to_vec();
    let low = list.iter().fold(Vec3::INFINITY, |m, &q| m.min(Vec3::from(q)));
    let high = list.iter().fold(Vec3::NEG_INFINITY, |m, &q| m.max(Vec3::from(q)));
    let scale = 1023.0 / (high - low).max_element().max(1e-9);
    list.sort_by_cached_key(|&q| {
        let cell = (Vec3::from(q) - low) * scale;
        let spread = |v: f32| (0..10).fold(0u32, |n, bit| n | (v as u32 >> bit & 1) << (3 * bit));
        spread(cell.x) | spread(cell.y) << 1 | spread(cell.z) << 2
    });
    list
}
