//! The film: sums of radiance in integers, so that no order of arrival can change a picture.
//!
//! Rays come home in whatever order rooms were resident. Floating-point sums would remember that
//! order in their last bits; integer sums do not. Each channel is an `i64` in units of 2⁻³⁰ W/m²/sr:
//! steps of a billionth, room for eight thousand million. What does not fit is widened, never
//! clamped: a wrapped `i64` leaves a carry, a contribution too large for an `i64` goes to a wider
//! register, both in a side table that is empty in any sane picture.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicI64, AtomicU32, AtomicU64, Ordering::Relaxed};
use std::sync::{Mutex, MutexGuard, PoisonError};

use enf_layout::film::PixelRecord;

/// Units of the fixed point per W/m²/sr: 2³⁰.
pub const UNITS: f64 = (1u64 << 30) as f64;
/// From this magnitude (2³³) on, a single contribution goes to the side table.
const LARGE: f32 = (1u64 << 33) as f32;
/// Large contributions are whole multiples of this (an `f32` of at least 2³³ has steps of 2¹⁰).
const LARGE_UNIT: f64 = 1024.0;

/// 2⁶⁴.
const TWO_64: f64 = (1u128 << 64) as f64;

const DIRECT: usize = 0;
const INDIRECT: usize = 3;
const ALBEDO: usize = 6;
const NORMAL: usize = 9;
const DEPTH: usize = 12;
const GATHERED: usize = 13;
const NEARNESS: usize = 16;
const RAYS: usize = 17;
const NOISE: usize = 18;
const CHANNELS: usize = 19;

/// One pixel's sums.
#[derive(Default)]
struct Cell {
    sums: [AtomicI64; CHANNELS],
    room: AtomicU32,
    /// Largest room plus 1 that a sample sees, and the smallest: as its complement, so that it is a maximum too.
    rooms: [AtomicU32; 2],
}

impl Cell {
    /// [`PixelRecord::room`].
    fn room(&self) -> f32 {
        let room = self.room.load(Relaxed) as f32;
        let [largest, smallest] = self.rooms.each_ref().map(|r| r.load(Relaxed));
        // Both are 0 where nothing was said.
        let several = smallest != 0 && largest != !smallest;
        if several { -room } else { room }
    }
}

/// What gather rays say about a pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Gathered {
    /// Radiance that they have added, W/m²/sr, mean over the samples that sent them.
    pub radiance: [f32; 3],
    /// Mean of one over the distance to what they met first, 1/m; 0 where they met nothing.
    pub nearness: f32,
}

/// What did not fit into one `i64`. All three parts are sums of integers, so their values do not
/// depend on the order of adds either.
#[derive(Clone, Copy, Default)]
struct Wide {
    /// Wraps of the `i64`, in units of 2⁶⁴.
    carries: i64,
    /// Large contributions in [`LARGE_UNIT`], upper part, in units of 2⁶⁴ ...
    high: i128,
    /// ... and the sum of the lower 64 bits.
    low: i128,
}

/// Accumulators for a contiguous band of pixels, shared by all threads.
///
/// The caller reserves [`Film::bytes_per_pixel`] per pixel in its memory budget before it calls
/// [`Film::new`]. Contributions that are not finite, or whose pixel lies outside the film, are
/// refused and counted by [`Film::rejected`].
pub struct Film {
    cells: Vec<Cell>,
    wide: Mutex<BTreeMap<(u32, u8), Wide>>,
    rejected: AtomicU64,
}

impl Film {
    /// Bytes that one pixel takes.
    pub fn bytes_per_pixel() -> usize {
        size_of::<Cell>()
    }

    /// A black film of `pixels` pixels.
    pub fn new(pixels: usize) -> Self {
        let mut cells = Vec::with_capacity(pixels);
        cells.resize_with(pixels, Cell::default);
        Self { cells, wide: Mutex::default(), rejected: AtomicU64::new(0) }
    }

    /// Number of pixels.
    pub fn len(&self) -> usize {
        self.cells.len()
    }

    /// Whether the film has no pixel at all.
    pub fn is_empty(&self) -> bool {
        self.cells.is_empty()
    }

