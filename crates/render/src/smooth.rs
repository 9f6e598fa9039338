//! Gathered light, averaged over the neighbouring pixels of a surface.
//!
//! Irradiance from other surfaces changes slowly, and the slower the farther away these are: over a distance `x` by about
//! `x / R`, where `R` is the harmonic mean of the distances to what is around (Ward, Rubinstein and Clear 1988, "A Ray
//! Tracing Solution for Diffuse Interreflection", the split-sphere model). Gather rays measure `R`. So a pixel
//! takes the mean over neighbours that see the same plane, within a share of `R`: wide on an open wall, three pixels
//! in a corner. (A pixel that sees an edge takes the mean over those near it that see a like mixture: those beside the edge are
//! darker or brighter than the mixture, and light would be lost.) What is averaged is what arrives; the pixel's own albedo reflects it, textures stay sharp. Direct light and caustics are
//! left alone.
//!
//! Bands wait for their neighbours, so that no edge shows: the same pixels whatever the budget, threads and tiles.

use std::ops::Range;

use enf_image::Gathered;
use enf_layout::film::PixelRecord;
use glam::Vec3;

use crate::shade::Context;
use crate::{BAND_PIXELS, RenderArgs};

/// Pixels to each side that are looked at.
const REACH: u32 = 8;
/// Pixels over which it is averaged in corners as well.
const LEAST: u32 = 3;
/// Pixels to each side over which the distance to what is around is averaged.
const NEAR_REACH: u32 = 2;
/// Surroundings are as near up to this ratio ...
const ALIKE_NEAR: f32 = 1.2;
/// ... and then a pixel counts so many times as far.
const ALONG: f32 = 4.0;
/// Least cosine between the normals of pixels that see one surface.
const SAME_NORMAL: f32 = 0.97;
/// Mixtures are alike if their mean normals and albedos, as one vector, differ by less.
const SAME_MIXTURE: f32 = 0.12;
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

/// Bytes that smoothing takes where bands have so many pixels and pictures this width: two bands, edges of others, and
/// what is made of them.
pub(crate) fn bytes(band_pixels: u32, width: u32) -> u64 {
    let (band, margin) = (u64::from(band_pixels), margin(width) as u64);
    let about = band + 2 * margin;
    let held = (size_of::<PixelRecord>() + size_of::<Gathered>()) as u64;
    let made = (size_of::<Seen>() + size_of::<f32>()) as u64;
    held * (2 * band + about) + made * about + size_of::<PixelRecord>() as u64 * band
}

/// Pixels beyond a band's edge that matter to it, at most.
fn margin(width: u32) -> usize {
    (width as usize * (REACH + NEAR_REACH) as usize).min(BAND_PIXELS as usize)
}

/// A band as it was exposed.
pub(crate) struct Exposed {
    pub(crate) band: u32,
    /// Whether it is still to be written.
    pub(crate) write: bool,
    pub(crate) records: Vec<PixelRecord>,
    pub(crate) gathered: Vec<Gathered>,
}

/// The bands about the one that is smoothed next.
pub(crate) struct Window {
    /// See [`margin`].
    margin: usize,
    /// The last pixels of the band before.
    before: (Vec<PixelRecord>, Vec<Gathered>),
    current: Option<Exposed>,
    next: Option<Exposed>,
}

impl Window {
    /// An empty window for pictures of this width at most.
    pub(crate) fn new(width: u32) -> Self {
        Self { margin: margin(width), before: Default::default(), current: None, next: None }
    }

    /// Takes in the next band; whether one can be smoothed now.
    pub(crate) fn push(&mut self, exposed: Exposed) -> Option<()> {
        if self.current.is_none() {
            self.current = Some(exposed);
            return None;
        }
        self.next = Some(exposed);
        Some(())
    }

