//! Gathered light, averaged over the neighbouring pixels of a surface.
//!
//! Irradiance from other surfaces changes slowly, and the slower the farther away these are: over a distance `x` by about
//! `x / R`, where `R` is the harmonic mean of the distances to what is around (Ward, Rubinstein and Clear 1988, "A Ray
//! Tracing Solution for Diffuse Interreflection", the split-sphere model). Gather rays measure `R`. So a pixel
//! exchanges light with neighbours that see the same plane, within a share of `R`: far on an open wall, three pixels
//! in a corner.
//!
//! **No light is lost.** What pixel `i` gets from `j`, `j` gives: `w y_i y_j (g_i R_j - g_j R_i)`, with radiances `R` as they were
//! gathered, a weight `w` that is the same both ways, and a *guide* `g`, what the radiance is expected to be proportional to. So
//! the sums of light stay, of a room and of the edges between rooms, whatever the weights; and where `R` is `g` times a
//! constant, nothing changes. The factors `y` see to it that a pixel ends with the mean of its neighbours, up to little: a
//! symmetric matrix with even sums of rows (Sinkhorn and Knopp 1967; Milanfar 2013, "Symmetrizing Smoothing Filters"), two
//! steps of their iteration. First the guide is the albedo: what arrives is averaged, textures stay sharp.
//!
//! **Edges** come second. A pixel that sees several surfaces, or little of one, has no like neighbours. Its guide is read off the
//! surfaces about it, smoothed by then: their radiance as a linear function of normal, albedo and depth, at what the pixel has of
//! these (He, Sun and Tang 2010, "Guided Image Filtering"; Bitterli et al. 2016, "Nonlinearly Weighted First-Order Regression").
//! Such pixels exchange with each other, along the edge. Direct light and caustics are left alone.
//!
//! Pixels come band by band and go through the steps row after row, each as soon as the rows about it have made the one before:
//! the same pixels whatever the budget, threads and tiles.

use std::sync::Arc;

use enf_image::Gathered;
use enf_layout::film::PixelRecord;
use glam::Vec3;
use parking_lot::Mutex;

use crate::shade::Context;
use crate::{BAND_PIXELS, RenderArgs};

/// Pixels to each side that are looked at.
const REACH: u32 = 8;
/// Pixels over which it is averaged in corners as well.
const LEAST: u32 = 3;
/// Pixels to each side over which the distance to what is around is averaged.
const NEAR_REACH: u32 = 2;
/// Pixels to each side that an edge's guide is read off.
const GUIDE_REACH: u32 = 3;
/// Pixels to each side that edges exchange with.
const EDGE_REACH: u32 = 4;
/// How many rows each step looks ahead, see [`Step`].
const ROWS: [u32; STEPS] =
    [NEAR_REACH, REACH, REACH, REACH, GUIDE_REACH, EDGE_REACH, EDGE_REACH, EDGE_REACH];
const STEPS: usize = 8;
/// Surroundings are as near up to this ratio ...
const ALIKE_NEAR: f32 = 1.2;
/// ... and then a pixel counts so many times as far.
const ALONG: f32 = 4.0;
/// Least cosine between the normals of pixels that see one surface.
const SAME_NORMAL: f32 = 0.97;
/// Least length of a mean normal: below, the pixel sees several surfaces.
const FLAT: f32 = 0.98;
/// How far from the plane of one pixel another one may be, of their distance.
const SAME_PLANE: f32 = 0.1;
/// A pixel with less of the weights that it would have on an open wall, in the window of [`LEAST`], is an edge.
const FEW: f32 = 0.2;
/// What an edge's guide may be of the least and of the most about it.
const GUIDE_RANGE: [f32; 2] = [0.5, 1.5];
/// Keeps the guide's slopes small where what is about does not say them; of features squared.
const RIDGE: f64 = 1e-3;