    /// Adds radiance (W/m²/sr) that came straight from a light: emitted, or once reflected.
    pub fn add_direct(&self, pixel: u32, rgb: [f32; 3]) {
        self.add(pixel, DIRECT, &rgb);
    }

    /// Adds radiance (W/m²/sr) that came by way of the photon maps.
    pub fn add_indirect(&self, pixel: u32, rgb: [f32; 3]) {
        self.add(pixel, INDIRECT, &rgb);
    }

    /// Adds radiance (W/m²/sr) that gather rays from what is seen first have found. It is part of the indirect light, and
    /// kept apart besides.
    pub fn add_gathered(&self, pixel: u32, rgb: [f32; 3]) {
        self.add(pixel, GATHERED, &rgb);
    }

    /// Counts gather rays that start at what is seen first.
    pub fn add_gather_rays(&self, pixel: u32, rays: u32) {
        self.add(pixel, RAYS, &[rays as f32]);
    }

    /// Adds one over the distance at which such a ray met something, 1/m.
    pub fn add_nearness(&self, pixel: u32, nearness: f32) {
        self.add(pixel, NEARNESS, &[nearness]);
    }

    /// Adds luminance with the sign of the half of the samples that it comes from: in the end, how far the halves are apart.
    pub fn add_noise(&self, pixel: u32, signed: f32) {
        self.add(pixel, NOISE, &[signed]);
    }

    /// Sum of what [`Film::add_noise`] was told about a pixel.
    pub fn noise(&self, pixel: usize) -> f64 {
        self.sum(&self.wide(), pixel, NOISE)
    }

    /// Sum of the luminance of a pixel's direct and indirect light over its samples, W/m²/sr.
    pub fn luminance(&self, pixel: usize) -> f64 {
        let wide = self.wide();
        let sum = |first: usize| {
            [0.2126, 0.7152, 0.0722]
                .iter()
                .zip(first..)
                .map(|(weight, channel)| weight * self.sum(&wide, pixel, channel))
                .sum::<f64>()
        };
        sum(DIRECT) + sum(INDIRECT) + sum(GATHERED)
    }

    /// What gather rays of so many samples say about a pixel.
    pub fn gathered(&self, pixel: usize, gathering: u32) -> Gathered {
        let wide = self.wide();
        let sum = |channel| self.sum(&wide, pixel, channel);
        let (gathering, rays) = (f64::from(gathering.max(1)), sum(RAYS).max(1.0));
        Gathered {
            radiance: [0, 1, 2].map(|c| (sum(GATHERED + c) / gathering) as f32),
            nearness: (sum(NEARNESS) / rays) as f32,
        }
    }

    /// A channel's sum.
    fn sum(&self, wide: &BTreeMap<(u32, u8), Wide>, pixel: usize, channel: usize) -> f64 {
        let Some(cell) = self.cells.get(pixel) else { return 0.0 };
        let sum = cell.sums[channel].load(Relaxed);
        let side = if wide.is_empty() { None } else { wide.get(&(pixel as u32, channel as u8)) };
        match side {
            None => sum as f64 / UNITS,
            Some(side) => {
                let fine = i128::from(sum) + (i128::from(side.carries) << 64);
                let coarse = side.high as f64 * TWO_64 + side.low as f64;
                fine as f64 / UNITS + coarse * LARGE_UNIT
            }
        }
    }

    /// Adds what one sample sees first: diffuse albedo, unit normal, distance in m.
    pub fn add_surface(&self, pixel: u32, albedo: [f32; 3], normal: [f32; 3], depth: f32) {
        let [r, g, b] = albedo;
        let [x, y, z] = normal;
        const { assert!(NORMAL == ALBEDO + 3 && DEPTH == NORMAL + 3) };
        self.add(pixel, ALBEDO, &[r, g, b, x, y, z, depth]);
    }