    /// A band between those before and after it, as far as there are any, ready to be smoothed; moves on. `None` where there is no
    /// band, or it was written before.
    pub(crate) fn take(&mut self, args: &RenderArgs) -> Option<Smoothing> {
        let current = self.current.take()?;
        let after = self.next.as_ref().map_or(0, |next| next.records.len().min(self.margin));
        let smoothed = current.write.then(|| {
            let mut records = std::mem::take(&mut self.before.0);
            let mut gathered = std::mem::take(&mut self.before.1);
            let first = records.len();
            records.extend_from_slice(&current.records);
            gathered.extend_from_slice(&current.gathered);
            let end = records.len();
            if let Some(next) = &self.next {
                records.extend_from_slice(&next.records[..after]);
                gathered.extend_from_slice(&next.gathered[..after]);
            }
            let first_pixel = current.band * BAND_PIXELS - first as u32;
            let share = args.gather_smoothing;
            Smoothing {
                band: current.band,
                first_pixel,
                records,
                gathered,
                range: first..end,
                share,
            }
        });
        let from = current.records.len().saturating_sub(self.margin);
        self.before = (current.records[from..].to_vec(), current.gathered[from..].to_vec());
        self.current = self.next.take();
        smoothed
    }
}

/// A band that can be smoothed, with what lies about it: work for any thread.
pub(crate) struct Smoothing {
    band: u32,
    first_pixel: u32,
    records: Vec<PixelRecord>,
    gathered: Vec<Gathered>,
    range: Range<usize>,
    share: f32,
}

impl Smoothing {
    /// The band, smoothed.
    pub(crate) fn run(self, context: &Context<'_>) -> (u32, Vec<PixelRecord>) {
        let Self { band, first_pixel, records, gathered, range, share } = self;
        (band, smooth(context, first_pixel, &records, &gathered, range, share))
    }
}

/// The pixels of `range`, with what gather rays have added averaged; the others of `records` lie about them.
fn smooth(
    context: &Context<'_>,
    first_pixel: u32,
    records: &[PixelRecord],
    gathered: &[Gathered],
    range: Range<usize>,
    share: f32,
) -> Vec<PixelRecord> {
    let count = records.len();
    let seen: Vec<Seen> = records
        .iter()
        .enumerate()
        .map(|(pixel, record)| {
            let (view, local) = context.pixel(first_pixel + pixel as u32);
            let (origin, direction) = view.camera.ray(local, 0.5, 0.5);
            let normal = Vec3::from(record.normal);
            let flat = normal.length() > FLAT && record.depth > 0.0;
            let gathered = gathered[pixel];
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
            context.neighbours(first_pixel, count, pixel, NEAR_REACH, |other, _| {
                if alike(&seen[pixel], &seen[other]) {
                    sum += seen[other].nearness;
                    weight += 1.0;
                }
            });
            if weight > 0.0 { sum / weight } else { f32::INFINITY }
        })
        .collect();
    let smoothed = |pixel: usize| {
        let mut record = records[pixel];
        let own = &seen[pixel];
        let flat = own.normal != Vec3::ZERO;
        let albedo = Vec3::from(record.albedo);
        let reach = share / near[pixel].max(1e-6);
        let (mut sum, mut weights) = (Vec3::ZERO, Vec3::ZERO);
        let pixels = if flat { REACH } else { LEAST };
        context.neighbours(first_pixel, count, pixel, pixels, |other, squares| {
            let there = &seen[other];
            // Along a corner, where the surroundings stay as near, light changes less than across.
            let alike_near =
                near[pixel] < ALIKE_NEAR * near[other] && near[other] < ALIKE_NEAR * near[pixel];
            let reach = if alike_near { ALONG * reach } else { reach };
            let weight = 1.0 - (own.position - there.position).length() / reach;
            let window = |pixels: u32| 1.0 - squares as f32 / ((pixels + 1) * (pixels + 1)) as f32;
            // A round window, so that the reach's end is no edge; and some pixels always, for a picture shows no less.
            let weight = weight.min(window(REACH)).max(window(LEAST));
            let weight = match flat {
                true if alike(own, there) => weight,
                false if there.normal == Vec3::ZERO => {
                    let normal = Vec3::from(records[other].normal) - Vec3::from(record.normal);
                    let albedo = Vec3::from(records[other].albedo) - albedo;
                    let differ2 = normal.length_squared() + albedo.length_squared();
                    let alike = 1.0 - differ2 / (SAME_MIXTURE * SAME_MIXTURE);
                    window(LEAST).max(0.0) * alike
                }
                _ if other == pixel => weight,
                _ => 0.0,
            };
            if weight > 0.0 {
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
        record.indirect = (Vec3::from(record.indirect) + change).max(Vec3::ZERO).to_array();
        record
    };
    range.map(smoothed).collect()
}