/// The steps after a pixel has come in. Each needs those before to be done for all pixels about it.
#[derive(Clone, Copy)]
enum Step {
    /// The distance to what is around, averaged: a few rays see a corner or miss it, neighbours together know better.
    Near,
    /// Which pixels are edges; first factors of surfaces.
    First,
    /// Their second factors.
    Second,
    /// Surfaces exchange.
    Surfaces,
    /// The guide of edges.
    Guide,
    /// First factors of edges.
    FirstEdge,
    /// Their second factors.
    SecondEdge,
    /// Edges exchange; the pixel is done.
    Edges,
}

const ORDER: [Step; STEPS] = [
    Step::Near,
    Step::First,
    Step::Second,
    Step::Surfaces,
    Step::Guide,
    Step::FirstEdge,
    Step::SecondEdge,
    Step::Edges,
];

/// A pixel under way.
#[derive(Clone, Copy, Default)]
struct Cell {
    record: PixelRecord,
    position: Vec3,
    /// Whether it sees one plane, and that is not nothing.
    flat: bool,
    /// Whether it is treated as an edge.
    edge: bool,
    /// One over the distance to what is around, 1/m: as measured, and averaged.
    nearness: f32,
    near: f32,
    /// What gather rays have added, W/m2/sr: at first, and once surfaces are smoothed.
    raw: Vec3,
    smooth: Vec3,
    /// Factors of the exchange: after one step, and after two.
    first: Vec3,
    second: Vec3,
    /// Of edges: what the radiance is expected to be, W/m2/sr, and the factors.
    guide: Vec3,
    first_edge: Vec3,
    second_edge: Vec3,
}

impl Cell {
    fn normal(&self) -> Vec3 {
        Vec3::from(self.record.normal)
    }

    fn albedo(&self) -> Vec3 {
        Vec3::from(self.record.albedo)
    }

    /// Light stays among pixels for which this is the same: the room, or that there are several.
    fn place(&self) -> u32 {
        match self.record.room.is_sign_negative() {
            true => u32::MAX,
            false => self.record.room.to_bits(),
        }
    }

    /// Whether two pixels see the same plane of the same room.
    fn is_alike(&self, other: &Self) -> bool {
        if !(self.flat && other.flat && self.place() == other.place()) {
            return false;
        }
        let (a, b) = (self.normal(), other.normal());
        let way = other.position - self.position;
        let (from, to, most) = (way.dot(a), way.dot(b), SAME_PLANE * SAME_PLANE);
        let square = way.length_squared();
        a.dot(b) > SAME_NORMAL * a.length() * b.length()
            && from * from <= most * square
            && to * to <= most * square
    }

    /// How much two pixels of a surface exchange, `squares` apart in pixels.
    fn weight(&self, other: &Self, squares: u32, share: f32) -> f32 {
        if !self.is_alike(other) {
            return 0.0;
        }
        // Along a corner, where the surroundings stay as near, light changes less than across.
        let (near, far) = (self.near.max(other.near), self.near.min(other.near));
        let along = if near < ALIKE_NEAR * far { ALONG } else { 1.0 };
        let reach = along * share / near.max(1e-6);
        let distance = (other.position - self.position).length();
        // A round window, so that the reach's end is no edge; and some pixels always, for a picture shows no less.
        (1.0 - distance / reach).min(window(squares, REACH)).max(window(squares, LEAST))
    }

    /// How much two edges exchange.
    fn edge_weight(&self, other: &Self, squares: u32) -> f32 {
        match self.edge && other.edge && self.place() == other.place() {
            true => window(squares, EDGE_REACH),
            false => 0.0,
        }
    }
}

/// A weight that ends with so many pixels.
fn window(squares: u32, pixels: u32) -> f32 {
    (1.0 - squares as f32 / ((pixels + 1) * (pixels + 1)) as f32).max(0.0)
}

/// 1 over the square root; 0 of nothing.
fn inverse_root(v: Vec3) -> Vec3 {
    let one = |x: f32| if x > 0.0 { 1.0 / x.sqrt() } else { 0.0 };
    Vec3::new(one(v.x), one(v.y), one(v.z))
}

/// Pixels from one to the place so many rows down, at most.
fn pixels_of(rows: u32, width: u32) -> u64 {
    u64::from(rows) * (u64::from(width) + 1)
}