    /// Sets the room that the pixel's first sample sees, plus 1. Said more than once, the largest
    /// number stands, whatever the order.
    pub fn set_room(&self, pixel: u32, room_plus_1: u32) {
        match self.cells.get(pixel as usize) {
            Some(cell) => {
                cell.room.fetch_max(room_plus_1, Relaxed);
            }
            None => {
                self.rejected.fetch_add(1, Relaxed);
            }
        }
    }

    /// Says which room a sample sees, plus 1; 0 where it sees nothing. So it comes to be known which pixels see several.
    pub fn add_room(&self, pixel: u32, room_plus_1: u32) {
        match self.cells.get(pixel as usize) {
            Some(Cell { rooms: [largest, smallest], .. }) => {
                largest.fetch_max(room_plus_1, Relaxed);
                smallest.fetch_max(!room_plus_1, Relaxed);
            }
            None => {
                self.rejected.fetch_add(1, Relaxed);
            }
        }
    }

    fn add(&self, pixel: u32, first: usize, values: &[f32]) {
        let cell = match self.cells.get(pixel as usize) {
            Some(cell) if values.iter().all(|v| v.is_finite()) => cell,
            _ => {
                self.rejected.fetch_add(1, Relaxed);
                return;
            }
        };
        for (i, (&value, sum)) in values.iter().zip(&cell.sums[first..]).enumerate() {
            if value == 0.0 {
                continue;
            }
            let key = (pixel, (first + i) as u8);
            if value.abs() >= LARGE {
                // Exact: a multiple of 2^10, below 2^118 in that unit.
                let units = (f64::from(value) / LARGE_UNIT) as i128;
                let mut wide = self.wide();
                let entry = wide.entry(key).or_default();
                entry.high += units >> 64;
                entry.low += units & i128::from(u64::MAX);
                continue;
            }
            // Below 2^63, and the product with a power of two is exact.
            let units = (f64::from(value) * UNITS).round_ties_even() as i64;
            let before = sum.fetch_add(units, Relaxed);
            if before.checked_add(units).is_none() {
                self.wide().entry(key).or_default().carries += units.signum();
            }
        }
    }

    fn wide(&self) -> MutexGuard<'_, BTreeMap<(u32, u8), Wide>> {
        self.wide.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Writes the means over `samples` samples per pixel to `out`, one record per pixel from
    /// pixel 0 on; as many as both sides have. No samples count as one.
    pub fn resolve(&self, samples: u32, out: &mut [PixelRecord]) {
        self.resolve_from(0, samples, out);
    }

    /// [`Film::resolve`] for the pixels from `first` on, so that a big film can be resolved through
    /// a small buffer.
    pub fn resolve_from(&self, first: usize, samples: u32, out: &mut [PixelRecord]) {
        self.resolve_each(first, |_| samples, samples, out);
    }

    /// [`Film::resolve_from`] where each pixel has samples of its own number; `gathering` of them, in all pixels, sent gather rays.
    pub fn resolve_each(
        &self,
        first: usize,
        samples: impl Fn(usize) -> u32,
        gathering: u32,
        out: &mut [PixelRecord],
    ) {
        let gathering = f64::from(gathering.max(1));
        let wide = self.wide();
        let cells = self.cells.get(first..).unwrap_or_default();
        for ((i, cell), record) in cells.iter().enumerate().zip(out) {
            let pixel = first + i;
            let samples = f64::from(samples(pixel).max(1));
            let mean = |channel: usize| (self.sum(&wide, pixel, channel) / samples) as f32;
            let rgb = |c: usize| [mean(c), mean(c + 1), mean(c + 2)];
            let both = |c: usize| {
                let sum = |channel| self.sum(&wide, pixel, channel);
                (sum(INDIRECT + c) / samples + sum(GATHERED + c) / gathering) as f32
            };
            *record = PixelRecord {
                direct: rgb(DIRECT),
                indirect: [both(0), both(1), both(2)],
                albedo: rgb(ALBEDO),
                normal: rgb(NORMAL),
                depth: mean(DEPTH),
                room: cell.room(),
            };
        }
    }

    /// Makes the film black again, for the next band; also forgets [`Film::rejected`].
    pub fn clear(&mut self) {
        self.cells.fill_with(Cell::default);
        self.wide.get_mut().unwrap_or_else(PoisonError::into_inner).clear();
        *self.rejected.get_mut() = 0;
    }

