//! Gathered light, averaged over the neighbouring pixels of a surface.
//!
//! Irradiance from other surfaces changes slowly, and the slower the farther away these are: over a distance `x` by about
//! `x / R`, where `R` is the harmonic mean of the distances to what is around (Ward, Rubinstein and Clear 1988, "A Ray
//! Tracing Solution for Diffuse Interreflection", the split-sphere model). Gather rays measure `R`. So a pixel
//! takes the mean over neighbours that see the same plane, within a share of `R`: wide on an open wall, two pixels
//! in a corner. (A pixel that sees an edge takes that of the pixels next to it.) What is averaged is what arrives; the pixel's own albedo reflects it, textures stay sharp. Direct light and caustics are
//! left alone.
//!
//! A band of the picture is smoothed on its own: the same pixels whatever the budget, threads and tiles.

use enf_image::Film;
use enf_layout::film::PixelRecord;
use glam::Vec3;

use crate::shade::Context;

/// Pixels to each side that are looked at.
const REACH: u32 = 8;
/// Pixels over which it is averaged in corners as well.
const LEAST: u32 = 2;
/// Least cosine between the normals of pixels that see one surface.
const SAME_NORMAL: f32 = 0.97;
/// Least length of a mean normal: below, the pixel sees several surfaces.
const FLAT: f32 = 0.98;
/// How far from the plane of one pixel another one may be, of their distance.
const SAME_PLANE: f32 = 0.1;
/// Albedo below this says nothing about what arrives.
const DARK: f32 = 0.01;

/// What a pixel sees.
#[derive(Clone, Copy, Default)]
struct Seen {
    position: Vec3,
    /// Zero where the pixel sees several surfaces, or none.
    normal: Vec3,
    /// What gather rays have added, over the albedo.
    arrives: Vec3,
    nearness: f32,
    room: f32,
}

/// Bytes per pixel that smoothing takes.
pub(crate) const BYTES_PER_PIXEL: usize = size_of::<Seen>() + size_of::<f32>();

/// Averages what gather rays have added to a band.
pub(crate) fn smooth(
    film: &Film,
    context: &Context<'_>,
    first_pixel: u32,
    share: f32,
    records: &mut [PixelRecord],
) {
    let count = records.len();
    let seen: Vec<Seen> = records
        .iter()
        .enumerate()
        .map(|(pixel, record)| {
            let (view, local) = context.pixel(first_pixel + pixel as u32);
            let (origin, direction) = view.camera.ray(local, 0.5, 0.5);
            let normal = Vec3::from(record.normal);
            let flat = normal.length() > FLAT && record.depth > 0.0;
            let gathered = film.gathered(pixel, context.samples);
            let arrives =
                Vec3::from(gathered.radiance) / Vec3::from(record.albedo).max(Vec3::splat(DARK));
            Seen {
                position: origin + direction * record.depth,
                normal: if flat { normal } else { Vec3::ZERO },
                arrives,
                nearness: gathered.nearness,
                room: record.room,
            }
        })
        .collect();
    let alike = |a: &Seen, b: &Seen| {
        let way = b.position - a.position;
        let height = way.dot(a.normal);
        let distance2 = way.length_squared();
        a.room == b.room
            && a.normal.dot(b.normal) > SAME_NORMAL * a.normal.length() * b.normal.length()
            && height * height <= SAME_PLANE * SAME_PLANE * distance2
    };
    // A few rays see a corner or miss it: neighbours together know better.
    let near: Vec<f32> = (0..count)
        .map(|pixel| {
            let (mut sum, mut weight) = (0.0f32, 0.0f32);
            context.neighbours(first_pixel, count, pixel, 2, |other, _| {
                if alike(&seen[pixel], &seen[other]) {
                    sum += seen[other].nearness;
                    weight += 1.0;
                }
            });
            if weight > 0.0 { sum / weight } else { f32::INFINITY }
        })
        .collect();
    for pixel in 0..count {
        let own = &seen[pixel];
        let flat = own.normal != Vec3::ZERO;
        let albedo = Vec3::from(records[pixel].albedo);
        let reach = share / near[pixel].max(1e-6);
        let (mut sum, mut weights) = (Vec3::ZERO, Vec3::ZERO);
        let pixels = if flat { REACH } else { 1 };
        context.neighbours(first_pixel, count, pixel, pixels, |other, squares| {
            let there = &seen[other];
            let weight = 1.0 - (own.position - there.position).length() / reach;
            let window = |pixels: u32| 1.0 - squares as f32 / ((pixels + 1) * (pixels + 1)) as f32;
            // A round window, so that the reach's end is no edge; and some pixels always, for a picture shows no less.
            let weight = weight.min(window(REACH)).max(window(LEAST));
            let alike = if flat { alike(own, there) } else { own.room == there.room };
            if weight > 0.0 && (other == pixel || alike) {
                let reflects = Vec3::from(records[other].albedo);
                let known = Vec3::select(reflects.cmpge(Vec3::splat(DARK)), Vec3::ONE, Vec3::ZERO);
                sum += there.arrives * known * weight;
                weights += known * weight;
            }
        });
        let before = own.arrives;
        let after = Vec3::select(weights.cmpgt(Vec3::ZERO), sum / weights, before);
        let change = albedo * (after - before);
        let known = albedo.cmpge(Vec3::splat(DARK));
        let change = Vec3::select(known, change, Vec3::ZERO);
        let indirect = Vec3::from(records[pixel].indirect) + change;
        records[pixel].indirect = indirect.max(Vec3::ZERO).to_array();
    }
}