/// Bytes that smoothing takes where bands have so many pixels and pictures this width: the pixels under way, a band that
/// comes, and those that go.
pub(crate) fn bytes(band_pixels: u32, width: u32) -> u64 {
    let band = u64::from(band_pixels);
    // A picture of a single band has no other rows.
    let about = match band_pixels < BAND_PIXELS {
        true => 0,
        false => pixels_of(ROWS.iter().sum::<u32>() + REACH, width),
    };
    let comes = (size_of::<PixelRecord>() + size_of::<Gathered>()) as u64;
    (band + about) * (size_of::<Cell>() + size_of::<PixelRecord>()) as u64 + band * comes
}

/// Bands before another one that matter to it.
pub(crate) fn bands_before(width: u32) -> u32 {
    pixels_of(ROWS.iter().sum(), width).div_ceil(u64::from(BAND_PIXELS)) as u32
}

/// A band as it was exposed.
pub(crate) struct Exposed {
    pub(crate) band: u32,
    /// Whether it is still to be written.
    pub(crate) write: bool,
    pub(crate) records: Vec<PixelRecord>,
    pub(crate) gathered: Vec<Gathered>,
}

/// A band that is done.
pub(crate) type Smoothed = (u32, Vec<PixelRecord>);

/// The pixels under way. Bands come in order, one at a time.
pub(crate) struct Window(Arc<Mutex<Pixels>>);

impl Window {
    /// An empty window for pictures of this width at most, which end at this pixel.
    pub(crate) fn new(width: u32, end: u32, args: &RenderArgs) -> Self {
        Self(Arc::new(Mutex::new(Pixels {
            width,
            last: end,
            share: args.gather_smoothing,
            first: 0,
            cells: Vec::new(),
            done: [0; STEPS],
            bands: Vec::new(),
            records: Vec::new(),
        })))
    }

    /// The work that comes with the next band.
    pub(crate) fn push(&self, exposed: Exposed) -> Smoothing {
        Smoothing { pixels: Arc::clone(&self.0), exposed }
    }
}

/// A band that comes in: work for any thread.
pub(crate) struct Smoothing {
    pixels: Arc<Mutex<Pixels>>,
    exposed: Exposed,
}

impl Smoothing {
    /// The bands that are done then, and are to be written.
    pub(crate) fn run(self, context: &Context<'_>) -> Vec<Smoothed> {
        let mut pixels = self.pixels.lock();
        pixels.take_in(context, self.exposed);
        pixels.smooth(context)
    }
}

/// See the module. Pixels are counted over all views.
struct Pixels {
    width: u32,
    /// End of the last picture.
    last: u32,
    share: f32,
    /// The pixel of the first cell.
    first: u32,
    cells: Vec<Cell>,
    /// Up to which pixel each step is done.
    done: [u32; STEPS],
    /// Bands that are not done, with their pixels and whether they are written.
    bands: Vec<(u32, u32, bool)>,
    /// Pixels of the first of them that are done.
    records: Vec<PixelRecord>,
}

impl Pixels {
    fn end(&self) -> u32 {
        self.first + self.cells.len() as u32
    }

    fn take_in(&mut self, context: &Context<'_>, exposed: Exposed) {
        let begin = exposed.band * BAND_PIXELS;
        if self.cells.is_empty() {
            self.first = begin;
            self.done = [begin; STEPS];
        }
        self.bands.push((exposed.band, exposed.records.len() as u32, exposed.write));
        // No more than was reserved: growing by doubling would take more.
        self.cells.reserve_exact(exposed.records.len());
        let pixels = exposed.records.into_iter().zip(exposed.gathered);
        self.cells.extend((begin..).zip(pixels).map(|(pixel, (record, gathered))| {
            let (view, local) = context.pixel(pixel);
            let (origin, direction) = view.camera.ray(local, 0.5, 0.5);
            let raw = Vec3::from(gathered.radiance);
            Cell {
                record,
                position: origin + direction * record.depth,
                flat: Vec3::from(record.normal).length() > FLAT && record.depth > 0.0,
                nearness: gathered.nearness,
                raw,
                smooth: raw,
                ..Cell::default()
            }
        }));
    }