    /// Contributions refused since the film was new or cleared: not finite, or outside the film.
    pub fn rejected(&self) -> u64 {
        self.rejected.load(Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn resolved(film: &Film, samples: u32) -> Vec<PixelRecord> {
        let mut out = vec![PixelRecord::default(); film.len()];
        film.resolve(samples, &mut out);
        out
    }

    #[test]
    fn sums_are_exact_and_means_are_means() {
        let film = Film::new(3);
        for _ in 0..4 {
            film.add_direct(1, [0.25, 0.5, -0.125]);
            film.add_indirect(1, [1.0, 2.0, 3.0]);
            film.add_surface(1, [0.1, 0.2, 0.3], [0.0, 0.0, 1.0], 7.5);
        }
        film.set_room(1, 13);
        let out = resolved(&film, 4);
        assert_eq!(out[0], PixelRecord::default());
        assert_eq!(out[1].direct, [0.25, 0.5, -0.125]);
        assert_eq!(out[1].indirect, [1.0, 2.0, 3.0]);
        assert_eq!(out[1].normal, [0.0, 0.0, 1.0]);
        assert_eq!((out[1].depth, out[1].room), (7.5, 13.0));
        assert!((out[1].albedo[0] - 0.1).abs() < 1e-9);
        assert_eq!(film.rejected(), 0);
    }

    /// Rooms 0 and 1, nothing and a room, one room alone, nothing at all; whatever the order.
    #[test]
    fn pixels_that_see_several_rooms_are_marked() {
        let film = Film::new(5);
        for (pixel, rooms) in [(0, [2, 1]), (1, [0, 3]), (2, [4, 4]), (3, [0, 0])] {
            film.set_room(pixel, rooms[0]);
            for room in rooms {
                film.add_room(pixel, room);
            }
        }
        film.add_room(9, 1);
        assert_eq!(film.rejected(), 1);
        let rooms: Vec<f32> = resolved(&film, 2).iter().map(|r| r.room).collect();
        assert_eq!(rooms, [-2.0, 0.0, 4.0, 0.0, 0.0]);
        let several: Vec<bool> = rooms.iter().map(|r| r.is_sign_negative()).collect();
        assert_eq!(several, [true, true, false, false, false]);
    }

    #[test]
    fn any_order_and_any_threads_give_the_same_bits() {
        // Magnitudes over 20 orders, with overflow on the way: a float sum would differ.
        let mut state = 1u64;
        let adds: Vec<(u32, [f32; 3])> = (0..20_000)
            .map(|_| {
                let mut next = || {
                    state =
                        state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                    (state >> 33) as u32
                };
                let pixel = next() % 7;
                let rgb = [(); 3].map(|()| {
                    let m = next() as f32 / 2f32.powi(31) - 0.4;
                    m * 2f32.powi((next() % 66) as i32 - 30)
                });
                (pixel, rgb)
            })
            .collect();
        let reference = {
            let film = Film::new(7);
            adds.iter().for_each(|&(p, rgb)| film.add_direct(p, rgb));
            resolved(&film, 16)
        };
        for threads in [2, 3, 8] {
            let film = Film::new(7);
            std::thread::scope(|scope| {
                for t in 0..threads {
                    let (film, adds) = (&film, &adds);
                    scope.spawn(move || {
                        for (p, rgb) in adds.iter().rev().skip(t).step_by(threads) {
                            film.add_direct(*p, *rgb);
                        }
                    });
                }
            });
            assert_eq!(resolved(&film, 16), reference, "{threads} threads");
        }
    }

    #[test]
    fn overflow_widens_and_never_clamps() {
        let film = Film::new(1);
        let big = 2f32.powi(32) * 1.5;
        for _ in 0..1000 {
            film.add_direct(0, [big, -big, 2f32.powi(40)]);
        }
        film.add_direct(0, [0.0, 0.0, -2f32.powi(40)]);
        let out = resolved(&film, 1);
        assert_eq!(out[0].direct, [big * 1000.0, -big * 1000.0, 2f32.powi(40) * 999.0]);
        // And back again: the carries cancel.
        for _ in 0..1000 {
            film.add_direct(0, [-big, big, 0.0]);
        }
        film.add_direct(0, [0.5, 0.0, 0.0]);
        assert_eq!(resolved(&film, 1)[0].direct[..2], [0.5, 0.0]);
        // The largest floats there are.
        let film = Film::new(1);
        for _ in 0..5000 {
            film.add_indirect(0, [f32::MAX, f32::MIN, f32::MAX]);
            film.add_indirect(0, [0.0, 0.0, f32::MIN]);
        }
        assert_eq!(resolved(&film, 5000)[0].indirect, [f32::MAX, f32::MIN, 0.0]);
    }

    #[test]
    fn what_is_no_number_is_refused_whole_and_counted() {
        let mut film = Film::new(2);
        film.add_direct(0, [1.0, f32::NAN, 1.0]);
        film.add_indirect(0, [f32::INFINITY, 0.0, 0.0]);
        film.add_surface(0, [0.5; 3], [0.0, 0.0, 1.0], f32::NEG_INFINITY);
        film.add_direct(2, [1.0; 3]);
        film.set_room(9, 1);
        assert_eq!(film.rejected(), 5);
        assert_eq!(resolved(&film, 1), vec![PixelRecord::default(); 2]);
        film.add_direct(1, [f32::MAX; 3]);
        film.clear();
        assert_eq!(film.rejected(), 0);
        assert_eq!(resolved(&film, 1), vec![PixelRecord::default(); 2]);
    }

    #[test]
    fn gathered_light_is_indirect_and_kept_apart() {
        let film = Film::new(2);
        film.add_indirect(1, [1.0, 2.0, 3.0]);
        film.add_gathered(1, [0.5, 0.25, 8.0]);
        film.add_gather_rays(1, 4);
        film.add_nearness(1, 2.0);
        film.add_nearness(1, 6.0);
        film.add_noise(1, 3.0);
        film.add_noise(1, -1.0);
        let mut out = [PixelRecord::default(); 2];
        film.resolve_each(0, |pixel| [1, 2][pixel], 4, &mut out);
        assert_eq!(out[1].indirect, [0.625, 1.0625, 3.5]);
        let gathered = Gathered { radiance: [0.125, 0.0625, 2.0], nearness: 2.0 };
        assert_eq!(film.gathered(1, 4), gathered);
        assert_eq!(film.gathered(0, 2), Gathered::default());
        assert_eq!((film.noise(1), film.noise(0)), (2.0, 0.0));
        let expected = 0.2126 * 1.5 + 0.7152 * 2.25 + 0.0722 * 11.0;
        assert!((film.luminance(1) - expected).abs() < 1e-6);
    }

    #[test]
    fn a_film_can_be_resolved_in_pieces() {
        let film = Film::new(10);
        for p in 0..10 {
            film.add_direct(p, [p as f32 * if p == 6 { 1e12 } else { 1.0 }; 3]);
            film.set_room(p, p);
        }
        let whole = resolved(&film, 2);
        let mut piece = [PixelRecord::default(); 3];
        film.resolve_from(5, 2, &mut piece);
        assert_eq!(piece, whole[5..8]);
        film.resolve_from(100, 2, &mut piece);
        assert_eq!(piece, whole[5..8], "nothing there, nothing written");
    }

    proptest! {
        #[test]
        fn the_sum_of_two_is_within_half_a_unit_each(a in -1e6f32..1e6, b in -1e6f32..1e6) {
            let film = Film::new(1);
            film.add_direct(0, [a, b, 0.0]);
            film.add_direct(0, [b, a, 0.0]);
            let out = resolved(&film, 1);
            prop_assert_eq!(out[0].direct[0], out[0].direct[1]);
            let exact = f64::from(a) + f64::from(b);
            let error = (f64::from(out[0].direct[0]) - exact).abs();
            prop_assert!(error <= 1.0 / UNITS + exact.abs() * 1e-7);
        }
    }
}
