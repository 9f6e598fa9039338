//! Lights: emitting triangles gathered by object and material, and points.

use crate::{Lights, Material, SceneError, stream::area_vector};
use enf_layout::light::{EmitterRecord, LIGHT_AREA, LightRecord};
use glam::DVec3;
use std::{
    collections::{BTreeMap, HashSet},
    f64::consts::PI,
    path::Path,
};
use zerocopy::IntoBytes;

/// Lights whose areas differ by less than this share one material (rounding of turned instances).
const SAME_AREA: f64 = 1e-4;

/// One emitting triangle on its way into a light.
pub(crate) struct Emitting {
    pub(crate) object: u32,
    pub(crate) material: u32,
    pub(crate) index: u32,
    pub(crate) corners: [[f32; 3]; 3],
}

/// Area of a triangle, m².
pub(crate) fn area(corners: &[[f32; 3]; 3]) -> f64 {
    0.5 * area_vector(corners).length()
}

/// What tells faces apart: a hash of the corners, the same whichever corner is the first.
pub(crate) fn face_key(corners: &[[f32; 3]; 3]) -> u128 {
    let mut bits = corners.map(|p| p.map(f32::to_bits));
    let least = (0..3).min_by_key(|&i| bits[i]).unwrap_or(0);
    bits.rotate_left(least);
    xxhash_rust::xxh3::xxh3_128(bits.as_bytes())
}

/// Gathers area lights: ascending by object, then material; emitters by triangle. Of faces that are there
/// twice, the first emits.
pub(crate) fn gather(
    mut found: Vec<Emitting>,
    materials: &[Material],
    name: impl Fn(u32) -> String,
) -> Lights {
    found.sort_by_key(|e| (e.object, e.material, e.index));
    let mut lights = Lights::default();
    let mut faces = HashSet::new();
    found.retain(|e| faces.insert((e.object, e.material, face_key(&e.corners))));
    drop(faces);
    for group in found.chunk_by(|a, b| (a.object, a.material) == (b.object, b.material)) {
        let (object, material) = (group[0].object, group[0].material);
        let first_emitter = lights.emitters.len() as u32;
        let mut axis = DVec3::ZERO;
        let (mut lo, mut hi) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let mut total = 0.0;
        for e in group {
            total += area(&e.corners);
            axis += area_vector(&e.corners) * 0.5;
            for p in e.corners {
                let p = DVec3::from_array(p.map(f64::from));
                (lo, hi) = (lo.min(p), hi.max(p));
            }
        }
        let mut sum = 0.0;
        for (i, e) in group.iter().enumerate() {
            sum += area(&e.corners);
            let cumulative = if i + 1 == group.len() { 1.0 } else { (sum / total) as f32 };
            lights.emitters.push(EmitterRecord {
                corners: e.corners,
                triangle: e.index,
                cumulative,
                reserved: 0,
            });
        }
        let emission = materials[material as usize].record.emission;
        let centre = ((lo + hi) * 0.5).to_array().map(|v| v as f32);
        let about = DVec3::from_array(centre.map(f64::from));
        let radius = ((hi - about).max(about - lo)).length() as f32;
        let cancels = axis.length() <= 1e-6 * total;
        lights.records.push(LightRecord {
            kind: LIGHT_AREA,
            material,
            first_emitter,
            emitter_count: group.len() as u32,
            flux_w: emission.map(|le| (PI * total * f64::from(le)) as f32),
            area_m2: total as f32,
            position: centre,
            radius: radius.next_up(),
            axis: if cancels {
                [0.0; 3]
            } else {
                (axis / axis.length()).to_array().map(|v| v as f32)
            },
            ..LightRecord::DARK
        });
        lights.names.push(format!("{} {}", name(object), materials[material as usize].name));
    }
    lights
}

/// A point light's record.
pub(crate) fn point(kind: u32, position: [f32; 3], axis: [f32; 3], flux: [f64; 3]) -> LightRecord {
    LightRecord { kind, flux_w: flux.map(|v| v as f32), position, axis, ..LightRecord::DARK }
}

/// Sets the radiance of materials that are given by the flux of each light. Lights of one material
/// whose areas differ get copies of it; returns which (object, material) has which copy.
pub(crate) fn set_power(
    materials: &mut Vec<Material>,
    power: &[Option<[f64; 3]>],
    areas: &BTreeMap<(u32, u32), f64>,
    file: &Path,
) -> Result<BTreeMap<(u32, u32), u32>, SceneError> {
    let mut by_material: BTreeMap<u32, Vec<(f64, u32)>> = BTreeMap::new();
    for (&(object, material), &area) in areas {
        if power[material as usize].is_some() && area > 0.0 {
            by_material.entry(material).or_default().push((area, object));
        }
    }
    let mut copies = BTreeMap::new();
    for (material, mut lights) in by_material {
        let Some(flux) = power[material as usize] else { continue };
        lights.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut groups: Vec<&[(f64, u32)]> = Vec::new();
        let mut rest = &lights[..];
        while let Some(&(least, _)) = rest.first() {
            let n = rest.partition_point(|l| l.0 <= least * (1.0 + SAME_AREA));
            let (group, after) = rest.split_at(n);
            groups.push(group);
            rest = after;
        }
        // The most common area keeps the material itself; of equals, the smallest.
        let most = groups.iter().map(|g| g.len()).max().unwrap_or(0);
        let keeps = groups.iter().position(|g| g.len() == most);
        for (i, group) in groups.iter().enumerate() {
            let area = group.iter().map(|l| l.0).sum::<f64>() / group.len() as f64;
            let emission = flux.map(|w| (w / (PI * area)) as f32);
            if emission.iter().any(|&v| v > 1e25) {
                return Err(SceneError::whole(
                    file,
                    format!(
                        "material \"{}\" is to give its whole flux from {area:.3e} m²",
                        materials[material as usize].name
                    ),
                    "check the size of that light",
                ));
            }
            let id = if Some(i) == keeps {
                material
            } else {
                let mut copy = materials[material as usize].clone();
                copy.name = format!("{} {area:.6} m2", copy.name);
                materials.push(copy);
                let id = materials.len() as u32 - 1;
                copies.extend(group.iter().map(|l| ((l.1, material), id)));
                id
            };
            materials[id as usize].record.emission = emission;
        }
    }
    Ok(copies)
}