    /// Takes each step as far as the one before allows; the bands that are done.
    fn smooth(&mut self, context: &Context<'_>) -> Vec<Smoothed> {
        let mut before = self.end();
        for (step, (kind, rows)) in ORDER.into_iter().zip(ROWS).enumerate() {
            let ahead = if before == self.last { 0 } else { pixels_of(rows, self.width) };
            let until = u64::from(before).saturating_sub(ahead) as u32;
            for pixel in self.done[step]..until {
                let at = (pixel - self.first) as usize;
                self.step(context, kind, at);
            }
            self.done[step] = self.done[step].max(until);
            before = self.done[step];
        }
        self.give(before)
    }

    /// Bands of which all pixels are done up to one; lets go of what is no longer looked at.
    fn give(&mut self, done: u32) -> Vec<Smoothed> {
        let mut given = Vec::new();
        while let Some(&(band, pixels, write)) = self.bands.first() {
            let begin = band * BAND_PIXELS;
            let from = begin + self.records.len() as u32;
            let until = done.min(begin + pixels);
            self.records.reserve_exact((begin + pixels - from) as usize);
            let cells = (from.min(until) - self.first) as usize..(until - self.first) as usize;
            self.records.extend(self.cells[cells].iter().map(|cell| cell.record));
            if until < begin + pixels {
                break;
            }
            let records = std::mem::take(&mut self.records);
            if write {
                given.push((band, records));
            }
            self.bands.remove(0);
        }
        let behind = u64::from(done).saturating_sub(pixels_of(REACH, self.width)) as u32;
        if behind > self.first {
            self.cells.drain(..(behind - self.first) as usize);
            self.first = behind;
        }
        given
    }

    /// Calls `each` with the cells about one, itself included, and their squared distance in pixels.
    fn about(
        &self,
        context: &Context<'_>,
        at: usize,
        reach: u32,
        mut each: impl FnMut(&Cell, u32, bool),
    ) {
        context.neighbours(self.first, self.cells.len(), at, reach, |other, squares| {
            each(&self.cells[other], squares, other == at);
        });
    }

    fn step(&mut self, context: &Context<'_>, step: Step, at: usize) {
        let own = self.cells[at];
        let share = self.share;
        match step {
            Step::Near => {
                let (mut sum, mut weight) = (0.0f32, 0.0f32);
                if own.flat {
                    self.about(context, at, NEAR_REACH, |there, _, _| {
                        if own.is_alike(there) {
                            sum += there.nearness;
                            weight += 1.0;
                        }
                    });
                }
                self.cells[at].near = if weight > 0.0 { sum / weight } else { f32::INFINITY };
            }
            Step::First => {
                let (mut sum, mut has, mut all) = (Vec3::ZERO, 0.0f32, 0.0f32);
                if own.flat {
                    self.about(context, at, REACH, |there, squares, _| {
                        let weight = own.weight(there, squares, share);
                        sum += weight * there.albedo();
                        has += if weight > 0.0 { window(squares, LEAST) } else { 0.0 };
                        all += window(squares, LEAST);
                    });
                }
                let cell = &mut self.cells[at];
                cell.first = inverse_root(sum);
                cell.edge = own.record.depth > 0.0 && has <= FEW * all;
            }
            Step::Second => {
                let mut sum = Vec3::ZERO;
                if own.flat {
                    self.about(context, at, REACH, |there, squares, _| {
                        sum += own.weight(there, squares, share) * there.albedo() * there.first;
                    });
                }
                self.cells[at].second = own.first * inverse_root(own.first * sum);
            }
            Step::Surfaces => {
                let mut change = Vec3::ZERO;
                if own.flat {
                    self.about(context, at, REACH, |there, squares, _| {
                        let flow = own.albedo() * there.raw - there.albedo() * own.raw;
                        change += own.weight(there, squares, share) * there.second * flow;
                    });
                }
                self.cells[at].smooth = own.raw + own.second * change;
            }
            Step::Guide => {
                if own.edge {
                    self.cells[at].guide = self.guide(context, at);
                }
            }
            Step::FirstEdge => {
                let mut sum = Vec3::ZERO;
                if own.edge {
                    self.about(context, at, EDGE_REACH, |there, squares, _| {
                        sum += own.edge_weight(there, squares) * there.guide;
                    });
                }
                self.cells[at].first_edge = inverse_root(sum);
            }
            Step::SecondEdge => {
                let mut sum = Vec3::ZERO;
                if own.edge {
                    self.about(context, at, EDGE_REACH, |there, squares, _| {
                        sum += own.edge_weight(there, squares) * there.guide * there.first_edge;
                    });
                }
                self.cells[at].second_edge = own.first_edge * inverse_root(own.first_edge * sum);
            }
            Step::Edges => {
                let mut change = Vec3::ZERO;
                if own.edge {
                    self.about(context, at, EDGE_REACH, |there, squares, _| {
                        let flow = own.guide * there.smooth - there.guide * own.smooth;
                        change += own.edge_weight(there, squares) * there.second_edge * flow;
                    });
                }
                let gathered = own.smooth + own.second_edge * change;
                let all = Vec3::from(own.record.indirect) + (gathered - own.raw);
                self.cells[at].record.indirect = all.max(Vec3::ZERO).to_array();
            }
        }
    }

    /// What the radiance of an edge is expected to be, from the surfaces about it.
    fn guide(&self, context: &Context<'_>, at: usize) -> Vec3 {
        let own = &self.cells[at];
        let mut fit = Fit::default();
        let (mut light, mut reflects) = (Vec3::ZERO, Vec3::ZERO);
        self.about(context, at, GUIDE_REACH, |there, squares, _| {
            light += there.smooth;
            reflects += there.albedo();
            // Nothing at all is a surface as well, without light.
            if there.record.depth <= 0.0 || !there.edge {
                let weight = f64::from(window(squares, GUIDE_REACH + 1));
                fit.add(features(there, own), there.smooth, weight);
            }
        });
        // Next to other edges alone: what arrives on average.
        let known = reflects.cmpgt(Vec3::ZERO);
        let mean = Vec3::select(known, own.albedo() * (light / reflects), Vec3::ZERO);
        fit.at(features(own, own)).unwrap_or(mean).max(Vec3::ZERO)
    }
}

/// Numbers that radiance is a linear function of.
const FEATURES: usize = 7;

/// Those of a pixel, beside another one.
fn features(cell: &Cell, own: &Cell) -> [f64; FEATURES] {
    let [nx, ny, nz] = cell.record.normal;
    let [r, g, b] = cell.record.albedo;
    let depth = cell.record.depth / own.record.depth.max(f32::MIN_POSITIVE);
    // Far behind is no farther than behind.
    [nx, ny, nz, r, g, b, depth.min(2.0)].map(f64::from)
}

/// A weighted linear fit, by its sums.
#[derive(Default)]
struct Fit {
    samples: u32,
    weight: f64,
    features: [f64; FEATURES],
    products: [[f64; FEATURES]; FEATURES],
    light: [f64; 3],
    lights: [[f64; FEATURES]; 3],
    range: Option<[Vec3; 2]>,
}

impl Fit {
    fn add(&mut self, features: [f64; FEATURES], light: Vec3, weight: f64) {
        self.samples += 1;
        self.weight += weight;
        for i in 0..FEATURES {
            self.features[i] += weight * features[i];
            for j in 0..=i {
                self.products[i][j] += weight * features[i] * features[j];
            }
        }
        for (c, value) in light.to_array().map(f64::from).into_iter().enumerate() {
            self.light[c] += weight * value;
            for (sum, feature) in self.lights[c].iter_mut().zip(features) {
                *sum += weight * value * feature;
            }
        }
        let [least, most] = self.range.unwrap_or([light; 2]);
        self.range = Some([least.min(light), most.max(light)]);
    }

    /// The fit's value; `None` where too little is known.
    fn at(&self, features: [f64; FEATURES]) -> Option<Vec3> {
        let [least, most] = self.range.filter(|_| self.samples >= 4 && self.weight > 0.0)?;
        let mean = self.features.map(|f| f / self.weight);
        // Cholesky's lower triangle of the covariance, with the ridge.
        let mut lower = [[0.0f64; FEATURES]; FEATURES];
        for i in 0..FEATURES {
            for j in 0..=i {
                let ridge = if i == j { RIDGE } else { 0.0 };
                let covariance = self.products[i][j] / self.weight - mean[i] * mean[j] + ridge;
                let both = lower[i].iter().zip(&lower[j]).take(j);
                let sum = covariance - both.map(|(a, b)| a * b).sum::<f64>();
                // Above the ridge, but for rounding.
                lower[i][j] = if i == j { sum.max(0.1 * RIDGE).sqrt() } else { sum / lower[j][j] };
            }
        }
        let mut way = [0.0f64; FEATURES];
        for i in 0..FEATURES {
            let mut sum = features[i] - mean[i];
            for k in 0..i {
                sum -= lower[i][k] * way[k];
            }
            way[i] = sum / lower[i][i];
        }
        let mut weights = [0.0f64; FEATURES];
        for i in (0..FEATURES).rev() {
            let mut sum = way[i];
            for k in i + 1..FEATURES {
                sum -= lower[k][i] * weights[k];
            }
            weights[i] = sum / lower[i][i];
        }
        let value = |c: usize| {
            let mean_light = self.light[c] / self.weight;
            let slope: f64 = (0..FEATURES)
                .map(|i| weights[i] * (self.lights[c][i] / self.weight - mean[i] * mean_light))
                .sum();
            (mean_light + slope) as f32
        };
        let value = Vec3::new(value(0), value(1), value(2));
        Some(value.clamp(GUIDE_RANGE[0] * least, GUIDE_RANGE[1] * most))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An edge between two surfaces, at any share of either, is the mixture of the two; what is not known is the mean.
    #[test]
    fn a_fit_finds_the_mixture() {
        let (floor, wall) =
            ([0.0, 0.0, 1.0, 0.2, 0.3, 0.4, 1.0], [1.0, 0.0, 0.0, 0.8, 0.8, 0.8, 1.0]);
        let (dark, bright) = (Vec3::new(0.1, 0.2, 0.3), Vec3::new(4.0, 3.0, 2.0));
        let mut fit = Fit::default();
        assert_eq!(fit.at(floor), None);
        for i in 0..12 {
            let weight = 0.3 + 0.1 * f64::from(i % 4);
            if i % 3 == 0 {
                fit.add(wall, bright, weight);
            } else {
                fit.add(floor, dark, weight);
            }
        }
        for share in [0.0, 0.25, 0.7, 1.0] {
            let mixed = std::array::from_fn(|i| floor[i] + share * (wall[i] - floor[i]));
            let (found, wanted) = (fit.at(mixed).unwrap(), dark.lerp(bright, share as f32));
            let off = (found - wanted).abs().max_element();
            assert!(off < 0.02, "{share}: {found} for {wanted}");
        }
        // A feature that was the same everywhere says nothing.
        let other = std::array::from_fn(|i| if i == 1 { 1.0 } else { wall[i] });
        assert!((fit.at(other).unwrap() - bright).abs().max_element() < 0.02);
    }

    /// A window is whole in its middle and ends a pixel beyond its reach; of nothing there is no root.
    #[test]
    fn windows_end_where_they_should() {
        assert_eq!(window(0, LEAST), 1.0);
        assert_eq!(window(16, LEAST), 0.0);
        assert!(window(15, LEAST) > 0.0);
        assert_eq!(inverse_root(Vec3::new(4.0, 0.0, 0.25)), Vec3::new(0.5, 0.0, 2.0));
        assert!(bytes(100, 1 << 16) < 100 * 400, "one band has no rows about it");
        assert_eq!(bands_before(1024), 2);
    }
}
